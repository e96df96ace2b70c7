//! The files that a command is to write, checked before the work.

use std::path::{Path, PathBuf};
use vorofit::files::{SurfaceToWrite, check_place, check_writable};
use vorofit::mesh::{ControlMesh, PolygonMesh, Scheme, shapes};
use vorofit::{Error, Result};

/// The files to write.
#[derive(Debug, Default)]
pub struct Outputs {
    pub control: Vec<PathBuf>,
    pub surface: Vec<PathBuf>,
}

impl Outputs {
    /// Refuses, before any work, what could not be written after it, and what would replace an input.
    pub fn check(&self, scheme: Scheme, inputs: &[&Path]) -> Result<()> {
        let triangle: PolygonMesh = shapes::sphere(1.0, 0).into();
        let control = ControlMesh::from(triangle.clone());
        for path in &self.control {
            check_writable(path, &SurfaceToWrite::control(&control, scheme))?;
        }
        for path in &self.surface {
            check_writable(path, &SurfaceToWrite::dense(&triangle, None))?;
        }
        refuse_clashes(self.control.iter().chain(&self.surface), inputs)
    }

    /// Refuses, before the fit, files that could not hold the creases and corners of the template.
    pub fn check_sharp(&self, template: Option<&ControlMesh>, scheme: Scheme) -> Result<()> {
        let Some(control) = template else {
            return Ok(());
        };
        let mut example = ControlMesh::from(PolygonMesh::from(shapes::sphere(1.0, 0)));
        if !(control.creases.is_empty() && control.corners.is_empty()) {
            example.corners = vec![0];
        }
        let surface = SurfaceToWrite::control(&example, scheme);
        self.control
            .iter()
            .try_for_each(|path| check_writable(path, &surface))
    }
}

/// Refuses output files that cannot be made, that would replace an input, or that are given twice.
pub fn refuse_clashes<'a>(
    outputs: impl Iterator<Item = &'a PathBuf>,
    inputs: &[&Path],
) -> Result<()> {
    let all: Vec<&PathBuf> = outputs.collect();
    for (k, path) in all.iter().enumerate() {
        check_place(path)?;
        if inputs.iter().any(|input| is_same_file(input, path)) {
            return Err(refused(path, "it is also an input"));
        }
        if all[..k].contains(path) {
            return Err(refused(path, "it is given twice"));
        }
    }
    Ok(())
}

fn is_same_file(a: &Path, b: &Path) -> bool {
    let resolved = |path: &Path| std::fs::canonicalize(path).ok();
    resolved(a).is_some_and(|a| resolved(b) == Some(a))
}

fn refused(path: &Path, problem: &str) -> Error {
    Error::file(path, "output", problem, "give another name")
}
