//! The limit surface itself, at any parameter: positions and derivatives of Loop and Catmull–Clark surfaces, exact to rounding.
//!
//! **Theory.** One refinement of the control mesh leaves at most one irregular corner to a face: every control face becomes four, and only corner 0 of a
//! quarter can be a vertex of the control mesh. A quarter without an irregular corner is a quartic box spline (Loop) or a bicubic B-spline (Catmull–Clark)
//! over 12 or 16 vertices of the refined mesh; beyond boundaries and creases these are *ghosts*, combinations of vertices for which the spline follows the rules
//! of the sharp edge. A quarter with an irregular corner (any valence, or any sector between sharp edges) is refined on towards it by small matrices
//! ([Stam 1998], [Stam 1999]); see `irregular` for how, and for what the derivatives at the corner itself are.
//!
//! **Practice.** [`LimitSurface`] holds tables of the connectivity only; [`LimitSurface::patches`] binds it to control points with one sparse product.
//! All evaluation is in the parameters of the control faces. Their frames differ from face to face; [`LimitSurface::cross`] takes a parameter over an edge.
//!
//! [Stam 1998]: Evaluation of Loop subdivision surfaces. [Stam 1999]: Exact evaluation of Catmull–Clark subdivision surfaces at arbitrary parameter values.

mod basis;
mod domain;
mod flat;
mod irregular;
mod newton;
mod ring;
mod search;
#[cfg(test)]
mod tests;

pub use flat::{FlatTables, NONE};
pub use newton::{Range, Status, SurfacePoint};
pub use search::PatchSearch;

use super::refinement::{Level, Row, Split};
use crate::error::{Error, Result};
use crate::kernel::sparse::Csr;
use crate::mesh::{Connectivity, ControlMesh, Scheme};
use glam::{DMat2, DVec2, DVec3};
use irregular::Irregular;
use rayon::prelude::*;
use ring::Sector;
use std::array::from_fn;
use std::collections::HashMap;

/// A point of a limit surface: a control face and a point of the face's domain.
///
/// Triangles: u, v ≥ 0, u + v ≤ 1, with the face's corner 0 at (0, 0), corner 1 at (1, 0), corner 2 at (0, 1). Quads: the unit square, corners
/// counter-clockwise from (0, 0).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceParameter {
    /// The control face.
    pub face: u32,
    /// From corner 0 towards corner 1.
    pub u: f64,
    /// From corner 0 towards the last corner.
    pub v: f64,
}

/// Position and derivatives of a limit surface by the (u, v) of its control face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimitJet {
    /// The point.
    pub position: DVec3,
    /// ∂/∂u.
    pub du: DVec3,
    /// ∂/∂v.
    pub dv: DVec3,
    /// ∂²/∂u².
    pub duu: DVec3,
    /// ∂²/∂u∂v.
    pub duv: DVec3,
    /// ∂²/∂v².
    pub dvv: DVec3,
}

impl LimitJet {
    fn from_array([position, du, dv, duu, duv, dvv]: [DVec3; 6]) -> Self {
        Self {
            position,
            du,
            dv,
            duu,
            duv,
            dvv,
        }
    }

    fn to_array(self) -> [DVec3; 6] {
        [
            self.position,
            self.du,
            self.dv,
            self.duu,
            self.duv,
            self.dvv,
        ]
    }

    /// By other parameters, of which `linear` makes these.
    fn by(self, linear: &DMat2) -> Self {
        let (x, y) = (linear.x_axis, linear.y_axis);
        let second = |p: DVec2, q: DVec2| {
            p.x * q.x * self.duu + (p.x * q.y + p.y * q.x) * self.duv + p.y * q.y * self.dvv
        };
        Self {
            position: self.position,
            du: x.x * self.du + x.y * self.dv,
            dv: y.x * self.du + y.y * self.dv,
            duu: second(x, x),
            duv: second(x, y),
            dvv: second(y, y),
        }
    }
}

/// A quarter of a control face.
#[derive(Debug, Clone, Copy)]
struct Quarter {
    /// Where its points begin in `LimitSurface::indices`.
    first: u32,
    /// Its irregular corner in `LimitSurface::tables`, or [`REGULAR`].
    table: u32,
}

/// No irregular corner.
const REGULAR: u32 = u32::MAX;

/// Faces that one task looks around.
const FACES_PER_TASK: usize = 256;

/// The limit surface of a control mesh, whatever its control points.
#[derive(Debug, Clone)]
pub struct LimitSurface {
    split: Split,
    connectivity: Connectivity,
    /// From the control points to the vertices of the refined mesh and the ghosts after them.
    matrix: Csr,
    /// `[4 faces]`.
    quarters: Vec<Quarter>,
    /// The points of each quarter, rows of `matrix`.
    indices: Vec<u32>,
    tables: Vec<Irregular>,
}

impl LimitSurface {
    /// The tables of a control mesh; its control points are not used. O(faces), and for every kind of irregular corner O(points³) for the points around it.
    ///
    /// # Errors
    /// As [`Model::new`](super::Model::new); also where the scheme is `Polygon`, a face of a Catmull–Clark mesh is not a quad, a crease is
    /// sharp for some levels only, or fewer than three triangles meet at an inner vertex.
    pub fn new(control: &ControlMesh, scheme: Scheme) -> Result<Self> {
        let level = Level::of(control, scheme)?;
        check(&level, scheme)?;
        let (finer, refinement) = level.refine();
        let builder = Builder::of(&finer)?;
        let matrix = append_ghosts(refinement, &builder.ghosts);
        Ok(Self {
            split: level.split,
            connectivity: level.connectivity,
            matrix,
            quarters: builder.quarters,
            indices: builder.indices,
            tables: builder.tables,
        })
    }

    /// The control mesh's faces and edges.
    pub fn connectivity(&self) -> &Connectivity {
        &self.connectivity
    }

    /// The points of the control mesh refined once, in the order of [`subdivide`](super::subdivide).
    pub fn refined(&self, control_points: &[DVec3]) -> Vec<DVec3> {
        let mesh = &self.connectivity;
        let faces = match self.split {
            Split::Triangles => 0,
            Split::Quads => mesh.face_count(),
        };
        let mut points = self.matrix.apply(control_points);
        points.truncate(mesh.vertex_count() + mesh.edge_count() + faces);
        points
    }

    /// The surface for given control points.
    pub fn patches(&self, control_points: &[DVec3]) -> Patches<'_> {
        let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (lo, hi) = (control_points.iter()).fold(empty, |(lo, hi), &p| (lo.min(p), hi.max(p)));
        let origin = 0.5 * (lo + hi);
        let local: Vec<DVec3> = control_points.iter().map(|&p| p - origin).collect();
        Patches {
            surface: self,
            origin,
            points: self.matrix.apply(&local),
        }
    }

    /// The position at a parameter as a combination of control points: (control point, weight), ascending, the weights summing to 1. Replaces what is in `out`.
    pub fn weights(&self, at: SurfaceParameter, out: &mut Vec<(u32, f64)>) {
        out.clear();
        let (quarter, to_local) = domain::quarter(self.split, DVec2::new(at.u, at.v));
        let local = to_local.apply(DVec2::new(at.u, at.v));
        let (indices, table) = self.quarter(4 * at.face as usize + quarter);
        match (table, self.split) {
            (Some(table), _) => self.combine(indices, &table.weights(local), out),
            (None, Split::Triangles) => {
                self.combine(indices, &basis::box_spline_values(local), out)
            }
            (None, Split::Quads) => self.combine(indices, &basis::bicubic_values(local), out),
        }
        out.sort_unstable_by_key(|entry| entry.0);
    }

    /// Appends the control points that rows of the matrix, by number and with weights, are a combination of.
    fn combine(&self, rows: &[u32], weights: &[f64], out: &mut Vec<(u32, f64)>) {
        // Where a control point probably stands, by its last digits: without, most of the time goes into looking.
        let mut places = [0u8; 128];
        for (&row, weight) in rows.iter().zip(weights) {
            for (control_point, share) in self.matrix.row(row as usize) {
                let value = weight * share;
                let place = &mut places[control_point as usize % 128];
                match out.get_mut(*place as usize) {
                    Some(entry) if entry.0 == control_point => entry.1 += value,
                    _ => {
                        let known = out.iter().position(|entry| entry.0 == control_point);
                        match known {
                            Some(k) => out[k].1 += value,
                            None => out.push((control_point, value)),
                        }
                        *place = known.unwrap_or(out.len() - 1) as u8;
                    }
                }
            }
        }
    }

    /// Where a parameter, and a direction there, are in the face across edge `edge` (from corner `edge` to the next), with both faces laid out flat as
    /// two halves of a parallelogram or two squares; `at` may lie on the edge or beyond it. `None` at a boundary.
    pub fn cross(
        &self,
        at: SurfaceParameter,
        direction: DVec2,
        edge: usize,
    ) -> Option<(SurfaceParameter, DVec2)> {
        let mesh = &self.connectivity;
        let here = mesh.half_edges(at.face as usize).start + edge as u32;
        let there = mesh.opposite(here)?;
        let face = mesh.face_of(there);
        let other = (there - mesh.half_edges(face as usize).start) as usize;
        let to = domain::to_corner(self.split, edge);
        let from = domain::from_corner(self.split, other);
        let point = from.apply(DVec2::X - to.apply(DVec2::new(at.u, at.v)));
        let direction = -(from.linear * (to.linear * direction));
        let (u, v) = (point.x, point.y);
        Some((SurfaceParameter { face, u, v }, direction))
    }

    /// The points of a quarter, and its irregular corner if it has one.
    fn quarter(&self, q: usize) -> (&[u32], Option<&Irregular>) {
        let Quarter { first, table } = self.quarters[q];
        let table = (table != REGULAR).then(|| &self.tables[table as usize]);
        let count = table.map_or(irregular::regular_count(self.split), |t| t.points);
        (&self.indices[first as usize..first as usize + count], table)
    }
}

/// A limit surface with its control points.
#[derive(Debug, Clone)]
pub struct Patches<'a> {
    surface: &'a LimitSurface,
    /// The middle of the control points, so that a surface far from 0 loses nothing.
    origin: DVec3,
    /// Rows of the surface's matrix, relative to the origin.
    points: Vec<DVec3>,
}

impl Patches<'_> {
    /// The connectivity that these are the patches of.
    pub fn surface(&self) -> &LimitSurface {
        self.surface
    }

    /// The surface at a parameter within its face's domain. Exact to rounding; for derivatives at an irregular corner itself see the module.
    pub fn evaluate(&self, at: SurfaceParameter) -> LimitJet {
        let jet = self.local(at);
        LimitJet {
            position: jet.position + self.origin,
            ..jet
        }
    }

    /// Relative to the origin.
    fn local(&self, at: SurfaceParameter) -> LimitJet {
        let parameter = DVec2::new(at.u, at.v);
        let (quarter, to_local) = domain::quarter(self.surface.split, parameter);
        let local = to_local.apply(parameter);
        let (indices, table) = self.surface.quarter(4 * at.face as usize + quarter);
        let point = |i: usize| self.points[indices[i] as usize];
        let jet = match (table, self.surface.split) {
            (Some(table), _) => table.jet(point, local),
            (None, Split::Triangles) => basis::box_spline(&from_fn(point), local),
            (None, Split::Quads) => basis::bicubic(&from_fn(point), local),
        };
        jet.by(&to_local.linear)
    }
}

/// The tables of a surface while they grow.
#[derive(Default)]
struct Builder {
    quarters: Vec<Quarter>,
    indices: Vec<u32>,
    tables: Vec<Irregular>,
    known: HashMap<Sector, u32>,
    /// Combinations of vertices.
    ghosts: Vec<Row>,
}

impl Builder {
    /// Of the faces of the refined mesh.
    fn of(level: &Level) -> Result<Self> {
        let faces: Vec<Surroundings> = (0..level.connectivity.face_count())
            .into_par_iter()
            .with_min_len(FACES_PER_TASK)
            .map(|f| Surroundings::of(level, f))
            .collect();
        let mut builder = Self::default();
        let mut sectors = Vec::new();
        for face in faces {
            builder.push(level.connectivity.vertex_count(), face, &mut sectors);
        }
        builder.tables = sectors
            .into_par_iter()
            .map(|sector| Irregular::new(level.split, sector))
            .collect::<Result<_>>()?;
        Ok(builder)
    }

    /// Appends a face of a mesh with so many vertices. `sectors`: those that a table is to be made of.
    fn push(&mut self, vertices: usize, face: Surroundings, sectors: &mut Vec<Sector>) {
        let first = self.indices.len() as u32;
        let table = match face {
            Surroundings::Irregular(sector, points) => {
                self.indices.extend(points);
                *self.known.entry(sector).or_insert_with(|| {
                    sectors.push(sector);
                    sectors.len() as u32 - 1
                })
            }
            Surroundings::Regular(points) => {
                for point in points {
                    self.indices.push(match point {
                        ring::Point::Vertex(v) => v,
                        ring::Point::Ghost(row) => {
                            self.ghosts.push(row);
                            (vertices + self.ghosts.len() - 1) as u32
                        }
                    });
                }
                REGULAR
            }
        };
        self.quarters.push(Quarter { first, table });
    }
}

/// What acts on a face of the refined mesh.
enum Surroundings {
    Irregular(Sector, Vec<u32>),
    Regular(Vec<ring::Point>),
}

impl Surroundings {
    fn of(level: &Level, f: usize) -> Self {
        match ring::irregular_sector(level, f) {
            Some(sector) => Self::Irregular(sector, ring::irregular_points(level, f)),
            None => Self::Regular(ring::regular_points(level, f)),
        }
    }
}

/// The refinement with a row for each ghost below it.
fn append_ghosts(refinement: Csr, ghosts: &[Row]) -> Csr {
    if ghosts.is_empty() {
        return refinement;
    }
    let vertices = refinement.row_count();
    Csr::build(
        vertices + ghosts.len(),
        refinement.column_count,
        |r, row| {
            if r < vertices {
                return row.extend(refinement.row(r));
            }
            for &(v, weight) in &ghosts[r - vertices] {
                row.extend(refinement.row(v as usize).map(|(c, w)| (c, weight * w)));
            }
        },
    )
}

/// Refuses what has no limit surface made of such patches.
fn check(level: &Level, scheme: Scheme) -> Result<()> {
    let mesh = &level.connectivity;
    let problem = if scheme == Scheme::Polygon {
        "a polygon mesh has no limit surface".to_owned()
    } else if let Some(e) = level
        .sharpness
        .iter()
        .position(|&s| s > 0.0 && s.is_finite())
    {
        let [a, b] = mesh.ends(e as u32);
        format!("the crease between vertices {a} and {b} is sharp for some levels only")
    } else if let Some(f) = (level.split == Split::Quads)
        .then(|| mesh.faces().position(|f| f.len() != 4))
        .flatten()
    {
        format!("face {f} has {} corners", mesh.face(f).len())
    } else if let Some(v) = (0..mesh.vertex_count() as u32).find(|&v| {
        level.split == Split::Triangles
            && !mesh.is_boundary_vertex(v)
            && mesh.around(v).nth(2).is_none()
    }) {
        format!("fewer than three triangles meet at vertex {v}")
    } else {
        return Ok(());
    };
    Err(Error::input(
        problem,
        "evaluate the Catmull–Clark surface of quads or the Loop surface of triangles; subdivide other meshes first",
    ))
}
