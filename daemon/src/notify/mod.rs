//! What systemd is told: that posed is ready, what it does, that it still works (sd_notify(3)).
//! Without systemd all of this does nothing.

use std::time::Duration;

use posed_signal::HostTime;
use sd_notify::NotifyState;

/// The way to systemd.
#[derive(Debug)]
pub struct Notifier {
    watchdog: Option<Watchdog>,
}

impl Notifier {
    /// Reads from the environment whether the unit asks for a watchdog.
    #[must_use]
    pub fn from_env() -> Self {
        Self {
            watchdog: sd_notify::watchdog_enabled().and_then(Watchdog::new),
        }
    }

    /// Models are loaded and the first tick is done: whoever waits for posed may go on.
    pub fn ready(&self, status: &str) {
        send(&[NotifyState::Ready, NotifyState::Status(&one_line(status))]);
    }

    /// One line about what posed does now; `systemctl --user status posed` shows it.
    pub fn status(&self, status: &str) {
        send(&[NotifyState::Status(&one_line(status))]);
    }

    /// Feeds the watchdog where that is due and `ticks`, the tracker thread's counter, has moved
    /// on. To be called several times within the limit that the unit sets. When the tracker
    /// stands still systemd hears nothing more, and restarts posed.
    pub fn ticks(&mut self, ticks: u64, now: HostTime) {
        if self
            .watchdog
            .as_mut()
            .is_some_and(|watchdog| watchdog.is_due(ticks, now))
        {
            send(&[NotifyState::Watchdog]);
        }
    }

    /// posed is on its way out.
    pub fn stopping(&self) {
        send(&[NotifyState::Stopping]);
    }
}

/// A line break would begin another message.
fn one_line(text: &str) -> String {
    text.replace(['\n', '\r'], " ")
}

fn send(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        tracing::warn!(%error, "systemd cannot be told how posed is");
    }
}

/// When to feed the watchdog.
#[derive(Debug)]
struct Watchdog {
    interval_ns: i64,
    /// The last feeding, and the counter then.
    fed: Option<(HostTime, u64)>,
}

impl Watchdog {
    /// Half the limit is what sd_watchdog_enabled(3) recommends; a third forgives a late look.
    fn new(limit: Duration) -> Option<Self> {
        let interval_ns = i64::try_from((limit / 3).as_nanos())
            .ok()
            .filter(|ns| *ns > 0)?;
        Some(Self {
            interval_ns,
            fed: None,
        })
    }

    fn is_due(&mut self, ticks: u64, now: HostTime) -> bool {
        let due = self
            .fed
            .is_none_or(|(at, then)| now.since_ns(at) >= self.interval_ns && ticks != then);
        if due {
            self.fed = Some((now, ticks));
        }
        due
    }
}

#[cfg(test)]
mod unit_files;

#[cfg(test)]
mod tests {
    use std::{
        env,
        os::unix::net::UnixDatagram,
        process::{Command, Stdio},
    };

    use super::*;

    #[test]
    fn the_watchdog_is_fed_while_the_counter_moves_and_no_longer() {
        let ms = |ms: u64| HostTime(ms * 1_000_000);
        let mut watchdog = Watchdog::new(Duration::from_millis(3_000)).unwrap();
        assert!(watchdog.is_due(1, ms(10_000)), "at once");
        let fed = (1..=100).filter(|look| watchdog.is_due(1 + look, ms(10_000 + 100 * look)));
        assert_eq!(fed.count(), 10, "once a third of the limit");
        assert!(!(1..=100).any(|look| watchdog.is_due(101, ms(20_000 + 100 * look))));
        assert!(watchdog.is_due(102, ms(31_000)), "it works again");
        assert!(Watchdog::new(Duration::ZERO).is_none());
    }

    /// The environment is the process's: a child sends the messages, with a socket of this test
    /// as systemd's.
    #[test]
    fn systemd_is_told_of_readiness_status_ticks_and_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let systemd = UnixDatagram::bind(&path).unwrap();
        systemd
            .set_read_timeout(Some(Duration::from_secs(30)))
            .unwrap();
        let mut child = Command::new(env::current_exe().unwrap())
            .args([
                "--exact",
                "--ignored",
                "notify::tests::child_says_everything",
            ])
            .env("NOTIFY_SOCKET", &path)
            .env("WATCHDOG_USEC", "3000000")
            .env_remove("WATCHDOG_PID")
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        for expected in [
            "READY=1\nSTATUS=tracking READY=0\n",
            "WATCHDOG=1\n",
            "STATUS=two devices\n",
            "WATCHDOG=1\n",
            "STOPPING=1\n",
        ] {
            let mut bytes = [0; 256];
            let length = systemd.recv(&mut bytes).unwrap();
            assert_eq!(std::str::from_utf8(&bytes[..length]), Ok(expected));
        }
        assert!(child.wait().unwrap().success());
    }

    #[test]
    #[ignore = "runs in a child process, whose systemd is a test"]
    fn child_says_everything() {
        let mut notifier = Notifier::from_env();
        assert!(notifier.watchdog.is_some());
        notifier.ready("tracking\nREADY=0");
        notifier.ticks(1, HostTime(0));
        notifier.status("two devices");
        notifier.ticks(1, HostTime(2_000_000_000));
        notifier.ticks(2, HostTime(2_000_000_001));
        notifier.stopping();
    }
}
