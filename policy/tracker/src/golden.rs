//! How tests compare with golden vectors of the training side.

/// Panics where numbers of `frame` are further apart than `bound`, relative above one.
pub(crate) fn close(name: &str, frame: usize, found: &[f32], wanted: &[f32], bound: f32) {
    for (index, (found, wanted)) in found.iter().zip(wanted).enumerate() {
        let off = (found - wanted).abs();
        assert!(
            off < bound * (1.0 + wanted.abs()),
            "{name} {index} of frame {frame}: {found}, not {wanted}"
        );
    }
}
