//! Connections, so many at a time.

use std::{
    io,
    os::unix::net::UnixListener as StdUnixListener,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use futures_util::{Stream, stream};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream, UnixListener, UnixStream},
    sync::{OwnedSemaphorePermit, Semaphore},
    time,
};
use tonic::transport::server::Connected;

/// Connections that one listening socket may have; more wait in the system's queue.
const CONNECTIONS_MAX: usize = 64;
/// Accepting fails when the process has no file descriptor left: some time later it may have.
const RETRY: Duration = Duration::from_millis(100);

/// The connections that arrive on a Unix socket.
pub(super) fn unix(
    listener: StdUnixListener,
) -> io::Result<impl Stream<Item = io::Result<Counted<UnixStream>>>> {
    listener.set_nonblocking(true)?;
    let listener = Arc::new(UnixListener::from_std(listener)?);
    Ok(counted(move || {
        let listener = Arc::clone(&listener);
        async move { listener.accept().await.map(|(stream, _)| stream) }
    }))
}

/// The connections that arrive on a TCP address.
pub(super) fn tcp(
    listener: std::net::TcpListener,
) -> io::Result<impl Stream<Item = io::Result<Counted<TcpStream>>>> {
    listener.set_nonblocking(true)?;
    let listener = Arc::new(TcpListener::from_std(listener)?);
    Ok(counted(move || {
        let listener = Arc::clone(&listener);
        async move {
            let (stream, _) = listener.accept().await?;
            // Poses are small and late ones worthless: none waits to share a segment.
            stream.set_nodelay(true)?;
            Ok(stream)
        }
    }))
}

fn counted<T, A, F>(accept: A) -> impl Stream<Item = io::Result<Counted<T>>>
where
    A: Fn() -> F,
    F: Future<Output = io::Result<T>>,
{
    let free = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    stream::unfold((accept, free), |(accept, free)| async {
        let permit = Arc::clone(&free).acquire_owned().await.ok()?;
        loop {
            match accept().await {
                Ok(stream) => {
                    let connection = Counted {
                        stream,
                        _permit: permit,
                    };
                    return Some((Ok(connection), (accept, free)));
                }
                Err(error) => {
                    tracing::warn!(%error, "a connection cannot be accepted");
                    time::sleep(RETRY).await;
                }
            }
        }
    })
}

/// A connection that holds one of the places.
#[derive(Debug)]
pub(super) struct Counted<T> {
    stream: T,
    _permit: OwnedSemaphorePermit,
}

impl<T: Connected> Connected for Counted<T> {
    type ConnectInfo = T::ConnectInfo;

    fn connect_info(&self) -> Self::ConnectInfo {
        self.stream.connect_info()
    }
}

impl<T: AsyncRead + Unpin> AsyncRead for Counted<T> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl<T: AsyncWrite + Unpin> AsyncWrite for Counted<T> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
