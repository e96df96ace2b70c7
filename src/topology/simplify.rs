//! Simplification by the quadric error metric: a coarse mesh of a fine one's shape and topology.
//!
//! **Theory** [GH97: M. Garland, P. S. Heckbert, *Surface simplification using quadric error metrics*]. Each vertex carries the area-weighted sum of squared distances to
//! the planes of its triangles. Contracting an edge adds the quadrics of its ends and puts the vertex where the sum is least; the edge
//! that costs least goes first. A rim (boundary, or edge of more than two faces) also counts planes through its edges across their faces, so that it stays. Each vertex
//! counts its own place a little, which makes every system regular and keeps flat areas even [P. Trettner, L. Kobbelt, *Fast and robust QEF
//! minimization using probabilistic quadrics*, 2020, is the argument for it].
//!
//! **Practice.** A sum of quadrics is nowhere less than its parts, so an edge's cost never falls: a contraction only marks the edges around it stale, and they are
//! priced again when they come up (lazily, with the same result as at once). What topology (`complex`) or a fold forbids is parked until its
//! surroundings change. Coordinates are those of the unit frame; ties go by edge number, so the result is always the same to the bit.

use super::clean::{cleaned, compacted};
use super::complex::{Complex, Corner, Place, split};
use super::quadric::Quadric;
use super::queue::Queue;
use crate::mesh::{Frame, TriangleMesh};
use glam::DVec3;
use rayon::prelude::*;

/// What to simplify to. The result never has fewer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// This many triangles; one more where only pairs of them can go, as in a closed mesh.
    Faces(usize),
    /// This many vertices.
    Vertices(usize),
}

/// The outcome of [`simplify`].
#[derive(Debug, Clone, PartialEq)]
pub struct Simplified {
    /// The coarse mesh, in the input's coordinates and orientation.
    pub mesh: TriangleMesh,
    /// The largest distance (root mean square over area, input units) of a vertex from the planes that it stands for.
    pub deviation: f64,
    /// Whether the target was met; if not, nothing more can be contracted without changing the topology (a soup: nothing at all) or folding.
    pub reached: bool,
}

/// Weight of the planes that hold a rim, against area: an edge of length l counts as `RIM` l².
const RIM: f64 = 10.0;
/// The weight of a vertex's own place, against the area around it, unless the caller wants another: enough for a regular system in f64, too little to be seen in the errors.
const ANCHOR: f64 = 1e-5;
/// A contraction may turn no triangle by more than this cosine allows.
const TURN: f64 = 0.2;

/// Contracts edges of a mesh, cheapest first, down to a target count, keeping its topology (components, handles, boundaries, lines where sheets meet).
///
/// The mesh is cleaned first ([`cleaned`]: equal positions merged, degenerate and duplicate triangles dropped); a mesh already under its target is
/// returned so, with the bits of its positions. Expects finite positions and indices in range, as the readers ensure. O(n log n) in time; about 200 bytes
/// a triangle.
pub fn simplify(mesh: &TriangleMesh, target: Target) -> Simplified {
    simplify_evenly(mesh, target, ANCHOR)
}

/// Like [`simplify`], with triangles of even size where `evenness` is large: the weight of a vertex's own place against the area around it, 1e-5 in [`simplify`]. From about
/// 1e-3 on flat parts are divided as evenly as round ones.
pub fn simplify_evenly(mesh: &TriangleMesh, target: Target, evenness: f64) -> Simplified {
    let clean = cleaned(mesh);
    let Ok(frame) = Frame::of(&clean) else {
        let reached = true;
        return Simplified {
            mesh: clean,
            deviation: 0.0,
            reached,
        };
    };
    let mut run = Simplification::new(&clean, &frame, evenness);
    let reached = run.contract_to(target);
    let positions: Vec<DVec3> = run
        .positions
        .iter()
        .zip(&clean.positions)
        .map(|(&x, &p)| {
            if x == frame.to_unit(p) {
                p
            } else {
                frame.to_input(x)
            }
        })
        .collect();
    Simplified {
        mesh: compacted(&positions, run.complex.remaining().collect()),
        deviation: run.deviation_squared.sqrt() * frame.diagonal,
        reached,
    }
}

/// Where an edge stands towards the queue.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Standing {
    /// Queued with its cost.
    Priced,
    /// Queued with a cost that may be too low.
    Stale,
    /// Not queued: it was forbidden when it came up.
    Parked,
}

/// What contracting an edge would give: the vertex, what it costs, and what it would stand for.
struct Offer {
    position: DVec3,
    cost: f64,
    quadric: Quadric,
}

struct Simplification {
    complex: Complex,
    /// In the unit frame.
    positions: Vec<DVec3>,
    quadrics: Vec<Quadric>,
    standing: Vec<Standing>,
    queue: Queue,
    faces: usize,
    vertices: usize,
    deviation_squared: f64,
}

impl Simplification {
    fn new(mesh: &TriangleMesh, frame: &Frame, evenness: f64) -> Self {
        let complex = Complex::new(&mesh.triangles, mesh.positions.len());
        let positions: Vec<DVec3> = mesh.positions.iter().map(|&p| frame.to_unit(p)).collect();
        let quadrics = (0..positions.len() as u32)
            .into_par_iter()
            .with_min_len(1024)
            .map(|v| vertex_quadric(&complex, &positions, v, evenness))
            .collect();
        let mut run = Self {
            standing: vec![Standing::Priced; complex.edge_count()],
            queue: Queue::new(),
            faces: mesh.triangles.len(),
            vertices: positions.len(),
            deviation_squared: 0.0,
            complex,
            positions,
            quadrics,
        };
        let costs: Vec<f64> = (0..run.complex.edge_count() as u32)
            .into_par_iter()
            .with_min_len(1024)
            .map(|e| run.offer(e).cost)
            .collect();
        for (e, cost) in costs.into_iter().enumerate() {
            run.queue.push(cost, e as u32);
        }
        run
    }

    /// Contracts until the target is met, and says whether it is.
    fn contract_to(&mut self, target: Target) -> bool {
        while self.work_through_queue(target) {
            // What was forbidden where it came up may have become possible from further away.
            for e in 0..self.complex.edge_count() as u32 {
                self.unpark(e);
            }
        }
        self.met(target)
    }

    fn met(&self, target: Target) -> bool {
        match target {
            Target::Faces(n) => self.faces.saturating_sub(1) <= n,
            Target::Vertices(n) => self.vertices <= n,
        }
    }

    /// Whether a contraction that takes `faces` triangles away stays within the target.
    fn allows(&self, target: Target, faces: u32) -> bool {
        match target {
            Target::Faces(n) => self.faces.saturating_sub(n) >= faces as usize,
            Target::Vertices(n) => self.vertices > n,
        }
    }

    /// Contracts until nothing is queued or allowed; true where that contracted something and the target is still ahead.
    fn work_through_queue(&mut self, target: Target) -> bool {
        let mut contracted = false;
        while self.allows(target, 1) {
            let Some(edge) = self.queue.pop() else {
                return contracted;
            };
            let faces = self.complex.faces(edge);
            if faces == 0 {
                continue;
            }
            if self.standing[edge as usize] == Standing::Stale {
                self.enqueue(edge);
            } else if self.allows(target, faces) && self.contract(edge) {
                contracted = true;
            } else {
                self.standing[edge as usize] = Standing::Parked;
            }
        }
        false
    }

    /// Contracts an edge unless topology or a fold forbids it.
    fn contract(&mut self, edge: u32) -> bool {
        if !self.complex.contractible(edge) {
            return false;
        }
        let Offer {
            position,
            cost,
            quadric,
        } = self.offer(edge);
        if self.folds(edge, position) {
            return false;
        }
        self.faces -= self.complex.faces(edge) as usize;
        self.vertices -= 1;
        self.deviation_squared = self.deviation_squared.max(cost / quadric.weight());
        let kept = self.complex.contract(edge);
        self.positions[kept as usize] = position;
        self.quadrics[kept as usize] = quadric;
        for i in 0..self.complex.stars()[0].len() {
            for spoke in self.complex.spokes(self.complex.stars()[0][i]) {
                self.unpark(spoke);
                self.standing[spoke as usize] = Standing::Stale;
            }
        }
        true
    }

    /// Queues an edge if it was parked.
    fn unpark(&mut self, edge: u32) {
        if self.standing[edge as usize] == Standing::Parked && self.complex.faces(edge) != 0 {
            self.enqueue(edge);
        }
    }

    /// Queues an edge at what it costs now.
    fn enqueue(&mut self, edge: u32) {
        self.standing[edge as usize] = Standing::Priced;
        self.queue.push(self.offer(edge).cost, edge);
    }

    /// What contracting an edge would give.
    fn offer(&self, edge: u32) -> Offer {
        let [a, b] = self.complex.ends(edge);
        let quadric = self.quadrics[a as usize] + self.quadrics[b as usize];
        let [p, q] = [self.positions[a as usize], self.positions[b as usize]];
        let position = if self.complex.place(a) == Place::Fixed {
            p
        } else if self.complex.place(b) == Place::Fixed {
            q
        } else {
            let middle = 0.5 * (p + q);
            quadric
                .minimizer(middle)
                .unwrap_or_else(|| least(&quadric, [p, q, middle]))
        };
        Offer {
            position,
            cost: quadric.at(position),
            quadric,
        }
    }

    /// Whether a triangle that stays would turn too far with the ends of an edge at `position`.
    fn folds(&self, edge: u32, position: DVec3) -> bool {
        self.complex.stars().iter().flatten().any(|&corner| {
            let (t, k) = split(corner);
            let triangle = self.complex.triangle(t);
            if triangle.edges.contains(&edge) {
                return false;
            }
            let [p, q, r] = triangle.from(k, &self.positions);
            let before = (q - p).cross(r - p);
            let after = (q - position).cross(r - position);
            let cosine = before.dot(after);
            let lengths = before.length_squared() * after.length_squared();
            // A triangle without area has no side to turn from.
            before != DVec3::ZERO && (cosine <= 0.0 || cosine * cosine < TURN * TURN * lengths)
        })
    }
}

/// The point where a quadric is least.
fn least(quadric: &Quadric, points: [DVec3; 3]) -> DVec3 {
    let [first, others @ ..] = points;
    others.into_iter().fold(
        first,
        |a, b| if quadric.at(b) < quadric.at(a) { b } else { a },
    )
}

/// The planes of a vertex's triangles, of its rim, and its own place.
fn vertex_quadric(complex: &Complex, positions: &[DVec3], v: u32, evenness: f64) -> Quadric {
    let mut sum = Quadric::default();
    for corner in complex.star(v) {
        sum += corner_quadric(complex, positions, corner, evenness);
    }
    sum
}

fn corner_quadric(
    complex: &Complex,
    positions: &[DVec3],
    corner: Corner,
    evenness: f64,
) -> Quadric {
    let (t, k) = split(corner);
    let triangle = complex.triangle(t);
    let [p, q, r] = triangle.from(k, positions);
    let cross = (q - p).cross(r - p);
    let Some(normal) = cross.try_normalize() else {
        return Quadric::default();
    };
    let area = 0.5 * cross.length();
    let mut sum = Quadric::plane(normal, p, area) + Quadric::point(p, evenness * area);
    let [to_r, to_q] = complex.spokes(corner);
    for (edge, side) in [(to_q, q - p), (to_r, r - p)] {
        if complex.faces(edge) != 2 {
            let across = normal.cross(side).normalize_or_zero();
            sum += Quadric::plane(across, p, RIM * side.length_squared());
        }
    }
    sum
}
