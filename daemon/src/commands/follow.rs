//! `posed follow`.

use std::io::{self, BufWriter};

use super::CommandError;
use crate::{
    cli::FollowArgs,
    clock::Monotonic,
    follow::{Format, Printer, follow},
};

/// Follows the pose of a running posed until Ctrl-C, its end, or the number of poses asked for.
///
/// # Errors
/// No posed answers, or the output cannot be written.
pub fn run(args: &FollowArgs) -> Result<(), CommandError> {
    let server = args.server.server()?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let (format, output) = if args.json {
        (
            Format::Json,
            Box::new(BufWriter::new(io::stdout())) as Box<dyn io::Write>,
        )
    } else {
        (Format::Text, Box::new(io::stdout()) as Box<dyn io::Write>)
    };
    let mut output = output;
    let mut printer = Printer::new(format, &mut *output);
    let stop = async {
        let _ = tokio::signal::ctrl_c().await;
    };
    let summary = runtime.block_on(follow(&server, Monotonic, &mut printer, args.count, stop))?;
    eprintln!("{summary}");
    Ok(())
}
