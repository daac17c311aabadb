//! `posed eval`: trackers against recorded motion.

mod dump;
mod plot;
mod source;
mod usb;

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
use posed_body::motion::{Clip, MotionSet};
use posed_tracker::{
    eval::{ClipResult, Options, Report, Row, Trend, continuous, evaluate},
    metrics::{Metric, Scores},
};
use serde_json::json;

use super::CommandError;
use crate::cli::EvalArgs;
use source::Source;

/// Minutes at both ends of a long input that are compared.
const TREND_MINUTES: usize = 2;

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
        kinds: args.kinds,
        dump: args.dump.is_some() || args.plot.is_some(),
    };
    let source = Source::new(args)?;
    if let Some(minutes) = args.continuous {
        return through(&sets, &jobs, &options, &source, args, minutes);
    }
    if args.usb {
        return whole_way(&sets, &jobs, &options, &source, args);
    }
    let results = in_parallel(jobs.len(), args.threads, |index| {
        let clip = read_clip(&sets, jobs[index], args)?;
        let mut tracker = source.tracker(&options, &clip, args)?;
        Ok(evaluate(&clip, &mut *tracker, &options))
    })?;
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
            "stature_m": args.stature,
            "kinds": args.kinds.name(),
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

/// Joins clips into one long input and prints the error minute by minute.
fn through(
    sets: &[MotionSet],
    jobs: &[Job],
    options: &Options,
    source: &Source,
    args: &EvalArgs,
    minutes: f64,
) -> Result<(), CommandError> {
    let first = read_clip(sets, jobs[0], args)?;
    let mut trackers = [
        source.tracker(options, &first, args)?,
        source.tracker(options, &first, args)?,
    ];
    let [through, fresh] = &mut trackers;
    // Round and round, until the time is over.
    let clips = jobs
        .iter()
        .cycle()
        .map_while(|&job| read_clip(sets, job, args).ok());
    let stretches = continuous(
        clips,
        [&mut **through, &mut **fresh],
        options,
        60.0 * minutes,
    );
    println!("minute clips  left right  joined cm  fresh cm  unsound");
    for (minute, stretch) in stretches.iter().enumerate() {
        println!(
            "{minute:>6} {:>5} {:>4.0} % {:>3.0} % {:>10.3} {:>9.3} {:>8}",
            stretch.clips,
            100.0 * stretch.hands_seen[0],
            100.0 * stretch.hands_seen[1],
            stretch.through_cm,
            stretch.fresh_cm,
            stretch.unsound,
        );
    }
    let trend = Trend::of(&stretches, TREND_MINUTES);
    let (first, last) = (trend.first_cm, trend.last_cm);
    println!(
        "first {TREND_MINUTES} minutes {:.3} joined, {:.3} fresh; last {:.3}, {:.3}; joined less \
         fresh grows by {:.4} cm a minute",
        first[0], first[1], last[0], last[1], trend.slope_cm_per_min,
    );
    Ok(())
}

/// Ideal sensors and USB traffic side by side.
fn whole_way(
    sets: &[MotionSet],
    jobs: &[Job],
    options: &Options,
    source: &Source,
    args: &EvalArgs,
) -> Result<(), CommandError> {
    let results = in_parallel(jobs.len(), args.threads, |index| {
        let clip = read_clip(sets, jobs[index], args)?.centred();
        if !usb::fits(&clip) {
            return Ok(None);
        }
        let trackers = [
            source.tracker(options, &clip, args)?,
            source.tracker(options, &clip, args)?,
        ];
        let both = usb::both(&clip, trackers, options)
            .map_err(|error| CommandError::Input(format!("clip {}: {error}", clip.name)))?;
        Ok(Some(both))
    })?;
    let found: Vec<_> = results.iter().flatten().collect();
    let mean =
        |of: fn(&usb::Both) -> &ClipResult| Scores::mean(found.iter().map(|both| &of(both).scores));
    let (ideal, usb) = (mean(|both| &both.ideal), mean(|both| &both.usb));
    let left_out = results.len() - found.len();
    print!("{}", usb::text(&ideal, &usb, found.len(), left_out));
    Ok(())
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
        let every = args.every as usize;
        jobs.extend(wanted.step_by(every).map(|(clip, _)| Job { set, clip }));
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

fn read_clip(sets: &[MotionSet], job: Job, args: &EvalArgs) -> Result<Clip, CommandError> {
    let clip = sets[job.set].clip(job.clip).map_err(|error| {
        let name = &sets[job.set].entries()[job.clip].name;
        CommandError::Input(format!("clip {name}: {error}"))
    })?;
    Ok(match args.stature {
        Some(stature) => clip.of_stature(stature),
        None => clip,
    })
}

/// Does `count` jobs on some threads. Results are put back in the order of the jobs: the number of
/// threads changes nothing but the time.
fn in_parallel<T: Send>(
    count: usize,
    threads: Option<usize>,
    one: impl Fn(usize) -> Result<T, CommandError> + Sync,
) -> Result<Vec<T>, CommandError> {
    let cores = thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = threads.unwrap_or(cores).clamp(1, count);
    let progress = ProgressBar::new(count as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} clips, {eta} left") {
        progress.set_style(style);
    }
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<Option<Result<T, CommandError>>>> =
        Mutex::new((0..count).map(|_| None).collect());
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(index) = claim(&next, count) {
                    let result = one(index);
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
    text += &format!(
        " {:>9} {:>8} {:>8} {:>7}",
        "falls/min", "unbroken", "held_10s", "own"
    );
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
    *text += &format!(
        " {:>9.2} {:>8.2} {:>8.2} {:>7.2}",
        row.falls_per_minute, row.unbroken, row.held_10s, row.own
    );
    text.push('\n');
}
