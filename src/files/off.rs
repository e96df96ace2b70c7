//! Geomview's Object File Format in text: `OFF`, with the colours, normals and texture coordinates of `COFF`, `NOFF`, `STOFF`… passed over.

use super::{Draft, quoted};
use crate::error::Defect;
use crate::mesh::PolygonMesh;
use glam::DVec3;
use std::io::{self, Write};

const DAMAGED: &str = "correct the line or export the file again";

/// Whether the first word is the magic of any variant of the format.
pub(super) fn has_magic(bytes: &[u8]) -> bool {
    let word = bytes.split(u8::is_ascii_whitespace).next();
    word.and_then(|word| std::str::from_utf8(word).ok())
        .and_then(split_magic)
        .is_some()
}

/// The variant's letters before OFF and what follows: some files run the first count into the word (`OFF490 518 0`).
fn split_magic(word: &str) -> Option<(&str, &str)> {
    let (variant, rest) = word.split_once("OFF")?;
    let plausible =
        variant.chars().all(|c| "STCN4n".contains(c)) && rest.chars().all(|c| c.is_ascii_digit());
    plausible.then_some((variant, rest))
}

pub(super) fn read(bytes: &[u8]) -> Result<Draft, Defect> {
    let mut lines = Lines {
        rest: bytes,
        number: 0,
    };
    let [vertices, faces] = read_header(&mut lines)?;
    // No space is reserved for counts that the file may not keep.
    let mut positions = Vec::new();
    for v in 0..vertices {
        let line = lines.next(|| format!("vertex {v} of {vertices}"))?;
        positions.push(position(line).ok_or_else(|| {
            lines.defect(format!(
                "{} does not start with three coordinates",
                quoted(line)
            ))
        })?);
    }
    let mut draft = Draft::new(positions);
    let mut corners = Vec::new();
    for f in 0..faces {
        let line = lines.next(|| format!("face {f} of {faces}"))?;
        read_corners(line, &mut corners).ok_or_else(|| {
            lines.defect(format!(
                "{} is not a count of corners and the corners",
                quoted(line)
            ))
        })?;
        draft.push_face(&corners, || lines.place())?;
    }
    Ok(draft)
}

/// The numbers of vertices and faces.
fn read_header(lines: &mut Lines<'_>) -> Result<[usize; 2], Defect> {
    let first = lines.next(|| "the word OFF".into())?;
    let word = first.split_whitespace().next().unwrap_or_default();
    let Some((variant, rest)) = split_magic(word) else {
        return Err(lines.defect(format!("{} is not OFF", quoted(word))));
    };
    if variant.contains(['4', 'n']) {
        return Err(lines.defect(format!("{variant}OFF is not a surface in three dimensions")));
    }
    let mut counts = first[word.len() - rest.len()..].trim();
    if counts.starts_with("BINARY") {
        return Err(Defect::new(
            lines.place(),
            "binary OFF is not supported",
            "write it as text or as .ply",
        ));
    }
    if counts.is_empty() {
        counts = lines.next(|| "the counts of vertices and faces".into())?;
    }
    let mut numbers = counts
        .split_whitespace()
        .map_while(|word| word.parse().ok());
    match (numbers.next(), numbers.next()) {
        (Some(vertices), Some(faces)) => Ok([vertices, faces]),
        _ => Err(lines.defect(format!(
            "{} is not the counts of vertices and faces",
            quoted(counts)
        ))),
    }
}

fn position(line: &str) -> Option<DVec3> {
    let mut numbers = line.split_whitespace().map_while(|word| word.parse().ok());
    Some(DVec3::new(
        numbers.next()?,
        numbers.next()?,
        numbers.next()?,
    ))
}

fn read_corners(line: &str, corners: &mut Vec<i64>) -> Option<()> {
    let mut words = line.split_whitespace();
    let count: usize = words.next()?.parse().ok()?;
    corners.clear();
    corners.extend(words.take(count).map_while(|word| word.parse::<i64>().ok()));
    (corners.len() == count).then_some(())
}

/// Lines without comments and blank ones, numbered.
struct Lines<'a> {
    rest: &'a [u8],
    number: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self, wanted: impl Fn() -> String) -> Result<&'a str, Defect> {
        while !self.rest.is_empty() {
            let end = self.rest.iter().position(|&b| b == b'\n');
            let (line, rest) = self.rest.split_at(end.map_or(self.rest.len(), |e| e + 1));
            self.rest = rest;
            self.number += 1;
            let content = line.split(|&b| b == b'#').next().unwrap_or_default();
            let content = content.trim_ascii();
            if !content.is_empty() {
                return std::str::from_utf8(content).map_err(|_| self.defect("it is not text"));
            }
        }
        Err(Defect::new(
            "end of file",
            format!("{} is missing", wanted()),
            "the file is truncated or its counts are wrong: export it again",
        ))
    }

    fn place(&self) -> String {
        format!("line {}", self.number)
    }

    fn defect(&self, problem: impl Into<String>) -> Defect {
        Defect::new(self.place(), problem, DAMAGED)
    }
}

pub(super) fn write(out: &mut dyn Write, mesh: &PolygonMesh) -> io::Result<()> {
    writeln!(out, "OFF\n{} {} 0", mesh.positions.len(), mesh.face_count())?;
    for p in &mesh.positions {
        writeln!(out, "{} {} {}", p.x, p.y, p.z)?;
    }
    for face in mesh.faces() {
        write!(out, "{}", face.len())?;
        for v in face {
            write!(out, " {v}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODY: &str = "0 0 0\n1 0 0 # a comment\n\n1 1 0 255 0 0\n0 1 0\n4 0 1 2 3 0.5 0.5 0.5\r\n3 0 1 2\n2 0 1\n";

    #[test]
    fn headers_come_in_many_shapes() {
        for header in [
            "OFF\n4 3 0",
            "OFF 4 3 0",
            "OFF4 3 0",
            "# by hand\nCOFF\n# counts\n4 3",
            "STNOFF\r\n4 3 0",
        ] {
            let draft = read(format!("{header}\n{BODY}").as_bytes()).unwrap();
            assert_eq!(draft.mesh.positions[2], DVec3::new(1.0, 1.0, 0.0));
            assert_eq!(draft.mesh.face(0), [0, 1, 2, 3], "{header}");
            assert_eq!((draft.mesh.face_count(), draft.short_faces), (2, 1));
        }
    }

    #[test]
    fn errors_name_the_line_and_huge_counts_end_at_once() {
        let cases = [
            ("", "end of file"),
            ("OFF", "end of file"),
            ("PLY\n1 1 0", "line 1"),
            ("4OFF\n1 1 0", "line 1"),
            ("OFF BINARY\n1 1 0", "line 1"),
            ("OFF\n-1 1 0", "line 2"),
            ("OFF\n99999999999999999999 1", "line 2"),
            ("OFF\n18446744073709551615 1\n0 0 0", "end of file"),
            ("OFF\n1 18446744073709551615\n0 0 0", "end of file"),
            ("OFF\n1 1\n0 0 x", "line 3"),
            ("OFF\n1 1\n0 0 0\n3 0 0 1", "line 4"),
            ("OFF\n1 1\n0 0 0\n3 0 0 -1", "line 4"),
            ("OFF\n1 1\n0 0 0\n18446744073709551615 0 0 0", "line 4"),
            ("OFF\n1 1\n0 0 0\n3 0 0", "line 4"),
        ];
        for (text, place) in cases {
            let defect = read(text.as_bytes()).err().unwrap();
            assert_eq!(defect.place, place, "{text}: {defect:?}");
        }
    }
}
