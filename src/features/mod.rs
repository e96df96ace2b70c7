//! Features of a surface: its Monge form at every vertex, and from that ridges, umbilics, and where ridges cross.
//!
//! **Theory** [X. Ma, S. Keates, Y. Jiang, J. Kosinka, *Subdivision surface fitting to a dense mesh using ridges and umbilics*, CAGD 2015, section 3;
//! F. Cazals and M. Pouget, *Topology driven algorithms for ridge extraction on meshes*, INRIA RR-5526, 2005]. A jet of degree 4 at every vertex
//! ([`crate::kernel::jet`]) gives curvatures, their directions and derivatives (`monge`). Ridges are marched through the faces (`ridges`), joined into lines of
//! one colour (`lines`), crossed with each other (`crossings`); umbilics are found by an index of every face (`umbilics`). [`Features::filtered`] chooses as many
//! of them as a control mesh shall have points.
//!
//! **Departures.** Colours come from third derivatives, umbilics from an exact index; thresholds are found, not asked for. A neighbourhood ends at
//! sharp edges, which are features of their own: across them no jet fits, and beside them, on planes and cylinders, everything would be a ridge. Lines and
//! umbilics that are within the error of the fit are left out.
//!
//! **Practice.** No connectivity is assumed but shared vertices: see [`crate::topology::cleaned`] and [`crate::topology::oriented`] for what makes a
//! file's mesh ready. The same bits come out for any number of threads.

mod crossings;
mod edges;
mod filter;
mod lines;
mod monge;
mod neighbourhood;
mod ridges;
mod trace;
mod umbilics;
mod vertices;

pub use filter::{Filtered, Origin, Site};

use crate::device::Device;
use crate::error::Result;
use crate::mesh::TriangleMesh;
use crate::mesh::sample::SurfacePoint;
use edges::Edges;
use glam::DVec3;
use lines::{SharpLines, Traced};
use neighbourhood::Adjacency;
use ridges::{Family, ridges};
use vertices::Vertices;

/// The Monge form of a surface at a vertex: in the frame of its directions and normal the surface is
/// z = ½ (k₁x² + k₂y²) + ⅙ (b₀x³ + 3b₁x²y + 3b₂xy² + b₃y³) + ¹⁄₂₄ (c₀x⁴ + 4c₁x³y + 6c₂x²y² + 4c₃xy³ + c₄y⁴) + …
///
/// All numbers are 0 at a vertex without faces. Normals are those of the faces, so that with faces outwards a convex surface has negative
/// curvatures. Directions are known up to a common turn by 180°, under which b changes sign.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Monge {
    /// Unit length.
    pub normal: DVec3,
    /// The principal directions, of unit length; with the normal a right-handed frame.
    pub directions: [DVec3; 2],
    /// k₁ ≥ k₂, per unit of length.
    pub curvatures: [f64; 2],
    /// b₀ to b₃, per square of the unit.
    pub third: [f64; 4],
    /// c₀ to c₄, per cube of the unit. On scans these are noise.
    pub fourth: [f64; 5],
}

/// How much of the surface a Monge form is fitted to.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Scale {
    /// 2 % of the diagonal, four edges at least, and more as noise makes it necessary.
    #[default]
    Automatic,
    /// The radius as a share of the target's diagonal, above 0 and up to 0.25. Where the vertices are too far apart for that it is as much larger as
    /// it has to be.
    Fraction(f64),
}

/// The Monge form at every vertex of a mesh, by least squares over its neighbourhood.
///
/// # Errors
/// Where the mesh has no extent, the scale is out of range, or the device fails.
pub fn monge_forms(device: &Device, mesh: &TriangleMesh, scale: Scale) -> Result<Vec<Monge>> {
    Surface::new(device, mesh, scale).map(|surface| surface.vertices.forms)
}

/// Which principal curvature is extreme along a ridge, and how: the paper's colours.
///
/// The names are for the normals of the faces: where those look outwards, convex edges are blue and valleys red.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A maximum of k₁ (elliptic).
    Red,
    /// A minimum of k₂ (elliptic).
    Blue,
    /// A maximum of k₂ (hyperbolic).
    Yellow,
    /// A minimum of k₁ (hyperbolic).
    Green,
}

impl Kind {
    /// Of the outstanding sort: the others are where a curvature is least outstanding.
    pub fn is_elliptic(self) -> bool {
        matches!(self, Self::Red | Self::Blue)
    }

    /// The paper's code, of one bit: red 8, blue 4, yellow 2, green 1 (section 4.2).
    pub fn code(self) -> u8 {
        match self {
            Self::Red => 8,
            Self::Blue => 4,
            Self::Yellow => 2,
            Self::Green => 1,
        }
    }
}

/// A point of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinePoint {
    /// Its face, which it has in common with the next point, and where it is there.
    pub place: SurfacePoint,
    /// Where that is.
    pub position: DVec3,
    /// The principal curvature that is extreme there.
    pub curvature: f64,
    /// Whether the line is elliptic there and its curvature the larger one in size.
    pub is_crest: bool,
}

/// A ridge of one colour, or a sharp edge.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Its colour.
    pub kind: Kind,
    /// Whether it runs along edges of the mesh between faces at a large angle; its curvature is that of the neighbourhood that the edge is rounded over.
    pub is_sharp: bool,
    /// Whether the last point is the first.
    pub is_closed: bool,
    /// At least two.
    pub points: Vec<LinePoint>,
    /// ∫ |k| ds along it, free of scale.
    pub strength: f64,
}

impl Line {
    fn new(kind: Kind, is_sharp: bool, is_closed: bool, points: Vec<LinePoint>) -> Self {
        let part = |w: &[LinePoint]| {
            let mean = 0.5 * (w[0].curvature.abs() + w[1].curvature.abs());
            mean * w[0].position.distance(w[1].position)
        };
        Self {
            kind,
            is_sharp,
            is_closed,
            strength: points.windows(2).map(part).sum(),
            points,
        }
    }

    /// Its length.
    pub fn length(&self) -> f64 {
        let parts = self.points.windows(2);
        parts.map(|w| w[0].position.distance(w[1].position)).sum()
    }
}

/// The sort of an umbilic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UmbilicKind {
    /// Three ridges pass through it.
    Elliptic,
    /// One ridge passes through it.
    Hyperbolic,
}

/// A point where both principal curvatures are the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Umbilic {
    /// Its face, and where it is there.
    pub place: SurfacePoint,
    /// Where that is.
    pub position: DVec3,
    /// The turns that the principal directions make around it: ½ or −½, or more where several could not be told apart.
    pub index: f64,
    /// By the third derivatives.
    pub kind: UmbilicKind,
    /// Whether index and kind go together: an elliptic umbilic has the index −½.
    pub is_sure: bool,
    /// The curvature in all directions.
    pub curvature: f64,
}

/// A point where two ridges cross, or where sharp edges meet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Its face, and where it is there.
    pub place: SurfacePoint,
    /// Where that is.
    pub position: DVec3,
    /// The lines.
    pub lines: [u32; 2],
    /// The strength of the weaker line.
    pub strength: f64,
}

/// All features of a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    /// `[vertices]`.
    pub forms: Vec<Monge>,
    /// About the radius of the neighbourhoods.
    pub radius: f64,
    /// The strongest first.
    pub lines: Vec<Line>,
    /// The most curved first.
    pub umbilics: Vec<Umbilic>,
    /// The strongest first.
    pub crossings: Vec<Crossing>,
    /// Where a ridge changes between elliptic and hyperbolic.
    pub turnings: Vec<LinePoint>,
}

impl Features {
    /// Finds the features of a mesh.
    ///
    /// # Errors
    /// As [`monge_forms`].
    pub fn find(device: &Device, mesh: &TriangleMesh, scale: Scale) -> Result<Self> {
        let surface = Surface::new(device, mesh, scale)?;
        let Surface {
            adjacency,
            edges,
            sharp,
            vertices,
            is_known,
        } = &surface;
        let mut traced = Traced::default();
        for family in [Family::Greater, Family::Lesser] {
            let ridges = ridges(mesh, adjacency, edges, vertices, is_known, family);
            traced.add(mesh, &ridges, family, edges);
        }
        traced.add_sharp(mesh, sharp, vertices);
        let Traced {
            mut lines,
            turnings,
        } = traced;
        lines.sort_by(|a, b| b.strength.total_cmp(&a.strength));
        Ok(Self {
            radius: surface.vertices.usual_radius,
            crossings: crossings::crossings(mesh, &lines),
            umbilics: umbilics::umbilics(mesh, edges, vertices, is_known),
            forms: surface.vertices.forms,
            lines,
            turnings,
        })
    }
}

/// A mesh with all that features are found from.
struct Surface {
    adjacency: Adjacency,
    edges: Edges,
    sharp: SharpLines,
    vertices: Vertices,
    /// `[vertices]`: whether the third derivatives mean something.
    is_known: Vec<bool>,
}

impl Surface {
    fn new(device: &Device, mesh: &TriangleMesh, scale: Scale) -> Result<Self> {
        let adjacency = Adjacency::of(mesh);
        let edges = Edges::of(mesh, &adjacency);
        let angles = edges.sharp(mesh);
        let least = vertices::usual_radius(mesh)?;
        let sharp = SharpLines::of(mesh, &edges, &angles, least);
        let is_barrier = sharp.vertices(mesh.positions.len());
        let vertices = Vertices::fit(device, mesh, &adjacency, &is_barrier, scale)?;
        let is_known = is_barrier
            .iter()
            .zip(&vertices.trust)
            .map(|(barrier, trust)| !barrier && trust.third_error.is_finite())
            .collect();
        Ok(Self {
            adjacency,
            edges,
            sharp,
            vertices,
            is_known,
        })
    }
}
