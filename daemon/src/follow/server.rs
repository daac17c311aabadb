//! Where a server is, as people write it, and the connection to it.

use std::{fmt, net::SocketAddr, path::PathBuf, str::FromStr, time::Duration};

use tonic::transport::{Channel, Endpoint};

use crate::config::{Loopback, files};

/// How long a server may take to answer at first.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// A server's address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Server {
    /// A Unix socket.
    Unix(PathBuf),
    /// A TCP address.
    Tcp(SocketAddr),
}

/// There is no server to talk to.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The text names no address.
    #[error("`{0}` is no server: give a socket's path, or an address such as 127.0.0.1:50770")]
    Address(String),
    /// Nobody answers.
    #[error("no posed answers at {server}: is `posed run` running? ({reason})")]
    Unreachable {
        /// Where.
        server: Server,
        /// What the system says.
        reason: String,
    },
}

impl Server {
    /// Where a posed with the default configuration serves its user: the Unix socket, or the TCP
    /// address where there is no `XDG_RUNTIME_DIR`.
    #[must_use]
    pub fn of_user() -> Self {
        files::socket().map_or(Self::Tcp(Loopback::DEFAULT.addr()), Self::Unix)
    }

    /// Connects.
    ///
    /// # Errors
    /// Nobody listens there.
    pub async fn connect(&self) -> Result<Channel, ServerError> {
        let uri = match self {
            Self::Unix(path) => format!("unix:{}", path.display()),
            Self::Tcp(addr) => format!("http://{addr}"),
        };
        let unreachable = |error: tonic::transport::Error| ServerError::Unreachable {
            server: self.clone(),
            reason: root_cause(&error),
        };
        let endpoint = Endpoint::from_shared(uri).map_err(unreachable)?;
        endpoint
            .connect_timeout(CONNECT_TIMEOUT)
            .connect()
            .await
            .map_err(unreachable)
    }
}

/// tonic says "transport error"; what people can act on lies deeper.
fn root_cause(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(deeper) = cause.source() {
        cause = deeper;
    }
    cause.to_string()
}

impl FromStr for Server {
    type Err = ServerError;

    /// A path (with a `/`, or after `unix:`), or an IP address with a port.
    fn from_str(text: &str) -> Result<Self, ServerError> {
        let path = text
            .strip_prefix("unix://")
            .or_else(|| text.strip_prefix("unix:"));
        if let Some(path) = path.or_else(|| text.contains('/').then_some(text)) {
            return Ok(Self::Unix(path.into()));
        }
        let addr = text
            .parse()
            .map_err(|_| ServerError::Address(text.into()))?;
        Ok(Self::Tcp(addr))
    }
}

impl fmt::Display for Server {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unix(path) => path.display().fmt(f),
            Self::Tcp(addr) => addr.fmt(f),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn servers_are_written_as_paths_or_addresses() {
        let parse = |text: &str| text.parse::<Server>();
        let path = |path: &str| Server::Unix(path.into());
        assert_eq!(
            parse("/run/user/1000/posed/posed.sock").unwrap(),
            path("/run/user/1000/posed/posed.sock")
        );
        assert_eq!(parse("unix:/s").unwrap(), path("/s"));
        assert_eq!(parse("unix:///s").unwrap(), path("/s"));
        assert_eq!(parse("./s").unwrap(), path("./s"));
        assert_eq!(parse("[::1]:5").unwrap().to_string(), "[::1]:5");
        let error = parse("somewhere").unwrap_err().to_string();
        assert!(
            error.contains("`somewhere`") && error.contains("127.0.0.1:50770"),
            "{error}"
        );
    }

    #[tokio::test]
    async fn a_server_that_is_not_there_is_named_with_the_reason() {
        let server: Server = "/nonexistent/posed.sock".parse().unwrap();
        let error = server.connect().await.unwrap_err().to_string();
        assert!(error.contains("/nonexistent/posed.sock"), "{error}");
        assert!(error.contains("No such file"), "{error}");
    }
}
