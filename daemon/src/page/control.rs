//! What the page's buttons ask for.

use posed_tracker::TrackerKind;
use serde::Deserialize;

use crate::{config::HEIGHT_M, pipeline::tracking::Request};

/// `"reset"`, `{"height_m": 1.8}` or `{"tracker": "ik"}`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Wish {
    Reset,
    HeightM(f32),
    Tracker(String),
}

/// The request that `body` makes; else what is wrong with it.
pub(super) fn parse(body: &[u8], trackers: &[TrackerKind]) -> Result<Request, String> {
    let wish = serde_json::from_slice(body).map_err(|error| format!("no request: {error}"))?;
    match wish {
        Wish::Reset => Ok(Request::Reset),
        Wish::HeightM(height) if HEIGHT_M.contains(&height) => Ok(Request::Height(height)),
        Wish::HeightM(height) => {
            let (low, high) = (HEIGHT_M.start(), HEIGHT_M.end());
            Err(format!("a height of {height} m: give {low} to {high}"))
        }
        Wish::Tracker(name) => TrackerKind::from_name(&name)
            .filter(|kind| trackers.contains(kind))
            .map(Request::Tracker)
            .ok_or_else(|| {
                let names: Vec<_> = trackers.iter().map(|kind| kind.name()).collect();
                format!("tracker {name}: there are {}", names.join(", "))
            }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wishes_become_requests() {
        let parse = |text: &str| parse(text.as_bytes(), &[TrackerKind::Ik, TrackerKind::Pip]);
        assert_eq!(parse("\"reset\""), Ok(Request::Reset));
        assert_eq!(parse("{\"height_m\": 1.8}"), Ok(Request::Height(1.8)));
        assert_eq!(
            parse("{\"tracker\": \"pip\"}"),
            Ok(Request::Tracker(TrackerKind::Pip))
        );
        assert!(
            parse("{\"tracker\": \"questsim\"}")
                .unwrap_err()
                .contains("there are ik, pip")
        );
        for height in ["0.5", "3", "1e99", "null", "\"tall\""] {
            assert!(
                parse(&format!("{{\"height_m\": {height}}}")).is_err(),
                "{height}"
            );
        }
        for text in ["", "reset", "{}", "[]", "{\"reset\": 1}", "\"explode\""] {
            assert!(parse(text).is_err(), "{text}");
        }
    }
}
