//! `posed reset`, `height`, `calibrate`, `tracker` and `record start|stop`: requests to a running
//! posed.

use std::{io::IsTerminal as _, thread, time::Duration};

use posed_proto::v1::{
    CalibrateRequest, GetControlStateRequest, GetControlStateResponse, Recording, ResetRequest,
    SetHeightRequest, SetTrackerRequest, StopRecordingRequest,
    control_service_client::ControlServiceClient,
};
use tonic::{Response, Status, transport::Channel};

use super::CommandError;
use crate::{
    cli::{CalibrateArgs, HeightArgs, RecordStartArgs, ServerArgs, TrackerArgs},
    follow::{FollowError, Server},
    grpc::convert,
    heights::Avatar,
    output::record::Wish,
};

/// The tracker forgets the past.
///
/// # Errors
/// No posed answers.
pub fn reset(args: &ServerArgs) -> Result<(), CommandError> {
    ask(args, async |mut client| client.reset(ResetRequest {}).await)?;
    println!("the tracker starts anew");
    Ok(())
}

/// Tells the wearer's height, or asks for it.
///
/// # Errors
/// No posed answers.
pub fn height(args: &HeightArgs) -> Result<(), CommandError> {
    if let Some(height_m) = args.height {
        let wish = SetHeightRequest {
            height_m,
            avatar_height_m: convert::avatar(args.avatar.unwrap_or(Avatar::Keep)),
        };
        ask(&args.server, async |mut client| {
            client.set_height(wish).await
        })?;
    }
    let state = state(&args.server)?;
    match state.avatar_height_m {
        Some(avatar) => println!("{:.2} m, shown as {avatar:.2} m", state.height_m),
        None => println!("{:.2} m", state.height_m),
    }
    Ok(())
}

/// Chooses a tracker, or says which there are.
///
/// # Errors
/// No posed answers, or it has no such tracker.
pub fn tracker(args: &TrackerArgs) -> Result<(), CommandError> {
    if let Some(kind) = args.tracker {
        let tracker = convert::tracker(kind).into();
        ask(&args.server, async |mut client| {
            client.set_tracker(SetTrackerRequest { tracker }).await
        })?;
    }
    let state = state(&args.server)?;
    for known in state.trackers() {
        let name = convert::tracker_name(known);
        let mark = if known == state.tracker() { "*" } else { " " };
        println!("{mark} {name}");
    }
    Ok(())
}

/// Counts down, so that the wearer can take the stance, and calibrates.
///
/// # Errors
/// No posed answers.
pub fn calibrate(args: &CalibrateArgs) -> Result<(), CommandError> {
    // Whoever has counted down for nobody is told so now.
    state(&args.server)?;
    for left in (1..=args.seconds).rev() {
        if std::io::stdout().is_terminal() {
            println!("{}: hold still in {left} s", args.stance.name());
        }
        thread::sleep(Duration::from_secs(1));
    }
    let stance = convert::stance(args.stance).into();
    ask(&args.server, async |mut client| {
        client.calibrate(CalibrateRequest { stance }).await
    })?;
    println!("calibrated in {}", args.stance.name());
    Ok(())
}

/// Begins to record poses.
///
/// # Errors
/// No posed answers, or it cannot record.
pub fn start_recording(args: &RecordStartArgs) -> Result<(), CommandError> {
    let wish = convert::wish(&Wish {
        format: args.format,
        name: args.name.clone().unwrap_or_default(),
        names: args.names,
    });
    let begun = ask(&args.server, async |mut client| {
        client.start_recording(wish).await
    })?;
    let path = begun.recording.unwrap_or_default().path;
    println!("recording to {path}; end it with `posed record stop`");
    Ok(())
}

/// Ends the recording.
///
/// # Errors
/// No posed answers, nothing is being recorded, or the file is not whole.
pub fn stop_recording(args: &ServerArgs) -> Result<(), CommandError> {
    let ended = ask(args, async |mut client| {
        client.stop_recording(StopRecordingRequest {}).await
    })?;
    let Recording {
        path,
        poses,
        lost,
        error,
        ..
    } = ended.recording.unwrap_or_default();
    if !error.is_empty() {
        return Err(CommandError::Input(error));
    }
    println!("{path}: {poses} poses, {lost} lost");
    Ok(())
}

impl ServerArgs {
    /// The server named, or the user's own.
    pub(super) fn server(&self) -> Result<Server, CommandError> {
        match &self.server {
            Some(text) => Ok(text.parse().map_err(FollowError::from)?),
            None => Ok(Server::of_user()),
        }
    }
}

fn state(args: &ServerArgs) -> Result<GetControlStateResponse, CommandError> {
    ask(args, async |mut client| {
        client.get_control_state(GetControlStateRequest {}).await
    })
}

fn ask<T>(
    args: &ServerArgs,
    question: impl AsyncFnOnce(ControlServiceClient<Channel>) -> Result<Response<T>, Status>,
) -> Result<T, CommandError> {
    let server = args.server()?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let channel = server.connect().await.map_err(FollowError::from)?;
        let answer = question(ControlServiceClient::new(channel)).await;
        let refused = |status: Status| CommandError::Input(status.message().into());
        Ok(answer.map_err(refused)?.into_inner())
    })
}
