//! The order in which formats list the nodes of a curved cell: corners, edges, faces, inside.

use crate::mesh::{CellShape, NodalVolume};

/// How a format goes through the nodes of one shape.
pub(super) struct Numbering {
    /// Corners that the nodes inside an edge run from and to.
    pub(super) edges: &'static [[usize; 2]],
    /// Corners of a face: the nodes inside start near the first and run toward the second.
    pub(super) faces: &'static [&'static [usize]],
    pub(super) triangles: Inside,
    pub(super) quads: Inside,
    pub(super) cell: Inside,
}

/// How a format goes through the nodes inside a face or a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Inside {
    /// Row after row, as text is written.
    Rows,
    /// As a face or cell of lower order, corners first.
    Nested,
}

type Point = [i32; 3];

impl Numbering {
    /// For each node in the format's order, its place among the nodes of a [`NodalVolume`].
    pub(super) fn places(&self, shape: CellShape, order: usize) -> Vec<usize> {
        let corners = NodalVolume::corner_points(shape, order);
        let corners: Vec<Point> = corners.iter().map(|c| c.map(|x| x as i32)).collect();
        let mut points = Vec::with_capacity(NodalVolume::node_count(shape, order));
        self.cell(shape, &corners, order as i32, &mut points);
        let points: Vec<[usize; 3]> = points.iter().map(|p| p.map(|x| x as usize)).collect();
        NodalVolume::places(shape, order, &points)
    }

    fn cell(&self, shape: CellShape, corners: &[Point], order: i32, points: &mut Vec<Point>) {
        if order == 0 {
            points.push(corners[0]);
        }
        if order <= 0 {
            return;
        }
        points.extend(corners);
        for &[a, b] in self.edges {
            edge(corners[a], corners[b], order, points);
        }
        for face in self.faces {
            let corners: Vec<Point> = face.iter().map(|&c| corners[c]).collect();
            let inside = if corners.len() == 3 {
                self.triangles
            } else {
                self.quads
            };
            face_inside(&corners, order, inside, points);
        }
        match (shape, self.cell) {
            (CellShape::Hexahedron, Inside::Nested) => {
                let inner = inset(corners, self.edges, order);
                self.cell(shape, &inner, order - 2, points);
            }
            (CellShape::Tetrahedron, Inside::Nested) => {
                let inner = inset(corners, self.edges, order);
                self.cell(shape, &inner, order - 4, points);
            }
            _ => points.extend(inner_rows(shape, order)),
        }
    }
}

/// The nodes inside an edge.
fn edge(a: Point, b: Point, order: i32, points: &mut Vec<Point>) {
    points.extend((1..order).map(|t| along(a, b, t, order)));
}

/// The node `t` steps from a toward b.
fn along(a: Point, b: Point, t: i32, order: i32) -> Point {
    std::array::from_fn(|d| a[d] + (b[d] - a[d]) * t / order)
}

/// Each corner moved a step along each of its edges.
fn inset(corners: &[Point], edges: &[[usize; 2]], order: i32) -> Vec<Point> {
    let mut inner = corners.to_vec();
    for &[a, b] in edges {
        for (from, to) in [(a, b), (b, a)] {
            for d in 0..3 {
                inner[from][d] += (corners[to][d] - corners[from][d]) / order;
            }
        }
    }
    inner
}

fn face_inside(corners: &[Point], order: i32, inside: Inside, points: &mut Vec<Point>) {
    match (inside, corners) {
        (Inside::Nested, [_, _, _]) => {
            let inner = inset(corners, &[[0, 1], [1, 2], [2, 0]], order);
            nested_face(&inner, order - 3, points);
        }
        (Inside::Nested, _) => {
            let inner = inset(corners, &[[0, 1], [1, 2], [2, 3], [3, 0]], order);
            nested_face(&inner, order - 2, points);
        }
        (Inside::Rows, &[a, b, c]) => {
            for row in 1..order {
                let start = along(a, c, row, order);
                let step = |t| along(start, [0, 1, 2].map(|d| start[d] + b[d] - a[d]), t, order);
                points.extend((1..order - row).map(step));
            }
        }
        (Inside::Rows, _) => {
            for row in 1..order {
                let start = along(corners[0], corners[3], row, order);
                edge(
                    start,
                    along(corners[1], corners[2], row, order),
                    order,
                    points,
                );
            }
        }
    }
}

/// All nodes of a face, corners first.
fn nested_face(corners: &[Point], order: i32, points: &mut Vec<Point>) {
    if order == 0 {
        points.push(corners[0]);
    }
    if order <= 0 {
        return;
    }
    points.extend(corners);
    for k in 0..corners.len() {
        edge(corners[k], corners[(k + 1) % corners.len()], order, points);
    }
    face_inside(corners, order, Inside::Nested, points);
}

/// The nodes inside a cell in the order of the lattice.
fn inner_rows(shape: CellShape, order: i32) -> impl Iterator<Item = Point> {
    let lattice = NodalVolume::lattice(shape, order as usize).into_iter();
    lattice
        .map(|p| p.map(|x| x as i32))
        .filter(move |&[i, j, k]| {
            let inside = |x: i32| 0 < x && x < order;
            inside(i)
                && inside(j)
                && inside(k)
                && match shape {
                    CellShape::Hexahedron => true,
                    CellShape::Prism => i + j < order,
                    CellShape::Tetrahedron => i + j + k < order,
                }
        })
}
