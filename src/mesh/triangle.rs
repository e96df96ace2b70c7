use glam::DVec3;

/// Triangles over shared or unshared vertices. No connectivity, orientation or manifoldness is assumed: a soup is one too.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TriangleMesh {
    /// `[vertices]`.
    pub positions: Vec<DVec3>,
    /// `[triangles, 3]`, indices into `positions`, counter-clockwise seen from outside where the mesh is oriented.
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// The corner positions of triangle `t`.
    pub fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangles[t].map(|v| self.positions[v as usize])
    }

    /// Twice the area times the unit normal of triangle `t`; zero where it is degenerate.
    pub fn area_vector(&self, t: usize) -> DVec3 {
        let [a, b, c] = self.corners(t);
        (b - a).cross(c - a)
    }

    /// The total area.
    pub fn area(&self) -> f64 {
        (0..self.triangles.len())
            .map(|t| 0.5 * self.area_vector(t).length())
            .sum()
    }

    /// Area-weighted unit normals at the vertices; zero where the faces around one cancel or there are none.
    pub fn vertex_normals(&self) -> Vec<DVec3> {
        let mut normals = vec![DVec3::ZERO; self.positions.len()];
        for (t, corners) in self.triangles.iter().enumerate() {
            let area_vector = self.area_vector(t);
            for &v in corners {
                normals[v as usize] += area_vector;
            }
        }
        normals.iter().map(|n| n.normalize_or_zero()).collect()
    }

    /// Minimum and maximum corner of the bounding box of the referenced vertices; `None` without triangles.
    pub fn bounding_box(&self) -> Option<(DVec3, DVec3)> {
        let mut points = self
            .triangles
            .iter()
            .flatten()
            .map(|&v| self.positions[v as usize]);
        let first = points.next()?;
        Some(points.fold((first, first), |(lo, hi), p| (lo.min(p), hi.max(p))))
    }
}
