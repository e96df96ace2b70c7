//! The surface under a shell, cut into faces that cells can stand on.

use crate::error::{Error, Result};
use crate::mesh::{Connectivity, PolygonMesh};
use glam::DVec3;

/// Quads with angles of a sine below this are cut into triangles.
const LEAST_SINE: f64 = 0.05;

/// The surface without vertices that no face uses, and with faces that cells can stand on.
///
/// # Errors
/// Where it is no oriented manifold, or a face has no area.
pub(super) fn checked(surface: &PolygonMesh) -> Result<PolygonMesh> {
    Connectivity::of(surface)?;
    let mut number = vec![u32::MAX; surface.positions.len()];
    surface
        .corners()
        .iter()
        .for_each(|&v| number[v as usize] = 0);
    let mut used = PolygonMesh::default();
    for (p, number) in surface
        .positions
        .iter()
        .zip(&mut number)
        .filter(|(_, n)| **n == 0)
    {
        *number = used.positions.len() as u32;
        used.positions.push(*p);
    }
    for (f, face) in surface.faces().enumerate() {
        let face: Vec<u32> = face.iter().map(|&v| number[v as usize]).collect();
        for part in convex_parts(&used.positions, face) {
            if least_sine(&used.positions, &part) <= 0.0 {
                return Err(Error::input(
                    format!("face {f} (counted from 0) has no area, or folds over itself"),
                    "mend the surface: no cell can stand on this face",
                ));
            }
            used.push_face(&part);
        }
    }
    Ok(used)
}

/// A polygon cut into triangles, unless it is a triangle or a convex quad: from the corner that leaves the least sharp angles.
fn convex_parts(positions: &[DVec3], face: Vec<u32>) -> Vec<Vec<u32>> {
    let n = face.len();
    if n == 3 || n == 4 && least_sine(positions, &face) > LEAST_SINE {
        return vec![face];
    }
    let fan = |from: usize| {
        let at = |k: usize| face[(from + k) % n];
        (2..n)
            .map(|k| vec![at(0), at(k - 1), at(k)])
            .collect::<Vec<_>>()
    };
    let across = area_vector(positions, &face);
    let least = |parts: &Vec<Vec<u32>>| {
        let sines = parts.iter().map(
            |part| match area_vector(positions, part).dot(across) > 0.0 {
                true => least_sine(positions, part),
                false => -1.0,
            },
        );
        sines.fold(1.0, f64::min)
    };
    let fans = (0..n).map(fan);
    fans.max_by(|a, b| least(a).total_cmp(&least(b)))
        .unwrap_or_default()
}

/// The least sine of the angles of a polygon; negative where it is not convex.
fn least_sine(positions: &[DVec3], face: &[u32]) -> f64 {
    let n = face.len();
    let across = area_vector(positions, face).normalize_or_zero();
    let sine = |k: usize| {
        let [before, at, after] = [k + n - 1, k, k + 1].map(|k| positions[face[k % n] as usize]);
        let (a, b) = (after - at, before - at);
        a.cross(b).dot(across) / (a.length() * b.length())
    };
    // Not a number where an edge has no length.
    (0..n)
        .map(sine)
        .fold(1.0, |least, s| if s >= least { least } else { s })
}

/// Twice the area of a polygon times its normal.
pub(super) fn area_vector(positions: &[DVec3], face: &[u32]) -> DVec3 {
    let at = |k: usize| positions[face[k] as usize] - positions[face[0] as usize];
    (2..face.len()).map(|k| at(k - 1).cross(at(k))).sum()
}
