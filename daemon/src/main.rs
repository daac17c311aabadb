//! The `posed` program.

use std::{
    io::{self, IsTerminal as _},
    process::ExitCode,
};

use clap::{CommandFactory as _, Parser as _};
use posed::{
    cli::{Cli, Command, RecordLive},
    commands::{self, CommandError, control},
};
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    let cli = Cli::parse();
    if let Err(error) = start_log(cli.log.as_deref()) {
        eprintln!("error: {error}");
        return ExitCode::from(2);
    }
    match run(&cli.command) {
        Ok(()) => ExitCode::SUCCESS,
        // Whoever read the output has seen enough: `posed inspect ... | head`.
        Err(CommandError::Io(error)) if error.kind() == io::ErrorKind::BrokenPipe => {
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(command: &Command) -> Result<(), CommandError> {
    match command {
        Command::Run(args) => commands::run::run(args),
        Command::Replay(args) => commands::replay::run(args),
        Command::Setup(args) => commands::setup::run(args),
        Command::Inspect(args) => commands::inspect::run(args),
        Command::Survey(args) => commands::survey::run(args),
        Command::Record(args) => match &args.live {
            None => commands::record::run(args),
            Some(RecordLive::Start(args)) => control::start_recording(args),
            Some(RecordLive::Stop(args)) => control::stop_recording(args),
        },
        Command::Export(args) => commands::export::run(args),
        Command::Reset(args) => control::reset(args),
        Command::Height(args) => control::height(args),
        Command::Tracker(args) => control::tracker(args),
        Command::Calibrate(args) => control::calibrate(args),
        Command::Vibrate(args) => commands::vibrate::run(args),
        Command::Simulate(args) => commands::simulate::run(args),
        Command::Follow(args) => commands::follow::run(args),
        Command::List(args) => commands::list::run(args),
        Command::Eval(args) => commands::eval::run(args),
        Command::Demo(args) => commands::demo::run(args),
        Command::Udev => {
            print!("{}", posed_device::catalog::udev_rules());
            Ok(())
        }
        Command::Completions { shell } => {
            clap_complete::generate(*shell, &mut Cli::command(), "posed", &mut io::stdout());
            Ok(())
        }
        Command::Man => Ok(clap_mangen::Man::new(Cli::command()).render(&mut io::stdout())?),
    }
}

/// Logs go to standard error. `--log` wins over `RUST_LOG`.
fn start_log(filter: Option<&str>) -> Result<(), String> {
    let filter = match filter {
        Some(text) => EnvFilter::try_new(text).map_err(|error| format!("--log {text}: {error}"))?,
        None => EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info")),
    };
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        .with_target(false)
        .with_ansi(io::stderr().is_terminal())
        .init();
    Ok(())
}
