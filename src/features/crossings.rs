//! Where ridges of the two principal curvatures cross in a face, and where sharp edges meet.

use super::{Crossing, Kind, Line, LinePoint};
use crate::mesh::TriangleMesh;
use crate::mesh::sample::SurfacePoint;
use glam::DVec3;

/// All crossings of lines that come in descending strength, the strongest first.
pub(super) fn crossings(mesh: &TriangleMesh, lines: &[Line]) -> Vec<Crossing> {
    let mut crossings = ridge_crossings(mesh, lines);
    crossings.extend(corners(mesh, lines));
    crossings.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    crossings
}

/// A part of a line within a face.
struct Piece {
    face: u32,
    line: u32,
    ends: [DVec3; 2],
}

fn ridge_crossings(mesh: &TriangleMesh, lines: &[Line]) -> Vec<Crossing> {
    let mut pieces = Vec::new();
    for (l, line) in lines.iter().enumerate().filter(|(_, line)| !line.is_sharp) {
        pieces.extend(line.points.windows(2).map(|w| Piece {
            face: w[0].place.triangle,
            line: l as u32,
            ends: [w[0].position, w[1].position],
        }));
    }
    pieces.sort_by_key(|piece| piece.face);
    let is_greater =
        |piece: &Piece| matches!(lines[piece.line as usize].kind, Kind::Red | Kind::Green);
    let mut crossings = Vec::new();
    for face in pieces.chunk_by(|a, b| a.face == b.face) {
        for a in face.iter().filter(|piece| is_greater(piece)) {
            for b in face.iter().filter(|piece| !is_greater(piece)) {
                if let Some(position) = meeting(mesh, a, b) {
                    crossings.push(Crossing {
                        place: place_in(mesh, a.face, position),
                        position,
                        lines: [a.line, b.line],
                        strength: lines[a.line.max(b.line) as usize].strength,
                    });
                }
            }
        }
    }
    crossings
}

/// Where two pieces of a face cross.
fn meeting(mesh: &TriangleMesh, a: &Piece, b: &Piece) -> Option<DVec3> {
    let normal = mesh.area_vector(a.face as usize);
    let (along_a, along_b) = (a.ends[1] - a.ends[0], b.ends[1] - b.ends[0]);
    let between = b.ends[0] - a.ends[0];
    let area = along_a.cross(along_b).dot(normal);
    let share_a = between.cross(along_b).dot(normal) / area;
    let share_b = between.cross(along_a).dot(normal) / area;
    let inside = 0.0..1.0;
    (inside.contains(&share_a) && inside.contains(&share_b)).then(|| a.ends[0] + share_a * along_a)
}

/// A point of a face as weights of its corners; the middle of a face without area.
pub(super) fn place_in(mesh: &TriangleMesh, face: u32, p: DVec3) -> SurfacePoint {
    let [a, b, c] = mesh.corners(face as usize);
    let normal = mesh.area_vector(face as usize);
    let squared = normal.length_squared();
    let barycentric = match squared > 0.0 {
        true => {
            let share = |q: DVec3, r: DVec3| (q - p).cross(r - p).dot(normal) / squared;
            let u = share(b, c).clamp(0.0, 1.0);
            let v = share(c, a).clamp(0.0, 1.0 - u);
            [u, v, 1.0 - u - v]
        }
        false => [1.0 / 3.0; 3],
    };
    SurfacePoint {
        triangle: face,
        barycentric,
    }
}

/// Where ends of sharp edges meet.
fn corners(mesh: &TriangleMesh, lines: &[Line]) -> Vec<Crossing> {
    let mut ends: Vec<(u32, u32, LinePoint)> = Vec::new();
    for (l, line) in lines
        .iter()
        .enumerate()
        .filter(|(_, line)| line.is_sharp && !line.is_closed)
    {
        for point in [line.points.first(), line.points.last()]
            .into_iter()
            .flatten()
        {
            let corner = point.place.barycentric.iter().position(|&b| b == 1.0);
            let vertex = mesh.triangles[point.place.triangle as usize][corner.unwrap_or_default()];
            ends.push((vertex, l as u32, *point));
        }
    }
    ends.sort_by_key(|&(vertex, line, _)| (vertex, line));
    ends.chunk_by(|a, b| a.0 == b.0)
        .filter(|ends| ends.len() > 1)
        .map(|ends| Crossing {
            place: ends[0].2.place,
            position: ends[0].2.position,
            lines: [ends[0].1, ends[1].1],
            strength: lines[ends[1].1 as usize].strength,
        })
        .collect()
}
