//! Range images: a grid of what a scanner saw, a point or nothing to a cell.
//!
//! Stanford's PLY files of raw scans hold the points as vertices, an element `range_grid` with a list of no or one vertex to a cell, row by
//! row, and the size of the grid in `obj_info num_cols` and `num_rows`. Neighbouring cells make triangles, unless one of their sides jumps
//! in depth: the surface behind is another one, or too oblique to be trusted.

use crate::error::Defect;
use glam::DVec3;

/// A side so many times as long as the median one is a jump in depth.
const JUMP: f64 = 4.0;

/// A grid of cells, row by row.
pub(super) struct RangeGrid {
    pub columns: usize,
    /// `[rows × columns]`: the point that was seen, if any.
    pub cells: Vec<Option<u32>>,
}

impl RangeGrid {
    /// From the header's remarks and the cells' lists; `None` where the remarks do not tell the size.
    ///
    /// # Errors
    /// Where the size is not that of the lists, or a cell names a point that is not there.
    pub fn new<'a>(
        remarks: impl Iterator<Item = &'a str> + Clone,
        lists: impl ExactSizeIterator<Item = &'a [i32]>,
        points: usize,
    ) -> Result<Option<Self>, Defect> {
        let size = |name: &str| {
            let value = |remark: &str| remark.trim().strip_prefix(name)?.trim().parse().ok();
            remarks.clone().find_map(value)
        };
        let (Some(columns), Some(rows)): (Option<usize>, Option<usize>) =
            (size("num_cols"), size("num_rows"))
        else {
            return Ok(None);
        };
        let damaged = |place: String, problem: String| {
            Defect::new(place, problem, "the file is damaged: export it again")
        };
        if columns.checked_mul(rows) != Some(lists.len()) {
            let problem = format!(
                "{columns} columns and {rows} rows, but {} cells",
                lists.len()
            );
            return Err(damaged("element range_grid".into(), problem));
        }
        let cell = |(c, list): (usize, &[i32])| match list {
            [] => Ok(None),
            &[v, ..] if usize::try_from(v).is_ok_and(|v| v < points) => Ok(Some(v as u32)),
            &[v, ..] => Err(damaged(
                format!("cell {c} of the range grid (counted from 0)"),
                format!("it names vertex {v} (counted from 0) of {points}"),
            )),
        };
        let cells = lists.enumerate().map(cell).collect::<Result<_, _>>()?;
        Ok(Some(Self { columns, cells }))
    }

    /// Triangles between neighbouring cells, those across jumps left out. Seen from the scanner, rows go up and columns to the right (as in
    /// Stanford's scans of the dragon), and the triangles run counter-clockwise.
    pub fn triangles(&self, points: &[DVec3]) -> Vec<[u32; 3]> {
        let length = |a: u32, b: u32| points[a as usize].distance(points[b as usize]);
        let columns = self.columns;
        let sides = (0..self.cells.len()).flat_map(|c| {
            let right =
                (c + 1 < self.cells.len() && (c + 1) % columns != 0).then(|| self.cells[c + 1]);
            let below = self.cells.get(c + columns).copied();
            let to = move |end: Option<Option<u32>>| Some((self.cells[c]?, end??));
            [to(right), to(below)].into_iter().flatten()
        });
        let mut lengths: Vec<f64> = sides.map(|(a, b)| length(a, b)).collect();
        if lengths.is_empty() {
            return Vec::new();
        }
        let middle = lengths.len() / 2;
        let longest = JUMP * *lengths.select_nth_unstable_by(middle, f64::total_cmp).1;
        let mut triangles = Vec::new();
        let mut push = |corners: [Option<u32>; 3]| {
            if let [Some(a), Some(b), Some(c)] = corners
                && [(a, b), (b, c), (c, a)]
                    .iter()
                    .all(|&(a, b)| length(a, b) <= longest)
            {
                triangles.push([a, b, c]);
            }
        };
        for c in (0..self.cells.len().saturating_sub(columns)).filter(|c| (c + 1) % columns != 0) {
            let [a, b] = [self.cells[c], self.cells[c + 1]];
            let [d, e] = [self.cells[c + columns], self.cells[c + columns + 1]];
            // The shorter diagonal, where there are both.
            let falling = match (a, b, d, e) {
                (Some(a), Some(b), Some(d), Some(e)) => length(a, e) <= length(b, d),
                (a, _, _, e) => a.is_some() && e.is_some(),
            };
            if falling {
                push([a, e, d]);
                push([a, b, e]);
            } else {
                push([a, b, d]);
                push([b, e, d]);
            }
        }
        triangles
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(remarks: [&str; 2], cells: &[&[i32]]) -> Result<Option<RangeGrid>, Defect> {
        RangeGrid::new(remarks.into_iter(), cells.iter().copied(), 6)
    }

    /// Three columns and two rows of points, seen from above.
    fn points() -> Vec<DVec3> {
        (0..6)
            .map(|k| DVec3::new(f64::from(k % 3), f64::from(k / 3), 0.0))
            .collect()
    }

    const ALL: [&[i32]; 6] = [&[0], &[1], &[2], &[3], &[4], &[5]];

    #[test]
    fn a_grid_that_does_not_fit_its_size_or_points_is_refused() {
        let size = ["num_cols 3", "num_rows 2"];
        assert!(
            grid(["is_mesh 0", "num_rows 2"], &ALL)
                .expect("a file")
                .is_none()
        );
        assert_eq!(
            grid(size, &ALL[1..]).err().expect("too few").place,
            "element range_grid"
        );
        for wrong in [6, -1] {
            let cells: [&[i32]; 6] = [&[0], &[wrong], &[], &[], &[], &[]];
            let defect = grid(size, &cells).err().expect("no such point");
            assert_eq!(defect.place, "cell 1 of the range grid (counted from 0)");
        }
        let huge = ["num_cols 18446744073709551615", "num_rows 2"];
        assert!(grid(huge, &ALL).is_err());
        assert!(
            grid(["num_cols 0", "num_rows 0"], &[])
                .expect("empty")
                .expect("a grid")
                .triangles(&[])
                .is_empty()
        );
    }

    #[test]
    fn triangles_face_the_scanner_and_stop_at_jumps_and_gaps() {
        let size = ["num_cols 3", "num_rows 2"];
        let whole = grid(size, &ALL).expect("sound").expect("a grid");
        let up = |points: &[DVec3], t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| points[v as usize]);
            (b - a).cross(c - a).z
        };
        let flat = points();
        let triangles = whole.triangles(&flat);
        assert_eq!(triangles.len(), 4);
        assert!(triangles.iter().all(|t| up(&flat, t) > 0.0));
        let mut jumped = points();
        jumped[5].z = -9.0;
        let kept = whole.triangles(&jumped);
        assert_eq!(kept.len(), 3);
        assert!(kept.iter().flatten().all(|&v| v != 5));
        let gap: [&[i32]; 6] = [&[0], &[], &[2], &[3], &[4], &[5]];
        let gap = grid(size, &gap).expect("sound").expect("a grid");
        let triangles = gap.triangles(&flat);
        assert_eq!(triangles.len(), 2);
        assert!(triangles.iter().all(|t| up(&flat, t) > 0.0));
    }
}
