//! Lines and points with numbers on them: PLY, OBJ and VTK's .vtp.
//!
//! | format | lines | numbers |
//! | --- | --- | --- |
//! | .vtp | polylines and single vertices | every column, of points and of lines |
//! | .ply | an element `edge` of pairs of vertices | every column, at vertices; and a colour each |
//! | .obj | `l` and `p` | none: a group for each name |
//!
//! Of PLY readers, MeshLab's takes edges; meshio's refuses every file that has more than vertices and faces.

use super::write_whole;
use crate::error::{Defect, Result};
use glam::DVec3;
use std::io::{self, Write};
use std::path::Path;

/// A line, or a point where it has one vertex only.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// What it is called in an .obj file: one word.
    pub name: &'static str,
    /// At least one.
    pub points: Vec<DVec3>,
    /// `[points, columns]`.
    pub values: Vec<Vec<f64>>,
    /// Red, green and blue.
    pub color: [u8; 3],
}

/// Writes curves, whole or not at all; the format is told by the extension. `columns` names the numbers of the points, each with one word.
///
/// # Errors
/// Where the extension is none of .vtp, .ply and .obj, or the file cannot be written.
pub fn write_curves(path: &Path, columns: &[&str], curves: &[Curve]) -> Result<()> {
    let format = Format::of(path)?;
    write_whole(path, |out| match format {
        Format::Vtp => vtp(out, columns, curves),
        Format::Ply => ply(out, columns, curves),
        Format::Obj => obj(out, curves),
    })
}

/// Whether [`write_curves`] knows the extension.
///
/// # Errors
/// Where it does not.
pub fn check_curves(path: &Path) -> Result<()> {
    Format::of(path).map(|_| ())
}

#[derive(Debug, Clone, Copy)]
enum Format {
    Vtp,
    Ply,
    Obj,
}

impl Format {
    fn of(path: &Path) -> Result<Self> {
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        match extension.to_str() {
            Some("vtp") => Ok(Self::Vtp),
            Some("ply") => Ok(Self::Ply),
            Some("obj") => Ok(Self::Obj),
            _ => Err(Defect::new(
                "extension",
                format!("{extension:?} is no format of lines known here"),
                "use .vtp, .ply or .obj",
            )
            .in_file(path)),
        }
    }
}

fn vtp(out: &mut dyn Write, columns: &[&str], curves: &[Curve]) -> io::Result<()> {
    let point_count: usize = curves.iter().map(|curve| curve.points.len()).sum();
    let is_point = |curve: &&Placed<'_>| curve.1.points.len() == 1;
    let (points, lines): (Vec<_>, Vec<_>) = placed(curves).partition(|curve| is_point(&curve));
    writeln!(
        out,
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\">\n<PolyData>\n\
         <Piece NumberOfPoints=\"{point_count}\" NumberOfVerts=\"{}\" NumberOfLines=\"{}\" NumberOfStrips=\"0\" NumberOfPolys=\"0\">",
        points.len(),
        lines.len()
    )?;
    writeln!(out, "<PointData>")?;
    for (k, column) in columns.iter().enumerate() {
        open(out, "Float64", column, 1)?;
        for value in curves.iter().flat_map(|curve| &curve.values) {
            writeln!(out, "{}", value[k])?;
        }
        close(out)?;
    }
    open(out, "UInt8", "color", 3)?;
    for curve in curves {
        let [r, g, b] = curve.color;
        for _ in &curve.points {
            writeln!(out, "{r} {g} {b}")?;
        }
    }
    close(out)?;
    writeln!(out, "</PointData>\n<Points>")?;
    open(out, "Float64", "Points", 3)?;
    for p in curves.iter().flat_map(|curve| &curve.points) {
        writeln!(out, "{} {} {}", p.x, p.y, p.z)?;
    }
    close(out)?;
    writeln!(out, "</Points>")?;
    for (tag, cells) in [("Verts", points), ("Lines", lines)] {
        writeln!(out, "<{tag}>")?;
        open(out, "Int64", "connectivity", 1)?;
        for (first, curve) in &cells {
            for v in *first..first + curve.points.len() {
                writeln!(out, "{v}")?;
            }
        }
        close(out)?;
        open(out, "Int64", "offsets", 1)?;
        let mut end = 0;
        for (_, curve) in &cells {
            end += curve.points.len();
            writeln!(out, "{end}")?;
        }
        close(out)?;
        writeln!(out, "</{tag}>")?;
    }
    writeln!(out, "</Piece>\n</PolyData>\n</VTKFile>")
}

fn open(out: &mut dyn Write, kind: &str, name: &str, width: usize) -> io::Result<()> {
    writeln!(
        out,
        "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{width}\" format=\"ascii\">"
    )
}

fn close(out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "</DataArray>")
}

/// A curve and the place of its first point among all points.
type Placed<'a> = (usize, &'a Curve);

fn placed(curves: &[Curve]) -> impl Iterator<Item = Placed<'_>> {
    curves.iter().scan(0, |next, curve| {
        let first = *next;
        *next += curve.points.len();
        Some((first, curve))
    })
}

fn ply(out: &mut dyn Write, columns: &[&str], curves: &[Curve]) -> io::Result<()> {
    let points: usize = curves.iter().map(|curve| curve.points.len()).sum();
    let edges = points - curves.len();
    writeln!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment vorofit features\nelement vertex {points}"
    )?;
    for name in ["x", "y", "z"].iter().chain(columns) {
        writeln!(out, "property double {name}")?;
    }
    writeln!(
        out,
        "property uchar red\nproperty uchar green\nproperty uchar blue"
    )?;
    writeln!(
        out,
        "element edge {edges}\nproperty int vertex1\nproperty int vertex2\nend_header"
    )?;
    for curve in curves {
        for (p, values) in curve.points.iter().zip(&curve.values) {
            for x in p.to_array().iter().chain(values) {
                out.write_all(&x.to_le_bytes())?;
            }
            out.write_all(&curve.color)?;
        }
    }
    for (first, curve) in placed(curves) {
        for v in first..first + curve.points.len() - 1 {
            for end in [v as i32, v as i32 + 1] {
                out.write_all(&end.to_le_bytes())?;
            }
        }
    }
    Ok(())
}

fn obj(out: &mut dyn Write, curves: &[Curve]) -> io::Result<()> {
    writeln!(out, "# vorofit features")?;
    for p in curves.iter().flat_map(|curve| &curve.points) {
        writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
    }
    let mut group = "";
    for (first, curve) in placed(curves) {
        if curve.name != group {
            group = curve.name;
            writeln!(out, "g {group}")?;
        }
        write!(out, "{}", if curve.points.len() == 1 { "p" } else { "l" })?;
        for v in first..first + curve.points.len() {
            write!(out, " {}", v + 1)?;
        }
        writeln!(out)?;
    }
    Ok(())
}
