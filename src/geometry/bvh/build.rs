//! The tree built from the top: a node's triangles are split in two by the binned surface-area heuristic, and the larger parts again, until there
//! are four children.

use super::{Bounds, COUNT_BITS, HEURISTIC_LEVELS, LEAF, Node};
use glam::Vec3A;
use rayon::prelude::*;

/// Most triangles of a leaf.
const LEAF_SIZE: usize = 2;
/// Bins of the surface-area heuristic.
const BINS: usize = 16;
/// Runs up to this length are halved by count: binning them costs more than it saves.
const FEW: usize = 8;
/// Subtrees larger than this are built in parallel.
const PARALLEL_SIZE: usize = 4096;

/// A triangle during the build.
#[derive(Clone, Copy)]
pub(super) struct Item {
    pub bounds: Bounds,
    /// Its index in the mesh.
    pub index: u32,
}

/// The nodes of the tree over `items`, the root first; brings these into the order of its leaves.
pub(super) fn tree(items: &mut [Item]) -> Vec<Node> {
    let mut nodes = Vec::with_capacity(items.len() / LEAF_SIZE);
    build(items, 0, 0, &mut nodes);
    nodes
}

/// Appends the tree over `items` and brings them into the order of its leaves; `first` is the slot of the first item.
fn build(items: &mut [Item], first: usize, level: usize, nodes: &mut Vec<Node>) {
    let root = nodes.len();
    nodes.push(Node::EMPTY);
    let parallel = items.len() > PARALLEL_SIZE;
    let mut parts = split_in_four(items, first, level);
    for (k, part) in parts.iter().enumerate() {
        nodes[root].set_bounds(k, part.bounds());
    }
    let subtree = |part: &mut Part, nodes: &mut Vec<Node>| {
        let child = nodes.len() as u32;
        if part.items.len() <= LEAF_SIZE {
            return leaf_reference(part.first, part.items.len());
        }
        build(part.items, part.first, level + 1, nodes);
        child
    };
    if parallel {
        let build_apart = |part: &mut Part| {
            let mut nodes = Vec::new();
            (subtree(part, &mut nodes), nodes)
        };
        let subtrees: Vec<_> = parts.par_iter_mut().map(build_apart).collect();
        for (k, (child, subtree)) in subtrees.into_iter().enumerate() {
            nodes[root].children[k] = moved(child, nodes.len());
            append(nodes, subtree);
        }
    } else {
        for (k, part) in parts.iter_mut().enumerate() {
            nodes[root].children[k] = subtree(part, nodes);
        }
    }
}

/// A run of items that becomes a child.
struct Part<'a> {
    items: &'a mut [Item],
    first: usize,
}

impl Part<'_> {
    fn bounds(&self) -> Bounds {
        self.items
            .iter()
            .fold(Bounds::EMPTY, |sum, item| sum.union(item.bounds))
    }
}

/// Up to four runs of the reordered items, by splitting the largest run again and again while it is too large for a leaf.
fn split_in_four(items: &mut [Item], first: usize, level: usize) -> Vec<Part<'_>> {
    let mut parts = vec![Part { items, first }];
    while parts.len() < 4 {
        let largest = (0..parts.len()).max_by_key(|&k| parts[k].items.len());
        let Some(k) = largest.filter(|&k| parts[k].items.len() > LEAF_SIZE) else {
            break;
        };
        let Part { items, first } = parts.swap_remove(k);
        let middle = split(items, level < HEURISTIC_LEVELS);
        let (left, right) = items.split_at_mut(middle);
        parts.push(Part { items: left, first });
        parts.push(Part {
            items: right,
            first: first + middle,
        });
    }
    parts
}

/// Adds a subtree at the end, its references moved along.
fn append(nodes: &mut Vec<Node>, subtree: Vec<Node>) {
    let start = nodes.len();
    nodes.extend(subtree.into_iter().map(|mut node| {
        node.children = node.children.map(|child| moved(child, start));
        node
    }));
}

/// A child's reference after its nodes have moved up by `offset`.
fn moved(child: u32, offset: usize) -> u32 {
    if child & LEAF == 0 {
        child + offset as u32
    } else {
        child
    }
}

/// Reorders at least two items into two non-empty runs; returns the length of the first.
fn split(items: &mut [Item], by_heuristic: bool) -> usize {
    let (lo, hi) = items
        .iter()
        .map(|item| item.bounds.center())
        .fold((Vec3A::splat(4.0), Vec3A::splat(-4.0)), |(lo, hi), c| {
            (lo.min(c), hi.max(c))
        });
    let extent = hi - lo;
    let axis = usize::from(extent.y > extent.x);
    let axis = if extent.z > extent[axis] { 2 } else { axis };
    if by_heuristic && items.len() > FEW && extent[axis] > 0.0 {
        let bins = Binning {
            axis,
            lo: lo[axis],
            // Just under the number of bins, so that the highest centre falls into the last one.
            per_unit: BINS as f32 * (1.0 - f32::EPSILON) / extent[axis],
        };
        let cut = bins.cheapest_cut(items);
        partition(items, |item| bins.of(item) < cut)
    } else {
        let middle = items.len() / 2;
        items.select_nth_unstable_by(middle, |a, b| {
            a.bounds.center()[axis]
                .total_cmp(&b.bounds.center()[axis])
                .then(a.index.cmp(&b.index))
        });
        middle
    }
}

/// Equal slabs between the lowest and the highest centre along one axis.
struct Binning {
    axis: usize,
    lo: f32,
    per_unit: f32,
}

impl Binning {
    fn of(&self, item: &Item) -> usize {
        (((item.bounds.center()[self.axis] - self.lo) * self.per_unit) as usize).min(BINS - 1)
    }

    /// The bin before which to cut so that the sum of area times count over both sides is least. The first and the last bin are never
    /// empty, so neither side is.
    fn cheapest_cut(&self, items: &[Item]) -> usize {
        let mut bins = [(Bounds::EMPTY, 0u32); BINS];
        for item in items {
            let bin = &mut bins[self.of(item)];
            *bin = (bin.0.union(item.bounds), bin.1 + 1);
        }
        let grow = |side: &mut (Bounds, u32), bin: &(Bounds, u32)| {
            *side = (side.0.union(bin.0), side.1 + bin.1);
            side.0.half_area() * side.1 as f32
        };
        let mut above = [0.0; BINS];
        let mut side = (Bounds::EMPTY, 0);
        for cut in (1..BINS).rev() {
            above[cut] = grow(&mut side, &bins[cut]);
        }
        let mut side = (Bounds::EMPTY, 0);
        let mut best = (f32::INFINITY, 1);
        for cut in 1..BINS {
            let cost = grow(&mut side, &bins[cut - 1]) + above[cut];
            if cost < best.0 {
                best = (cost, cut);
            }
        }
        best.1
    }
}

/// Moves the items that satisfy `is_first` to the front; returns their number.
fn partition(items: &mut [Item], is_first: impl Fn(&Item) -> bool) -> usize {
    let mut count = 0;
    for k in 0..items.len() {
        if is_first(&items[k]) {
            items.swap(k, count);
            count += 1;
        }
    }
    count
}

/// The reference of a run of leaves.
fn leaf_reference(first: usize, count: usize) -> u32 {
    LEAF | (first as u32) << COUNT_BITS | count as u32
}
