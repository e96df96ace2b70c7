//! Shells \[PPL13, section 4.4\]: layers of cells over one or both sides of a surface, all of a wanted thickness.
//!
//! **Theory.** Every vertex of the surface goes along its normal by the thickness, or less where there is no room for that: a ball that touches the
//! surface there and nowhere else must be larger, or layers from opposite sides would meet. Then the layers are optimized ([`crate::untangle`]) with the surface
//! itself held fast: the ideal of a cell is the polygon that it stands on, raised along its normal by the thickness of a layer there (the paper's reference
//! matrix A). Where cells stay inverted, or faces of the boundary cross each other ([`crate::geometry::crossing`]), layers are made thinner, and it is done again.
//!
//! **Departure from the paper**: it starts from a tiny extrusion and lets the optimizer blow it up, which keeps cells valid but not layers apart.

mod base;
mod surface;

use crate::error::{Error, Result};
use crate::mesh::{PolygonMesh, VolumeMesh};
use crate::progress::Progress;
use crate::untangle::{Boundary, inverted, untangle};
use base::{Base, Course};

/// Heights from this share of the wanted thickness on are all of it, but for rounding.
const WHOLE: f64 = 1.0 - 1e-9;

/// How often layers are made thinner where cells stay inverted or cross others.
const RETRIES: usize = 8;

/// Which side of a surface layers are on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Where its normals point.
    Outside,
    /// The other.
    Inside,
    /// Either, as many layers on each.
    Both,
}

/// How thick a shell has become, as shares of the wanted thickness: from the vertices and the middles of the faces of its far sides to the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thickness {
    /// The least.
    pub min: f64,
    /// The mean.
    pub mean: f64,
    /// The largest.
    pub max: f64,
}

/// A shell.
#[derive(Debug, Clone, PartialEq)]
pub struct Shell {
    /// Prisms over triangles and hexahedra over quads. The first vertices are those of the surface.
    pub mesh: VolumeMesh,
    /// Of all sides together.
    pub thickness: Thickness,
    /// The share of vertices over which there was no room for the whole thickness, either side counted.
    pub shortened: f64,
    /// Cells that are inverted at a corner all the same.
    pub inverted: usize,
    /// Cells with faces on the boundary that cross others all the same, where not both are faces of the surface.
    pub crossing: usize,
    /// Triangles of the surface that cross each other: no shell of it can be free of that.
    pub surface_crossing: usize,
    /// Whether it was stopped before its end.
    pub interrupted: bool,
}

/// Layers of cells over a surface, closed or open: `layers` on each side, `distance` thick together. Faces of more than four corners and
/// quads that are not convex are cut into triangles.
///
/// ```
/// use vorofit::mesh::shapes::torus;
/// use vorofit::progress::Silent;
/// use vorofit::template::shell::{Side, shell};
///
/// let made = shell(&torus(1.0, 0.4, 32, 16), 2, 0.1, Side::Both, &Silent)?;
/// assert_eq!((made.mesh.cell_count(), made.inverted), (2048, 0));
/// # Ok::<(), vorofit::Error>(())
/// ```
///
/// # Errors
/// Where the surface is no oriented manifold, a face has no area, there are no layers or too many, or the distance is not positive.
pub fn shell(
    surface: &PolygonMesh,
    layers: u32,
    distance: f64,
    side: Side,
    progress: &dyn Progress,
) -> Result<Shell> {
    if layers == 0 || !(distance > 0.0 && distance.is_finite()) || surface.face_count() == 0 {
        return Err(Error::input(
            "there is nothing to extrude",
            "give a surface, a distance above 0 and at least one layer",
        ));
    }
    let largest = surface.positions.len().max(surface.corners().len()) as u64;
    if largest.saturating_mul(2 * u64::from(layers) + 1) > u64::from(u32::MAX / 8) {
        return Err(Error::input(
            format!("{layers} layers have too many cells"),
            "give fewer layers",
        ));
    }
    let surface = &surface::checked(surface)?;
    let signs: &[f64] = match side {
        Side::Outside => &[1.0],
        Side::Inside => &[-1.0],
        Side::Both => &[1.0, -1.0],
    };
    let base = Base::new(surface)?;
    let mut courses: Vec<Course> = signs
        .iter()
        .map(|&sign| base.course(sign, distance))
        .collect();
    let short = |course: &Course| {
        course
            .heights
            .iter()
            .filter(|h| **h < WHOLE * distance)
            .count()
    };
    let shortened = courses.iter().map(short).sum::<usize>() as f64
        / (courses.len() * surface.positions.len()) as f64;
    let mut pinned = vec![false; surface.positions.len() * (1 + courses.len() * layers as usize)];
    pinned[..surface.positions.len()].fill(true);
    let surface_crossing = base.surface_crossing();
    let mut retries = RETRIES;
    loop {
        let mesh = base.extruded(&courses, layers);
        let ideals = base.ideals(&mesh, &courses, layers);
        let found = untangle(&mesh, &ideals, Boundary::Pinned(&pinned), progress)?;
        let mut bad = inverted(&found.mesh);
        let crossing = base.crossing(&found.mesh);
        // Over a surface that crosses itself thinner layers cross others, too.
        if surface_crossing == 0 {
            bad.iter_mut().zip(&crossing).for_each(|(b, c)| *b |= *c);
        }
        if !bad.contains(&true) || found.interrupted || retries == 0 {
            return Ok(Shell {
                thickness: base.thickness(&found.mesh, layers, &courses, distance)?,
                mesh: found.mesh,
                shortened,
                inverted: found.inverted,
                crossing: crossing.into_iter().filter(|c| *c).count(),
                surface_crossing,
                interrupted: found.interrupted,
            });
        }
        retries -= 1;
        base.thin(&mut courses, &bad, layers);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{CellShape, shapes};
    use crate::progress::Silent;
    use glam::DVec3;

    fn square(n: u32) -> PolygonMesh {
        let mut mesh = PolygonMesh::new(
            (0..(n + 1) * (n + 1))
                .map(|k| DVec3::new(f64::from(k % (n + 1)), f64::from(k / (n + 1)), 0.0))
                .collect(),
        );
        for k in 0..n * n {
            let a = k / n * (n + 1) + k % n;
            mesh.push_face(&[a, a + 1, a + n + 2, a + n + 1]);
        }
        mesh
    }

    fn made(surface: &PolygonMesh, layers: u32, distance: f64, side: Side) -> Shell {
        let made = shell(surface, layers, distance, side, &Silent).unwrap();
        assert_eq!((made.inverted, made.crossing), (0, 0));
        made
    }

    #[test]
    fn an_open_sheet_becomes_a_plate() {
        let found = made(&square(4), 3, 0.6, Side::Both);
        assert_eq!(found.mesh.cell_count(), 2 * 3 * 16);
        assert!(
            found
                .mesh
                .cells()
                .all(|(shape, _)| shape == CellShape::Hexahedron)
        );
        let Thickness { min, mean, max } = found.thickness;
        assert!(
            min > 1.0 - 1e-3 && max < 1.0 + 1e-3 && (mean - 1.0).abs() < 1e-3,
            "{min} {max}"
        );
        assert_eq!(found.shortened, 0.0);
        let layers = found
            .mesh
            .positions
            .iter()
            .map(|p| (p.z / 0.2).round() as i64);
        assert_eq!((layers.clone().min(), layers.max()), (Some(-3), Some(3)));
    }

    #[test]
    fn a_sphere_has_a_shell_on_either_side() {
        for side in [Side::Outside, Side::Inside, Side::Both] {
            let sphere: PolygonMesh = shapes::sphere(1.0, 2).into();
            let found = made(&sphere, 2, 0.1, side);
            let Thickness { min, mean, max } = found.thickness;
            assert!(
                min > 0.9 && max < 1.1 && (mean - 1.0).abs() < 0.06,
                "{side:?}: {min} {mean} {max}"
            );
            assert_eq!(
                &found.mesh.positions[..sphere.positions.len()],
                &sphere.positions[..]
            );
        }
    }

    #[test]
    fn sharp_edges_are_followed() {
        let cube = shapes::box_grid(DVec3::ZERO, DVec3::ONE, [4; 3]);
        let found = made(&cube, 2, 0.1, Side::Both);
        assert!(
            found.thickness.min > 0.6 && found.thickness.mean > 0.85,
            "{:?}",
            found.thickness
        );
    }

    #[test]
    fn layers_from_opposite_sides_do_not_meet() {
        // A gap of 0.3 between two plates, and layers of 1.
        let below = square(6);
        let mut mesh = below.clone();
        mesh.positions
            .extend(below.positions.iter().map(|p| *p + 0.3 * DVec3::Z));
        let first = below.positions.len() as u32;
        for face in below.faces() {
            let turned: Vec<u32> = face.iter().rev().map(|v| v + first).collect();
            mesh.push_face(&turned);
        }
        let found = made(&mesh, 1, 1.0, Side::Outside);
        assert!(found.shortened > 0.9);
        let lower = |v: usize| v % (2 * first as usize) < first as usize;
        for (v, p) in found.mesh.positions.iter().enumerate() {
            assert!(if lower(v) { p.z < 0.15 } else { p.z > 0.15 }, "{p}");
        }
    }

    #[test]
    fn layers_from_two_rims_do_not_cross() {
        // A roof, open along its ridge: both sides lean towards the gap.
        let mut mesh = square(6);
        mesh.positions.iter_mut().for_each(|p| p.z = 0.4 * p.x);
        let mirrored = mesh.positions.clone();
        let first = mesh.positions.len() as u32;
        let over = |p: DVec3| DVec3::new(12.3 - p.x, p.y, p.z);
        mesh.positions.extend(mirrored.into_iter().map(over));
        for face in square(6).faces() {
            let turned: Vec<u32> = face.iter().rev().map(|v| v + first).collect();
            mesh.push_face(&turned);
        }
        let found = made(&mesh, 1, 1.0, Side::Inside);
        assert!(found.thickness.min > 0.1 && found.surface_crossing == 0);
        let of_left = |v: usize| v % (2 * first as usize) < first as usize;
        for (v, p) in found.mesh.positions.iter().enumerate() {
            assert_eq!(of_left(v), p.x < 6.15, "{p}");
        }
    }

    #[test]
    fn a_surface_that_crosses_itself_is_reported() {
        let mut mesh = square(3);
        let first = mesh.positions.len() as u32;
        let upright = |p: &DVec3| DVec3::new(p.x + 0.4, 1.3, p.y - 1.6);
        let standing: Vec<DVec3> = mesh.positions.iter().map(upright).collect();
        mesh.positions.extend(standing);
        for face in square(3).faces() {
            let moved: Vec<u32> = face.iter().map(|v| v + first).collect();
            mesh.push_face(&moved);
        }
        let found = shell(&mesh, 1, 0.1, Side::Outside, &Silent).unwrap();
        assert!(found.surface_crossing > 0 && found.crossing > 0);
    }

    #[test]
    fn larger_and_hollow_faces_are_cut() {
        let corners = [
            (0.0, 0.0),
            (2.0, 0.0),
            (2.0, 1.0),
            (1.0, 2.0),
            (0.0, 1.0),
            (0.7, 0.5),
        ];
        let at = |&(x, y): &(f64, f64)| DVec3::new(x, y, 0.0);
        let positions: Vec<DVec3> = corners.iter().map(at).collect();
        let pentagon = PolygonMesh::from_faces(positions.clone(), [[0, 1, 2, 3, 4]]);
        assert_eq!(made(&pentagon, 1, 0.1, Side::Outside).mesh.cell_count(), 3);
        let hollow = PolygonMesh::from_faces(positions, [[0, 5, 4, 1]]);
        assert_eq!(made(&hollow, 1, 0.1, Side::Outside).mesh.cell_count(), 2);
    }

    #[test]
    fn what_cannot_be_extruded_is_refused() {
        let sheet = square(1);
        for (layers, distance) in [
            (0, 1.0),
            (1, 0.0),
            (1, -1.0),
            (1, f64::NAN),
            (u32::MAX, 1.0),
        ] {
            assert!(shell(&sheet, layers, distance, Side::Outside, &Silent).is_err());
        }
        assert!(shell(&PolygonMesh::default(), 1, 1.0, Side::Outside, &Silent).is_err());
        let mut flat = sheet.clone();
        flat.positions.fill(DVec3::X);
        assert!(shell(&flat, 1, 1.0, Side::Outside, &Silent).is_err());
        let twice = PolygonMesh::from_faces(sheet.positions.clone(), [[0, 1, 3, 2], [0, 1, 3, 2]]);
        assert!(shell(&twice, 1, 1.0, Side::Outside, &Silent).is_err());
    }
}
