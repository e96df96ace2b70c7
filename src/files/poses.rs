//! Poses of scans in one frame: the `.conf` files of Stanford's repository, a line `bmesh FILE tx ty tz qx qy qz qw` to a scan.
//!
//! A point x of a scan goes to R x + t. The quaternion is that of the inverse of R: that is how the dragon's scans fit together. Other lines (`camera`, groups, comments) are passed over.

use super::quoted;
use crate::error::Defect;
use glam::{DQuat, DVec3};

/// Where a scan goes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pose {
    /// The scan's file, as the line names it.
    pub file: String,
    rotation: DQuat,
    translation: DVec3,
}

impl Pose {
    pub fn point(&self, p: DVec3) -> DVec3 {
        self.rotation * p + self.translation
    }

    pub fn direction(&self, d: DVec3) -> DVec3 {
        self.rotation * d
    }
}

/// The poses of the file, in its order.
///
/// # Errors
/// The first line of a scan that is not complete.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<Pose>, Defect> {
    let text = String::from_utf8_lossy(bytes);
    let lines = text.lines().zip(1..);
    lines
        .filter_map(|(line, number)| pose(line, number).transpose())
        .collect()
}

fn pose(line: &str, number: usize) -> Result<Option<Pose>, Defect> {
    let mut words = line.split_whitespace();
    if words.next() != Some("bmesh") {
        return Ok(None);
    }
    let parsed = words.next().and_then(|file| {
        let numbers: Option<Vec<f64>> = words
            .map(|word| word.parse().ok().filter(|x: &f64| x.is_finite()))
            .collect();
        let [tx, ty, tz, qx, qy, qz, qw] = numbers?[..] else {
            return None;
        };
        let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
        (rotation.length() > 0.0).then(|| Pose {
            file: file.to_owned(),
            rotation: rotation.normalize().conjugate(),
            translation: DVec3::new(tx, ty, tz),
        })
    });
    parsed.map(Some).ok_or_else(|| {
        Defect::new(
            format!("line {number}"),
            format!(
                "{} is not a file, a translation and a quaternion",
                quoted(line)
            ),
            "write bmesh FILE tx ty tz qx qy qz qw",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_that_are_no_poses_are_refused_by_number() {
        assert_eq!(
            read(b"camera 0 0 1\n\nmesh group 0 0 0 0 0 0 1\n"),
            Ok(vec![])
        );
        for line in [
            "bmesh",
            "bmesh a.ply",
            "bmesh a.ply 0 0 0 0 0 0",
            "bmesh a.ply 0 0 0 0 0 0 0",
            "bmesh a.ply 0 0 0 0 0 0 1 2",
            "bmesh a.ply 0 0 nan 0 0 0 1",
        ] {
            let text = format!("camera 1\n{line}\n");
            assert_eq!(read(text.as_bytes()).expect_err(line).place, "line 2");
        }
    }

    #[test]
    fn a_quarter_turn_is_turned_back() {
        // About z by 90 degrees, twice as long as a unit quaternion.
        let poses = read(b"bmesh a.ply 1 2 3 0 0 2 2\n").expect("a pose");
        assert_eq!(poses[0].file, "a.ply");
        assert!((poses[0].direction(DVec3::Y) - DVec3::X).length() < 1e-15);
        assert!((poses[0].point(DVec3::Y) - DVec3::new(2.0, 2.0, 3.0)).length() < 1e-15);
    }
}
