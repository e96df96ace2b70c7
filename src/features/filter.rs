//! As many features as a control mesh shall have points, chosen without thresholds to tune.
//!
//! The paper asks its users for a least strength and a least curvature, which differ from model to model by factors of a hundred, and keeps clusters. Here
//! features are ranked, and taken from the best on wherever none is within a distance δ; δ is bisected until their number is right. What is then
//! still wanted comes from the lines themselves, the strongest first, and at last from the vertices furthest from all others.

use super::{Features, UmbilicKind};
use crate::geometry::morton;
use crate::mesh::TriangleMesh;
use crate::mesh::sample::SurfacePoint;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// Features are this much of the even distance √(area / count) apart at least.
const CLOSEST: f64 = 0.5;
/// Points of lines keep this distance.
const ALONG: f64 = 0.8;
/// Bisections of δ.
const STEPS: usize = 24;
/// Vertices that a thread looks at for the furthest at a time.
const GRAIN: usize = 8192;

/// What a site is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// An umbilic, by its place in [`Features::umbilics`].
    Umbilic(u32),
    /// A crossing, by its place in [`Features::crossings`].
    Crossing(u32),
    /// A point of a line, by its place in [`Features::lines`].
    Line(u32),
    /// A vertex far from everything else.
    Vertex(u32),
}

/// A place for a control point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    /// Its face, and where it is there.
    pub place: SurfacePoint,
    /// Where that is.
    pub position: DVec3,
    /// What it is.
    pub origin: Origin,
    /// The codes of the ridges through it ([`Kind::code`](super::Kind::code)), added.
    pub colors: u8,
}

/// The features that were chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct Filtered {
    /// The most telling first.
    pub sites: Vec<Site>,
    /// The least strength of a crossing among them.
    pub strength: Option<f64>,
    /// The least curvature of an umbilic among them, in size.
    pub curvature: Option<f64>,
}

impl Features {
    /// Chooses `count` sites; fewer only where the mesh has fewer vertices.
    pub fn filtered(&self, mesh: &TriangleMesh, count: usize) -> Filtered {
        let even = (mesh.area() / count.max(1) as f64).sqrt();
        let candidates = self.candidates();
        let least = CLOSEST * even;
        let mut sites = spaced(&candidates, least, Vec::new(), usize::MAX);
        if sites.len() > count {
            // From too many to too few; the last that is still enough counts.
            let (mut low, mut high) = (least, 8.0 * even);
            for _ in 0..STEPS {
                let middle = 0.5 * (low + high);
                let chosen = spaced(&candidates, middle, Vec::new(), usize::MAX);
                if chosen.len() >= count {
                    (low, sites) = (middle, chosen);
                } else {
                    high = middle;
                }
            }
            sites.truncate(count);
        }
        let sites = spaced(&self.line_points(), ALONG * even, sites, count);
        let sites = furthest(mesh, sites, count);
        let strength = sites.iter().filter_map(|site| match site.origin {
            Origin::Crossing(c) => Some(self.crossings[c as usize].strength),
            _ => None,
        });
        let curvature = sites.iter().filter_map(|site| match site.origin {
            Origin::Umbilic(u) => Some(self.umbilics[u as usize].curvature.abs()),
            _ => None,
        });
        Filtered {
            strength: strength.min_by(f64::total_cmp),
            curvature: curvature.min_by(f64::total_cmp),
            sites,
        }
    }

    /// Crossings and umbilics by their rank among their like.
    fn candidates(&self) -> Vec<Site> {
        let rank = |k: usize, all: usize| k as f64 / all as f64;
        let crossings = self.crossings.iter().enumerate().map(|(k, crossing)| {
            let colors = crossing.lines.map(|l| self.lines[l as usize].kind.code());
            let site = Site {
                place: crossing.place,
                position: crossing.position,
                origin: Origin::Crossing(k as u32),
                colors: colors[0] | colors[1],
            };
            (rank(k, self.crossings.len()), site)
        });
        let sure: Vec<usize> = (0..self.umbilics.len())
            .filter(|&u| self.umbilics[u].is_sure)
            .collect();
        let umbilics = sure.iter().enumerate().map(|(k, &u)| {
            let umbilic = &self.umbilics[u];
            let site = Site {
                place: umbilic.place,
                position: umbilic.position,
                origin: Origin::Umbilic(u as u32),
                colors: self.colors_near(umbilic.position, umbilic.kind),
            };
            (rank(k, sure.len()), site)
        });
        let mut all: Vec<_> = crossings.chain(umbilics).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all.into_iter().map(|(_, site)| site).collect()
    }

    /// The colours of lines that end near an umbilic, as many as there can be.
    fn colors_near(&self, p: DVec3, kind: UmbilicKind) -> u8 {
        let ends = self
            .lines
            .iter()
            .filter(|line| !line.is_closed)
            .flat_map(|line| {
                let ends = [line.points[0], line.points[line.points.len() - 1]];
                ends.map(|end| (end.position.distance(p), line.kind.code()))
            });
        let mut near: Vec<_> = ends.filter(|end| end.0 < self.radius).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let most = match kind {
            UmbilicKind::Elliptic => 6,
            UmbilicKind::Hyperbolic => 2,
        };
        near.iter().take(most).fold(0, |colors, end| colors | end.1)
    }

    /// The points of all elliptic lines, the strongest line first.
    fn line_points(&self) -> Vec<Site> {
        let elliptic = self
            .lines
            .iter()
            .enumerate()
            .filter(|(_, line)| line.kind.is_elliptic());
        let sites = elliptic.flat_map(|(l, line)| {
            line.points.iter().map(move |point| Site {
                place: point.place,
                position: point.position,
                origin: Origin::Line(l as u32),
                colors: line.kind.code(),
            })
        });
        sites.collect()
    }
}

/// Adds candidates to sites, as far as they go, where none is within a distance.
fn spaced(candidates: &[Site], distance: f64, mut sites: Vec<Site>, most: usize) -> Vec<Site> {
    let cell = |p: DVec3| (p / distance).floor().to_array().map(|x| x as i64);
    let mut grid: HashMap<[i64; 3], Vec<DVec3>> = HashMap::new();
    for site in &sites {
        grid.entry(cell(site.position))
            .or_default()
            .push(site.position);
    }
    for site in candidates {
        if sites.len() >= most {
            break;
        }
        let [x, y, z] = cell(site.position);
        let around = (0..27).map(|k| [x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1]);
        let near = |p: &DVec3| p.distance_squared(site.position) < distance * distance;
        let taken = around.filter_map(|c| grid.get(&c)).flatten().any(near);
        if !taken {
            grid.entry([x, y, z]).or_default().push(site.position);
            sites.push(*site);
        }
    }
    sites
}

/// Adds the vertex furthest from all sites until there are enough.
fn furthest(mesh: &TriangleMesh, mut sites: Vec<Site>, count: usize) -> Vec<Site> {
    let mut corner_of = vec![None; mesh.positions.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for (k, &v) in triangle.iter().enumerate() {
            corner_of[v as usize].get_or_insert((t as u32, k));
        }
    }
    let used: Vec<u32> = (0..corner_of.len() as u32)
        .filter(|&v| corner_of[v as usize].is_some())
        .collect();
    let points: Vec<DVec3> = used.iter().map(|&v| mesh.positions[v as usize]).collect();
    let order = morton::order(&points);
    let mut distances: Vec<f64> = vec![f64::INFINITY; used.len()];
    for site in &sites {
        shorten(&mut distances, &points, site.position);
    }
    let mut best = order.first().map(|&k| (f64::INFINITY, k as usize));
    if !sites.is_empty() {
        best = longest(&distances);
    }
    while let Some((distance, k)) = best {
        if sites.len() >= count || distance <= 0.0 {
            break;
        }
        let v = used[k];
        let Some((triangle, corner)) = corner_of[v as usize] else {
            break;
        };
        let mut barycentric = [0.0; 3];
        barycentric[corner] = 1.0;
        sites.push(Site {
            place: SurfacePoint {
                triangle,
                barycentric,
            },
            position: points[k],
            origin: Origin::Vertex(v),
            colors: 0,
        });
        shorten(&mut distances, &points, points[k]);
        best = longest(&distances);
    }
    sites
}

/// Takes a site into the squared distances of points.
fn shorten(distances: &mut [f64], points: &[DVec3], site: DVec3) {
    distances
        .par_iter_mut()
        .zip(points)
        .with_min_len(GRAIN)
        .for_each(|(distance, p)| *distance = distance.min(p.distance_squared(site)));
}

/// The greatest squared distance, and the first point that has it.
fn longest(distances: &[f64]) -> Option<(f64, usize)> {
    let part = |(k, part): (usize, &[f64])| {
        let mut best = (part[0], k * GRAIN);
        for (j, &distance) in part.iter().enumerate() {
            if distance > best.0 {
                best = (distance, k * GRAIN + j);
            }
        }
        best
    };
    let parts: Vec<_> = distances.par_chunks(GRAIN).enumerate().map(part).collect();
    parts
        .into_iter()
        .reduce(|a, b| if b.0 > a.0 { b } else { a })
}
