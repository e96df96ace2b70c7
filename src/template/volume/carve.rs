//! Carving: what is left of a mesh when the cells outside of a target are dropped.
//!
//! A cell stays where the winding number is above ½ at enough of its [samples](sample_weights). What is left would seldom have a manifold for its boundary; so of it
//! - the largest set of cells connected through faces stays,
//! - cavities, which the outside does not reach through faces, are filled,
//! - cells are put back where two sheets of the boundary touch in an edge or a vertex, until none do ([`Complex::fill_pinches`]).
//!
//! Handles and tunnels stay as the cells have them: the Euler characteristic of the boundary says how many.

use super::{checked, part};
use crate::error::{Error, Result};
use crate::geometry::winding::WindingNumbers;
use crate::mesh::{CellShape, TriangleMesh, VolumeMesh, check_volume};
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::HashMap;

/// Samples of a cell in each direction.
const SAMPLES: usize = 3;

/// The part of a mesh whose cells have at least `share` (0 to 1) of their samples inside a target, connected and with a manifold boundary.
///
/// The target may have holes, overlaps and bad triangles; a few microseconds a sample.
///
/// # Errors
/// Where nothing is left, and as [`checked`].
pub fn carve(mesh: &VolumeMesh, target: &TriangleMesh, share: f64) -> Result<VolumeMesh> {
    check_volume::sound(mesh)?;
    let surface = WindingNumbers::of(target);
    // Whichever way the target faces.
    let inside = |numbers: Vec<f64>| numbers.into_iter().map(|w| w.abs() > 0.5).collect();
    let shares = shares_inside(mesh, |points| inside(surface.at_all(points)));
    checked(carved(mesh, &shares, share)?)
}

/// The share of the samples of each cell that are inside. `[cells]`.
pub(super) fn shares_inside(
    mesh: &VolumeMesh,
    are_inside: impl FnOnce(&[DVec3]) -> Vec<bool>,
) -> Vec<f64> {
    let weights = CellShape::ALL.map(sample_weights);
    let samples: Vec<DVec3> = mesh
        .cells()
        .flat_map(|(shape, cell)| {
            let at = |k: usize| mesh.positions[cell[k] as usize];
            weights[shape as usize]
                .iter()
                .map(move |weights| weights.iter().map(|&(k, w)| w * at(k)).sum::<DVec3>())
        })
        .collect();
    let share = |samples: &[bool]| {
        let inside = samples.iter().filter(|is_inside| **is_inside).count();
        inside as f64 / samples.len() as f64
    };
    are_inside(&samples)
        .chunks(SAMPLES.pow(3))
        .map(share)
        .collect()
}

/// The samples of a cell, as weights of its corners: the middles of 3³ equal parts of the unit cube, prisms and tetrahedra being taken for hexahedra of which
/// edges and faces have collapsed.
fn sample_weights(shape: CellShape) -> Vec<Vec<(usize, f64)>> {
    let corners = match shape {
        CellShape::Hexahedron => [0, 1, 2, 3, 4, 5, 6, 7],
        CellShape::Prism => [0, 1, 2, 2, 3, 4, 5, 5],
        CellShape::Tetrahedron => [0, 1, 2, 2, 3, 3, 3, 3],
    };
    let middle = |i: usize| (i as f64 + 0.5) / SAMPLES as f64;
    let weights = |at: [usize; 3]| {
        let [u, v, w] = at.map(middle);
        let square = [(1.0 - u) * (1.0 - v), u * (1.0 - v), u * v, (1.0 - u) * v];
        let weight = move |k: usize| square[k % 4] * if k < 4 { 1.0 - w } else { w };
        (0..8).map(|k| (corners[k], weight(k))).collect()
    };
    let lines = (0..SAMPLES).flat_map(|k| (0..SAMPLES).map(move |j| (j, k)));
    lines
        .flat_map(|(j, k)| (0..SAMPLES).map(move |i| weights([i, j, k])))
        .collect()
}

/// [`carve`] of a sound mesh by given shares, `[cells]`; straight edges stay as they are, so that what was not inverted is not.
///
/// # Errors
/// Where no cell has the share.
pub(super) fn carved(mesh: &VolumeMesh, shares: &[f64], least: f64) -> Result<VolumeMesh> {
    let mut complex = Complex::of(mesh);
    complex.is_kept = shares.iter().map(|&share| share >= least).collect();
    if !complex.is_kept.contains(&true) {
        return Err(Error::input(
            "no cell lies inside the target",
            "give a mesh over the target, smaller cells or a smaller share",
        ));
    }
    complex.keep_largest();
    complex.fill_cavities();
    complex.fill_pinches(shares);
    // Filling may have closed a cavity.
    complex.fill_cavities();
    Ok(part(mesh, |c| complex.is_kept[c]))
}

/// Which cells are kept, and who is next to whom.
struct Complex<'a> {
    mesh: &'a VolumeMesh,
    /// `[cells, faces of the cell]`: the cell beyond.
    beyond: Vec<Vec<Option<u32>>>,
    /// `[vertices]`: its cells.
    around: Vec<Vec<u32>>,
    is_kept: Vec<bool>,
}

impl<'a> Complex<'a> {
    fn of(mesh: &'a VolumeMesh) -> Self {
        let mut beyond: Vec<Vec<Option<u32>>> = mesh
            .cells()
            .map(|(shape, _)| vec![None; shape.faces().len()])
            .collect();
        let mut around = vec![Vec::new(); mesh.positions.len()];
        let mut open: HashMap<Vec<u32>, (usize, usize)> = HashMap::new();
        for (c, (shape, cell)) in mesh.cells().enumerate() {
            for &v in cell {
                around[v as usize].push(c as u32);
            }
            for (f, face) in shape.faces().iter().enumerate() {
                let mut key: Vec<u32> = face.iter().map(|&k| cell[k]).collect();
                key.sort_unstable();
                if let Some((other, g)) = open.remove(&key) {
                    beyond[c][f] = Some(other as u32);
                    beyond[other][g] = Some(c as u32);
                } else {
                    open.insert(key, (c, f));
                }
            }
        }
        Self {
            mesh,
            beyond,
            around,
            is_kept: vec![true; mesh.cell_count()],
        }
    }

    /// Keeps the largest of the sets of cells that are connected through faces; of equal ones the first.
    fn keep_largest(&mut self) {
        let mut seen = vec![false; self.is_kept.len()];
        let mut largest = Vec::new();
        for c in 0..self.is_kept.len() {
            if self.is_kept[c] && !seen[c] {
                let found = self.flood(vec![c], &mut seen);
                if found.len() > largest.len() {
                    largest = found;
                }
            }
        }
        self.is_kept.fill(false);
        for c in largest {
            self.is_kept[c] = true;
        }
    }

    /// Keeps the cells that the outside of the mesh does not reach through dropped ones.
    fn fill_cavities(&mut self) {
        let outermost = |c: &usize| !self.is_kept[*c] && self.beyond[*c].contains(&None);
        let start: Vec<usize> = (0..self.is_kept.len()).filter(outermost).collect();
        let mut seen = vec![false; self.is_kept.len()];
        self.flood(start, &mut seen);
        self.is_kept = seen.into_iter().map(|is_outside| !is_outside).collect();
    }

    /// What is connected with `found` through faces and as much kept; marks it as seen.
    fn flood(&self, mut found: Vec<usize>, seen: &mut [bool]) -> Vec<usize> {
        found.iter().for_each(|&c| seen[c] = true);
        let mut next = 0;
        while let Some(&c) = found.get(next) {
            next += 1;
            for n in self.beyond[c].iter().flatten().map(|&n| n as usize) {
                if self.is_kept[n] == self.is_kept[c] && !std::mem::replace(&mut seen[n], true) {
                    found.push(n);
                }
            }
        }
        found
    }

    /// Puts cells back until the boundary is a manifold.
    ///
    /// It is a disc at a vertex where both the kept and the other cells around it are connected through faces, with all that is outside of the mesh for one cell.
    /// Elsewhere the cell is put back that leaves the fewest pieces; of equal ones that with the largest share. It ends, for the whole mesh has a manifold
    /// boundary.
    fn fill_pinches(&mut self, shares: &[f64]) {
        let mut pending: Vec<u32> = (0..self.around.len() as u32).rev().collect();
        while let Some(v) = pending.pop() {
            if self.around[v as usize].is_empty() || self.pieces_at(v) <= 2 {
                continue;
            }
            let mut dropped = self.around[v as usize].clone();
            dropped.retain(|&c| !self.is_kept[c as usize]);
            let rank = |c: u32| {
                self.is_kept[c as usize] = true;
                let pieces = self.pieces_at(v);
                self.is_kept[c as usize] = false;
                // Shares are not negative, so that their bits are ordered as they are.
                (pieces, Reverse(shares[c as usize].to_bits()), c)
            };
            let Some((.., best)) = dropped.into_iter().map(rank).min() else {
                continue;
            };
            self.is_kept[best as usize] = true;
            pending.extend_from_slice(self.mesh.cell(best as usize));
        }
    }

    /// In how many pieces the kept and the other cells around a vertex are; no more than two where the boundary is a disc there, or nowhere.
    fn pieces_at(&self, v: u32) -> usize {
        let cells = &self.around[v as usize];
        // The outside of the mesh comes last.
        let outside = cells.len();
        let mut root: Vec<usize> = (0..=outside).collect();
        fn find(root: &mut [usize], mut k: usize) -> usize {
            while root[k] != k {
                k = root[k];
            }
            k
        }
        let mut meets_outside = false;
        for (k, &c) in cells.iter().enumerate() {
            let cell = self.mesh.cell(c as usize);
            let faces = self.mesh.shape(c as usize).faces();
            for (face, beyond) in faces.iter().zip(&self.beyond[c as usize]) {
                if !face.iter().any(|&corner| cell[corner] == v) {
                    continue;
                }
                let other = match beyond {
                    Some(n) => cells.iter().position(|m| m == n),
                    None => Some(outside),
                };
                meets_outside |= beyond.is_none();
                let kept = |k: usize| k < outside && self.is_kept[cells[k] as usize];
                if let Some(other) = other.filter(|&o| kept(o) == kept(k)) {
                    let (a, b) = (find(&mut root, k), find(&mut root, other));
                    root[a.max(b)] = a.min(b);
                }
            }
        }
        let members = outside + usize::from(meets_outside);
        (0..members).filter(|&k| root[k] == k).count()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Course, extrude, grid};
    use super::*;
    use crate::geometry::random::Random;
    use crate::mesh::{Connectivity, PolygonMesh, shapes};

    fn euler(mesh: &VolumeMesh) -> i64 {
        let surface = Connectivity::of(&super::super::boundary(mesh)).expect("a manifold");
        surface.euler_characteristic()
    }

    /// Five cubes an axis, of which those are inside that are marked.
    fn of_cubes(marked: impl Fn([usize; 3]) -> bool) -> VolumeMesh {
        let mesh = grid(DVec3::ZERO, DVec3::splat(5.0), [5; 3]);
        let place = |c: usize| [c % 5, c / 5 % 5, c / 25];
        let shares: Vec<f64> = (0..125)
            .map(|c| f64::from(u8::from(marked(place(c)))))
            .collect();
        carved(&mesh, &shares, 0.5).expect("something inside")
    }

    #[test]
    fn nothing_inside_is_refused() {
        let ball = shapes::sphere(1.0, 2);
        let far = grid(DVec3::splat(3.0), DVec3::splat(4.0), [2; 3]);
        for target in [&ball, &TriangleMesh::default()] {
            let message = carve(&far, target, 0.5).unwrap_err().to_string();
            assert!(message.contains("no cell lies inside"), "{message}");
        }
        assert!(carve(&VolumeMesh::default(), &ball, 0.5).is_err());
    }

    #[test]
    fn a_ball_is_carved_whichever_way_it_faces() {
        let mut ball = shapes::sphere(1.0, 3);
        let mesh = grid(DVec3::splat(-1.2), DVec3::splat(1.2), [12; 3]);
        let carved = carve(&mesh, &ball, 0.5).unwrap();
        let volume = 0.2f64.powi(3) * carved.cell_count() as f64;
        assert!((volume - 4.19).abs() < 0.42, "{volume}");
        assert_eq!(euler(&carved), 2);
        ball.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(carve(&mesh, &ball, 0.5).unwrap(), carved);
        let whole = carve(&mesh, &ball, 1.0).unwrap();
        assert!(whole.cell_count() < carved.cell_count());
    }

    #[test]
    fn random_cells_become_a_manifold() {
        let triangles: PolygonMesh = shapes::box_grid(DVec3::ZERO, DVec3::ONE, [3; 3])
            .triangulate()
            .into();
        let shell = extrude(&triangles, Course::Normals(-0.2), 2).unwrap();
        let cubes = grid(DVec3::ZERO, DVec3::ONE, [7; 3]);
        let mut random = Random::new(11);
        for (mesh, least) in [&shell, &cubes]
            .into_iter()
            .flat_map(|mesh| [0.3, 0.5, 0.7, 0.9].map(|least| (mesh, least)))
        {
            let shares: Vec<f64> = (0..mesh.cell_count()).map(|_| random.uniform()).collect();
            let carved = checked(carved(mesh, &shares, least).unwrap()).unwrap();
            assert_eq!(check_volume::sound(&carved).unwrap().pieces, 1);
        }
    }

    #[test]
    fn pinches_and_cavities_are_filled_and_tunnels_stay() {
        let pair = |other| of_cubes(|at| at == [1, 1, 1] || at == [1, 1, 2] || at == other);
        assert_eq!(pair([1, 2, 2]).cell_count(), 3);
        // What touches in an edge only is another piece.
        assert_eq!(pair([2, 2, 2]).cell_count(), 2);
        let corner = |at: [usize; 3]| at.iter().all(|&i| i < 2) && at != [0, 0, 0] && at != [1; 3];
        assert_eq!(of_cubes(corner).cell_count(), 7);
        let ring = |at: [usize; 3]| at[2] == 0 && at.iter().all(|&i| i < 3) && at != [1, 1, 0];
        assert_eq!(euler(&of_cubes(ring)), 0);
        assert_eq!(of_cubes(|at| at != [2; 3]).cell_count(), 125);
    }
}
