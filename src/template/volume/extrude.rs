//! Extrusion: layers of cells over a surface mesh.

use super::offset::offsets;
use super::{checked, part};
use crate::error::{Error, Result};
use crate::mesh::{CellShape, Connectivity, PolygonMesh, VolumeMesh};
use glam::DVec3;

/// Which way a surface is extruded, and how far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Course {
    /// Over the planes of its faces, so that layers over flat parts have this thickness; below 0 inwards.
    Normals(f64),
    /// By this vector, all of it.
    Along(DVec3),
}

/// Layers of equal thickness over a surface mesh, which is their one side: hexahedra over its quads, prisms over its triangles.
///
/// # Errors
/// Where a face is neither a quad nor a triangle, the distance or the number of layers is 0, the surface is no manifold, layers are inverted (as those over
/// a surface that is seen from behind, or that bends more than the distance allows), and as [`checked`].
pub fn extrude(surface: &PolygonMesh, course: Course, layers: u32) -> Result<VolumeMesh> {
    if let Some(f) = surface.faces().position(|f| !matches!(f.len(), 3 | 4)) {
        return Err(Error::input(
            format!(
                "face {f} (counted from 0) has {} corners",
                surface.face(f).len()
            ),
            "give triangles and quads",
        ));
    }
    Connectivity::of(surface)?;
    let path = path(surface, course);
    let moves = path.iter().any(|d| *d != DVec3::ZERO);
    if layers == 0 || !moves || path.iter().any(|d| !d.is_finite()) {
        return Err(Error::input(
            "there is nothing to extrude",
            "give a surface, a distance other than 0 and at least one layer",
        ));
    }
    let count = surface.positions.len();
    if (count as u64).saturating_mul(u64::from(layers) + 1) > u64::from(u32::MAX) {
        return Err(Error::input(
            format!("{layers} layers have too many vertices"),
            "give fewer layers",
        ));
    }
    let share = |layer: u32| f64::from(layer) / f64::from(layers);
    let level = |layer: u32| {
        let points = surface.positions.iter().zip(&path);
        points.map(move |(p, d)| *p + share(layer) * *d)
    };
    let mut mesh = VolumeMesh::new((0..=layers).flat_map(level).collect());
    // Inwards the new side is the one below.
    let is_inwards = matches!(course, Course::Normals(distance) if distance < 0.0);
    for layer in 0..layers as usize {
        let (below, above) = match is_inwards {
            false => (layer * count, (layer + 1) * count),
            true => ((layer + 1) * count, layer * count),
        };
        for face in surface.faces() {
            let side = |first: usize| face.iter().map(move |&v| v + first as u32);
            let cell: Vec<u32> = side(below).chain(side(above)).collect();
            let shape = match face.len() {
                3 => CellShape::Prism,
                _ => CellShape::Hexahedron,
            };
            mesh.push_cell(shape, &cell);
        }
    }
    checked(part(&mesh, |_| true))
}

/// How each vertex goes. `[vertices]`.
fn path(surface: &PolygonMesh, course: Course) -> Vec<DVec3> {
    match course {
        Course::Along(vector) => vec![vector; surface.positions.len()],
        Course::Normals(distance) => {
            let offsets = offsets(surface).into_iter();
            offsets.map(|offset| distance * offset.outwards).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::corner_determinants;
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn what_cannot_be_extruded_is_refused() {
        let cube = shapes::box_grid(DVec3::ZERO, DVec3::ONE, [1; 3]);
        let up = |k| Course::Along(f64::from(k) * DVec3::Z);
        assert!(extrude(&cube, Course::Normals(0.0), 1).is_err());
        assert!(extrude(&cube, Course::Normals(f64::NAN), 1).is_err());
        assert!(extrude(&cube, Course::Normals(0.1), 0).is_err());
        assert!(extrude(&cube, Course::Normals(0.1), u32::MAX).is_err());
        assert!(extrude(&PolygonMesh::default(), up(1), 1).is_err());
        let corners = (0..5).map(|k| DVec3::new(f64::from(k), f64::from(k * k), 0.0));
        let pentagon = PolygonMesh::from_faces(corners.collect(), [[0, 1, 2, 3, 4]]);
        let message = extrude(&pentagon, up(1), 1).unwrap_err().to_string();
        assert!(message.contains("5 corners"), "{message}");
        let beyond = PolygonMesh::from_faces(vec![DVec3::ZERO; 3], [[0, 1, 3]]);
        assert!(extrude(&beyond, up(1), 1).is_err());
        // Seen from behind, and more than to the middle.
        let square = [DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y];
        let square = PolygonMesh::from_faces(square.to_vec(), [[0, 1, 2, 3]]);
        let message = extrude(&square, up(-1), 1).unwrap_err().to_string();
        assert!(message.contains("inverted"), "{message}");
        assert!(extrude(&cube, Course::Normals(-0.6), 1).is_err());
    }

    #[test]
    fn layers_of_a_box_are_as_thick_as_asked() {
        let cube = shapes::box_grid(DVec3::ZERO, DVec3::ONE, [2; 3]);
        for (distance, volume) in [(0.5, 7.0), (-0.25, 0.875)] {
            let mesh = extrude(&cube, Course::Normals(distance), 3).unwrap();
            assert_eq!(mesh.cell_count(), 3 * cube.face_count());
            let sum: f64 = corner_determinants(&mesh).iter().sum();
            // The mean of the corners is the volume where opposite faces are similar; between it and the exact one there is a little.
            assert!((sum / 8.0 - volume).abs() < 0.02 * volume, "{}", sum / 8.0);
        }
    }

    #[test]
    fn triangles_make_prisms() {
        let ball = shapes::sphere(1.0, 2);
        let mesh = extrude(&ball.clone().into(), Course::Normals(0.2), 2).unwrap();
        assert_eq!(mesh.cell_count(), 2 * ball.triangles.len());
        assert!(mesh.cells().all(|c| c.0 == CellShape::Prism));
        let outermost = mesh.positions.iter().map(|p| p.length());
        let outermost = outermost.fold(0.0, f64::max);
        assert!((outermost - 1.2).abs() < 5e-3, "{outermost}");
    }
}
