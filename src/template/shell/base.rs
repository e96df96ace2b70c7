//! Where layers over a surface go, and how far there is room for them.

use super::Thickness;
use super::surface::area_vector;
use crate::error::Result;
use crate::geometry::Bvh;
use crate::geometry::crossing::crossings;
use crate::mesh::{CellShape, PolygonMesh, VolumeMesh, check_volume};
use crate::untangle::Ideals;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Layers reach this share of the radius of the ball that has room: those of the other side come as far.
const ROOM: f64 = 0.8;

/// A ball is stopped by points that are seen from where it touches under this sine or more over the tangent plane: lower ones belong to the same part of the surface.
const OTHER_SIDE: f64 = 0.5;

/// Layers are at least this share of the wanted thickness before cells that stay inverted make them thinner.
const LEAST_HEIGHT: f64 = 0.1;

/// Steps in which a ball shrinks, at most.
const SHRINKING: usize = 30;

/// How much thicker layers may get over a length along the surface.
const STEEPEST: f64 = 0.5;

/// To which share layers become thinner where they must.
const THINNER: f64 = 0.5;

/// The weight of not moving beside the squares of the normals around a vertex.
const STAYING: f64 = 1e-3;

/// The surface that a shell stands on.
pub(super) struct Base<'a> {
    surface: &'a PolygonMesh,
    triangles: Vec<[u32; 3]>,
    tree: Bvh,
    /// `[vertices]`: what takes a vertex one unit over the planes of the faces around it.
    outwards: Vec<DVec3>,
    /// `[faces]`, unit length.
    normals: Vec<DVec3>,
}

/// Where the layers on one side go.
pub(super) struct Course {
    /// 1 along the normals, −1 against them.
    sign: f64,
    /// `[vertices]`: how far.
    pub heights: Vec<f64>,
}

impl<'a> Base<'a> {
    pub fn new(surface: &'a PolygonMesh) -> Result<Self> {
        let triangles = surface.triangulate();
        let tree = Bvh::new(&triangles.positions, &triangles.triangles)?;
        let normals: Vec<DVec3> = surface
            .faces()
            .map(|face| area_vector(&surface.positions, face).normalize_or_zero())
            .collect();
        let mut sums = vec![
            (DMat3::from_diagonal(DVec3::splat(STAYING)), DVec3::ZERO);
            surface.positions.len()
        ];
        for (face, &n) in surface.faces().zip(&normals) {
            for &v in face {
                let (squares, sum) = &mut sums[v as usize];
                *squares += DMat3::from_cols(n * n.x, n * n.y, n * n.z);
                *sum += n;
            }
        }
        let outwards = sums
            .into_iter()
            .map(|(squares, sum)| squares.inverse() * sum)
            .collect();
        Ok(Self {
            surface,
            triangles: triangles.triangles,
            tree,
            outwards,
            normals,
        })
    }

    /// How far layers can go on one side.
    pub fn course(&self, sign: f64, distance: f64) -> Course {
        let room = |v: usize| ROOM * self.ball(v, sign, distance / ROOM);
        let mut heights: Vec<f64> = (0..self.surface.positions.len())
            .into_par_iter()
            .map(|v| room(v).clamp(LEAST_HEIGHT * distance, distance))
            .collect();
        self.smooth(&mut heights);
        Course { sign, heights }
    }

    /// The radius of the largest ball that touches the surface at a vertex and holds no point of another part of it, `largest` at most.
    fn ball(&self, v: usize, sign: f64, largest: f64) -> f64 {
        let (p, n) = (
            self.surface.positions[v],
            sign * self.outwards[v].normalize_or_zero(),
        );
        let mut radius = largest;
        for _ in 0..SHRINKING {
            let center = p + radius * n;
            let found = self.tree.closest(center);
            let touches = self.triangles[found.triangle as usize].contains(&(v as u32));
            let across = found.point - p;
            let is_same_part = touches || across.dot(n) < OTHER_SIDE * across.length();
            if is_same_part || found.distance_squared.sqrt() > radius * (1.0 - 1e-6) {
                break;
            }
            // The ball through both points.
            radius = across.length_squared() / (2.0 * across.dot(n));
        }
        radius
    }

    /// Lowers heights so that they change slowly along the surface.
    fn smooth(&self, heights: &mut [f64]) {
        loop {
            let mut is_changed = false;
            for face in self.surface.faces() {
                for k in 0..face.len() {
                    let [a, b] = [face[k], face[(k + 1) % face.len()]].map(|v| v as usize);
                    let rise =
                        STEEPEST * self.surface.positions[a].distance(self.surface.positions[b]);
                    for (low, high) in [(a, b), (b, a)] {
                        // Without the share rounding could go on for ever.
                        if heights[high] > (heights[low] + rise) * (1.0 + 1e-9) {
                            heights[high] = heights[low] + rise;
                            is_changed = true;
                        }
                    }
                }
            }
            if !is_changed {
                return;
            }
        }
    }

    /// The layers before they are optimized.
    pub fn extruded(&self, courses: &[Course], layers: u32) -> VolumeMesh {
        let mut mesh = VolumeMesh::new(self.surface.positions.clone());
        for course in courses {
            let before = mesh.positions.len();
            for layer in 1..=layers {
                let share = course.sign * f64::from(layer) / f64::from(layers);
                let ways = self.outwards.iter().zip(&course.heights);
                let points = self.surface.positions.iter().zip(ways);
                mesh.positions
                    .extend(points.map(|(p, (n, h))| *p + share * *h * *n));
            }
            self.push_layers(&mut mesh, before as u32, layers, course.sign);
        }
        mesh
    }

    /// The cells of one side, layer after layer; `first` is the first vertex over the surface.
    fn push_layers(&self, mesh: &mut VolumeMesh, first: u32, layers: u32, sign: f64) {
        let count = self.surface.positions.len() as u32;
        for layer in 0..layers {
            let above = first + layer * count;
            let below = if layer == 0 { 0 } else { above - count };
            let (bottom, top) = if sign > 0.0 {
                (below, above)
            } else {
                (above, below)
            };
            for face in self.surface.faces() {
                let cell: Vec<u32> = face
                    .iter()
                    .map(|v| bottom + v)
                    .chain(face.iter().map(|v| top + v))
                    .collect();
                mesh.push_cell(shape_over(face), &cell);
            }
        }
    }

    /// The polygon under each cell, raised along its normal.
    pub fn ideals(&self, mesh: &VolumeMesh, courses: &[Course], layers: u32) -> Ideals {
        let faces = self.surface.face_count();
        Ideals::new(mesh, |c| {
            let course = &courses[c / (faces * layers as usize)];
            let (face, n) = (self.surface.face(c % faces), self.normals[c % faces]);
            let bottom = face.iter().map(|&v| self.surface.positions[v as usize]);
            let top = face.iter().map(|&v| {
                let height = course.heights[v as usize] / f64::from(layers);
                self.surface.positions[v as usize] + height * n
            });
            bottom.chain(top).collect()
        })
    }

    /// For each cell of a shell whether its faces on the boundary cross others, unless both are faces of the surface.
    pub fn crossing(&self, mesh: &VolumeMesh) -> Vec<bool> {
        let mut triangles = Vec::new();
        let mut owners = Vec::new();
        for (c, f) in check_volume::boundary_faces(mesh) {
            let face = mesh.shape(c).faces()[f];
            let at = |k: usize| mesh.cell(c)[face[k]];
            for k in 2..face.len() {
                triangles.push([at(0), at(k - 1), at(k)]);
                owners.push(c);
            }
        }
        let is_surface = |t: u32| {
            let vertices = triangles[t as usize].iter();
            vertices.max() < Some(&(self.surface.positions.len() as u32))
        };
        let mut crossing = vec![false; mesh.cell_count()];
        for pair in crossings(&mesh.positions, &triangles) {
            if !pair.iter().all(|&t| is_surface(t)) {
                pair.iter()
                    .for_each(|&t| crossing[owners[t as usize]] = true);
            }
        }
        crossing
    }

    /// How many triangles of the surface cross each other.
    pub fn surface_crossing(&self) -> usize {
        let mut crossing = crossings(&self.surface.positions, &self.triangles).concat();
        crossing.sort_unstable();
        crossing.dedup();
        crossing.len()
    }

    /// Makes layers thinner where cells are bad.
    pub fn thin(&self, courses: &mut [Course], bad: &[bool], layers: u32) {
        let faces = self.surface.face_count();
        for (course, bad) in courses.iter_mut().zip(bad.chunks(faces * layers as usize)) {
            let mut touched = vec![false; course.heights.len()];
            for (c, _) in bad.iter().enumerate().filter(|(_, b)| **b) {
                self.surface
                    .face(c % faces)
                    .iter()
                    .for_each(|&v| touched[v as usize] = true);
            }
            for (height, _) in course.heights.iter_mut().zip(touched).filter(|(_, t)| *t) {
                *height *= THINNER;
            }
            self.smooth(&mut course.heights);
        }
    }

    /// From the far sides to the surface.
    pub fn thickness(
        &self,
        mesh: &VolumeMesh,
        layers: u32,
        courses: &[Course],
        distance: f64,
    ) -> Result<Thickness> {
        let count = self.surface.positions.len();
        let mut points = Vec::new();
        for side in 0..courses.len() {
            let top = &mesh.positions[count * (1 + side * layers as usize + layers as usize - 1)..]
                [..count];
            points.extend_from_slice(top);
            points.extend(self.surface.faces().map(|face| {
                face.iter().map(|&v| top[v as usize]).sum::<DVec3>() / face.len() as f64
            }));
        }
        let found = self.tree.closest_all(&points);
        let shares: Vec<f64> = found
            .iter()
            .map(|c| c.distance_squared.sqrt() / distance)
            .collect();
        Ok(Thickness {
            min: shares.iter().copied().fold(f64::INFINITY, f64::min),
            mean: shares.iter().sum::<f64>() / shares.len() as f64,
            max: shares.iter().copied().fold(0.0, f64::max),
        })
    }
}

fn shape_over(face: &[u32]) -> CellShape {
    match face.len() {
        3 => CellShape::Prism,
        _ => CellShape::Hexahedron,
    }
}
