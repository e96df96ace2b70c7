//! Shells \[PPL13, section 4.4\]: layers of cells over one or both sides of a surface, all of a wanted thickness.
//!
//! **Theory.** Every vertex of the surface goes along its normal by the thickness, or less where there is no room for that: a ball that touches the
//! surface there and nowhere else must be larger, or layers from opposite sides would meet. Then the layers are optimized ([`crate::untangle`]) with the surface
//! itself held fast: the ideal of a cell is the polygon that it stands on, raised along its normal by the thickness of a layer there (the paper's reference
//! matrix A). Where cells stay inverted, their layers are made thinner, and it is done again.
//!
//! **Departure from the paper**: it starts from a tiny extrusion and lets the optimizer blow it up, which keeps cells valid but not layers apart.

use crate::error::{Error, Result};
use crate::geometry::Bvh;
use crate::mesh::{CellShape, Connectivity, PolygonMesh, VolumeMesh};
use crate::progress::Progress;
use crate::untangle::{Boundary, Ideals, inverted, untangle};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Layers reach this share of the radius of the ball that has room: those of the other side come as far.
const ROOM: f64 = 0.8;

/// A ball is stopped by points that are seen from where it touches under this sine or more over the tangent plane: lower ones belong to the same part of the surface.
const OTHER_SIDE: f64 = 0.5;

/// Layers are at least this share of the wanted thickness before cells that stay inverted make them thinner.
const LEAST_HEIGHT: f64 = 0.1;

/// Heights from this share of the wanted thickness on are all of it, but for rounding.
const WHOLE: f64 = 1.0 - 1e-9;

/// Steps in which a ball shrinks, at most.
const SHRINKING: usize = 30;

/// How much thicker layers may get over a length along the surface.
const STEEPEST: f64 = 0.5;

/// How often cells that stay inverted are made thinner, and to which share.
const RETRIES: usize = 3;
const THINNER: f64 = 0.5;

/// The weight of not moving beside the squares of the normals around a vertex.
const STAYING: f64 = 1e-3;

/// Quads with angles of a sine below this are cut into triangles.
const LEAST_SINE: f64 = 0.05;

/// Which side of a surface layers are on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Where its normals point.
    Outside,
    /// The other.
    Inside,
    /// Either, as many layers on each.
    Both,
}

/// How thick a shell has become, as shares of the wanted thickness: from the vertices and the middles of the faces of its far sides to the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thickness {
    /// The least.
    pub min: f64,
    /// The mean.
    pub mean: f64,
    /// The largest.
    pub max: f64,
}

/// A shell.
#[derive(Debug, Clone, PartialEq)]
pub struct Shell {
    /// Prisms over triangles and hexahedra over quads. The first vertices are those of the surface.
    pub mesh: VolumeMesh,
    /// Of all sides together.
    pub thickness: Thickness,
    /// The share of vertices over which there was no room for the whole thickness, either side counted.
    pub shortened: f64,
    /// Cells that are inverted at a corner all the same.
    pub inverted: usize,
    /// Whether it was stopped before its end.
    pub interrupted: bool,
}

/// Layers of cells over a surface, closed or open: `layers` on each side, `distance` thick together. Faces of more than four corners and
/// quads that are not convex are cut into triangles.
///
/// ```no_run
/// use vorofit::mesh::shapes::torus;
/// use vorofit::progress::Silent;
/// use vorofit::template::shell::{Side, shell};
///
/// let made = shell(&torus(1.0, 0.4, 32, 16), 2, 0.1, Side::Both, &Silent)?;
/// assert_eq!((made.mesh.cell_count(), made.inverted), (2048, 0));
/// # Ok::<(), vorofit::Error>(())
/// ```
///
/// # Errors
/// Where the surface is no oriented manifold, a face has no area, there are no layers or too many, or the distance is not positive.
pub fn shell(
    surface: &PolygonMesh,
    layers: u32,
    distance: f64,
    side: Side,
    progress: &dyn Progress,
) -> Result<Shell> {
    let surface = &check(surface, layers, distance)?;
    let signs: &[f64] = match side {
        Side::Outside => &[1.0],
        Side::Inside => &[-1.0],
        Side::Both => &[1.0, -1.0],
    };
    let base = Base::new(surface)?;
    let mut courses: Vec<Course> = signs
        .iter()
        .map(|&sign| base.course(sign, distance))
        .collect();
    let short = |course: &Course| {
        course
            .heights
            .iter()
            .filter(|h| **h < WHOLE * distance)
            .count()
    };
    let shortened = courses.iter().map(short).sum::<usize>() as f64
        / (courses.len() * surface.positions.len()) as f64;
    let mut pinned = vec![false; surface.positions.len() * (1 + courses.len() * layers as usize)];
    pinned[..surface.positions.len()].fill(true);
    let mut retries = RETRIES;
    loop {
        let mesh = base.extruded(&courses, layers);
        let ideals = base.ideals(&mesh, &courses, layers);
        let found = untangle(&mesh, &ideals, Boundary::Pinned(&pinned), progress)?;
        if found.inverted == 0 || found.interrupted || retries == 0 {
            return Ok(Shell {
                thickness: base.thickness(&found.mesh, layers, &courses, distance)?,
                mesh: found.mesh,
                shortened,
                inverted: found.inverted,
                interrupted: found.interrupted,
            });
        }
        retries -= 1;
        base.thin(&mut courses, &inverted(&found.mesh), layers);
    }
}

/// The surface without vertices that no face uses, and with faces that cells can stand on.
fn check(surface: &PolygonMesh, layers: u32, distance: f64) -> Result<PolygonMesh> {
    if layers == 0 || !(distance > 0.0 && distance.is_finite()) || surface.face_count() == 0 {
        return Err(Error::input(
            "there is nothing to extrude",
            "give a surface, a distance above 0 and at least one layer",
        ));
    }
    Connectivity::of(surface)?;
    let largest = surface.positions.len().max(surface.corners().len()) as u64;
    if largest.saturating_mul(2 * u64::from(layers) + 1) > u64::from(u32::MAX / 8) {
        return Err(Error::input(
            format!("{layers} layers have too many cells"),
            "give fewer layers",
        ));
    }
    let mut number = vec![u32::MAX; surface.positions.len()];
    surface
        .corners()
        .iter()
        .for_each(|&v| number[v as usize] = 0);
    let mut used = PolygonMesh::default();
    for (p, number) in surface
        .positions
        .iter()
        .zip(&mut number)
        .filter(|(_, n)| **n == 0)
    {
        *number = used.positions.len() as u32;
        used.positions.push(*p);
    }
    for (f, face) in surface.faces().enumerate() {
        let face: Vec<u32> = face.iter().map(|&v| number[v as usize]).collect();
        for part in convex_parts(&used.positions, face) {
            if least_sine(&used.positions, &part) <= 0.0 {
                return Err(Error::input(
                    format!("face {f} (counted from 0) has no area, or folds over itself"),
                    "mend the surface: no cell can stand on this face",
                ));
            }
            used.push_face(&part);
        }
    }
    Ok(used)
}

/// A polygon cut into triangles, unless it is a triangle or a convex quad: from the corner that leaves the least sharp angles.
fn convex_parts(positions: &[DVec3], face: Vec<u32>) -> Vec<Vec<u32>> {
    let n = face.len();
    if n == 3 || n == 4 && least_sine(positions, &face) > LEAST_SINE {
        return vec![face];
    }
    let fan = |from: usize| {
        let at = |k: usize| face[(from + k) % n];
        (2..n)
            .map(|k| vec![at(0), at(k - 1), at(k)])
            .collect::<Vec<_>>()
    };
    let across = area_vector(positions, &face);
    let least = |parts: &Vec<Vec<u32>>| {
        let sines = parts.iter().map(
            |part| match area_vector(positions, part).dot(across) > 0.0 {
                true => least_sine(positions, part),
                false => -1.0,
            },
        );
        sines.fold(1.0, f64::min)
    };
    let fans = (0..n).map(fan);
    fans.max_by(|a, b| least(a).total_cmp(&least(b)))
        .unwrap_or_default()
}

/// The least sine of the angles of a polygon; negative where it is not convex.
fn least_sine(positions: &[DVec3], face: &[u32]) -> f64 {
    let n = face.len();
    let across = area_vector(positions, face).normalize_or_zero();
    let sine = |k: usize| {
        let [before, at, after] = [k + n - 1, k, k + 1].map(|k| positions[face[k % n] as usize]);
        let (a, b) = (after - at, before - at);
        a.cross(b).dot(across) / (a.length() * b.length())
    };
    // Not a number where an edge has no length.
    (0..n)
        .map(sine)
        .fold(1.0, |least, s| if s >= least { least } else { s })
}

/// Twice the area of a polygon times its normal.
fn area_vector(positions: &[DVec3], face: &[u32]) -> DVec3 {
    let at = |k: usize| positions[face[k] as usize] - positions[face[0] as usize];
    (2..face.len()).map(|k| at(k - 1).cross(at(k))).sum()
}

/// The surface that a shell stands on.
struct Base<'a> {
    surface: &'a PolygonMesh,
    triangles: Vec<[u32; 3]>,
    tree: Bvh,
    /// `[vertices]`: what takes a vertex one unit over the planes of the faces around it.
    outwards: Vec<DVec3>,
    /// `[faces]`, unit length.
    normals: Vec<DVec3>,
}

/// Where the layers on one side go.
struct Course {
    /// 1 along the normals, −1 against them.
    sign: f64,
    /// `[vertices]`: how far.
    heights: Vec<f64>,
}

impl<'a> Base<'a> {
    fn new(surface: &'a PolygonMesh) -> Result<Self> {
        let triangles = surface.triangulate();
        let tree = Bvh::new(&triangles.positions, &triangles.triangles)?;
        let normals: Vec<DVec3> = surface
            .faces()
            .map(|face| area_vector(&surface.positions, face).normalize_or_zero())
            .collect();
        let mut sums = vec![
            (DMat3::from_diagonal(DVec3::splat(STAYING)), DVec3::ZERO);
            surface.positions.len()
        ];
        for (face, &n) in surface.faces().zip(&normals) {
            for &v in face {
                let (squares, sum) = &mut sums[v as usize];
                *squares += DMat3::from_cols(n * n.x, n * n.y, n * n.z);
                *sum += n;
            }
        }
        let outwards = sums
            .into_iter()
            .map(|(squares, sum)| squares.inverse() * sum)
            .collect();
        Ok(Self {
            surface,
            triangles: triangles.triangles,
            tree,
            outwards,
            normals,
        })
    }

    /// How far layers can go on one side.
    fn course(&self, sign: f64, distance: f64) -> Course {
        let room = |v: usize| ROOM * self.ball(v, sign, distance / ROOM);
        let mut heights: Vec<f64> = (0..self.surface.positions.len())
            .into_par_iter()
            .map(|v| room(v).clamp(LEAST_HEIGHT * distance, distance))
            .collect();
        self.smooth(&mut heights);
        Course { sign, heights }
    }

    /// The radius of the largest ball that touches the surface at a vertex and holds no point of another part of it, `largest` at most.
    fn ball(&self, v: usize, sign: f64, largest: f64) -> f64 {
        let (p, n) = (
            self.surface.positions[v],
            sign * self.outwards[v].normalize_or_zero(),
        );
        let mut radius = largest;
        for _ in 0..SHRINKING {
            let center = p + radius * n;
            let found = self.tree.closest(center);
            let touches = self.triangles[found.triangle as usize].contains(&(v as u32));
            let across = found.point - p;
            let is_same_part = touches || across.dot(n) < OTHER_SIDE * across.length();
            if is_same_part || found.distance_squared.sqrt() > radius * (1.0 - 1e-6) {
                break;
            }
            // The ball through both points.
            radius = across.length_squared() / (2.0 * across.dot(n));
        }
        radius
    }

    /// Lowers heights so that they change slowly along the surface.
    fn smooth(&self, heights: &mut [f64]) {
        loop {
            let mut is_changed = false;
            for face in self.surface.faces() {
                for k in 0..face.len() {
                    let [a, b] = [face[k], face[(k + 1) % face.len()]].map(|v| v as usize);
                    let rise =
                        STEEPEST * self.surface.positions[a].distance(self.surface.positions[b]);
                    for (low, high) in [(a, b), (b, a)] {
                        // Without the share rounding could go on for ever.
                        if heights[high] > (heights[low] + rise) * (1.0 + 1e-9) {
                            heights[high] = heights[low] + rise;
                            is_changed = true;
                        }
                    }
                }
            }
            if !is_changed {
                return;
            }
        }
    }

    /// The layers before they are optimized.
    fn extruded(&self, courses: &[Course], layers: u32) -> VolumeMesh {
        let mut mesh = VolumeMesh::new(self.surface.positions.clone());
        for course in courses {
            let before = mesh.positions.len();
            for layer in 1..=layers {
                let share = course.sign * f64::from(layer) / f64::from(layers);
                let ways = self.outwards.iter().zip(&course.heights);
                let points = self.surface.positions.iter().zip(ways);
                mesh.positions
                    .extend(points.map(|(p, (n, h))| *p + share * *h * *n));
            }
            self.push_layers(&mut mesh, before as u32, layers, course.sign);
        }
        mesh
    }

    /// The cells of one side, layer after layer; `first` is the first vertex over the surface.
    fn push_layers(&self, mesh: &mut VolumeMesh, first: u32, layers: u32, sign: f64) {
        let count = self.surface.positions.len() as u32;
        for layer in 0..layers {
            let above = first + layer * count;
            let below = if layer == 0 { 0 } else { above - count };
            let (bottom, top) = if sign > 0.0 {
                (below, above)
            } else {
                (above, below)
            };
            for face in self.surface.faces() {
                let cell: Vec<u32> = face
                    .iter()
                    .map(|v| bottom + v)
                    .chain(face.iter().map(|v| top + v))
                    .collect();
                mesh.push_cell(shape_over(face), &cell);
            }
        }
    }

    /// The polygon under each cell, raised along its normal.
    fn ideals(&self, mesh: &VolumeMesh, courses: &[Course], layers: u32) -> Ideals {
        let faces = self.surface.face_count();
        Ideals::new(mesh, |c| {
            let course = &courses[c / (faces * layers as usize)];
            let (face, n) = (self.surface.face(c % faces), self.normals[c % faces]);
            let bottom = face.iter().map(|&v| self.surface.positions[v as usize]);
            let top = face.iter().map(|&v| {
                let height = course.heights[v as usize] / f64::from(layers);
                self.surface.positions[v as usize] + height * n
            });
            bottom.chain(top).collect()
        })
    }

    /// Makes layers thinner where cells are inverted.
    fn thin(&self, courses: &mut [Course], inverted: &[bool], layers: u32) {
        let faces = self.surface.face_count();
        for (course, inverted) in courses
            .iter_mut()
            .zip(inverted.chunks(faces * layers as usize))
        {
            let mut touched = vec![false; course.heights.len()];
            for (c, _) in inverted.iter().enumerate().filter(|(_, i)| **i) {
                self.surface
                    .face(c % faces)
                    .iter()
                    .for_each(|&v| touched[v as usize] = true);
            }
            for (height, _) in course.heights.iter_mut().zip(touched).filter(|(_, t)| *t) {
                *height *= THINNER;
            }
            self.smooth(&mut course.heights);
        }
    }

    fn thickness(
        &self,
        mesh: &VolumeMesh,
        layers: u32,
        courses: &[Course],
        distance: f64,
    ) -> Result<Thickness> {
        let count = self.surface.positions.len();
        let mut points = Vec::new();
        for side in 0..courses.len() {
            let top = &mesh.positions[count * (1 + side * layers as usize + layers as usize - 1)..]
                [..count];
            points.extend_from_slice(top);
            points.extend(self.surface.faces().map(|face| {
                face.iter().map(|&v| top[v as usize]).sum::<DVec3>() / face.len() as f64
            }));
        }
        let found = self.tree.closest_all(&points);
        let shares: Vec<f64> = found
            .iter()
            .map(|c| c.distance_squared.sqrt() / distance)
            .collect();
        Ok(Thickness {
            min: shares.iter().copied().fold(f64::INFINITY, f64::min),
            mean: shares.iter().sum::<f64>() / shares.len() as f64,
            max: shares.iter().copied().fold(0.0, f64::max),
        })
    }
}

fn shape_over(face: &[u32]) -> CellShape {
    match face.len() {
        3 => CellShape::Prism,
        _ => CellShape::Hexahedron,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;
    use crate::progress::Silent;

    fn square(n: u32) -> PolygonMesh {
        let mut mesh = PolygonMesh::new(
            (0..(n + 1) * (n + 1))
                .map(|k| DVec3::new(f64::from(k % (n + 1)), f64::from(k / (n + 1)), 0.0))
                .collect(),
        );
        for k in 0..n * n {
            let a = k / n * (n + 1) + k % n;
            mesh.push_face(&[a, a + 1, a + n + 2, a + n + 1]);
        }
        mesh
    }

    fn made(surface: &PolygonMesh, layers: u32, distance: f64, side: Side) -> Shell {
        let made = shell(surface, layers, distance, side, &Silent).unwrap();
        assert_eq!(made.inverted, 0);
        made
    }

    #[test]
    fn an_open_sheet_becomes_a_plate() {
        let found = made(&square(4), 3, 0.6, Side::Both);
        assert_eq!(found.mesh.cell_count(), 2 * 3 * 16);
        assert!(
            found
                .mesh
                .cells()
                .all(|(shape, _)| shape == CellShape::Hexahedron)
        );
        let Thickness { min, mean, max } = found.thickness;
        assert!(
            min > 1.0 - 1e-3 && max < 1.0 + 1e-3 && (mean - 1.0).abs() < 1e-3,
            "{min} {max}"
        );
        assert_eq!(found.shortened, 0.0);
        let layers = found
            .mesh
            .positions
            .iter()
            .map(|p| (p.z / 0.2).round() as i64);
        assert_eq!((layers.clone().min(), layers.max()), (Some(-3), Some(3)));
    }

    #[test]
    fn a_sphere_has_a_shell_on_either_side() {
        for side in [Side::Outside, Side::Inside, Side::Both] {
            let sphere: PolygonMesh = shapes::sphere(1.0, 2).into();
            let found = made(&sphere, 2, 0.1, side);
            let Thickness { min, mean, max } = found.thickness;
            assert!(
                min > 0.9 && max < 1.1 && (mean - 1.0).abs() < 0.06,
                "{side:?}: {min} {mean} {max}"
            );
            assert_eq!(
                &found.mesh.positions[..sphere.positions.len()],
                &sphere.positions[..]
            );
        }
    }

    #[test]
    fn sharp_edges_are_followed() {
        let cube = shapes::box_grid(DVec3::ZERO, DVec3::ONE, [4; 3]);
        let found = made(&cube, 2, 0.1, Side::Both);
        assert!(
            found.thickness.min > 0.6 && found.thickness.mean > 0.85,
            "{:?}",
            found.thickness
        );
    }

    #[test]
    fn layers_from_opposite_sides_do_not_meet() {
        // A gap of 0.3 between two plates, and layers of 1.
        let below = square(6);
        let mut mesh = below.clone();
        mesh.positions
            .extend(below.positions.iter().map(|p| *p + 0.3 * DVec3::Z));
        let first = below.positions.len() as u32;
        for face in below.faces() {
            let turned: Vec<u32> = face.iter().rev().map(|v| v + first).collect();
            mesh.push_face(&turned);
        }
        let found = made(&mesh, 1, 1.0, Side::Outside);
        assert!(found.shortened > 0.9);
        let lower = |v: usize| v % (2 * first as usize) < first as usize;
        for (v, p) in found.mesh.positions.iter().enumerate() {
            assert!(if lower(v) { p.z < 0.15 } else { p.z > 0.15 }, "{p}");
        }
    }

    #[test]
    fn larger_and_hollow_faces_are_cut() {
        let corners = [
            (0.0, 0.0),
            (2.0, 0.0),
            (2.0, 1.0),
            (1.0, 2.0),
            (0.0, 1.0),
            (0.7, 0.5),
        ];
        let at = |&(x, y): &(f64, f64)| DVec3::new(x, y, 0.0);
        let positions: Vec<DVec3> = corners.iter().map(at).collect();
        let pentagon = PolygonMesh::from_faces(positions.clone(), [[0, 1, 2, 3, 4]]);
        assert_eq!(made(&pentagon, 1, 0.1, Side::Outside).mesh.cell_count(), 3);
        let hollow = PolygonMesh::from_faces(positions, [[0, 5, 4, 1]]);
        assert_eq!(made(&hollow, 1, 0.1, Side::Outside).mesh.cell_count(), 2);
    }

    #[test]
    fn what_cannot_be_extruded_is_refused() {
        let sheet = square(1);
        for (layers, distance) in [
            (0, 1.0),
            (1, 0.0),
            (1, -1.0),
            (1, f64::NAN),
            (u32::MAX, 1.0),
        ] {
            assert!(shell(&sheet, layers, distance, Side::Outside, &Silent).is_err());
        }
        assert!(shell(&PolygonMesh::default(), 1, 1.0, Side::Outside, &Silent).is_err());
        let mut flat = sheet.clone();
        flat.positions.fill(DVec3::X);
        assert!(shell(&flat, 1, 1.0, Side::Outside, &Silent).is_err());
        let twice = PolygonMesh::from_faces(sheet.positions.clone(), [[0, 1, 3, 2], [0, 1, 3, 2]]);
        assert!(shell(&twice, 1, 1.0, Side::Outside, &Silent).is_err());
    }
}
