//! The grass fire: which site each vertex of a surface is nearest to, along edges.
//!
//! Fires lit at the sites burn along the edges at unit speed; a vertex belongs to the site whose fire reaches it first \[MKJK15, algorithm 1\]. A site
//! that comes later is lit alone in what has burnt already, and takes over what it reaches sooner: its cost is that of its own cell.

use crate::mesh::Connectivity;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ops::Range;

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
        self.burn(BinaryHeap::from([Reverse((0, vertex))]));
    }

    /// Takes sites away by their labels; what was theirs goes to the nearest of the others, which are numbered anew in their order.
    pub fn put_out(&mut self, labels: &[u32]) {
        let mut numbers = vec![0; self.sites.len()];
        for &label in labels {
            numbers[label as usize] = NONE;
        }
        let mut next = 0..;
        for number in numbers.iter_mut().filter(|number| **number != NONE) {
            *number = next.next().unwrap_or(NONE);
        }
        let mut all = 0..self.sites.len();
        self.sites
            .retain(|_| all.next().is_some_and(|k| numbers[k] != NONE));
        for (label, distance) in self.labels.iter_mut().zip(&mut self.distances) {
            *label = numbers.get(*label as usize).copied().unwrap_or(NONE);
            if *label == NONE {
                *distance = f64::INFINITY;
            }
        }
        let burns = |v: u32| self.labels[v as usize] != NONE;
        let is_at_the_front = |v: &u32| burns(*v) && self.ways(*v).iter().any(|way| !burns(way.0));
        let entry = |v: u32| Reverse((self.distances[v as usize].to_bits(), v));
        let vertices = 0..self.labels.len() as u32;
        let front: BinaryHeap<_> = vertices.filter(is_at_the_front).map(entry).collect();
        self.burn(front);
    }

    /// Burns on from vertices whose label and distance are known: the bits of floats that are not negative sort as they do.
    fn burn(&mut self, mut front: BinaryHeap<Reverse<(u64, u32)>>) {
        while let Some(Reverse((bits, v))) = front.pop() {
            let (here, label) = (self.distances[v as usize], self.labels[v as usize]);
            if here.to_bits() != bits {
                continue;
            }
            for k in self.range(v) {
                let (u, length) = self.ways[k];
                let there = here + length;
                if there < self.distances[u as usize] {
                    self.distances[u as usize] = there;
                    self.labels[u as usize] = label;
                    front.push(Reverse((there.to_bits(), u)));
                }
            }
        }
    }

    fn range(&self, v: u32) -> Range<usize> {
        self.offsets[v as usize] as usize..self.offsets[v as usize + 1] as usize
    }

    fn ways(&self, v: u32) -> &[(u32, f64)] {
        &self.ways[self.range(v)]
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
    fn what_is_put_out_is_as_if_it_had_never_burnt() {
        let (surface, positions) = ball();
        let lit = |sites: &mut dyn Iterator<Item = u32>| {
            let mut fire = fire(&surface, &positions);
            sites.for_each(|k| fire.light(k * 61));
            fire
        };
        let mut found = lit(&mut (0..40));
        found.put_out(&[]);
        found.put_out(&[17, 0, 3, 4]);
        let expected = lit(&mut (0..40).filter(|k| ![17, 0, 3, 4].contains(k)));
        assert_eq!(found.sites, expected.sites);
        assert_eq!(found.distances, expected.distances);
        let labels = || found.labels.iter().zip(&expected.labels);
        let same = labels().filter(|(a, b)| a == b).count();
        assert!(100 * same > 98 * found.labels.len(), "but for ties: {same}");
        found.put_out(&(0..36).collect::<Vec<_>>());
        assert!(found.sites.is_empty() && found.labels.iter().all(|&label| label == NONE));
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
