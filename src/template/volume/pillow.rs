//! Pillowing: a layer of cells under the boundary.
//!
//! Where a hexahedron has two faces on the boundary, a smooth target makes them coplanar, and det J vanishes along the edge between them. After pillowing
//! every cell has at most one face there; the edges and corners are inside.
//!
//! The old boundary moves inwards under the planes of its faces. Around some vertices of carved grids faces face opposite ways, and no layer fits under them: then the boundary is
//! rounded, and all cells are made good under it ([`untangle`]).

use super::offset::offsets;
use super::{boundary, checked, inverted};
use crate::error::{Error, Result};
use crate::mesh::{CellShape, PolygonMesh, TriangleMesh, VolumeMesh, check_volume};
use crate::progress::Silent;
use crate::untangle::{Boundary, Ideals, untangle};
use glam::DVec3;

/// How often the layer is halved where cells are inverted.
const HALVINGS: usize = 4;

/// Steps that round the boundary, each halfway to the mean of the neighbours.
const ROUNDING: usize = 3;

/// The mesh with a layer of new cells under its boundary: hexahedra at its quads, prisms at its triangles.
///
/// The layer is `depth` (0 to 1) thick in mean edges of the boundary at each vertex, or half of it, a quarter … around cells that would be inverted. The boundary
/// stays where it is; where it cannot, it is rounded everywhere, and the layer is as thick as suits the cells.
///
/// # Errors
/// Where cells are inverted even so, and as [`checked`].
pub fn pillow(mesh: &VolumeMesh, depth: f64) -> Result<VolumeMesh> {
    check_volume::sound(mesh)?;
    if !(depth > 0.0 && depth < 1.0) {
        return Err(Error::input(
            format!("a layer cannot be {depth} edges thick"),
            "give a depth between 0 and 1",
        ));
    }
    let mut depths = vec![depth; mesh.positions.len()];
    for _ in 0..=HALVINGS {
        let pillowed = pillowed(mesh, &depths);
        let inverted = inverted(&pillowed)?;
        if inverted.is_empty() {
            return checked(pillowed);
        }
        let mut is_near = vec![false; pillowed.positions.len()];
        for v in inverted.into_iter().flat_map(|c| pillowed.cell(c)) {
            is_near[*v as usize] = true;
        }
        for (depth, _) in depths.iter_mut().zip(is_near).filter(|(_, near)| *near) {
            *depth *= 0.5;
        }
    }
    depths.fill(depth);
    let tangled = pillowed(mesh, &depths);
    let surface = rounded(boundary(mesh));
    let ideals = Ideals::local(&tangled);
    let untangled = untangle(&tangled, &ideals, Boundary::Drawn(&surface), &Silent)?;
    checked(untangled.mesh)
}

fn rounded(mut surface: PolygonMesh) -> TriangleMesh {
    for _ in 0..ROUNDING {
        let mut sums = vec![(DVec3::ZERO, 0.0); surface.positions.len()];
        for face in surface.faces() {
            for (k, &v) in face.iter().enumerate() {
                let next = face[(k + 1) % face.len()];
                // Every edge is passed twice, once in each direction.
                let (sum, count) = &mut sums[v as usize];
                *sum += surface.positions[next as usize];
                *count += 1.0;
            }
        }
        for (p, (sum, count)) in surface.positions.iter_mut().zip(sums) {
            if count > 0.0 {
                *p = p.midpoint(sum / count);
            }
        }
    }
    surface.triangulate()
}

/// [`pillow`] with a depth at each vertex, `[vertices]`, whatever becomes of the cells. Vertices of the mesh keep their numbers, those of the boundary move
/// inwards; the new boundary has the numbers after them.
pub(super) fn pillowed(mesh: &VolumeMesh, depths: &[f64]) -> VolumeMesh {
    const NONE: u32 = u32::MAX;
    let faces = boundary(mesh);
    let mut outer = vec![NONE; mesh.positions.len()];
    let mut pillowed = mesh.clone();
    for &v in faces.corners() {
        if outer[v as usize] == NONE {
            outer[v as usize] = pillowed.positions.len() as u32;
            pillowed.positions.push(mesh.positions[v as usize]);
        }
    }
    for (v, offset) in offsets(&faces).into_iter().enumerate() {
        pillowed.positions[v] -= depths[v] * offset.edge * offset.outwards;
    }
    for face in faces.faces() {
        let above = face.iter().map(|&v| outer[v as usize]);
        let cell: Vec<u32> = face.iter().copied().chain(above).collect();
        let shape = match face.len() {
            3 => CellShape::Prism,
            _ => CellShape::Hexahedron,
        };
        pillowed.push_cell(shape, &cell);
    }
    pillowed
}

#[cfg(test)]
mod tests {
    use super::super::{carve, grid};
    use super::*;
    use crate::mesh::shapes;

    /// The most faces that a cell has on the boundary.
    fn most_outer_faces(mesh: &VolumeMesh) -> usize {
        let mut counts = vec![0; mesh.cell_count()];
        for (c, _) in check_volume::boundary_faces(mesh) {
            counts[c] += 1;
        }
        counts.into_iter().max().unwrap_or_default()
    }

    #[test]
    fn depths_that_are_no_share_are_refused() {
        let cube = grid(DVec3::ZERO, DVec3::ONE, [1; 3]);
        for depth in [0.0, 1.0, -0.1, f64::NAN] {
            assert!(pillow(&cube, depth).is_err());
        }
        assert!(pillow(&VolumeMesh::default(), 0.3).is_err());
    }

    #[test]
    fn a_cube_gets_a_layer_of_even_thickness() {
        let cube = grid(DVec3::ZERO, DVec3::ONE, [1; 3]);
        let pillowed = pillow(&cube, 0.25).unwrap();
        assert_eq!((pillowed.cell_count(), pillowed.positions.len()), (7, 16));
        assert_eq!(boundary(&pillowed).face_count(), 6);
        assert_eq!(most_outer_faces(&pillowed), 1);
        for (k, p) in pillowed.positions[..8].iter().enumerate() {
            let wanted = cube.positions[k].clamp(DVec3::splat(0.25), DVec3::splat(0.75));
            assert!(p.distance(wanted) < 1e-3, "{p}");
        }
        assert_eq!(pillowed.positions[8..].len(), cube.positions.len());
    }

    #[test]
    fn carved_grids_and_tetrahedra_are_pillowed() {
        let mesh = grid(DVec3::splat(-1.2), DVec3::splat(1.2), [10; 3]);
        let ball = carve(&mesh, &shapes::sphere(1.0, 3), 0.5).unwrap();
        let quads = boundary(&ball).face_count();
        let pillowed = pillow(&ball, 0.35).unwrap();
        assert_eq!(pillowed.cell_count(), ball.cell_count() + quads);
        assert_eq!(most_outer_faces(&pillowed), 1);

        let mut tetrahedron = VolumeMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]);
        tetrahedron.push_cell(CellShape::Tetrahedron, &[0, 1, 2, 3]);
        let pillowed = pillow(&tetrahedron, 0.1).unwrap();
        let prisms = pillowed.cells().filter(|c| c.0 == CellShape::Prism);
        assert_eq!((pillowed.cell_count(), prisms.count()), (5, 4));
        // Deeper than it is thick: the layer gets thinner.
        pillow(&tetrahedron, 0.9).unwrap();
    }

    #[test]
    fn a_boundary_that_leaves_no_room_is_rounded() {
        // Four cubes in a row that turns twice: around the vertex of them all faces face opposite ways.
        let cubes = grid(DVec3::ZERO, DVec3::splat(2.0), [2; 3]);
        let mesh = super::super::part(&cubes, |c| [0, 1, 3, 7].contains(&c));
        checked(mesh.clone()).unwrap();
        assert!(
            !inverted(&pillowed(&mesh, &vec![0.1; mesh.positions.len()]))
                .unwrap()
                .is_empty()
        );
        let quads = boundary(&mesh).face_count();
        let pillowed = pillow(&mesh, 0.35).unwrap();
        assert_eq!(pillowed.cell_count(), mesh.cell_count() + quads);
        assert_eq!(most_outer_faces(&pillowed), 1);
    }
}
