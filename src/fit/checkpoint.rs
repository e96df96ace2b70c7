//! Where a fit stands between two phases, in a file: a fit that was interrupted goes on from there and ends with the same bits.
//!
//! A phase starts from the positions of the control points alone, and what comes before it (template, subdivisions, target, samples) follows
//! from the input. So positions and the number of phases done are the whole state; a phase that was cut short is run again.
//! The text is JSON, whose numbers keep all bits here.

use super::Target;
use super::record::Iteration;
use super::start::Start;
use super::voronoi::Options;
use crate::error::{Error, Result};
use crate::files::write_whole;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The layout of the file.
const SCHEMA: &str = "vorofit.checkpoint/1";

/// The state of a fit after some of its phases.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    schema: String,
    /// Of the program: another version may have another schedule.
    version: String,
    /// What the state depends on, as [`fingerprint`].
    fingerprint: u64,
    /// Phases done.
    pub(super) phases: usize,
    /// `[control points]`, unit frame.
    positions: Vec<[f64; 3]>,
    pub(super) iterations: Vec<Iteration>,
    pub(super) stages: Vec<(String, f64)>,
    /// The file that it was read from.
    #[serde(skip)]
    path: PathBuf,
}

/// Where a fit goes on from, and where it leaves its checkpoints.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Checkpoints {
    /// Go on from here.
    pub resume: Option<Checkpoint>,
    /// Written, whole or not at all, before the first phase and after every one.
    pub file: Option<PathBuf>,
}

impl Checkpoint {
    /// Reads a checkpoint.
    ///
    /// # Errors
    /// Where the file cannot be read, or is no checkpoint of this version.
    pub fn read(path: &Path) -> Result<Self> {
        let refused = |place: String, problem: String| {
            Error::file(path, place, problem, "start the fit without --resume")
        };
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
        let mut read: Self = serde_json::from_slice(&bytes).map_err(|e| {
            let place = format!("line {}", e.line());
            refused(place, format!("it is no checkpoint of a fit ({e})"))
        })?;
        let [ours, theirs] = [
            [SCHEMA, env!("CARGO_PKG_VERSION")],
            [&read.schema, &read.version],
        ];
        if ours != theirs {
            let problem = format!("it is {} of version {}", theirs[0], theirs[1]);
            return Err(refused("start".into(), problem));
        }
        read.path = path.into();
        Ok(read)
    }

    /// The positions of this many control points.
    pub(super) fn positions_for(&self, count: usize) -> Result<Vec<DVec3>> {
        let positions: Vec<DVec3> = self.positions.iter().map(|&p| p.into()).collect();
        if positions.len() == count && positions.iter().all(|p| p.is_finite()) {
            return Ok(positions);
        }
        Err(self.damaged(
            "positions",
            &format!("they are not those of {count} control points"),
        ))
    }

    pub(super) fn damaged(&self, place: &str, problem: &str) -> Error {
        let remedy = "the file is damaged: start the fit without --resume";
        Error::file(&self.path, place, problem, remedy)
    }

    /// Refuses a checkpoint of another fit.
    pub(super) fn check(&self, fingerprint: u64) -> Result<()> {
        if self.fingerprint == fingerprint {
            return Ok(());
        }
        Err(Error::file(
            &self.path,
            "fingerprint",
            "it is of a fit of another target, from another template or with other options",
            "repeat the command that wrote it, with --resume",
        ))
    }

    pub(super) fn new(
        fingerprint: u64,
        phases: usize,
        positions: &[DVec3],
        iterations: &[Iteration],
        stages: &[(String, f64)],
    ) -> Self {
        Self {
            schema: SCHEMA.into(),
            version: env!("CARGO_PKG_VERSION").into(),
            fingerprint,
            phases,
            positions: positions.iter().map(|p| p.to_array()).collect(),
            iterations: iterations.to_vec(),
            stages: stages.to_vec(),
            path: PathBuf::new(),
        }
    }

    pub(super) fn write(&self, path: &Path) -> Result<()> {
        write_whole(path, |out| Ok(serde_json::to_writer(out, self)?))
    }
}

/// Tells apart the inputs that phases depend on; when to stop is not among them. FNV-1a, of words.
pub(super) fn fingerprint(target: &Target, start: &Start, options: &Options) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |word: u64| hash = (hash ^ word).wrapping_mul(0x0100_0000_01b3);
    let control = &start.control.mesh;
    for p in target.mesh.positions.iter().chain(&control.positions) {
        p.to_array()
            .into_iter()
            .map(f64::to_bits)
            .for_each(&mut add);
    }
    target
        .weights
        .iter()
        .map(|w| w.to_bits())
        .for_each(&mut add);
    let triangles = target.mesh.triangles.as_flattened();
    for index in triangles
        .iter()
        .chain(control.offsets())
        .chain(control.corners())
    {
        add((*index).into());
    }
    let options = Options {
        max_error: None,
        mean_error: None,
        iterations: None,
        ..options.clone()
    };
    let Start {
        control,
        subdivisions,
        proximity,
    } = start;
    let sharp = (&control.creases, &control.corners);
    let rest = format!("{options:?} {subdivisions} {proximity:?} {sharp:?}");
    rest.bytes().for_each(|byte| add(byte.into()));
    hash
}
