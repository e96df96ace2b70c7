//! What is written to stderr: bars with rates and time left on a terminal, plain lines elsewhere; warnings on both.
//!
//! Also where Ctrl-C arrives: the first asks the work to stop, the second ends the program.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use vorofit::progress::{Event, Progress};
use vorofit::{Error, Result};

/// Plain lines about one stage are this far apart.
const BETWEEN_LINES: Duration = Duration::from_secs(5);

const BAR: &str = "{msg:36} {bar:24} {pos:>3}/{len} {per_sec:>8}, at most {eta} left";
const SPINNER: &str = "{msg:36} {spinner} {elapsed}";

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// One line on stderr: what sort of message, and the message. A closed stderr is no reason to fail.
pub fn complain(sort: &str, message: &str) {
    let message = message.split_whitespace().collect::<Vec<_>>().join(" ");
    let _ = writeln!(std::io::stderr(), "{sort}: {message}");
}

/// Asks running work to stop at the first Ctrl-C (or a request to terminate), and ends the program at the second.
///
/// # Errors
/// Where the system refuses the handler.
pub fn catch_interrupts() -> Result<()> {
    ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        complain(
            "interrupted",
            "writing the best so far; once more to give up at once",
        );
    })
    .map_err(|e| Error::input(format!("Ctrl-C cannot be caught: {e}"), "try again"))
}

/// Draws the events of a run.
pub struct Terminal {
    manner: Manner,
    stage: Mutex<Option<Stage>>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Manner {
    Silent,
    Lines,
    Bars,
}

struct Stage {
    name: String,
    steps: usize,
    begun: Instant,
    last_line: Instant,
    bar: Option<ProgressBar>,
}

impl Terminal {
    /// For this process's stderr.
    pub fn new(quiet: bool) -> Self {
        let manner = match (quiet, std::io::stderr().is_terminal()) {
            (true, _) => Manner::Silent,
            (false, true) => Manner::Bars,
            (false, false) => Manner::Lines,
        };
        Self {
            manner,
            stage: Mutex::default(),
        }
    }

    /// Announces a stage of unknown length.
    pub fn stage(&self, name: &str) {
        self.event(Event::Stage { name, steps: 0 });
    }

    /// Says something that the user should know.
    pub fn warn(&self, message: &str) {
        self.event(Event::Warning(message));
    }

    /// Takes the bar away: what follows is the result.
    pub fn clear(&self) {
        self.end(&mut self.current());
    }

    fn current(&self) -> MutexGuard<'_, Option<Stage>> {
        self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn end(&self, stage: &mut Option<Stage>) {
        if let Some(bar) = stage.take().and_then(|stage| stage.bar) {
            bar.finish_and_clear();
        }
    }

    fn begin(&self, stage: &mut Option<Stage>, name: &str, steps: usize) {
        self.end(stage);
        if self.manner == Manner::Lines {
            let _ = writeln!(std::io::stderr(), "{name}");
        }
        let now = Instant::now();
        *stage = Some(Stage {
            name: name.into(),
            steps,
            begun: now,
            last_line: now,
            bar: (self.manner == Manner::Bars).then(|| bar(name, steps)),
        });
    }
}

impl Progress for Terminal {
    fn event(&self, event: Event<'_>) {
        let mut stage = self.current();
        match event {
            Event::Stage { name, steps } => self.begin(&mut stage, name, steps),
            Event::Step { done, .. } => {
                if let Some(stage) = stage.as_mut() {
                    stage.step(done, self.manner);
                }
            }
            Event::Warning(message) => match stage.as_ref().and_then(|s| s.bar.as_ref()) {
                Some(bar) => bar.suspend(|| complain("warning", message)),
                None => complain("warning", message),
            },
            _ => (),
        }
    }

    fn interrupted(&self) -> bool {
        INTERRUPTED.load(Ordering::Relaxed)
    }
}

impl Stage {
    fn step(&mut self, done: usize, manner: Manner) {
        if let Some(bar) = &self.bar {
            bar.set_position(done as u64);
        }
        if manner == Manner::Lines && self.last_line.elapsed() >= BETWEEN_LINES {
            self.last_line = Instant::now();
            let rate = done as f64 / self.begun.elapsed().as_secs_f64();
            let left = self.steps.saturating_sub(done) as f64 / rate;
            let _ = writeln!(
                std::io::stderr(),
                "{}: step {done} of {}, {rate:.1}/s, at most {left:.0} s left",
                self.name,
                self.steps
            );
        }
    }
}

fn bar(name: &str, steps: usize) -> ProgressBar {
    let (bar, template) = match steps {
        0 => (ProgressBar::new_spinner(), SPINNER),
        _ => (ProgressBar::new(steps as u64), BAR),
    };
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.set_style(style);
    bar.set_message(name.to_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
