//! Rims: the loops of the data's boundary, and the curves that the boundary of a limit surface is.
//!
//! A point of a rim has its footpoint on the loop of the surface that became of that rim, not on another that passes nearer: scans have holes side by
//! side. Which loop goes with which rim is found once, on the start, which is near the data; splits and flips keep the vertices of a loop on it.
//! Distances count both ways: points of the loop have their nearest points on the rim, too.

use super::Data;
use crate::error::Result;
use crate::geometry::Bvh;
use crate::mesh::Connectivity;
use crate::model::limit_surface::{Patches, SurfaceParameter};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Straight pieces to an edge of the boundary, for first guesses.
const PIECES: u32 = 8;

/// Points to an edge of the boundary whose distances from the rim count.
const SPREAD: u32 = 8;

/// Newton steps on a curve, and halvings of each, at most.
const STEPS: usize = 12;
const HALVINGS: usize = 4;

/// The rims of the data, and which of them each loop of a control mesh's boundary goes with.
pub(super) struct Rims {
    /// `[control points]`: the rim of the loop that it lies on.
    of_point: Vec<Option<u32>>,
    /// `[rims]`.
    polylines: Vec<Bvh>,
}

impl Rims {
    /// Each loop with the rim that is the nearest for most of its vertices and edges, and no rim with two loops.
    ///
    /// `mesh`: of the control mesh that a fit starts from; `positions`: its points.
    ///
    /// # Errors
    /// Where there are too many points for a tree.
    pub fn matched(data: &Data, mesh: &Connectivity, positions: &[DVec3]) -> Result<Self> {
        let polyline = |vertices: &Vec<DVec3>| Bvh::new(vertices, &segments(0, vertices.len()));
        let mut rims = Self {
            of_point: vec![None; mesh.vertex_count()],
            polylines: data.loops.iter().map(polyline).collect::<Result<_>>()?,
        };
        let loops = mesh.boundary_loops();
        if data.loops.is_empty() || loops.is_empty() {
            return Ok(rims);
        }
        let votes = Votes::new(&data.loops)?;
        let mut pairs = Vec::new();
        for (l, half_edges) in loops.iter().enumerate() {
            let points = half_edges.iter().flat_map(|&h| {
                let [a, b] = [mesh.origin(h), mesh.target(h)].map(|v| positions[v as usize]);
                [a, a.midpoint(b)]
            });
            pairs.extend(
                votes
                    .shares(points)
                    .into_iter()
                    .map(|(rim, share)| (share, l, rim)),
            );
        }
        pairs.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut of_loop = vec![None; loops.len()];
        let mut is_taken = vec![false; data.loops.len()];
        for (_, l, rim) in pairs {
            if of_loop[l].is_none() && !is_taken[rim as usize] {
                of_loop[l] = Some(rim);
                is_taken[rim as usize] = true;
            }
        }
        for (half_edges, rim) in loops.iter().zip(of_loop) {
            rims.label(mesh, half_edges, rim);
        }
        Ok(rims)
    }

    /// Goes over to the mesh after splits and flips, whose first vertices are those of the mesh before.
    pub fn carry_over(&mut self, mesh: &Connectivity) {
        let before = self.of_point.len();
        self.of_point.resize(mesh.vertex_count(), None);
        for half_edges in mesh.boundary_loops() {
            let mut origins = half_edges.iter().map(|&h| mesh.origin(h) as usize);
            let rim = origins.find(|&v| v < before).and_then(|v| self.of_point[v]);
            self.label(mesh, &half_edges, rim);
        }
    }

    fn label(&mut self, mesh: &Connectivity, half_edges: &[u32], rim: Option<u32>) {
        for &h in half_edges {
            self.of_point[mesh.origin(h) as usize] = rim;
        }
    }
}

/// Which rims are the nearest.
struct Votes {
    segments: Bvh,
    /// `[segments]`.
    rims: Vec<u32>,
}

impl Votes {
    fn new(loops: &[Vec<DVec3>]) -> Result<Self> {
        let (mut all, mut rims) = (Vec::new(), Vec::new());
        let mut first = 0;
        for (rim, vertices) in loops.iter().enumerate() {
            all.extend(segments(first, vertices.len()));
            rims.resize(all.len(), rim as u32);
            first += vertices.len();
        }
        Ok(Self {
            segments: Bvh::new(&loops.concat(), &all)?,
            rims,
        })
    }

    /// The share of points that each rim is the nearest for.
    fn shares(&self, points: impl Iterator<Item = DVec3>) -> BTreeMap<u32, f64> {
        let (mut votes, mut count) = (BTreeMap::new(), 0.0);
        for p in points {
            let segment = self.segments.closest(p).triangle;
            *votes.entry(self.rims[segment as usize]).or_default() += 1.0;
            count += 1.0;
        }
        votes.values_mut().for_each(|v: &mut f64| *v /= count);
        votes
    }
}

/// The segments of a closed polyline of `count` vertices from `first` on, as triangles without area.
fn segments(first: usize, count: usize) -> Vec<[u32; 3]> {
    let vertex = |k: usize| (first + k % count) as u32;
    (0..count)
        .map(|k| [vertex(k), vertex(k + 1), vertex(k + 1)])
        .collect()
}

/// A point of the boundary of a limit surface.
pub(super) struct CurvePoint {
    pub at: SurfaceParameter,
    pub position: DVec3,
    /// Unit length, or zero where the curve stands still.
    pub tangent: DVec3,
}

/// The curves that the boundary of a limit surface is.
pub(super) struct BoundaryCurves<'a> {
    patches: &'a Patches<'a>,
    curves: Vec<Curve>,
    rims: &'a Rims,
    /// The curve of each rim.
    of_rim: BTreeMap<u32, usize>,
}

struct Curve {
    /// The half-edges of the control mesh.
    edges: Vec<u32>,
    pieces: Bvh,
}

impl<'a> BoundaryCurves<'a> {
    /// `rims`: of the control mesh.
    ///
    /// # Errors
    /// Where there are too many edges for a tree.
    pub fn new(patches: &'a Patches<'a>, rims: &'a Rims) -> Result<Self> {
        let mesh = patches.surface().connectivity();
        let loops = mesh.boundary_loops();
        let rim = |edges: &[u32]| rims.of_point[mesh.origin(edges[0]) as usize];
        let numbered = loops.iter().enumerate();
        let of_rim = numbered.filter_map(|(k, edges)| Some((rim(edges)?, k)));
        Ok(Self {
            of_rim: of_rim.collect(),
            curves: (loops.into_iter())
                .map(|edges| Curve::new(patches, edges))
                .collect::<Result<_>>()?,
            patches,
            rims,
        })
    }

    /// The closest point of a rim's curve, or of all where the rim has none. `None` for a closed surface.
    pub fn closest(&self, p: DVec3, rim: Option<u32>) -> Option<CurvePoint> {
        let own = rim.and_then(|rim| self.of_rim.get(&rim));
        match own {
            Some(&k) => Some(self.curves[k].closest(p, self.patches)),
            None => (self.curves.iter().map(|c| c.closest(p, self.patches))).min_by(|a, b| {
                let distance = |c: &CurvePoint| c.position.distance_squared(p);
                distance(a).total_cmp(&distance(b))
            }),
        }
    }

    /// Points spread over the curves, each with the nearest point of its rim.
    ///
    /// Without them a curve is free to run out between two of the data's points and back.
    pub fn spread(&self) -> Vec<(CurvePoint, u32, DVec3)> {
        let half_edges = (self.of_rim.iter())
            .flat_map(|(&rim, &k)| self.curves[k].edges.iter().map(move |&h| (h, rim)));
        let places =
            half_edges.flat_map(|(h, rim)| (0..SPREAD).map(move |k| (h, rim, f64::from(k))));
        let places: Vec<(u32, u32, f64)> = places.collect();
        (places.into_par_iter())
            .map(|(h, rim, k)| {
                let here = jet(self.patches, h, k / f64::from(SPREAD));
                let nearest = self.rims.polylines[rim as usize].closest(here.position);
                (here.into(), rim, nearest.point)
            })
            .collect()
    }
}

impl Curve {
    fn new(patches: &Patches<'_>, edges: Vec<u32>) -> Result<Self> {
        let places = (edges.par_iter()).flat_map_iter(|&h| (0..=PIECES).map(move |k| (h, k)));
        let positions: Vec<DVec3> = places
            .map(|(h, k)| jet(patches, h, f64::from(k) / f64::from(PIECES)).position)
            .collect();
        let ends = 0..positions.len() as u32;
        let segments: Vec<[u32; 3]> = ends
            .filter(|end| end % (PIECES + 1) > 0)
            .map(|end| [end - 1, end, end])
            .collect();
        Ok(Self {
            edges,
            pieces: Bvh::new(&positions, &segments)?,
        })
    }

    /// From the nearest straight piece, by Newton's method on its edge.
    fn closest(&self, p: DVec3, patches: &Patches<'_>) -> CurvePoint {
        let found = self.pieces.closest(p);
        let h = self.edges[(found.triangle / PIECES) as usize];
        let within = 1.0 - found.barycentric[0];
        let mut s = (f64::from(found.triangle % PIECES) + within) / f64::from(PIECES);
        let mut here = jet(patches, h, s);
        for _ in 0..STEPS {
            let error = p - here.position;
            let flat = here.first.length_squared();
            let curved = flat - error.dot(here.second);
            let slope = error.dot(here.first);
            let mut step = slope / if curved > 0.1 * flat { curved } else { flat };
            let distance = error.length_squared();
            let next = (0..HALVINGS).find_map(|_| {
                let t = (s + step).clamp(0.0, 1.0);
                let there = jet(patches, h, t);
                step *= 0.5;
                let nearer = there.position.distance_squared(p) < distance;
                nearer.then_some((t, there))
            });
            match next {
                Some(next) => (s, here) = next,
                None => break,
            }
        }
        here.into()
    }
}

/// A point of a curve with its derivatives along the edge.
struct CurveJet {
    at: SurfaceParameter,
    position: DVec3,
    first: DVec3,
    second: DVec3,
}

impl From<CurveJet> for CurvePoint {
    fn from(jet: CurveJet) -> Self {
        Self {
            at: jet.at,
            position: jet.position,
            tangent: jet.first.normalize_or_zero(),
        }
    }
}

/// The limit surface at `s`, from 0 at the start to 1 at the end of half-edge `h`.
fn jet(patches: &Patches<'_>, h: u32, s: f64) -> CurveJet {
    const CORNERS: [DVec2; 4] = [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::ZERO];
    let mesh = patches.surface().connectivity();
    let face = mesh.face_of(h);
    let k = (h - mesh.half_edges(face as usize).start) as usize;
    let along = CORNERS[k + 1] - CORNERS[k];
    let p = CORNERS[k] + s * along;
    let at = SurfaceParameter {
        face,
        u: p.x,
        v: p.y,
    };
    let jet = patches.evaluate(at);
    CurveJet {
        at,
        position: jet.position,
        first: along.x * jet.du + along.y * jet.dv,
        second: along.x * along.x * jet.duu
            + 2.0 * along.x * along.y * jet.duv
            + along.y * along.y * jet.dvv,
    }
}
