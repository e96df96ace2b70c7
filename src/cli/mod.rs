//! The command line: one file a command, each parses, calls the library and prints. No numerics.
//!
//! Results go to files and stdout, progress and warnings to stderr. Exit status: 0 done, 1 failed (one line on stderr), 2 bad usage,
//! 130 interrupted.

mod bench;
mod check;
mod choices;
mod compare;
mod demo;
mod devices;
mod features;
mod fit;
mod job;
mod optimize;
mod outputs;
mod render;
mod session;
mod shell;
mod summary;
mod template;
mod terminal;
mod text;
mod volume;
mod volume_file;

use clap::{Parser, Subcommand};
use session::{Common, Session};
use std::process::ExitCode;
use terminal::complain;

/// Fits subdivision and polygon surfaces to 3D scans.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100, after_help = "Start with: vorofit demo")]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Subcommand)]
enum Command {
    Fit(Box<fit::Args>),
    Volume(Box<volume::Args>),
    Optimize(optimize::Args),
    Shell(shell::Args),
    Demo(demo::Args),
    Features(features::Args),
    Compare(compare::Args),
    Template(Box<template::Args>),
    Render(render::Args),
    Check(check::Args),
    Devices(devices::Args),
    Bench(bench::Args),
}

/// How a command ended that did not fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Done,
    /// The best result so far has been written.
    Interrupted,
}

/// Runs the program.
pub fn main() -> ExitCode {
    quiet_drivers();
    let Cli { command, common } = Cli::parse();
    let run = || {
        let session = Session::start(&common)?;
        match &command {
            Command::Fit(args) => args.run(&session),
            Command::Volume(args) => args.run(&session),
            Command::Optimize(args) => args.run(&session),
            Command::Shell(args) => args.run(&session),
            Command::Demo(args) => args.run(&session),
            Command::Features(args) => args.run(&session),
            Command::Compare(args) => args.run(&session),
            Command::Template(args) => args.run(&session),
            Command::Render(args) => args.run(&session),
            Command::Check(args) => args.run(&session),
            Command::Devices(args) => args.run(&session),
            Command::Bench(args) => args.run(&session),
        }
    };
    match run() {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Interrupted) => ExitCode::from(130),
        Err(error) => {
            complain("error", &error.to_string());
            ExitCode::FAILURE
        }
    }
}

/// Ends the program as clap does where options contradict each other.
fn bad_usage(message: &str) -> ! {
    use clap::CommandFactory;
    Cli::command()
        .error(clap::error::ErrorKind::ArgumentConflict, message)
        .exit()
}

/// Mesa complains on stderr, under the word "error", where there is no private runtime directory, as on servers and in containers.
fn quiet_drivers() {
    const VARIABLE: &str = "XDG_RUNTIME_DIR";
    if cfg!(target_os = "linux") && std::env::var_os(VARIABLE).is_none() {
        // SAFETY: this is the only thread yet.
        unsafe { std::env::set_var(VARIABLE, std::env::temp_dir()) };
    }
}
