//! The host's part of a candidate search: the lists of small groups of triangles.
//!
//! The [`TriangleTree`] is descended from blocks of as many triangles as a few cells have on average. A block's list comes
//! from a tree over the seeds; below, a node filters its parent's list. With i the seed nearest to the box's centre c,
//! seed j can be nearest somewhere in the box only if f(y) = |y − x_j|² − |y − x_i|² is negative somewhere in it; f is
//! affine, so its minimum over the box is f(c) − 2 Σ_k e_k |x_j − x_i|_k with e the half extents. For a whole node of the
//! seed tree the two terms are bounded each by itself. (From the root down, without a seed tree, every level costs as
//! much as the last one; a search per triangle would repeat that of its neighbours.)

use super::seed_tree::{Four, Seed, SeedTree};
use crate::geometry::triangle_tree::{Aabb, Node, TriangleTree};
use glam::{BVec4A, DVec3, Vec3A, Vec4};
use rayon::prelude::*;
use std::ops::Range;

/// Triangles handled by one task at most. Fixed, so that lists do not depend on the number of threads.
const GRAIN: usize = 2048;

/// Seeds to a block of triangles on average. Instructions counted on the bunny with 20,000 seeds: 4 cost 6 % more, 32 as much.
const BLOCK_SEEDS: usize = 16;

/// Bound on the rounding of f in units of (largest coordinate + distance) × distance. Counting roundings of the
/// coordinates (2 u each, in both points), the subtraction and the three-term sum gives 12 u with u = 2⁻²⁴.
pub(super) const ROUNDING: f32 = 16.0 * 6e-8;

/// Collects the lists that the search ends with, in the order of the triangles.
pub(super) trait Collect: Default + Send {
    /// A group of triangles and its list, which holds every seed that may be nearest somewhere on one of them.
    fn group(&mut self, search: &Search<'_>, triangles: Range<usize>, list: List<'_>);
}

/// A list of at least one seed, filled up to whole fours with [`Seed::FAR`].
#[derive(Clone, Copy)]
pub(super) struct List<'a> {
    pub(super) fours: &'a [[Seed; 4]],
    pub(super) len: usize,
}

/// A search for the candidates of `triangles`.
pub(super) struct Search<'a> {
    tree: &'a TriangleTree,
    triangles: &'a [[DVec3; 3]],
    frame: LocalFrame,
    root: Node,
    seeds: SeedTree,
    /// In the local frame.
    pub(super) slack: f32,
    block_level: u32,
}

impl<'a> Search<'a> {
    /// `None` where there are no triangles or no seeds.
    pub(super) fn new(
        tree: &'a TriangleTree,
        triangles: &'a [[DVec3; 3]],
        seeds: &[DVec3],
        slack: f64,
    ) -> Option<Self> {
        let root = tree.root().filter(|_| !seeds.is_empty())?;
        let frame = LocalFrame::new(tree.bounds(root), seeds);
        Some(Self {
            tree,
            triangles,
            frame,
            root,
            seeds: SeedTree::new(seeds, |x| frame.local(x)),
            slack: (slack * frame.scale) as f32,
            block_level: level_of(root, seeds.len() / BLOCK_SEEDS),
        })
    }

    /// A point in the local frame, where coordinates are of order 1.
    pub(super) fn local(&self, p: DVec3) -> Vec3A {
        self.frame.local(p)
    }

    /// The corners of some triangles in the local frame.
    pub(super) fn corners(&self, triangles: Range<usize>) -> impl Iterator<Item = [Vec3A; 3]> {
        self.triangles[triangles]
            .iter()
            .map(|corners| corners.map(|p| self.frame.local(p)))
    }

    /// Searches in parallel; the parts come in the order of the triangles.
    pub(super) fn run<C: Collect>(&self) -> Vec<C> {
        let tasks = level_of(self.root, self.triangles.len() / GRAIN);
        let tasks: Vec<Node> = self.root.descendants(tasks).collect();
        tasks.par_iter().map(|&task| self.part(task)).collect()
    }

    /// The lists of the triangles of one task.
    fn part<C: Collect>(&self, task: Node) -> C {
        let mut part = C::default();
        let mut stack = Stack::default();
        // A neighbour's nearest seed is a good first guess.
        let mut guess = 0;
        for block in task.descendants(self.block_level.max(task.level())) {
            let bounds = self.bounds(block);
            guess = self.seeds.nearest(bounds.center, guess);
            let test = BoxTest::new(&bounds, self.seeds.position(guess), self.slack);
            stack.0.clear();
            self.seeds
                .gather(&mut stack.0, |range| test.may_keep_some_between(range));
            let gathered = stack.close(0);
            let list = stack.filter(&test, gathered);
            self.descend(block, list, &mut stack, &mut part);
        }
        part
    }

    /// Hands on the lists of a subtree, whose own list is `list`.
    fn descend<C: Collect>(&self, node: Node, list: Place, stack: &mut Stack, part: &mut C) {
        if list.len == 1 || node.is_leaf() {
            part.group(self, node.range(), stack.list(list));
            return;
        }
        for child in node.children() {
            let bounds = self.bounds(child);
            let nearest = stack.nearest(list, bounds.center);
            let kept = stack.filter(&BoxTest::new(&bounds, nearest, self.slack), list);
            self.descend(child, kept, stack, part);
            stack.0.truncate(kept.begin);
        }
    }

    fn bounds(&self, node: Node) -> LocalBox {
        let Aabb { lo, hi } = self.tree.bounds(node);
        LocalBox {
            center: self.frame.local(0.5 * (lo + hi)),
            half: ((hi - lo) * (0.5 * self.frame.scale)).as_vec3a(),
        }
    }
}

/// The first level of at least `nodes` nodes, or that of the leaves.
fn level_of(root: Node, nodes: usize) -> u32 {
    nodes.max(1).next_power_of_two().ilog2().min(root.depth())
}

/// Brings triangles and seeds to coordinates of order 1 about the triangles' centre, where f32 serves.
#[derive(Clone, Copy)]
struct LocalFrame {
    center: DVec3,
    scale: f64,
}

impl LocalFrame {
    fn new(bounds: Aabb, seeds: &[DVec3]) -> Self {
        let center = 0.5 * (bounds.lo + bounds.hi);
        let reach = seeds
            .iter()
            .map(|x| (*x - center).abs().max_element())
            .fold((bounds.hi - center).max_element(), f64::max);
        Self {
            center,
            scale: if reach > 0.0 { 1.0 / reach } else { 1.0 },
        }
    }

    fn local(&self, p: DVec3) -> Vec3A {
        ((p - self.center) * self.scale).as_vec3a()
    }
}

/// A box by its centre and half extents.
struct LocalBox {
    center: Vec3A,
    half: Vec3A,
}

/// The pruning of one box by one seed, best that nearest to its centre.
struct BoxTest {
    center: Vec3A,
    /// Twice the half extents.
    extent: Vec3A,
    nearest: Vec3A,
    bound: f32,
}

impl BoxTest {
    fn new(bounds: &LocalBox, nearest: Vec3A, slack: f32) -> Self {
        let LocalBox { center, half } = *bounds;
        let squared = (nearest - center).length_squared();
        let far = squared.sqrt() + half.length();
        let reach = far + half.length() + 2.0 * slack;
        Self {
            center,
            extent: 2.0 * half,
            nearest,
            bound: squared + 4.0 * slack * (far + slack) + ROUNDING * (1.0 + reach) * reach,
        }
    }

    /// Which of the seeds may be nearest somewhere in the box.
    fn keeps(&self, seeds: &Four) -> BVec4A {
        let apart = seeds.minus(self.nearest);
        let gain = self.extent.x * apart.x.abs()
            + self.extent.y * apart.y.abs()
            + self.extent.z * apart.z.abs();
        (seeds.squared_distances(self.center) - gain).cmple(Vec4::splat(self.bound))
    }

    /// Whether a seed between these coordinates may be.
    fn may_keep_some_between(&self, [lo, hi]: [Vec3A; 2]) -> bool {
        let distance = self.center - self.center.clamp(lo, hi);
        let apart = (hi - self.nearest).max(self.nearest - lo);
        distance.length_squared() - self.extent.dot(apart) <= self.bound
    }
}

/// The lists of a node and of those above it.
#[derive(Default)]
struct Stack(Vec<Seed>);

/// Where a list is on the stack, filled up.
#[derive(Clone, Copy)]
struct Place {
    begin: usize,
    len: usize,
}

impl Stack {
    /// Makes what follows `begin` a list.
    fn close(&mut self, begin: usize) -> Place {
        let len = self.0.len() - begin;
        self.0.resize(begin + len.next_multiple_of(4), Seed::FAR);
        Place { begin, len }
    }

    fn list(&self, Place { begin, len }: Place) -> List<'_> {
        let filled = begin..begin + len.next_multiple_of(4);
        List {
            fours: self.0[filled].as_chunks().0,
            len,
        }
    }

    /// The seed of a list nearest to a point.
    fn nearest(&self, list: Place, point: Vec3A) -> Vec3A {
        let mut best = (f32::INFINITY, Vec3A::ZERO);
        for four in self.list(list).fours {
            let squared = Four::of(four).squared_distances(point);
            if squared.cmplt(Vec4::splat(best.0)).any() {
                for (k, seed) in four.iter().enumerate() {
                    if squared[k] < best.0 {
                        best = (squared[k], seed.position());
                    }
                }
            }
        }
        best.1
    }

    /// Leaves the seeds of a list that pass the test as a new list at the end.
    fn filter(&mut self, test: &BoxTest, list: Place) -> Place {
        let begin = self.0.len();
        let filled = list.len.next_multiple_of(4);
        self.0.resize(begin + filled, Seed::FAR);
        let (lists, kept) = self.0.split_at_mut(begin);
        // Without branches: every seed is written, and the next one overwrites it unless it is kept.
        let mut len = 0;
        for four in lists[list.begin..list.begin + filled].as_chunks().0 {
            let keeps = test.keeps(&Four::of(four)).bitmask();
            for (k, seed) in four.iter().enumerate() {
                kept[len] = *seed;
                len += (keeps >> k & 1) as usize;
            }
        }
        self.0.truncate(begin + len);
        self.close(begin)
    }
}
