//! Somebody who wears a headset and stands upright, seen by the headset alone.

/// Upright seconds, with the gaze within this of level, s and rad.
const UPRIGHT: (f64, f64) = (2.0, 0.35);
/// A headset that is worn never rests: it turns by more than this on the way, rad/s.
const WORN_RATE: f64 = 0.04;
/// Heights in that time stay within this, m.
const STEADY: f64 = 0.06;

/// Watches a headset for its wearer's first seconds upright.
#[derive(Debug, Clone, Copy, Default)]
pub struct Upright {
    since: Option<f64>,
    low: f64,
    high: f64,
    rate: f64,
}

impl Upright {
    /// Takes the eyes' height in metres, how far the head leans from upright in radians, to either
    /// side, and how fast it turns in rad/s, at a time in seconds. Answers the eyes' height once it
    /// is known: the middle of two seconds in which it hardly changed.
    pub fn watch(&mut self, time: f64, height: f64, lean: f64, rate: f64) -> Option<f64> {
        // Written so that what is no number does not count as upright.
        if !(lean.abs() <= UPRIGHT.1 && height.is_finite()) {
            self.since = None;
            return None;
        }
        let steady = self.high.max(height) - self.low.min(height) < STEADY;
        let goes_on = self.since.is_some_and(|since| since <= time) && steady;
        let Some(since) = self.since.filter(|_| goes_on) else {
            (self.since, self.low, self.high, self.rate) = (Some(time), height, height, 0.0);
            return None;
        };
        (self.low, self.high) = (self.low.min(height), self.high.max(height));
        self.rate = self.rate.max(rate);
        let done = time - since > UPRIGHT.0;
        (done && self.rate > WORN_RATE).then_some(0.5 * (self.low + self.high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What ten looks a second tell, until something is known.
    fn watch(seconds: f64, of: impl Fn(f64) -> (f64, f64, f64)) -> Option<f64> {
        let mut upright = Upright::default();
        let times = (0..(seconds * 10.0) as u32).map(|tick| f64::from(tick) * 0.1);
        let mut looks = times.map(|time| (time, of(time)));
        looks.find_map(|(time, (height, lean, rate))| upright.watch(time, height, lean, rate))
    }

    #[test]
    fn two_steady_seconds_tell_the_height() {
        let eyes = watch(4.0, |time| (1.6 + 0.01 * time.sin(), 0.1, 0.1));
        assert!(eyes.is_some_and(|eyes| (eyes - 1.6).abs() < 0.01));
        assert_eq!(watch(1.9, |_| (1.6, 0.1, 0.1)), None, "too short");
    }

    #[test]
    fn nothing_else_does() {
        assert_eq!(watch(9.0, |_| (0.7, 0.0, 0.01)), None, "on a table");
        assert_eq!(
            watch(9.0, |time| (1.2 + 0.1 * time, 0.0, 0.1)),
            None,
            "rising"
        );
        assert_eq!(
            watch(9.0, |time| (1.6, 0.5 * time.cos(), 0.1)),
            None,
            "nodding"
        );
        assert_eq!(watch(9.0, |_| (f64::NAN, 0.0, 0.1)), None);
        assert_eq!(watch(9.0, |_| (1.6, f64::NAN, 0.1)), None);
    }
}
