//! From the coefficients of a volume to the local modes of its cells: signs, swaps and rotations of what neighbours share.
//!
//! Every edge and face has its modes in a frame of its own, which depends on the numbers of its vertices only:
//! an edge runs from the smaller to the larger; a quad starts at its smallest vertex, s toward the smaller neighbour;
//! a triangle's corners ascend. Tetrahedra take their corners in ascending order, so nothing is left to do. On hexahedra and on quads of prisms
//! a reversed axis gives the mode m the sign (−1)^m. Prisms take the corners of their bottom in ascending order; the modes
//! inside their top are rotated by [`triangle_permutation`].

use super::CurvedVolume;
use crate::mesh::CellShape;
use crate::model::element::{
    TETRAHEDRON_EDGES, TETRAHEDRON_FACES, TRIANGLE_EDGES, corners, modes, triangle_mode_count,
    triangle_permutation,
};
use std::collections::{BTreeMap, BTreeSet};

/// A local mode, the coefficient that it takes, and the factor in between.
type Entry = (usize, u32, f64);

/// Multi-indices and rotations for some cells.
pub struct Lists {
    order: usize,
    quad: Vec<[usize; 2]>,
    hexahedron: Vec<[usize; 3]>,
    prism: Vec<[usize; 2]>,
    /// `[k, l]`: mode k inside a triangle after a permutation of its corners, in modes l.
    rotations: BTreeMap<[usize; 3], Vec<f64>>,
}

impl Lists {
    pub fn new(volume: &CurvedVolume, cells: &[u32]) -> Self {
        let orders = cells.iter().map(|&c| volume.kernel_order(c as usize));
        let order = orders.max().unwrap_or(1);
        let prisms = cells
            .iter()
            .map(|&c| c as usize)
            .filter(|&c| volume.shape(c) == CellShape::Prism);
        let tops: BTreeSet<_> = prisms
            .map(|c| ascending(&volume.frame_vertices(c)[3..]))
            .collect();
        let rotation = |top| (top, triangle_permutation(volume.basis, order, top));
        Self {
            order,
            quad: modes::quad(order),
            hexahedron: modes::hexahedron(order),
            prism: modes::prism(order),
            rotations: tops.into_iter().map(rotation).collect(),
        }
    }
}

/// The corners of a triangle by ascending vertex.
fn ascending(ids: &[u32]) -> [usize; 3] {
    let mut order = [0, 1, 2];
    order.sort_by_key(|&k| ids[k]);
    order
}

/// (−1)^m where an axis is reversed.
fn sign(m: usize, reversed: bool) -> f64 {
    if reversed && m % 2 == 1 { -1.0 } else { 1.0 }
}

/// How the frame of a quad lies over two local axes.
pub struct QuadFrame {
    reversed: [bool; 2],
    swapped: bool,
}

impl QuadFrame {
    /// From the vertices at \[end of the first axis\]\[end of the second\].
    pub fn new(ids: [[u32; 2]; 2]) -> Self {
        let corners = [[0, 0], [0, 1], [1, 0], [1, 1]];
        let [a, b] = corners
            .into_iter()
            .min_by_key(|&[a, b]| ids[a][b])
            .unwrap_or([0, 0]);
        Self {
            reversed: [a == 1, b == 1],
            swapped: ids[1 - a][b] > ids[a][1 - b],
        }
    }

    /// The mode along each local axis that is the mode (m_s, m_t) of the quad, and its sign.
    pub fn local(&self, [s, t]: [usize; 2]) -> ([usize; 2], f64) {
        let m = if self.swapped { [t, s] } else { [s, t] };
        (
            m,
            sign(m[0], self.reversed[0]) * sign(m[1], self.reversed[1]),
        )
    }
}

/// Calls `take` with every entry of the gather of cell `c` at the order `p`.
pub fn entries(volume: &CurvedVolume, lists: &Lists, c: usize, p: usize, take: impl FnMut(Entry)) {
    match volume.shape(c) {
        CellShape::Hexahedron => hexahedron(volume, lists, c, p, take),
        CellShape::Prism => prism(volume, lists, c, p, take),
        CellShape::Tetrahedron => tetrahedron(volume, c, p, take),
    }
}

fn hexahedron(
    volume: &CurvedVolume,
    lists: &Lists,
    c: usize,
    p: usize,
    mut take: impl FnMut(Entry),
) {
    let shape = CellShape::Hexahedron;
    let ids = volume.vertices(c);
    let n = p + 1;
    let index = |m: [usize; 3]| m[0] + n * (m[1] + n * m[2]);
    // The ends of the axes at which a corner is.
    let ends = |corner: usize| corners(shape)[corner].to_array().map(|x| x as usize);
    let corner_at = |m: [usize; 3]| ids[[0, 1, 3, 2, 4, 5, 7, 6][m[0] + 2 * m[1] + 4 * m[2]]];
    for (k, &v) in ids.iter().enumerate() {
        take((index(ends(k)), v, 1.0));
    }
    for (&e, &[a, b]) in volume.entities.edges_of(c).iter().zip(shape.edges()) {
        let (from, to) = (ends(a), ends(b));
        let axis = (0..3).find(|&k| from[k] != to[k]).unwrap_or(0);
        for (global, m) in volume.edge_modes(e).zip(2..) {
            let mut local = from;
            local[axis] = m;
            take((index(local), global, sign(m, ids[a] > ids[b])));
        }
    }
    for (&f, face) in volume.entities.faces_of(c).iter().zip(shape.faces()) {
        let fixed = (0..3)
            .find(|&k| face.iter().all(|&v| ends(v)[k] == ends(face[0])[k]))
            .unwrap_or(0);
        let axes = [[1, 2], [0, 2], [0, 1]][fixed];
        let at = |m: [usize; 2]| {
            let mut local = ends(face[0]);
            (local[axes[0]], local[axes[1]]) = (m[0], m[1]);
            local
        };
        let frame = QuadFrame::new([0, 1].map(|a| [0, 1].map(|b| corner_at(at([a, b])))));
        for (global, &mode) in volume.face_modes(f).zip(&lists.quad) {
            let (m, sign) = frame.local(mode);
            take((index(at(m)), global, sign));
        }
    }
    for (global, &m) in volume.cell_modes(c).zip(&lists.hexahedron) {
        take((index(m), global, 1.0));
    }
}

fn prism(volume: &CurvedVolume, lists: &Lists, c: usize, p: usize, mut take: impl FnMut(Entry)) {
    let ids = volume.frame_vertices(c);
    let (bottom, top) = ids.split_at(3);
    let base = triangle_mode_count(p);
    let edge_mode = |e: usize, m: usize| 3 + e * (p - 1) + m - 2;
    let inside = 3 + 3 * (p - 1);
    for (w, end) in [bottom, top].into_iter().enumerate() {
        for (k, &v) in end.iter().enumerate() {
            take((k + base * w, v, 1.0));
        }
        for (e, [a, b]) in TRIANGLE_EDGES.into_iter().enumerate() {
            let edge = volume.edge_between(end[a], end[b]);
            for (global, m) in volume.edge_modes(edge).zip(2..) {
                let sign = sign(m, end[a] > end[b]);
                take((edge_mode(e, m) + base * w, global, sign));
            }
        }
    }
    for k in 0..3 {
        let edge = volume.edge_between(bottom[k], top[k]);
        for (global, m) in volume.edge_modes(edge).zip(2..) {
            take((k + base * m, global, sign(m, bottom[k] > top[k])));
        }
    }
    for (e, [a, b]) in TRIANGLE_EDGES.into_iter().enumerate() {
        let quad = volume.face_over(&[bottom[a], bottom[b], top[b], top[a]]);
        let frame = QuadFrame::new([[bottom[a], top[a]], [bottom[b], top[b]]]);
        for (global, &mode) in volume.face_modes(quad).zip(&lists.quad) {
            let ([x, w], sign) = frame.local(mode);
            take((edge_mode(e, x) + base * w, global, sign));
        }
    }
    for (k, global) in volume.face_modes(volume.face_over(bottom)).enumerate() {
        take((inside + k, global, 1.0));
    }
    let rotation = &lists.rotations[&ascending(top)];
    let stride = modes::triangle_count(lists.order);
    let modes = volume.face_modes(volume.face_over(top));
    for (k, global) in modes.clone().enumerate() {
        for l in 0..modes.len() {
            let weight = rotation[k * stride + l];
            if weight != 0.0 {
                take((inside + l + base, global, weight));
            }
        }
    }
    for (global, &[t, m]) in volume.cell_modes(c).zip(&lists.prism) {
        take((inside + t + base * m, global, 1.0));
    }
}

fn tetrahedron(volume: &CurvedVolume, c: usize, p: usize, mut take: impl FnMut(Entry)) {
    let ids = volume.frame_vertices(c);
    for (k, &v) in ids.iter().enumerate() {
        take((k, v, 1.0));
    }
    for (e, [a, b]) in TETRAHEDRON_EDGES.into_iter().enumerate() {
        let edge = volume.edge_between(ids[a], ids[b]);
        for (k, global) in volume.edge_modes(edge).enumerate() {
            take((4 + e * (p - 1) + k, global, 1.0));
        }
    }
    let faces = 4 + 6 * (p - 1);
    let inside = modes::triangle_count(p);
    for (f, corners) in TETRAHEDRON_FACES.into_iter().enumerate() {
        let face = volume.face_over(&corners.map(|k| ids[k]));
        for (k, global) in volume.face_modes(face).enumerate() {
            take((faces + f * inside + k, global, 1.0));
        }
    }
    for (k, global) in volume.cell_modes(c).enumerate() {
        take((faces + 4 * inside + k, global, 1.0));
    }
}
