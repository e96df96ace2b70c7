//! The events of a run. The library emits them through [`Progress`]; whoever embeds it draws them.
//!
//! Long work asks [`Progress::interrupted`] between steps and then returns the best it has.

/// Something that happened in a run.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Event<'a> {
    /// A stage of known length begins; `steps` is an upper bound.
    Stage {
        /// What is being done, in a few words.
        name: &'a str,
        /// How many steps it may take; 0 where unknown.
        steps: usize,
    },
    /// A step of the current stage is done.
    Step {
        /// Steps done in this stage.
        done: usize,
        /// The figure that the stage drives down (energy, error), if any.
        value: Option<f64>,
    },
    /// Something the user should know, that does not stop the run.
    Warning(&'a str),
}

/// Receives the events of a run.
pub trait Progress: Sync {
    /// Called on the thread that runs the work; must return quickly.
    fn event(&self, event: Event<'_>);

    /// Whether the run should stop at the next safe point with the best result so far.
    fn interrupted(&self) -> bool {
        false
    }
}

/// Ignores everything and never interrupts.
pub struct Silent;

impl Progress for Silent {
    fn event(&self, _: Event<'_>) {}
}
