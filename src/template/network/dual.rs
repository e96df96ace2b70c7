//! The dual of the cells of a fire: a triangle wherever a face has three labels; and where that is no surface like the one below.
//!
//! **Theory.** The dual is a manifold of the surface's own topology if the cells are those of a triangulation: every cell is a disc, any two meet along one
//! line or not at all, such a line ends in a face of three labels, any three meet in one face, and a cell has one piece of boundary at most, a boundary three
//! cells at least. Each of these is counted directly ([`faults`]). A site more where one fails brings the cells nearer to single vertices, whose dual is the surface
//! itself: so mending ends ([`mend`]).

use super::fire::Fire;
use crate::mesh::Connectivity;
use std::collections::BTreeSet;

/// What keeps the dual from being a surface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Fault {
    /// The labels of the cells at fault.
    labels: Vec<u32>,
    /// The vertex that becomes a site.
    remedy: u32,
}

/// One triangle of labels for each face with three of them, in the order of the faces.
pub(super) fn triangles(surface: &Connectivity, labels: &[u32]) -> Vec<[u32; 3]> {
    (0..surface.face_count())
        .map(|f| labels_of(surface, labels, f))
        .filter(|&corners| distinct(corners) == 3)
        .collect()
}

/// Lights sites until the dual has no fault.
pub(super) fn mend(surface: &Connectivity, loops: &[Vec<u32>], fire: &mut Fire) {
    fire.reach_all();
    loop {
        let faults = faults(surface, loops, fire);
        let mut mended = BTreeSet::<u32>::new();
        for fault in &faults {
            // What one site mends, another might only mend again.
            if fault.labels.iter().all(|label| !mended.contains(label)) {
                mended.extend(&fault.labels);
                fire.light(fault.remedy);
            }
        }
        if faults.is_empty() {
            return;
        }
    }
}

/// All faults of the dual of cells that cover the surface.
pub(super) fn faults(surface: &Connectivity, loops: &[Vec<u32>], fire: &Fire) -> Vec<Fault> {
    let mut faults = cells_that_are_no_discs(surface, fire);
    faults.extend(torn_boundaries(loops, fire));
    faults.extend(torn_borders(surface, fire));
    faults.extend(repeated_triangles(surface, fire));
    faults
}

fn labels_of(surface: &Connectivity, labels: &[u32], f: usize) -> [u32; 3] {
    let corners = surface.face(f);
    [0, 1, 2].map(|k| labels[corners[k] as usize])
}

fn distinct([a, b, c]: [u32; 3]) -> usize {
    1 + usize::from(b != a) + usize::from(c != a && c != b)
}

/// Cells whose Euler characteristic is not that of a disc. A cell is connected, as fires burn.
fn cells_that_are_no_discs(surface: &Connectivity, fire: &Fire) -> Vec<Fault> {
    let labels = &fire.labels;
    let mut euler = vec![0i64; fire.sites.len()];
    let mut farthest = fire.sites.clone();
    for (v, &label) in labels.iter().enumerate() {
        euler[label as usize] += 1;
        let best = &mut farthest[label as usize];
        if fire.distances[v] > fire.distances[*best as usize] {
            *best = v as u32;
        }
    }
    for e in 0..surface.edge_count() as u32 {
        let [a, b] = surface.ends(e).map(|v| labels[v as usize]);
        euler[a as usize] -= i64::from(a == b);
    }
    for f in 0..surface.face_count() {
        let corners = labels_of(surface, labels, f);
        euler[corners[0] as usize] += i64::from(distinct(corners) == 1);
    }
    let wrong = (0..euler.len()).filter(|&label| euler[label] != 1);
    wrong
        .map(|label| Fault {
            labels: vec![label as u32],
            remedy: farthest[label],
        })
        .collect()
}

/// Boundary loops of fewer than three cells, and cells with more than one piece of boundary.
fn torn_boundaries(loops: &[Vec<u32>], fire: &Fire) -> Vec<Fault> {
    let label = |v: u32| fire.labels[v as usize];
    let mut faults = Vec::new();
    // (label, loop, where its run begins)
    let mut runs = Vec::new();
    for (number, trail) in loops.iter().enumerate() {
        let before = |k: usize| trail[(k + trail.len() - 1) % trail.len()];
        let starts = (0..trail.len()).filter(|&k| label(before(k)) != label(trail[k]));
        let first = runs.len();
        runs.extend(starts.map(|k| (label(trail[k]), number, k)));
        if runs.len() - first < 3 {
            let mut cells: Vec<u32> = trail.iter().map(|&v| label(v)).collect();
            cells.sort_unstable();
            cells.dedup();
            let remedy = fire.farthest_of(trail.iter().copied());
            faults.extend(remedy.map(|remedy| Fault {
                labels: cells,
                remedy,
            }));
        }
    }
    runs.sort_unstable();
    for same in runs.chunk_by(|a, b| a.0 == b.0).filter(|c| c.len() > 1) {
        let vertices = same.iter().flat_map(|&(cell, number, start)| {
            let trail = &loops[number];
            let from_start = trail.iter().cycle().skip(start).take(trail.len());
            from_start.copied().take_while(move |&v| label(v) == cell)
        });
        faults.extend(fire.farthest_of(vertices).map(|remedy| Fault {
            labels: vec![same[0].0],
            remedy,
        }));
    }
    faults
}

/// Pairs of cells that meet along more than one line, or along a line that ends in no face of three labels.
fn torn_borders(surface: &Connectivity, fire: &Fire) -> Vec<Fault> {
    let labels = &fire.labels;
    let mut lines = Lines::new(surface.edge_count());
    for f in 0..surface.face_count() {
        let corners = labels_of(surface, labels, f);
        let mixed = surface
            .half_edges(f)
            .filter(|&h| labels[surface.origin(h) as usize] != labels[surface.target(h) as usize]);
        let edges: Vec<u32> = mixed.map(|h| surface.edge_of(h)).collect();
        match distinct(corners) {
            2 => lines.join(edges[0], edges[1]),
            3 => edges.iter().for_each(|&e| lines.ends[e as usize] = true),
            _ => {}
        }
    }
    let mut borders: Vec<([u32; 2], u32)> = (0..surface.edge_count() as u32)
        .map(|e| (surface.ends(e).map(|v| labels[v as usize]), e))
        .filter(|([a, b], _)| a != b)
        .map(|([a, b], e)| ([a.min(b), a.max(b)], e))
        .collect();
    borders.sort_unstable();
    let mut faults = Vec::new();
    for border in borders.chunk_by(|a, b| a.0 == b.0) {
        let line = lines.root(border[0].1);
        let is_one = border.iter().all(|&(_, e)| lines.root(e) == line);
        if is_one && border.iter().any(|&(_, e)| lines.ends[e as usize]) {
            continue;
        }
        let vertices = border.iter().flat_map(|&(_, e)| around_edge(surface, e));
        faults.extend(fire.farthest_of(vertices).map(|remedy| Fault {
            labels: border[0].0.to_vec(),
            remedy,
        }));
    }
    faults
}

/// The vertices of the faces at an edge.
fn around_edge(surface: &Connectivity, e: u32) -> impl Iterator<Item = u32> + '_ {
    let h = surface.half_edge(e);
    let sides = [Some(h), surface.opposite(h)].into_iter().flatten();
    sides.flat_map(|h| surface.face(surface.face_of(h) as usize).iter().copied())
}

/// Edges joined to lines, as a forest.
struct Lines {
    parents: Vec<u32>,
    /// `[edges]`: whether a line ends there, in a face of three labels.
    ends: Vec<bool>,
}

impl Lines {
    fn new(edges: usize) -> Self {
        Self {
            parents: (0..edges as u32).collect(),
            ends: vec![false; edges],
        }
    }

    fn root(&mut self, mut e: u32) -> u32 {
        while self.parents[e as usize] != e {
            self.parents[e as usize] = self.parents[self.parents[e as usize] as usize];
            e = self.parents[e as usize];
        }
        e
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parents[a.max(b) as usize] = a.min(b);
    }
}

/// Triples of cells that meet in more than one face.
fn repeated_triangles(surface: &Connectivity, fire: &Fire) -> Vec<Fault> {
    let mut corners: Vec<([u32; 3], u32)> = (0..surface.face_count())
        .map(|f| (labels_of(surface, &fire.labels, f), f as u32))
        .filter(|&(corners, _)| distinct(corners) == 3)
        .map(|(mut corners, f)| {
            corners.sort_unstable();
            (corners, f)
        })
        .collect();
    corners.sort_unstable();
    let repeated = corners.chunk_by(|a, b| a.0 == b.0).filter(|c| c.len() > 1);
    repeated
        .filter_map(|same| {
            let faces = same.iter().map(|&(_, f)| surface.face(f as usize));
            let remedy = fire.farthest_of(faces.flatten().copied())?;
            Some(Fault {
                labels: same[0].0.to_vec(),
                remedy,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{PolygonMesh, TriangleMesh, shapes};
    use glam::DVec3;

    /// The dual of a mesh from these sites, mended: who is next to whom, and the number of sites.
    fn mended(mesh: &PolygonMesh, sites: &[u32]) -> (Connectivity, usize) {
        let surface = Connectivity::of(mesh).expect("a manifold");
        let loops = surface.boundary_vertices();
        let at = |v: u32| mesh.positions[v as usize];
        let mut fire = Fire::new(&surface, |a, b| at(a).distance(at(b)));
        sites.iter().for_each(|&v| fire.light(v));
        mend(&surface, &loops, &mut fire);
        assert_eq!(faults(&surface, &loops, &fire), []);
        let places = vec![DVec3::ZERO; fire.sites.len()];
        let dual = PolygonMesh::from_faces(places, triangles(&surface, &fire.labels));
        let dual = Connectivity::of(&dual).expect("a manifold");
        dual.validate().expect("consistent");
        assert_eq!(dual.euler_characteristic(), surface.euler_characteristic());
        assert_eq!(dual.boundary_loops().len(), loops.len());
        let used = (0..dual.vertex_count() as u32).all(|v| dual.around(v).next().is_some());
        assert!(used, "every site has a face");
        (dual, fire.sites.len())
    }

    /// A strip of `n` by `m` cells, closed to a tube along `n` if `is_tube`.
    fn strip(n: u32, m: u32, is_tube: bool) -> PolygonMesh {
        let columns = if is_tube { n } else { n + 1 };
        let positions = (0..=m).flat_map(|j| (0..columns).map(move |i| (i, j)));
        let angle = |i: u32| f64::from(i) / f64::from(n) * std::f64::consts::TAU;
        let positions = positions.map(|(i, j)| match is_tube {
            true => DVec3::new(angle(i).cos(), angle(i).sin(), 0.3 * f64::from(j)),
            false => DVec3::new(f64::from(i), f64::from(j), 0.0),
        });
        let cells = (0..m).flat_map(|j| (0..n).map(move |i| (i, j)));
        let at = |i: u32, j: u32| j * columns + i % columns;
        let triangles = cells.flat_map(|(i, j)| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[a, b, c], [a, c, d]]
        });
        TriangleMesh {
            positions: positions.collect(),
            triangles: triangles.collect(),
        }
        .into()
    }

    #[test]
    fn the_least_surfaces_are_their_own_duals() {
        let triangle =
            PolygonMesh::from_faces(vec![DVec3::ZERO, DVec3::X, DVec3::Y], [[0u32, 1, 2]]);
        assert_eq!(mended(&triangle, &[]).1, 3);
        let points = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let tetrahedron = [[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        assert_eq!(
            mended(&PolygonMesh::from_faces(points, tetrahedron), &[2]).1,
            4
        );
    }

    #[test]
    fn a_ball_from_one_site_gets_at_least_four() {
        let ball = shapes::sphere(1.0, 3).into();
        let (dual, sites) = mended(&ball, &[0]);
        assert!((4..20).contains(&sites), "{sites}");
        assert_eq!(dual.euler_characteristic(), 2);
    }

    #[test]
    fn handles_are_kept_from_few_sites() {
        let ring = PolygonMesh::from(shapes::torus(2.0, 0.5, 60, 20).triangulate());
        for sites in [vec![], vec![3], vec![0, 100, 700]] {
            let (dual, count) = mended(&ring, &sites);
            assert_eq!(dual.euler_characteristic(), 0);
            assert!((7..40).contains(&count), "{count} sites");
        }
    }

    #[test]
    fn boundaries_are_kept_from_few_sites() {
        for (n, m, is_tube) in [
            (40, 3, false),
            (40, 40, false),
            (40, 20, true),
            (40, 2, true),
            (3, 1, true),
        ] {
            let mesh = strip(n, m, is_tube);
            for sites in [vec![], vec![0, 5]] {
                let (dual, _) = mended(&mesh, &sites);
                assert_eq!(dual.boundary_loops().len(), if is_tube { 2 } else { 1 });
            }
        }
        let mut holed = shapes::sphere(1.0, 3);
        holed.triangles.swap_remove(700);
        holed.triangles.swap_remove(100);
        let (dual, _) = mended(&holed.into(), &[9]);
        assert_eq!(dual.boundary_loops().len(), 2);
    }

    #[test]
    fn every_part_gets_sites() {
        let mut two = shapes::sphere(1.0, 2);
        let more = two.clone();
        let first = two.positions.len() as u32;
        two.positions
            .extend(more.positions.iter().map(|p| *p + 3.0 * DVec3::X));
        two.triangles
            .extend(more.triangles.iter().map(|t| t.map(|v| v + first)));
        assert_eq!(mended(&two.into(), &[5]).0.euler_characteristic(), 4);
    }

    #[test]
    fn enough_sites_are_left_as_they_are() {
        let ball = PolygonMesh::from(shapes::sphere(1.0, 4));
        let sites: Vec<u32> = (0..42).collect();
        let (dual, count) = mended(&ball, &sites);
        assert_eq!((count, dual.face_count()), (42, 80));
    }
}
