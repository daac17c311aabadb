//! Which trackers can be had.

use crate::{
    inference::InferenceError,
    tracker::{Tracker, TrackerKind},
};

/// The trackers that `load` gives, and what to say if `wanted` is not among them: `ik` stands in
/// then, so that there is always a body.
pub fn gather(
    wanted: TrackerKind,
    load: impl Fn(TrackerKind) -> Result<Option<Box<dyn Tracker>>, InferenceError>,
) -> (Vec<Box<dyn Tracker>>, Option<String>) {
    let (mut trackers, mut warning) = (Vec::new(), None);
    for kind in TrackerKind::ALL {
        let name = kind.name();
        let problem = match load(kind) {
            Ok(Some(tracker)) => {
                trackers.push(tracker);
                continue;
            }
            Ok(None) => format!("this build has no model for the tracker {name}: ik stands in"),
            Err(error) => format!("the tracker {name} cannot be used, ik stands in: {error}"),
        };
        if kind == wanted && kind != TrackerKind::Ik {
            warning = Some(problem);
        }
    }
    (trackers, warning)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Ik;

    #[test]
    fn a_tracker_that_cannot_be_had_is_named_with_its_reason() {
        let missing = InferenceError::Library {
            path: "/nowhere/libonnxruntime.so".into(),
            message: "no such file".into(),
        };
        let misfit = InferenceError::Port {
            model: "hmd_nemo_small.onnx".into(),
            port: "input `features`".into(),
            wanted: "32-bit floats (1, 5, 15)".into(),
            found: "32-bit floats (1, 5, 18)".into(),
        };
        let nemo = TrackerKind::HmdNemo;
        let of = |error: &InferenceError| gather(nemo, |_| Err(error.clone())).1.unwrap();
        let text = of(&missing);
        for word in [
            "hmd_nemo",
            "ik stands in",
            "/nowhere/libonnxruntime.so",
            "make native",
        ] {
            assert!(text.contains(word), "{text}");
        }
        let text = of(&misfit);
        for word in [
            "hmd_nemo_small.onnx",
            "features",
            "(1, 5, 15)",
            "(1, 5, 18)",
        ] {
            assert!(text.contains(word), "{text}");
        }
        // Another tracker's trouble is none of the wanted one's.
        let load = |kind| match kind {
            TrackerKind::HmdNemo => Ok(Some(Box::new(Ik::default()) as Box<dyn Tracker>)),
            _ => Err(misfit.clone()),
        };
        let (trackers, warning) = gather(nemo, load);
        assert_eq!((trackers.len(), warning), (1, None));
        assert!(gather(TrackerKind::Pip, load).1.is_some());
        assert_eq!(gather(TrackerKind::Ik, |_| Ok(None)).1, None);
    }
}
