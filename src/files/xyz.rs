//! Point clouds as text: a point to a line, its three coordinates first.
//!
//! Words are parted by blanks, commas or semicolons. Three numbers more are the normal, if they are a unit vector on every line. What else
//! follows (colours, intensities) is passed over, as are empty lines and comments (`#` or `//`, on their own line or at the end of one).

use super::quoted;
use crate::error::Defect;
use crate::mesh::PointCloud;
use glam::DVec3;

/// A vector whose length is this near to 1 may be a normal: printed with a few digits.
const UNIT: f64 = 0.02;

/// The points of the file.
pub(super) fn read(bytes: &[u8]) -> Result<PointCloud, Defect> {
    let mut cloud = PointCloud::default();
    for (line, number) in bytes.split(|&b| b == b'\n').zip(1..) {
        let line = String::from_utf8_lossy(line);
        let content = [line.find('#'), line.find("//")];
        let end = content.into_iter().flatten().min().unwrap_or(line.len());
        let content = line[..end].trim();
        if content.is_empty() {
            continue;
        }
        let separates = |c: char| c.is_whitespace() || c == ',' || c == ';';
        let mut words = content.split(separates).filter(|word| !word.is_empty());
        let point = vector(&mut words).ok_or_else(|| defect(number, content))?;
        let normal = vector(&mut words).filter(|n| (n.length() - 1.0).abs() < UNIT);
        if let Some(normal) = normal
            && cloud.normals.len() == cloud.positions.len()
        {
            cloud.normals.push(normal);
        }
        cloud.positions.push(point);
    }
    if cloud.normals.len() < cloud.positions.len() {
        cloud.normals.clear();
    }
    Ok(cloud)
}

fn vector<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<DVec3> {
    let mut number = || words.next()?.parse().ok();
    Some(DVec3::new(number()?, number()?, number()?))
}

fn defect(line: usize, content: &str) -> Defect {
    Defect::new(
        format!("line {line}"),
        format!("{} does not start with three coordinates", quoted(content)),
        "correct the line, or put # before it",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_that_are_no_points_are_refused_by_number() {
        for (text, place) in [
            ("1 2", "line 1"),
            ("1 2 3\nx y z\n", "line 2"),
            ("# points\n\n1 2 3 # first\n1 2 3e\n", "line 4"),
            ("12\n", "line 1"),
        ] {
            let defect = read(text.as_bytes()).expect_err(text);
            assert_eq!(defect.place, place, "{text}");
        }
        assert_eq!(read(b""), Ok(PointCloud::default()));
        assert_eq!(read(b"\xff\xfe").expect_err("no text").place, "line 1");
    }

    #[test]
    fn comments_colours_and_commas_are_passed_over_and_digits_kept() {
        let text = "// a scan\r\n4600123.25 -1e3 0.5 0 0 1\r\n\r\n1,2;3 // last\n";
        let cloud = read(text.as_bytes()).expect("two points");
        let expected = vec![
            DVec3::new(4_600_123.25, -1e3, 0.5),
            DVec3::new(1.0, 2.0, 3.0),
        ];
        assert_eq!((cloud.positions, cloud.normals), (expected, vec![]));
    }

    #[test]
    fn unit_vectors_on_every_line_are_normals() {
        let normals = |text: &str| read(text.as_bytes()).expect("points").normals;
        assert_eq!(normals("1 2 3 0 0 1\n4 5 6 0.6 0.8 0 255 0 0\n").len(), 2);
        assert!(normals("1 2 3 0 0 1\n4 5 6 255 0 0\n").is_empty());
        assert!(normals("1 2 3 0 0\n4 5 6 1 0 0\n").is_empty());
    }
}
