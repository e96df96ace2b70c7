//! Seeds in f32, four at a time, and a tree over them.

use crate::geometry::triangle_tree::{Node, fit_boxes, spatial_order};
use glam::{DVec3, Mat4, Vec3, Vec3A, Vec4, Vec4Swizzles};

/// A seed: its position, and in the fourth place the bits of its index. So a seed moves as one register, and four of them
/// transpose to their coordinates.
#[derive(Clone, Copy)]
pub(super) struct Seed(Vec4);

impl Seed {
    /// Further than any distance that counts, though its square is finite: fills lists up.
    pub(super) const FAR: Self = Self(Vec4::new(1e18, 1e18, 1e18, 0.0));

    pub(super) fn position(self) -> Vec3A {
        Vec3A::from(self.0.xyz())
    }

    pub(super) fn index(self) -> u32 {
        self.0.w.to_bits()
    }
}

/// The coordinates of four points.
#[derive(Clone, Copy)]
pub(super) struct Four {
    pub(super) x: Vec4,
    pub(super) y: Vec4,
    pub(super) z: Vec4,
}

impl Four {
    pub(super) fn of(seeds: &[Seed; 4]) -> Self {
        let rows = Mat4::from_cols(seeds[0].0, seeds[1].0, seeds[2].0, seeds[3].0).transpose();
        Self {
            x: rows.x_axis,
            y: rows.y_axis,
            z: rows.z_axis,
        }
    }

    /// The vectors from `p`.
    pub(super) fn minus(&self, p: Vec3A) -> Self {
        Self {
            x: self.x - p.x,
            y: self.y - p.y,
            z: self.z - p.z,
        }
    }

    pub(super) fn squared_distances(&self, p: Vec3A) -> Vec4 {
        let d = self.minus(p);
        d.x * d.x + d.y * d.y + d.z * d.z
    }
}

/// The least and largest coordinates of nothing.
const EMPTY: [Vec3A; 2] = [Vec3A::INFINITY, Vec3A::NEG_INFINITY];

/// The seeds in spatial order, and the boxes of the tree over that.
pub(super) struct SeedTree {
    seeds: Vec<Seed>,
    /// Their least and largest coordinates.
    boxes: Vec<[Vec3A; 2]>,
}

impl SeedTree {
    /// Over at least one seed; `local` brings them to coordinates of order 1.
    pub(super) fn new(seeds: &[DVec3], local: impl Fn(DVec3) -> Vec3A) -> Self {
        let seeds: Vec<Seed> = spatial_order(seeds)
            .into_iter()
            .map(|i| Seed(local(seeds[i as usize]).extend(f32::from_bits(i))))
            .collect();
        let mut boxes = Vec::new();
        fit_boxes(
            seeds.len(),
            &mut boxes,
            EMPTY,
            |range| {
                let positions = seeds[range].iter().map(|s| s.position());
                positions.fold(EMPTY, |[lo, hi], x| [lo.min(x), hi.max(x)])
            },
            |a, b| [a[0].min(b[0]), a[1].max(b[1])],
        );
        Self { seeds, boxes }
    }

    /// Where the seed at a place of the order is.
    pub(super) fn position(&self, place: usize) -> Vec3A {
        self.seeds[place].position()
    }

    /// The place of the seed nearest to a point; `guess` is any place, the nearer the faster.
    pub(super) fn nearest(&self, point: Vec3A, guess: usize) -> usize {
        let mut best = ((self.position(guess) - point).length_squared(), guess);
        self.search(Node::root(self.seeds.len()), Vec3::from(point), &mut best);
        best.1
    }

    fn search(&self, node: Node, point: Vec3, best: &mut (f32, usize)) {
        if node.is_leaf() {
            for place in node.range() {
                let squared = (self.seeds[place].0.xyz() - point).length_squared();
                if squared < best.0 {
                    *best = (squared, place);
                }
            }
            return;
        }
        let mut children = node
            .children()
            .map(|child| (self.squared_distance(child, point.into()), child));
        if children[1].0 < children[0].0 {
            children.swap(0, 1);
        }
        for (squared, child) in children {
            if squared < best.0 {
                self.search(child, point, best);
            }
        }
    }

    fn squared_distance(&self, node: Node, point: Vec3A) -> f32 {
        let [lo, hi] = self.boxes[node.index()];
        (point - point.clamp(lo, hi)).length_squared()
    }

    /// Appends the seeds of all leaves that pass a test together with the nodes above them.
    pub(super) fn gather(&self, into: &mut Vec<Seed>, test: impl Fn([Vec3A; 2]) -> bool) {
        let mut node = Node::root(self.seeds.len());
        // Depth first without a stack: after a leaf or a failure comes the next subtree to the right.
        while let Some(next) = {
            let passes = test(self.boxes[node.index()]);
            if passes && !node.is_leaf() {
                Some(node.children()[0])
            } else {
                if passes {
                    into.extend_from_slice(&self.seeds[node.range()]);
                }
                node.next()
            }
        } {
            node = next;
        }
    }
}
