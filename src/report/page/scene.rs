//! The geometry of a page: quantized, as base64 in JSON.
//!
//! All layers share a cube whose side is the longest of their common box. A vertex is six u16, little endian: x, y, z, (1 + value) / 2, and the normal
//! folded onto an octahedron (two). Triangles and edges are u32. Lines of features are pairs of ends, each four u16: x, y, z and nothing.

use super::thin::thinned;
use crate::mesh::{PolygonMesh, TriangleMesh};
use crate::picture::color::{self, Rgb};
use crate::picture::{Axis, Shape, Strokes, edges};
use crate::report::feature_layers::FeatureLayer;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use glam::DVec3;
use serde::Serialize;

/// Triangles (points of a cloud) of a layer on a page: 25 bytes each.
pub(super) const LIMIT: usize = 300_000;

/// What the script of the page reads.
#[derive(Serialize)]
pub(super) struct Scene {
    /// The axis that is upwards at first.
    up: &'static str,
    /// The sides of the common box, the longest 1.
    extent: [f64; 3],
    /// The colour map: bytes of sRGB.
    colors: String,
    unknown: Rgb,
    layers: Layers,
    features: Vec<Sort>,
}

/// Features of one sort.
#[derive(Serialize)]
struct Sort {
    name: &'static str,
    color: Rgb,
    lines: Vec<Lines>,
}

#[derive(Serialize)]
struct Lines {
    /// In pixels.
    width: f64,
    ends: String,
}

#[derive(Serialize)]
struct Layers {
    target: Layer,
    cage: Layer,
    surface: Layer,
}

#[derive(Serialize)]
struct Layer {
    vertex_count: usize,
    /// How many; a layer without is points.
    triangles: usize,
    vertices: String,
    indices: String,
    /// Pairs of vertices; of the cage.
    #[serde(skip_serializing_if = "Option::is_none")]
    edges: Option<String>,
    color: Rgb,
    /// Whether the values mean something.
    valued: bool,
}

/// The layers of a page.
pub(super) struct Parts<'a> {
    pub target: &'a TriangleMesh,
    pub features: &'a [FeatureLayer],
    pub cage: &'a PolygonMesh,
    pub surface: &'a TriangleMesh,
    /// `[surface vertices]`: shares of the colour map, negative where unknown.
    pub values: Option<&'a [f64]>,
    pub up: Axis,
}

impl Scene {
    pub(super) fn new(parts: &Parts<'_>) -> Self {
        let all = [
            &parts.target.positions,
            &parts.cage.positions,
            &parts.surface.positions,
        ];
        let cube = Cube::around(all.into_iter().flatten().copied());
        let (surface, sources) = thinned(parts.surface, LIMIT);
        let values = parts.values.map(|values| {
            let of = |&v: &u32| values[v as usize];
            sources.iter().map(of).collect::<Vec<_>>()
        });
        let (target, _) = thinned(parts.target, LIMIT);
        let target = match target.triangles.is_empty() {
            true => cloud(&target),
            false => Shape::smooth(&target),
        };
        Self {
            up: match parts.up {
                Axis::X => "x",
                Axis::Y => "y",
                Axis::Z => "z",
            },
            extent: (cube.extent / cube.side).to_array(),
            colors: BASE64_STANDARD.encode(color_table()),
            unknown: color::UNKNOWN,
            layers: Layers {
                target: cube.layer(&target, None, color::TARGET),
                cage: cube.cage(parts.cage),
                surface: cube.layer(&Shape::smooth(&surface), values.as_deref(), color::CAGE),
            },
            features: parts.features.iter().map(|sort| cube.sort(sort)).collect(),
        }
    }
}

fn color_table() -> Vec<u8> {
    let steps = (0..color::STEPS).map(|k| color::map(k as f64 / (color::STEPS - 1) as f64));
    steps.flatten().collect()
}

/// Points as vertices without normals.
fn cloud(mesh: &TriangleMesh) -> Shape {
    let count = mesh.positions.len();
    Shape {
        positions: mesh.positions.clone(),
        normals: vec![DVec3::ZERO; count],
        sources: (0..count as u32).collect(),
        triangles: Vec::new(),
    }
}

/// The space that positions are quantized in.
struct Cube {
    low: DVec3,
    extent: DVec3,
    side: f64,
}

impl Cube {
    fn around(points: impl Iterator<Item = DVec3>) -> Self {
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (low, high) = points.fold(start, |(lo, hi), p| (lo.min(p), hi.max(p)));
        let extent = high - low;
        Self {
            low,
            extent,
            side: extent.max_element().max(f64::MIN_POSITIVE),
        }
    }

    fn layer(&self, shape: &Shape, values: Option<&[f64]>, color: Rgb) -> Layer {
        let mut words: Vec<u16> = Vec::with_capacity(6 * shape.positions.len());
        for ((&p, &n), &v) in shape
            .positions
            .iter()
            .zip(&shape.normals)
            .zip(&shape.sources)
        {
            let value = values.map_or(0.0, |values| values[v as usize].clamp(-1.0, 1.0));
            let [x, y, z] = ((p - self.low) / self.side).to_array();
            let [a, b] = octahedral(n);
            words.extend([x, y, z, 0.5 + 0.5 * value, 0.5 + 0.5 * a, 0.5 + 0.5 * b].map(quantized));
        }
        Layer {
            vertex_count: shape.positions.len(),
            triangles: shape.triangles.len(),
            vertices: encoded(words.into_iter().flat_map(u16::to_le_bytes)),
            indices: encoded(
                shape
                    .triangles
                    .as_flattened()
                    .iter()
                    .flat_map(|v| v.to_le_bytes()),
            ),
            edges: None,
            color,
            valued: values.is_some(),
        }
    }

    fn sort(&self, sort: &FeatureLayer) -> Sort {
        let words = |p: &DVec3| {
            let [x, y, z] = ((*p - self.low) / self.side).to_array().map(quantized);
            [x, y, z, 0]
        };
        let lines = |strokes: &Strokes| Lines {
            width: strokes.width,
            ends: encoded(
                (strokes.segments.as_flattened().iter())
                    .flat_map(words)
                    .flat_map(u16::to_le_bytes),
            ),
        };
        Sort {
            name: sort.name,
            color: sort.color,
            lines: sort.strokes.iter().map(lines).collect(),
        }
    }

    fn cage(&self, mesh: &PolygonMesh) -> Layer {
        let shape = Shape::faceted(mesh);
        // Every face has vertices of its own: an edge takes any of those that stand for its ends.
        let mut copies = vec![0; mesh.positions.len()];
        for (copy, &v) in shape.sources.iter().enumerate() {
            copies[v as usize] = copy as u32;
        }
        let edges = edges(mesh).into_iter().flatten();
        let ends = edges.flat_map(|v| copies[v as usize].to_le_bytes());
        Layer {
            edges: Some(encoded(ends)),
            ..self.layer(&shape, None, color::CAGE)
        }
    }
}

fn encoded(bytes: impl Iterator<Item = u8>) -> String {
    BASE64_STANDARD.encode(bytes.collect::<Vec<_>>())
}

fn quantized(share: f64) -> u16 {
    (share.clamp(0.0, 1.0) * f64::from(u16::MAX)).round() as u16
}

/// A unit vector on the octahedron |x| + |y| + |z| = 1, whose lower half is folded outwards; 0 becomes the pole.
fn octahedral(n: DVec3) -> [f64; 2] {
    let size = n.abs().element_sum();
    if size == 0.0 {
        return [0.0, 0.0];
    }
    let n = n / size;
    match n.z >= 0.0 {
        true => [n.x, n.y],
        false => [
            (1.0 - n.y.abs()) * 1f64.copysign(n.x),
            (1.0 - n.x.abs()) * 1f64.copysign(n.y),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As the page's shader does it.
    fn unfolded([x, y]: [f64; 2]) -> DVec3 {
        let z = 1.0 - x.abs() - y.abs();
        let under = (-z).max(0.0);
        let fold = |x: f64| x - under * if x >= 0.0 { 1.0 } else { -1.0 };
        DVec3::new(fold(x), fold(y), z).normalize()
    }

    #[test]
    fn normals_come_back_from_the_octahedron() {
        for n in crate::mesh::shapes::sphere(1.0, 2).positions {
            assert!(unfolded(octahedral(n)).distance(n) < 1e-12, "{n}");
        }
        assert_eq!(unfolded(octahedral(DVec3::ZERO)), DVec3::Z);
    }

    #[test]
    fn nothing_and_a_single_place_are_quantized_without_harm() {
        let point = PolygonMesh::from_faces(vec![DVec3::ONE; 3], [[0, 1, 2]]);
        let parts = Parts {
            target: &TriangleMesh::default(),
            features: &[],
            cage: &point,
            surface: &point.triangulate(),
            values: Some(&[-1.0, 0.0, 1.0]),
            up: Axis::Z,
        };
        let scene = Scene::new(&parts);
        assert_eq!(scene.layers.target.vertex_count, 0);
        let words = BASE64_STANDARD
            .decode(&scene.layers.surface.vertices)
            .unwrap();
        let values: Vec<_> = words
            .chunks(12)
            .map(|w| u16::from_le_bytes([w[6], w[7]]))
            .collect();
        assert_eq!(values, [0, 32768, 65535]);
    }
}
