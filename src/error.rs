//! One error type. Every message names the place (file, line, element) and what to do about it.

use std::path::{Path, PathBuf};

/// What went wrong, in terms a user can act on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be opened, read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's word.
        source: std::io::Error,
    },
    /// A file's content is not what its format allows.
    #[error("{}: {place}: {problem}; {remedy}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Where in it: "line 12", "face 7", "header".
        place: String,
        /// What is wrong there.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A mesh or a parameter violates a precondition.
    #[error("{problem}; {remedy}")]
    Input {
        /// What is wrong, with the element it is wrong at.
        problem: String,
        /// What the caller can do.
        remedy: String,
    },
    /// No adapter, a lost device, an allocation that failed, a shader that does not compile.
    #[error("{problem}; {remedy}")]
    Device {
        /// What the device or driver said.
        problem: String,
        /// What to try.
        remedy: String,
    },
}

impl Error {
    /// A violated precondition, and what to do about it.
    pub fn input(problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Input {
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// Malformed content of a file, at a place in it.
    pub fn file(
        path: &Path,
        place: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::File {
            path: path.into(),
            place: place.into(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// A failure of the operating system on a file.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io {
            path: path.into(),
            source,
        }
    }

    /// A failure of the GPU or its driver.
    pub fn device(problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Device {
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }
}

/// What is wrong in some content, before it is known which file, if any, the content came from.
#[derive(Debug, Clone, PartialEq)]
pub struct Defect {
    /// Where: "line 12", "face 7", "header".
    pub place: String,
    /// What is wrong there.
    pub problem: String,
    /// What the user can do.
    pub remedy: String,
}

impl Defect {
    /// A defect at a place, and what to do about it.
    pub fn new(
        place: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            place: place.into(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// The error of the file that the content came from.
    pub fn in_file(self, path: &Path) -> Error {
        Error::file(path, self.place, self.problem, self.remedy)
    }
}

impl From<Defect> for Error {
    fn from(defect: Defect) -> Self {
        let Defect {
            place,
            problem,
            remedy,
        } = defect;
        Self::input(format!("{place}: {problem}"), remedy)
    }
}

/// `std::result::Result` with [`enum@Error`] unless told otherwise.
pub type Result<T, E = Error> = std::result::Result<T, E>;
