//! What all commands share: the options that every command takes, made into a device, a terminal and a place for the report.

use super::terminal::{Terminal, complain};
use clap::ValueEnum;
use std::cell::OnceCell;
use std::io::Write;
use std::path::{Path, PathBuf};
use vorofit::device::{Device, DeviceChoice};
use vorofit::files::check_place;
use vorofit::report::{DeviceReport, Report};
use vorofit::{Error, Result};

/// Options of every command.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Options of every command")]
pub struct Common {
    /// Where to compute: `auto` takes a hardware GPU where there is one and the CPU otherwise; `gpu` also accepts a software adapter
    #[arg(
        long,
        global = true,
        value_enum,
        default_value_t,
        hide_possible_values = true,
        value_name = "auto|cpu|gpu"
    )]
    device: Choice,
    /// Take the adapter whose name contains this (see `vorofit devices`)
    #[arg(long, global = true, value_name = "NAME")]
    adapter: Option<String>,
    /// CPU threads [default: all]
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// Write a report as JSON to a file, or to stdout in place of the text
    #[arg(long, global = true, value_name = "FILE|-")]
    json: Option<PathBuf>,
    /// Show no progress and no summary
    #[arg(long, short, global = true)]
    quiet: bool,
    /// Say more; twice for more still
    #[arg(long, short, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
}

#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum Choice {
    #[default]
    Auto,
    Cpu,
    Gpu,
}

/// A running command's surroundings.
pub struct Session {
    /// Draws progress and warnings.
    pub terminal: Terminal,
    /// What the user asks for.
    pub choice: DeviceChoice,
    /// The adapter that the user names.
    pub adapter: Option<String>,
    json: Option<PathBuf>,
    quiet: bool,
    device: OnceCell<Device>,
}

impl Session {
    /// Applies the options, and checks that the report can be written.
    pub fn start(common: &Common) -> Result<Self> {
        start_log(common.verbose);
        if let Some(threads) = common.threads {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads.into())
                .build_global()
                .map_err(|e| Error::input(format!("{threads} threads: {e}"), "use fewer"))?;
        }
        let session = Self {
            terminal: Terminal::new(common.quiet),
            choice: match common.device {
                Choice::Auto => DeviceChoice::Auto,
                Choice::Cpu => DeviceChoice::Cpu,
                Choice::Gpu => DeviceChoice::Gpu,
            },
            adapter: common.adapter.clone(),
            json: common.json.clone(),
            quiet: common.quiet,
            device: OnceCell::new(),
        };
        if let Some(path) = session.json_file() {
            check_place(path)?;
        }
        Ok(session)
    }

    /// The device of this run, chosen at the first call.
    ///
    /// # Errors
    /// Where a GPU was asked for and there is none.
    pub fn device(&self) -> Result<&Device> {
        if let Some(device) = self.device.get() {
            return Ok(device);
        }
        let device = Device::choose(self.choice, self.adapter.as_deref())?;
        log::info!("running on {}", DeviceReport::of(&device));
        Ok(self.device.get_or_init(|| device))
    }

    /// The options by which the device was asked for.
    pub fn device_options(&self) -> String {
        let choice = match self.choice {
            DeviceChoice::Auto => "--device auto",
            DeviceChoice::Cpu => "--device cpu",
            DeviceChoice::Gpu => "--device gpu",
        };
        match &self.adapter {
            Some(name) => format!("{choice} --adapter {name}"),
            None => choice.into(),
        }
    }

    /// The file of the report, if any.
    fn json_file(&self) -> Option<&Path> {
        self.json.as_deref().filter(|path| *path != Path::new("-"))
    }

    /// Writes the report where it was asked for, and the summary to stdout unless the report went there.
    ///
    /// # Errors
    /// Where either cannot be written.
    pub fn finish(&self, report: &Report, summary: &str) -> Result<()> {
        if let Some(path) = self.json_file() {
            report.write(path)?;
        } else if self.json.is_some() {
            return print(&report.to_json()?);
        }
        match self.quiet {
            true => Ok(()),
            false => print(summary),
        }
    }
}

/// Writes to stdout. A reader that has gone away is none of our business.
fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Error::io(Path::new("stdout"), e))
        }
        _ => Ok(()),
    }
}

/// Warnings always, more on request, in the form of this program's own; `RUST_LOG` overrides.
fn start_log(verbose: u8) {
    let default = [
        "vorofit=warn",
        "vorofit=info",
        "vorofit=debug,wgpu=warn",
        "debug",
    ];
    let filter = default[usize::from(verbose).min(default.len() - 1)];
    let environment = env_logger::Env::default().default_filter_or(filter);
    env_logger::Builder::from_env(environment)
        .format(|_, record| {
            let level = match record.level() {
                log::Level::Warn => "warning".into(),
                level => level.as_str().to_lowercase(),
            };
            complain(&level, &record.args().to_string());
            Ok(())
        })
        .init();
}
