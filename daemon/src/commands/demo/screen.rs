//! What the demo shows: on a terminal a picture that renews itself, elsewhere a line a second.

use std::{
    fmt::Write as _,
    io::Write as _,
    path::Path,
    time::{Duration, Instant},
};

use posed_signal::time::MILLISECOND_NS;
use tokio::{runtime::Runtime, sync::watch, task::JoinHandle};

use super::figure;
use crate::{
    clock::Monotonic,
    follow::{FollowError, Followed, Follower, Late, Server, Summary},
    published::{DeviceState, PublishedPose},
};

/// A terminal is redrawn this often.
const REDRAW: Duration = Duration::from_millis(100);
/// Without a terminal, a line is printed this often.
const LINE: Duration = Duration::from_secs(1);

/// A client that follows the demo's own server and shows what it gets.
pub(super) struct Screen {
    task: JoinHandle<Result<Summary, FollowError>>,
}

impl Screen {
    /// Follows the server on `socket`.
    pub(super) fn follow(
        runtime: &Runtime,
        socket: &Path,
        devices: watch::Receiver<Vec<DeviceState>>,
        terminal: bool,
    ) -> Self {
        let server = Server::Unix(socket.to_path_buf());
        let task = runtime.spawn(async move {
            let mut follower = Follower::connect(&server, Monotonic, Late::CatchUp).await?;
            let mut view = View {
                terminal,
                drawn: None,
                lines: 0,
            };
            let mut summary = Summary::default();
            loop {
                match follower.next().await {
                    Ok(Some(followed)) => {
                        summary.take(&followed);
                        view.show(&followed, &summary, &devices.borrow());
                    }
                    // The server says good-bye at the demo's end.
                    Ok(None) => break,
                    Err(FollowError::Status(_)) if summary.poses > 0 => break,
                    Err(error) => return Err(error),
                }
            }
            Ok(summary)
        });
        Self { task }
    }

    /// The last words, once the server has stopped.
    pub(super) async fn finish(self) -> String {
        match self.task.await {
            Ok(Ok(summary)) => format!("followed over gRPC: {summary}\n"),
            Ok(Err(error)) => format!("following over gRPC failed: {error}\n"),
            Err(error) => format!("following over gRPC failed: {error}\n"),
        }
    }
}

struct View {
    terminal: bool,
    drawn: Option<Instant>,
    lines: usize,
}

impl View {
    fn show(&mut self, followed: &Followed, summary: &Summary, devices: &[DeviceState]) {
        let every = if self.terminal { REDRAW } else { LINE };
        if self.drawn.is_some_and(|drawn| drawn.elapsed() < every) {
            return;
        }
        self.drawn = Some(Instant::now());
        let text = if self.terminal {
            picture(followed, summary, devices)
        } else {
            line(followed, summary)
        };
        let mut output = std::io::stdout().lock();
        let up = std::mem::replace(
            &mut self.lines,
            if self.terminal {
                text.lines().count()
            } else {
                0
            },
        );
        if up > 0 {
            let _ = write!(output, "\x1b[{up}A");
        }
        for row in text.lines() {
            // Clears what the last picture had to the right.
            let clear = if self.terminal { "\x1b[K" } else { "" };
            let _ = writeln!(output, "{row}{clear}");
        }
        let _ = output.flush();
    }
}

fn line(followed: &Followed, summary: &Summary) -> String {
    let pose = &followed.pose;
    format!(
        "{} {} | {} | {summary}\n",
        pose.kind.name(),
        pose.quality.name(),
        posture(pose)
    )
}

fn picture(followed: &Followed, summary: &Summary, devices: &[DeviceState]) -> String {
    let mut text = String::new();
    for row in figure::draw(&followed.pose.joints) {
        let _ = writeln!(text, "{row}");
    }
    let _ = writeln!(
        text,
        "{} {}, {}",
        followed.pose.kind.name(),
        followed.pose.quality.name(),
        posture(&followed.pose)
    );
    for device in devices {
        let residual = device.pose.map_or(0.0, |pose| pose.residual_rad * 1e6);
        let _ = writeln!(
            text,
            "{:<12} {:<16} {:<10} {:>6.0} samples/s  tracked {:>3.0} %  residual {residual:>4.0} urad",
            device.serial,
            device.model,
            device.role,
            device.rate_hz,
            100.0 * device.tracked_share,
        );
    }
    let sample_ms = followed.sample_age_ns as f64 / MILLISECOND_NS as f64;
    let _ = writeln!(text, "report to client {sample_ms:.2} ms; {summary}");
    text
}

/// The body in a few words.
fn posture(pose: &PublishedPose) -> String {
    use posed_body::Joint::{Head, LeftAnkle, Pelvis, RightAnkle};
    let height = |joint| pose.joints.position(joint).y;
    let (head, pelvis) = (height(Head), height(Pelvis));
    let apart = (pose.joints.position(LeftAnkle) - pose.joints.position(RightAnkle)).length();
    format!("head {head:.2} m, pelvis {pelvis:.2} m, feet {apart:.2} m apart")
}
