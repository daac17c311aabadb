//! What the services are given.

use std::{fmt, sync::Arc};

use posed_signal::Clock;
use posed_tracker::Wearer;
use tokio::sync::watch;

use super::hub::Hub;
use crate::published::DeviceState;

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
}

impl fmt::Debug for Services {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Services")
            .field("hub", &self.hub)
            .finish_non_exhaustive()
    }
}
