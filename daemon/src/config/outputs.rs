//! Tables of the ways out besides gRPC.

use std::{
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
    str::FromStr,
};

use serde::{Deserialize, Deserializer, de::Error as _};

use super::{ConfigError, RATE_HZ};
use crate::{output::vrchat::Part, page::guard::Access};

/// `[page]`.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Page {
    /// Where the page is served; `None` for nowhere.
    #[serde(deserialize_with = "address")]
    pub listen: Option<SocketAddr>,
    /// What browsers must know to come in; empty for nothing, which only the loopback allows.
    pub token: String,
}

/// `[recording]`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Recordings {
    /// Where recordings are written; `None` for the user's own folder.
    #[serde(deserialize_with = "folder")]
    pub folder: Option<PathBuf>,
}

/// `[vmc]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Vmc {
    /// Receivers; none turns the output off.
    pub to: Vec<SocketAddr>,
    /// Poses a second, at most.
    pub rate_hz: f64,
}

/// `[vrchat]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VrChat {
    /// Receivers; none turns the output off.
    pub to: Vec<SocketAddr>,
    /// Poses a second, at most.
    pub rate_hz: f64,
    /// What VRChat is to follow.
    #[serde(deserialize_with = "parts")]
    pub parts: Vec<Part>,
    /// Whether VRChat is told where the head is.
    pub align_head: bool,
}

impl Default for Page {
    fn default() -> Self {
        let listen = Some((Ipv4Addr::LOCALHOST, 50771).into());
        Self {
            listen,
            token: String::new(),
        }
    }
}

impl Default for Vmc {
    fn default() -> Self {
        Self {
            to: Vec::new(),
            rate_hz: 90.0,
        }
    }
}

impl Default for VrChat {
    fn default() -> Self {
        Self {
            to: Vec::new(),
            rate_hz: 90.0,
            parts: Part::ALL.to_vec(),
            align_head: true,
        }
    }
}

impl Page {
    /// Who may come in.
    ///
    /// # Errors
    /// The page could be opened from other machines without a token, or the token is too short.
    pub fn access(&self) -> Result<Access, String> {
        let is_local = self
            .listen
            .is_none_or(|address| address.ip().to_canonical().is_loopback());
        match (self.token.as_str(), is_local) {
            ("", true) => Ok(Access::local()),
            ("", false) => Err(
                "a page.token too, or a loopback address: other machines can reach \
                                this one"
                    .into(),
            ),
            (token, _) => Access::with_token(token).map_err(|error| error.to_string()),
        }
    }

    pub(super) fn check(&self, origin: &str) -> Result<(), ConfigError> {
        self.access().map(drop).map_err(|allowed| {
            let value = self
                .listen
                .map_or("off".into(), |address| address.to_string());
            ConfigError::Range {
                origin: origin.into(),
                key: "page.listen",
                value,
                allowed,
            }
        })
    }
}

/// Whether a rate can be kept.
pub(super) fn check_rate(origin: &str, key: &'static str, rate: f64) -> Result<(), ConfigError> {
    if RATE_HZ.contains(&rate) {
        return Ok(());
    }
    let allowed = format!(
        "poses a second from {:?} to {:?}",
        RATE_HZ.start(),
        RATE_HZ.end()
    );
    Err(ConfigError::Range {
        origin: origin.into(),
        key,
        value: rate.to_string(),
        allowed,
    })
}

fn address<'de, D: Deserializer<'de>>(from: D) -> Result<Option<SocketAddr>, D::Error> {
    let text = String::deserialize(from)?;
    if text == "off" {
        return Ok(None);
    }
    let example = Page::default()
        .listen
        .map_or(String::new(), |address| address.to_string());
    SocketAddr::from_str(&text).map(Some).map_err(|_| {
        D::Error::custom(format!(
            "`{text}` is no address: give one such as {example}, or \"off\""
        ))
    })
}

fn folder<'de, D: Deserializer<'de>>(from: D) -> Result<Option<PathBuf>, D::Error> {
    let text = String::deserialize(from)?;
    if text == "auto" {
        return Ok(None);
    }
    let path = PathBuf::from(&text);
    let absolute = path.is_absolute().then_some(Some(path));
    absolute.ok_or_else(|| D::Error::custom(format!("`{text}`: give \"auto\" or an absolute path")))
}

fn parts<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Part>, D::Error> {
    let part = |name: &String| {
        Part::from_name(name).ok_or_else(|| {
            let known = Part::ALL.map(Part::name).join(", ");
            D::Error::custom(format!("`{name}` is not known: give one of {known}"))
        })
    };
    Vec::<String>::deserialize(from)?.iter().map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::{super::*, *};

    fn config(text: &str) -> Result<Config, String> {
        let layer = Layer {
            origin: "posed.toml".into(),
            text: text.into(),
        };
        parse(&[layer]).map_err(|error| error.to_string())
    }

    #[test]
    fn outputs_are_off_until_they_have_receivers() {
        let config = config(
            "[vmc]\nto = [\"127.0.0.1:39539\", \"[::1]:39539\"]\nrate_hz = 60\n\
             [vrchat]\nto = [\"192.168.1.7:9000\"]\nparts = [\"feet\", \"hip\"]\n",
        )
        .unwrap();
        assert_eq!((config.vmc.to.len(), config.vmc.rate_hz), (2, 60.0));
        assert_eq!(config.vrchat.parts, [Part::Feet, Part::Hip]);
        let default = Config::default();
        assert!(default.vmc.to.is_empty() && default.vrchat.to.is_empty());
    }

    #[test]
    fn the_page_is_opened_to_others_only_with_a_token() {
        assert_eq!(
            config("[page]\nlisten = \"off\"\n").unwrap().page.listen,
            None
        );
        let wide = "[page]\nlisten = \"0.0.0.0:50771\"\n";
        let error = config(wide).unwrap_err();
        assert!(error.contains("page.listen = 0.0.0.0:50771") && error.contains("page.token"));
        assert!(
            config(&format!("{wide}token = \"short\"\n"))
                .unwrap_err()
                .contains("at least 16")
        );
        let layer = |text: &str| Layer {
            origin: "a".into(),
            text: text.into(),
        };
        let token = layer("[page]\ntoken = \"long-enough-to-keep\"\n");
        assert!(
            parse(&[layer(wide), token]).is_ok(),
            "address and token from two files"
        );
        assert!(config(&format!("{wide}token = \"long-enough-to-keep\"\n")).is_ok());
    }

    #[test]
    fn errors_name_the_key() {
        for (text, part) in [
            ("[vmc]\nrate_hz = 0\n", "vmc.rate_hz = 0"),
            ("[vrchat]\nrate_hz = 1e9\n", "vrchat.rate_hz"),
            (
                "[vrchat]\nparts = [\"tail\"]\n",
                "hip, feet, knees, chest, elbows",
            ),
            ("[vmc]\nto = [\"localhost\"]\n", "line 2"),
            ("[page]\nlisten = \"here\"\n", "or \"off\""),
        ] {
            let error = config(text).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
