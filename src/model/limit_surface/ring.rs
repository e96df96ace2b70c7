//! The control points that act on a face of a refined mesh, in an order that depends only on what kind of place it is.
//!
//! In a refined mesh every edge that is sharp at all stays sharp, and of a face's corners only corner 0 (the one that was a vertex before)
//! can be irregular. Sharp edges end what acts on a face: around a corner only the *sector* between two of them counts.

use super::domain::corner_count;
use crate::model::refinement::{Level, Row, Rule, Split};
use std::collections::VecDeque;

/// What bounds the faces around a corner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Extent {
    /// No sharp edge: all the way round.
    Closed,
    /// All the way round from a single sharp edge back to it.
    Dart,
    /// From one sharp edge to another.
    Open,
}

/// What the rules at a corner and around it depend on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Sector {
    pub extent: Extent,
    /// The number of faces in it.
    pub faces: usize,
    /// Where among them the face is, counter-clockwise from the (first) sharp edge; 0 in a closed one.
    pub place: usize,
    /// Whether the vertex stays where it is.
    pub pinned: bool,
}

/// The vertices around a corner of a face: neighbours counter-clockwise, over quads alternating with the vertices across the quads.
struct Ring {
    center: u32,
    sector: Sector,
    /// From one sharp edge to the other, or from the face's own edge all round.
    vertices: Vec<u32>,
    /// How many of them come before the end of the face's own edge.
    before: usize,
}

/// Vertices of a ring for each face.
fn stride(split: Split) -> usize {
    match split {
        Split::Triangles => 1,
        Split::Quads => 2,
    }
}

impl Ring {
    /// Around the origin of half-edge `start`.
    fn new(level: &Level, start: u32) -> Self {
        let mesh = &level.connectivity;
        let is_sharp = |h: u32| level.sharpness[mesh.edge_of(h) as usize] > 0.0;
        let across = |h: u32| (level.split == Split::Quads).then(|| mesh.target(mesh.next(h)));
        let mut vertices = Vec::with_capacity(16);
        let mut extent = Extent::Closed;
        let mut h = start;
        loop {
            vertices.push(mesh.target(h));
            vertices.extend(across(h));
            let back = mesh.previous(h);
            match mesh.opposite(back) {
                Some(next) if next == start && !is_sharp(start) => break,
                Some(next) if !is_sharp(back) => h = next,
                _ => {
                    vertices.push(mesh.origin(back));
                    extent = Extent::Open;
                    break;
                }
            }
        }
        let last = mesh.edge_of(mesh.previous(h));
        let mut before = 0;
        if extent == Extent::Open {
            h = start;
            let mut earlier = Vec::new();
            while let Some(opposite) = mesh.opposite(h).filter(|_| !is_sharp(h)) {
                h = mesh.next(opposite);
                earlier.extend(across(h));
                earlier.push(mesh.target(h));
            }
            before = earlier.len();
            earlier.reverse();
            vertices.splice(0..0, earlier);
            if mesh.edge_of(h) == last {
                extent = Extent::Dart;
                vertices.pop();
            }
        }
        let center = mesh.origin(start);
        let sector = Sector {
            extent,
            faces: (vertices.len() - usize::from(extent == Extent::Open)) / stride(level.split),
            place: before / stride(level.split),
            pinned: level.rule(center, 0.0) == Rule::Corner,
        };
        Self {
            center,
            sector,
            vertices,
            before,
        }
    }

    /// The vertex at a place counted from the end of the face's own edge, if the sector goes so far.
    fn at(&self, place: usize, regular: usize) -> Option<u32> {
        let mut index = self.before + place;
        // Counted on around, or back.
        if index >= self.vertices.len() && index >= regular {
            index -= regular;
        }
        self.vertices.get(index).copied()
    }
}

/// Places on the regular ring around a corner.
fn ring_size(split: Split) -> usize {
    match split {
        Split::Triangles => 6,
        Split::Quads => 8,
    }
}

impl Sector {
    /// Whether the rules here are those of a spline on a regular grid, mirrored at sharp edges.
    fn is_regular(self, split: Split) -> bool {
        let half = ring_size(split) / stride(split) / 2;
        match (self.extent, self.pinned) {
            (Extent::Closed, false) => self.faces == 2 * half,
            (Extent::Open, false) => self.faces == half,
            (Extent::Open, true) => self.faces == 1,
            _ => false,
        }
    }
}

/// The half-edge of face `f` that leaves its corner `k`.
fn leaving(level: &Level, f: usize, k: usize) -> u32 {
    level.connectivity.half_edges(f).start + k as u32
}

/// The sector at corner 0 of face `f` where it is irregular.
pub fn irregular_sector(level: &Level, f: usize) -> Option<Sector> {
    let sector = Ring::new(level, leaving(level, f, 0)).sector;
    (!sector.is_regular(level.split)).then_some(sector)
}

/// For each place around corner `k ≥ 1` of a face whose vertex no earlier corner of the face has in its ring.
const NEW_PLACES: [(Split, &[&[usize]]); 2] = [
    (Split::Triangles, &[&[3, 4, 5], &[3, 4]]),
    (Split::Quads, &[&[5, 6, 7], &[5, 6, 7], &[5]]),
];

/// The vertices that act on face `f`, irregular at its corner 0: the corner, its ring, and what the rings of the other corners add.
pub fn irregular_points(level: &Level, f: usize) -> Vec<u32> {
    let ring = Ring::new(level, leaving(level, f, 0));
    let mut points = vec![ring.center];
    points.extend(&ring.vertices);
    let [(_, triangles), (_, quads)] = NEW_PLACES;
    let places = match level.split {
        Split::Triangles => triangles,
        Split::Quads => quads,
    };
    for (k, places) in (1..).zip(places) {
        let ring = Ring::new(level, leaving(level, f, k));
        points.extend(
            places
                .iter()
                .filter_map(|&p| ring.at(p, ring_size(level.split))),
        );
    }
    points
}

/// A control point of a regular patch.
#[derive(Debug, Clone)]
pub enum Point {
    /// A vertex of the mesh.
    Vertex(u32),
    /// Beyond a sharp edge: the combination of vertices that makes the spline follow the rules of the edge.
    Ghost(Row),
}

impl Point {
    /// Adds its vertices to a row.
    pub fn push(&self, weight: f64, row: &mut Row) {
        match self {
            Self::Vertex(v) => row.push((*v, weight)),
            Self::Ghost(terms) => row.extend(terms.iter().map(|&(v, w)| (v, weight * w))),
        }
    }

    fn combine<const N: usize>(terms: [(f64, &Self); N]) -> Self {
        let mut row = Row::new();
        for (weight, point) in terms {
            point.push(weight, &mut row);
        }
        Self::Ghost(row)
    }
}

/// The control points of face `f`, all corners of which are regular: 12 or 16 in the order of the basis functions.
pub fn regular_points(level: &Level, f: usize) -> Vec<Point> {
    let split = level.split;
    let size = match split {
        Split::Triangles => 12,
        Split::Quads => 16,
    };
    let mut points = vec![Point::Vertex(0); size];
    for k in 0..corner_count(split) {
        let ring = Ring::new(level, leaving(level, f, k));
        for (place, point) in complete(ring, split).into_iter().enumerate() {
            points[slot(split, k, place)] = point;
        }
    }
    points
}

/// The number, among the control points of a face, of the one at a place on the ring around corner `k`.
fn slot(split: Split, k: usize, place: usize) -> usize {
    match split {
        Split::Triangles => {
            let across = |k: usize| 3 + k % 3;
            [
                (k + 1) % 3,
                (k + 2) % 3,
                across(k + 1),
                6 + 2 * k,
                7 + 2 * k,
                across(k + 2),
            ][place]
        }
        Split::Quads => {
            // Counter-clockwise around a point, from the direction of u.
            let around = [1, 5, 4, 3, -1, -5, -4, -3];
            let corner = [5, 6, 10, 9][k];
            (corner + around[(place + 2 * k) % 8]) as usize
        }
    }
}

/// The whole regular ring from the end of the face's own edge on, with what is beyond sharp edges mirrored.
///
/// Around a triangle's sharp edge the spline follows the rules of a crease if the points p, q across it mirror each other at its middle, p + q = v + e;
/// over quads if the rows on both sides do at the points of the crease.
fn complete(ring: Ring, split: Split) -> Vec<Point> {
    let size = ring_size(split);
    let center = Point::Vertex(ring.center);
    let mut first = ring.before;
    let mut points: VecDeque<Point> = ring.vertices.into_iter().map(Point::Vertex).collect();
    let beyond = |last: &Point, before: &Point, opposite: Option<&Point>, grown: usize| match split
    {
        Split::Triangles => Point::combine([(1.0, &center), (1.0, last), (-1.0, before)]),
        Split::Quads => match opposite.filter(|_| grown % 2 == 1) {
            Some(opposite) => Point::combine([(2.0, &center), (-1.0, opposite)]),
            None => Point::combine([(2.0, last), (-1.0, before)]),
        },
    };
    for grown in 0.. {
        let count = points.len();
        if count >= size {
            break;
        }
        let opposite = count.checked_sub(4).map(|i| &points[i]);
        let back = beyond(&points[count - 1], &points[count - 2], opposite, grown);
        points.push_back(back);
        if count + 1 < size {
            let front = beyond(&points[0], &points[1], points.get(3), grown);
            points.push_front(front);
            first += 1;
        }
    }
    points.rotate_left(first % size);
    points.into()
}
