//! The tables of a surface as flat arrays, for a device.

use super::{LimitSurface, Patches, Split, irregular};
use glam::DVec3;

/// The tables of a Loop surface, all that evaluation and steps over edges need.
#[derive(Debug, Clone)]
pub struct FlatTables {
    /// `[4 faces]`: the first index, the number of points, and where the pickings of its irregular corner begin, [`NONE`] without.
    pub quarters: Vec<[u32; 4]>,
    /// The points of each quarter.
    pub indices: Vec<u32>,
    /// `[levels, 3, points, 12]` for each kind of irregular corner.
    pub pickings: Vec<f32>,
    /// `[3 faces]`: the face times three plus the edge on the other side of each edge, or [`NONE`].
    pub neighbours: Vec<u32>,
}

/// No irregular corner; no neighbour.
pub const NONE: u32 = u32::MAX;

impl LimitSurface {
    /// Whether faces are triangles.
    pub fn is_loop(&self) -> bool {
        self.split == Split::Triangles
    }

    /// The tables, with pickings for the first `levels` (at most 16) only. For a Loop surface.
    pub fn flat_tables(&self, levels: usize) -> FlatTables {
        let mut pickings: Vec<f32> = Vec::new();
        let mut starts = Vec::new();
        for table in &self.tables {
            let size = levels * 3 * table.points * irregular::regular_count(self.split);
            starts.push(pickings.len() as u32);
            pickings.extend(table.pickings[..size].iter().map(|&value| value as f32));
        }
        let quarters = (self.quarters.iter())
            .map(|q| match self.tables.get(q.table as usize) {
                Some(table) => [q.first, table.points as u32, starts[q.table as usize], 0],
                None => [
                    q.first,
                    irregular::regular_count(self.split) as u32,
                    NONE,
                    0,
                ],
            })
            .collect();
        let half_edges = 0..self.connectivity.half_edge_count() as u32;
        FlatTables {
            quarters,
            indices: self.indices.clone(),
            pickings,
            neighbours: half_edges
                .map(|h| self.connectivity.opposite(h).unwrap_or(NONE))
                .collect(),
        }
    }
}

impl Patches<'_> {
    /// The middle of the control points.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// The points that the indices of [`FlatTables`] count, relative to the origin.
    pub fn flat_points(&self) -> &[DVec3] {
        &self.points
    }
}
