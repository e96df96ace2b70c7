//! Surfaces from files and into files, one file per format. Volume meshes: [`volume`].
//!
//! Reading: [`read_surface`] takes OBJ, PLY, STL, OFF and USD text by extension, checks what it read at the door ([`crate::mesh::check`]) and counts
//! the flaws that it accepted. Readers never trust a length or an index: memory grows with the bytes that are there, not with what a
//! header claims. [`read_scans`] also takes points without faces, from PLY and XYZ, and several files as one.
//!
//! Writing: [`write_surface`] takes a [`SurfaceToWrite`] and the format's extension. What a format cannot hold it refuses, and names one
//! that can: a file never means another surface than the one given. Every file goes through [`write_whole`].
//!
//! | extension | read | written | precision | holds |
//! | --- | --- | --- | --- | --- |
//! | `.obj` | yes | yes | f64 | polygons, creases, corners |
//! | `.ply` | yes | binary | f64 | polygons, error per vertex |
//! | `.off` | yes | yes | f64 | polygons |
//! | `.stl` | yes | binary | f32 | triangles |
//! | `.xyz` | as points | no | f64 | points |
//! | `.usda` | yes | yes | f32 about a local origin | polygons, scheme, creases, corners, error per vertex |
//! | `.glb` | no | yes | f32 about a local origin | triangles, normals, error per vertex as colours |

mod atomic;
pub mod curves;
mod glb;
mod obj;
mod off;
mod ply;
mod poses;
mod range_grid;
mod scan;
mod stl;
mod usd;
pub mod volume;
mod xyz;

pub use atomic::{check_place, write_whole};
pub use scan::{Scan, read_scans};
pub use volume::{
    Pyramids, Volume, VolumeToWrite, check_volume_writable, read_volume, volume_from_bytes,
    write_volume,
};

use crate::error::{Defect, Error, Result};
use crate::mesh::check::{self, Census};
use crate::mesh::{ControlMesh, Crease, PolygonMesh, Scheme};
use glam::DVec3;
use std::path::Path;

/// A surface as it was in its file.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// Its vertices and faces, sound in the sense of [`check::sound`].
    pub mesh: PolygonMesh,
    /// Its sizes and flaws.
    pub census: Census,
    /// `[vertices]`, how much each is to be trusted; empty where the file (a PLY with a property `confidence`) does not say.
    pub confidence: Vec<f64>,
}

/// Reads a surface; the format is told by the extension, in any case of letters.
///
/// Vertices keep the file's order. OBJ and STL, which repeat positions at seams, have equal positions merged
/// ([`crate::mesh::weld`]). Colours, normals and texture coordinates are passed over.
///
/// # Errors
/// Where the file cannot be read, is of another format than its name says, is truncated or malformed, holds points only, or fails
/// [`check::sound`].
pub fn read_surface(path: &Path) -> Result<Surface> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    surface_from_bytes(path, &bytes)
}

/// Like [`read_surface`], with the content of the file given; `path` says the format and is named in errors.
///
/// # Errors
/// As [`read_surface`].
pub fn surface_from_bytes(path: &Path, bytes: &[u8]) -> Result<Surface> {
    draft(path, bytes)
        .and_then(surface)
        .map_err(|defect| defect.in_file(path))
}

fn surface(draft: Draft) -> Result<Surface, Defect> {
    check::sound(&draft.mesh)?;
    let mut census = Census::of(&draft.mesh);
    census.short_faces = draft.short_faces;
    Ok(Surface {
        mesh: draft.mesh,
        census,
        confidence: draft.confidence,
    })
}

/// The distances at the vertices of a PLY surface, as [`write_surface`] writes them; none where the file has none, or is of another format.
///
/// # Errors
/// As [`read_surface`], and where a distance is not finite.
pub fn read_error(path: &Path) -> Result<Option<Vec<f64>>> {
    if !Format::of(path).is_ok_and(|format| format == Format::Ply) {
        return Ok(None);
    }
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    let error = ply::read_error(&bytes).map_err(|defect| defect.in_file(path))?;
    match error.iter().flatten().position(|e| !e.is_finite()) {
        Some(v) => Err(Error::file(
            path,
            format!("vertex {v} (counted from 0)"),
            "its error is not finite",
            "write the file again",
        )),
        None => Ok(error),
    }
}

/// Reads a control mesh: a surface with the edges and vertices that stay sharp under subdivision, where the format holds them (see the
/// table of [`crate::files`]).
///
/// # Errors
/// As [`read_surface`], and where a crease or corner is not on the mesh or a corner is semi-sharp.
pub fn read_control(path: &Path) -> Result<ControlMesh> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    draft(path, &bytes)
        .and_then(|draft| {
            check::sound(&draft.mesh)?;
            Ok(ControlMesh {
                mesh: draft.mesh,
                creases: draft.creases,
                corners: draft.sharp_corners,
            })
        })
        .map_err(|defect| defect.in_file(path))
}

fn draft(path: &Path, bytes: &[u8]) -> Result<Draft, Defect> {
    let format = Format::of(path)?;
    if bytes.is_empty() {
        return Err(Defect::new("start", "the file is empty", "export it again"));
    }
    if let Some(content) = Format::sniff(bytes)
        && content != format
    {
        return Err(Defect::new(
            "start",
            format!("the name says {format:?}, the content {content:?}"),
            "give the file the extension of its content",
        ));
    }
    match format {
        Format::Obj => obj::read(bytes),
        Format::Ply => ply::read(bytes),
        Format::Stl => stl::read(bytes),
        Format::Off => off::read(bytes),
        Format::Usda => usd::read(bytes),
        Format::Glb => Err(Defect::new(
            "extension",
            "Glb is written here but not read",
            "give an .obj, .ply, .stl, .off or .usda file",
        )),
    }
}

/// What goes into a file: a mesh, the surface it stands for, and what decorates it.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceToWrite<'a> {
    mesh: &'a PolygonMesh,
    scheme: Scheme,
    creases: &'a [Crease],
    corners: &'a [u32],
    error: Option<&'a [f64]>,
}

impl<'a> SurfaceToWrite<'a> {
    /// A surface that is its own faces. `error`: `[vertices]`, a distance in the mesh's units, written where the format has a place for
    /// it (see the table of [`crate::files`]) and left out elsewhere.
    pub fn dense(mesh: &'a PolygonMesh, error: Option<&'a [f64]>) -> Self {
        Self {
            mesh,
            scheme: Scheme::Polygon,
            creases: &[],
            corners: &[],
            error,
        }
    }

    /// A control mesh of a subdivision surface (or, with [`Scheme::Polygon`], a polygon mesh).
    pub fn control(control: &'a ControlMesh, scheme: Scheme) -> Self {
        Self {
            mesh: &control.mesh,
            scheme,
            creases: &control.creases,
            corners: &control.corners,
            error: None,
        }
    }

    /// Whether everything that refers to the mesh fits it.
    fn check(&self) -> Result<(), Defect> {
        check::sound(self.mesh)?;
        let vertices = self.mesh.positions.len();
        let outside = |&v: &u32| v as usize >= vertices;
        let refuse = |place: &str, problem: String| {
            Err(Defect::new(place, problem, "give the data of this mesh"))
        };
        if let Some(v) = self.corners.iter().copied().find(outside) {
            return refuse("corners", format!("vertex {v} of {vertices}"));
        }
        if let Some(crease) = self
            .creases
            .iter()
            .find(|c| c.edge.iter().any(outside) || c.sharpness.is_nan() || c.sharpness < 0.0)
        {
            return refuse("creases", format!("{crease:?} with {vertices} vertices"));
        }
        if self.scheme == Scheme::Loop && self.mesh.faces().any(|f| f.len() != 3) {
            return refuse("scheme", "a Loop surface has triangles only".into());
        }
        match self.error {
            Some(error) if error.len() != vertices => refuse(
                "error",
                format!("{} values for {vertices} vertices", error.len()),
            ),
            Some(error) if error.iter().any(|e| !e.is_finite()) => {
                refuse("error", "a value is not finite".into())
            }
            _ => Ok(()),
        }
    }
}

/// Whether [`write_surface`] would take the surface under this name: to be asked, with [`check_place`], before the work.
///
/// # Errors
/// Where the extension is unknown, the format cannot hold the surface, or the surface is not consistent.
pub fn check_writable(path: &Path, surface: &SurfaceToWrite<'_>) -> Result<()> {
    Format::of(path)
        .and_then(|format| format.check_holds(surface))
        .and_then(|()| surface.check())
        .map_err(|defect| defect.in_file(path))
}

/// Writes a surface, whole or not at all; the format is told by the extension.
///
/// # Errors
/// As [`check_writable`], and where the file cannot be written.
pub fn write_surface(path: &Path, surface: &SurfaceToWrite<'_>) -> Result<()> {
    check_writable(path, surface)?;
    let format = Format::of(path).map_err(|defect| defect.in_file(path))?;
    write_whole(path, |out| match format {
        Format::Obj => obj::write(out, surface),
        Format::Ply => ply::write(out, surface.mesh, surface.error),
        Format::Stl => stl::write(out, surface.mesh),
        Format::Off => off::write(out, surface.mesh),
        Format::Usda => usd::write(out, surface),
        Format::Glb => glb::write(out, surface.mesh, surface.error),
    })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Obj,
    Ply,
    Stl,
    Off,
    Usda,
    Glb,
}

impl Format {
    fn of(path: &Path) -> Result<Self, Defect> {
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        Ok(match extension.to_str() {
            Some("obj") => Self::Obj,
            Some("ply") => Self::Ply,
            Some("stl") => Self::Stl,
            Some("off") => Self::Off,
            Some("usda") => Self::Usda,
            Some("glb") => Self::Glb,
            _ => {
                return Err(Defect::new(
                    "extension",
                    format!("{extension:?} is no format of surfaces known here"),
                    "use .obj, .ply, .stl, .off or .usda, or for output also .glb",
                ));
            }
        })
    }

    /// The format that the content declares itself to be, where it does. OBJ declares nothing.
    fn sniff(bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
            Some(Self::Ply)
        } else if bytes.starts_with(b"glTF") {
            Some(Self::Glb)
        } else if bytes.starts_with(b"#usda") {
            Some(Self::Usda)
        } else if off::has_magic(bytes) {
            Some(Self::Off)
        } else {
            stl::recognize(bytes).map(|_| Self::Stl)
        }
    }

    /// Whether the format can say what the surface is.
    fn check_holds(self, surface: &SurfaceToWrite<'_>) -> Result<(), Defect> {
        let refuse = |problem: &str, remedy: &str| {
            Err(Defect::new(
                "extension",
                format!("{self:?} {problem}"),
                remedy,
            ))
        };
        let sharp = !(surface.creases.is_empty() && surface.corners.is_empty());
        match self {
            Self::Usda | Self::Obj => Ok(()),
            Self::Stl | Self::Glb if surface.scheme != Scheme::Polygon => refuse(
                "has no subdivision surfaces",
                "write the control mesh as .obj or .usda, or the dense surface to this file",
            ),
            _ if sharp => refuse("has no creases or corners", "write a .usda or .obj file"),
            Self::Stl => stl::check_holds(surface.mesh),
            _ => Ok(()),
        }
    }
}

/// A mesh while its file is read.
#[derive(Default)]
struct Draft {
    mesh: PolygonMesh,
    creases: Vec<Crease>,
    /// Vertices that stay sharp.
    sharp_corners: Vec<u32>,
    /// `[vertices]`, or empty where the file has none.
    normals: Vec<DVec3>,
    /// `[vertices]`, or empty where the file has none.
    confidence: Vec<f64>,
    corners: usize,
    short_faces: usize,
    /// The corners of the last face, kept for its memory.
    face: Vec<u32>,
}

impl Draft {
    fn new(positions: Vec<DVec3>) -> Self {
        Self {
            mesh: PolygonMesh::new(positions),
            ..Self::default()
        }
    }

    /// Appends a face of indices as the file has them, counted from 0. Faces of fewer than three corners are only counted.
    fn push_face(&mut self, corners: &[i64], place: impl Fn() -> String) -> Result<(), Defect> {
        if corners.len() < 3 {
            self.short_faces += 1;
            return Ok(());
        }
        let vertices = self.mesh.positions.len();
        let inside = |v: i64| usize::try_from(v).is_ok_and(|v| v < vertices);
        if let Some(v) = corners.iter().find(|&&v| !inside(v)) {
            return Err(Defect::new(
                place(),
                format!("it names vertex {v} (counted from 0) of {vertices}"),
                "the file is damaged: export it again",
            ));
        }
        self.corners += corners.len();
        if self.corners > u32::MAX as usize || vertices > u32::MAX as usize {
            return Err(Defect::new(
                place(),
                "there are more than 4,294,967,295 vertices or corners",
                "decimate the mesh or split it",
            ));
        }
        self.face.clear();
        self.face.extend(corners.iter().map(|&v| v as u32));
        self.mesh.push_face(&self.face);
        Ok(())
    }

    /// Appends a crease between vertices counted from 0; none where the sharpness is 0.
    fn push_crease(
        &mut self,
        edge: [i64; 2],
        sharpness: f64,
        place: impl Fn() -> String,
    ) -> Result<(), Defect> {
        let [a, b] = edge.map(|v| self.sharp_vertex(v, sharpness, &place));
        let edge = [a?, b?];
        if sharpness > 0.0 {
            self.creases.push(Crease { edge, sharpness });
        }
        Ok(())
    }

    /// Appends a vertex, counted from 0, that stays sharp; none where the sharpness is 0.
    fn push_corner(
        &mut self,
        vertex: i64,
        sharpness: f64,
        place: impl Fn() -> String,
    ) -> Result<(), Defect> {
        let vertex = self.sharp_vertex(vertex, sharpness, &place)?;
        if sharpness >= Crease::INFINITE {
            self.sharp_corners.push(vertex);
        } else if sharpness > 0.0 {
            return Err(Defect::new(
                place(),
                format!("vertex {vertex} is a semi-sharp corner, of sharpness {sharpness}"),
                "make that 10 or 0: corners are sharp for ever here",
            ));
        }
        Ok(())
    }

    /// A vertex of the mesh, if the sharpness is one.
    fn sharp_vertex(
        &self,
        vertex: i64,
        sharpness: f64,
        place: impl Fn() -> String,
    ) -> Result<u32, Defect> {
        let vertices = self.mesh.positions.len();
        u32::try_from(vertex)
            .ok()
            .filter(|&v| (v as usize) < vertices && sharpness >= 0.0)
            .ok_or_else(|| {
                Defect::new(
                    place(),
                    format!(
                        "vertex {vertex} (counted from 0) of {vertices} is sharp by {sharpness}"
                    ),
                    "the file is damaged: export it again",
                )
            })
    }
}

/// A word of a file, fit for an error message of one line.
fn quoted(word: &str) -> String {
    let start: String = word.chars().take(40).collect();
    format!("{start:?}")
}

/// The origin for f32 coordinates: 0, or the centre of the bounding box where that is further from 0 than the box is large and
/// f32 would lose the shape in the distance.
fn local_origin(mesh: &PolygonMesh) -> DVec3 {
    let (lo, hi) = bounds(mesh);
    let center = lo + 0.5 * (hi - lo);
    if center.length() > (hi - lo).length() {
        center
    } else {
        DVec3::ZERO
    }
}

/// Minimum and maximum over all vertices, of which there is at least one.
fn bounds(mesh: &PolygonMesh) -> (DVec3, DVec3) {
    mesh.positions
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), &p| {
            (lo.min(p), hi.max(p))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad() -> ControlMesh {
        let points = vec![DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y];
        PolygonMesh::from_faces(points, [[0, 1, 2, 3]]).into()
    }

    fn refusal(name: &str, surface: &SurfaceToWrite<'_>) -> String {
        check_writable(Path::new(name), surface)
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn what_a_format_cannot_hold_is_refused_with_an_alternative() {
        let mut control = quad();
        for name in ["a.stl", "a.GLB"] {
            let cage = SurfaceToWrite::control(&control, Scheme::CatmullClark);
            assert!(refusal(name, &cage).contains("dense surface"));
            assert!(
                check_writable(Path::new(name), &SurfaceToWrite::dense(&control.mesh, None))
                    .is_ok()
            );
        }
        control.corners = vec![2];
        for name in ["a.ply", "a.off"] {
            let cage = SurfaceToWrite::control(&control, Scheme::CatmullClark);
            assert!(refusal(name, &cage).contains(".usda"));
        }
        let cage = SurfaceToWrite::control(&control, Scheme::Loop);
        assert!(refusal("a.usda", &cage).contains("triangles only"));
        assert!(refusal("a.xyz", &cage).contains("use .obj"));
        assert!(refusal("a", &cage).contains("use .obj"));
    }

    #[test]
    fn data_of_another_mesh_is_refused() {
        let mut control = quad();
        assert!(
            refusal("a.ply", &SurfaceToWrite::dense(&control.mesh, Some(&[0.0])))
                .contains("1 values")
        );
        assert!(
            refusal(
                "a.ply",
                &SurfaceToWrite::dense(&control.mesh, Some(&[f64::NAN; 4]))
            )
            .contains("finite")
        );
        control.corners = vec![4];
        assert!(
            refusal(
                "a.usda",
                &SurfaceToWrite::control(&control, Scheme::CatmullClark)
            )
            .contains("corners")
        );
        control.corners.clear();
        for (edge, sharpness) in [([0, 4], 1.0), ([0, 1], f64::NAN), ([0, 1], -1.0)] {
            control.creases = vec![Crease { edge, sharpness }];
            assert!(
                refusal(
                    "a.usda",
                    &SurfaceToWrite::control(&control, Scheme::CatmullClark)
                )
                .contains("creases")
            );
        }
        assert!(
            refusal(
                "a.obj",
                &SurfaceToWrite::dense(&PolygonMesh::default(), None)
            )
            .contains("no faces")
        );
    }

    #[test]
    fn a_name_that_lies_about_the_content_is_refused() {
        let contents: [(&str, &[u8]); 4] = [
            ("Ply", b"ply\nformat ascii 1.0\n"),
            ("Off", b"OFF\n0 0 0"),
            ("Stl", b"solid a\nendsolid"),
            ("Glb", b"glTF\x02\0\0\0"),
        ];
        for (format, content) in contents {
            for extension in ["obj", "ply", "stl", "off"] {
                let path = format!("a.{extension}");
                let message = surface_from_bytes(Path::new(&path), content)
                    .unwrap_err()
                    .to_string();
                let lies = !format.eq_ignore_ascii_case(extension);
                assert_eq!(
                    message.contains("the name says"),
                    lies,
                    "{path} {format}: {message}"
                );
            }
        }
    }
}
