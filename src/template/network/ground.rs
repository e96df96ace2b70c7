//! The surface that networks are laid on: an oriented manifold whose vertices are close together for the cells to come.

use super::dual::{mend, triangles};
use super::fire::Fire;
use crate::error::{Error, Result};
use crate::mesh::{Connectivity, ControlMesh, PolygonMesh, TriangleMesh};
use crate::topology;
use glam::DVec3;
use std::collections::{BinaryHeap, HashMap};

/// Edges of the surface are at most this share of √(area / cells): some 40 vertices to a cell, so that its outline has a shape. Fine scans are left as they are.
const LONGEST: f64 = 0.25;

/// More cells than this do not make the surface finer: it would not fit into memory.
const MOST_CELLS: usize = 100_000;

/// Where every candidate for the last site would ask for more to be mended, so many are tried.
const MOST_SKIPPED: usize = 8;

/// The stage of a run in which a network is made.
pub(super) const NETWORK: &str = "choosing control points";

/// A surface, and the network that cells on it make.
pub(super) struct Ground {
    /// `[vertices]`.
    pub positions: Vec<DVec3>,
    /// Who is next to whom.
    pub surface: Connectivity,
    /// √(area / cells).
    pub spacing: f64,
    loops: Vec<Vec<u32>>,
}

/// A target as a manifold without superfluous vertices: what a [`Ground`] is made of.
///
/// # Errors
/// Where nothing with area is left.
pub(super) fn manifold(target: &TriangleMesh) -> Result<TriangleMesh> {
    let mesh = topology::manifold(&topology::cleaned(target)).mesh;
    match mesh.area() > 0.0 {
        true => Ok(mesh),
        false => Err(Error::input(
            "the target has no area to lay a network on",
            "give a mesh with faces",
        )),
    }
}

impl Ground {
    /// Of a manifold, for so many cells. Long edges are halved; `halve(a, b)` hears of every vertex added between two others.
    ///
    /// # Errors
    /// Where the mesh is no manifold.
    pub fn new(mut mesh: TriangleMesh, cells: usize, halve: impl FnMut(u32, u32)) -> Result<Self> {
        let spacing = (mesh.area() / cells.max(1) as f64).sqrt();
        let finest = (mesh.area() / MOST_CELLS as f64).sqrt();
        halve_long_edges(&mut mesh, LONGEST * spacing.max(finest), halve);
        let surface = Connectivity::of(&PolygonMesh::from(mesh.clone()))?;
        Ok(Self {
            loops: surface.boundary_vertices(),
            positions: mesh.positions,
            surface,
            spacing,
        })
    }

    /// Its triangles.
    pub fn mesh(&self) -> TriangleMesh {
        PolygonMesh::from_faces(self.positions.clone(), self.surface.faces()).triangulate()
    }

    /// Lights sites until the dual of the cells is a surface of this topology.
    pub fn mend(&self, fire: &mut Fire) {
        mend(&self.surface, &self.loops, fire);
    }

    /// A fire with `wanted` more sites, and mended: the first of `candidates` that are `apart` from all sites, then what is farthest. Fewer, or none, where mending
    /// would lead beyond `most`.
    pub fn grow(
        &self,
        before: &Fire,
        candidates: &[u32],
        apart: f64,
        mut wanted: usize,
        most: usize,
    ) -> Fire {
        let is_site = |v: u32| before.distances[v as usize] == 0.0;
        let candidates: Vec<u32> = candidates
            .iter()
            .copied()
            .filter(|&v| !is_site(v))
            .collect();
        let mut skipped = 0;
        while wanted > 0 && skipped < MOST_SKIPPED {
            let mut fire = before.clone();
            let goal = fire.sites.len() + wanted;
            for &v in candidates.iter().skip(skipped) {
                if fire.sites.len() < goal && self.is_free(&fire, v, apart) {
                    fire.light(v);
                }
            }
            fire.spread(goal);
            self.mend(&mut fire);
            let excess = fire.sites.len().saturating_sub(most);
            match wanted {
                _ if excess == 0 => return fire,
                1 => skipped += 1,
                _ => wanted -= excess.min(wanted - 1),
            }
        }
        before.clone()
    }

    fn is_free(&self, fire: &Fire, v: u32, apart: f64) -> bool {
        let at = |v: u32| self.positions[v as usize];
        fire.sites.iter().all(|&s| at(s).distance(at(v)) > apart)
    }

    /// The dual of cells that have been mended, on the surface: a control point for each site, of the cells on the boundary at the vertex of their piece of it that is
    /// nearest to the site.
    ///
    /// # Errors
    /// Where the dual is no manifold of the surface's topology: not after mending.
    pub fn network(&self, fire: &Fire) -> Result<ControlMesh> {
        let mut places = fire.sites.clone();
        let mut nearest = vec![f64::INFINITY; places.len()];
        for &v in self.loops.iter().flatten() {
            let label = fire.labels[v as usize] as usize;
            if fire.distances[v as usize] < nearest[label] {
                nearest[label] = fire.distances[v as usize];
                places[label] = v;
            }
        }
        let positions = places.iter().map(|&v| self.positions[v as usize]);
        let faces = triangles(&self.surface, &fire.labels);
        let mesh = PolygonMesh::from_faces(positions.collect(), faces);
        let connectivity = Connectivity::of(&mesh)?;
        let boundaries = |surface: &Connectivity| surface.boundary_loops().len();
        let is_alike = connectivity.euler_characteristic() == self.surface.euler_characteristic()
            && boundaries(&connectivity) == self.loops.len();
        match is_alike {
            true => Ok(mesh.into()),
            false => Err(Error::input(
                "the network is not of the target's topology",
                "report this with the mesh: it is a fault of the program",
            )),
        }
    }
}

/// Halves the longest edge until none is longer than `longest`, with the faces at it.
pub(in crate::template) fn halve_long_edges(
    mesh: &mut TriangleMesh,
    longest: f64,
    mut halve: impl FnMut(u32, u32),
) {
    let key = |a: u32, b: u32| [a.min(b), a.max(b)];
    let squared = |positions: &[DVec3], [a, b]: [u32; 2]| {
        (positions[a as usize] - positions[b as usize]).length_squared()
    };
    let sides = |[a, b, c]: [u32; 3]| [key(a, b), key(b, c), key(c, a)];
    let is_long = |positions: &[DVec3], edge| squared(positions, edge) > longest * longest;
    let all = || mesh.triangles.iter().flat_map(|&t| sides(t));
    if !all().any(|edge| is_long(&mesh.positions, edge)) {
        return;
    }
    let mut faces: HashMap<[u32; 2], Vec<u32>> = HashMap::new();
    for (t, &triangle) in mesh.triangles.iter().enumerate() {
        for edge in sides(triangle) {
            faces.entry(edge).or_default().push(t as u32);
        }
    }
    // The bits of floats that are not negative sort as they do.
    let entry = |positions: &[DVec3], edge| (squared(positions, edge).to_bits(), edge);
    let long = faces.keys().filter(|&&edge| is_long(&mesh.positions, edge));
    let mut queue: BinaryHeap<_> = long.map(|&edge| entry(&mesh.positions, edge)).collect();
    while let Some((_, edge)) = queue.pop() {
        let Some(beside) = faces.remove(&edge) else {
            continue;
        };
        let [a, b] = edge;
        let middle = mesh.positions.len() as u32;
        let place = 0.5 * (mesh.positions[a as usize] + mesh.positions[b as usize]);
        mesh.positions.push(place);
        halve(a, b);
        let mut made = vec![key(a, middle), key(b, middle)];
        for t in beside {
            let triangle = mesh.triangles[t as usize];
            let added = mesh.triangles.len() as u32;
            let with = |from: u32| triangle.map(|v| if v == from { middle } else { v });
            mesh.triangles[t as usize] = with(b);
            mesh.triangles.push(with(a));
            let opposite = triangle.into_iter().find(|&v| v != a && v != b);
            let Some(c) = opposite else { continue };
            // The first half keeps its place and a, the second has b.
            if let Some(list) = faces.get_mut(&key(b, c)) {
                list.iter_mut()
                    .filter(|f| **f == t)
                    .for_each(|f| *f = added);
            }
            faces.insert(key(middle, c), vec![t, added]);
            faces.entry(key(a, middle)).or_default().push(t);
            faces.entry(key(b, middle)).or_default().push(added);
            made.push(key(middle, c));
        }
        let made = made
            .into_iter()
            .filter(|&edge| is_long(&mesh.positions, edge));
        queue.extend(made.map(|edge| entry(&mesh.positions, edge)));
    }
}
