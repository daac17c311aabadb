//! A client of `PoseService`: credits hidden, ages worked out; and what `posed follow` prints.

mod print;
mod server;

use std::{future::Future, io};

use posed_proto::v1::{
    FollowPosesRequest, GetClockRequest, pose_service_client::PoseServiceClient,
};
use posed_signal::Clock;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Status, Streaming, transport::Channel};

pub use print::{Format, Printer, Summary};
pub use server::{Server, ServerError};

use crate::{
    grpc::convert::{self, ConvertError},
    published::PublishedPose,
};

/// Questions after the server's clock; the one answered fastest counts.
const CLOCK_QUESTIONS: usize = 5;
/// How many poses a client may be behind before it is given the newest one: 0.7 s at 90 Hz.
const CATCH_UP: u32 = 64;

/// Why following ends.
#[derive(Debug, thiserror::Error)]
pub enum FollowError {
    /// Nobody answers, or not as posed does.
    #[error(transparent)]
    Server(#[from] ServerError),
    /// The server refused, or went away.
    #[error("posed ended the stream: {}", .0.message())]
    Status(#[from] Box<Status>),
    /// The server sent something else than a pose.
    #[error(transparent)]
    Convert(#[from] ConvertError),
    /// The poses cannot be printed.
    #[error("the output cannot be written: {0}")]
    Output(#[from] io::Error),
}

impl From<Status> for FollowError {
    fn from(status: Status) -> Self {
        Self::Status(Box::new(status))
    }
}

/// A pose as a client gets it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Followed {
    /// The pose.
    pub pose: PublishedPose,
    /// Poses published since the last one and not sent.
    pub gap: u64,
    /// From its publication to its arrival here, ns; off by half a round trip at most.
    pub age_ns: i64,
    /// From the newest measurement behind it to its arrival here, ns.
    pub sample_age_ns: i64,
}

/// A client that follows the pose.
#[derive(Debug)]
pub struct Follower<C> {
    clock: C,
    /// The server's clock less this one's, ns.
    offset_ns: i64,
    catch_up: u32,
    credits: mpsc::Sender<FollowPosesRequest>,
    poses: Streaming<posed_proto::v1::FollowPosesResponse>,
}

/// What a follower wants when it is late.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Late {
    /// Always the newest pose.
    #[default]
    Newest,
    /// Every pose, unless it is very late.
    CatchUp,
}

impl<C: Clock> Follower<C> {
    /// Connects, compares the clocks and asks for poses.
    ///
    /// # Errors
    /// Nobody answers there, or something else than posed.
    pub async fn connect(server: &Server, clock: C, late: Late) -> Result<Self, FollowError> {
        let mut client = PoseServiceClient::new(server.connect().await?);
        let offset_ns = clock_offset(&mut client, &clock).await?;
        // One request for each pose received: there is never more than one waiting.
        let (credits, requests) = mpsc::channel(2);
        let poses = client
            .follow_poses(ReceiverStream::new(requests))
            .await?
            .into_inner();
        let catch_up = match late {
            Late::Newest => 0,
            Late::CatchUp => CATCH_UP,
        };
        Ok(Self {
            clock,
            offset_ns,
            catch_up,
            credits,
            poses,
        })
    }

    /// Waits for the next pose: the newest of this moment, or the next published. `None` when the
    /// server publishes no more.
    ///
    /// # Errors
    /// The server stops or is gone, or its pose cannot be understood.
    pub async fn next(&mut self) -> Result<Option<Followed>, FollowError> {
        let request = FollowPosesRequest {
            credit: 1,
            catch_up: self.catch_up,
        };
        // Where the server is gone, the stream says so.
        let _ = self.credits.send(request).await;
        let Some(response) = self.poses.message().await? else {
            return Ok(None);
        };
        let now = self.clock.now().plus_ns(self.offset_ns);
        let missing = ConvertError {
            field: "pose",
            problem: "is missing",
        };
        let pose = convert::to_pose(response.pose.as_ref().ok_or(missing)?)?;
        Ok(Some(Followed {
            pose,
            gap: response.gap,
            age_ns: now.since_ns(pose.publish_at),
            sample_age_ns: now.since_ns(pose.sample_at),
        }))
    }
}

/// The server's clock less this one's, ns.
async fn clock_offset(
    client: &mut PoseServiceClient<Channel>,
    clock: &impl Clock,
) -> Result<i64, FollowError> {
    let mut best = (i64::MAX, 0);
    for _ in 0..CLOCK_QUESTIONS {
        let asked = clock.now();
        let answer = client.get_clock(GetClockRequest {}).await?.into_inner();
        let round_trip = clock.now().since_ns(asked);
        let middle = asked.plus_ns(round_trip / 2);
        let offset = posed_signal::HostTime(answer.time_ns).since_ns(middle);
        best = best.min((round_trip, offset));
    }
    Ok(best.1)
}

/// Follows until `stop`, the server's end, or `count` poses, and prints them.
///
/// # Errors
/// As [`Follower::connect`] and [`Follower::next`]; or the output cannot be written.
pub async fn follow<C: Clock>(
    server: &Server,
    clock: C,
    printer: &mut Printer<'_>,
    count: Option<u64>,
    stop: impl Future<Output = ()>,
) -> Result<Summary, FollowError> {
    let mut follower = Follower::connect(server, clock, Late::CatchUp).await?;
    let mut stop = std::pin::pin!(stop);
    while count.is_none_or(|count| printer.summary().poses < count) {
        let next = tokio::select! {
            next = follower.next() => next?,
            () = &mut stop => break,
        };
        let Some(followed) = next else { break };
        match printer.print(&followed) {
            Ok(()) => {}
            // Whoever read the output has seen enough: `posed follow | head`.
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {
                return Ok(printer.summary().clone());
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok(printer.finish()?)
}
