//! Results of many clips joined.

use std::collections::BTreeMap;

use serde::{Serialize, Serializer, ser::SerializeMap};

use super::ClipResult;
use crate::metrics::{Metric, Scores};

/// A simulated body that was not put back for so long has held, seconds.
const HELD_S: f64 = 10.0;

/// Means over some clips.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The clip, the kind of motion, or `all`.
    pub name: String,
    /// How many clips.
    pub clips: usize,
    /// How long they are together.
    pub seconds: f64,
    /// Share of frames in which the left and right hand were shown, mean over clips.
    pub hands_seen: [f64; 2],
    /// Share of frames that the tracker made itself, over all frames.
    pub own: f64,
    /// How often a minute a simulated body had to be put back on its feet.
    pub falls_per_minute: f64,
    /// Share of clips in which it never had to be.
    pub unbroken: f64,
    /// Share of clips in whose first ten seconds it never had to be.
    pub held_10s: f64,
    /// The metrics, mean over clips.
    pub scores: Scores,
}

/// All clips, kinds of motion, and everything together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Over all clips.
    pub all: Row,
    /// By kind of motion, in the order of names.
    pub classes: Vec<Row>,
    /// Clip by clip, in the order given.
    pub clips: Vec<Row>,
}

impl Report {
    /// Joins results. Their order decides the order of sums: keep the clips' own, whatever order
    /// they finished in.
    #[must_use]
    pub fn of(results: &[ClipResult]) -> Self {
        let mut classes: BTreeMap<&str, Vec<&ClipResult>> = BTreeMap::new();
        for result in results {
            classes.entry(&result.class).or_default().push(result);
        }
        let everything: Vec<&ClipResult> = results.iter().collect();
        Self {
            all: row("all", &everything),
            classes: classes
                .iter()
                .map(|(name, clips)| row(name, clips))
                .collect(),
            clips: results
                .iter()
                .map(|result| row(&result.name, &[result]))
                .collect(),
        }
    }
}

fn row(name: &str, results: &[&ClipResult]) -> Row {
    let count = results.len().max(1) as f64;
    let seen = |hand: usize| {
        results
            .iter()
            .map(|clip| clip.hands_seen[hand])
            .sum::<f64>()
            / count
    };
    let seconds: f64 = results.iter().map(|clip| clip.seconds).sum();
    let own: f64 = results.iter().map(|clip| clip.own * clip.seconds).sum();
    let falls: u64 = results.iter().map(|clip| clip.recoveries).sum();
    let held = |clip: &&&ClipResult| clip.recoveries == 0 || clip.held_s >= HELD_S;
    let unbroken = results.iter().filter(|clip| clip.recoveries == 0).count();
    Row {
        name: name.to_owned(),
        clips: results.len(),
        seconds,
        own: own / seconds.max(1e-9),
        falls_per_minute: falls as f64 * 60.0 / seconds.max(1e-9),
        unbroken: unbroken as f64 / count,
        held_10s: results.iter().filter(held).count() as f64 / count,
        hands_seen: [seen(0), seen(1)],
        scores: Scores::mean(results.iter().map(|clip| &clip.scores)),
    }
}

impl Serialize for Scores {
    /// A map from metric names to numbers or null.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(Metric::COUNT + 1))?;
        for &metric in Metric::ALL {
            map.serialize_entry(metric.name(), &self.get(metric))?;
        }
        map.serialize_entry("translation_cm", &self.translation_cm)?;
        map.end()
    }
}
