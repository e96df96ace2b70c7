//! More control points where the error is large, and a regular mesh again.

use super::footpoints::Sample;
use crate::error::Result;
use crate::mesh::{Connectivity, ControlMesh};
use crate::model::limit_surface::{LimitSurface, SurfaceParameter};
use crate::topology::{self, Flip, flip_for_angles, flip_for_valence, split::closure};
use glam::DVec2;
use rayon::prelude::*;

/// Splits faces whose error, in tolerances, is above 1, worst first, to at most `most` control points; then flips edges.
///
/// `surface`: of `control`. `errors`: `[faces]`. The samples' footpoints are taken along. Returns whether anything was split.
///
/// # Errors
/// Where the mesh is no oriented manifold of triangles.
pub(super) fn refine(
    control: &mut ControlMesh,
    surface: &LimitSurface,
    errors: &[f64],
    most: usize,
    samples: &mut [Sample],
) -> Result<bool> {
    let marked = mark(surface.connectivity(), errors, most);
    if !marked.contains(&true) {
        return Ok(false);
    }
    let subdivided = surface.refined(&control.mesh.positions);
    let mut split = topology::split(control, &marked, &subdivided)?;
    let mut flips = flip_for_valence(&mut split.control)?;
    flips.extend(flip_for_angles(&mut split.control)?);
    samples.par_iter_mut().for_each(|sample| {
        move_to(sample, split.locate(sample.at.face, parameters(sample)));
    });
    follow(&flips, split.control.mesh.face_count(), samples);
    *control = split.control;
    Ok(true)
}

fn parameters(sample: &Sample) -> DVec2 {
    DVec2::new(sample.at.u, sample.at.v)
}

fn move_to(sample: &mut Sample, (face, at): (u32, DVec2)) {
    let (u, v) = (at.x, at.y);
    sample.at = SurfaceParameter { face, u, v };
}

/// Takes samples along with the flips of the faces that they are in.
fn follow(flips: &[Flip], faces: usize, samples: &mut [Sample]) {
    let mut is_flipped = vec![false; faces];
    for &face in flips.iter().flat_map(|flip| &flip.faces) {
        is_flipped[face as usize] = true;
    }
    let mut within = vec![Vec::new(); faces];
    for (k, sample) in samples.iter().enumerate() {
        if is_flipped[sample.at.face as usize] {
            within[sample.at.face as usize].push(k);
        }
    }
    for flip in flips {
        let inside = flip.faces.map(|f| std::mem::take(&mut within[f as usize]));
        for k in inside.into_iter().flatten() {
            let sample = &mut samples[k];
            move_to(sample, flip.locate(sample.at.face, parameters(sample)));
            within[sample.at.face as usize].push(k);
        }
    }
}

/// The faces to split.
fn mark(mesh: &Connectivity, errors: &[f64], most: usize) -> Vec<bool> {
    let mut worst: Vec<usize> = (0..errors.len()).filter(|&f| errors[f] > 1.0).collect();
    worst.sort_by(|&a, &b| errors[b].total_cmp(&errors[a]).then(a.cmp(&b)));
    let first = |count: usize| {
        let mut marked = vec![false; errors.len()];
        worst[..count].iter().for_each(|&f| marked[f] = true);
        marked
    };
    // The number of cut edges grows with that of marked faces.
    let (mut fits, mut beyond) = (0, worst.len() + 1);
    while fits + 1 < beyond {
        let middle = fits.midpoint(beyond);
        if mesh.vertex_count() + cut_edges(mesh, &first(middle)) <= most {
            fits = middle;
        } else {
            beyond = middle;
        }
    }
    first(fits)
}

/// The vertices that a split adds.
fn cut_edges(mesh: &Connectivity, marked: &[bool]) -> usize {
    let whole = closure(mesh, marked);
    let is_whole = |h: u32| whole[mesh.face_of(h) as usize];
    (0..mesh.edge_count() as u32)
        .map(|e| mesh.half_edge(e))
        .filter(|&h| is_whole(h) || mesh.opposite(h).is_some_and(is_whole))
        .count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{PolygonMesh, Scheme, shapes};
    use glam::DVec3;

    #[test]
    fn the_worst_faces_are_split_and_the_count_is_kept() {
        let ball = ControlMesh::from(PolygonMesh::from(shapes::sphere(1.0, 2)));
        let vertices = ball.mesh.positions.len();
        let errors: Vec<f64> = (0..ball.mesh.face_count())
            .map(|f| f as f64 / 200.0)
            .collect();
        for most in [vertices, vertices + 2, vertices + 20, vertices + 1000] {
            let mut control = ball.clone();
            let mut samples: Vec<Sample> = (0..320)
                .map(|face| {
                    let mut sample = Sample::new(DVec3::ZERO, None);
                    sample.is_known = true;
                    (sample.at.face, sample.at.u, sample.at.v) = (face, 0.25, 0.5);
                    sample
                })
                .collect();
            let surface = LimitSurface::new(&control, Scheme::Loop).unwrap();
            let split = refine(&mut control, &surface, &errors, most, &mut samples).unwrap();
            let count = control.mesh.positions.len();
            assert_eq!(split, most >= vertices + 3);
            assert!(count <= most && (count > vertices) == split);
            Connectivity::of(&control.mesh).unwrap().validate().unwrap();
            let faces = control.mesh.face_count() as u32;
            assert!(samples.iter().all(|s| s.at.face < faces));
            assert!(samples.iter().all(|s| s.is_known));
        }
    }

    #[test]
    fn nothing_above_the_tolerance_leaves_all_as_it_is() {
        let mut ball = ControlMesh::from(PolygonMesh::from(shapes::sphere(1.0, 1)));
        let same = ball.clone();
        let errors = vec![1.0; ball.mesh.face_count()];
        let surface = LimitSurface::new(&ball, Scheme::Loop).unwrap();
        assert!(!refine(&mut ball, &surface, &errors, 10_000, &mut []).unwrap());
        assert_eq!(ball, same);
    }
}
