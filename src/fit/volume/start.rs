//! Where a volume fit starts.

use super::target::VolumeTarget;
use crate::error::{Error, Result};
use crate::mesh::{CellShape, VolumeMesh};
use crate::model::element::{Basis, reference_volume};
use crate::model::volume::CurvedVolume;
use crate::progress::{Event, Progress};
use crate::template::{self, Align, alignment};
use crate::untangle::{Boundary, Ideals, inverted, untangle};
use glam::DVec3;

/// Generated templates fill this share of the target's bounding box: they grow into the target rather than shrink.
const SHARE: f64 = 0.8;

/// A template lies on the target already where the root mean square distance from its boundary is under this share of the mean
/// length of its edges there.
const NEARBY: f64 = 0.25;

/// How far the boundary of a template may move while it is untangled, in diagonals.
const UNTANGLED: f64 = 5e-4;

/// What a volume fit starts from, in the target's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub enum VolumeTemplate {
    /// About so many hexahedra made in the target, with its handles ([`template::volume::automatic`]).
    Auto(usize),
    /// The target's bounding box, somewhat shrunk, as a grid of so many hexahedra along x, y and z.
    Grid([u32; 3]),
    /// A ball in that box: 7 n³ hexahedra.
    Ball(u32),
    /// A mesh of the user's own.
    Mesh {
        /// The mesh.
        mesh: VolumeMesh,
        /// How it is brought onto the target.
        align: Align,
    },
}

impl VolumeTemplate {
    /// A mesh of one cell of each shape that it has, to try a file format on.
    ///
    /// # Errors
    /// Where it has no cells.
    pub fn sample(&self) -> Result<VolumeMesh> {
        let cube = template::volume::grid(DVec3::ZERO, DVec3::ONE, [1; 3]);
        let Self::Mesh { mesh, .. } = self else {
            return Ok(cube);
        };
        let mut sample = VolumeMesh::default();
        for shape in CellShape::ALL {
            if let Some((_, cell)) = mesh.cells().find(|c| c.0 == shape) {
                let first = sample.positions.len() as u32;
                let corners: Vec<u32> = (first..first + cell.len() as u32).collect();
                let positions = cell.iter().map(|&v| mesh.positions[v as usize]);
                sample.positions.extend(positions);
                sample.push_cell(shape, &corners);
            }
        }
        match sample.cell_count() {
            0 => Err(no_cells()),
            _ => Ok(sample),
        }
    }
}

/// The start of a volume fit, in the target's unit frame.
#[derive(Debug, Clone, PartialEq)]
pub struct VolumeStart {
    /// Straight-edged cells.
    pub mesh: VolumeMesh,
    /// Whether its boundary lies on the target already.
    pub nearby: bool,
}

impl VolumeStart {
    /// The start for a template.
    ///
    /// # Errors
    /// Where the template is no volume mesh (see [`CurvedVolume::new`]), cannot be aligned or made, or a count is 0.
    pub fn new<'a>(target: impl Into<VolumeTarget<'a>>, template: &VolumeTemplate) -> Result<Self> {
        let target = target.into();
        let (lo, hi) = target.mesh().bounding_box().unwrap_or_default();
        let (center, half) = (0.5 * (lo + hi), 0.5 * SHARE * (hi - lo));
        let (lo, hi) = (center - half, center + half);
        let mesh = match template {
            VolumeTemplate::Auto(elements) => {
                return Ok(Self {
                    mesh: template::volume::automatic(target.mesh(), *elements)?,
                    nearby: true,
                });
            }
            VolumeTemplate::Grid(cells) if cells.contains(&0) => return Err(no_cells()),
            VolumeTemplate::Ball(0) => return Err(no_cells()),
            VolumeTemplate::Grid(cells) => template::volume::grid(lo, hi, *cells),
            VolumeTemplate::Ball(n) => template::volume::ball(lo, hi, *n),
            VolumeTemplate::Mesh { mesh, align } => return Self::placed(target, mesh, *align),
        };
        Ok(Self {
            mesh,
            nearby: false,
        })
    }

    fn placed(target: VolumeTarget<'_>, mesh: &VolumeMesh, align: Align) -> Result<Self> {
        let mut mesh = mesh.clone();
        for p in &mut mesh.positions {
            *p = target.frame().to_unit(*p);
        }
        let boundary = |mesh: &VolumeMesh| -> Result<_> {
            let volume = CurvedVolume::new(mesh, Basis::default())?;
            Ok(volume.boundary_surface(1).mesh(&volume.coefficients))
        };
        let map = alignment(align, &boundary(&mesh)?, target.mesh())?;
        for p in &mut mesh.positions {
            *p = map.transform_point3(*p);
        }
        let surface = boundary(&mesh)?;
        let centers: Vec<DVec3> = (0..surface.triangles.len())
            .map(|t| surface.corners(t).iter().sum::<DVec3>() / 3.0)
            .collect();
        let squares = target.squared_distances(&centers)?;
        let square = squares.iter().sum::<f64>() / centers.len() as f64;
        // Two triangles to a square.
        let edge = (2.0 * surface.area() / centers.len() as f64).sqrt();
        Ok(Self {
            mesh,
            nearby: square.sqrt() < NEARBY * edge,
        })
    }

    /// The same without inverted cells: where there are some, the mesh is untangled over its own boundary.
    pub(super) fn untangled(self, progress: &dyn Progress) -> Result<Self> {
        let count = inverted(&self.mesh).into_iter().filter(|x| *x).count();
        if count == 0 {
            return Ok(self);
        }
        let cells = self.mesh.cell_count();
        progress.event(Event::Warning(&format!(
            "{count} of the template's {cells} cells are inverted or degenerate, and untangled first"
        )));
        let hold = Boundary::Own {
            tolerance: UNTANGLED,
        };
        let found = untangle(&self.mesh, &Ideals::local(&self.mesh), hold, progress)?;
        Ok(Self {
            mesh: found.mesh,
            ..self
        })
    }

    /// The edge lengths of the cells' ideal shapes, for a target that encloses `volume`: for a template nearby those of cells of
    /// the same volumes as they have; else all equal, and so that the ideal shapes fill the target. `[cells]`.
    pub(super) fn ideal_sizes(&self, volume: f64) -> Vec<f64> {
        let reference = |c: usize| reference_volume(self.mesh.shape(c));
        let cells = 0..self.mesh.cell_count();
        if self.nearby {
            let size = |c| (cell_volume(&self.mesh, c) / reference(c)).cbrt();
            return cells.map(size).collect();
        }
        let total: f64 = cells.clone().map(reference).sum();
        vec![(volume / total).cbrt(); cells.len()]
    }
}

fn no_cells() -> Error {
    Error::input(
        "the template has no cells",
        "give at least one cell in each direction",
    )
}

/// The volume of a cell cut into tetrahedra; for a hexahedron the mean of both ways to cut.
fn cell_volume(mesh: &VolumeMesh, c: usize) -> f64 {
    const TETRAHEDRON: &[[usize; 4]] = &[[0, 1, 2, 3]];
    const PRISM: &[[usize; 4]] = &[[0, 1, 2, 3], [1, 2, 3, 4], [2, 5, 4, 3]];
    const HEXAHEDRON: &[[usize; 4]] = &[
        [0, 1, 3, 4],
        [2, 3, 1, 6],
        [5, 4, 6, 1],
        [7, 6, 4, 3],
        [1, 3, 4, 6],
        [1, 2, 0, 5],
        [3, 0, 2, 7],
        [4, 5, 7, 0],
        [6, 7, 5, 2],
        [0, 2, 5, 7],
    ];
    let (parts, share) = match mesh.shape(c) {
        CellShape::Tetrahedron => (TETRAHEDRON, 1.0),
        CellShape::Prism => (PRISM, 1.0),
        CellShape::Hexahedron => (HEXAHEDRON, 0.5),
    };
    let cell = mesh.cell(c);
    let at = |k: usize| mesh.positions[cell[k] as usize];
    let volume = |&[a, b, c, d]: &[usize; 4]| {
        let (x, y, z) = (at(b) - at(a), at(c) - at(a), at(d) - at(a));
        x.dot(y.cross(z)).abs() / 6.0
    };
    share * parts.iter().map(volume).sum::<f64>()
}
