//! Follows the wearer's pose: what a client in Rust needs.
//!
//! `cargo run --example follow -- [SERVER] [COUNT]`, with posed running. posed-proto is all that a
//! client needs of posed.

use std::error::Error;

use posed_proto::v1::{FollowPosesRequest, Quality, pose_service_client::PoseServiceClient};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// SMPL's index of the head; proto/posed/v1/pose.proto lists all joints.
const HEAD: usize = 15;

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let server = arguments
        .next()
        .unwrap_or_else(|| "http://127.0.0.1:50770".into());
    let count = arguments
        .next()
        .map_or(Ok(u64::MAX), |count| count.parse())?;
    let mut client = PoseServiceClient::connect(server).await?;

    // A credit is one pose: whoever grants the next only after the last always gets the newest, and
    // never works through a queue of old ones.
    let (credits, granted) = mpsc::channel(1);
    let credit = FollowPosesRequest {
        credit: 1,
        catch_up: 0,
    };
    credits.send(credit).await?;
    let mut poses = client
        .follow_poses(ReceiverStream::new(granted))
        .await?
        .into_inner();
    for _ in 0..count {
        let Some(message) = poses.message().await? else {
            break;
        };
        let Some(pose) = message.pose else { continue };
        let Some(head) = pose.joint_positions.get(HEAD) else {
            continue;
        };
        let age_ms = (pose.publish_time_ns - pose.sample_time_ns) as f64 * 1e-6;
        println!(
            "pose {} ({}): head at {:.3} {:.3} {:.3} m, measured {age_ms:.1} ms before, {} skipped",
            pose.sequence,
            Quality::try_from(pose.quality)?.as_str_name(),
            head.x,
            head.y,
            head.z,
            message.gap,
        );
        credits.send(credit).await?;
    }
    Ok(())
}
