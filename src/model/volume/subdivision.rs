//! Subdivision volumes by multi-linear cell averaging \[BSWX02\]: P → X = M P from the vertices of a coarse control mesh to those of a finer one.
//!
//! **Theory.** A step cuts every cell into hexahedra, one for each of its vertices, with new vertices at the midpoints of edges and the
//! centroids of faces and cells; then each vertex goes to the mean of the centroids of the cells around it. On a regular grid that is the
//! tensor product of uniform cubic B-splines. A vertex on a sub-manifold takes that one's cells instead: the boundary's quads on the boundary
//! (there the rule is that of Catmull and Clark where four quads meet, and depends on the boundary alone), the segments of a crease on a
//! crease, and none at a corner, which stays where it is.
//!
//! **Practice.** Prisms and tetrahedra are cut by the same rule, three edges meet in each of their vertices: after the first step all cells are
//! hexahedra. A crease that ends inside a smooth part of the boundary (a dart) ends there like the boundary around it.
//!
//! **Departure from the paper**: its other, smoother variant with weights by valence is not made.
//!
//! \[BSWX02\] C. Bajaj, S. Schaefer, J. Warren, G. Xu: *A subdivision scheme for hexahedral meshes*, The Visual Computer 18, 2002.

use super::entities::{Entities, Face};
use crate::error::{Error, Result};
use crate::kernel::sparse::Csr;
use crate::mesh::{CellShape, VolumeMesh};
use crate::model::element::corners;
use glam::DVec3;
use std::collections::BTreeMap;

/// A control mesh of a subdivision volume.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ControlVolume {
    /// Its cells.
    pub mesh: VolumeMesh,
    /// Edges that stay sharp, as pairs of vertices.
    pub creases: Vec<[u32; 2]>,
    /// Vertices that stay where they are.
    pub corners: Vec<u32>,
}

/// One step of subdivision.
#[derive(Debug, Clone, PartialEq)]
pub struct Subdivided {
    /// The finer control mesh, all hexahedra.
    pub control: ControlVolume,
    /// M, `[fine vertices, coarse vertices]`: rows sum to 1.
    pub matrix: Csr,
}

impl From<VolumeMesh> for ControlVolume {
    /// Without creases and corners.
    fn from(mesh: VolumeMesh) -> Self {
        Self {
            mesh,
            ..Self::default()
        }
    }
}

impl ControlVolume {
    /// With creases where the boundary turns by more than `angle`, in radians, and corners where three creases or more meet or a crease turns
    /// by more than that.
    ///
    /// # Errors
    /// Where the mesh is none: see [`super::CurvedVolume::new`].
    pub fn with_sharp_edges(mesh: VolumeMesh, angle: f64) -> Result<Self> {
        let entities = Entities::of(&mesh)?;
        let at = |v: u32| mesh.positions[v as usize];
        let turns = |a: DVec3, b: DVec3| a.angle_between(b) > angle;
        let mut normals: BTreeMap<[u32; 2], Vec<DVec3>> = BTreeMap::new();
        for quad in boundary_cycles(&mesh, &entities) {
            let normal = area_vector(&quad.iter().map(|&v| at(v)).collect::<Vec<_>>());
            for (&a, &b) in quad.iter().zip(quad.iter().cycle().skip(1)) {
                normals
                    .entry([a.min(b), a.max(b)])
                    .or_default()
                    .push(normal);
            }
        }
        let is_sharp = |around: &Vec<DVec3>| match around[..] {
            [a, b] => turns(a, b),
            _ => true,
        };
        let sharp = normals.into_iter().filter(|(_, around)| is_sharp(around));
        let creases: Vec<[u32; 2]> = sharp.map(|(edge, _)| edge).collect();
        let corners = ends_of(&creases)
            .into_iter()
            .filter(|(v, ends)| match ends[..] {
                [_] => false,
                [a, b] => turns(at(*v) - at(a), at(b) - at(*v)),
                _ => true,
            })
            .map(|(v, _)| v)
            .collect();
        Ok(Self {
            mesh,
            creases,
            corners,
        })
    }

    /// A step of subdivision.
    ///
    /// # Errors
    /// Where the mesh is none (see [`super::CurvedVolume::new`]), a crease is no edge of its boundary, or there would be more vertices than
    /// 32-bit indices serve.
    pub fn subdivided(&self) -> Result<Subdivided> {
        let entities = Entities::of(&self.mesh)?;
        let cut = Cut::new(&self.mesh, entities)?;
        let creases = self.cut_creases(&cut)?;
        let cells = cut.hexahedra();
        let averages = self.averages(&cut, &cells, &creases);
        let matrix = averages.multiply(&cut.midpoints());
        let mut mesh = VolumeMesh::new(matrix.apply(&self.mesh.positions));
        for cell in &cells {
            mesh.push_cell(CellShape::Hexahedron, cell);
        }
        Ok(Subdivided {
            control: Self {
                mesh,
                creases,
                corners: self.corners.clone(),
            },
            matrix,
        })
    }

    /// Both halves of every crease.
    fn cut_creases(&self, cut: &Cut) -> Result<Vec<[u32; 2]>> {
        let mut halves = Vec::with_capacity(2 * self.creases.len());
        for &[a, b] in &self.creases {
            let e = cut.entities.edge_between(a, b);
            if cut.entities.edges.get(e) != Some(&[a.min(b), a.max(b)]) {
                return Err(Error::input(
                    format!(
                        "the crease between the vertices {a} and {b} (counted from 0) is no edge"
                    ),
                    "tag edges of the control mesh",
                ));
            }
            halves.extend([a, b].map(|end| [end, cut.of_edge(e)]));
        }
        Ok(halves)
    }

    /// From the vertices of the cut mesh to the means of the centroids around them.
    fn averages(&self, cut: &Cut, cells: &[[u32; 8]], creases: &[[u32; 2]]) -> Csr {
        let mut rows: Vec<Vec<(u32, f64)>> = vec![Vec::new(); cut.vertex_count()];
        average(&mut rows, cells.iter().map(|cell| &cell[..]), |_| true);
        let quads = cut.boundary_quads();
        average(&mut rows, quads.iter().map(|quad| &quad[..]), |_| true);
        let ends = ends_of(creases);
        let is_smooth = |v: u32| ends.get(&v).is_some_and(|ends| ends.len() == 2);
        average(&mut rows, creases.iter().map(|edge| &edge[..]), is_smooth);
        for &v in &self.corners {
            rows[v as usize] = vec![(v, 1.0)];
        }
        Csr::from_rows(&rows, cut.vertex_count())
    }
}

/// Replaces the rows of the vertices of some cells that are `of` them by the means of the cells' centroids.
fn average<'a>(
    rows: &mut [Vec<(u32, f64)>],
    cells: impl Iterator<Item = &'a [u32]>,
    of: impl Fn(u32) -> bool,
) {
    let mut sums: BTreeMap<u32, (f64, Vec<(u32, f64)>)> = BTreeMap::new();
    for cell in cells {
        for &v in cell.iter().filter(|&&v| of(v)) {
            let (count, row) = sums.entry(v).or_default();
            *count += 1.0;
            row.extend(cell.iter().map(|&w| (w, 1.0 / cell.len() as f64)));
        }
    }
    for (v, (count, mut row)) in sums {
        row.iter_mut().for_each(|entry| entry.1 /= count);
        rows[v as usize] = row;
    }
}

/// The other ends of the creases at each vertex that has some.
fn ends_of(creases: &[[u32; 2]]) -> BTreeMap<u32, Vec<u32>> {
    let mut ends: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for &[a, b] in creases {
        ends.entry(a).or_default().push(b);
        ends.entry(b).or_default().push(a);
    }
    ends
}

/// The vertices of the boundary faces, counter-clockwise seen from outside.
fn boundary_cycles(mesh: &VolumeMesh, entities: &Entities) -> Vec<Vec<u32>> {
    let mut cycles = Vec::new();
    for (c, (shape, cell)) in mesh.cells().enumerate() {
        for (&f, face) in entities.faces_of(c).iter().zip(shape.faces()) {
            if entities.is_boundary(f) {
                cycles.push(face.iter().map(|&k| cell[k]).collect());
            }
        }
    }
    cycles
}

fn area_vector(polygon: &[DVec3]) -> DVec3 {
    let next = polygon.iter().cycle().skip(1);
    polygon.iter().zip(next).map(|(a, b)| a.cross(*b)).sum()
}

/// A mesh cut into hexahedra. Its vertices are those of the mesh, then those in edges, faces and cells.
struct Cut<'a> {
    mesh: &'a VolumeMesh,
    entities: Entities,
    /// The first vertices in edges, faces and cells, and the number of all.
    firsts: [usize; 4],
}

impl<'a> Cut<'a> {
    fn new(mesh: &'a VolumeMesh, entities: Entities) -> Result<Self> {
        let in_edges = mesh.positions.len();
        let in_faces = in_edges + entities.edges.len();
        let in_cells = in_faces + entities.faces.len();
        let all = in_cells + mesh.cell_count();
        if all > i32::MAX as usize {
            return Err(Error::input(
                format!("a step of subdivision makes {all} vertices"),
                "use fewer levels or a coarser template",
            ));
        }
        Ok(Self {
            mesh,
            entities,
            firsts: [in_edges, in_faces, in_cells, all],
        })
    }

    fn vertex_count(&self) -> usize {
        self.firsts[3]
    }

    fn of_edge(&self, e: usize) -> u32 {
        (self.firsts[0] + e) as u32
    }

    fn of_face(&self, f: usize) -> u32 {
        (self.firsts[1] + f) as u32
    }

    /// From the vertices of the mesh to the middles of everything.
    fn midpoints(&self) -> Csr {
        let mean = |vertices: &[u32]| -> Vec<(u32, f64)> {
            let share = 1.0 / vertices.len() as f64;
            vertices.iter().map(|&v| (v, share)).collect()
        };
        let vertices = self.mesh.positions.len();
        let mut rows: Vec<_> = (0..vertices as u32).map(|v| mean(&[v])).collect();
        rows.extend(self.entities.edges.iter().map(|edge| mean(edge)));
        rows.extend(self.entities.faces.iter().map(|face| mean(face.vertices())));
        rows.extend(self.mesh.cells().map(|(_, cell)| mean(cell)));
        Csr::from_rows(&rows, vertices)
    }

    /// One for each vertex of each cell.
    fn hexahedra(&self) -> Vec<[u32; 8]> {
        let mut hexahedra = Vec::new();
        for (c, (shape, cell)) in self.mesh.cells().enumerate() {
            let inside = (self.firsts[2] + c) as u32;
            for (k, &v) in cell.iter().enumerate() {
                let [x, y, z] = around(shape, k);
                let edge = |a: usize| self.of_edge(self.entities.edge_between(v, cell[a]));
                let face = |a: usize, b: usize| {
                    let has_all = |face: &&[usize]| [k, a, b].iter().all(|v| face.contains(v));
                    let local = shape.faces().iter().position(has_all).unwrap_or(0);
                    self.of_face(self.entities.faces_of(c)[local] as usize)
                };
                hexahedra.push([
                    v,
                    edge(x),
                    face(x, y),
                    edge(y),
                    edge(z),
                    face(x, z),
                    inside,
                    face(y, z),
                ]);
            }
        }
        hexahedra
    }

    /// One for each vertex of each boundary face.
    fn boundary_quads(&self) -> Vec<[u32; 4]> {
        let mut quads = Vec::new();
        for cycle in boundary_cycles(self.mesh, &self.entities) {
            let n = cycle.len();
            let middle = self.of_face(self.entities.face_number(&Face::new(&cycle)));
            let edge = |k: usize| {
                let (a, b) = (cycle[k % n], cycle[(k + 1) % n]);
                self.of_edge(self.entities.edge_between(a, b))
            };
            quads.extend((0..n).map(|k| [cycle[k], edge(k), middle, edge(k + n - 1)]));
        }
        quads
    }
}

/// The three vertices next to vertex k of a cell, so that the cell is on the positive side of their order.
fn around(shape: CellShape, k: usize) -> [usize; 3] {
    let at = |v: usize| corners(shape)[v] - corners(shape)[k];
    let mut next = [0; 3];
    let other_end = |&[a, b]: &[usize; 2]| match (a == k, b == k) {
        (true, _) => Some(b),
        (_, true) => Some(a),
        _ => None,
    };
    let others = shape.edges().iter().filter_map(other_end);
    next.iter_mut().zip(others).for_each(|(n, v)| *n = v);
    let [x, y, z] = next;
    if at(x).cross(at(y)).dot(at(z)) > 0.0 {
        [x, y, z]
    } else {
        [y, x, z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::element::Basis;
    use crate::model::volume::CurvedVolume;
    use crate::template::volume::grid;

    fn cube(n: u32) -> VolumeMesh {
        grid(DVec3::ZERO, DVec3::splat(f64::from(n)), [n; 3])
    }

    /// A cube, a prism on one of its sides and a tetrahedron on the prism.
    fn mixed() -> VolumeMesh {
        let mut mesh = cube(1);
        mesh.positions.extend([
            DVec3::new(1.8, 0.4, 0.1),
            DVec3::new(1.9, 0.5, 1.1),
            DVec3::new(1.4, 0.3, 2.0),
        ]);
        mesh.push_cell(CellShape::Prism, &[1, 8, 3, 5, 9, 7]);
        mesh.push_cell(CellShape::Tetrahedron, &[5, 9, 7, 10]);
        mesh
    }

    fn entry(matrix: &Csr, row: usize, column: u32) -> f64 {
        let mut found = matrix.row(row).filter(|e| e.0 == column);
        found.next().map_or(0.0, |e| e.1)
    }

    #[test]
    fn inside_a_grid_the_rule_is_that_of_cubic_splines() {
        let Subdivided { matrix, control } = ControlVolume::from(cube(4)).subdivided().unwrap();
        let index = |i: u32, j: u32, k: u32| i + 5 * (j + 5 * k);
        let center = index(2, 2, 2);
        let spline = |d: i32| [0.75, 0.125][d.unsigned_abs() as usize];
        for (i, j, k) in [(0, 0, 0), (1, 0, 0), (-1, 1, 0), (1, -1, 1)] {
            let column = |d: i32| (2 + d) as u32;
            let at = index(column(i), column(j), column(k));
            let expected = spline(i) * spline(j) * spline(k);
            let found = entry(&matrix, center as usize, at);
            assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        }
        assert_eq!(matrix.row(center as usize).len(), 27);
        assert_eq!(control.mesh.cell_count(), 8 * 64);
    }

    #[test]
    fn rows_sum_to_one_and_cells_of_every_shape_become_valid_hexahedra() {
        let mesh = mixed();
        let coarse = CurvedVolume::new(&mesh, Basis::Legendre).unwrap();
        let volume = |v: &CurvedVolume| {
            let surface = v.boundary_surface(8).mesh(&v.coefficients);
            (0..surface.triangles.len())
                .map(|t| surface.corners(t))
                .map(|[a, b, c]| a.dot(b.cross(c)) / 6.0)
                .sum::<f64>()
        };
        let once = ControlVolume::from(mesh).subdivided().unwrap();
        assert_eq!(once.control.mesh.cell_count(), 8 + 6 + 4);
        for row in 0..once.matrix.row_count() {
            let sum: f64 = once.matrix.row(row).map(|e| e.1).sum();
            assert!((sum - 1.0).abs() < 1e-14);
        }
        let fine = CurvedVolume::new(&once.control.mesh, Basis::Legendre).unwrap();
        assert!(volume(&fine) > 0.3 * volume(&coarse) && volume(&fine) < volume(&coarse));
        // The cut alone leaves the volume as it is.
        let mesh = mixed();
        let cut = Cut::new(&mesh, Entities::of(&mesh).unwrap()).unwrap();
        let mut flat = VolumeMesh::new(cut.midpoints().apply(&mesh.positions));
        for cell in cut.hexahedra() {
            flat.push_cell(CellShape::Hexahedron, &cell);
        }
        let flat = CurvedVolume::new(&flat, Basis::Legendre).unwrap();
        for c in 0..flat.cell_count() {
            let det = flat.evaluate(c, DVec3::splat(0.5)).1.determinant();
            assert!(det > 0.0, "cell {c}: {det}");
        }
        // But for the triangles by which its warped sides are measured.
        assert!((volume(&flat) - volume(&coarse)).abs() < 1e-3);
        assert!(once.control.subdivided().is_ok());
    }

    #[test]
    fn a_box_with_sharp_edges_stays_a_box_and_keeps_linear_functions() {
        let mesh = grid(DVec3::ZERO, DVec3::new(3.0, 2.0, 1.0), [3, 2, 2]);
        let control = ControlVolume::with_sharp_edges(mesh, 0.5).unwrap();
        assert_eq!(control.corners.len(), 8);
        assert_eq!(control.creases.len(), 4 * (3 + 2 + 2));
        let smooth = ControlVolume::from(control.mesh.clone());
        let twice = |control: &ControlVolume| {
            let once = control.subdivided().unwrap();
            once.control.subdivided().unwrap().control
        };
        // The lattice of a regular grid is linear in its indices, and stays so: each vertex is where an even cut would have it.
        let sharp = twice(&control);
        for (p, q) in sharp.mesh.positions.iter().zip(even_cut(&control.mesh)) {
            assert!(p.distance(q) < 1e-14, "{p} {q}");
        }
        assert_eq!(sharp.creases.len(), 4 * control.creases.len());
        let round = twice(&smooth).mesh.positions;
        let corner = round[0];
        assert!(corner.min_element() > 0.1, "{corner}");
    }

    /// The positions after two cuts without averaging.
    fn even_cut(mesh: &VolumeMesh) -> Vec<DVec3> {
        let mut mesh = mesh.clone();
        for _ in 0..2 {
            let cut = Cut::new(&mesh, Entities::of(&mesh).unwrap()).unwrap();
            let mut next = VolumeMesh::new(cut.midpoints().apply(&mesh.positions));
            for cell in cut.hexahedra() {
                next.push_cell(CellShape::Hexahedron, &cell);
            }
            mesh = next;
        }
        mesh.positions
    }

    #[test]
    fn creases_depend_on_their_own_vertices_only() {
        let mut control = ControlVolume::from(cube(2));
        // An edge of the cube from end to end: its ends are darts, its middle a crease vertex.
        control.creases = vec![[0, 1], [1, 2]];
        let fine = control.subdivided().unwrap();
        let row: Vec<_> = fine.matrix.row(1).collect();
        assert_eq!(row, [(0, 0.125), (1, 0.75), (2, 0.125)]);
        assert!(fine.matrix.row(0).len() > 3);
        control.creases = vec![[0, 8]];
        assert!(control.subdivided().is_err());
        control.creases = Vec::new();
        control.corners = vec![0];
        let fine = control.subdivided().unwrap();
        assert_eq!(fine.matrix.row(0).collect::<Vec<_>>(), [(0, 1.0)]);
    }
}
