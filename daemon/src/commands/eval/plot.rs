//! A page that shows where a tracker is wrong: the worst, the median and the best clip, each with
//! its error over time, its foot contacts beside the true ones, and a strip of skeletons.

use std::fmt::Write as _;

use glam::Vec3;
use posed_body::{JOINTS, Joint, skeleton::PARENTS};
use posed_tracker::{
    eval::{ClipResult, Dump, error_curve},
    metrics::{Metric, Track},
};

/// Width of every picture, pixels.
const WIDTH: f64 = 1100.0;
/// Skeletons in a strip.
const STRIP: usize = 11;
/// Points of a curve; longer clips are thinned out.
const POINTS: usize = 1_000;
/// A foot slower and lower than this stands, m/s and metres over its lowest tenth.
const STANDS: (f32, f32) = (0.3, 0.04);

const STYLE: &str = "body{font:14px system-ui,sans-serif;margin:2em;max-width:1150px;\
    color:#222;background:#fff}svg{display:block;margin:.4em 0 1em}\
    .p{stroke:#d5542b;fill:none}.t{stroke:#7a8a99;fill:none}.g{stroke:#ddd}\
    .pb{fill:#d5542b}.tb{fill:#7a8a99}text{fill:#555;font-size:11px}\
    @media(prefers-color-scheme:dark){body{color:#ddd;background:#15181b}.g{stroke:#333}\
    text{fill:#aaa}}";

/// The page, HTML with its pictures inside.
pub(super) fn page(results: &[ClipResult], tracker: &str) -> String {
    let mut order: Vec<_> = results
        .iter()
        .filter(|result| result.dump.is_some())
        .collect();
    let error = |result: &ClipResult| result.scores.get(Metric::MpjpeHead).unwrap_or(0.0);
    order.sort_by(|a, b| error(b).total_cmp(&error(a)));
    let mut page = format!(
        "<!doctype html><html lang=en><meta charset=utf-8><title>posed eval: {tracker}</title>\
         <style>{STYLE}</style><h1>{tracker}, {} clips</h1>\
         <p>Predicted in orange, true in grey.",
        results.len()
    );
    let picks = [
        ("worst", 0),
        ("median", order.len() / 2),
        ("best", order.len().max(1) - 1),
    ];
    for (which, index) in picks {
        if let Some(result) = order.get(index) {
            clip(&mut page, which, result, error(result));
        }
    }
    page
}

fn clip(page: &mut String, which: &str, result: &ClipResult, error: f64) {
    let Some(dump) = &result.dump else { return };
    let _ = write!(
        page,
        "<h2>{which}: {} ({:.1} s, {error:.2} cm)</h2>",
        escape(&result.name),
        result.seconds
    );
    curve(page, &error_curve(dump), dump.truth.fps);
    feet(page, dump);
    strip(page, dump);
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

/// Head-aligned error over time.
fn curve(page: &mut String, errors: &[f64], fps: f64) {
    const HEIGHT: f64 = 160.0;
    let top = errors.iter().copied().fold(1.0, f64::max);
    let _ = write!(
        page,
        "<svg width={WIDTH} height={HEIGHT} viewBox='0 0 {WIDTH} {HEIGHT}'>"
    );
    for share in [0.25, 0.5, 0.75] {
        let y = HEIGHT * share;
        let _ = write!(page, "<line class=g x1=0 x2={WIDTH} y1={y} y2={y} />");
    }
    let step = errors.len().div_ceil(POINTS).max(1);
    let scale = WIDTH / errors.len().max(1) as f64;
    let point = |(index, error): (usize, &f64)| {
        format!(
            "{:.1},{:.1}",
            index as f64 * scale,
            HEIGHT * (1.0 - error / top)
        )
    };
    let points: Vec<_> = errors.iter().enumerate().step_by(step).map(point).collect();
    let seconds = errors.len() as f64 / fps;
    let _ = write!(
        page,
        "<polyline class=p points='{}' /><text x=4 y=12>head-aligned error, top {top:.1} cm, \
         {seconds:.1} s</text></svg>",
        points.join(" ")
    );
}

/// When each foot stands, predicted above true.
fn feet(page: &mut String, dump: &Dump) {
    const ROW: f64 = 12.0;
    let height = 4.0 * ROW + 6.0;
    let _ = write!(
        page,
        "<svg width={WIDTH} height={height} viewBox='0 0 {WIDTH} {height}'>"
    );
    let mut y = 0.0;
    for (foot, name) in [
        (Joint::LeftFoot, "left foot"),
        (Joint::RightFoot, "right foot"),
    ] {
        for (track, class) in [(&dump.predicted, "pb"), (&dump.truth, "tb")] {
            bars(page, &standing(track, foot), class, y, ROW - 2.0);
            y += ROW;
        }
        let _ = write!(page, "<text x=4 y={:.0}>{name}</text>", y - ROW + 4.0);
        y += 3.0;
    }
    page.push_str("</svg>");
}

fn standing(track: &Track, foot: Joint) -> Vec<bool> {
    let at = |frame: usize| track.positions[frame][foot as usize];
    let mut heights: Vec<f32> = (0..track.len()).map(|frame| at(frame).y).collect();
    heights.sort_by(f32::total_cmp);
    let floor = heights.get(heights.len() / 10).copied().unwrap_or(0.0);
    let stands = |frame: usize| {
        let speed = (at(frame) - at(frame.saturating_sub(1))).length() * track.fps as f32;
        speed < STANDS.0 && at(frame).y < floor + STANDS.1
    };
    (0..track.len()).map(stands).collect()
}

fn bars(page: &mut String, on: &[bool], class: &str, y: f64, height: f64) {
    let scale = WIDTH / on.len().max(1) as f64;
    let mut begin = None;
    for frame in 0..=on.len() {
        let now = on.get(frame).copied().unwrap_or(false);
        match (begin, now) {
            (None, true) => begin = Some(frame),
            (Some(from), false) => {
                let (x, width) = (from as f64 * scale, (frame - from) as f64 * scale);
                let _ = write!(
                    page,
                    "<rect class={class} x={x:.1} y={y} width={width:.1} height={height} />"
                );
                begin = None;
            }
            _ => {}
        }
    }
}

/// Skeletons at even times, seen from where the wearer's chest looked.
fn strip(page: &mut String, dump: &Dump) {
    const HEIGHT: f64 = 220.0;
    let _ = write!(
        page,
        "<svg width={WIDTH} height={HEIGHT} viewBox='0 0 {WIDTH} {HEIGHT}'>"
    );
    let frames = dump.predicted.len().min(dump.truth.len());
    for place in 0..STRIP.min(frames) {
        let frame = place * (frames - 1) / (STRIP - 1).max(1);
        let middle = WIDTH * (place as f64 + 0.5) / STRIP as f64;
        let pelvis = dump.truth.positions[frame][Joint::Pelvis as usize];
        let turn = dump.truth.world[frame][Joint::Pelvis as usize];
        let side = (turn * Vec3::Z).cross(Vec3::Y).normalize_or(Vec3::X);
        for (track, class) in [(&dump.truth, "t"), (&dump.predicted, "p")] {
            skeleton(
                page,
                &track.positions[frame],
                class,
                pelvis,
                side,
                (middle, HEIGHT),
            );
        }
    }
    page.push_str("</svg>");
}

fn skeleton(
    page: &mut String,
    joints: &[Vec3; JOINTS],
    class: &str,
    pelvis: Vec3,
    side: Vec3,
    (middle, bottom): (f64, f64),
) {
    const PIXELS: f64 = 105.0;
    let place = |joint: Vec3| {
        let across = f64::from((joint - pelvis).dot(side));
        (
            middle + across * PIXELS,
            bottom - 6.0 - f64::from(joint.y) * PIXELS,
        )
    };
    let mut path = String::new();
    for (index, parent) in PARENTS.into_iter().enumerate() {
        let Some(parent) = parent else { continue };
        let ((x0, y0), (x1, y1)) = (place(joints[parent]), place(joints[index]));
        let _ = write!(path, "M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}");
    }
    let _ = write!(page, "<path class={class} d='{path}' />");
}
