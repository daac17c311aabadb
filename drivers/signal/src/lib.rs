//! The vocabulary of posed: what every other room speaks, and nothing that does I/O.
//!
//! * [`time`]: host and device time as values, clocks as something that is passed in.
//! * [`device`]: device ids, serials and the roles that devices play on the wearer's body.
//! * [`sample`]: the `Copy` samples that decoders and solvers emit.
//! * [`ring`]: the bounded single-producer single-consumer ring, which drops and counts.
//! * [`history`]: samples indexed by time; answers *at a time* and says how.
//! * [`clock_map`]: device ticks to host time, in spite of jitter, drift, wraps and jumps.
//! * [`latest`]: one value, always the newest, read without ever delaying the writer.
//! * [`upright`]: how high a standing wearer's eyes are.

pub mod clock_map;
pub mod device;
pub mod history;
pub mod latest;
pub mod ring;
pub mod sample;
mod sync;
pub mod time;
pub mod upright;

pub use clock_map::{ClockMap, TickUnwrap};
pub use device::{DeviceId, Role, Serial};
pub use history::{History, Lookup, Motion};
pub use sample::{Battery, Buttons, Imu, Orientation, Pose, PoseHow, Radio, Sample};
pub use time::{Clock, HostTime, VirtualClock};
