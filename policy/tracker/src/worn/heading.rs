//! Headings that wander: how fast, in degrees a minute, and back to where they belong.

use crate::geometry::wrap;

/// Offsets are averaged over this long, seconds.
const BIN_S: f64 = 5.0;
/// A bin counts if this much of it was usable, seconds.
const BIN_USED_S: f64 = 1.0;
/// Bins that the drift is taken over: 5 minutes.
const BINS: usize = 60;
/// No drift is told before so many bins: half a minute.
const BINS_MIN: usize = 6;
/// Offsets beyond this are the wearer looking elsewhere, not drift, radians (30 degrees).
const OFFSET_MAX: f32 = 0.52;
/// An offset is taken back with this time constant, seconds: slower than anybody looks aside.
const RETURN_S: f32 = 60.0;
/// The fastest correction, rad/s: 6 degrees a minute.
const RATE_MAX: f32 = 6.0 / 180.0 * std::f32::consts::PI / 60.0;

/// Watches the heading of one tracker against a reference.
#[derive(Debug, Clone)]
pub struct HeadingWatch {
    /// Mean offsets, radians, with the middle of their time, seconds; NaN-free, oldest first.
    bins: [(f64, f64); BINS],
    count: usize,
    sum: f64,
    used_s: f64,
    begun_s: f64,
    now_s: f64,
    /// The corrections so far, radians.
    corrected: f64,
}

impl Default for HeadingWatch {
    fn default() -> Self {
        Self {
            bins: [(0.0, 0.0); BINS],
            count: 0,
            sum: 0.0,
            used_s: 0.0,
            begun_s: 0.0,
            now_s: 0.0,
            corrected: 0.0,
        }
    }
}

impl HeadingWatch {
    /// Time goes on by `dt` seconds. `offset` is the bone's heading less the reference's, radians,
    /// where both can be told. Answers with the correction of the tracker's heading, radians,
    /// which is zero unless the reference is `trusted`.
    pub fn update(&mut self, dt: f32, offset: Option<f32>, trusted: bool) -> f32 {
        self.now_s += f64::from(dt);
        let usable = offset.map(wrap).filter(|offset| offset.abs() < OFFSET_MAX);
        let mut correction = 0.0;
        if let Some(offset) = usable {
            self.sum += (f64::from(offset) - self.corrected) * f64::from(dt);
            self.used_s += f64::from(dt);
            if trusted {
                let most = RATE_MAX * dt;
                correction = (-offset * dt / RETURN_S).clamp(-most, most);
                self.corrected += f64::from(correction);
            }
        }
        if self.now_s - self.begun_s >= BIN_S {
            self.close_bin();
        }
        correction
    }

    /// How fast the heading wanders, degrees a minute, counter-clockwise from above; `None` while
    /// too little was seen. Corrections are not part of it.
    #[must_use]
    pub fn drift(&self) -> Option<f32> {
        let bins = &self.bins[..self.count];
        if self.count < BINS_MIN {
            return None;
        }
        let mean =
            |of: fn(&(f64, f64)) -> f64| bins.iter().map(of).sum::<f64>() / self.count as f64;
        let (time, offset) = (mean(|bin| bin.0), mean(|bin| bin.1));
        let (mut covariance, mut variance) = (0.0, 0.0);
        for (t, o) in bins {
            covariance += (t - time) * (o - offset);
            variance += (t - time) * (t - time);
        }
        Some((covariance / variance.max(1e-9) * 60.0).to_degrees() as f32)
    }

    fn close_bin(&mut self) {
        if self.used_s >= BIN_USED_S {
            if self.count == BINS {
                self.bins.rotate_left(1);
                self.count -= 1;
            }
            let middle = (self.begun_s + self.now_s) / 2.0;
            self.bins[self.count] = (middle, self.sum / self.used_s);
            self.count += 1;
        }
        (self.sum, self.used_s, self.begun_s) = (0.0, 0.0, self.now_s);
    }
}
