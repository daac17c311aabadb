//! The sockets that the services listen on: a Unix socket of the user's own and TCP on the
//! loopback, bound here or handed over by systemd.

use std::{
    fmt, fs, io,
    net::{SocketAddr, TcpListener},
    os::unix::{
        fs::{DirBuilderExt as _, FileTypeExt as _, MetadataExt as _, PermissionsExt as _},
        net::{UnixListener, UnixStream},
    },
    path::{Path, PathBuf},
};

use listenfd::ListenFd;

use crate::config::{Grpc, Loopback, NotLoopback, UnixSocket};

/// Why a socket cannot be listened on.
#[derive(Debug, thiserror::Error)]
pub enum ListenError {
    /// There is no directory for the default socket.
    #[error(
        "XDG_RUNTIME_DIR is not set, so there is no place for posed's socket: set it, give a path \
         as grpc.unix, or turn the socket off with grpc.unix = \"off\""
    )]
    NoRuntimeDir,
    /// Somebody serves there.
    #[error("{0}: another posed is running; stop it, or give this one another socket as grpc.unix")]
    InUse(PathBuf),
    /// What is there is not a socket, and not posed's to remove.
    #[error("{0}: there is a file that is no socket; remove it or give another path as grpc.unix")]
    NotASocket(PathBuf),
    /// The operating system refuses the Unix socket.
    #[error("{path}: cannot be listened on: {source}")]
    Unix {
        /// The socket.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The operating system refuses the TCP address.
    #[error(
        "{addr}: cannot be listened on: {source}; give another address as grpc.tcp, or \"off\""
    )]
    Tcp {
        /// The address.
        addr: SocketAddr,
        /// Why.
        source: io::Error,
    },
    /// systemd was told to listen too widely.
    #[error("the socket unit hands over {0}")]
    Wide(#[from] NotLoopback),
    /// systemd handed over something else than listening stream sockets.
    #[error("file descriptor {index} handed over by systemd: {source}")]
    HandedOver {
        /// Its number among those handed over.
        index: usize,
        /// What it is not.
        source: io::Error,
    },
    /// Everything is turned off.
    #[error("both grpc.unix and grpc.tcp are off: nobody could follow the pose")]
    Nowhere,
}

/// The sockets, bound and listening. Those bound here are removed when this is dropped.
#[derive(Debug, Default)]
pub struct Listeners {
    pub(super) unix: Vec<UnixListener>,
    pub(super) tcp: Vec<TcpListener>,
    bound: Option<BoundPath>,
    names: Vec<String>,
}

impl Listeners {
    /// Takes the sockets that systemd hands over, and binds those of `config` that it does not
    /// replace. `runtime_dir` is where the default Unix socket goes.
    ///
    /// # Errors
    /// A socket cannot be bound, is in use, or would be reachable from other machines.
    pub fn open(config: &Grpc, runtime_dir: Option<&Path>) -> Result<Self, ListenError> {
        let mut listeners = Self::handed_over(&mut ListenFd::from_env())?;
        if listeners.unix.is_empty() {
            match (&config.unix, runtime_dir) {
                (UnixSocket::Off, _) => {}
                (UnixSocket::At(path), _) => listeners.bind_unix(path)?,
                (UnixSocket::Auto, Some(dir)) => listeners.bind_unix(&dir.join("posed.sock"))?,
                (UnixSocket::Auto, None) => return Err(ListenError::NoRuntimeDir),
            }
        }
        if let Some(addr) = config.tcp
            && listeners.tcp.is_empty()
        {
            listeners.bind_tcp(addr)?;
        }
        if listeners.names.is_empty() {
            Err(ListenError::Nowhere)
        } else {
            Ok(listeners)
        }
    }

    /// Where clients can connect, for people.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Binds a Unix socket with mode 0600. A socket file that nobody listens on any more is
    /// replaced. Folders that are missing are made with mode 0700.
    ///
    /// # Errors
    /// Somebody listens on it, something else is in its place, or the system refuses.
    pub fn bind_unix(&mut self, path: &Path) -> Result<(), ListenError> {
        let fail = |source| ListenError::Unix {
            path: path.into(),
            source,
        };
        if let Some(parent) = path.parent() {
            fs::DirBuilder::new()
                .recursive(true)
                .mode(0o700)
                .create(parent)
                .map_err(fail)?;
        }
        check_free(path)?;
        // Bound under another name and moved into place: nobody can connect before the mode is
        // set, and a stale file is replaced in one step.
        let fresh = path.with_extension(format!("{}.new", std::process::id()));
        let _ = fs::remove_file(&fresh);
        let listener = UnixListener::bind(&fresh).map_err(fail)?;
        let placed = fs::set_permissions(&fresh, fs::Permissions::from_mode(0o600))
            .and_then(|()| fs::rename(&fresh, path));
        if let Err(source) = placed {
            let _ = fs::remove_file(&fresh);
            return Err(fail(source));
        }
        let inode = fs::metadata(path).map_err(fail)?.ino();
        self.bound = Some(BoundPath {
            path: path.into(),
            inode,
        });
        self.names.push(format!("unix:{}", path.display()));
        self.unix.push(listener);
        Ok(())
    }

    /// Binds a TCP address of the loopback.
    ///
    /// # Errors
    /// The system refuses, as when the port is taken.
    pub fn bind_tcp(&mut self, addr: Loopback) -> Result<(), ListenError> {
        let fail = |source| ListenError::Tcp {
            addr: addr.addr(),
            source,
        };
        let listener = TcpListener::bind(addr.addr()).map_err(fail)?;
        let bound = listener.local_addr().map_err(fail)?;
        self.names.push(bound.to_string());
        self.tcp.push(listener);
        Ok(())
    }

    /// The TCP addresses listened on: with port 0 asked for, the one that the system chose.
    pub fn tcp_addrs(&self) -> impl Iterator<Item = SocketAddr> + '_ {
        self.tcp
            .iter()
            .filter_map(|listener| listener.local_addr().ok())
    }

    fn handed_over(fds: &mut ListenFd) -> Result<Self, ListenError> {
        let mut listeners = Self::default();
        for index in 0..fds.len() {
            if let Ok(Some(listener)) = fds.take_unix_listener(index) {
                let name = listener.local_addr().ok();
                let path = name.as_ref().and_then(|addr| addr.as_pathname());
                let path = path.map_or("unnamed".into(), |path| path.display().to_string());
                listeners.names.push(format!("unix:{path} (from systemd)"));
                listeners.unix.push(listener);
                continue;
            }
            let fail = |source| ListenError::HandedOver { index, source };
            if let Some(listener) = fds.take_tcp_listener(index).map_err(fail)? {
                let addr = Loopback::try_from(listener.local_addr().map_err(fail)?)?;
                listeners.names.push(format!("{addr} (from systemd)"));
                listeners.tcp.push(listener);
            }
        }
        Ok(listeners)
    }
}

/// Where clients find the services, for people.
impl fmt::Display for Listeners {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.names.join(", "))
    }
}

/// Whether `path` can be bound: nothing is there, or a socket that nobody listens on.
fn check_free(path: &Path) -> Result<(), ListenError> {
    let fail = |source| ListenError::Unix {
        path: path.into(),
        source,
    };
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(fail(error)),
        Ok(there) if !there.file_type().is_socket() => Err(ListenError::NotASocket(path.into())),
        Ok(_) => match UnixStream::connect(path) {
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => Ok(()),
            Err(error) => Err(fail(error)),
            Ok(_) => Err(ListenError::InUse(path.into())),
        },
    }
}

/// A socket file made here; removed at the end unless somebody has put another one there.
#[derive(Debug)]
struct BoundPath {
    path: PathBuf,
    inode: u64,
}

impl Drop for BoundPath {
    fn drop(&mut self) {
        if fs::metadata(&self.path).is_ok_and(|there| there.ino() == self.inode) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(unix: UnixSocket, tcp: Option<&str>) -> Grpc {
        let tcp = tcp.map(|addr| Loopback::try_from(addr.parse::<SocketAddr>().unwrap()).unwrap());
        Grpc { unix, tcp }
    }

    #[test]
    fn the_default_socket_is_the_users_alone() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join("posed");
        let config = config(UnixSocket::Auto, Some("127.0.0.1:0"));
        let listeners = Listeners::open(&config, Some(&dir)).unwrap();
        let socket = dir.join("posed.sock");
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!((mode(&dir), mode(&socket)), (0o700, 0o600));
        assert_eq!(
            fs::read_dir(&dir).unwrap().count(),
            1,
            "nothing else is left there"
        );
        UnixStream::connect(&socket).unwrap();
        assert!(
            listeners
                .tcp_addrs()
                .all(|addr| addr.ip().is_loopback() && addr.port() != 0)
        );
        assert!(
            listeners.to_string().contains("posed.sock, 127.0.0.1:"),
            "{listeners}"
        );
        drop(listeners);
        assert!(!socket.exists());
    }

    #[test]
    fn a_stale_socket_is_replaced_and_a_live_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        drop(UnixListener::bind(&socket).unwrap());
        assert!(socket.exists(), "std leaves the file behind");
        let config = config(UnixSocket::At(socket.clone()), None);
        let first = Listeners::open(&config, None).unwrap();
        UnixStream::connect(&socket).unwrap();

        let second = Listeners::open(&config, None).unwrap_err();
        assert!(
            matches!(&second, ListenError::InUse(path) if *path == socket),
            "{second}"
        );
        assert!(
            second.to_string().contains("another posed is running"),
            "{second}"
        );
        drop(first);

        fs::write(&socket, "precious").unwrap();
        let third = Listeners::open(&config, None).unwrap_err();
        assert!(matches!(third, ListenError::NotASocket(_)), "{third}");
        assert_eq!(fs::read(&socket).unwrap(), b"precious");
    }

    #[test]
    fn another_servers_socket_is_left_alone_at_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let config = config(UnixSocket::At(socket.clone()), None);
        let first = Listeners::open(&config, None).unwrap();
        fs::remove_file(&socket).unwrap();
        let other = UnixListener::bind(&socket).unwrap();
        drop(first);
        assert!(socket.exists());
        drop(other);
    }

    #[test]
    fn errors_say_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let open = |config: Grpc| Listeners::open(&config, None).unwrap_err().to_string();
        assert!(open(config(UnixSocket::Auto, None)).contains("XDG_RUNTIME_DIR"));
        assert!(open(config(UnixSocket::Off, None)).contains("grpc.tcp"));
        let long = folder.path().join("x".repeat(120));
        let error = open(config(UnixSocket::At(long), None));
        assert!(
            error.contains("xxx") && error.contains("cannot be listened on"),
            "{error}"
        );
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let addr = taken.local_addr().unwrap().to_string();
        let error = open(config(UnixSocket::Off, Some(&addr)));
        assert!(
            error.contains(&addr) && error.contains("grpc.tcp"),
            "{error}"
        );
    }

    /// systemd passes the socket in the environment, which is the process's: a child takes it.
    #[test]
    fn a_socket_handed_over_by_systemd_is_taken() {
        use std::{env, io::Read as _, process};
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("s");
        let child = process::Command::new("systemd-socket-activate")
            .arg("--listen")
            .arg(&socket)
            .arg(env::current_exe().unwrap())
            .args([
                "--exact",
                "--ignored",
                "grpc::listen::tests::child_takes_the_socket",
            ])
            .stdout(process::Stdio::null())
            .stderr(process::Stdio::null())
            .spawn();
        let Ok(mut child) = child else {
            println!("SKIPPED (needs systemd-socket-activate)");
            return;
        };
        let connect = || UnixStream::connect(&socket).ok();
        let pause = std::time::Duration::from_millis(10);
        let connection = (0..1000).find_map(|_| {
            std::thread::sleep(pause);
            connect()
        });
        let mut said = String::new();
        connection.unwrap().read_to_string(&mut said).unwrap();
        assert!(
            said.contains(&format!("unix:{} (from systemd)", socket.display())),
            "{said}"
        );
        assert!(child.wait().unwrap().success());
        assert!(socket.exists(), "it is systemd's to remove");
    }

    #[test]
    #[ignore = "runs in a child process, whose systemd is a test"]
    fn child_takes_the_socket() {
        use std::io::Write as _;
        // No directory for a socket of its own: it must not want one.
        let listeners = Listeners::open(&config(UnixSocket::Auto, None), None).unwrap();
        let (mut connection, _) = listeners.unix[0].accept().unwrap();
        connection
            .write_all(listeners.to_string().as_bytes())
            .unwrap();
        assert!(listeners.bound.is_none());
    }
}
