//! Where a fit starts: a template coarse enough to find its way, and how often it is subdivided on the way.

use super::Target;
use crate::error::Result;
use crate::mesh::{ControlMesh, Scheme};
use crate::model;
use crate::progress::{Progress, Silent};
use crate::template::{self, Align, Axis, Genus};
use glam::DVec3;

/// A fit starts with at least this many control points, where the asked number allows: fewer do not show the target's shape, and
/// from many more it folds.
const COARSEST: usize = 90;

/// An automatic template of more points is made with a quarter of them and subdivided: the grid that it comes from shows no smaller faces.
const MOST_AUTOMATIC: usize = 2_500;

/// What a fit starts from, in the target's coordinates.
#[derive(Debug, Clone, PartialEq)]
pub enum Template {
    /// Quads on the target, with its handles.
    Automatic {
        /// Control points at the end of the fit, within 5 %.
        control_points: usize,
        /// What becomes of its small handles.
        genus: Genus,
    },
    /// The target's bounding box.
    BoundingBox {
        /// Control points at the end of the fit, as nearly as the grid allows.
        control_points: usize,
    },
    /// A torus around the target's hole.
    Torus {
        /// What it goes around.
        axis: Axis,
        /// Control points at the end of the fit, as nearly as the grid allows.
        control_points: usize,
    },
    /// The target with its holes bridged, simplified by the quadric error metric: triangles. It is fitted as it is, without subdivision.
    Simplified {
        /// Control points.
        control_points: usize,
    },
    /// A network on the target that follows its curvature ([`template::adaptive`]): triangles. It is fitted as it is, without subdivision.
    Adaptive {
        /// Control points.
        control_points: usize,
        /// The seed of its first point.
        seed: u64,
    },
    /// A network on the target's ridges and umbilics ([`template::ridges`]): triangles. It is fitted as it is, without subdivision.
    Ridges {
        /// Control points.
        control_points: usize,
        /// Whether edges are flipped along ridges of one colour.
        flips: bool,
    },
    /// A control mesh of the user's own. It is fitted as it is, without subdivision.
    Mesh {
        /// The mesh.
        control: ControlMesh,
        /// How it is brought onto the target.
        align: Align,
    },
}

/// Where a fit starts.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// The control mesh, in the target's unit frame.
    pub control: ControlMesh,
    /// How often it is subdivided during the fit.
    pub subdivisions: usize,
    /// How near the target it is.
    pub proximity: Proximity,
}

/// How near its target a template is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Proximity {
    /// Around it somewhere, like a bounding box.
    Far,
    /// Of about its shape.
    Near,
    /// On it, with folds that Voronoi cells are to open.
    Folded,
    /// On it without folds: with the polish, closest points serve from the start.
    Touching,
    /// The same, but much of it faces away from what is closest: of the closest points those serve that face alike.
    Opposed,
}

impl Start {
    /// The start for a template.
    ///
    /// Grids start with about a hundred points and have the asked number after the subdivisions. For [`Scheme::Loop`] polygons are cut
    /// into triangles.
    ///
    /// # Errors
    /// As [`template::automatic`], [`template::torus`], [`template::simplified`], [`template::adaptive`], [`template::ridges`] and [`template::placed`].
    pub fn new(target: &Target, template: &Template, scheme: Scheme) -> Result<Self> {
        Self::with_progress(target, template, scheme, &Silent)
    }

    /// Like [`new`](Self::new), telling how far it is; interrupted, a network has fewer points.
    ///
    /// # Errors
    /// As there.
    pub fn with_progress(
        target: &Target,
        template: &Template,
        scheme: Scheme,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let mut proximity = match template {
            Template::BoundingBox { .. } => Proximity::Far,
            _ => Proximity::Near,
        };
        let (mut control, subdivisions) = match template {
            Template::Automatic {
                control_points,
                genus,
            } => {
                let (count, subdivisions) = at_most(*control_points, MOST_AUTOMATIC);
                let automatic = template::automatic(&target.mesh, count, *genus, target.holes)?;
                proximity = match (automatic.sound, automatic.opposed) {
                    (true, false) => Proximity::Touching,
                    (true, true) => Proximity::Opposed,
                    (false, _) => Proximity::Folded,
                };
                (automatic.control, subdivisions)
            }
            Template::BoundingBox { control_points } => {
                // On a sphere V grows to 4 V − 6: by quads as by triangles, V − 2 is multiplied by four.
                let (count, subdivisions) = coarsest(*control_points, 2);
                let (lo, hi) = target.mesh.bounding_box().unwrap_or_default();
                (template::bounding_box(lo, hi, count), subdivisions)
            }
            Template::Torus {
                axis,
                control_points,
            } => {
                // On a torus V itself is.
                let (count, subdivisions) = coarsest(*control_points, 0);
                let axis = in_unit_frame(*axis, target);
                (template::torus(&target.mesh, axis, count)?, subdivisions)
            }
            Template::Simplified { control_points } => {
                (template::simplified(&target.mesh, *control_points)?, 0)
            }
            Template::Adaptive {
                control_points,
                seed,
            } => {
                let (device, mesh) = (&target.device, &target.mesh);
                let network = template::adaptive(device, mesh, *control_points, *seed, progress)?;
                (model::interpolating(&network, scheme)?, 0)
            }
            Template::Ridges {
                control_points,
                flips,
            } => {
                let (device, mesh) = (&target.device, &target.mesh);
                let network = template::ridges(device, mesh, *control_points, *flips, progress)?;
                (model::interpolating(&network, scheme)?, 0)
            }
            Template::Mesh { control, align } => {
                let mut control = control.clone();
                for p in &mut control.mesh.positions {
                    *p = target.frame.to_unit(*p);
                }
                (template::placed(&control, *align, &target.mesh)?, 0)
            }
        };
        if scheme == Scheme::Loop {
            control.mesh = control.mesh.triangulate().into();
        }
        Ok(Self {
            control,
            subdivisions,
            proximity,
        })
    }
}

/// The number of points to start with and of subdivisions to make it `wanted`, for a grid whose points beyond `fixed` are multiplied by
/// four.
fn coarsest(wanted: usize, fixed: usize) -> (usize, usize) {
    let at = |k: usize| {
        let share = wanted.saturating_sub(fixed) as f64 / 4f64.powi(k as i32);
        share.round() as usize + fixed
    };
    let subdivisions = (1..32).take_while(|&k| at(k) >= COARSEST).count();
    (at(subdivisions), subdivisions)
}

/// The number of points to start with, at most `most`, and of subdivisions that make it about `wanted`.
fn at_most(wanted: usize, most: usize) -> (usize, usize) {
    let at = |k: usize| wanted >> (2 * k);
    let subdivisions = (0..).find(|&k| at(k) <= most).unwrap_or(0);
    (at(subdivisions), subdivisions)
}

fn in_unit_frame(axis: Axis, target: &Target) -> Axis {
    match axis {
        Axis::Inertia => Axis::Inertia,
        Axis::Given { point, direction } => Axis::Given {
            point: target.frame.to_unit(point),
            direction: direction.try_normalize().unwrap_or(DVec3::ZERO),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Device;
    use crate::mesh::{PolygonMesh, shapes};

    fn end(target: &PolygonMesh, template: &Template, scheme: Scheme) -> usize {
        let target = Target::new(&Device::Cpu, &target.triangulate()).unwrap();
        let start = Start::new(&target, template, scheme).unwrap();
        let mut control = start.control;
        assert!(control.mesh.positions.len() < 4 * COARSEST + 40);
        for _ in 0..start.subdivisions {
            control = model::subdivide(&control, scheme).unwrap();
        }
        control.mesh.positions.len()
    }

    #[test]
    fn grids_end_with_the_asked_number() {
        let ball = shapes::sphere(3.0, 3).into();
        let ring = shapes::torus(3.0, 1.0, 40, 20);
        for scheme in [Scheme::CatmullClark, Scheme::Loop, Scheme::Polygon] {
            for control_points in [98, 386, 1538, 6146] {
                let template = Template::BoundingBox { control_points };
                assert_eq!(end(&ball, &template, scheme), control_points);
            }
            let template = Template::Torus {
                axis: Axis::Inertia,
                control_points: 512,
            };
            assert_eq!(end(&ring, &template, scheme), 512);
        }
        let template = Template::BoundingBox {
            control_points: 1500,
        };
        let reached = end(&ball, &template, Scheme::CatmullClark);
        assert!(reached.abs_diff(1500) < 75, "{reached}");
    }

    #[test]
    fn automatic_templates_end_with_about_the_asked_number() {
        let ring = shapes::torus(3.0, 1.0, 40, 20);
        for control_points in [100, 1500, 6000] {
            let genus = Genus::default();
            let template = Template::Automatic {
                control_points,
                genus,
            };
            let target = Target::new(&Device::Cpu, &ring.triangulate()).unwrap();
            let start = Start::new(&target, &template, Scheme::CatmullClark).unwrap();
            let reached = start.control.mesh.positions.len() << (2 * start.subdivisions);
            assert!(
                reached.abs_diff(control_points) * 20 <= control_points,
                "{reached}"
            );
        }
        assert_eq!(at_most(0, 10), (0, 0));
        assert_eq!(at_most(160, 10), (10, 2));
        assert_eq!(at_most(usize::MAX, 3), (3, 31));
    }

    #[test]
    fn few_points_are_not_subdivided_and_none_is_a_box() {
        assert_eq!(coarsest(50, 2), (50, 0));
        assert_eq!(coarsest(386, 2), (98, 1));
        assert_eq!(coarsest(1538, 2), (98, 2));
        assert_eq!(coarsest(512, 0), (128, 1));
        assert_eq!(coarsest(0, 2), (2, 0));
        let ball = shapes::sphere(1.0, 2).into();
        let none = Template::BoundingBox { control_points: 0 };
        assert_eq!(end(&ball, &none, Scheme::CatmullClark), 8);
    }

    #[test]
    fn a_given_axis_and_a_given_mesh_are_in_the_targets_coordinates() {
        let offset = DVec3::new(5e6, -4e6, 3e5);
        let mut ring = shapes::torus(3.0, 1.0, 40, 20);
        for p in &mut ring.positions {
            *p += offset;
        }
        let template = Template::Torus {
            axis: Axis::Given {
                point: offset,
                direction: 7.0 * DVec3::Z,
            },
            control_points: 512,
        };
        assert_eq!(end(&ring, &template, Scheme::CatmullClark), 512);
        let target = Target::new(&Device::Cpu, &ring.triangulate()).unwrap();
        let template = Template::Mesh {
            control: ring.into(),
            align: Align::None,
        };
        let start = Start::new(&target, &template, Scheme::CatmullClark).unwrap();
        assert_eq!(start.subdivisions, 0);
        for (a, b) in start
            .control
            .mesh
            .positions
            .iter()
            .zip(&target.mesh.positions)
        {
            assert!(a.distance(*b) < 1e-12);
        }
    }
}
