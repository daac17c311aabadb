//! `DeviceService`: the devices, now and whenever they change, and how to make one buzz.

use std::{pin::Pin, time::Duration};

use futures_util::{Stream, stream};
use posed_device::haptic::HapticError;
use posed_proto::v1::{
    ApplyHapticsRequest, ApplyHapticsResponse, Device, ListDevicesRequest, ListDevicesResponse,
    WatchDevicesRequest, WatchDevicesResponse, device_service_server::DeviceService,
};
use tokio::{sync::watch, time};
use tonic::{Request, Response, Status};

use super::{Services, convert, stopping};
use crate::published::DeviceState;

/// Counters change with every packet; people and games need them no oftener than this.
const INTERVAL: Duration = Duration::from_millis(100);

/// The service.
#[derive(Debug)]
pub(super) struct Devices {
    pub(super) services: Services,
    /// Closes when the server stops.
    pub(super) stop: watch::Receiver<()>,
}

/// One client of `WatchDevices`.
struct Watcher {
    devices: watch::Receiver<Vec<DeviceState>>,
    stop: watch::Receiver<()>,
    is_first: bool,
}

#[tonic::async_trait]
impl DeviceService for Devices {
    type WatchDevicesStream =
        Pin<Box<dyn Stream<Item = Result<WatchDevicesResponse, Status>> + Send>>;

    async fn list_devices(
        &self,
        _: Request<ListDevicesRequest>,
    ) -> Result<Response<ListDevicesResponse>, Status> {
        let devices = messages(&self.services.devices.borrow());
        Ok(Response::new(ListDevicesResponse { devices }))
    }

    async fn watch_devices(
        &self,
        _: Request<WatchDevicesRequest>,
    ) -> Result<Response<Self::WatchDevicesStream>, Status> {
        let watcher = Watcher {
            devices: self.services.devices.clone(),
            stop: self.stop.clone(),
            is_first: true,
        };
        let lists = stream::unfold(watcher, |mut watcher| async {
            let next = watcher.next().await?;
            Some((
                next.map(|devices| WatchDevicesResponse { devices }),
                watcher,
            ))
        });
        Ok(Response::new(Box::pin(lists)))
    }

    async fn apply_haptics(
        &self,
        request: Request<ApplyHapticsRequest>,
    ) -> Result<Response<ApplyHapticsResponse>, Status> {
        let request = request.into_inner();
        let buzz = convert::to_buzz(&request);
        let buzz = buzz.map_err(|error| Status::invalid_argument(error.to_string()))?;
        {
            let devices = self.services.devices.borrow();
            let named = |device: &&DeviceState| u32::from(device.id.0) == request.device;
            let device = devices.iter().find(named).filter(|device| device.connected);
            let gone = || Status::not_found(HapticError::NoDevice(buzz.device).to_string());
            if !device.ok_or_else(gone)?.has_haptics {
                let text = HapticError::NoMotor(buzz.device).to_string();
                return Err(Status::failed_precondition(text));
            }
        }
        let asked = self.services.control.buzz(buzz);
        asked.map_err(|refusal| Status::resource_exhausted(refusal.to_string()))?;
        Ok(Response::new(ApplyHapticsResponse {}))
    }
}

impl Watcher {
    /// The next list; `None` ends the stream.
    async fn next(&mut self) -> Option<Result<Vec<Device>, Status>> {
        if !self.is_first {
            let changed = async {
                time::sleep(INTERVAL).await;
                self.devices.changed().await
            };
            tokio::select! {
                changed = changed => changed.ok()?,
                _ = self.stop.changed() => return Some(Err(stopping())),
            }
        }
        self.is_first = false;
        Some(Ok(messages(&self.devices.borrow_and_update())))
    }
}

fn messages(devices: &[DeviceState]) -> Vec<Device> {
    devices.iter().map(convert::device).collect()
}
