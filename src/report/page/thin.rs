//! Large meshes made smaller for looking at.

use crate::mesh::TriangleMesh;
use glam::DVec3;
use std::collections::{HashMap, HashSet};

/// A mesh of at most `limit` triangles (a cloud: points), with the vertex of the given one that each vertex stands for.
///
/// Vertices that share a cell of a grid become one, at their mean; the grid is made coarser until the limit is met. This takes any soup and costs
/// little; [`crate::topology::simplify()`] gives better meshes, for work.
pub(super) fn thinned(mesh: &TriangleMesh, limit: usize) -> (TriangleMesh, Vec<u32>) {
    let size = |mesh: &TriangleMesh| match mesh.triangles.len() {
        0 => mesh.positions.len(),
        triangles => triangles,
    };
    if size(mesh) <= limit {
        return (mesh.clone(), (0..mesh.positions.len() as u32).collect());
    }
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (lo, hi) = mesh
        .positions
        .iter()
        .fold(start, |(lo, hi), &p| (lo.min(p), hi.max(p)));
    let extent = (hi - lo).max_element();
    // A surface meets about as many cells as the square of their number along a side.
    let mut cells = (limit as f64).sqrt();
    loop {
        let thin = clustered(mesh, lo, extent / cells);
        let found = size(&thin.0);
        if found <= limit || cells <= 1.0 {
            // Where one cell is left there are at most eight vertices.
            return thin;
        }
        cells = (cells * (limit as f64 / found as f64).sqrt().min(0.97)).max(1.0);
    }
}

fn clustered(mesh: &TriangleMesh, lo: DVec3, cell: f64) -> (TriangleMesh, Vec<u32>) {
    let mut numbers: HashMap<[u32; 3], u32> = HashMap::new();
    let mut clusters: Vec<(DVec3, f64, u32)> = Vec::new();
    let mut places = Vec::with_capacity(mesh.positions.len());
    for (v, &p) in mesh.positions.iter().enumerate() {
        let key = ((p - lo) / cell).to_array().map(|x| x as u32);
        let number = *numbers.entry(key).or_insert_with(|| {
            clusters.push((DVec3::ZERO, 0.0, v as u32));
            (clusters.len() - 1) as u32
        });
        let (sum, count, _) = &mut clusters[number as usize];
        *sum += p - lo;
        *count += 1.0;
        places.push(number);
    }
    let mut seen = HashSet::new();
    let mut is_new = |&[a, b, c]: &[u32; 3]| {
        let mut sorted = [a, b, c];
        sorted.sort_unstable();
        a != b && b != c && c != a && seen.insert(sorted)
    };
    let triangles = mesh.triangles.iter().map(|t| t.map(|v| places[v as usize]));
    let thin = TriangleMesh {
        positions: clusters
            .iter()
            .map(|(sum, count, _)| lo + *sum / *count)
            .collect(),
        triangles: triangles.filter(|t| is_new(t)).collect(),
    };
    (
        thin,
        clusters.into_iter().map(|(_, _, first)| first).collect(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn a_thinned_ball_is_still_one() {
        let ball = shapes::sphere(1.0, 5);
        assert_eq!(thinned(&ball, 20_480).0, ball);
        let (thin, sources) = thinned(&ball, 3000);
        assert!(
            (1000..=3000).contains(&thin.triangles.len()),
            "{}",
            thin.triangles.len()
        );
        for (p, &v) in thin.positions.iter().zip(&sources) {
            assert!((p.length() - 1.0).abs() < 0.01);
            assert!(p.distance(ball.positions[v as usize]) < 0.1);
        }
    }

    #[test]
    fn clouds_and_piles_of_triangles_end() {
        let cloud = TriangleMesh {
            positions: shapes::sphere(1.0, 4).positions,
            triangles: vec![],
        };
        assert!((300..=1000).contains(&thinned(&cloud, 1000).0.positions.len()));
        let pile = TriangleMesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            triangles: vec![[0, 1, 2]; 50],
        };
        assert_eq!(thinned(&pile, 10).0.triangles.len(), 1);
    }
}
