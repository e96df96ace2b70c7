//! Sites on features: crossings of ridges and umbilics, so that edges of the network run along what a designer would draw \[MKJK15\].

use super::fire::Fire;
use super::ground::{Ground, NETWORK, manifold};
use crate::device::Device;
use crate::error::Result;
use crate::features::{Features, Monge, Scale, Site};
use crate::mesh::{ControlMesh, TriangleMesh};
use crate::progress::{Event, Progress};
use crate::topology::flip_for_colors;
use glam::DVec3;
use std::collections::HashMap;

/// The share of the sites that are features; the others are the vertices farthest from all. Of features alone cells are so uneven that the bunny's mean error is
/// 0.28 %.
const FEATURES: f64 = 0.6;

/// Attempts to meet the number where mending adds sites of its own.
const ROUNDS: usize = 4;

/// The least cosine of half the angle between two neighbouring normals in the length between them: beyond are sharp edges, where no arc is between.
const LEAST_COSINE: f64 = 0.5;

/// A network of about `control_points` sites (never fewer than the target's topology needs) at vertices of the target: on the features that tell most, and between
/// them.
///
/// Cells are made by the lengths of arcs from the curvatures at their ends. With `flips`, edges are then laid along ridges of one colour: that follows features, and
/// in most cases makes the error larger. Interrupted, the network is one of the points chosen so far.
///
/// # Errors
/// Where the target has no area, or the device fails.
pub fn ridges(
    device: &Device,
    target: &TriangleMesh,
    control_points: usize,
    flips: bool,
    progress: &dyn Progress,
) -> Result<ControlMesh> {
    progress.event(Event::Stage {
        name: NETWORK,
        steps: control_points,
    });
    let mesh = manifold(target)?;
    let features = Features::find(device, &mesh, Scale::default())?;
    let sites = features
        .filtered(&mesh, (FEATURES * control_points as f64) as usize)
        .sites;
    let colors = colors(&mesh, &sites);
    let candidates: Vec<u32> = sites.iter().map(|site| vertex(&mesh, site)).collect();
    let mut bends: Vec<Bend> = features.forms.iter().map(Bend::of).collect();
    let ground = Ground::new(mesh, control_points, |a, b| {
        bends.push(bends[a as usize].mean(bends[b as usize]));
    })?;
    let at = |v: u32| (ground.positions[v as usize], bends[v as usize]);
    let mut fire = Fire::new(&ground.surface, |a, b| arc_length(at(a), at(b)));
    for _ in 0..ROUNDS {
        let missing = control_points.saturating_sub(fire.sites.len());
        fire = ground.grow(&fire, &candidates, 0.0, missing, control_points);
        progress.event(Event::Step {
            done: fire.sites.len(),
            value: None,
        });
        if progress.interrupted() {
            break;
        }
    }
    // Not mended yet only where the topology alone asks for more.
    ground.mend(&mut fire);
    let mut network = ground.network(&fire)?;
    if flips {
        let of_site = |v: &u32| colors.get(v).copied().unwrap_or(0);
        let colors: Vec<u8> = fire.sites.iter().map(of_site).collect();
        flip_for_colors(&mut network, &colors)?;
    }
    Ok(network)
}

/// The corner nearest to a site.
fn vertex(mesh: &TriangleMesh, site: &Site) -> u32 {
    let weights = site.place.barycentric;
    let nearest = (1..3).fold(
        0,
        |best, k| if weights[k] > weights[best] { k } else { best },
    );
    mesh.triangles[site.place.triangle as usize][nearest]
}

/// The colours of the ridges through vertices that are sites.
fn colors(mesh: &TriangleMesh, sites: &[Site]) -> HashMap<u32, u8> {
    let mut colors = HashMap::new();
    for site in sites {
        *colors.entry(vertex(mesh, site)).or_default() |= site.colors;
    }
    colors
}

/// How a surface bends at a vertex.
#[derive(Debug, Clone, Copy)]
struct Bend {
    normal: DVec3,
    curvatures: [f64; 2],
}

impl Bend {
    fn of(form: &Monge) -> Self {
        Self {
            normal: form.normal,
            curvatures: form.curvatures,
        }
    }

    fn mean(self, other: Self) -> Self {
        let [a, b] = [self.curvatures, other.curvatures];
        Self {
            normal: (self.normal + other.normal).normalize_or_zero(),
            curvatures: [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])],
        }
    }
}

/// The length of an arc on the surface between two points, by equation 7: the modified Hausdorff distance of the points moved along their
/// principal curvature vectors by l²/12 (the paper's l²/4 leaves out the third order), over the cosine of half the angle between the normals.
fn arc_length((p, a): (DVec3, Bend), (q, b): (DVec3, Bend)) -> f64 {
    let moved = p.distance_squared(q) / 12.0;
    let ends = |p: DVec3, bend: Bend| bend.curvatures.map(|k| p + moved * k * bend.normal);
    let (from, to) = (ends(p, a), ends(q, b));
    let farthest = |from: [DVec3; 2], to: [DVec3; 2]| {
        let nearest = |x: DVec3| x.distance(to[0]).min(x.distance(to[1]));
        nearest(from[0]).max(nearest(from[1]))
    };
    let cosine = (0.5 * (1.0 + a.normal.dot(b.normal))).max(0.0).sqrt();
    farthest(from, to).max(farthest(to, from)) / cosine.max(LEAST_COSINE)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two points of a circle of radius `r` in a cylinder, `angle` apart.
    fn on_cylinder(r: f64, angle: f64) -> [(DVec3, Bend); 2] {
        [0.0, angle].map(|t| {
            let normal = DVec3::new(t.cos(), t.sin(), 0.0);
            let bend = Bend {
                normal,
                curvatures: [0.0, -1.0 / r],
            };
            (r * normal, bend)
        })
    }

    #[test]
    fn chords_are_lengths_where_nothing_bends_and_coincident_points_are_at_0() {
        let flat = Bend {
            normal: DVec3::Z,
            curvatures: [0.0; 2],
        };
        assert_eq!(arc_length((DVec3::ZERO, flat), (3.0 * DVec3::X, flat)), 3.0);
        assert_eq!(arc_length((DVec3::X, flat), (DVec3::X, flat)), 0.0);
        let turned = Bend {
            normal: -DVec3::Z,
            ..flat
        };
        assert!(arc_length((DVec3::ZERO, flat), (DVec3::X, turned)).is_finite());
    }

    #[test]
    fn arcs_of_a_sphere_are_found_to_the_fifth_order() {
        // Where both curvatures are that of the arc, the Hausdorff distance has no choice.
        let error = |angle: f64| {
            let [p, q] = on_cylinder(2.0, angle).map(|(p, bend)| {
                let curvatures = [-0.5; 2];
                (p, Bend { curvatures, ..bend })
            });
            (arc_length(p, q) - 2.0 * angle).abs() / (2.0 * angle)
        };
        assert!(error(0.2) < 2e-5, "{}", error(0.2));
        assert!(error(0.1) < error(0.2) / 12.0);
        // The paper's coefficient has a relative error of angle²/6, some 7e-3 here, and the chord of angle²/24.
        assert!(error(0.2) < 0.01 * 0.04 / 24.0);
    }
}
