//! Wavefront OBJ: `v` and `f` statements, through the crate `tobj`, and the tags of what is sharp.
//!
//! The tags are those of OpenSubdiv's shapes (its folder `regression/shapes`; its exporters for Maya and Houdini write them too):
//! `t crease 2/1/0 V W SHARPNESS` and `t corner 1/1/0 V SHARPNESS`, that is a name, how many integers, floats and strings follow, and
//! these. Vertices count from 0 in tags, and a sharpness of 10 is for ever. Other tags are passed over.
//!
//! tobj hands out positions in the order of their first use, drops unused ones, does not join continued lines, takes polylines for faces
//! and names no line in its errors. So it is fed by [`Statements`], which passes on only what makes a surface and knows the line.

use super::{Draft, SurfaceToWrite, quoted};
use crate::error::Defect;
use crate::mesh::Crease;
use crate::mesh::weld::welded;
use glam::DVec3;
use std::io::{self, BufRead, Read, Write};

const DAMAGED: &str = "correct the line or export the file again";

pub(super) fn read(bytes: &[u8]) -> Result<Draft, Defect> {
    let mut statements = Statements::new(bytes);
    let options = tobj::LoadOptions::default();
    let no_materials = |_: &std::path::Path| Ok(Default::default());
    let (models, _) = tobj::load_obj_buf(&mut statements, &options, no_materials).map_err(
        |error| match error {
            tobj::LoadError::FaceVertexOutOfBounds => index_out_of_range(bytes),
            _ => Defect::new(
                format!("line {}", statements.line),
                error.to_string(),
                DAMAGED,
            ),
        },
    )?;
    // Without `o`, `g` and `usemtl` there is a single model.
    let mesh = models
        .into_iter()
        .next()
        .map(|m| m.mesh)
        .unwrap_or_default();
    if mesh.positions.is_empty() {
        return Err(Defect::new(
            "whole file",
            "there is no vertex (v x y z) in it",
            "check that it is a Wavefront OBJ file",
        ));
    }
    let mut draft = Draft::new(
        mesh.positions
            .chunks_exact(3)
            .map(DVec3::from_slice)
            .collect(),
    );
    let mut rest = mesh.indices.as_slice();
    let mut corners = Vec::new();
    for &arity in &mesh.face_arities {
        let (face, tail) = rest.split_at(arity as usize);
        rest = tail;
        corners.clear();
        corners.extend(face.iter().map(|&v| i64::from(v)));
        draft.push_face(&corners, || "face".into())?;
    }
    // Every vertex came with a face of one corner.
    draft.short_faces -= draft.mesh.positions.len();
    read_tags(bytes, &mut draft)?;
    let (mesh, merged) = welded(&draft.mesh);
    draft.mesh = mesh;
    let ends = draft.creases.iter_mut().flat_map(|c| &mut c.edge);
    for vertex in ends.chain(&mut draft.sharp_corners) {
        *vertex = merged[*vertex as usize];
    }
    Ok(draft)
}

/// Reads the creases and corners, once all vertices are there.
fn read_tags(bytes: &[u8], draft: &mut Draft) -> Result<(), Defect> {
    for (line, text) in logical_lines(bytes).filter(|(_, text)| keyword(text) == b"t") {
        let text = String::from_utf8_lossy(&text);
        let place = || format!("line {line}");
        let damaged = || {
            let problem = format!("{} is no crease or corner", quoted(text.trim()));
            Defect::new(place(), problem, DAMAGED)
        };
        let integer = |word: &str| word.parse::<i64>().map_err(|_| damaged());
        let float = |word: &str| word.parse::<f64>().map_err(|_| damaged());
        match text.split_whitespace().skip(1).collect::<Vec<_>>()[..] {
            ["crease", "2/1/0", v, w, s] => {
                draft.push_crease([integer(v)?, integer(w)?], float(s)?, place)?;
            }
            ["corner", "1/1/0", v, s] => draft.push_corner(integer(v)?, float(s)?, place)?,
            ["crease" | "corner", ..] => return Err(damaged()),
            _ => {}
        }
    }
    Ok(())
}

/// The first face whose index is out of range, looked for only after tobj found that there is one.
fn index_out_of_range(bytes: &[u8]) -> Defect {
    let total = logical_lines(bytes)
        .filter(|(_, text)| keyword(text) == b"v")
        .count() as i64;
    let mut defined = 0;
    for (line, text) in logical_lines(bytes) {
        match keyword(&text) {
            b"v" => defined += 1,
            b"f" => {
                let text = String::from_utf8_lossy(&text);
                let bad = text.split_whitespace().skip(1).find(|word| {
                    let index = word.split('/').next().and_then(|v| v.parse::<i64>().ok());
                    index.is_none_or(|v| v == 0 || v > total || v < -defined)
                });
                if let Some(word) = bad {
                    return Defect::new(
                        format!("line {line}"),
                        format!("the face names vertex {} of {total}", quoted(word)),
                        DAMAGED,
                    );
                }
            }
            _ => {}
        }
    }
    Defect::new("faces", "a face names a vertex that is not there", DAMAGED)
}

fn keyword(text: &[u8]) -> &[u8] {
    let text = text.trim_ascii_start();
    let end = text.iter().position(u8::is_ascii_whitespace);
    &text[..end.unwrap_or(text.len())]
}

/// Lines joined where they end in a backslash, with the number of the last physical line.
fn logical_lines(bytes: &[u8]) -> impl Iterator<Item = (usize, Vec<u8>)> {
    let mut lines = bytes.split(|&b| b == b'\n').zip(1..);
    std::iter::from_fn(move || {
        let (line, mut number) = lines.next()?;
        let mut text = line.trim_ascii_end().to_vec();
        while text.last() == Some(&b'\\') {
            text.pop();
            let Some((next, n)) = lines.next() else { break };
            text.push(b' ');
            text.extend_from_slice(next.trim_ascii_end());
            number = n;
        }
        Some((number, text))
    })
}

/// A reader that yields one statement at a time.
struct Statements<'a> {
    lines: Box<dyn Iterator<Item = (usize, Vec<u8>)> + 'a>,
    /// The line that the current statement ends on.
    line: usize,
    text: Vec<u8>,
    consumed: usize,
}

impl<'a> Statements<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self {
            lines: Box::new(logical_lines(bytes)),
            line: 0,
            text: Vec::new(),
            consumed: 0,
        }
    }

    fn set(&mut self, statement: &[&[u8]]) {
        self.text = statement.join(&b' ');
        self.text.push(b'\n');
        self.consumed = 0;
    }
}

impl BufRead for Statements<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        while self.consumed == self.text.len() {
            let Some((line, text)) = self.lines.next() else {
                break;
            };
            self.line = line;
            match keyword(&text) {
                b"v" => {
                    // Position only: what follows may be a weight, which polygons do not have, or a colour.
                    let words: Vec<&[u8]> = text
                        .split(u8::is_ascii_whitespace)
                        .filter(|word| !word.is_empty())
                        .take(4)
                        .collect();
                    self.set(&words);
                    // A face of this one vertex keeps the vertex, in the file's order.
                    self.text.extend_from_slice(b"f -1\n");
                }
                b"f" => self.set(&[&text]),
                _ => {}
            }
        }
        Ok(&self.text[self.consumed..])
    }

    fn consume(&mut self, amount: usize) {
        self.consumed += amount;
    }
}

impl Read for Statements<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(buffer)?;
        self.consume(count);
        Ok(count)
    }
}

pub(super) fn write(out: &mut dyn Write, surface: &SurfaceToWrite<'_>) -> io::Result<()> {
    let mesh = surface.mesh;
    for p in &mesh.positions {
        writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
    }
    for face in mesh.faces() {
        write!(out, "f")?;
        for v in face {
            write!(out, " {}", u64::from(*v) + 1)?;
        }
        writeln!(out)?;
    }
    for Crease { edge, sharpness } in surface.creases {
        let sharpness = sharpness.min(Crease::INFINITE);
        writeln!(out, "t crease 2/1/0 {} {} {sharpness}", edge[0], edge[1])?;
    }
    for corner in surface.corners {
        writeln!(out, "t corner 1/1/0 {corner} {}", Crease::INFINITE)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

    fn faces(statements: &str) -> Vec<Vec<u32>> {
        let draft = read(format!("{SQUARE}{statements}").as_bytes()).unwrap();
        draft.mesh.faces().map(<[u32]>::to_vec).collect()
    }

    #[test]
    fn every_way_to_name_a_corner_is_read() {
        let expected = [[0, 1, 2, 3]];
        assert_eq!(faces("f 1 2 3 4\n"), expected);
        assert_eq!(faces("f -4 -3 -2 -1"), expected);
        assert_eq!(
            faces("vt 0\nvn 0 0 1\nf 1/1/1 2/1/1 3//1 4/1\r\n"),
            expected
        );
        assert_eq!(faces("f 1 2 \\\n 3 4\n"), expected);
        assert_eq!(
            faces("o a\nusemtl x\nf 1 2 3\ng b\nl 1 2 3\nf 1 3 4"),
            [[0, 1, 2], [0, 2, 3]]
        );
    }

    #[test]
    fn weights_colours_and_unused_vertices_do_not_disturb() {
        let draft =
            read(b"v 9 9 9\nv 0 0 0 2\nv 1 0 0 1 0 0\nv 0 1 0 .5 .5 .5 1\nf 4 3 2\nf 1\nf 1 2")
                .unwrap();
        assert_eq!(draft.mesh.positions[..2], [DVec3::splat(9.0), DVec3::ZERO]);
        assert_eq!(draft.mesh.face(0), [3, 2, 1]);
        assert_eq!(draft.short_faces, 2);
    }

    #[test]
    fn seams_close() {
        let draft = read(format!("{SQUARE}{SQUARE}f 1 2 3\nf 5 7 8").as_bytes()).unwrap();
        assert_eq!(draft.mesh.positions.len(), 4);
        assert_eq!(draft.mesh.face(1), [0, 2, 3]);
    }

    #[test]
    fn tags_name_vertices_of_the_file() {
        // The second square's vertices are merged into the first's.
        let text = format!(
            "t crease 2/1/0 4 5 2.5\nt interpolateboundary 1/0/0 2\nt corner 1/1/0 7 10\n\
             t corner 1/1/0 0 0\n{SQUARE}{SQUARE}f 5 6 7 8"
        );
        let draft = read(text.as_bytes()).unwrap();
        let [crease] = draft.creases[..] else {
            panic!("{:?}", draft.creases)
        };
        assert_eq!((crease.edge, crease.sharpness), ([0, 1], 2.5));
        assert_eq!(draft.sharp_corners, [3]);
        for tag in [
            "t crease 2/1/0 0 4 1",
            "t crease 2/1/0 -1 1 1",
            "t crease 2/1/0 0 1 -1",
            "t crease 2/1/0 0 1 nan",
            "t crease 2/1/0 0 1",
            "t crease 3/1/0 0 1 2 1",
            "t corner 1/1/0 1 2.5",
            "t corner 1/1/0 x 10",
        ] {
            let text = format!("{SQUARE}f 1 2 3\n{tag}");
            let defect = read(text.as_bytes()).err().unwrap();
            assert_eq!(defect.place, "line 6", "{tag}: {defect:?}");
        }
    }

    #[test]
    fn coordinates_keep_all_their_digits() {
        let draft = read(b"v 5000000.1234567 0.1 1e-300\n").unwrap();
        assert_eq!(
            draft.mesh.positions[0],
            DVec3::new(5000000.1234567, 0.1, 1e-300)
        );
    }

    #[test]
    fn errors_name_the_line() {
        let cases = [
            ("f 1 2 3\nf 1 2 5", "line 6"),
            ("f 0 1 2", "line 5"),
            ("f -5 -1 -2", "line 5"),
            ("f 1 2 99999999999999999999", "line 5"),
            ("f 1 2 x", "line 5"),
            ("\nv 1 2", "line 6"),
            ("v 1 2 z", "line 5"),
            ("f /1 /2 /3", "line 5"),
        ];
        for (statements, place) in cases {
            let defect = read(format!("{SQUARE}{statements}").as_bytes())
                .err()
                .unwrap();
            assert_eq!(defect.place, place, "{statements}: {defect:?}");
        }
        assert_eq!(read(b"hello\n").err().unwrap().place, "whole file");
    }
}
