//! From chains of crossed edges to ridge lines of one colour, and from sharp edges to lines of the same sort.

use super::crossings::place_in;
use super::edges::Edges;
use super::ridges::{Cut, Family, Ridges};
use super::trace::{Chain, Segment, chains};
use super::vertices::Vertices;
use super::{Kind, Line, LinePoint};
use crate::mesh::TriangleMesh;
use crate::mesh::sample::SurfacePoint;

/// How far along a line on either side the colour of a cut is judged, of the radius of a neighbourhood: about as far as errors go together.
const WINDOW: f64 = 0.5;
/// A line counts where b changes over the radius of a neighbourhood by more than so many times its error: some times what noise makes of it …
const SURE: f64 = 6.0;
/// … by more than this share of the squared curvature, as on cylinders and tori b is 0 everywhere up to the error of the fit (0.0015 on a torus; 0.06 on
/// the faintest ridge of the lobed ball) …
const DISTINCT: f64 = 0.01;
/// … and where the surface turns by this angle along it in all: no eye sees less.
const FAINT: f64 = 0.05;

/// Lines and where their colour changes along a ridge.
#[derive(Default)]
pub(super) struct Traced {
    pub lines: Vec<Line>,
    pub turnings: Vec<LinePoint>,
}

/// A point of a chain with all that its line needs.
struct Link {
    point: LinePoint,
    kind: Kind,
    /// b's change over the radius of a neighbourhood; its error; the squared curvature.
    change: [f64; 3],
}

impl Traced {
    /// Adds the ridges of a family. Lines that cannot be told from noise are left out.
    pub fn add(&mut self, mesh: &TriangleMesh, ridges: &Ridges, family: Family, edges: &Edges) {
        for chain in &ridges.chains {
            let mut links = links(mesh, ridges, chain, family, edges);
            if chain.is_closed() {
                links.pop();
                // So that no run goes over the seam.
                let turn = (1..links.len()).find(|&k| links[k].kind != links[k - 1].kind);
                links.rotate_left(turn.unwrap_or_default());
            }
            self.add_runs(mesh, &links, chain.is_closed());
        }
    }

    /// Adds the runs of one colour of a chain, which meet at turning points.
    fn add_runs(&mut self, mesh: &TriangleMesh, links: &[Link], is_closed: bool) {
        let runs: Vec<&[Link]> = links.chunk_by(|a, b| a.kind == b.kind).collect();
        let is_ring = is_closed && runs.len() == 1;
        // The turning point before each run, and at last the one after all.
        let turnings: Vec<Option<LinePoint>> = (0..=runs.len())
            .map(|r| {
                let inside = r > 0 && r < runs.len();
                (inside || is_closed && !is_ring).then(|| {
                    let before = runs[(r + runs.len() - 1) % runs.len()];
                    turning(mesh, &before[before.len() - 1], &runs[r % runs.len()][0])
                })
            })
            .collect();
        let mut was_kept = false;
        for (r, run) in runs.iter().enumerate() {
            let own = run.iter().map(|link| link.point);
            let mut points: Vec<LinePoint> = turnings[r]
                .into_iter()
                .chain(own)
                .chain(turnings[r + 1])
                .collect();
            if is_ring {
                points.push(points[0]);
            }
            let line = Line::new(run[0].kind, false, is_ring, points);
            let is_kept = is_sure(run) && line.strength > FAINT;
            if is_kept && was_kept {
                self.turnings.extend(turnings[r]);
            }
            if is_kept {
                self.lines.push(line);
            }
            was_kept = is_kept;
        }
    }

    /// Adds sharp edges: as ridges of the curvature that they round to.
    pub fn add_sharp(&mut self, mesh: &TriangleMesh, sharp: &SharpLines, vertices: &Vertices) {
        for (kind, segments, chains) in &sharp.lines {
            for chain in chains {
                let points = (0..chain.nodes.len()).map(|k| {
                    let v = chain.nodes[k];
                    let segment =
                        segments[chain.segments[k.min(chain.segments.len() - 1)] as usize];
                    let form = &vertices.forms[v as usize];
                    let corners = mesh.triangles[segment.face as usize];
                    let curvature = match kind {
                        Kind::Red => form.curvatures[0],
                        _ => form.curvatures[1],
                    };
                    LinePoint {
                        place: SurfacePoint {
                            triangle: segment.face,
                            barycentric: corners.map(|w| if w == v { 1.0 } else { 0.0 }),
                        },
                        position: mesh.positions[v as usize],
                        curvature,
                        is_crest: true,
                    }
                });
                let points = points.collect();
                self.lines
                    .push(Line::new(*kind, true, chain.is_closed(), points));
            }
        }
    }
}

/// Chains of sharp edges.
pub(super) struct SharpLines {
    /// Valleys (red) and crests (blue): the nodes of chains are vertices.
    lines: [(Kind, Vec<Segment>, Vec<Chain>); 2],
}

impl SharpLines {
    /// Chains of at least some length; shorter ones are noise. `angles`: `[edges]`, 0 where an edge is not sharp.
    pub fn of(mesh: &TriangleMesh, edges: &Edges, angles: &[f64], least: f64) -> Self {
        let lines = [(Kind::Red, -1.0), (Kind::Blue, 1.0)].map(|(kind, sign)| {
            let is_sharp = |e: &usize| angles[*e] * sign > 0.0;
            let segments: Vec<Segment> = (0..angles.len())
                .filter(is_sharp)
                .map(|e| Segment {
                    ends: edges.ends[e],
                    face: edges.faces[e][0],
                })
                .collect();
            let mut chains = chains(&segments, mesh.positions.len());
            let at = |v: u32| mesh.positions[v as usize];
            chains.retain(|chain| {
                let lengths = chain.nodes.windows(2).map(|w| at(w[0]).distance(at(w[1])));
                lengths.sum::<f64>() >= least
            });
            (kind, segments, chains)
        });
        Self { lines }
    }

    /// `[vertices]`: those on the chains.
    pub fn vertices(&self, count: usize) -> Vec<bool> {
        let mut is_on = vec![false; count];
        for chain in self.lines.iter().flat_map(|(_, _, chains)| chains) {
            for &v in &chain.nodes {
                is_on[v as usize] = true;
            }
        }
        is_on
    }
}

/// Every cut of a chain with its colour.
fn links(
    mesh: &TriangleMesh,
    ridges: &Ridges,
    chain: &Chain,
    family: Family,
    edges: &Edges,
) -> Vec<Link> {
    let cuts: Vec<&Cut> = chain
        .nodes
        .iter()
        .map(|&n| &ridges.cuts[n as usize])
        .collect();
    let count = cuts.len();
    let link = |k: usize| {
        let near = window(&cuts, k, chain.is_closed());
        let [change, way] = near.iter().fold([0.0; 2], |sum, &j| {
            [0, 1].map(|i| sum[i] + cuts[j].change[i])
        });
        let rate = if way > 0.0 { change / way } else { 0.0 };
        let [own, other] = cuts[k].curvatures;
        let kind = match (family, rate < 0.0) {
            (Family::Greater, true) => Kind::Red,
            (Family::Greater, false) => Kind::Green,
            (Family::Lesser, false) => Kind::Blue,
            (Family::Lesser, true) => Kind::Yellow,
        };
        let segment = chain.segments[k.min(chain.segments.len() - 1)];
        let face = ridges.segments[segment as usize].face;
        let [p, q] = edges.ends[cuts[k].edge as usize];
        let barycentric = mesh.triangles[face as usize].map(|v| match v {
            v if v == p => 1.0 - cuts[k].share,
            v if v == q => cuts[k].share,
            _ => 0.0,
        });
        Link {
            point: LinePoint {
                place: SurfacePoint {
                    triangle: face,
                    barycentric,
                },
                position: cuts[k].position,
                curvature: own,
                is_crest: kind.is_elliptic() && own.abs() > other.abs(),
            },
            kind,
            change: [rate.abs() * cuts[k].radius, cuts[k].third_error, own * own],
        }
    };
    (0..count).map(link).collect()
}

/// The places within the window around one of a chain, round its end where it is closed.
fn window(cuts: &[&Cut], k: usize, is_closed: bool) -> Vec<usize> {
    // The first of a closed chain comes last again.
    let period = if is_closed {
        cuts.len() - 1
    } else {
        cuts.len()
    };
    let reach = WINDOW * cuts[k].radius;
    let mut places = vec![k % period];
    for step in [1, period - 1] {
        let (mut at, mut way) = (k % period, 0.0);
        for _ in 0..period / 2 {
            let next = (at + step) % period;
            let wraps = at.abs_diff(next) != 1;
            way += cuts[at].position.distance(cuts[next].position);
            if way > reach || (wraps && !is_closed) {
                break;
            }
            places.push(next);
            at = next;
        }
    }
    places
}

/// Whether a run of links is more than noise.
fn is_sure(run: &[Link]) -> bool {
    let [change, error, squared] = run.iter().fold([0.0; 3], |sum, link| {
        [0, 1, 2].map(|i| sum[i] + link.change[i])
    });
    change > SURE * error && change > DISTINCT * squared
}

/// Half way between two links of different colours, which have a face in common: that of the first.
fn turning(mesh: &TriangleMesh, a: &Link, b: &Link) -> LinePoint {
    let position = 0.5 * (a.point.position + b.point.position);
    LinePoint {
        place: place_in(mesh, a.point.place.triangle, position),
        position,
        curvature: 0.5 * (a.point.curvature + b.point.curvature),
        is_crest: false,
    }
}
