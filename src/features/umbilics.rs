//! Umbilics: where both principal curvatures are the same, and directions turn by half a turn around a point.
//!
//! **Theory.** Around a face the direction d₁ turns by a multiple of ½. With α_v(e) the angle from edge e, projected to the tangent plane of v, to d₁ at v,
//! the index is [Σ_e red(α_j(e) − α_i(e)) + Σ corners − π] / 2π, where red reduces modulo π to (−½π, ½π] and corners are the angles between the projected
//! edges. Reduced turns cancel at every edge and corners make 2π at every vertex, so that over a closed surface the indices sum to V − ½F = χ, exactly.
//! An umbilic is elliptic (three ridges through it; index −½) where its cubic (b₀, 3b₁, 3b₂, b₃) has three real factors, else hyperbolic.
//!
//! **Practice.** Pairs of opposite index in neighbouring faces cancel: noise makes them.

use super::edges::{Edges, NONE};
use super::vertices::{Trust, Vertices};
use super::{Umbilic, UmbilicKind};
use crate::mesh::TriangleMesh;
use crate::mesh::sample::SurfacePoint;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// An umbilic counts where the difference of the curvatures grows away from it by so many times the error of third derivatives …
const SURE: f64 = 3.0;
/// … and where the surface bends by this angle over that radius: flat regions have umbilics everywhere.
const FLAT: f64 = 0.01;

/// Twice the index of every face.
pub(super) fn indices(mesh: &TriangleMesh, vertices: &Vertices) -> Vec<i8> {
    mesh.triangles
        .par_iter()
        .with_min_len(1024)
        .map(|&triangle| {
            let corners = triangle.map(|v| {
                let form = &vertices.forms[v as usize];
                (mesh.positions[v as usize], form.normal, form.directions[0])
            });
            twice_index(corners)
        })
        .collect()
}

/// Of a face by positions, normals and directions at its corners; 0 where those are missing.
fn twice_index(corners: [(DVec3, DVec3, DVec3); 3]) -> i8 {
    let angle =
        |normal: DVec3, from: DVec3, to: DVec3| normal.dot(from.cross(to)).atan2(from.dot(to));
    let flat = |normal: DVec3, v: DVec3| v - v.dot(normal) * normal;
    let mut sum = -PI;
    for k in 0..3 {
        let (p, n_p, d_p) = corners[k];
        let (q, n_q, d_q) = corners[(k + 1) % 3];
        let (r, ..) = corners[(k + 2) % 3];
        if n_p == DVec3::ZERO {
            return 0;
        }
        let edge = q - p;
        let (edge_p, edge_q) = (flat(n_p, edge), flat(n_q, edge));
        sum += reduced(angle(n_q, edge_q, d_q) - angle(n_p, edge_p, d_p));
        sum += angle(n_p, edge_p, flat(n_p, r - p));
    }
    (sum / PI).round().clamp(-4.0, 4.0) as i8
}

/// Modulo π, into (−½π, ½π].
fn reduced(angle: f64) -> f64 {
    let turns = (angle / PI).round();
    let rest = angle - turns * PI;
    if rest <= -0.5 * PI { rest + PI } else { rest }
}

/// The umbilics of a mesh, those nearest to a plane last. Flat regions, where curvatures are errors, have none.
pub(super) fn umbilics(
    mesh: &TriangleMesh,
    edges: &Edges,
    vertices: &Vertices,
    is_known: &[bool],
) -> Vec<Umbilic> {
    let mut indices = indices(mesh, vertices);
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        if !triangle.iter().all(|&v| is_known[v as usize]) {
            indices[t] = 0;
        }
    }
    cancel(&mut indices, mesh, edges);
    let found = |t: usize| umbilic(mesh, vertices, t, indices[t]);
    let mut umbilics: Vec<Umbilic> = (0..indices.len())
        .filter(|&t| indices[t] != 0)
        .filter_map(found)
        .collect();
    umbilics.sort_by(|a, b| b.curvature.abs().total_cmp(&a.curvature.abs()));
    umbilics
}

/// Takes away what opposite neighbours have in common: across edges first, then across vertices.
fn cancel(indices: &mut [i8], mesh: &TriangleMesh, edges: &Edges) {
    for faces in edges.faces.iter().filter(|faces| faces[1] != NONE) {
        cancel_among(indices, faces);
    }
    let mut around: std::collections::BTreeMap<u32, Vec<u32>> = Default::default();
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        if indices[t] != 0 {
            for &v in triangle {
                around.entry(v).or_default().push(t as u32);
            }
        }
    }
    for faces in around.values() {
        for (k, f) in faces.iter().enumerate() {
            for g in &faces[..k] {
                cancel_among(indices, &[*f, *g]);
            }
        }
    }
}

fn cancel_among(indices: &mut [i8], faces: &[u32; 2]) {
    let [a, b] = faces.map(|f| indices[f as usize]);
    if i32::from(a) * i32::from(b) < 0 {
        let common = a.abs().min(b.abs());
        indices[faces[0] as usize] -= common * a.signum();
        indices[faces[1] as usize] -= common * b.signum();
    }
}

/// The umbilic of a face; `None` where it cannot be told from noise.
fn umbilic(mesh: &TriangleMesh, vertices: &Vertices, t: usize, twice_index: i8) -> Option<Umbilic> {
    let triangle = mesh.triangles[t];
    let forms = triangle.map(|v| vertices.forms[v as usize]);
    let curvature = forms
        .iter()
        .map(|f| 0.5 * (f.curvatures[0] + f.curvatures[1]))
        .sum::<f64>()
        / 3.0;
    let normal = mesh.area_vector(t).normalize_or_zero();
    let (x, y) = normal.try_normalize().map(DVec3::any_orthonormal_pair)?;
    // Directions in the face: numbers that a half turn does not change, and the cubics turned into its frame.
    let mut differences = [DVec2::ZERO; 3];
    let mut cubic = [0.0; 4];
    for (form, difference) in forms.iter().zip(&mut differences) {
        let flat = DVec2::new(form.directions[0].dot(x), form.directions[0].dot(y));
        let flat = flat.normalize_or(DVec2::X);
        let doubled = DVec2::new(flat.x * flat.x - flat.y * flat.y, 2.0 * flat.x * flat.y);
        *difference = (form.curvatures[0] - form.curvatures[1]) * doubled;
        for (sum, b) in cubic.iter_mut().zip(turned(form.third, flat)) {
            *sum += b;
        }
    }
    let cubic = cubic.map(|b| b / 3.0);
    let mean = |of: fn(&Trust) -> f64| {
        triangle
            .map(|v| of(&vertices.trust[v as usize]))
            .iter()
            .sum::<f64>()
            / 3.0
    };
    let (radius, error) = (mean(|trust| trust.radius), mean(|trust| trust.third_error));
    if curvature.abs() * radius < FLAT || growth(cubic) < SURE * error {
        return None;
    }
    let barycentric = zero(differences);
    let place = SurfacePoint {
        triangle: t as u32,
        barycentric,
    };
    let kind = match discriminant(cubic) > 0.0 {
        true => UmbilicKind::Elliptic,
        false => UmbilicKind::Hyperbolic,
    };
    Some(Umbilic {
        place,
        position: place.position(mesh.corners(t)),
        index: 0.5 * f64::from(twice_index),
        kind,
        is_sure: twice_index.abs() == 1 && (kind == UmbilicKind::Hyperbolic || twice_index == -1),
        curvature,
    })
}

/// How fast the difference of the curvatures grows with the distance from an umbilic: the geometric mean over directions.
fn growth([b0, b1, b2, b3]: [f64; 4]) -> f64 {
    // The traceless part of the second derivatives is linear in the place: (b₀ − b₂, 2b₁) along x and (b₁ − b₃, 2b₂) along y.
    (2.0 * ((b0 - b2) * b2 - (b1 - b3) * b1)).abs().sqrt()
}

/// A symmetric cubic b₀x³ + 3b₁x²y + 3b₂xy² + b₃y³ in a frame whose x axis is `first`, in the frame that `first` is given in.
fn turned([b0, b1, b2, b3]: [f64; 4], first: DVec2) -> [f64; 4] {
    let (c, s) = (first.x, first.y);
    // Polarized: the value on three vectors, which are old components of the new axes.
    let value = |u: [DVec2; 3]| {
        let [p, q, r] = u;
        b0 * p.x * q.x * r.x
            + b1 * (p.x * q.x * r.y + p.x * q.y * r.x + p.y * q.x * r.x)
            + b2 * (p.x * q.y * r.y + p.y * q.x * r.y + p.y * q.y * r.x)
            + b3 * p.y * q.y * r.y
    };
    let (x, y) = (DVec2::new(c, -s), DVec2::new(s, c));
    [[x, x, x], [x, x, y], [x, y, y], [y, y, y]].map(value)
}

/// Of a cubic form b₀x³ + 3b₁x²y + 3b₂xy² + b₃y³: positive where it has three real factors.
fn discriminant([b0, b1, b2, b3]: [f64; 4]) -> f64 {
    let (a, b, c, d) = (b0, 3.0 * b1, 3.0 * b2, b3);
    18.0 * a * b * c * d - 4.0 * b * b * b * d + b * b * c * c
        - 4.0 * a * c * c * c
        - 27.0 * a * a * d * d
}

/// Where a linear field over a triangle vanishes, or the nearest place within: the middle where there is none.
fn zero([a, b, c]: [DVec2; 3]) -> [f64; 3] {
    let weights = [b.perp_dot(c), c.perp_dot(a), a.perp_dot(b)];
    let sum: f64 = weights.iter().sum();
    let inside = weights.map(|w| (w / sum).max(0.0));
    let total: f64 = inside.iter().sum();
    match total.is_finite() && total > 0.0 {
        true => inside.map(|w| w / total),
        false => [1.0 / 3.0; 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Device;
    use crate::features::Scale;
    use crate::features::neighbourhood::Adjacency;
    use crate::geometry::random::Random;
    use crate::mesh::shapes;

    #[test]
    fn indices_sum_to_the_euler_characteristic() {
        let mut rough = shapes::lobed_ball(4);
        let mut random = Random::new(3);
        for p in &mut rough.positions {
            *p *= 1.0 + 2e-3 * random.normal();
        }
        let torus = shapes::torus(2.0, 0.7, 60, 20).triangulate();
        for (mesh, expected) in [(shapes::lobed_ball(4), 2), (rough, 2), (torus, 0)] {
            let barriers = vec![false; mesh.positions.len()];
            let adjacency = Adjacency::of(&mesh);
            let vertices =
                Vertices::fit(&Device::Cpu, &mesh, &adjacency, &barriers, Scale::Automatic)
                    .unwrap();
            let twice: i32 = indices(&mesh, &vertices).into_iter().map(i32::from).sum();
            assert_eq!(twice, 2 * expected);
        }
    }

    #[test]
    fn cubics_turn_as_tensors() {
        let cubic = [0.3, -0.2, 0.5, 0.1];
        let value = |[a, b, c, d]: [f64; 4], p: DVec2| {
            a * p.x.powi(3)
                + 3.0 * b * p.x * p.x * p.y
                + 3.0 * c * p.x * p.y * p.y
                + d * p.y.powi(3)
        };
        let first = DVec2::from_angle(0.7);
        let p = DVec2::new(0.4, -1.1);
        let outside = turned(cubic, first);
        assert!((value(outside, first.rotate(p)) - value(cubic, p)).abs() < 1e-14);
        assert!((discriminant(outside) - discriminant(cubic)).abs() < 1e-14);
        // x³ − 3xy² has three real factors, x³ + 3xy² one.
        assert!(
            discriminant([1.0, 0.0, -1.0, 0.0]) > 0.0 && discriminant([1.0, 0.0, 1.0, 0.0]) < 0.0
        );
    }
}
