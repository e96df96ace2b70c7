//! The automatic template: quads around any target, with its handles.
//!
//! **Pipeline.** Coarse voxels would do for the shape but not for the topology: the genus of a voxel surface is not monotone in its resolution (a plate with five holes had
//! them at 1,012 to 1,494 points, and not at 2,072 to 3,932). So a fine surface comes first ([`skin`]), is simplified under the link condition, which keeps its
//! topology ([`crate::topology::simplify`]), has its triangles paired into quads ([`quads`], [`matching`]), is divided once, which leaves most vertices with four edges, and
//! is relaxed on the target. Where the target's rims are to be followed, the fine surface is first cut open along them ([`opening`]). A [`gate`] judges the result; what it rejects is tried again in another way ([`ATTEMPTS`]).
//!
//! Grids join what touches or crosses itself: a target that is one closed manifold of another topology than its skin is simplified in the skin's place.
//!
//! **Handles** that are small around are noise in most scans: simplification shrinks them to loops of three edges, which are cut
//! ([`crate::topology::cut_handles`]). Which are small is a share of the diagonal ([`SMALL_HANDLE`]); [`Genus::Keep`] cuts none.

mod gate;
mod matching;
mod opening;
mod quads;
mod skin;

use super::without_unused_vertices;
use crate::error::Result;
use crate::mesh::{Connectivity, ControlMesh, PolygonMesh, Scheme, TriangleMesh};
use crate::topology::Holes;
use crate::{model, topology};
use gate::{Judgement, edge_lengths};
use skin::{NEAR, Skin, Subject};

/// A handle or tunnel that is at most this far around, in diagonals of the target, is cut: four and a half cells of the grid that sees it.
const SMALL_HANDLE: f64 = 4.5 / 128.0;

/// Vertices of a surface that small handles were cut from, where no number is asked for.
const BODY: usize = 1500;

/// Vertices of the target this far from what is wrapped, in diagonals, are those of crumbs and spikes that are left out.
const LEFT_OUT: f64 = 0.03;

/// The fewest vertices to which a surface is simplified: a tetrahedron's.
const FEWEST: usize = 4;

/// What becomes of small handles and tunnels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Genus {
    /// All that the grid sees stay.
    Keep,
    /// Those less than 3.5 % of the target's diagonal around are closed.
    #[default]
    Simplify,
}

/// An automatic template.
#[derive(Debug, Clone, PartialEq)]
pub struct Automatic {
    /// Quads, a manifold on the target: closed, or open where its rims are followed. Only then a triangle may be among them.
    pub control: ControlMesh,
    /// Whether a fit should start with closest points: it has the right topology and hardly a fold, or Voronoi cells would do harm, as between scans and at rims.
    pub sound: bool,
    /// Whether much of it faces away from what of the target is closest, as on thin walls and behind gaps: of the closest points those should lead that face alike.
    pub opposed: bool,
}

/// A way from the skin to quads.
#[derive(Debug, Clone, Copy)]
struct Attempt {
    /// The weight of even sizes against flatness in simplification. With less the teeth of a gear fold, with more thin parts are seen late.
    evenness: f64,
    /// Whether a quarter of the points is made and each quad divided into four. That leaves 13 % of the vertices irregular, in place of half.
    divided: bool,
    /// Whether the vertices go onto the target in each step of relaxation, or only at its end.
    guided: bool,
}

const ATTEMPTS: [Attempt; 4] = [
    Attempt {
        evenness: 1e-3,
        divided: true,
        guided: true,
    },
    Attempt {
        evenness: 1e-3,
        divided: false,
        guided: true,
    },
    Attempt {
        evenness: 1e-2,
        divided: true,
        guided: true,
    },
    Attempt {
        evenness: 1e-2,
        divided: false,
        guided: false,
    },
];

/// Steps of relaxation.
const RELAXATION: usize = 3;

/// Quads of about `control_points` points around a target, with its Euler characteristic.
///
/// The target may have holes, overlaps, several components (crumbs beside the largest are left out) and bad triangles, but should face outwards ([`topology::oriented`]).
/// With [`Holes::Follow`] it is open where the target is.
/// Where no attempt passes the gate the best is returned, with a warning in the log. A few seconds at 10⁵ triangles, most of it winding numbers.
///
/// # Errors
/// Where the target has no triangles, or encloses nothing, as a soup does.
pub fn automatic(
    target: &TriangleMesh,
    control_points: usize,
    genus: Genus,
    holes: Holes,
) -> Result<Automatic> {
    let subject = Subject::new(target, holes)?;
    let mut skin = subject.skin(0.0)?;
    if let Some(rim) = &subject.rim {
        skin = opening::opened(skin, &subject, rim)?;
    }
    let skin = simplified(skin, &subject, control_points, genus)?;
    if let Some((count, farthest)) = subject.left_out(&skin, LEFT_OUT)? {
        log::warn!(
            "the template leaves out {count} of the target's {} vertices, in crumbs or spikes up to {:.1} % of the diagonal away from it",
            target.positions.len(),
            100.0 * farthest
        );
    }
    let mut best: Option<(Judgement, PolygonMesh)> = None;
    for (k, attempt) in (1..).zip(ATTEMPTS) {
        let judged = attempt
            .quads(&skin, &subject, control_points)
            .and_then(|quads| {
                let judgement = Judgement::of(&quads, &subject, control_points, skin.euler)?;
                Ok((judgement, quads))
            });
        let (judgement, quads) = match judged {
            Ok(judged) => judged,
            Err(error) => {
                log::info!("automatic template: attempt {k} rejected: {error}");
                continue;
            }
        };
        let Some(objection) = judgement.objection() else {
            log::info!(
                "automatic template: attempt {k} taken: {} points, Euler characteristic {}, {:.2} % folded, {:.0} % irregular",
                quads.positions.len(),
                skin.euler,
                100.0 * judgement.folds(),
                100.0 * judgement.irregular
            );
            return Ok(Automatic {
                control: quads.into(),
                sound: true,
                opposed: judgement.thin,
            });
        };
        log::info!("automatic template: attempt {k} rejected: {objection}");
        if best
            .as_ref()
            .is_none_or(|(b, _)| judgement.rank() < b.rank())
        {
            best = Some((judgement, quads));
        }
    }
    let Some((judgement, quads)) = best else {
        return Err(crate::Error::input(
            "no quads could be made around the target",
            "give --template bbox or a mesh",
        ));
    };
    match judgement.is_two_sided() {
        true => {
            log::warn!("the target is open: it is wrapped on both sides (--open follows its rims)")
        }
        false => log::warn!(
            "no automatic template passed all checks; of the one that is used, {}",
            judgement.objection().unwrap_or_default()
        ),
    }
    Ok(Automatic {
        control: quads.into(),
        opposed: judgement.thin || !judgement.is_sound(),
        // Where scans overlap some face away behind others, and Voronoi cells collapse over the gaps between them; of rims they know nothing.
        sound: judgement.is_sound()
            || subject.rim.is_some()
            || subject.layers > 1.0 && !judgement.is_two_sided(),
    })
}

/// A fine closed manifold of triangles around what a target encloses, near it but for what is smaller than its grid of 128 or 192 cells to the diagonal, or of cells
/// of the size `least`: the surface that [`automatic`] simplifies.
///
/// # Errors
/// As [`automatic`].
pub fn skin(target: &TriangleMesh, least: f64) -> Result<TriangleMesh> {
    Ok(Subject::new(target, Holes::Bridge)?.skin(least)?.mesh)
}

/// Such a surface without the handles that [`Genus::Simplify`] closes, coarser where there were some.
///
/// # Errors
/// As [`automatic`].
pub(super) fn body(target: &TriangleMesh) -> Result<TriangleMesh> {
    let skin = Subject::new(target, Holes::Bridge)?.skin(0.0)?;
    Ok(without_small_handles(skin, BODY)?.mesh)
}

/// The skin with its small handles closed.
fn without_small_handles(skin: Skin, points: usize) -> Result<Skin> {
    let coarse = topology::simplify(&skin.mesh, vertices(points)).mesh;
    let Some((lo, hi)) = skin.mesh.bounding_box() else {
        return Ok(skin);
    };
    let (cut, handles) = topology::cut_handles(&coarse, SMALL_HANDLE * (hi - lo).length())?;
    if handles == 0 {
        return Ok(skin);
    }
    log::info!("automatic template: {handles} small handles closed");
    Ok(Skin {
        mesh: cut,
        euler: skin.euler + 2 * handles as i64,
        ..skin
    })
}

/// The skin without its small handles, if they are to go; or the target in its place, where that is a manifold of another topology.
fn simplified(skin: Skin, subject: &Subject, points: usize, genus: Genus) -> Result<Skin> {
    if genus == Genus::Keep {
        return Ok(skin);
    }
    let skin = without_small_handles(skin, points)?;
    let Some(itself) = subject.itself(&skin) else {
        return Ok(skin);
    };
    let itself = without_small_handles(itself, points)?;
    if itself.euler == skin.euler {
        return Ok(skin);
    }
    log::info!(
        "automatic template: the grid shows an Euler characteristic of {}, the target has {}, so its own triangles are taken",
        skin.euler,
        itself.euler
    );
    Ok(itself)
}

fn vertices(points: usize) -> topology::Target {
    topology::Target::Vertices(points.max(FEWEST))
}

impl Attempt {
    /// Quads of about so many points on the target.
    fn quads(&self, skin: &Skin, subject: &Subject, points: usize) -> Result<PolygonMesh> {
        let mut quads = self.connect(skin, points)?;
        // Merged doublets are missing, and on a border half of each face: ask for as many more.
        let missing = points.saturating_sub(quads.positions.len());
        if missing > 0 {
            let again = self.connect(skin, points + missing)?;
            if again.positions.len().abs_diff(points) < missing {
                quads = again;
            }
        }
        let connectivity = Connectivity::of(&quads)?;
        // The middle of a coarse quad sinks deeper than the skin lies; over an open rim nothing is near.
        let lengths = edge_lengths(&quads, &connectivity);
        let edge = lengths.iter().sum::<f64>() / lengths.len().max(1) as f64;
        let reach = edge.max(NEAR * skin.cell);
        for step in 1..=RELAXATION {
            quads::relax(&mut quads, &connectivity);
            if self.guided || step == RELAXATION {
                subject.draw_on(&mut quads, &connectivity, 1.0, reach, skin.enclosed);
            }
        }
        Ok(quads)
    }

    /// Quads of about so many points near the skin.
    fn connect(&self, skin: &Skin, points: usize) -> Result<PolygonMesh> {
        let coarse = match self.divided {
            // Division adds a point to each edge and each face: V − χ grows four times.
            true => ((points as i64 + 3 * skin.euler) / 4).max(0) as usize,
            false => points,
        };
        let simplified = topology::simplify_evenly(&skin.mesh, vertices(coarse), self.evenness);
        let paired: ControlMesh = quads::paired(&simplified.mesh)?.into();
        let quads = without_unused_vertices(&paired);
        match self.divided {
            true => Ok(model::subdivide(&quads, Scheme::Polygon)?.mesh),
            false => Ok(quads.mesh),
        }
    }
}
