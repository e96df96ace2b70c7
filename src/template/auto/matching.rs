//! Triangles in pairs: the quads of a triangle mesh.
//!
//! **Theory.** Pairs of neighbours are a matching in the graph whose nodes are triangles. Every node of a closed triangle mesh has three neighbours and no edge
//! disconnects it, so it has a perfect matching [J. Petersen, *Die Theorie der regulären graphs*, 1891]. Good pairs are taken greedily; what is left single is
//! paired along augmenting paths, which blossoms are contracted to find [J. Edmonds, *Paths, trees, and flowers*, 1965]; rings of triangles around a vertex
//! are paired the other way where that is better.

use std::collections::VecDeque;

const NONE: u32 = u32::MAX;

/// Pairs of nodes of a graph with three neighbours to a node.
pub(super) struct Matching<'a> {
    neighbours: &'a [[u32; 3]],
    mates: Vec<u32>,
    /// Of the search: the tree's edges, the blossoms, what is in the tree, and which nodes to reset.
    parents: Vec<u32>,
    bases: Vec<u32>,
    even: Vec<bool>,
    touched: Vec<u32>,
}

impl<'a> Matching<'a> {
    /// No pairs yet. `neighbours`: `[nodes, 3]`, mutual.
    pub fn new(neighbours: &'a [[u32; 3]]) -> Self {
        let count = neighbours.len();
        Self {
            neighbours,
            mates: vec![NONE; count],
            parents: vec![NONE; count],
            bases: (0..count as u32).collect(),
            even: vec![false; count],
            touched: Vec::new(),
        }
    }

    /// Pairs two neighbours unless one of them is paired already.
    pub fn pair(&mut self, a: u32, b: u32) {
        if self.mates[a as usize] == NONE && self.mates[b as usize] == NONE {
            self.join(a, b);
        }
    }

    /// The other one of a node's pair.
    pub fn mate(&self, node: u32) -> Option<u32> {
        let mate = self.mates[node as usize];
        (mate != NONE).then_some(mate)
    }

    /// Makes the matching as large as it can be, and returns the number of single nodes.
    pub fn complete(&mut self) -> usize {
        let mut single = 0;
        for root in 0..self.mates.len() as u32 {
            if self.mates[root as usize] == NONE {
                let end = self.search(root);
                match end {
                    Some(end) => self.augment(end),
                    None => single += 1,
                }
                self.forget();
            }
        }
        single
    }

    /// Pairs a ring of nodes, each beside the next, the other way round where its pairs alternate and `cost` then falls.
    pub fn turn_ring(&mut self, ring: &[u32], cost: impl Fn(u32, u32) -> f64) -> bool {
        let n = ring.len();
        if n % 2 == 1 {
            return false;
        }
        let is_paired = |k: usize| self.mates[ring[k % n] as usize] == ring[(k + 1) % n];
        let Some(first) = [0, 1]
            .into_iter()
            .find(|&first| (0..n / 2).all(|k| is_paired(first + 2 * k)))
        else {
            return false;
        };
        let total = |first: usize| -> f64 {
            (0..n / 2)
                .map(|k| cost(ring[(first + 2 * k) % n], ring[(first + 2 * k + 1) % n]))
                .sum()
        };
        if total(1 - first) >= total(first) {
            return false;
        }
        for k in 0..n / 2 {
            let at = 1 - first + 2 * k;
            self.join(ring[at % n], ring[(at + 1) % n]);
        }
        true
    }

    fn join(&mut self, a: u32, b: u32) {
        self.mates[a as usize] = b;
        self.mates[b as usize] = a;
    }

    /// Grows an alternating tree from a single node, and returns another single node that it reaches.
    fn search(&mut self, root: u32) -> Option<u32> {
        let mut queue = VecDeque::from([root]);
        self.even[root as usize] = true;
        self.touched.push(root);
        while let Some(v) = queue.pop_front() {
            for to in self.neighbours[v as usize] {
                let mate = self.mates[to as usize];
                if self.bases[v as usize] == self.bases[to as usize] || self.mates[v as usize] == to
                {
                    continue;
                }
                let is_even = to == root || (mate != NONE && self.parents[mate as usize] != NONE);
                if is_even {
                    self.contract(v, to, &mut queue);
                } else if self.parents[to as usize] == NONE {
                    self.parents[to as usize] = v;
                    self.touched.push(to);
                    if mate == NONE {
                        return Some(to);
                    }
                    self.even[mate as usize] = true;
                    self.touched.push(mate);
                    queue.push_back(mate);
                }
            }
        }
        None
    }

    /// Makes the odd cycle that the edge ab closes in the tree one node.
    fn contract(&mut self, a: u32, b: u32, queue: &mut VecDeque<u32>) {
        let base = self.common_base(a, b);
        let mut blossom = Vec::new();
        for (from, child) in [(a, b), (b, a)] {
            let (mut v, mut child) = (from, child);
            while self.bases[v as usize] != base {
                let mate = self.mates[v as usize];
                blossom.extend([self.bases[v as usize], self.bases[mate as usize]]);
                self.parents[v as usize] = child;
                child = mate;
                v = self.parents[mate as usize];
            }
        }
        for k in 0..self.touched.len() {
            let v = self.touched[k];
            if blossom.contains(&self.bases[v as usize]) {
                self.bases[v as usize] = base;
                if !std::mem::replace(&mut self.even[v as usize], true) {
                    queue.push_back(v);
                }
            }
        }
    }

    /// Where the ways of two even nodes to the root meet.
    fn common_base(&self, a: u32, b: u32) -> u32 {
        let up = |v: u32| {
            let mate = self.mates[v as usize];
            let above = (mate != NONE).then(|| self.parents[mate as usize]);
            above.filter(|&p| p != NONE).map(|p| self.bases[p as usize])
        };
        let way = |v: u32| std::iter::successors(Some(self.bases[v as usize]), move |&v| up(v));
        let first: Vec<u32> = way(a).collect();
        way(b).find(|v| first.contains(v)).unwrap_or(a)
    }

    /// Exchanges paired and unpaired edges on the way from a single node to the root.
    fn augment(&mut self, end: u32) {
        let mut v = end;
        while v != NONE {
            let parent = self.parents[v as usize];
            let next = self.mates[parent as usize];
            self.join(v, parent);
            v = next;
        }
    }

    /// Resets the search.
    fn forget(&mut self) {
        for v in self.touched.drain(..) {
            self.parents[v as usize] = NONE;
            self.bases[v as usize] = v;
            self.even[v as usize] = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;
    use crate::mesh::{Connectivity, shapes};

    /// The triangles beside each triangle.
    fn neighbours(mesh: crate::mesh::TriangleMesh) -> Vec<[u32; 3]> {
        let mesh = Connectivity::of(&mesh.into()).expect("a manifold");
        let across = |h: u32| mesh.opposite(h).map_or(NONE, |o| mesh.face_of(o));
        (0..mesh.face_count())
            .map(|f| [0, 1, 2].map(|k| across(mesh.half_edges(f).start + k)))
            .collect()
    }

    fn check(neighbours: &[[u32; 3]], matching: &Matching) {
        for (v, around) in neighbours.iter().enumerate() {
            let mate = matching.mate(v as u32).expect("a pair");
            assert!(around.contains(&mate));
            assert_eq!(matching.mate(mate), Some(v as u32));
        }
    }

    #[test]
    fn every_triangle_of_a_closed_mesh_finds_a_partner_from_any_start() {
        let mut random = Random::new(5);
        for mesh in [
            shapes::sphere(1.0, 0),
            shapes::sphere(1.0, 3),
            shapes::torus(2.0, 1.0, 31, 17).triangulate(),
        ] {
            let neighbours = neighbours(mesh);
            for _ in 0..20 {
                let mut matching = Matching::new(&neighbours);
                for _ in 0..neighbours.len() {
                    let v = random.below(neighbours.len());
                    matching.pair(v as u32, neighbours[v][random.below(3)]);
                }
                assert_eq!(matching.complete(), 0);
                check(&neighbours, &matching);
            }
        }
    }

    /// The smallest graph with three neighbours to a node and no perfect matching: three blossoms at one node.
    #[test]
    fn what_has_no_perfect_matching_is_matched_as_far_as_it_can_be() {
        let mut neighbours = vec![[1, 6, 11]];
        for first in [1, 6, 11] {
            let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(|k| first + k);
            neighbours.extend([[0, b, c], [a, d, e], [a, d, e], [b, c, e], [b, c, d]]);
        }
        let mut matching = Matching::new(&neighbours);
        assert_eq!(matching.complete(), 2);
    }

    #[test]
    fn rings_turn_only_where_that_is_better() {
        let square = [[1, 3, 1], [0, 2, 0], [1, 3, 1], [0, 2, 0]];
        let mut matching = Matching::new(&square);
        assert!(!matching.turn_ring(&[0, 1, 2, 3], |_, _| 0.0));
        matching.pair(0, 1);
        matching.pair(2, 3);
        assert!(!matching.turn_ring(&[0, 1, 2], |_, _| 1.0));
        assert!(!matching.turn_ring(&[0, 1, 2, 3], |_, _| 1.0));
        let dear = |a: u32, b: u32| f64::from(u8::from(a.min(b) == 0 && a.max(b) == 1));
        assert!(matching.turn_ring(&[0, 1, 2, 3], dear));
        assert_eq!((matching.mate(1), matching.mate(3)), (Some(2), Some(0)));
    }
}
