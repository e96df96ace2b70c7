//! How commands read volume meshes.

use super::session::Session;
use std::path::Path;
use vorofit::Result;
use vorofit::files::{Pyramids, Volume, read_volume};

/// What to make of a file's cells.
#[derive(Debug, clap::Args)]
pub struct Reading {
    /// Leave out pyramids, which are not supported: where they were is a hole, whose sides are boundary like any other
    #[arg(long)]
    drop_pyramids: bool,
}

impl Reading {
    /// Whether a choice was made.
    pub fn drops_pyramids(&self) -> bool {
        self.drop_pyramids
    }

    /// The volume in a file; what was put right there is told.
    pub fn read(&self, session: &Session, path: &Path) -> Result<Volume> {
        let pyramids = if self.drop_pyramids {
            Pyramids::LeftOut
        } else {
            Pyramids::Refused
        };
        let volume = read_volume(path, pyramids)?;
        if !volume.warnings.is_empty() {
            let warnings = volume.warnings.join(", ");
            session
                .terminal
                .warn(&format!("{}: {warnings}", path.display()));
        }
        Ok(volume)
    }
}
