//! One step of subdivision: the finer mesh, what stays sharp in it, and the matrix from the coarse points to the fine ones.
//!
//! **Theory.** Catmull–Clark cuts every n-gon into n quads, Loop every triangle into four. The masks are Catmull and Clark's
//! (1978) and Loop's (1987), with the sharp and semi-sharp rules of DeRose, Kass and Truong ("Subdivision Surfaces in Character Animation", 1998)
//! as OpenSubdiv and USD run them with uniform creasing:
//! - a vertex with two sharp edges is a *crease* vertex, (1, 6, 1)/8 along them; with three or more, or tagged, a *corner* that stays; otherwise smooth
//!   (with a single sharp edge, a *dart*);
//! - the sharpness of an edge falls by one a level; where it is used up at this level, the sharp mask is blended with the smooth
//!   one by what was left of it;
//! - boundary edges are infinitely sharp, and a boundary vertex of a single face is a corner (`edgeAndCorner`, USD's default).
//!
//! **Practice.** The fine vertices are numbered: coarse vertices (so that a vertex keeps its index at every level), then edges, then (Catmull–Clark)
//! faces. The fine half-edges are paired by index arithmetic alone: no search is made below the control mesh.

use super::Scheme;
use crate::error::{Error, Result};
use crate::kernel::sparse::Csr;
use crate::mesh::{Connectivity, ControlMesh, Crease};

/// No half-edge, no edge.
const NONE: u32 = u32::MAX;

/// The entries of a matrix row, in any order, to be added up by column.
pub(super) type Row = Vec<(u32, f64)>;

/// How faces are cut, and with it which smooth masks hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Split {
    /// n-gons into n quads, Catmull–Clark's masks.
    Quads,
    /// Triangles into four, Loop's masks.
    Triangles,
}

/// Which mask a vertex follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rule {
    Smooth,
    /// A cubic B-spline through the two neighbours named.
    Crease([u32; 2]),
    Corner,
}

/// A mesh at one level of subdivision, with what is sharp in it.
#[derive(Debug, Clone)]
pub(super) struct Level {
    pub connectivity: Connectivity,
    pub split: Split,
    /// Every edge and vertex is sharp: plain polygons.
    hard: bool,
    /// `[edges]`: levels that the edge stays sharp for; infinite on the boundary.
    pub sharpness: Vec<f64>,
    /// `[vertices]`: tagged, or on the boundary of a single face.
    pub corners: Vec<bool>,
}

impl Level {
    /// The control mesh as level 0.
    pub fn of(control: &ControlMesh, scheme: Scheme) -> Result<Self> {
        let connectivity = Connectivity::of(&control.mesh)?;
        check_faces_and_vertices(&connectivity)?;
        let first_polygon = connectivity.faces().position(|f| f.len() != 3);
        let split = match (scheme, first_polygon) {
            (Scheme::Loop, Some(f)) => return Err(not_a_triangle(f, connectivity.face(f).len())),
            (Scheme::CatmullClark, _) | (Scheme::Polygon, Some(_)) => Split::Quads,
            (Scheme::Loop | Scheme::Polygon, None) => Split::Triangles,
        };
        let sharpness = edge_sharpness(&connectivity, &control.creases)?;
        let corners = vertex_corners(&connectivity, &control.corners)?;
        Ok(Self {
            connectivity,
            split,
            hard: scheme == Scheme::Polygon,
            sharpness,
            corners,
        })
    }

    /// The next finer level and the matrix `[fine vertices, vertices]` that makes its points.
    pub fn refine(&self) -> (Self, Csr) {
        let mesh = &self.connectivity;
        let children = match self.split {
            Split::Quads => quads(mesh),
            Split::Triangles => triangles(mesh),
        };
        let (edge_base, face_base) = self.bases();
        let fine_count = match self.split {
            Split::Quads => face_base as usize + mesh.face_count(),
            Split::Triangles => face_base as usize,
        };
        let matrix = Csr::build(fine_count, mesh.vertex_count(), |r, row| match r as u32 {
            v if v < edge_base => self.vertex_row(v, row),
            e if e < face_base => self.edge_row(e - edge_base, row),
            f => push_centroid(mesh.face((f - face_base) as usize), 1.0, row),
        });
        let connectivity = Connectivity::from_opposites(
            fine_count,
            children.offsets,
            children.origins,
            children.opposites,
        );
        let sharpness = (0..connectivity.edge_count() as u32)
            .map(
                |e| match children.parents[connectivity.half_edge(e) as usize] {
                    NONE => 0.0,
                    parent => (self.sharpness[parent as usize] - 1.0).max(0.0),
                },
            )
            .collect();
        let mut corners = self.corners.clone();
        corners.resize(fine_count, false);
        let finer = Self {
            connectivity,
            sharpness,
            corners,
            ..*self
        };
        (finer, matrix)
    }

    /// The face that face `child` of the next finer level is cut from.
    pub fn parent_face(&self, child: usize) -> u32 {
        match self.split {
            Split::Quads => self.connectivity.face_of(child as u32),
            Split::Triangles => child as u32 / 4,
        }
    }

    /// The part of the mesh that decides where vertex `v` goes: the faces around it, with `v` as vertex 0, and the indices here of its vertices.
    pub fn neighbourhood(&self, v: u32) -> (Self, Vec<u32>) {
        let mesh = &self.connectivity;
        let half_edges: Vec<u32> = mesh
            .around(v)
            .flat_map(|h| mesh.half_edges(mesh.face_of(h) as usize))
            .collect();
        let local = |h: Option<u32>| {
            let found = h.and_then(|h| half_edges.iter().position(|&g| g == h));
            found.map_or(NONE, |k| k as u32)
        };
        let mut vertices = vec![v];
        let mut offsets = vec![0];
        let mut origins = Vec::with_capacity(half_edges.len());
        for &h in &half_edges {
            let origin = mesh.origin(h);
            let known = vertices.iter().position(|&u| u == origin);
            origins.push(known.unwrap_or(vertices.len()) as u32);
            if known.is_none() {
                vertices.push(origin);
            }
            if h + 1 == mesh.half_edges(mesh.face_of(h) as usize).end {
                offsets.push(origins.len() as u32);
            }
        }
        let opposites = half_edges
            .iter()
            .map(|&h| local(mesh.opposite(h)))
            .collect();
        let connectivity =
            Connectivity::from_opposites(vertices.len(), offsets, origins, opposites);
        let sharpness = (0..connectivity.edge_count() as u32)
            .map(|e| match connectivity.is_boundary_edge(e) {
                true => f64::INFINITY,
                false => {
                    let h = half_edges[connectivity.half_edge(e) as usize];
                    self.sharpness[mesh.edge_of(h) as usize]
                }
            })
            .collect();
        let corners = vertices.iter().map(|&u| self.corners[u as usize]).collect();
        let part = Self {
            connectivity,
            sharpness,
            corners,
            ..*self
        };
        (part, vertices)
    }

    /// The mask that vertex `v` follows once `elapsed` levels more have passed.
    pub fn rule(&self, v: u32, elapsed: f64) -> Rule {
        if self.hard || self.corners[v as usize] {
            return Rule::Corner;
        }
        let mut sharp = self
            .connectivity
            .spokes(v)
            .filter(|&(e, _)| self.sharpness[e as usize] > elapsed)
            .map(|(_, neighbour)| neighbour);
        match (sharp.next(), sharp.next(), sharp.next()) {
            (Some(a), Some(b), None) => Rule::Crease([a, b]),
            (_, _, Some(_)) => Rule::Corner,
            _ => Rule::Smooth,
        }
    }

    /// The indices of the first edge vertex and of the first face vertex at the next finer level.
    fn bases(&self) -> (u32, u32) {
        let vertices = self.connectivity.vertex_count() as u32;
        (vertices, vertices + self.connectivity.edge_count() as u32)
    }

    fn vertex_row(&self, v: u32, row: &mut Row) {
        let now = self.rule(v, 0.0);
        let next = match now {
            Rule::Smooth => Rule::Smooth,
            Rule::Crease(_) | Rule::Corner => self.rule(v, 1.0),
        };
        if now == next {
            self.push_vertex(v, now, 1.0, row);
        } else {
            let left = self.sharpness_left(v);
            self.push_vertex(v, now, left, row);
            self.push_vertex(v, next, 1.0 - left, row);
        }
    }

    /// The mean sharpness of those edges at `v` whose sharpness is used up at this level.
    fn sharpness_left(&self, v: u32) -> f64 {
        let (count, sum) = self
            .connectivity
            .spokes(v)
            .map(|(e, _)| self.sharpness[e as usize])
            .filter(|&s| s > 0.0 && s <= 1.0)
            .fold((0, 0.0), |(count, sum), s| (count + 1, sum + s));
        sum / f64::from(count.max(1))
    }

    fn push_vertex(&self, v: u32, rule: Rule, weight: f64, row: &mut Row) {
        match rule {
            Rule::Corner => row.push((v, weight)),
            Rule::Crease(neighbours) => {
                row.push((v, 0.75 * weight));
                row.extend(neighbours.map(|n| (n, 0.125 * weight)));
            }
            Rule::Smooth => match self.split {
                Split::Quads => self.push_catmull_clark(v, weight, row),
                Split::Triangles => self.push_loop(v, weight, row),
            },
        }
    }

    /// ((n − 2) v + Σ neighbours / n + Σ centroids / n) / n.
    fn push_catmull_clark(&self, v: u32, weight: f64, row: &mut Row) {
        let mesh = &self.connectivity;
        let n = mesh.around(v).count() as f64;
        row.push((v, weight * (n - 2.0) / n));
        for h in mesh.around(v) {
            row.push((mesh.target(h), weight / (n * n)));
            push_centroid(mesh.face(mesh.face_of(h) as usize), weight / (n * n), row);
        }
    }

    /// (1 − n β) v + β Σ neighbours.
    fn push_loop(&self, v: u32, weight: f64, row: &mut Row) {
        let mesh = &self.connectivity;
        let n = mesh.around(v).count();
        let beta = loop_beta(n);
        row.push((v, weight * (1.0 - n as f64 * beta)));
        row.extend(mesh.around(v).map(|h| (mesh.target(h), weight * beta)));
    }

    fn edge_row(&self, e: u32, row: &mut Row) {
        let mesh = &self.connectivity;
        let h = mesh.half_edge(e);
        let sharp = match (self.hard, mesh.opposite(h)) {
            (true, _) | (_, None) => 1.0,
            _ => self.sharpness[e as usize].min(1.0),
        };
        if sharp > 0.0 {
            row.extend(mesh.ends(e).map(|v| (v, 0.5 * sharp)));
        }
        if sharp == 1.0 {
            return;
        }
        let smooth = 1.0 - sharp;
        let sides = [Some(h), mesh.opposite(h)].into_iter().flatten();
        match self.split {
            Split::Quads => {
                row.extend(mesh.ends(e).map(|v| (v, 0.25 * smooth)));
                for side in sides {
                    let face = mesh.face(mesh.face_of(side) as usize);
                    push_centroid(face, 0.25 * smooth, row);
                }
            }
            Split::Triangles => {
                row.extend(mesh.ends(e).map(|v| (v, 0.375 * smooth)));
                row.extend(sides.map(|side| (mesh.origin(mesh.previous(side)), 0.125 * smooth)));
            }
        }
    }
}

/// Loop's weight of each neighbour of a smooth vertex of valence `n`.
pub(super) fn loop_beta(n: usize) -> f64 {
    let n = n as f64;
    let c = 0.375 + 0.25 * (std::f64::consts::TAU / n).cos();
    (0.625 - c * c) / n
}

fn push_centroid(face: &[u32], weight: f64, row: &mut Row) {
    let share = weight / face.len() as f64;
    row.extend(face.iter().map(|&v| (v, share)));
}

/// The faces of a finer level.
struct Children {
    offsets: Vec<u32>,
    origins: Vec<u32>,
    opposites: Vec<u32>,
    /// `[half-edges]`: the coarse edge that it is half of, or `NONE` inside a coarse face.
    parents: Vec<u32>,
}

impl Children {
    fn new(face_count: usize, corners: usize) -> Self {
        Self {
            offsets: (0..=face_count).map(|f| (f * corners) as u32).collect(),
            origins: Vec::with_capacity(face_count * corners),
            opposites: Vec::with_capacity(face_count * corners),
            parents: Vec::with_capacity(face_count * corners),
        }
    }

    fn push(&mut self, origin: u32, opposite: Option<u32>, parent: u32) {
        self.origins.push(origin);
        self.opposites.push(opposite.unwrap_or(NONE));
        self.parents.push(parent);
    }
}

/// One quad for each half-edge `h`, of the same index: from its origin to its edge's vertex, the face's, and the previous edge's.
fn quads(mesh: &Connectivity) -> Children {
    let mut children = Children::new(mesh.half_edge_count(), 4);
    let edge_base = mesh.vertex_count() as u32;
    let face_base = edge_base + mesh.edge_count() as u32;
    for h in 0..mesh.half_edge_count() as u32 {
        let (next, previous) = (mesh.next(h), mesh.previous(h));
        let (edge, back) = (mesh.edge_of(h), mesh.edge_of(previous));
        let across = mesh.opposite(h).map(|o| 4 * mesh.next(o) + 3);
        let before = mesh.opposite(previous).map(|o| 4 * o);
        children.push(mesh.origin(h), across, edge);
        children.push(edge_base + edge, Some(4 * next + 2), NONE);
        children.push(face_base + mesh.face_of(h), Some(4 * previous + 1), NONE);
        children.push(edge_base + back, before, back);
    }
    children
}

/// Four triangles for each face `f`: 4 f + k at its corner k, and 4 f + 3 in the middle.
fn triangles(mesh: &Connectivity) -> Children {
    let mut children = Children::new(4 * mesh.face_count(), 3);
    let edge_vertex = |h| mesh.vertex_count() as u32 + mesh.edge_of(h);
    // The first half-edge of the child at the origin of h.
    let child = |h| 3 * (h + mesh.face_of(h));
    for f in 0..mesh.face_count() {
        let half_edges = mesh.half_edges(f);
        let middle = 3 * (4 * f as u32 + 3);
        for (k, h) in half_edges.clone().enumerate() {
            let previous = mesh.previous(h);
            let across = mesh.opposite(h).map(|o| child(mesh.next(o)) + 2);
            let before = mesh.opposite(previous).map(child);
            children.push(mesh.origin(h), across, mesh.edge_of(h));
            children.push(edge_vertex(h), Some(middle + (k as u32 + 2) % 3), NONE);
            children.push(edge_vertex(previous), before, mesh.edge_of(previous));
        }
        for h in half_edges {
            children.push(edge_vertex(h), Some(child(mesh.next(h)) + 1), NONE);
        }
    }
    children
}

fn check_faces_and_vertices(mesh: &Connectivity) -> Result<()> {
    if mesh.face_count() == 0 {
        return Err(Error::input(
            "the control mesh has no faces",
            "give a template with faces",
        ));
    }
    match (0..mesh.vertex_count() as u32).find(|&v| mesh.around(v).next().is_none()) {
        Some(v) => Err(Error::input(
            format!("control point {v} belongs to no face"),
            "remove unused vertices",
        )),
        None => Ok(()),
    }
}

fn not_a_triangle(f: usize, corners: usize) -> Error {
    Error::input(
        format!("face {f} has {corners} corners, and Loop subdivision takes triangles only"),
        "triangulate the control mesh or use the scheme catmull-clark",
    )
}

fn edge_sharpness(mesh: &Connectivity, creases: &[Crease]) -> Result<Vec<f64>> {
    let mut sharpness: Vec<f64> = (0..mesh.edge_count() as u32)
        .map(|e| match mesh.is_boundary_edge(e) {
            true => f64::INFINITY,
            false => 0.0,
        })
        .collect();
    for crease in creases {
        let [a, b] = crease.edge;
        let known = (a as usize) < mesh.vertex_count();
        let Some(e) = known.then(|| mesh.edge_between(a, b)).flatten() else {
            return Err(Error::input(
                format!("the crease between vertices {a} and {b} is no edge of the control mesh"),
                "remove the crease or add the edge",
            ));
        };
        if crease.sharpness.is_nan() || crease.sharpness < 0.0 {
            return Err(Error::input(
                format!(
                    "the crease between vertices {a} and {b} has sharpness {}",
                    crease.sharpness
                ),
                "give a sharpness of 0 or more",
            ));
        }
        let levels = match crease.sharpness {
            s if s >= Crease::INFINITE => f64::INFINITY,
            s => s,
        };
        let edge = &mut sharpness[e as usize];
        *edge = edge.max(levels);
    }
    Ok(sharpness)
}

fn vertex_corners(mesh: &Connectivity, tagged: &[u32]) -> Result<Vec<bool>> {
    let mut corners: Vec<bool> = (0..mesh.vertex_count() as u32)
        .map(|v| mesh.is_boundary_vertex(v) && mesh.around(v).nth(1).is_none())
        .collect();
    for &v in tagged {
        match corners.get_mut(v as usize) {
            Some(corner) => *corner = true,
            None => {
                return Err(Error::input(
                    format!("the corner {v} is no vertex of the control mesh"),
                    "remove the corner",
                ));
            }
        }
    }
    Ok(corners)
}
