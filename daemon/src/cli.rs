//! The command line.

use std::{net::SocketAddr, path::PathBuf};

use clap::{Args, Parser, Subcommand, ValueEnum};
use posed_signal::Role;
use posed_tracker::worn::Stance;

use crate::{
    heights::Avatar,
    output::{bvh::Unit, export, names::Names, record},
};

/// Whole-body pose from a VR headset and its controllers, over gRPC.
#[derive(Debug, Parser)]
#[command(name = "posed", version, about, propagate_version = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// How much to log: error, warn, info, debug, trace, or a filter as in RUST_LOG.
    #[arg(long, global = true, value_name = "FILTER")]
    pub log: Option<String>,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Track the wearer of the headset on this PC and serve the pose.
    Run(RunArgs),
    /// Track from captured USB traffic, exactly as live.
    Replay(ReplayArgs),
    /// Tell posed where the floor is and which way is ahead: with the headset, in two steps.
    Setup(SetupArgs),
    /// Say what a capture holds, device by device.
    Inspect(InspectArgs),
    /// Track every device of many captures, and print how well: one table.
    Survey(SurveyArgs),
    /// Write the traffic of the devices on this PC to a capture; or have a running posed write
    /// its poses to a file.
    Record(RecordArgs),
    /// Write the motion of a capture, or of poses written before, to a file for other programs.
    Export(ExportArgs),
    /// Make the USB traffic of a headset, two controllers and body trackers from a human motion.
    Simulate(SimulateArgs),
    /// Follow the pose that a running posed serves.
    Follow(FollowArgs),
    /// Have the tracker of a running posed start anew.
    Reset(ServerArgs),
    /// Tell a running posed the wearer's height, or ask for it.
    Height(HeightArgs),
    /// Choose the tracker of a running posed, or ask which there are.
    Tracker(TrackerArgs),
    /// Have a running posed learn how trackers sit on the body, from a stance.
    Calibrate(CalibrateArgs),
    /// Have a controller of a running posed buzz.
    Vibrate(VibrateArgs),
    /// List the devices on this PC that posed knows.
    List(ListArgs),
    /// Replay the embedded capture, serve it, follow it, and show what happens.
    Demo(DemoArgs),
    /// Measure a tracker against recorded motion.
    Eval(EvalArgs),
    /// Print the udev rules that let the user at the PC open the devices.
    Udev,
    /// Print shell completions.
    Completions {
        /// For which shell.
        shell: clap_complete::Shell,
    },
    /// Print the manual page (roff).
    Man,
}

/// Who wears the headset, and how the body is worked out.
#[derive(Debug, Clone, Args)]
pub struct BodyArgs {
    /// Which tracker works out the body; the configured one where this is left out.
    #[arg(long, value_parser = parse_tracker)]
    pub tracker: Option<posed_tracker::TrackerKind>,
    /// Let physics have the last word: gravity, the floor, and feet that stand stay.
    #[arg(long)]
    pub physics: bool,
    /// The wearer's height in metres.
    #[arg(long, value_name = "METRES", value_parser = parse_height)]
    pub height: Option<f32>,
    /// Height of the body shown, in metres, where it is not the wearer's own.
    #[arg(long, value_name = "METRES", value_parser = parse_height)]
    pub avatar_height: Option<f32>,
    /// Where the base stations stand, in libsurvive's JSON; without it posed finds out by itself.
    #[arg(long, value_name = "FILE")]
    pub base_stations: Option<PathBuf>,
    /// Poses a second.
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    pub rate: Option<f64>,
    /// Configuration file, read after those of the system and the user.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// Files that poses are written to.
#[derive(Debug, Clone, Args)]
pub struct OutputArgs {
    /// Write every body pose as a line of JSON.
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// Write every device pose as a line of JSON.
    #[arg(long, value_name = "FILE")]
    pub devices: Option<PathBuf>,
}

/// Arguments of `posed run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// The body.
    #[command(flatten)]
    pub body: BodyArgs,
    /// The outputs.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Arguments of `posed replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Captures: usbmon or USBPcap, pcap or pcapng, gzip'd or not, hid-recorder text or
    /// libsurvive's recordings. Several
    /// are merged by time.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Times real time, or `max` for as fast as possible.
    #[arg(long, default_value = "1", value_parser = parse_speed)]
    pub speed: Speed,
    /// The body.
    #[command(flatten)]
    pub body: BodyArgs,
    /// The outputs.
    #[command(flatten)]
    pub output: OutputArgs,
    /// Serve the poses over gRPC, on the page and to the other outputs meanwhile.
    #[arg(long)]
    pub serve: bool,
    /// Begin again at the end, until Ctrl-C.
    #[arg(long = "loop", requires = "serve")]
    pub again: bool,
    /// Calibrate inertial trackers from a stance that the wearer holds so many seconds into the
    /// capture: straight, t-pose or crouch. May be given several times.
    #[arg(long, value_name = "STANCE@SECONDS", value_parser = parse_calibration)]
    pub calibrate: Vec<Calibration>,
    /// Print the summary as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `posed setup`.
#[derive(Debug, Args)]
pub struct SetupArgs {
    /// Captures of a set-up, to be done again; the devices on this PC where this is left out.
    #[arg(value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// The body.
    #[command(flatten)]
    pub body: BodyArgs,
    /// Where to keep the room; the state directory where this is left out.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Arguments of `posed inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// The capture.
    pub file: PathBuf,
    /// As JSON.
    #[arg(long)]
    pub json: bool,
}

/// Where base stations' poses come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Stations {
    /// The libsurvive JSON beside a capture, `NAME.json`, where there is one.
    Beside,
    /// The light alone.
    None,
}

/// Arguments of `posed survey`.
#[derive(Debug, Args)]
pub struct SurveyArgs {
    /// Captures, and folders that hold some.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Where the base stations' poses come from.
    #[arg(long, value_enum, default_value = "beside")]
    pub base_stations: Stations,
    /// As JSON.
    #[arg(long)]
    pub json: bool,
}

/// Formats that captures are written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum CaptureFormat {
    /// usbmon in pcap, link type 220; compressed where the name ends in `.gz`.
    Pcap,
    /// hid-recorder text.
    HidRecorder,
}

/// Arguments of `posed record`.
#[derive(Debug, Args)]
#[command(subcommand_negates_reqs = true, args_conflicts_with_subcommands = true)]
pub struct RecordArgs {
    /// Record the poses of a running posed instead.
    #[command(subcommand)]
    pub live: Option<RecordLive>,
    /// The capture to write.
    #[arg(long, value_name = "FILE", required = true)]
    pub out: Option<PathBuf>,
    /// Its format.
    #[arg(long, value_enum, default_value = "pcap")]
    pub format: CaptureFormat,
    /// Stop after so many seconds; otherwise at Ctrl-C.
    #[arg(long, value_name = "SECONDS")]
    pub seconds: Option<f64>,
}

/// Recording what a running posed publishes.
#[derive(Debug, Subcommand)]
pub enum RecordLive {
    /// Begin to write poses to a file in posed's folder for recordings.
    Start(RecordStartArgs),
    /// End the recording.
    Stop(ServerArgs),
}

/// Arguments of `posed record start`.
#[derive(Debug, Args)]
pub struct RecordStartArgs {
    /// poses (lines of JSON), bvh or glb.
    #[arg(long, default_value = "bvh", value_parser = parse_recording)]
    pub format: record::Format,
    /// The file's name, without folder and ending; the time of day where this is left out.
    #[arg(long)]
    pub name: Option<String>,
    /// What the joints are called: smpl, unity, vrm, mixamo or openxr; what programs expect of the
    /// format where this is left out.
    #[arg(long, value_parser = parse_names)]
    pub names: Option<Names>,
    /// Whom to ask.
    #[command(flatten)]
    pub server: ServerArgs,
}

/// Arguments of `posed export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// A capture, or a file of poses as `--poses` and recordings have them.
    pub file: PathBuf,
    /// bvh, or glb: glTF with VRM's human bones.
    #[arg(long, default_value = "bvh", value_parser = parse_motion)]
    pub format: export::Format,
    /// The file to write; beside the input where this is left out.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// What the joints are called: smpl, unity, vrm, mixamo or openxr; what programs expect of the
    /// format where this is left out.
    #[arg(long, value_parser = parse_names)]
    pub names: Option<Names>,
    /// The unit of BVH: cm or m.
    #[arg(long, default_value = "cm", value_parser = parse_unit)]
    pub unit: Unit,
    /// The body, where a capture is tracked.
    #[command(flatten)]
    pub body: BodyArgs,
}

/// A running posed.
#[derive(Debug, Clone, Args)]
pub struct ServerArgs {
    /// The server: a socket path or an address; the user's own socket where this is left out.
    #[arg(long, value_name = "SOCKET|ADDRESS")]
    pub server: Option<String>,
}

/// Arguments of `posed height`.
#[derive(Debug, Args)]
pub struct HeightArgs {
    /// Metres; asked for where this is left out.
    #[arg(value_name = "METRES", value_parser = parse_height)]
    pub height: Option<f32>,
    /// Height of the body shown: metres, or `own` for the wearer's own; as before where this is left
    /// out.
    #[arg(long, value_name = "METRES", requires = "height", value_parser = parse_avatar)]
    pub avatar: Option<Avatar>,
    /// Whom to ask.
    #[command(flatten)]
    pub server: ServerArgs,
}

/// Arguments of `posed tracker`.
#[derive(Debug, Args)]
pub struct TrackerArgs {
    /// The tracker; the list of them where this is left out.
    #[arg(value_parser = parse_tracker)]
    pub tracker: Option<posed_tracker::TrackerKind>,
    /// Whom to ask.
    #[command(flatten)]
    pub server: ServerArgs,
}

/// Arguments of `posed calibrate`.
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    /// t-pose: arms stretched out sideways, palms down; straight: arms hanging; both upright, feet
    /// together, looking straight ahead. crouch: as on skis, after one of the others.
    #[arg(default_value = "t-pose", value_parser = parse_stance)]
    pub stance: posed_tracker::Stance,
    /// Seconds to take the stance in.
    #[arg(long, value_name = "SECONDS", default_value_t = 5)]
    #[arg(value_parser = clap::value_parser!(u32).range(..=60))]
    pub seconds: u32,
    /// Whom to ask.
    #[command(flatten)]
    pub server: ServerArgs,
}

/// Arguments of `posed vibrate`.
#[derive(Debug, Args)]
pub struct VibrateArgs {
    /// Its role (left_hand) or its serial number.
    pub device: String,
    /// How long.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.3)]
    pub seconds: f32,
    /// How fast.
    #[arg(long, value_name = "HZ", default_value_t = 160.0)]
    pub frequency: f32,
    /// How strongly, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 1.0)]
    pub strength: f32,
    /// Whom to ask.
    #[command(flatten)]
    pub server: ServerArgs,
}

/// Base stations of a simulated room.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Room {
    /// One of generation 2.
    One,
    /// Two of generation 2 in opposite corners.
    Two,
    /// Four of generation 2, one in each corner.
    Four,
    /// Two of generation 1 in opposite corners.
    FirstGeneration,
}

/// What goes wrong in a simulated room.
#[derive(Debug, Args)]
pub struct RoomArgs {
    /// Which base stations there are.
    #[arg(long, value_enum, default_value = "two")]
    pub room: Room,
    /// The wearer's body does not stand in the light.
    #[arg(long)]
    pub no_occlusion: bool,
    /// Share of hits that are reflections, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value = "0.001", value_parser = parse_share)]
    pub reflections: f64,
    /// No device sees any light in this span, seconds. May be given several times.
    #[arg(long, value_name = "FROM-TO", value_parser = parse_span)]
    pub dark: Vec<Span>,
    /// Somebody moves the second base station by 30 cm and turns it by 6 degrees, at so many
    /// seconds.
    #[arg(long, value_name = "SECONDS")]
    pub move_station: Option<f64>,
    /// The second base station is switched on only then.
    #[arg(long, value_name = "SECONDS")]
    pub late_station: Option<f64>,
    /// The last base station is set to the first one's channel.
    #[arg(long)]
    pub share_channel: bool,
    /// Standard deviation of device clocks from 48 MHz, parts in a million.
    #[arg(long, value_name = "PPM", default_value_t = 20.0)]
    pub drift: f64,
    /// Share of their packets that controllers lose by radio, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value = "0.015", value_parser = parse_share)]
    pub radio_loss: f64,
}

/// Begin and end, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span(pub [f64; 2]);

fn parse_span(text: &str) -> Result<Span, String> {
    let wrong = || "give a begin and an end in seconds, as 3-3.2".to_owned();
    let (begin, end) = text.split_once('-').ok_or_else(wrong)?;
    let number = |text: &str| text.parse::<f64>().map_err(|_| wrong());
    let span = [number(begin)?, number(end)?];
    // NaN is before nothing.
    if span[0] < span[1] {
        Ok(Span(span))
    } else {
        Err(wrong())
    }
}

/// Arguments of `posed simulate`.
#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// A motion file (npz); the built-in walking human where this is left out.
    #[arg(long, value_name = "FILE", requires = "clip")]
    pub motion: Option<PathBuf>,
    /// The clip of the motion file.
    #[arg(long, value_name = "NAME", requires = "motion")]
    pub clip: Option<String>,
    /// The wearer's height in metres, for the built-in human.
    #[arg(long, value_name = "METRES", default_value = "1.75", value_parser = parse_height)]
    pub height: f32,
    /// Seconds, at most.
    #[arg(long, value_name = "SECONDS")]
    pub seconds: Option<f64>,
    /// Leave out headset and controllers.
    #[arg(long, requires = "trackers")]
    pub no_headset: bool,
    /// SlimeVR trackers that the wearer has on, behind one receiver: roles with commas between
    /// them, or `six` for pelvis, shanks, forearms and head.
    #[arg(long, value_name = "ROLES", value_parser = parse_roles)]
    pub trackers: Option<Roles>,
    /// Share of their packets that the trackers' receiver loses, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value = "0", value_parser = parse_share)]
    pub loss: f64,
    /// The room.
    #[command(flatten)]
    pub room: RoomArgs,
    /// Begin with the stances of a calibration: straight, t-pose and crouch, held around 1.5, 5.5
    /// and 9.5 s. The motion begins after 12 s.
    #[arg(long)]
    pub calibration: bool,
    /// Format of the capture.
    #[arg(long, value_enum, default_value = "pcap")]
    pub format: CaptureFormat,
    /// Seed of noise and motion.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// The capture to write; a pcap is compressed where its name ends in `.gz`.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Where to write the true poses, as lines of JSON.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Where to write the simulated base stations, in libsurvive's JSON.
    #[arg(long, value_name = "FILE")]
    pub base_stations: Option<PathBuf>,
}

/// Arguments of `posed follow`.
#[derive(Debug, Args)]
pub struct FollowArgs {
    /// Whom to follow.
    #[command(flatten)]
    pub server: ServerArgs,
    /// Print each pose as a line of JSON.
    #[arg(long)]
    pub json: bool,
    /// Stop after so many poses.
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
}

/// Arguments of `posed list`.
#[derive(Debug, Args)]
pub struct ListArgs {
    /// As JSON.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `posed eval`.
#[derive(Debug, Args)]
pub struct EvalArgs {
    /// Motion set (npz); several are evaluated together.
    #[arg(long, required = true, value_name = "FILE")]
    pub data: Vec<PathBuf>,
    /// Which clips of it: train, val, test, cross or ood.
    #[arg(long, default_value = "test")]
    pub split: String,
    /// Only this clip.
    #[arg(long, value_name = "NAME")]
    pub clip: Option<String>,
    /// Which tracker.
    #[arg(long, default_value = "ik", value_parser = parse_tracker)]
    pub tracker: posed_tracker::TrackerKind,
    /// What the wearer has on: hmd, hmd+controllers, hmd+hands or imu6.
    #[arg(long, default_value = "hmd+controllers", value_parser = parse_sensors)]
    pub sensors: posed_tracker::eval::Sensors,
    /// How the sensors of imu6 sit: exact, or worn (off their place, calibrated and drifting as
    /// real ones are).
    #[arg(long, default_value = "exact", value_parser = parse_straps)]
    pub straps: posed_tracker::eval::Straps,
    /// Whose bones the tracker is told: the clip's own, or average ones of the height.
    #[arg(long, default_value = "clip", value_parser = parse_bones)]
    pub bones: posed_tracker::eval::Bones,
    /// Let the physics optimiser have the last word.
    #[arg(long)]
    pub physics: bool,
    /// Another model (ONNX) than the built-in one, with the same inputs and outputs.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Leave a part of PIP out, for comparison: dual-pd (joints' positions are not controlled) or
    /// physics.
    #[arg(long, value_name = "PART", value_parser = parse_without)]
    pub without: Option<posed_tracker::pip::Physics>,
    /// Leave a network's answer as it is: hung from the head, not moved to meet the hands.
    #[arg(long)]
    pub unrefined: bool,
    /// Ask a network only once, not of the mirror image as well.
    #[arg(long)]
    pub unmirrored: bool,
    /// Go the whole way through USB traffic of simulated devices, and compare with ideal sensors.
    #[arg(long, conflicts_with_all = ["lookahead", "dump", "plot"])]
    pub usb: bool,
    /// Join clips into one input of so many minutes, with hands that come and go, and compare
    /// with a tracker that is reset at every clip.
    #[arg(long, value_name = "MINUTES", conflicts_with_all = ["usb", "lookahead", "dump", "plot"])]
    pub continuous: Option<f64>,
    /// Make the movers so tall, in metres, their motion scaled with them.
    #[arg(long, value_name = "METRES", value_parser = parse_height)]
    pub stature: Option<f32>,
    /// What tells a clip's kind of motion: its name, or gait: stand, walk, jog or other, by how the
    /// mover moves.
    #[arg(long, default_value = "name", value_parser = parse_kinds)]
    pub kinds: posed_tracker::eval::Kinds,
    /// Only every so many clips.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub every: u32,
    /// Ticks by which the answer may lag the newest sample.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub lookahead: u32,
    /// Ticks a second.
    #[arg(long, value_name = "HZ", default_value = "60", value_parser = parse_rate)]
    pub rate: f64,
    /// Threads; as many as there are cores where this is left out.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Write every figure, by clip, by kind of motion and in all.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write the predicted and the true motion (npz).
    #[arg(long, value_name = "FILE")]
    pub dump: Option<PathBuf>,
    /// Write a page with curves, foot contacts and skeletons (HTML).
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}

/// Arguments of `posed demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Stop after so many seconds.
    #[arg(long, value_name = "SECONDS")]
    pub seconds: Option<f64>,
    /// Begin again at the end, until Ctrl-C or the seconds are over.
    #[arg(long = "loop")]
    pub again: bool,
    /// Listen here as well as on the demo's own socket.
    #[arg(long, value_name = "ADDRESS")]
    pub listen: Option<SocketAddr>,
    /// Serve the live page here.
    #[arg(long, value_name = "ADDRESS")]
    pub page: Option<SocketAddr>,
}

/// How fast to replay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Speed {
    /// Times real time.
    Times(f64),
    /// Without waiting.
    Max,
}

fn parse_without(text: &str) -> Result<posed_tracker::pip::Physics, String> {
    use posed_tracker::pip::Physics;
    match text {
        "dual-pd" => Ok(Physics::RotationsOnly),
        "physics" => Ok(Physics::Off),
        _ => Err("give dual-pd or physics".into()),
    }
}

/// A stance, and when it is held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Which stance.
    pub stance: Stance,
    /// Seconds from the first packet.
    pub seconds: f64,
}

fn parse_calibration(text: &str) -> Result<Calibration, String> {
    let wrong = || "give a stance and a time, as t-pose@5".to_owned();
    let (stance, seconds) = text.split_once('@').ok_or_else(wrong)?;
    let names = || format!("there are {}", Stance::ALL.map(Stance::name).join(", "));
    Ok(Calibration {
        stance: Stance::from_name(stance).ok_or_else(names)?,
        seconds: seconds.parse().map_err(|_| wrong())?,
    })
}

/// Roles of trackers.
#[derive(Debug, Clone, PartialEq)]
pub struct Roles(pub Vec<Role>);

fn parse_roles(text: &str) -> Result<Roles, String> {
    if text == "six" {
        return Ok(Roles(crate::simulated::SIX.to_vec()));
    }
    let role = |name: &str| {
        let known = Role::from_name(name).filter(|role| crate::simulated::carries(*role));
        known.ok_or_else(|| format!("no tracker is worn on {name:?}"))
    };
    let roles: Vec<Role> = text.split(',').map(role).collect::<Result<_, _>>()?;
    Ok(Roles(roles))
}

fn parse_share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(share) if (0.0..=1.0).contains(&share) => Ok(share),
        _ => Err("give a share from 0 to 1".into()),
    }
}

fn parse_speed(text: &str) -> Result<Speed, String> {
    if text == "max" {
        return Ok(Speed::Max);
    }
    match text.parse::<f64>() {
        Ok(times) if (0.01..=1000.0).contains(&times) => Ok(Speed::Times(times)),
        _ => Err("give a number from 0.01 to 1000, or max".into()),
    }
}

fn parse_height(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(height) if (1.0..=2.5).contains(&height) => Ok(height),
        _ => Err("give metres, from 1.0 to 2.5".into()),
    }
}

fn parse_avatar(text: &str) -> Result<Avatar, String> {
    match text {
        "own" => Ok(Avatar::Own),
        _ => parse_height(text).map(Avatar::Metres),
    }
}

fn parse_rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(rate) if (10.0..=1000.0).contains(&rate) => Ok(rate),
        _ => Err("give poses a second, from 10 to 1000".into()),
    }
}

fn parse_straps(text: &str) -> Result<posed_tracker::eval::Straps, String> {
    use posed_tracker::eval::Straps;
    let names = || Straps::ALL.map(Straps::name).join(", ");
    Straps::from_name(text).ok_or_else(|| format!("there are {}", names()))
}

fn parse_recording(text: &str) -> Result<record::Format, String> {
    let names = || record::Format::ALL.map(record::Format::name).join(", ");
    record::Format::from_name(text).ok_or_else(|| format!("there are {}", names()))
}

fn parse_motion(text: &str) -> Result<export::Format, String> {
    export::Format::from_name(text).ok_or_else(|| "give bvh or glb".into())
}

fn parse_names(text: &str) -> Result<Names, String> {
    let names = || Names::ALL.map(Names::name).join(", ");
    Names::from_name(text).ok_or_else(|| format!("there are {}", names()))
}

fn parse_unit(text: &str) -> Result<Unit, String> {
    match text {
        "cm" => Ok(Unit::Centimetres),
        "m" => Ok(Unit::Metres),
        _ => Err("give cm or m".into()),
    }
}

fn parse_stance(text: &str) -> Result<posed_tracker::Stance, String> {
    posed_tracker::Stance::from_name(text).ok_or_else(|| "give t-pose, straight or crouch".into())
}

fn parse_sensors(text: &str) -> Result<posed_tracker::eval::Sensors, String> {
    use posed_tracker::eval::Sensors;
    let names = || Sensors::ALL.map(Sensors::name).join(", ");
    Sensors::from_name(text).ok_or_else(|| format!("there are {}", names()))
}

fn parse_bones(text: &str) -> Result<posed_tracker::eval::Bones, String> {
    let unknown = || "give clip or height".to_owned();
    posed_tracker::eval::Bones::from_name(text).ok_or_else(unknown)
}

fn parse_kinds(text: &str) -> Result<posed_tracker::eval::Kinds, String> {
    let unknown = || "give name or gait".to_owned();
    posed_tracker::eval::Kinds::from_name(text).ok_or_else(unknown)
}

fn parse_tracker(text: &str) -> Result<posed_tracker::TrackerKind, String> {
    posed_tracker::TrackerKind::from_name(text).ok_or_else(|| {
        let names = posed_tracker::TrackerKind::ALL.map(posed_tracker::TrackerKind::name);
        format!("there are {}", names.join(", "))
    })
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_capture_is_recorded_or_poses_are() {
        let record = |line: &str| {
            let Command::Record(args) = Cli::try_parse_from(line.split(' '))?.command else {
                panic!("{line}");
            };
            Ok::<_, clap::Error>(args)
        };
        assert!(record("posed record").is_err());
        let capture = record("posed record --out a.pcap").unwrap();
        assert!(capture.live.is_none() && capture.out.is_some());
        let start = record("posed record start --format glb --names unity").unwrap();
        assert!(matches!(start.live, Some(RecordLive::Start(args))
            if args.names == Some(Names::Unity) && args.format.name() == "glb"));
        assert!(record("posed record stop --server 127.0.0.1:1").is_ok());
        assert!(record("posed record --out a.pcap stop").is_err());
    }

    #[test]
    fn speeds_are_checked() {
        assert_eq!(parse_speed("max"), Ok(Speed::Max));
        assert_eq!(parse_speed("2.5"), Ok(Speed::Times(2.5)));
        assert!(parse_speed("0").is_err() && parse_speed("NaN").is_err());
        assert_eq!(parse_span("3-3.2"), Ok(Span([3.0, 3.2])));
        for wrong in ["3", "3-", "4-3", "-1-2", "NaN-5"] {
            assert!(parse_span(wrong).is_err(), "{wrong}");
        }
    }
}
