//! What `posed follow` prints: a line a pose as JSON, or a few lines a second for people.

use std::{
    fmt,
    io::{self, Write},
};

use posed_body::Joint;
use posed_signal::{
    HostTime,
    time::{MILLISECOND_NS, SECOND_NS},
};
use serde::Serialize;

use super::Followed;

/// Lines for people, this far apart in the poses' own time.
const LINE_INTERVAL_NS: i64 = 250 * MILLISECOND_NS as i64;
/// Ages remembered for percentiles: 45 s at 90 Hz.
const AGES_MAX: usize = 4096;

/// How poses are printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Every pose as a line of JSON: that of `--poses`, with `sequence`, `gap`, `age_ns` and
    /// `sample_age_ns`.
    Json,
    /// A line four times a second.
    Text,
}

/// What was followed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Summary {
    /// Poses received.
    pub poses: u64,
    /// Poses published meanwhile and not received.
    pub gaps: u64,
    /// When the first and the last pose were published.
    pub span: Option<(HostTime, HostTime)>,
    /// The ages of the last poses at arrival, ns.
    ages: Vec<i64>,
}

impl Summary {
    /// Poses received a second, by the times of their publication.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        let Some((first, last)) = self.span else {
            return 0.0;
        };
        let seconds = last.since_secs(first);
        if seconds > 0.0 {
            (self.poses - 1) as f64 / seconds
        } else {
            0.0
        }
    }

    /// The age at arrival that `share` (0 to 1) of the last poses did not exceed, ns.
    #[must_use]
    pub fn age_ns(&self, share: f64) -> i64 {
        let mut ages = self.ages.clone();
        if ages.is_empty() {
            return 0;
        }
        let rank = (share.clamp(0.0, 1.0) * (ages.len() - 1) as f64).round() as usize;
        *ages.select_nth_unstable(rank).1
    }

    /// Counts a pose.
    pub(crate) fn take(&mut self, followed: &Followed) {
        let at = followed.pose.publish_at;
        let slot = (self.poses % AGES_MAX as u64) as usize;
        match self.ages.get_mut(slot) {
            Some(age) => *age = followed.age_ns,
            None => self.ages.push(followed.age_ns),
        }
        self.poses += 1;
        self.gaps += followed.gap;
        self.span = Some((self.span.map_or(at, |(first, _)| first), at));
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |share| self.age_ns(share) as f64 / MILLISECOND_NS as f64;
        write!(
            f,
            "{} poses at {:.1} Hz, {} missed, age p50 {:.2} ms, p99 {:.2} ms, max {:.2} ms",
            self.poses,
            self.rate_hz(),
            self.gaps,
            ms(0.5),
            ms(0.99),
            ms(1.0),
        )
    }
}

/// A line of JSON.
#[derive(Serialize)]
struct Line<'a> {
    sequence: u64,
    gap: u64,
    age_ns: i64,
    sample_age_ns: i64,
    #[serde(flatten)]
    pose: &'a crate::published::PublishedPose,
}

/// Prints poses and keeps count.
pub struct Printer<'a> {
    format: Format,
    out: &'a mut dyn Write,
    summary: Summary,
    /// Time, received and missed poses of the last line for people.
    last_line: Option<(HostTime, u64, u64)>,
}

impl<'a> Printer<'a> {
    /// Prints to `out`.
    pub fn new(format: Format, out: &'a mut dyn Write) -> Self {
        Self {
            format,
            out,
            summary: Summary::default(),
            last_line: None,
        }
    }

    /// What was printed so far.
    #[must_use]
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// Takes a pose.
    ///
    /// # Errors
    /// The output cannot be written.
    pub fn print(&mut self, followed: &Followed) -> io::Result<()> {
        self.summary.take(followed);
        match self.format {
            Format::Json => {
                let line = Line {
                    sequence: followed.pose.sequence,
                    gap: followed.gap,
                    age_ns: followed.age_ns,
                    sample_age_ns: followed.sample_age_ns,
                    pose: &followed.pose,
                };
                serde_json::to_writer(&mut self.out, &line)?;
                writeln!(self.out)
            }
            Format::Text => self.print_text(followed),
        }
    }

    /// Writes what is left, and says what was followed.
    ///
    /// # Errors
    /// The output cannot be written.
    pub fn finish(&mut self) -> io::Result<Summary> {
        self.out.flush()?;
        Ok(self.summary.clone())
    }

    fn print_text(&mut self, followed: &Followed) -> io::Result<()> {
        let (pose, now) = (&followed.pose, followed.pose.publish_at);
        let Summary { poses, gaps, .. } = self.summary;
        let (rate, missed) = match self.last_line {
            None => (None, 0),
            // A pose from before the last line: a replay was wound back.
            Some((last, ..)) if now < last => (None, 0),
            Some((last, _, _)) if now.since_ns(last) < LINE_INTERVAL_NS => return Ok(()),
            Some((last, then, missed)) => {
                let seconds = now.since_ns(last) as f64 / SECOND_NS as f64;
                (Some((poses - then) as f64 / seconds), gaps - missed)
            }
        };
        self.last_line = Some((now, poses, gaps));
        let ms = |ns: i64| format!("{:6.2}", ns as f64 / MILLISECOND_NS as f64);
        let rate = rate.map_or("    -".into(), |rate| format!("{rate:5.1}"));
        // Without a headset there is no motion that could be old.
        let motion = match pose.has_input() {
            true => ms(followed.sample_age_ns),
            false => "     -".into(),
        };
        write!(
            self.out,
            "#{:<7} {:8} {:8} {rate} Hz  age {} ms  motion {motion} ms  missed {missed:<4}",
            pose.sequence,
            pose.quality.name(),
            pose.kind.name(),
            ms(followed.age_ns),
        )?;
        for (name, joint) in [
            ("head", Joint::Head),
            ("left hand", Joint::LeftWrist),
            ("right hand", Joint::RightWrist),
            ("pelvis", Joint::Pelvis),
        ] {
            let position = pose.joints.position(joint);
            write!(
                self.out,
                "  {name} {:5.2} {:5.2} {:5.2}",
                position.x, position.y, position.z
            )?;
        }
        if let Some(counts) = pose.recoveries {
            write!(
                self.out,
                "  falls {} drifts {} faults {}",
                counts.falls, counts.drifts, counts.faults
            )?;
        }
        writeln!(self.out)?;
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::published::tests::pose_at;

    fn followed(sequence: u64, gap: u64) -> Followed {
        let pose = pose_at(sequence, HostTime(sequence * 10 * MILLISECOND_NS));
        Followed {
            pose,
            gap,
            age_ns: sequence as i64,
            sample_age_ns: 4_500_000,
        }
    }

    #[test]
    fn json_holds_the_pose_and_how_it_came() {
        let mut out = Vec::new();
        let mut printer = Printer::new(Format::Json, &mut out);
        printer.print(&followed(3, 2)).unwrap();
        printer.print(&followed(4, 0)).unwrap();
        let lines: Vec<serde_json::Value> = String::from_utf8(out)
            .unwrap()
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert_eq!(lines.len(), 2);
        assert_eq!(
            (&lines[0]["sequence"], &lines[0]["gap"]),
            (&3.into(), &2.into())
        );
        assert_eq!(
            (&lines[1]["age_ns"], &lines[1]["tracker"]),
            (&4.into(), &"ik".into())
        );
        assert_eq!(lines[0]["joints"].as_array().map(Vec::len), Some(22));
    }

    #[test]
    fn people_get_four_lines_a_second_with_rate_and_age() {
        let mut out = Vec::new();
        let mut printer = Printer::new(Format::Text, &mut out);
        for sequence in 1..=101 {
            printer
                .print(&followed(sequence, u64::from(sequence == 50)))
                .unwrap();
        }
        let summary = printer.finish().unwrap();
        let text = String::from_utf8(out).unwrap();
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines.len(), 5);
        assert!(
            lines[1].contains("100.0 Hz") && lines[1].contains("missed 0"),
            "{}",
            lines[1]
        );
        assert!(
            lines[2].contains("missed 1") && lines[2].contains("full"),
            "{}",
            lines[2]
        );
        assert!(lines[2].contains("motion   4.50 ms"), "{}", lines[2]);
        assert_eq!((summary.poses, summary.gaps), (101, 1));
        assert!((summary.rate_hz() - 100.0).abs() < 1e-9);
        assert_eq!((summary.age_ns(0.5), summary.age_ns(1.0)), (51, 101));
    }

    #[test]
    fn a_held_pose_has_no_motion_to_be_old() {
        let mut out = Vec::new();
        let mut held = followed(1, 0);
        held.pose.quality = posed_tracker::Quality::Held;
        Printer::new(Format::Text, &mut out).print(&held).unwrap();
        let text = String::from_utf8(out).unwrap();
        assert!(
            text.contains("held") && text.contains("motion      - ms"),
            "{text}"
        );
    }

    #[test]
    fn ages_are_those_of_the_last_poses() {
        let mut summary = Summary::default();
        assert_eq!((summary.age_ns(0.5), summary.rate_hz()), (0, 0.0));
        for sequence in 1..=AGES_MAX as u64 + 10 {
            summary.take(&followed(sequence, 0));
        }
        assert_eq!((summary.ages.len(), summary.age_ns(0.0)), (AGES_MAX, 11));
    }
}
