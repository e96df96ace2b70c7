//! glTF 2.0, binary: one mesh of triangles with normals and, where an error per vertex is given, colours.
//!
//! Positions are f32 by the standard, so far from the origin they are local to the node's translation.

use super::local_origin;
use crate::mesh::{PolygonMesh, TriangleMesh};
use glam::{DVec3, Vec3};
use serde_json::{Value, json};
use std::io::{self, Write};

// Constants of the standard (sections 3.6.2 and 4.4).
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_BYTE: u32 = 5121;
const VERTEX_DATA: u32 = 34962;
const INDEX_DATA: u32 = 34963;
const JSON_CHUNK: &[u8; 4] = b"JSON";
const BINARY_CHUNK: &[u8; 4] = b"BIN\0";

/// Colours of no error, half of the largest and the largest.
const COLORS: [Vec3; 3] = [
    Vec3::new(0.10, 0.25, 0.75),
    Vec3::new(0.90, 0.90, 0.80),
    Vec3::new(0.75, 0.05, 0.05),
];

pub(super) fn write(
    out: &mut dyn Write,
    mesh: &PolygonMesh,
    error: Option<&[f64]>,
) -> io::Result<()> {
    let origin = local_origin(mesh);
    let mesh = mesh.triangulate();
    let mut buffer = Buffer::default();

    let points: Vec<[f32; 3]> = mesh
        .positions
        .iter()
        .map(|&p| (p - origin).as_vec3().to_array())
        .collect();
    let position = buffer.push(VERTEX_DATA, FLOAT, "VEC3", &points);
    buffer.accessors[position]["min"] = json!(extreme(&points, Vec3::min));
    buffer.accessors[position]["max"] = json!(extreme(&points, Vec3::max));
    let normal = buffer.push(VERTEX_DATA, FLOAT, "VEC3", &normals(&mesh));
    let mut attributes = json!({ "POSITION": position, "NORMAL": normal });
    if let Some(error) = error {
        let color = buffer.push(VERTEX_DATA, UNSIGNED_BYTE, "VEC4", &colors(error));
        buffer.accessors[color]["normalized"] = json!(true);
        attributes["COLOR_0"] = json!(color);
    }
    let corners: &[u32] = mesh.triangles.as_flattened();
    let indices = buffer.push(INDEX_DATA, UNSIGNED_INT, "SCALAR", corners);

    let document = json!({
        "asset": { "version": "2.0", "generator": "vorofit" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "name": "surface", "translation": origin.to_array() }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }] }],
        "materials": [{
            "doubleSided": true,
            "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 0.8 },
        }],
        "buffers": [{ "byteLength": buffer.bytes.len() }],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
    });
    write_container(out, document.to_string().into_bytes(), buffer.bytes)
}

/// The binary chunk with the tables that describe it.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Appends an array of 4-byte aligned elements and returns its accessor's index.
    fn push<T: bytemuck::NoUninit>(
        &mut self,
        target: u32,
        component: u32,
        shape: &str,
        data: &[T],
    ) -> usize {
        let bytes = bytemuck::cast_slice(data);
        self.views.push(json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len(), "target": target,
        }));
        self.accessors.push(json!({
            "bufferView": self.views.len() - 1, "componentType": component, "type": shape,
            "count": data.len(),
        }));
        self.bytes.extend_from_slice(bytes);
        self.accessors.len() - 1
    }
}

/// Header, document and buffer, each chunk padded to 4 bytes.
fn write_container(out: &mut dyn Write, mut json: Vec<u8>, binary: Vec<u8>) -> io::Result<()> {
    json.resize(json.len().next_multiple_of(4), b' ');
    let length = |bytes: usize| {
        u32::try_from(bytes)
            .map(u32::to_le_bytes)
            .map_err(|_| io::Error::other("glTF binary ends at 4 GiB; write .ply"))
    };
    out.write_all(b"glTF")?;
    out.write_all(&2u32.to_le_bytes())?;
    out.write_all(&length(12 + 8 + json.len() + 8 + binary.len())?)?;
    for (kind, chunk) in [(JSON_CHUNK, json), (BINARY_CHUNK, binary)] {
        out.write_all(&length(chunk.len())?)?;
        out.write_all(kind)?;
        out.write_all(&chunk)?;
    }
    Ok(())
}

fn extreme(points: &[[f32; 3]], choose: fn(Vec3, Vec3) -> Vec3) -> [f32; 3] {
    let points = points.iter().map(|&p| Vec3::from(p));
    points.reduce(choose).unwrap_or_default().to_array()
}

/// Unit normals, the mean over a vertex's triangles by area; upwards where there is none, since the standard wants unit length.
fn normals(mesh: &TriangleMesh) -> Vec<[f32; 3]> {
    let mut sums = vec![DVec3::ZERO; mesh.positions.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let normal = mesh.area_vector(t);
        for &v in triangle {
            sums[v as usize] += normal;
        }
    }
    sums.into_iter()
        .map(|n| n.normalize_or(DVec3::Y).as_vec3().to_array())
        .collect()
}

fn colors(error: &[f64]) -> Vec<[u8; 4]> {
    let largest = error.iter().fold(f64::MIN_POSITIVE, |a, &b| a.max(b));
    error
        .iter()
        .map(|&e| {
            let share = (2.0 * e / largest).clamp(0.0, 2.0) as f32;
            let (from, part) = if share < 1.0 {
                (0, share)
            } else {
                (1, share - 1.0)
            };
            let [r, g, b] = (COLORS[from].lerp(COLORS[from + 1], part) * 255.0).to_array();
            [r as u8, g as u8, b as u8, 255]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The document and the binary chunk, with the container's lengths checked.
    fn open(bytes: &[u8]) -> (Value, &[u8]) {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(
            (&bytes[..4], word(4), word(8)),
            (&b"glTF"[..], 2, bytes.len())
        );
        let json = word(12);
        let binary = 20 + json;
        assert_eq!(json % 4 + word(binary) % 4, 0);
        assert_eq!(
            (&bytes[16..20], &bytes[binary + 4..binary + 8]),
            (&b"JSON"[..], &b"BIN\0"[..])
        );
        assert_eq!(binary + 8 + word(binary), bytes.len());
        (
            serde_json::from_slice(&bytes[20..binary]).unwrap(),
            &bytes[binary + 8..],
        )
    }

    #[test]
    fn positions_are_local_and_every_accessor_lies_in_the_buffer() {
        let points = [
            DVec3::ZERO,
            DVec3::X,
            DVec3::X + DVec3::Y,
            DVec3::Y,
            DVec3::Z,
        ]
        .map(|p| p + 5e6);
        let mesh = PolygonMesh::from_faces(points.to_vec(), [[0, 1, 2, 3]]);
        let mut out = Vec::new();
        write(&mut out, &mesh, Some(&[0.0, 0.5, 1.0, 0.0, 0.0])).unwrap();
        let (document, binary) = open(&out);
        let origin = DVec3::from_slice(
            &serde_json::from_value::<Vec<f64>>(document["nodes"][0]["translation"].clone())
                .unwrap(),
        );
        for (p, local) in points.iter().zip(binary.chunks(12)) {
            let local: &[f32] = bytemuck::cast_slice(local);
            let back = origin + DVec3::new(local[0].into(), local[1].into(), local[2].into());
            assert!((back - *p).length() < 1e-7);
        }
        let sizes = [("VEC3", 12), ("VEC4", 4), ("SCALAR", 4)];
        for (accessor, view) in document["accessors"]
            .as_array()
            .unwrap()
            .iter()
            .zip(document["bufferViews"].as_array().unwrap())
        {
            let size = sizes
                .iter()
                .find(|(name, _)| accessor["type"] == *name)
                .unwrap()
                .1;
            let length = view["byteLength"].as_u64().unwrap();
            assert_eq!(accessor["count"].as_u64().unwrap() * size, length);
            assert!(view["byteOffset"].as_u64().unwrap() + length <= binary.len() as u64);
        }
        assert_eq!(document["accessors"][0]["min"], json!([-0.5, -0.5, -0.5]));
        assert_eq!(document["accessors"][0]["max"], json!([0.5, 0.5, 0.5]));
    }

    #[test]
    fn a_vertex_without_faces_has_a_unit_normal_and_no_error_a_colour() {
        let mesh = TriangleMesh {
            positions: vec![DVec3::ZERO; 3],
            triangles: vec![[0, 1, 1]],
        };
        assert_eq!(normals(&mesh), [[0.0, 1.0, 0.0]; 3]);
        assert_eq!(colors(&[0.0, 0.0])[1], [25, 63, 191, 255]);
    }
}
