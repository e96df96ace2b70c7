//! Edge flips on a triangle control mesh: towards regular valences, then away from small angles; and along ridges.
//!
//! **Theory** \[NMM08, section 5\]. A flip replaces the edge between two faces by the other diagonal of their quadrilateral. R = Σ (valence −
//! optimal)², optimal 6 inside and 4 on the boundary, falls with every flip for valence, and the sorted angles rise with every flip for angles, so both
//! come to an end.
//!
//! **Practice.** The topology stays: a flip is refused where its new edge is there already. Boundaries and creases stay, and so do edges
//! where the surface bends (`FLAT`): flipping those would cut a ridge or bridge a valley. A boundary vertex keeps two faces, since with
//! one it would become a corner of the surface.

use super::split::check_triangles;
use crate::error::{Error, Result};
use crate::mesh::{Connectivity, ControlMesh, PolygonMesh};
use glam::{DVec2, DVec3};

/// The least cosine between the normals of the two faces, before and after a flip, and of one before and one after.
const FLAT: f64 = 0.7;

/// A flip for valence may leave no angle smaller than this, unless one was: radians.
const LEAST_ANGLE: f64 = 0.35;

/// A flip for angles must raise the smallest one by more than rounding: radians.
const RISE: f64 = 1e-6;

/// No opposite half-edge.
const NONE: u32 = u32::MAX;

/// A flip that was made: the faces (a, b, c) and (b, a, d) became (a, d, c) and (d, b, c), in their places and from their first corners on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flip {
    /// The places of the two faces.
    pub faces: [u32; 2],
    /// Which corner a was in the first face, and b in the second.
    corners: [usize; 2],
}

impl Flip {
    /// The face and parameters of what was at `at` in `face`, one of the two, if both lie flat as a parallelogram.
    pub fn locate(&self, face: u32, at: DVec2) -> (u32, DVec2) {
        let weights = [1.0 - at.x - at.y, at.x, at.y];
        let is_first = face == self.faces[0];
        let turn = self.corners[usize::from(!is_first)];
        let [p, q, r] = [0, 1, 2].map(|k| weights[(turn + k) % 3]);
        let [a, b, c, d] = match is_first {
            true => [p, q, r, 0.0],
            false => [q, p, 0.0, r],
        };
        // In a parallelogram a + b = c + d: what a and b share counts for c and d.
        let shared = a.min(b);
        match a > b {
            true => (self.faces[0], DVec2::new(d + shared, c + shared)),
            false => (self.faces[1], DVec2::new(b - shared, c + shared)),
        }
    }
}

/// Lowers R by flips until no flip lowers it. Returns the flips in order.
///
/// # Errors
/// Where the mesh is no oriented manifold or has a face other than a triangle.
pub fn flip_for_valence(control: &mut ControlMesh) -> Result<Vec<Flip>> {
    flip_all(control, |mesh, h, positions| {
        let quad = mesh.quad(h);
        mesh.valence_change(quad) < 0
            && least_angle(turned(quad), positions) >= LEAST_ANGLE.min(least_angle(quad, positions))
    })
}

/// Raises the smallest angle of two neighbouring faces by flips until no flip raises it. Returns the flips in order.
///
/// # Errors
/// As [`flip_for_valence`].
pub fn flip_for_angles(control: &mut ControlMesh) -> Result<Vec<Flip>> {
    flip_all(control, |mesh, h, positions| {
        let quad = mesh.quad(h);
        least_angle(turned(quad), positions) > least_angle(quad, positions) + RISE
    })
}

/// Lays edges along ridges \[MKJK15, algorithm 2\]: flips those whose ends have less in common than the two vertices across, until there is none. Returns the flips in order.
///
/// `colors`: `[control points]`, a bit for every kind of ridge through each, the more telling kind the higher bit. The paper flips all; here, as above, what
/// would fold or make a sliver stays.
///
/// # Errors
/// As [`flip_for_valence`], and where there is not one code for each control point.
pub fn flip_for_colors(control: &mut ControlMesh, colors: &[u8]) -> Result<Vec<Flip>> {
    let count = control.mesh.positions.len();
    if colors.len() != count {
        return Err(Error::input(
            format!(
                "there are {} colours for {count} control points",
                colors.len()
            ),
            "give one for each",
        ));
    }
    flip_all(control, |mesh, h, positions| {
        let quad = mesh.quad(h);
        let [a, b, c, d] = quad.map(|v| colors[v as usize]);
        a & b < c & d
            && least_angle(turned(quad), positions) >= LEAST_ANGLE.min(least_angle(quad, positions))
    })
}

/// R: the sum over all vertices of (valence − optimal)².
pub fn irregularity(mesh: &Connectivity) -> u64 {
    (0..mesh.vertex_count() as u32)
        .map(|v| {
            let excess = mesh.spokes(v).count() as i64 - optimal(mesh.is_boundary_vertex(v));
            (excess * excess) as u64
        })
        .sum()
}

fn optimal(on_boundary: bool) -> i64 {
    if on_boundary { 4 } else { 6 }
}

/// Flips what is wanted and allowed, in sweeps over the edges until one finds nothing.
fn flip_all(
    control: &mut ControlMesh,
    wanted: impl Fn(&Flippable, u32, &[DVec3]) -> bool,
) -> Result<Vec<Flip>> {
    let mut flips = Vec::new();
    let mut mesh = Flippable::of(control)?;
    let positions = std::mem::take(&mut control.mesh.positions);
    // How many flips there were when a half-edge was looked at, and after the last at a vertex: where none came in between, the answer is the same.
    let mut seen: Vec<Option<usize>> = vec![None; mesh.origins.len()];
    let mut touched = vec![0; positions.len()];
    loop {
        let before = flips.len();
        for h in 0..mesh.origins.len() as u32 {
            if !mesh.is_flippable(h) {
                continue;
            }
            let quad = mesh.quad(h);
            let last = quad.map(|v| touched[v as usize]).into_iter().max();
            if seen[h as usize] >= last {
                continue;
            }
            seen[h as usize] = Some(flips.len());
            if wanted(&mesh, h, &positions)
                && stays_flat(quad, &positions)
                && !mesh.has_other_diagonal(h)
            {
                flips.push(mesh.flip(h));
                for v in quad {
                    touched[v as usize] = flips.len();
                }
            }
        }
        if flips.len() == before {
            break;
        }
    }
    control.mesh = PolygonMesh::from_faces(positions, mesh.origins.chunks_exact(3));
    Ok(flips)
}

/// Two faces (a, b, c) and (b, a, d).
type Quad = [u32; 4];

/// The same quadrilateral cut along the other diagonal: (d, c, a) and (c, d, b).
fn turned([a, b, c, d]: Quad) -> Quad {
    [d, c, a, b]
}

fn normals([a, b, c, d]: Quad, positions: &[DVec3]) -> [DVec3; 2] {
    let [a, b, c, d] = [a, b, c, d].map(|v| positions[v as usize]);
    [(b - a).cross(c - a), (a - b).cross(d - b)].map(DVec3::normalize_or_zero)
}

fn least_angle([a, b, c, d]: Quad, positions: &[DVec3]) -> f64 {
    let [a, b, c, d] = [a, b, c, d].map(|v| positions[v as usize]);
    // Opposite to the shortest edge is the smallest angle.
    let triangle = |p: DVec3, q: DVec3, r: DVec3| {
        let edges = [[p, q, r], [q, r, p], [r, p, q]].map(|[x, y, z]| [y - x, z - x, z - y]);
        let across = |e: &[DVec3; 3]| e[2].length_squared();
        let least = |a, b| if across(&b) < across(&a) { b } else { a };
        let [x, y, _] = edges.into_iter().reduce(least).unwrap_or_default();
        x.cross(y).length().atan2(x.dot(y))
    };
    triangle(a, b, c).min(triangle(b, a, d))
}

/// Whether all four faces, those before and those after a flip, face about the same way.
fn stays_flat(quad: Quad, positions: &[DVec3]) -> bool {
    let ([a, b], [c, d]) = (normals(quad, positions), normals(turned(quad), positions));
    [(a, b), (c, d), (a, c), (a, d), (b, c), (b, d)]
        .iter()
        .all(|(x, y)| x.dot(*y) >= FLAT)
}

/// Half-edge 3 f + k runs from corner k of triangle f to the next.
struct Flippable {
    /// `[half-edges]`: the vertex it starts from.
    origins: Vec<u32>,
    /// `[half-edges]`: the one that runs back, or `NONE`.
    opposites: Vec<u32>,
    /// `[half-edges]`: whether it lies on a crease.
    sharp: Vec<bool>,
    /// `[vertices]`: a half-edge that leaves it, `NONE` without faces.
    outgoing: Vec<u32>,
    /// `[vertices]`: edges.
    valence: Vec<i64>,
    /// `[vertices]`: whether it lies on the boundary.
    on_boundary: Vec<bool>,
}

/// The half-edge after `h` around its triangle.
fn next(h: u32) -> u32 {
    if h % 3 == 2 { h - 2 } else { h + 1 }
}

/// The half-edge before `h` around its triangle.
fn previous(h: u32) -> u32 {
    if h.is_multiple_of(3) { h + 2 } else { h - 1 }
}

impl Flippable {
    fn of(control: &ControlMesh) -> Result<Self> {
        let mesh = Connectivity::of(&control.mesh)?;
        check_triangles(&mesh)?;
        let mut creases: Vec<[u32; 2]> = control
            .creases
            .iter()
            .filter(|c| c.sharpness > 0.0)
            .map(|c| sorted(c.edge))
            .collect();
        creases.sort_unstable();
        let half_edges = 0..mesh.half_edge_count() as u32;
        let is_sharp = |h| {
            let ends = sorted([mesh.origin(h), mesh.target(h)]);
            creases.binary_search(&ends).is_ok()
        };
        let vertices = 0..mesh.vertex_count() as u32;
        Ok(Self {
            origins: half_edges.clone().map(|h| mesh.origin(h)).collect(),
            opposites: half_edges
                .clone()
                .map(|h| mesh.opposite(h).unwrap_or(NONE))
                .collect(),
            sharp: half_edges.map(is_sharp).collect(),
            outgoing: vertices
                .clone()
                .map(|v| mesh.around(v).next().unwrap_or(NONE))
                .collect(),
            valence: vertices
                .clone()
                .map(|v| mesh.spokes(v).count() as i64)
                .collect(),
            on_boundary: vertices.map(|v| mesh.is_boundary_vertex(v)).collect(),
        })
    }

    fn origin(&self, h: u32) -> u32 {
        self.origins[h as usize]
    }

    /// The faces at `h`, seen from `h`; it must have an opposite.
    fn quad(&self, h: u32) -> Quad {
        let o = self.opposites[h as usize];
        [h, next(h), previous(h), previous(o)].map(|h| self.origin(h))
    }

    /// Whether a half-edge stands for an edge (by the smaller index of its two) that may be flipped: not of a boundary or crease, nor
    /// one that a vertex at its ends needs.
    fn is_flippable(&self, h: u32) -> bool {
        let o = self.opposites[h as usize];
        if o == NONE || o < h || self.sharp[h as usize] {
            return false;
        }
        [self.origin(h), self.origin(o)].iter().all(|&v| {
            // Three edges at the boundary are two faces.
            self.valence[v as usize] > 3
        })
    }

    /// How R changes if a quad is turned.
    fn valence_change(&self, [a, b, c, d]: Quad) -> i64 {
        // (x ± 1)² − x² = 1 ± 2 x.
        let excess = |v: u32| self.valence[v as usize] - optimal(self.on_boundary[v as usize]);
        4 + 2 * (excess(c) + excess(d) - excess(a) - excess(b))
    }

    /// Whether the vertices across `h` are joined by an edge already.
    fn has_other_diagonal(&self, h: u32) -> bool {
        let [_, _, c, d] = self.quad(h);
        c == d || self.are_neighbours(c, d)
    }

    fn are_neighbours(&self, v: u32, w: u32) -> bool {
        let first = self.outgoing[v as usize];
        let mut h = first;
        // Counter-clockwise, and from a boundary back to the other one.
        loop {
            if self.origin(next(h)) == w || self.origin(previous(h)) == w {
                return true;
            }
            h = self.opposites[previous(h) as usize];
            if h == first {
                return false;
            }
            if h == NONE {
                break;
            }
        }
        h = first;
        while self.opposites[h as usize] != NONE {
            h = next(self.opposites[h as usize]);
            if self.origin(next(h)) == w || self.origin(previous(h)) == w {
                return true;
            }
        }
        false
    }

    /// Turns the faces (a, b, c) and (b, a, d) at `h` into (a, d, c) and (d, b, c), in their places.
    fn flip(&mut self, h: u32) -> Flip {
        let [a, b, c, d] = self.quad(h);
        let o = self.opposites[h as usize];
        let (f, g) = (h / 3, o / 3);
        let outer = |mesh: &Self, h: u32| (mesh.opposites[h as usize], mesh.sharp[h as usize]);
        let [bc, ca] = [next(h), previous(h)].map(|h| outer(self, h));
        let [ad, db] = [next(o), previous(o)].map(|h| outer(self, h));
        let inner = |h: u32| (h, false);
        self.set(f, [a, d, c], [ad, inner(3 * g + 2), ca]);
        self.set(g, [d, b, c], [db, bc, inner(3 * f + 1)]);
        for v in [a, b] {
            self.valence[v as usize] -= 1;
        }
        for v in [c, d] {
            self.valence[v as usize] += 1;
        }
        Flip {
            faces: [f, g],
            corners: [h, o].map(|h| (h % 3) as usize),
        }
    }

    /// Gives a face its vertices and, for each half-edge, what runs back and whether it is sharp.
    fn set(&mut self, f: u32, vertices: [u32; 3], edges: [(u32, bool); 3]) {
        for ((h, v), (opposite, sharp)) in (3 * f..).zip(vertices).zip(edges) {
            self.origins[h as usize] = v;
            self.outgoing[v as usize] = h;
            self.opposites[h as usize] = opposite;
            self.sharp[h as usize] = sharp;
            if opposite != NONE {
                self.opposites[opposite as usize] = h;
            }
        }
    }
}

fn sorted([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::random::Random;
    use crate::mesh::{Crease, shapes};

    /// A flat strip of points: two rows of `n`, joined by triangles.
    fn quad_of(points: [[f64; 2]; 4]) -> ControlMesh {
        let positions = points.map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec();
        PolygonMesh::from_faces(positions, [[0u32, 1, 2], [1, 0, 3]]).into()
    }

    #[test]
    fn a_lone_quadrilateral_keeps_its_diagonal() {
        // Flipped, the vertices 0 and 1 would be left with a single face each.
        let mut thin = quad_of([[0.0, -3.0], [0.0, 3.0], [-0.5, 0.0], [0.5, 0.0]]);
        let same = thin.clone();
        assert!(flip_for_angles(&mut thin).unwrap().is_empty());
        assert_eq!(thin, same);
    }

    /// A disc: a thin quadrilateral of vertices 0 to 3 with a ring of faces around it.
    fn disc() -> ControlMesh {
        let mut positions = quad_of([[0.0, -3.0], [0.0, 3.0], [-0.5, 0.0], [0.5, 0.0]])
            .mesh
            .positions;
        let outer = [[0.0, -6.0], [6.0, 0.0], [0.0, 6.0], [-6.0, 0.0]];
        positions.extend(outer.map(|[x, y]| DVec3::new(x, y, 0.0)));
        let faces = [
            [0u32, 1, 2],
            [1, 0, 3],
            [4, 5, 0],
            [5, 3, 0],
            [5, 1, 3],
            [5, 6, 1],
            [6, 7, 1],
            [7, 2, 1],
            [7, 0, 2],
            [7, 4, 0],
        ];
        PolygonMesh::from_faces(positions, faces).into()
    }

    #[test]
    fn a_thin_quadrilateral_is_turned_unless_creased_or_bent() {
        let has = |control: &ControlMesh, a, b| {
            let mesh = Connectivity::of(&control.mesh).expect("still a manifold");
            mesh.validate().expect("consistent");
            mesh.edge_between(a, b).is_some()
        };
        let mut plain = disc();
        assert_eq!(flip_for_angles(&mut plain).unwrap()[0].faces, [0, 1]);
        assert!(has(&plain, 2, 3) && !has(&plain, 0, 1));

        let mut creased = disc();
        creased.creases = vec![Crease {
            edge: [1, 0],
            sharpness: 2.0,
        }];
        flip_for_angles(&mut creased).unwrap();
        assert!(has(&creased, 0, 1));

        let mut bent = disc();
        for v in [2, 3] {
            bent.mesh.positions[v].z = 0.5;
        }
        flip_for_angles(&mut bent).unwrap();
        assert!(has(&bent, 0, 1));
    }

    #[test]
    fn parameters_follow_their_points_over_a_flip() {
        // A parallelogram in its ring, turned so that every corner of its faces comes first once.
        let mut before = disc();
        for (v, [x, y]) in [[0.0, -1.0], [1.0, 3.0], [-0.5, 1.0], [1.5, 1.0]]
            .into_iter()
            .enumerate()
        {
            before.mesh.positions[v] = DVec3::new(x, y, 0.0);
        }
        for (turn, other) in [(0, 0), (1, 2), (2, 1)] {
            let faces = before.mesh.faces().map(|f| [f[0], f[1], f[2]]);
            let mut faces: Vec<[u32; 3]> = faces.collect();
            faces[0].rotate_left(turn);
            faces[1].rotate_left(other);
            let turned = PolygonMesh::from_faces(before.mesh.positions.clone(), faces);
            let mut after = ControlMesh::from(turned.clone());
            let flips = flip_for_angles(&mut after).unwrap();
            assert_eq!(flips[0].faces, [0, 1]);
            let place = |mesh: &PolygonMesh, f: u32, at: DVec2| {
                let [a, b, c] =
                    [0, 1, 2].map(|k| mesh.positions[mesh.face(f as usize)[k] as usize]);
                a * (1.0 - at.x - at.y) + b * at.x + c * at.y
            };
            for (face, x, y) in [
                (0, 0.1, 0.3),
                (0, 0.7, 0.2),
                (1, 0.25, 0.5),
                (1, 0.0, 0.4),
                (0, 0.5, 0.0),
            ] {
                let at = DVec2::new(x, y);
                let (there, moved) = flips[0].locate(face, at);
                assert!(moved.min_element() >= 0.0 && moved.x + moved.y <= 1.0 + 1e-15);
                let distance = place(&turned, face, at).distance(place(&after.mesh, there, moved));
                assert!(distance < 1e-15, "{face} {at} {distance}");
            }
        }
    }

    #[test]
    fn an_edge_that_is_there_already_is_not_made_twice() {
        // In a tetrahedron all vertices are neighbours; in an octahedron opposite ones are not, but all valences are 4.
        let tetrahedron = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let faces = [[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let mut control = ControlMesh::from(PolygonMesh::from_faces(tetrahedron, faces));
        assert!(flip_for_valence(&mut control).unwrap().is_empty());
        assert!(flip_for_angles(&mut control).unwrap().is_empty());
    }

    #[test]
    fn polygons_are_refused() {
        let mut quads = ControlMesh::from(shapes::torus(3.0, 1.0, 8, 6));
        let error = flip_for_valence(&mut quads).expect_err("quads");
        assert!(error.to_string().contains("face 0 has 4 corners"));
    }

    #[test]
    fn flips_along_colours_gain_and_never_fold() {
        let mut random = Random::new(1);
        let ball: ControlMesh = PolygonMesh::from(shapes::lobed_ball(3)).into();
        let count = ball.mesh.positions.len();
        assert!(flip_for_colors(&mut ball.clone(), &vec![8; count - 1]).is_err());
        assert!(
            flip_for_colors(&mut ball.clone(), &vec![8; count])
                .unwrap()
                .is_empty()
        );
        let common = |control: &ControlMesh, colors: &[u8]| -> (u64, Connectivity) {
            let mesh = Connectivity::of(&control.mesh).unwrap();
            let edges = (0..mesh.edge_count() as u32).map(|e| mesh.ends(e));
            let sum = edges.map(|[a, b]| u64::from(colors[a as usize] & colors[b as usize]));
            (sum.sum(), mesh)
        };
        for _ in 0..5 {
            let colors: Vec<u8> = (0..count).map(|_| random.below(16) as u8).collect();
            let mut flipped = ball.clone();
            let flips = flip_for_colors(&mut flipped, &colors).unwrap();
            let ((before, _), (after, mesh)) = (common(&ball, &colors), common(&flipped, &colors));
            mesh.validate().unwrap();
            assert!(flips.len() > 50 && after >= before + flips.len() as u64);
            for face in mesh.faces() {
                let [a, b, c] = [0, 1, 2].map(|k| flipped.mesh.positions[face[k] as usize]);
                assert!(
                    (b - a).cross(c - a).dot(a + b + c) > 0.0,
                    "a face is turned inwards"
                );
            }
        }
    }
}
