//! How high the wearer's floor lies: headsets measure it several centimetres wrong, skeletons have
//! soles of their own, and a character that shall be taller than its legs are long falls.

/// The level follows the stand-in's lowest sole within so many seconds, downwards and upwards: it stays
/// among the lower ones, as clips are set on the floor in training.
const DOWN_S: f64 = 0.3;
const UP_S: f64 = 1.0;
/// At first, and for how long: a stand-in's first ticks know least of the legs.
const FIRST_S: f64 = 0.05;
const FIRST_FOR_S: f64 = 0.2;
/// Soles that are higher above the level than this (who jumps) count as if they were so high, metres.
const OFF: f64 = 0.03;
/// No floor is measured more wrongly than this, metres.
const FARTHEST: f64 = 0.12;

/// Height of the floor under the wearer, as the stand-in's soles have it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Level {
    height: Option<f64>,
    /// Seconds that it has been followed.
    age: f64,
}

impl Level {
    /// Metres above zero.
    pub(super) fn height(self) -> f64 {
        self.height.unwrap_or(0.0)
    }

    /// The stand-in's lowest sole is at `lowest` (metres) `seconds` after the last call.
    pub(super) fn follow(&mut self, lowest: f64, seconds: f64) {
        let lowest = lowest.clamp(-FARTHEST, FARTHEST);
        self.age += seconds;
        let Some(height) = &mut self.height else {
            self.height = Some(lowest);
            return;
        };
        let above = lowest - *height;
        let (above, span) = match above {
            _ if self.age < FIRST_FOR_S => (above, FIRST_S),
            _ if above < 0.0 => (above, DOWN_S),
            _ => (above.min(OFF), UP_S),
        };
        *height += above * (1.0 - (-seconds / span).exp());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK_S: f64 = 1.0 / 90.0;

    #[test]
    fn the_level_is_where_soles_are_most_of_the_time() {
        let mut level = Level::default();
        assert_eq!(level.height(), 0.0);
        // Walking 3 cm above zero, a sole now and then 1 cm lower, jumps in between.
        for tick in 0..2000 {
            let lowest = match (f64::from(tick) * TICK_S) % 4.0 {
                s if s < 0.1 => 0.02,
                s if s > 3.6 => 0.3,
                _ => 0.03,
            };
            level.follow(lowest, TICK_S);
            if tick > 20 {
                assert!((0.02..0.045).contains(&level.height()), "{level:?}");
            }
        }
        level.follow(-5.0, 1e9);
        assert!((level.height() + FARTHEST).abs() < 1e-9);
    }

    #[test]
    fn a_wrong_beginning_is_soon_forgotten() {
        let mut level = Level::default();
        level.follow(-0.05, 0.0);
        for _ in 0..18 {
            level.follow(0.03, TICK_S);
        }
        assert!((level.height() - 0.03).abs() < 0.005, "{level:?}");
        // And one that lasted longer, within some seconds.
        let mut level = Level::default();
        (0..30).for_each(|_| level.follow(-0.05, TICK_S));
        (0..400).for_each(|_| level.follow(0.03, TICK_S));
        assert!((level.height() - 0.03).abs() < 0.01, "{level:?}");
    }
}
