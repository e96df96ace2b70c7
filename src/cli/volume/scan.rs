//! What `vorofit volume` fits to: a closed surface, or points on one.

use crate::cli::job::{in_file, warn_of_flaws};
use crate::cli::session::Session;
use std::path::{Path, PathBuf};
use vorofit::Result;
use vorofit::files::{self, read_scans, read_surface};
use vorofit::fit::{PointTarget, Target, VolumeTarget};
use vorofit::measure;
use vorofit::mesh::{Frame, PointCloud, PolygonMesh, TriangleMesh};
use vorofit::report::{ErrorReport, TargetReport};

/// Area samples a side by which the result is judged: the rms is then certain to about a percent.
const SAMPLES: usize = 200_000;

/// A scan as it was read.
pub enum Scan {
    Surface(PolygonMesh),
    Points(PointCloud),
}

/// A scan made ready for a fit.
pub enum Prepared {
    Surface {
        target: Box<Target>,
        /// The input in the unit frame; the target's holes are bridged.
        input: TriangleMesh,
    },
    Points(Box<PointTarget>),
}

impl Scan {
    /// Reads a surface, or as points whatever there is.
    pub fn read(session: &Session, path: &Path, as_points: bool) -> Result<Self> {
        if !as_points {
            let surface = read_surface(path)?;
            warn_of_flaws(session, path, &surface.census);
            return Ok(Self::Surface(surface.mesh));
        }
        Ok(Self::Points(match read_scans(&[PathBuf::from(path)])? {
            files::Scan::Points(points) => points,
            files::Scan::Surface(surface) => PointCloud {
                positions: surface.mesh.positions,
                ..PointCloud::default()
            },
        }))
    }

    /// Makes it ready; `path` is named in errors.
    pub fn prepare(&self, session: &Session, path: &Path) -> Result<Prepared> {
        match self {
            Self::Surface(mesh) => {
                let mut input = mesh.triangulate();
                let target = Target::new(session.device()?, &input)
                    .map_err(|e| in_file(e, path, "faces"))?;
                for p in &mut input.positions {
                    *p = target.frame.to_unit(*p);
                }
                Ok(Prepared::Surface {
                    target: Box::new(target),
                    input,
                })
            }
            Self::Points(cloud) => {
                let target = PointTarget::new(cloud).map_err(|e| in_file(e, path, "points"))?;
                Ok(Prepared::Points(Box::new(target)))
            }
        }
    }

    /// What the report says of it.
    pub fn report(&self, diagonal: f64) -> TargetReport {
        let (vertices, faces) = match self {
            Self::Surface(mesh) => (mesh.positions.len(), mesh.face_count()),
            Self::Points(cloud) => (cloud.positions.len(), 0),
        };
        TargetReport {
            vertices,
            faces,
            bbox_diagonal: diagonal,
        }
    }
}

impl Prepared {
    pub fn target(&self) -> VolumeTarget<'_> {
        match self {
            Self::Surface { target, .. } => VolumeTarget::Surface(target),
            Self::Points(target) => VolumeTarget::Points(target),
        }
    }

    pub fn frame(&self) -> Frame {
        *self.target().frame()
    }

    /// The error of a surface in the unit frame: both ways from a surface, from points their distances.
    pub fn error(&self, surface: &TriangleMesh) -> Result<ErrorReport> {
        let diagonal = self.frame().diagonal;
        match self {
            Self::Surface { input, .. } => {
                let error = measure::surface_error(input, surface, SAMPLES)?;
                Ok(ErrorReport::of_fit(&error, diagonal))
            }
            Self::Points(target) => {
                let figures = measure::point_error(target.positions(), surface)?;
                Ok(ErrorReport::of_points(figures, diagonal))
            }
        }
    }

    /// The distances of a surface's vertices, in the units of the input; of points nobody knows what lies between them.
    pub fn distances(&self, surface: &TriangleMesh) -> Result<Option<Vec<f64>>> {
        let Self::Surface { input, .. } = self else {
            return Ok(None);
        };
        let diagonal = self.frame().diagonal;
        let distances = measure::distances(input, &surface.positions)?;
        Ok(Some(distances.iter().map(|d| diagonal * d).collect()))
    }
}
