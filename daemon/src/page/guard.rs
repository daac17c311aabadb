//! Who may use the page.
//!
//! Every web page that the user has open can send requests to the loopback. Such a request gives
//! itself away by its `Origin`; one that was led here by a name whose address was changed (DNS
//! rebinding), by its `Host`. From other machines only those come in who know the token.

use std::{net::IpAddr, sync::Arc};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, StatusCode, Uri, header},
    middleware::Next,
    response::{IntoResponse, Response},
};

/// The cookie that holds the token after the first visit.
const COOKIE: &str = "posed_token";
/// Shorter tokens can be guessed.
pub const TOKEN_CHARS_MIN: usize = 16;

/// Who may come in.
#[derive(Clone, Default)]
pub struct Access {
    token: Option<String>,
}

/// A token is too short, or has characters that do not fit an address and a cookie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the page's token needs at least {TOKEN_CHARS_MIN} letters, digits, `-` or `_`")]
pub struct BadToken;

/// Why somebody may not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
enum Refusal {
    #[error("open this page by address (localhost, 127.0.0.1 or another IP address), not by name")]
    Host,
    #[error("pages of other origins may not use posed")]
    Origin,
    #[error("open this page with its token once: http://ADDRESS:PORT/?token=TOKEN")]
    Token,
}

impl Access {
    /// Everybody on this machine: for the loopback.
    #[must_use]
    pub fn local() -> Self {
        Self::default()
    }

    /// Everybody who knows `token`.
    ///
    /// # Errors
    /// The token could be guessed, or cannot be sent.
    pub fn with_token(token: &str) -> Result<Self, BadToken> {
        let fits = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if token.len() < TOKEN_CHARS_MIN || !token.chars().all(fits) {
            return Err(BadToken);
        }
        Ok(Self {
            token: Some(token.into()),
        })
    }

    fn admit(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let host = text(headers, header::HOST).unwrap_or_default();
        if !is_address(host) {
            return Err(Refusal::Host);
        }
        let own = |origin: &str| origin.strip_prefix("http://") == Some(host);
        if headers.contains_key(header::ORIGIN) && !text(headers, header::ORIGIN).is_some_and(own) {
            return Err(Refusal::Origin);
        }
        let Some(token) = &self.token else {
            return Ok(());
        };
        let bearer =
            text(headers, header::AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
        let given = bearer.or_else(|| cookie(headers)).unwrap_or_default();
        if is_same(given, token) {
            Ok(())
        } else {
            Err(Refusal::Token)
        }
    }

    /// The answer to a visit with the right token in the address: a cookie, and the address
    /// without it, so that it does not stay in the browser's history.
    fn greet(&self, uri: &Uri) -> Option<Response> {
        let token = self.token.as_ref()?;
        let mut pairs = uri.query()?.split('&');
        let given = pairs.find_map(|pair| pair.strip_prefix("token="))?;
        if uri.path() != "/" || !is_same(given, token) {
            return None;
        }
        let cookie = format!("{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict");
        let headers = [
            (header::SET_COOKIE, HeaderValue::try_from(cookie).ok()?),
            (header::LOCATION, HeaderValue::from_static("/")),
        ];
        Some((StatusCode::SEE_OTHER, headers).into_response())
    }
}

/// Stands before every handler.
pub(super) async fn check(
    State(access): State<Arc<Access>>,
    request: Request,
    next: Next,
) -> Response {
    match access.admit(request.headers()) {
        Ok(()) => next.run(request).await,
        Err(Refusal::Token) if let Some(welcome) = access.greet(request.uri()) => welcome,
        Err(refusal) => {
            let status = match refusal {
                Refusal::Token => StatusCode::UNAUTHORIZED,
                Refusal::Host | Refusal::Origin => StatusCode::FORBIDDEN,
            };
            (status, refusal.to_string()).into_response()
        }
    }
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

fn cookie(headers: &HeaderMap) -> Option<&str> {
    let all = headers
        .get_all(header::COOKIE)
        .iter()
        .filter_map(|value| value.to_str().ok());
    let mut pairs = all
        .flat_map(|value| value.split(';'))
        .filter_map(|pair| pair.split_once('='));
    pairs
        .find(|(name, _)| name.trim() == COOKIE)
        .map(|(_, value)| value.trim())
}

/// Whether a `Host` names no domain: a rebound name is always one.
fn is_address(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|c| c.is_ascii_digit()) => name,
        _ => host,
    };
    let inner = name
        .strip_prefix('[')
        .and_then(|rest| rest.strip_suffix(']'));
    match inner {
        Some(v6) => v6.parse::<std::net::Ipv6Addr>().is_ok(),
        None => {
            name.eq_ignore_ascii_case("localhost")
                || name
                    .parse::<IpAddr>()
                    .is_ok_and(|address| address.is_ipv4())
        }
    }
}

/// Takes as long whether they differ early or late.
fn is_same(given: &str, token: &str) -> bool {
    let differences = given
        .bytes()
        .zip(token.bytes())
        .fold(0, |sum, (a, b)| sum | (a ^ b));
    given.len() == token.len() && differences == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: &str = "a-token-of-enough_chars";

    fn headers(pairs: &[(header::HeaderName, &str)]) -> HeaderMap {
        pairs
            .iter()
            .map(|(name, value)| (name.clone(), value.parse().unwrap()))
            .collect()
    }

    #[test]
    fn names_are_refused_and_addresses_are_not() {
        for host in [
            "localhost",
            "LOCALHOST:50771",
            "127.0.0.1:50771",
            "[::1]:50771",
            "10.1.2.3",
        ] {
            assert!(is_address(host), "{host}");
        }
        let names = [
            "",
            "evil.example",
            "evil.example:50771",
            "127.0.0.1.evil.example",
            "[evil]:80",
            "::1",
            "localhost.evil.example:1",
            "127.0.0.1:x",
            "localhost@evil.example",
        ];
        for host in names {
            assert!(!is_address(host), "{host}");
            let refused = Access::local().admit(&headers(&[(header::HOST, host)]));
            assert_eq!(refused, Err(Refusal::Host));
        }
        assert_eq!(Access::local().admit(&HeaderMap::new()), Err(Refusal::Host));
    }

    #[test]
    fn other_origins_are_refused() {
        let admit = |origin: &str| {
            let host = (header::HOST, "127.0.0.1:50771");
            Access::local().admit(&headers(&[host, (header::ORIGIN, origin)]))
        };
        assert_eq!(admit("http://127.0.0.1:50771"), Ok(()));
        let others = [
            "null",
            "https://127.0.0.1:50771",
            "http://127.0.0.1:8080",
            "http://evil.example",
            "http://127.0.0.1:50771.evil.example",
            "http://localhost:50771",
        ];
        for origin in others {
            assert_eq!(admit(origin), Err(Refusal::Origin), "{origin}");
        }
    }

    #[test]
    fn a_token_is_asked_for_by_header_or_cookie() {
        let access = Access::with_token(TOKEN).unwrap();
        let admit = |name, value: &str| {
            access.admit(&headers(&[(header::HOST, "10.0.0.2:50771"), (name, value)]))
        };
        assert_eq!(
            admit(header::AUTHORIZATION, &format!("Bearer {TOKEN}")),
            Ok(())
        );
        assert_eq!(
            admit(header::COOKIE, &format!("a=b; {COOKIE}={TOKEN}")),
            Ok(())
        );
        let wrong = ["", "Bearer ", "Bearer a-token-of-enough_charz", TOKEN];
        for value in wrong {
            assert_eq!(
                admit(header::AUTHORIZATION, value),
                Err(Refusal::Token),
                "{value}"
            );
        }
        assert_eq!(
            admit(header::COOKIE, &format!("x{COOKIE}={TOKEN}")),
            Err(Refusal::Token)
        );
        for token in ["short", "sixteen chars and blanks", "sixteen-chars-and-ü"] {
            assert!(Access::with_token(token).is_err(), "{token}");
        }
    }

    #[test]
    fn the_first_visit_leaves_a_cookie_and_a_clean_address() {
        let access = Access::with_token(TOKEN).unwrap();
        let greet = |uri: &str| access.greet(&uri.parse().unwrap());
        let welcome = greet(&format!("/?a=b&token={TOKEN}")).unwrap();
        assert_eq!(welcome.status(), StatusCode::SEE_OTHER);
        assert_eq!(welcome.headers()[header::LOCATION], "/");
        let cookie = welcome.headers()[header::SET_COOKIE].to_str().unwrap();
        assert!(
            cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"),
            "{cookie}"
        );
        assert!(greet("/").is_none() && greet("/?token=wrong").is_none());
        assert!(greet(&format!("/control?token={TOKEN}")).is_none());
        assert!(
            Access::local()
                .greet(&"/?token=x".parse().unwrap())
                .is_none()
        );
    }
}
