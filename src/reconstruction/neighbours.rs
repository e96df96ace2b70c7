//! The nearest neighbours of every point of a cloud.

use glam::DVec3;
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;
use std::f64::consts::PI;

/// Neighbours a point: enough for a plane through noise, few enough for it to bend with the surface.
const COUNT: usize = 12;

/// Lists of neighbours of points.
#[derive(Debug, Clone)]
pub(super) struct Graph {
    /// `[points + 1]`.
    offsets: Vec<u32>,
    indices: Vec<u32>,
}

/// The points of a cloud that are nearest to others or to anything, nearest first.
#[derive(Debug, Clone)]
pub(super) struct Neighbours {
    tree: RTree<Entry>,
    graph: Graph,
    /// `[points]`: the share of the surface that a point stands for.
    areas: Vec<f64>,
}

/// A point and its index.
type Entry = GeomWithData<[f64; 3], u32>;

impl Neighbours {
    /// The nearest others of each point; all of them where there are few. Points at the same place are one another's neighbours, of no area.
    pub fn of_points(positions: &[DVec3]) -> Self {
        let points = positions.iter().enumerate();
        let entries = points.map(|(i, p)| Entry::new(p.to_array(), i as u32));
        let tree = RTree::bulk_load(entries.collect());
        let near = |i: usize| -> (Vec<u32>, f64) {
            let mut found = nearest(&tree, positions[i], COUNT + 1);
            found.retain(|&(_, j)| j as usize != i);
            found.truncate(COUNT);
            let radius_squared = found.last().map_or(0.0, |last| last.0);
            let area = PI * radius_squared / found.len().max(1) as f64;
            (found.into_iter().map(|(_, j)| j).collect(), area)
        };
        let found: Vec<(Vec<u32>, f64)> = (0..positions.len()).into_par_iter().map(near).collect();
        Self {
            areas: found.iter().map(|(_, area)| *area).collect(),
            graph: Graph::from_lists(found.into_iter().map(|(list, _)| list)),
            tree,
        }
    }

    /// The neighbours of point `i`.
    pub fn of(&self, i: usize) -> &[u32] {
        self.graph.of(i)
    }

    /// The area around point `i` that no other point stands for: that of the disc that holds its neighbours, divided by their number.
    pub fn area(&self, i: usize) -> f64 {
        self.areas[i]
    }

    /// The points nearest to anything.
    pub fn nearest(&self, x: DVec3) -> impl Iterator<Item = usize> {
        nearest(&self.tree, x, COUNT)
            .into_iter()
            .map(|(_, i)| i as usize)
    }

    /// With j a neighbour of i wherever i is one of j.
    pub fn symmetric(&self) -> Graph {
        let mut lists = vec![Vec::new(); self.areas.len()];
        for i in 0..lists.len() {
            for &j in self.of(i) {
                lists[i].push(j);
                lists[j as usize].push(i as u32);
            }
        }
        for list in &mut lists {
            list.sort_unstable();
            list.dedup();
        }
        Graph::from_lists(lists.into_iter())
    }
}

impl Graph {
    fn from_lists(lists: impl Iterator<Item = Vec<u32>>) -> Self {
        let (mut offsets, mut indices) = (vec![0], Vec::new());
        for list in lists {
            indices.extend(list);
            offsets.push(indices.len() as u32);
        }
        Self { offsets, indices }
    }

    /// The neighbours of point `i`.
    pub fn of(&self, i: usize) -> &[u32] {
        &self.indices[self.offsets[i] as usize..self.offsets[i + 1] as usize]
    }
}

/// The squared distances and indices of the nearest points.
fn nearest(tree: &RTree<Entry>, x: DVec3, count: usize) -> Vec<(f64, u32)> {
    let found = tree
        .nearest_neighbor_iter_with_distance_2(x.to_array())
        .take(count);
    let mut found: Vec<(f64, u32)> = found.map(|(entry, d2)| (d2, entry.data)).collect();
    // Those at one distance come in the tree's order, which is none.
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    found
}
