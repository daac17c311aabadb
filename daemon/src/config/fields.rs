//! Values of the configuration that are written as words or addresses.

use std::{
    collections::BTreeMap,
    fmt,
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
    str::FromStr,
};

use posed_signal::Role;
use posed_tracker::TrackerKind;
use serde::{Deserialize as _, Deserializer, de::Error as _};

/// An address of the loopback interface: nothing wider can be listened on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Loopback(SocketAddr);

/// An address is not the loopback's.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0} can be reached from other machines, and posed has no access control for them: \
     give a loopback address such as {default}",
    default = Loopback::DEFAULT
)]
pub struct NotLoopback(pub SocketAddr);

impl Loopback {
    /// Where posed listens unless told otherwise.
    pub const DEFAULT: Self = Self(SocketAddr::new(
        std::net::IpAddr::V4(Ipv4Addr::LOCALHOST),
        50770,
    ));

    /// The address.
    #[must_use]
    pub fn addr(self) -> SocketAddr {
        self.0
    }
}

impl TryFrom<SocketAddr> for Loopback {
    type Error = NotLoopback;

    fn try_from(addr: SocketAddr) -> Result<Self, NotLoopback> {
        if addr.ip().to_canonical().is_loopback() {
            Ok(Self(addr))
        } else {
            Err(NotLoopback(addr))
        }
    }
}

impl fmt::Display for Loopback {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Which Unix socket to listen on.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum UnixSocket {
    /// `posed/posed.sock` under `XDG_RUNTIME_DIR`.
    #[default]
    Auto,
    /// None.
    Off,
    /// This one.
    At(PathBuf),
}

pub(super) fn tracker<'de, D: Deserializer<'de>>(from: D) -> Result<TrackerKind, D::Error> {
    let name = String::deserialize(from)?;
    TrackerKind::from_name(&name)
        .ok_or_else(|| D::Error::custom(unknown(&name, &TrackerKind::ALL.map(TrackerKind::name))))
}

pub(super) fn roles<'de, D: Deserializer<'de>>(
    from: D,
) -> Result<BTreeMap<String, Role>, D::Error> {
    let names = BTreeMap::<String, String>::deserialize(from)?;
    names
        .into_iter()
        .map(|(serial, name)| match Role::from_name(&name) {
            Some(role) => Ok((serial, role)),
            None => Err(D::Error::custom(format!(
                "{serial}: {}",
                unknown(&name, &Role::ALL.map(Role::name))
            ))),
        })
        .collect()
}

pub(super) fn unix<'de, D: Deserializer<'de>>(from: D) -> Result<UnixSocket, D::Error> {
    let text = String::deserialize(from)?;
    match text.as_str() {
        "auto" => Ok(UnixSocket::Auto),
        "off" => Ok(UnixSocket::Off),
        path if path.starts_with('/') => Ok(UnixSocket::At(path.into())),
        _ => Err(D::Error::custom(format!(
            "`{text}` is no socket: give \"auto\", \"off\" or an absolute path"
        ))),
    }
}

pub(super) fn tcp<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Loopback>, D::Error> {
    let text = String::deserialize(from)?;
    if text == "off" {
        return Ok(None);
    }
    let addr = SocketAddr::from_str(&text).map_err(|_| {
        let example = Loopback::DEFAULT;
        D::Error::custom(format!(
            "`{text}` is no address: give one such as {example}, or \"off\""
        ))
    })?;
    Loopback::try_from(addr).map(Some).map_err(D::Error::custom)
}

fn unknown(name: &str, known: &[&str]) -> String {
    format!("`{name}` is not known: give one of {}", known.join(", "))
}
