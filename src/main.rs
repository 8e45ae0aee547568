//! The command `limpid`: parse, call one command, print the error.
#![deny(unsafe_code)]
#![warn(missing_docs)]

mod cli;

use clap::Parser;
use std::io::Write;
use std::process::ExitCode;

fn main() -> ExitCode {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("error")).init();
    let parsed = match cli::Cli::try_parse() {
        Ok(parsed) => parsed,
        Err(error) => return refuse(&error),
    };
    match run(&parsed) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            complain(&error.to_string());
            ExitCode::from(error.downcast_ref::<limpid::Error>().map_or(1, limpid::Error::exit_code))
        }
    }
}

fn run(parsed: &cli::Cli) -> anyhow::Result<u8> {
    Ok(cli::run(parsed)?)
}

/// Help and version go to standard output; any other refusal of the arguments becomes one line.
fn refuse(error: &clap::Error) -> ExitCode {
    if !error.use_stderr() || error.kind() == clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        // Nothing can be done where the stream is closed.
        let _ = error.print();
        return ExitCode::from(error.exit_code() as u8);
    }
    complain(&cli::one_line(&error.render().to_string()));
    ExitCode::from(2)
}

fn complain(message: &str) {
    let message = message.lines().collect::<Vec<_>>().join(" ");
    let _ = writeln!(std::io::stderr(), "error: {message}");
}
