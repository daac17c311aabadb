//! `posed eval`: trackers against recorded motion.

mod dump;
mod plot;

use std::{
    fs::File,
    io::BufReader,
    path::Path,
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use indicatif::{ProgressBar, ProgressStyle};
use posed_body::motion::MotionSet;
use posed_tracker::{
    Ik, Physical, Tracker, TrackerKind,
    eval::{ClipResult, Options, Report, Row, evaluate},
    metrics::Metric,
};
use serde_json::json;

use super::CommandError;
use crate::{cli::EvalArgs, models::Models};

/// One clip of one set.
#[derive(Debug, Clone, Copy)]
struct Job {
    set: usize,
    clip: usize,
}

/// Evaluates and prints.
///
/// # Errors
/// A set cannot be read, nothing is in the split, or an output cannot be written.
pub fn run(args: &EvalArgs) -> Result<(), CommandError> {
    let sets = args
        .data
        .iter()
        .map(|path| read(path))
        .collect::<Result<Vec<_>, _>>()?;
    let jobs = jobs(&sets, args)?;
    let options = Options {
        sensors: args.sensors,
        straps: args.straps,
        bones: args.bones,
        rate_hz: args.rate,
        lookahead: args.lookahead,
        dump: args.dump.is_some() || args.plot.is_some(),
    };
    let results = evaluate_all(&sets, &jobs, &options, args)?;
    let report = Report::of(&results);
    if let Some(path) = &args.json {
        let value = json!({
            "data": args.data,
            "split": args.split,
            "tracker": args.tracker.name(),
            "sensors": args.sensors.name(),
            "straps": args.straps.name(),
            "bones": args.bones.name(),
            "physics": args.physics,
            "lookahead": args.lookahead,
            "rate_hz": args.rate,
            "report": report,
        });
        let text = serde_json::to_string_pretty(&value).map_err(std::io::Error::from)?;
        std::fs::write(path, text).map_err(|error| CommandError::file(path, error))?;
    }
    if let Some(path) = &args.dump {
        dump::write(path, &results).map_err(|error| CommandError::file(path, error))?;
    }
    if let Some(path) = &args.plot {
        let page = plot::page(&results, args.tracker.name());
        std::fs::write(path, page).map_err(|error| CommandError::file(path, error))?;
    }
    print!("{}", text(&report));
    Ok(())
}

/// Where trackers come from.
struct Source {
    kind: TrackerKind,
    models: Option<Models>,
}

impl Source {
    fn new(kind: TrackerKind) -> Result<Self, CommandError> {
        let models = match kind {
            TrackerKind::Ik => None,
            _ => Some(Models::load().map_err(|error| CommandError::Input(error.to_string()))?),
        };
        Ok(Self { kind, models })
    }

    /// A fresh tracker.
    fn tracker(&self) -> Result<Box<dyn Tracker>, CommandError> {
        let Some(models) = &self.models else {
            return Ok(Box::new(Ik::default()));
        };
        let found = models
            .tracker(self.kind)
            .map_err(|error| CommandError::Input(error.to_string()))?;
        found.ok_or_else(|| {
            let name = self.kind.name();
            CommandError::Input(format!("this build has no model for the tracker {name}"))
        })
    }
}

fn read(path: &Path) -> Result<MotionSet, CommandError> {
    let file = File::open(path).map_err(|error| CommandError::file(path, error))?;
    MotionSet::read(BufReader::new(file))
        .map_err(|error| CommandError::Input(format!("{}: {error}", path.display())))
}

fn jobs(sets: &[MotionSet], args: &EvalArgs) -> Result<Vec<Job>, CommandError> {
    let mut jobs = Vec::new();
    for (set, motion) in sets.iter().enumerate() {
        let wanted = motion.entries().iter().enumerate().filter(|(_, entry)| {
            entry.split == args.split && args.clip.as_ref().is_none_or(|name| *name == entry.name)
        });
        jobs.extend(wanted.map(|(clip, _)| Job { set, clip }));
    }
    if jobs.is_empty() {
        let names: Vec<_> = args
            .data
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        let problem = format!(
            "no clip of the split `{}` in {}",
            args.split,
            names.join(", ")
        );
        return Err(CommandError::Input(problem));
    }
    Ok(jobs)
}

/// Clips in parallel. Each starts with a fresh tracker, and results are put back in the order of
/// the clips: the number of threads changes nothing but the time.
fn evaluate_all(
    sets: &[MotionSet],
    jobs: &[Job],
    options: &Options,
    args: &EvalArgs,
) -> Result<Vec<ClipResult>, CommandError> {
    let source = Source::new(args.tracker)?;
    source.tracker()?;
    let cores = thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = args.threads.unwrap_or(cores).clamp(1, jobs.len());
    let progress = ProgressBar::new(jobs.len() as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} clips, {eta} left") {
        progress.set_style(style);
    }
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<Option<Result<ClipResult, CommandError>>>> =
        Mutex::new(jobs.iter().map(|_| None).collect());
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(index) = claim(&next, jobs.len()) {
                    let result = one(sets, jobs[index], options, &source, args);
                    progress.inc(1);
                    if let Ok(mut done) = done.lock() {
                        done[index] = Some(result);
                    }
                }
            });
        }
    });
    progress.finish_and_clear();
    let done = done.into_inner().unwrap_or_default();
    let lost = || CommandError::Input("an evaluation thread failed; this is a bug".into());
    done.into_iter()
        .map(|result| result.unwrap_or_else(|| Err(lost())))
        .collect()
}

fn claim(next: &AtomicUsize, end: usize) -> Option<usize> {
    let index = next.fetch_add(1, Ordering::Relaxed);
    (index < end).then_some(index)
}

fn one(
    sets: &[MotionSet],
    job: Job,
    options: &Options,
    source: &Source,
    args: &EvalArgs,
) -> Result<ClipResult, CommandError> {
    let clip = sets[job.set].clip(job.clip).map_err(|error| {
        let name = &sets[job.set].entries()[job.clip].name;
        CommandError::Input(format!("clip {name}: {error}"))
    })?;
    let mut tracker = source.tracker()?;
    if args.physics {
        tracker = Box::new(Physical::new(
            tracker,
            &options.bones.wearer(&clip),
            args.rate,
        ));
    }
    Ok(evaluate(&clip, &mut *tracker, options))
}

/// A table: the classes, then everything.
fn text(report: &Report) -> String {
    let mut text = format!("{:<28} {:>5} {:>7}", "motion", "clips", "s");
    for &metric in Metric::ALL {
        text += &format!(
            " {:>width$}",
            metric.name(),
            width = metric.name().len().max(7)
        );
    }
    text.push('\n');
    for row in report.classes.iter().chain([&report.all]) {
        line(row, &mut text);
    }
    text
}

fn line(row: &Row, text: &mut String) {
    *text += &format!("{:<28.28} {:>5} {:>7.1}", row.name, row.clips, row.seconds);
    for &metric in Metric::ALL {
        let width = metric.name().len().max(7);
        match row.scores.get(metric) {
            Some(value) => *text += &format!(" {value:>width$.3}"),
            None => *text += &format!(" {:>width$}", "-"),
        }
    }
    text.push('\n');
}
