//! The writer.

use super::super::{SurfaceToWrite, bounds, local_origin};
use crate::mesh::{Crease, Scheme};
use std::fmt::Display;
use std::io::{self, Write};

pub fn write(out: &mut dyn Write, surface: &SurfaceToWrite<'_>) -> io::Result<()> {
    let mesh = surface.mesh;
    let origin = local_origin(mesh);
    let (lo, hi) = bounds(mesh);
    let local = |p: glam::DVec3| vector((p - origin).as_vec3().to_array());
    let sharpness = |s: f64| s.min(Crease::INFINITE);
    let scheme = match surface.scheme {
        Scheme::Polygon => "none",
        Scheme::CatmullClark => "catmullClark",
        Scheme::Loop => "loop",
    };
    writeln!(out, "#usda 1.0\n(\n    defaultPrim = \"surface\"")?;
    writeln!(
        out,
        "    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\ndef Mesh \"surface\"\n{{"
    )?;
    writeln!(out, "    uniform token subdivisionScheme = \"{scheme}\"")?;
    writeln!(out, "    uniform token orientation = \"rightHanded\"")?;
    writeln!(out, "    token interpolateBoundary = \"edgeAndCorner\"")?;
    writeln!(out, "    bool doubleSided = 1")?;
    array(out, "float3[] extent", [local(lo), local(hi)])?;
    writeln!(
        out,
        "    double3 xformOp:translate = {}",
        vector(origin.to_array())
    )?;
    writeln!(
        out,
        "    uniform token[] xformOpOrder = [\"xformOp:translate\"]"
    )?;
    array(
        out,
        "point3f[] points",
        mesh.positions.iter().map(|&p| local(p)),
    )?;
    array(
        out,
        "int[] faceVertexCounts",
        mesh.faces().map(<[u32]>::len),
    )?;
    array(out, "int[] faceVertexIndices", mesh.faces().flatten())?;
    let creases = surface.creases;
    if !creases.is_empty() {
        array(
            out,
            "int[] creaseIndices",
            creases.iter().flat_map(|c| c.edge),
        )?;
        array(
            out,
            "int[] creaseLengths",
            creases.iter().map(|c| c.edge.len()),
        )?;
        array(
            out,
            "float[] creaseSharpnesses",
            creases.iter().map(|c| sharpness(c.sharpness)),
        )?;
    }
    if !surface.corners.is_empty() {
        array(out, "int[] cornerIndices", surface.corners)?;
        array(
            out,
            "float[] cornerSharpnesses",
            surface.corners.iter().map(|_| Crease::INFINITE),
        )?;
    }
    if let Some(error) = surface.error {
        let error = error.iter().map(|&e| e as f32);
        assignment(out, "float[] primvars:error", error)?;
        writeln!(out, " (\n        interpolation = \"vertex\"\n    )")?;
    }
    writeln!(out, "}}")
}

fn vector(v: [impl Display; 3]) -> String {
    let [x, y, z] = v;
    format!("({x}, {y}, {z})")
}

fn array(
    out: &mut dyn Write,
    name: &str,
    values: impl IntoIterator<Item = impl Display>,
) -> io::Result<()> {
    assignment(out, name, values)?;
    writeln!(out)
}

/// An array without the line's end, for metadata to follow.
fn assignment(
    out: &mut dyn Write,
    name: &str,
    values: impl IntoIterator<Item = impl Display>,
) -> io::Result<()> {
    write!(out, "    {name} = [")?;
    for (k, value) in values.into_iter().enumerate() {
        write!(out, "{}{value}", if k == 0 { "" } else { ", " })?;
    }
    write!(out, "]")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{ControlMesh, PolygonMesh};
    use glam::DVec3;

    fn written(surface: &SurfaceToWrite<'_>) -> String {
        let mut out = Vec::new();
        write(&mut out, surface).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn sharpness_and_scheme_are_written_in_usd_terms() {
        let points = vec![DVec3::ZERO, DVec3::X, DVec3::ONE, DVec3::Y];
        let mut control = ControlMesh::from(PolygonMesh::from_faces(points, [[0, 1, 2, 3]]));
        control.creases = vec![
            Crease {
                edge: [0, 1],
                sharpness: f64::INFINITY,
            },
            Crease {
                edge: [2, 1],
                sharpness: 2.5,
            },
        ];
        control.corners = vec![3];
        let text = written(&SurfaceToWrite::control(&control, Scheme::CatmullClark));
        for line in [
            "subdivisionScheme = \"catmullClark\"",
            "creaseIndices = [0, 1, 2, 1]",
            "creaseLengths = [2, 2]",
            "creaseSharpnesses = [10, 2.5]",
            "cornerIndices = [3]",
            "cornerSharpnesses = [10]",
            "points = [(0, 0, 0), (1, 0, 0), (1, 1, 1), (0, 1, 0)]",
            "faceVertexIndices = [0, 1, 2, 3]",
            "translate = (0, 0, 0)",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
    }

    #[test]
    fn far_from_the_origin_the_translation_keeps_the_digits() {
        let points = [DVec3::ZERO, DVec3::X * 2.0, DVec3::Y * 2.0].map(|p| p + 5e6);
        let mesh = PolygonMesh::from_faces(points.to_vec(), [[0, 1, 2]]);
        let text = written(&SurfaceToWrite::dense(&mesh, Some(&[0.5, 0.0, 1.0])));
        assert!(
            text.contains("translate = (5000001, 5000001, 5000000)"),
            "{text}"
        );
        assert!(
            text.contains("points = [(-1, -1, 0), (1, -1, 0), (-1, 1, 0)]"),
            "{text}"
        );
        assert!(text.contains("primvars:error = [0.5, 0, 1] (") && !text.contains("crease"));
    }
}
