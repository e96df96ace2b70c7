//! Patches with an irregular corner: their own refinement as small matrices.
//!
//! **Theory.** Let C be the m points that act on a face with one irregular corner. Refinement takes them to the m points A C of the same
//! kind that act on the quarter at that corner, and to the control points T₁ C, T₂ C, T₃ C of the other three quarters, which are
//! regular patches. So at a parameter that can be doubled k times before it leaves the quarter at the corner, the surface is the regular patch
//! with control points Tⱼ Aᵏ C, exactly (Stam 1998, equation 17).
//!
//! **Departures.** Stam diagonalizes A to have its powers. Here the products Tⱼ Aᵏ are tabulated for the first levels, and Aᵏ for
//! those further down: there is no ill-conditioned basis of eigenvectors at high valence and no Jordan block at sharp corners, and matrices with
//! non-negative rows that sum to 1 lose nothing in being multiplied. A and T come from refining a mesh that has only this corner, so all rules of
//! [`Level`] hold here by construction.
//!
//! **At the corner** itself the position is the limit mask's. Derivatives by the face's parameters do not exist there: with λ the subdominant eigenvalue
//! of A they grow or shrink as (2 λ)ᵏ. Around a smooth vertex what is returned as first derivatives are the limits of
//! (2 λ)⁻ᵏ S_u(2⁻ᵏ, 0) and (2 λ)⁻ᵏ S_v(0, 2⁻ᵏ): tangents along the two edges, which are the derivatives where the vertex is regular.
//! They are found with the projection on the eigenspace of λ, the limit of the powers of (A − A^∞) / λ. At other corners (creases, darts, pinned
//! vertices) the first derivatives are those a 2⁻¹⁶th inside the face. Second derivatives are 0.

use super::LimitJet;
use super::basis;
use super::domain::{depth, quarter};
use super::ring::{self, Extent, Sector};
use crate::error::Result;
use crate::mesh::{ControlMesh, Crease, PolygonMesh, Scheme};
use crate::model::refinement::{Level, Row, Split};
use glam::{DMat2, DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// Levels that are tabulated. Of all parameters, the quarter of 4⁻¹⁶ is further down.
pub const LEVELS: u32 = 16;
/// Squarings that lead to the projection on the subdominant eigenvectors: enough for the ratio of eigenvalues at valence 200.
const SQUARINGS: usize = 18;

/// The tables of one kind of irregular corner.
#[derive(Debug, Clone)]
pub struct Irregular {
    split: Split,
    /// m.
    pub points: usize,
    /// `[LEVELS, 3, m, 12 or 16]`: Tⱼ Aᵏ by columns.
    pub pickings: Vec<f64>,
    /// `[m, m]`: A, by rows.
    pub step: Vec<f64>,
    /// `[m, m]`: A to the power `LEVELS`, by rows.
    jump: Vec<f64>,
    /// `[6, m]`: the jet at the corner.
    corner: [Vec<f64>; 6],
}

/// The number of control points of a regular patch.
pub fn regular_count(split: Split) -> usize {
    match split {
        Split::Triangles => 12,
        Split::Quads => 16,
    }
}

impl Irregular {
    /// The tables for a sector.
    pub fn new(split: Split, sector: Sector) -> Result<Self> {
        let level = alone(split, sector)?;
        let face = sector.place;
        let points = ring::irregular_points(&level, face);
        let m = points.len();
        let (finer, refinement) = level.refine();
        let mut place = vec![usize::MAX; level.connectivity.vertex_count()];
        for (i, &v) in points.iter().enumerate() {
            place[v as usize] = i;
        }
        // A combination of points of the finer mesh as a row over `points`.
        let row = |terms: &Row| {
            let mut row = vec![0.0; m];
            for &(fine, weight) in terms {
                for (v, w) in refinement.row(fine as usize) {
                    row[place[v as usize]] += weight * w;
                }
            }
            row
        };
        let step: Vec<f64> = ring::irregular_points(&finer, 4 * face)
            .into_iter()
            .flat_map(|v| row(&vec![(v, 1.0)]))
            .collect();
        let mut picking = Vec::new();
        for quarter in 1..4 {
            for point in ring::regular_points(&finer, 4 * face + quarter) {
                let mut terms = Row::new();
                point.push(1.0, &mut terms);
                picking.extend(row(&terms));
            }
        }
        let mut limit = vec![0.0; m];
        for (v, w) in level.limit().row(0) {
            limit[place[v as usize]] = w;
        }
        let mut tables = Self {
            split,
            points: m,
            pickings: Vec::new(),
            jump: Vec::new(),
            step: Vec::new(),
            corner: [(); 6].map(|()| vec![0.0; m]),
        };
        tables.tabulate(&step, picking);
        tables.set_corner(sector, &step, limit);
        tables.step = step;
        Ok(tables)
    }

    fn tabulate(&mut self, step: &[f64], mut picking: Vec<f64>) {
        let (m, regular) = (self.points, regular_count(self.split));
        let mut power = step.to_vec();
        for k in 0..LEVELS {
            if k > 0 {
                picking = product(&picking, step, m);
                power = product(&power, step, m);
            }
            for quarter in picking.chunks(regular * m) {
                for column in 0..m {
                    self.pickings
                        .extend((0..regular).map(|r| quarter[r * m + column]));
                }
            }
        }
        self.jump = power;
    }

    fn set_corner(&mut self, sector: Sector, step: &[f64], limit: Vec<f64>) {
        let m = self.points;
        let is_smooth = sector.extent == Extent::Closed && !sector.pinned;
        let (along_u, along_v) = if is_smooth {
            let tangent = tangent_projection(step, &limit, subdominant(self.split, sector.faces));
            let project = |row: Vec<f64>| product(&row, &tangent, m);
            (
                project(self.row(DVec2::X, 1)),
                project(self.row(DVec2::Y, 2)),
            )
        } else {
            let inside = DVec2::splat(0.5f64.powi(LEVELS as i32));
            (self.row(inside, 1), self.row(inside, 2))
        };
        (self.corner[0], self.corner[1], self.corner[2]) = (limit, along_u, along_v);
    }

    /// The derivative of number `order` at a parameter, as a row over the points.
    fn row(&self, at: DVec2, order: usize) -> Vec<f64> {
        let unit = |column: usize| move |i: usize| if i == column { DVec3::X } else { DVec3::ZERO };
        (0..self.points)
            .map(|column| self.jet(unit(column), at).to_array()[order].x)
            .collect()
    }

    /// The surface at a parameter of the face, its points given by number.
    pub fn jet(&self, point: impl Fn(usize) -> DVec3, at: DVec2) -> LimitJet {
        let Some(depth) = depth(self.split, at) else {
            return LimitJet::from_array(self.corner.each_ref().map(|row| {
                (row.iter().enumerate()).fold(DVec3::ZERO, |sum, (i, &w)| sum + w * point(i))
            }));
        };
        if depth < LEVELS {
            return self.regular_jet(point, at, depth);
        }
        let mut points: Vec<DVec3> = (0..self.points).map(&point).collect();
        for _ in 0..depth / LEVELS {
            points = apply(&self.jump, &points);
        }
        let scale = power_of_two(depth - depth % LEVELS);
        self.regular_jet(|i| points[i], scale * at, depth % LEVELS)
            .by(&DMat2::from_diagonal(DVec2::splat(scale)))
    }

    /// The surface at a parameter `depth` levels down, less than [`LEVELS`].
    fn regular_jet(&self, point: impl Fn(usize) -> DVec3, at: DVec2, depth: u32) -> LimitJet {
        let scale = power_of_two(depth);
        let (quarter, to_local) = quarter(self.split, scale * at);
        let picking = self.picking(depth, quarter);
        let local = to_local.apply(scale * at);
        let jet = match self.split {
            Split::Triangles => basis::box_spline(&pick(picking, point), local),
            Split::Quads => basis::bicubic(&pick(picking, point), local),
        };
        jet.by(&(scale * to_local.linear))
    }

    /// The weight of each point in the position at a parameter.
    pub fn weights(&self, at: DVec2) -> Vec<f64> {
        let Some(depth) = depth(self.split, at) else {
            return self.corner[0].clone();
        };
        let scaled = power_of_two(depth) * at;
        let (quarter, to_local) = quarter(self.split, scaled);
        let local = to_local.apply(scaled);
        let picking = self.picking(depth % LEVELS, quarter);
        let mut weights = match self.split {
            Split::Triangles => picked(picking, &basis::box_spline_values(local)),
            Split::Quads => picked(picking, &basis::bicubic_values(local)),
        };
        for _ in 0..depth / LEVELS {
            weights = product(&weights, &self.jump, self.points);
        }
        weights
    }

    /// The control points of regular quarter `k` of the face.
    pub fn pick(&self, points: &[DVec3], k: usize) -> Vec<DVec3> {
        let picking = self.picking(0, k);
        match self.split {
            Split::Triangles => pick::<12>(picking, |i| points[i]).into(),
            Split::Quads => pick::<16>(picking, |i| points[i]).into(),
        }
    }

    /// Tⱼ Aᵏ by columns.
    fn picking(&self, k: u32, quarter: usize) -> &[f64] {
        let size = self.points * regular_count(self.split);
        let first = (3 * k as usize + quarter - 1) * size;
        &self.pickings[first..first + size]
    }
}

/// Combinations of points: a matrix `[N, points]` by columns times points by number.
fn pick<const N: usize>(matrix: &[f64], point: impl Fn(usize) -> DVec3) -> [DVec3; N] {
    // Coordinate by coordinate, so that sums run in vector registers.
    let [mut x, mut y, mut z] = [[0.0; N]; 3];
    for (i, column) in matrix.as_chunks::<N>().0.iter().enumerate() {
        let p = point(i);
        for r in 0..N {
            x[r] += column[r] * p.x;
            y[r] += column[r] * p.y;
            z[r] += column[r] * p.z;
        }
    }
    std::array::from_fn(|r| DVec3::new(x[r], y[r], z[r]))
}

/// The weight of each point where regular control points, picked from them by columns, have these weights.
fn picked<const N: usize>(picking: &[f64], values: &[f64; N]) -> Vec<f64> {
    let dot = |column: &[f64; N]| column.iter().zip(values).map(|(t, b)| t * b).sum();
    picking.as_chunks::<N>().0.iter().map(dot).collect()
}

/// 2ᵏ for a depth, which is below 1023.
fn power_of_two(k: u32) -> f64 {
    f64::from_bits(u64::from(1023 + k) << 52)
}

/// The product of a matrix by rows with points.
pub fn apply(matrix: &[f64], points: &[DVec3]) -> Vec<DVec3> {
    let dot = |row: &[f64]| {
        row.iter()
            .zip(points)
            .fold(DVec3::ZERO, |sum, (&w, &p)| sum + w * p)
    };
    matrix.chunks(points.len()).map(dot).collect()
}

/// The matrices `[12 or 16, 12 or 16]` by rows that take the control points of a regular patch to those of its quarters.
pub fn regular_refinements(split: Split) -> Result<[Vec<f64>; 4]> {
    let faces = match split {
        Split::Triangles => 6,
        Split::Quads => 4,
    };
    let sector = Sector {
        extent: Extent::Closed,
        faces,
        place: 0,
        pinned: false,
    };
    let level = alone(split, sector)?;
    let (finer, refinement) = level.refine();
    let vertex = |point: &ring::Point| match point {
        ring::Point::Vertex(v) => *v,
        ring::Point::Ghost(_) => u32::MAX,
    };
    let coarse: Vec<u32> = ring::regular_points(&level, 0).iter().map(vertex).collect();
    let row = |fine: u32| {
        let mut row = vec![0.0; coarse.len()];
        for (v, w) in refinement.row(fine as usize) {
            for (value, _) in row.iter_mut().zip(&coarse).filter(|(_, c)| **c == v) {
                *value += w;
            }
        }
        row
    };
    Ok([0, 1, 2, 3].map(|k| {
        let fine = ring::regular_points(&finer, k);
        fine.iter().flat_map(|point| row(vertex(point))).collect()
    }))
}

/// The product of a matrix of rows of length `m` with an `[m, m]` matrix.
fn product(rows: &[f64], matrix: &[f64], m: usize) -> Vec<f64> {
    let mut result = vec![0.0; rows.len()];
    for (row, sums) in rows.chunks(m).zip(result.chunks_mut(m)) {
        for (&weight, other) in row.iter().zip(matrix.chunks(m)) {
            if weight != 0.0 {
                for (sum, &value) in sums.iter_mut().zip(other) {
                    *sum += weight * value;
                }
            }
        }
    }
    result
}

/// The eigenvalue after 1, which is double, at a smooth vertex with `n` faces: that of the lowest frequency of the discrete Fourier transform around it.
pub fn subdominant(split: Split, n: usize) -> f64 {
    let c = (TAU / n as f64).cos();
    match split {
        Split::Triangles => 0.375 + 0.25 * c,
        Split::Quads => (5.0 + c + (PI / n as f64).cos() * (18.0 + 2.0 * c).sqrt()) / 16.0,
    }
}

/// The projection on the eigenspace of `eigenvalue`, by squaring (A − A^∞) / λ; kept at its trace, 2, against drift.
fn tangent_projection(step: &[f64], limit: &[f64], eigenvalue: f64) -> Vec<f64> {
    let m = limit.len();
    let mut power: Vec<f64> = (step.iter().zip(limit.iter().cycle()))
        .map(|(a, l)| (a - l) / eigenvalue)
        .collect();
    for _ in 0..SQUARINGS {
        power = product(&power, &power, m);
        let trace: f64 = power.iter().step_by(m + 1).sum();
        power.iter_mut().for_each(|a| *a *= 2.0 / trace);
    }
    power
}

/// A mesh that has nothing but a corner with a sector around it, as vertex 0, and what acts on the faces there. Face i < `sector.faces` is the
/// i-th of the sector, with the vertex as its corner 0.
fn alone(split: Split, sector: Sector) -> Result<Level> {
    let n = sector.faces as u32;
    let spokes = n + u32::from(sector.extent == Extent::Open);
    let spoke = |i: u32| 1 + i % spokes;
    let beyond = |i: u32| 1 + spokes + i % spokes;
    let first = 1 + 2 * spokes;
    let mut faces: Vec<Vec<u32>> = Vec::new();
    let scheme = match split {
        Split::Triangles => {
            let across = |i: u32| first + i;
            faces.extend((0..n).map(|i| vec![0, spoke(i), spoke(i + 1)]));
            for i in 0..n {
                faces.push(vec![spoke(i), across(i), spoke(i + 1)]);
                faces.push(vec![spoke(i), beyond(i), across(i)]);
                faces.push(vec![spoke(i + 1), across(i), beyond(i + 1)]);
            }
            Scheme::Loop
        }
        Split::Quads => {
            let across = |i: u32, k: u32| first + 4 * i + k;
            faces.extend((0..n).map(|i| vec![0, spoke(i), across(i, 0), spoke(i + 1)]));
            for i in 0..n {
                let [inner, right, far, left] = [0, 1, 2, 3].map(|k| across(i, k));
                faces.push(vec![spoke(i), beyond(i), right, inner]);
                faces.push(vec![inner, right, far, left]);
                faces.push(vec![inner, left, beyond(i + 1), spoke(i + 1)]);
            }
            Scheme::CatmullClark
        }
    };
    let count = match split {
        Split::Triangles => first + n,
        Split::Quads => first + 4 * n,
    };
    let mut control = ControlMesh::from(PolygonMesh::from_faces(
        vec![DVec3::ZERO; count as usize],
        faces,
    ));
    if sector.extent == Extent::Dart {
        control.creases = [[0, spoke(0)], [spoke(0), beyond(0)]]
            .map(|edge| Crease {
                edge,
                sharpness: f64::INFINITY,
            })
            .to_vec();
    }
    let mut level = Level::of(&control, scheme)?;
    level.corners[0] = sector.pinned;
    Ok(level)
}
