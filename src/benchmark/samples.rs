//! Generated inputs of every kernel, the same on every machine.

use crate::energy::element_tables;
use crate::error::Result;
use crate::geometry::distortion::Distortion;
use crate::geometry::triangle_tree::{TriangleTree, spatial_order};
use crate::kernel::candidates::{CandidateInput, Candidates};
use crate::kernel::closest_point::ClosestInput;
use crate::kernel::differentiated_voronoi::DifferentiatedInput;
use crate::kernel::element_energy::{ElementBatch, ElementInput};
use crate::kernel::jet::JetInput;
use crate::kernel::limit_surface::{LimitInput, LimitQuery};
use crate::kernel::restricted_voronoi::{Metric, RestrictedInput};
use crate::kernel::sparse::{Csr, SparseInput};
use crate::kernel::sum::{Segments, SumInput};
use crate::kernel::vsdm::{FixedSide, MovingSide};
use crate::mesh::{CellShape, ControlMesh, PolygonMesh, Scheme, TriangleMesh};
use crate::model::element::{
    Basis, Rule, corners, mode_count, reference_matrix, triangle_mode_count,
};
use crate::model::limit_surface::SurfaceParameter;
use glam::{DMat3, DVec3};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// The normal anisotropy of the samples: other than 1, so that all of a kernel runs.
const ANISOTROPY: f64 = 5.0;
/// Triangles to a seed: a scan is finer than the surface that is fitted to it.
const TRIANGLES_TO_SEED: usize = 8;
/// Records to a segment, as many as slots to a seed.
const RECORDS_TO_SEGMENT: usize = 12;
/// Entries to a row, and rows to a column: those of two subdivisions.
const ENTRIES: usize = 16;
/// The order of the hexahedra.
const ORDER: usize = 4;
/// Points that a jet is fitted to: those within four edges.
const JET_POINTS: usize = 60;
/// How far queries are from the surface, as a factor of its radius.
const QUERY_RADIUS: f64 = 1.02;

/// About `records` pairs of four-vectors in segments.
pub fn sums(records: usize) -> SumInput {
    let segments = (records / RECORDS_TO_SEGMENT).max(1);
    let keys = (0..records).map(|k| (k * 7919 % segments) as u32);
    SumInput {
        values: (0..2 * records).map(|k| [(k as f64).sin(); 4]).collect(),
        width: 2,
        segments: Segments::by_key(keys, segments),
    }
}

/// A matrix of `rows` rows times points.
pub fn product(rows: usize) -> SparseInput {
    let columns = (rows / ENTRIES).max(1);
    let weight = 1.0 / ENTRIES as f64;
    let column = |row: usize, k: usize| ((row / ENTRIES + 5 * k) % columns) as u32;
    SparseInput {
        matrix: Csr::build(rows, columns, |row, entries| {
            entries.extend((0..ENTRIES).map(|k| (column(row, k), weight)));
        }),
        points: (0..columns)
            .map(|k| DVec3::splat((k as f64).cos()))
            .collect(),
    }
}

/// As many queries near a sphere as it has triangles.
pub fn closest(triangles: usize) -> ClosestInput {
    let sphere = Sphere::new(triangles);
    let queries = spread(sphere.mesh.triangles.len());
    ClosestInput {
        points: queries.iter().map(|p| QUERY_RADIUS * *p).collect(),
        mesh: sphere.mesh,
    }
}

/// As many queries near the Loop surface of a sphere, with poles of valence 12, as there are triangles in a scan of it: eight to a control face.
pub fn limit(triangles: usize) -> LimitInput {
    let n = ((triangles / TRIANGLES_TO_SEED) as f64 / 24.0)
        .ceil()
        .max(2.0) as usize;
    let control = capped_sphere(12, n);
    let faces = control.mesh.face_count();
    let queries = (0..triangles)
        .map(|k| {
            let start = SurfaceParameter {
                face: (k % faces) as u32,
                u: 0.3,
                v: 0.4,
            };
            let corners = control.mesh.face(k % faces);
            let [a, b, c] = [0, 1, 2].map(|i| control.mesh.positions[corners[i] as usize]);
            let (s, t) = (0.5 + 0.4 * (k as f64).sin(), 0.5 + 0.4 * (k as f64).cos());
            let near = a.lerp(b, s).lerp(c, t);
            LimitQuery {
                point: QUERY_RADIUS * near,
                start,
                is_settled: false,
            }
        })
        .collect();
    LimitInput {
        control,
        scheme: Scheme::Loop,
        queries,
    }
}

/// The jets at an eighth as many vertices of a bumpy sheet, as many as all others have seeds.
pub fn jets(triangles: usize) -> JetInput {
    let groups = (triangles / TRIANGLES_TO_SEED).max(1);
    let golden = PI * (3.0 - 5f64.sqrt());
    let points = (0..groups * JET_POINTS).map(|k| {
        let (j, phase) = ((k % JET_POINTS) as f64, (k / JET_POINTS) as f64);
        let (y, x) = (golden * j).sin_cos();
        let r = 0.99 * ((j + 0.5) / JET_POINTS as f64).sqrt();
        let (x, y) = (r * x, r * y);
        DVec3::new(x, y, 0.1 * (x + phase).sin() * (1.3 * y - phase).cos())
    });
    JetInput {
        offsets: (0..=groups).map(|g| (g * JET_POINTS) as u32).collect(),
        points: points.collect(),
    }
}

/// The search for the seeds whose cells meet the triangles of a sphere.
pub fn candidates(triangles: usize) -> CandidateInput {
    CandidateInput {
        triangles: Sphere::new(triangles).corners(),
        seeds: spread(triangles / TRIANGLES_TO_SEED),
        slack: 0.0,
    }
}

/// The Voronoi cells of seeds on a sphere.
pub fn restricted(triangles: usize) -> RestrictedInput {
    let sphere = Sphere::new(triangles);
    let seeds = spread(triangles / TRIANGLES_TO_SEED);
    RestrictedInput {
        candidates: sphere.candidates(&seeds),
        triangles: sphere.corners(),
        seeds,
        metric: Metric::anisotropic(ANISOTROPY),
    }
}

/// The Voronoi cells of samples on a sphere that moves.
pub fn differentiated(triangles: usize) -> DifferentiatedInput {
    let sphere = Sphere::new(triangles);
    let samples = spread(triangles / TRIANGLES_TO_SEED);
    DifferentiatedInput {
        candidates: sphere.candidates(&samples),
        normals: samples.iter().map(|p| p.normalize()).collect(),
        triangles: sphere.mesh.triangles,
        points: sphere.mesh.positions,
        samples,
        metric: Metric::anisotropic(ANISOTROPY),
    }
}

/// Hexahedra of order 4 with about so many quadrature points.
///
/// # Errors
/// As [`curved`].
pub fn elements(points: usize) -> Result<ElementInput> {
    curved(
        CellShape::Hexahedron,
        ORDER,
        points.div_ceil((ORDER + 2).pow(3)),
    )
}

/// `count` ideal elements of a shape and an order with every mode disturbed a little.
///
/// # Errors
/// As [`element_tables`].
pub fn curved(shape: CellShape, order: usize, count: usize) -> Result<ElementInput> {
    let modes = mode_count(shape, order);
    let n = order + 1;
    let mut ideal = vec![DVec3::ZERO; modes];
    for &u in corners(shape) {
        let [x, y, z] = u.to_array().map(|x| x as usize);
        let mode = match shape {
            CellShape::Hexahedron => x + n * (y + n * z),
            CellShape::Prism => x + 2 * y + triangle_mode_count(order) * z,
            CellShape::Tetrahedron => x + 2 * y + 3 * z,
        };
        ideal[mode] = reference_matrix(shape) * u;
    }
    let size = 0.05 / (modes * order) as f64;
    let disturbed = |k: usize| {
        let t = k as f64;
        ideal[k % modes] + size * DVec3::new(t.sin(), (1.7 * t).cos(), (2.3 * t).sin())
    };
    Ok(ElementInput {
        batches: vec![ElementBatch {
            tables: Arc::new(element_tables(shape, Basis::Legendre, order, Rule::Gauss)?),
            inverse_references: vec![reference_matrix(shape).inverse(); count],
            weights: vec![1.0 / count as f64; count],
        }],
        coefficients: (0..count * modes).map(disturbed).collect(),
        distortion: Distortion::Strain,
    })
}

/// A sphere to be fitted to one of `triangles` triangles: both sides of the evaluation, its metric and control points to start from.
pub fn evaluation(triangles: usize) -> (FixedSide, MovingSide, Metric, Vec<DVec3>) {
    let target = Sphere::new(triangles);
    let mut surface = Sphere::new(2 * triangles / TRIANGLES_TO_SEED).mesh;
    // Turned, so that no edge of the target lies on a bisector by symmetry: the gradient jumps there, and the twins may take either side.
    let turn = DMat3::from_rotation_x(0.7) * DMat3::from_rotation_z(0.3);
    for p in &mut surface.positions {
        *p = QUERY_RADIUS * (turn * *p);
    }
    let count = surface.positions.len();
    let samples = spread(count);
    let normals = samples.iter().map(|p| p.normalize()).collect();
    (
        FixedSide::new(&target.corners(), samples, normals),
        MovingSide::new(Csr::identity(count), surface.triangles),
        Metric::anisotropic(ANISOTROPY),
        surface.positions,
    )
}

/// Points spread evenly over the sphere of diameter 1, by the golden angle; at least one.
fn spread(count: usize) -> Vec<DVec3> {
    let count = count.max(1);
    let golden = PI * (3.0 - 5f64.sqrt());
    (0..count)
        .map(|k| {
            let z = 1.0 - 2.0 * (k as f64 + 0.5) / count as f64;
            let around = golden * k as f64;
            let r = (1.0 - z * z).sqrt();
            0.5 * DVec3::new(r * around.cos(), r * around.sin(), z)
        })
        .collect()
}

/// A closed sphere of diameter 1: `rings` rings of `around` vertices between two poles.
fn capped_sphere(around: usize, rings: usize) -> ControlMesh {
    let down = |r: usize| PI * (r + 1) as f64 / (rings + 1) as f64;
    let mut positions = vec![0.5 * DVec3::Z, -0.5 * DVec3::Z];
    for k in 0..rings * around {
        let turn = TAU * (k % around) as f64 / around as f64;
        let (s, c) = down(k / around).sin_cos();
        positions.push(0.5 * DVec3::new(s * turn.cos(), s * turn.sin(), c));
    }
    let at = |r: usize, k: usize| (2 + r * around + k % around) as u32;
    let mut faces = Vec::new();
    for k in 0..around {
        faces.push([0, at(0, k), at(0, k + 1)]);
        for r in 1..rings {
            faces.push([at(r - 1, k), at(r, k), at(r, k + 1)]);
            faces.push([at(r - 1, k), at(r, k + 1), at(r - 1, k + 1)]);
        }
        faces.push([1, at(rings - 1, k + 1), at(rings - 1, k)]);
    }
    PolygonMesh::from_faces(positions, faces).into()
}

/// A sphere of diameter 1 by latitude and longitude, open at the poles, triangles in spatial order.
struct Sphere {
    mesh: TriangleMesh,
}

impl Sphere {
    /// Of about so many triangles.
    fn new(triangles: usize) -> Self {
        let n = ((triangles as f64 / 2.0).sqrt().round() as usize).max(3);
        let point = |k: usize| {
            let around = TAU * (k % n) as f64 / n as f64;
            let down = PI * ((k / n) as f64 + 0.5) / n as f64;
            let r = down.sin();
            0.5 * DVec3::new(r * around.cos(), r * around.sin(), down.cos())
        };
        let positions: Vec<_> = (0..n * n).map(point).collect();
        let at = |row: usize, column: usize| (row * n + column % n) as u32;
        let triangles: Vec<[u32; 3]> = (0..n * (n - 1))
            .map(|k| (k / n, k % n))
            .flat_map(|(r, c)| {
                let [a, b] = [at(r, c), at(r, c + 1)];
                let [c, d] = [at(r + 1, c), at(r + 1, c + 1)];
                [[a, c, b], [b, c, d]]
            })
            .collect();
        let center = |t: &[u32; 3]| t.map(|v| positions[v as usize]).iter().sum::<DVec3>() / 3.0;
        let order = spatial_order(&triangles.iter().map(center).collect::<Vec<_>>());
        let triangles = order.iter().map(|&t| triangles[t as usize]).collect();
        Self {
            mesh: TriangleMesh {
                positions,
                triangles,
            },
        }
    }

    fn corners(&self) -> Vec<[DVec3; 3]> {
        let count = self.mesh.triangles.len();
        (0..count).map(|t| self.mesh.corners(t)).collect()
    }

    fn candidates(&self, seeds: &[DVec3]) -> Candidates {
        let corners = self.corners();
        Candidates::find(&TriangleTree::new(&corners), &corners, seeds, 0.0)
    }
}
