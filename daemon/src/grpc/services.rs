//! What the services are given.

use std::{fmt, sync::Arc};

use posed_signal::Clock;
use posed_tracker::Wearer;
use tokio::sync::watch;

use super::hub::Hub;
use crate::{control::Control, output::record::Recorder, published::DeviceState};

/// What the services hand out.
#[derive(Clone)]
pub struct Services {
    /// Poses.
    pub hub: Hub,
    /// The devices, in the order of their ids.
    pub devices: watch::Receiver<Vec<DeviceState>>,
    /// The wearer.
    pub wearer: watch::Receiver<Wearer>,
    /// The clock that the poses' times are told by.
    pub clock: Arc<dyn Clock + Send + Sync>,
    /// The way of requests to the tracker.
    pub control: Arc<Control>,
    /// Writes poses to files.
    pub recorder: Recorder,
}

impl fmt::Debug for Services {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Services")
            .field("hub", &self.hub)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::path::Path;

    use posed_signal::{HostTime, ring::Consumer};

    use super::*;
    use crate::{
        control::tests::control,
        pipeline::{source::Buzz, tracking::Request},
    };

    /// The other ends of what services are given.
    pub(crate) struct Ends {
        pub(crate) devices: watch::Sender<Vec<DeviceState>>,
        pub(crate) requests: Consumer<Request>,
        pub(crate) buzzes: Consumer<Buzz>,
    }

    /// Services for the poses of `hub`, with a wearer of 1.8 m and a clock that stands at
    /// 123,456 ns. They record into `folder`.
    pub(crate) fn services(hub: &Hub, folder: Option<&Path>) -> (Services, Ends) {
        let (devices, devices_seen) = watch::channel(Vec::new());
        let (wearer, wearer_seen) = watch::channel(Wearer::of_height(1.8));
        let (control, requests, buzzes) = control(wearer);
        let services = Services {
            hub: hub.clone(),
            devices: devices_seen,
            wearer: wearer_seen,
            clock: Arc::new(HostTime(123_456)),
            control: Arc::new(control),
            recorder: Recorder::new(hub.clone(), folder.map(Into::into), 90.0),
        };
        let ends = Ends {
            devices,
            requests,
            buzzes,
        };
        (services, ends)
    }
}
