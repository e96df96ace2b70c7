//! The grass fire: which site each vertex of a surface is nearest to, along edges.
//!
//! Fires lit at the sites burn along the edges at unit speed; a vertex belongs to the site whose fire reaches it first \[MKJK15, algorithm 1\]. A site
//! that comes later is lit alone in what has burnt already, and takes over what it reaches sooner: its cost is that of its own cell.

use crate::mesh::Connectivity;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Not reached by any fire.
pub(super) const NONE: u32 = u32::MAX;

/// The cells of sites on the vertices of a surface.
#[derive(Debug, Clone)]
pub(super) struct Fire {
    /// `[vertices + 1]`: the ways from vertex v are `ways[offsets[v]..offsets[v + 1]]`.
    offsets: Vec<u32>,
    /// Neighbours, and how far it is to them.
    ways: Vec<(u32, f64)>,
    /// `[sites]`: their vertices.
    pub sites: Vec<u32>,
    /// `[vertices]`: the index of the site that each belongs to, or [`NONE`].
    pub labels: Vec<u32>,
    /// `[vertices]`: the distance from that site, or infinity.
    pub distances: Vec<f64>,
}

impl Fire {
    /// A surface before any fire. `length(a, b)`: how far it is between two neighbours, the same both ways.
    pub fn new(surface: &Connectivity, length: impl Fn(u32, u32) -> f64) -> Self {
        let count = surface.vertex_count();
        let mut offsets = vec![0];
        let mut ways = Vec::with_capacity(2 * surface.edge_count());
        for v in 0..count as u32 {
            let spokes = surface.spokes(v);
            // Underflow must not put a vertex at its site's place.
            ways.extend(spokes.map(|(_, u)| (u, length(v, u).max(f64::MIN_POSITIVE))));
            offsets.push(ways.len() as u32);
        }
        Self {
            offsets,
            ways,
            sites: Vec::new(),
            labels: vec![NONE; count],
            distances: vec![f64::INFINITY; count],
        }
    }

    /// Makes a vertex a site. Does nothing where it is one.
    pub fn light(&mut self, vertex: u32) {
        if self.distances[vertex as usize] == 0.0 {
            return;
        }
        let site = self.sites.len() as u32;
        self.sites.push(vertex);
        self.distances[vertex as usize] = 0.0;
        self.labels[vertex as usize] = site;
        let mut front = BinaryHeap::from([Reverse((0, vertex))]);
        while let Some(Reverse((bits, v))) = front.pop() {
            let here = self.distances[v as usize];
            // The bits of floats that are not negative sort as they do.
            if here.to_bits() != bits {
                continue;
            }
            let range = self.offsets[v as usize] as usize..self.offsets[v as usize + 1] as usize;
            for &(u, length) in &self.ways[range] {
                let there = here + length;
                if there < self.distances[u as usize] {
                    self.distances[u as usize] = there;
                    self.labels[u as usize] = site;
                    front.push(Reverse((there.to_bits(), u)));
                }
            }
        }
    }

    /// Lights the vertex farthest from all sites, again and again until there are `count` sites or every vertex is one. What no fire has
    /// reached is farthest.
    pub fn spread(&mut self, count: usize) {
        let entry = |v: usize, distance: f64| (distance.to_bits(), Reverse(v as u32));
        let entries = self.distances.iter().enumerate();
        let mut farthest: BinaryHeap<_> = entries.map(|(v, &d)| entry(v, d)).collect();
        while self.sites.len() < count
            && let Some((bits, Reverse(v))) = farthest.pop()
        {
            let now = self.distances[v as usize];
            if now.to_bits() != bits {
                farthest.push(entry(v as usize, now));
            } else if now > 0.0 {
                self.light(v);
            } else {
                break;
            }
        }
    }

    /// Lights a vertex wherever no fire has reached: one in each connected part without a site.
    pub fn reach_all(&mut self) {
        for v in 0..self.labels.len() {
            if self.labels[v] == NONE {
                self.light(v as u32);
            }
        }
    }

    /// The vertex farthest from its site, the first of equal ones; `None` where all are sites.
    pub fn farthest_of(&self, vertices: impl IntoIterator<Item = u32>) -> Option<u32> {
        let mut best = (0.0, None);
        for v in vertices {
            let distance = self.distances[v as usize];
            if distance > best.0 {
                best = (distance, Some(v));
            }
        }
        best.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{PolygonMesh, shapes};

    fn ball() -> (Connectivity, Vec<glam::DVec3>) {
        let ball = shapes::sphere(1.0, 4);
        let positions = ball.positions.clone();
        let surface = Connectivity::of(&PolygonMesh::from(ball)).unwrap();
        (surface, positions)
    }

    fn fire(surface: &Connectivity, positions: &[glam::DVec3]) -> Fire {
        Fire::new(surface, |a, b| {
            (positions[a as usize] - positions[b as usize]).length()
        })
    }

    #[test]
    fn nothing_burns_on_nothing() {
        let empty = Connectivity::of(&PolygonMesh::default()).unwrap();
        let mut fire = Fire::new(&empty, |_, _| 1.0);
        fire.spread(5);
        fire.reach_all();
        assert!(fire.sites.is_empty());
        assert_eq!(fire.farthest_of([]), None);
    }

    #[test]
    fn sites_lit_one_by_one_burn_what_each_would_reach_first_of_all() {
        let (surface, positions) = ball();
        let mut fire = fire(&surface, &positions);
        for k in 0..40 {
            fire.light(k * 61);
            fire.light(k * 61);
        }
        assert_eq!(fire.sites.len(), 40);
        for v in 0..fire.labels.len() as u32 {
            let here = fire.distances[v as usize];
            let ways = surface.spokes(v).map(|(_, u)| {
                let way = (positions[u as usize] - positions[v as usize]).length();
                (fire.distances[u as usize] + way, fire.labels[u as usize])
            });
            let (nearest, label) = ways.min_by(|a, b| a.0.total_cmp(&b.0)).expect("neighbours");
            if here == 0.0 {
                assert_eq!(fire.sites[fire.labels[v as usize] as usize], v);
            } else {
                assert_eq!((here, fire.labels[v as usize]), (nearest, label));
            }
        }
    }

    #[test]
    fn farthest_points_are_far_from_one_another_until_all_are_sites() {
        let (surface, positions) = ball();
        let mut fire = fire(&surface, &positions);
        fire.light(7);
        fire.spread(100);
        assert_eq!(fire.sites.len(), 100);
        let radius = fire.distances.iter().copied().fold(0.0, f64::max);
        for (k, &a) in fire.sites.iter().enumerate() {
            for &b in &fire.sites[..k] {
                // Paths along edges are at most a seventh longer than chords here.
                let gap = (positions[a as usize] - positions[b as usize]).length();
                assert!(gap > 0.8 * radius, "{gap} {radius}");
            }
        }
        fire.spread(usize::MAX);
        assert_eq!(fire.sites.len(), positions.len());
    }
}
