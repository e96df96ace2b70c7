//! The gradient of F_S→T through the Jacobians of the cut vertices, as [NYL12] appendix 2 derives it, against the boundary
//! integral of the kernel: two derivations and two clips give one gradient.

mod common;

use common::Noise;
use glam::{DMat3, DVec3};
use vorofit::geometry::triangle_tree::TriangleTree;
use vorofit::kernel::candidates::Candidates;
use vorofit::kernel::differentiated_voronoi;
use vorofit::kernel::restricted_voronoi::Metric;

/// Of the largest gradient. Measured: 8e-15.
const TOLERANCE: f64 = 1e-12;

/// What an edge of a cell lies on.
#[derive(Clone, Copy)]
enum Side {
    /// The triangle's edge from this corner to the next.
    Edge(usize),
    /// The bisector with this seed.
    Bisector(usize),
}

/// What a vertex of a cell is the intersection of: the three configurations of figure 22.
#[derive(Clone, Copy)]
enum Configuration {
    /// (c) It is a corner of the triangle.
    Corner(usize),
    /// (a) A bisector and an edge.
    OnEdge { edge: usize, other: usize },
    /// (b) Two bisectors and the facet.
    InFacet { others: [usize; 2] },
}

#[derive(Clone, Copy)]
struct Vertex {
    position: DVec3,
    made_of: Configuration,
    /// What the edge to the next vertex lies on.
    leaving: Side,
}

/// The cell of one seed on one triangle.
struct Cell<'a> {
    x: &'a [DVec3; 3],
    seeds: &'a [DVec3],
    own: usize,
}

impl Cell<'_> {
    /// The polygon, cut by the bisector with every other seed.
    fn polygon(&self) -> Vec<Vertex> {
        let mut polygon: Vec<Vertex> = (0..3)
            .map(|k| Vertex {
                position: self.x[k],
                made_of: Configuration::Corner(k),
                leaving: Side::Edge(k),
            })
            .collect();
        for other in (0..self.seeds.len()).filter(|&l| l != self.own) {
            let inside = |v: &Vertex| {
                v.position.distance_squared(self.seeds[self.own])
                    <= v.position.distance_squared(self.seeds[other])
            };
            let mut kept = Vec::new();
            for (k, a) in polygon.iter().enumerate() {
                let b = &polygon[(k + 1) % polygon.len()];
                if inside(a) {
                    kept.push(*a);
                }
                if inside(a) != inside(b) {
                    let made_of = match a.leaving {
                        Side::Edge(edge) => Configuration::OnEdge { edge, other },
                        Side::Bisector(before) => Configuration::InFacet {
                            others: [before, other],
                        },
                    };
                    kept.push(Vertex {
                        position: self.position(made_of),
                        made_of,
                        leaving: if inside(a) {
                            Side::Bisector(other)
                        } else {
                            a.leaving
                        },
                    });
                }
            }
            polygon = kept;
        }
        polygon
    }

    /// Normal and offset of the bisector with a seed: n·c = h on it.
    fn bisector(&self, other: usize) -> (DVec3, f64) {
        let [y1, y2] = [self.seeds[self.own], self.seeds[other]];
        (y2 - y1, 0.5 * (y2 - y1).dot(y1 + y2))
    }

    fn position(&self, made_of: Configuration) -> DVec3 {
        match made_of {
            Configuration::Corner(k) => self.x[k],
            Configuration::OnEdge { edge, other } => {
                let (n, h) = self.bisector(other);
                let [x1, x2] = [self.x[edge], self.x[(edge + 1) % 3]];
                x1 + (h - n.dot(x1)) / n.dot(x2 - x1) * (x2 - x1)
            }
            Configuration::InFacet { others } => {
                let [(n1, h1), (n2, h2)] = others.map(|l| self.bisector(l));
                let [x1, x2, x3] = *self.x;
                let planes = DMat3::from_cols((x2 - x1).cross(x3 - x1), n1, n2).transpose();
                x1 + planes.inverse() * DVec3::new(0.0, h1 - n1.dot(x1), h2 - n2.dot(x1))
            }
        }
    }

    /// Adds (∂c/∂x_k)ᵀ `by_c` to the gradient on each corner: equations 13 and 14.
    fn pull_back(&self, vertex: &Vertex, by_c: DVec3, gradient: &mut [DVec3; 3]) {
        match vertex.made_of {
            Configuration::Corner(k) => gradient[k] += by_c,
            Configuration::OnEdge { edge, other } => {
                let (n, h) = self.bisector(other);
                let [first, second] = [edge, (edge + 1) % 3];
                let [x1, x2] = [self.x[first], self.x[second]];
                let e = x2 - x1;
                let k = n.dot(e);
                let u = (h - n.dot(x1)) / k;
                let w1 = (h - n.dot(x2)) / (k * k) * n;
                let w2 = -(h - n.dot(x1)) / (k * k) * n;
                gradient[first] += w1 * e.dot(by_c) + (1.0 - u) * by_c;
                gradient[second] += w2 * e.dot(by_c) + u * by_c;
            }
            Configuration::InFacet { others } => {
                let [y1, y2, y3] = [self.own, others[0], others[1]].map(|j| self.seeds[j]);
                let [x1, x2, x3] = *self.x;
                let e = (y1 - y2).cross(y1 - y3);
                let n = (x1 - x2).cross(x1 - x3);
                let k = n.dot(e);
                let from_c = x1 - vertex.position;
                let w = [
                    ((x2 - x3).cross(from_c) + n) / k,
                    (x3 - x1).cross(from_c) / k,
                    (x1 - x2).cross(from_c) / k,
                ];
                for (g, w) in gradient.iter_mut().zip(w) {
                    *g += w * e.dot(by_c);
                }
            }
        }
    }
}

/// The energy of a triangle of a cell, |T| / 6 Σ_{k ≤ l} U_k·U_l with U_k = A (c_k − y), and its gradient on the c_k.
fn integral(
    c: [DVec3; 3],
    facing: DVec3,
    weighted: impl Fn(usize) -> DVec3,
    y: DVec3,
) -> (f64, [DVec3; 3]) {
    let area = 0.5 * facing.dot((c[1] - c[0]).cross(c[2] - c[0]));
    let w = [0, 1, 2].map(&weighted);
    let sum = w[0] + w[1] + w[2];
    // Σ_{k ≤ l} U_k·U_l = ½ (|Σ U|² + Σ |U|²)
    let density = (0..3).map(|k| (c[k] - y).dot(sum + w[k])).sum::<f64>() / 12.0;
    let gradient = [0, 1, 2].map(|k| {
        let by_area = 0.5 * facing.cross(c[(k + 2) % 3] - c[(k + 1) % 3]);
        area / 6.0 * (sum + w[k]) + density * by_area
    });
    (area * density, gradient)
}

struct Chain {
    energy: f64,
    gradient: Vec<[DVec3; 3]>,
    /// How many vertices there were of each configuration.
    seen: [usize; 3],
}

fn chain(triangles: &[[DVec3; 3]], seeds: &[DVec3], normals: &[DVec3], metric: Metric) -> Chain {
    let mut chain = Chain {
        energy: 0.0,
        gradient: vec![[DVec3::ZERO; 3]; triangles.len()],
        seen: [0; 3],
    };
    for (x, gradient) in triangles.iter().zip(&mut chain.gradient) {
        let facing = (x[1] - x[0]).cross(x[2] - x[0]).normalize();
        for own in 0..seeds.len() {
            let cell = Cell { x, seeds, own };
            let (y, n) = (seeds[own], normals[own]);
            let polygon = cell.polygon();
            for v in &polygon {
                let kind = match v.made_of {
                    Configuration::Corner(_) => 0,
                    Configuration::OnEdge { .. } => 1,
                    Configuration::InFacet { .. } => 2,
                };
                chain.seen[kind] += 1;
            }
            for k in 2..polygon.len() {
                let part = [&polygon[0], &polygon[k - 1], &polygon[k]];
                let c = part.map(|v| v.position);
                let weighted = |k: usize| {
                    let d = c[k] - y;
                    metric.tangential * d + (metric.normal - metric.tangential) * n.dot(d) * n
                };
                let (energy, by_c) = integral(c, facing, weighted, y);
                chain.energy += energy;
                for (v, by_c) in part.into_iter().zip(by_c) {
                    cell.pull_back(v, by_c, gradient);
                }
            }
        }
    }
    chain
}

/// Holds the two against each other, for several metrics.
fn agree(name: &str, triangles: &[[DVec3; 3]], seeds: &[DVec3], normals: &[DVec3]) {
    let candidates = Candidates::find(&TriangleTree::new(triangles), triangles, seeds, 0.0);
    for s in [0.5, 1.0, 5.0, 50.0] {
        let metric = Metric::anisotropic(s);
        let kernel = differentiated_voronoi::cpu(triangles, seeds, normals, &candidates, metric);
        let chain = chain(triangles, seeds, normals, metric);
        let pairs = || {
            kernel
                .gradient
                .iter()
                .flatten()
                .zip(chain.gradient.iter().flatten())
        };
        let largest = pairs().map(|(a, _)| a.length()).fold(0.0, f64::max);
        let apart = pairs().map(|(a, b)| a.distance(*b)).fold(0.0, f64::max) / largest;
        println!("{name}, s = {s}: {apart:.1e}, vertices {:?}", chain.seen);
        assert!(
            (chain.energy / kernel.energy - 1.0).abs() < 1e-12,
            "{name}, s = {s}"
        );
        assert!(apart < TOLERANCE, "{name}, s = {s}: {apart}");
        assert!(
            chain.seen.iter().all(|&n| n > 10),
            "a configuration is not there"
        );
    }
}

fn unit_vectors(noise: &mut Noise, count: usize) -> Vec<DVec3> {
    (0..count).map(|_| noise.vector().normalize()).collect()
}

#[test]
fn both_agree_on_random_triangles_and_seeds() {
    let noise = &mut Noise(5);
    let seeds: Vec<DVec3> = (0..40).map(|_| noise.vector()).collect();
    let normals = unit_vectors(noise, 40);
    let triangles: Vec<_> = (0..50).map(|_| [0; 3].map(|_| noise.vector())).collect();
    agree("random", &triangles, &seeds, &normals);
}

#[test]
fn both_agree_on_slivers() {
    let noise = &mut Noise(6);
    let seeds: Vec<DVec3> = (0..100).map(|_| noise.vector()).collect();
    let normals = unit_vectors(noise, 100);
    let triangles: Vec<_> = (0..200)
        .map(|_| {
            let [a, b] = [noise.vector(), noise.vector()];
            [a, b, a.lerp(b, 0.4) + 1e-2 * noise.vector()]
        })
        .collect();
    agree("slivers", &triangles, &seeds, &normals);
}

#[test]
fn both_agree_on_lattices() {
    let noise = &mut Noise(7);
    let across = DVec3::new(0.5, 0.5 * 3f64.sqrt(), 0.0);
    let at = |i: i32, j: i32| f64::from(i) * DVec3::X + f64::from(j) * across;
    let triangles: Vec<_> = (0..25)
        .map(|k| (k % 5, k / 5))
        .flat_map(|(i, j)| {
            let [b, c] = [at(i + 1, j), at(i, j + 1)];
            [[at(i, j), b, c], [b, at(i + 1, j + 1), c]]
        })
        .collect();
    // Bisectors parallel to edges, but on none: there the gradient is one-sided.
    let shift = DVec3::new(0.137, -0.291, 0.25);
    let hexagonal: Vec<DVec3> = (0..36).map(|k| at(k % 6, k / 6) + shift).collect();
    let normals = unit_vectors(noise, 36);
    agree("hexagonal", &triangles, &hexagonal, &normals);
    // Four seeds are cocircular about every Voronoi vertex.
    let square: Vec<DVec3> = (0..36)
        .map(|k| DVec3::new(f64::from(k % 6), f64::from(k / 6), 0.0) + shift)
        .collect();
    agree("square", &triangles, &square, &normals);
}
