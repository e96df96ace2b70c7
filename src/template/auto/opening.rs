//! Open skins: a closed skin cut away where the target has holes, its border on the target's rims.
//!
//! What of a skin is to go has nothing of the target near, or only a rim, or a sheet that faces the other way (the second side of an open sheet, the lid over a
//! bowl). But all of it goes only where it reaches a rim: elsewhere it spans a crevice that the grid does not resolve. What is left is jagged by
//! cells: a vote among neighbours takes specks away, then the border is smoothed along itself and drawn onto the rims.

use super::quads::relax;
use super::skin::{NEAR, ONTO, Skin, Subject};
use crate::error::{Error, Result};
use crate::geometry::ClosestPoint;
use crate::measure::{Boundary, Rim};
use crate::mesh::{Connectivity, PolygonMesh, TriangleMesh};
use crate::template::without_unused_vertices;
use glam::DVec3;

/// Rounds of votes; specks of up to three triangles go in one, and along a rim there are chains of them.
const VOTES: usize = 4;

/// Steps that smooth the border and draw it onto the rims.
const STEPS: usize = 4;

/// How far a border may lie from its rim, in reaches of the target ([`NEAR`]): the skin turns round a rim within one, and triangles are cut away whole.
const REACH: f64 = 2.0;

/// The part of a skin that lies on the target, with its border on the target's rims.
///
/// # Errors
/// Where nothing of it does.
pub(super) fn opened(skin: Skin, subject: &Subject, rim: &Rim) -> Result<Skin> {
    let connectivity = Connectivity::of(&skin.mesh.clone().into())?;
    let mut kept = on_target(&skin, subject);
    for _ in 0..VOTES {
        kept = without_specks(&kept, &connectivity);
    }
    put_back_bridges(&mut kept, &connectivity, &skin, rim);
    let mut mesh = largest_piece(&skin.mesh, &connectivity, kept)?;
    let connectivity = Connectivity::of(&mesh)?;
    for _ in 0..STEPS {
        relax(&mut mesh, &connectivity);
        subject.draw_on(
            &mut mesh,
            &connectivity,
            ONTO,
            NEAR * skin.cell,
            skin.enclosed,
        );
    }
    Ok(Skin {
        euler: connectivity.euler_characteristic(),
        mesh: mesh.triangulate(),
        ..skin
    })
}

/// `[triangles]`: whether it lies on the target and faces the same way, and not beyond a rim.
fn on_target(skin: &Skin, subject: &Subject) -> Vec<bool> {
    let boundary = Boundary::of(subject.mesh);
    let closest = subject.tree.closest_all(&centers(&skin.mesh));
    let is_on = |(t, c): (usize, &ClosestPoint)| {
        let near = c.distance_squared <= (NEAR * skin.cell).powi(2);
        let there = subject.mesh.area_vector(c.triangle as usize);
        near && !boundary.holds(c) && skin.mesh.area_vector(t).dot(there) > 0.0
    };
    closest.iter().enumerate().map(is_on).collect()
}

fn centers(mesh: &TriangleMesh) -> Vec<DVec3> {
    let center = |t| mesh.corners(t).iter().sum::<DVec3>() / 3.0;
    (0..mesh.triangles.len()).map(center).collect()
}

/// Each face as most of the faces at its vertices are.
fn without_specks(kept: &[bool], connectivity: &Connectivity) -> Vec<bool> {
    // More at a vertex than not, in faces.
    let balance: Vec<i32> = (0..connectivity.vertex_count() as u32)
        .map(|v| {
            let around = connectivity.around(v);
            let vote = |h| {
                if kept[connectivity.face_of(h) as usize] {
                    1
                } else {
                    -1
                }
            };
            around.map(vote).sum()
        })
        .collect();
    let votes = |face: &[u32]| face.iter().map(|&v| balance[v as usize]).sum::<i32>();
    let faces = connectivity.faces().zip(kept);
    faces
        .map(|(face, &kept)| match votes(face) {
            0 => kept,
            votes => votes > 0,
        })
        .collect()
}

/// Keeps all the same what is to go but reaches no rim.
fn put_back_bridges(kept: &mut [bool], connectivity: &Connectivity, skin: &Skin, rim: &Rim) {
    let centers = centers(&skin.mesh);
    let at_rim = |f: usize| {
        let [there] = rim.closest(&[centers[f]])[..] else {
            return false;
        };
        there.point.distance(centers[f]) <= NEAR * skin.cell
    };
    let mut seen = kept.to_vec();
    for start in 0..kept.len() {
        if seen[start] {
            continue;
        }
        let patch = connectivity.connected(start, &mut seen, |f| !kept[f]);
        if !patch.iter().any(|&f| at_rim(f)) {
            for f in patch {
                kept[f] = true;
            }
        }
    }
}

/// The largest piece of what is kept, without the triangles at vertices where it only touches itself.
fn largest_piece(
    mesh: &TriangleMesh,
    connectivity: &Connectivity,
    mut kept: Vec<bool>,
) -> Result<PolygonMesh> {
    while open_pinches(connectivity, &mut kept) {}
    let mut seen: Vec<bool> = kept.iter().map(|k| !k).collect();
    let mut largest = Vec::new();
    for start in 0..kept.len() {
        if !seen[start] {
            let piece = connectivity.connected(start, &mut seen, |f| kept[f]);
            if piece.len() > largest.len() {
                largest = piece;
            }
        }
    }
    if largest.is_empty() {
        return Err(Error::input(
            "no surface could be made that follows the target's rims",
            "leave out --open, or give a template",
        ));
    }
    kept.fill(false);
    for &f in &largest {
        kept[f] = true;
    }
    let faces = (0..kept.len()).filter(|&f| kept[f]);
    let faces = faces.map(|f| mesh.triangles[f]);
    let open = PolygonMesh::from_faces(mesh.positions.clone(), faces);
    Ok(without_unused_vertices(&open.into()).mesh)
}

/// Takes away the faces around vertices with more than one fan of kept faces; whether there were any.
fn open_pinches(connectivity: &Connectivity, kept: &mut [bool]) -> bool {
    let mut changed = false;
    for v in 0..connectivity.vertex_count() as u32 {
        let around: Vec<usize> = connectivity
            .around(v)
            .map(|h| connectivity.face_of(h) as usize)
            .collect();
        let n = around.len();
        let fans = (0..n).filter(|&k| kept[around[k]] && !kept[around[(k + 1) % n]]);
        if fans.count() > 1 {
            around.into_iter().for_each(|f| kept[f] = false);
            changed = true;
        }
    }
    changed
}

/// Moves the vertices of the border onto the rim, if it is not much further than `reach` away.
pub(super) fn onto_rim(mesh: &mut PolygonMesh, connectivity: &Connectivity, rim: &Rim, reach: f64) {
    let border: Vec<u32> = (0..mesh.positions.len() as u32)
        .filter(|&v| connectivity.is_boundary_vertex(v))
        .collect();
    let points: Vec<DVec3> = border.iter().map(|&v| mesh.positions[v as usize]).collect();
    for (v, on) in border.into_iter().zip(rim.closest(&points)) {
        let p = &mut mesh.positions[v as usize];
        if on.point.distance(*p) <= REACH * reach {
            *p = on.point;
        }
    }
}
