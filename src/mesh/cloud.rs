use glam::DVec3;

/// Points without faces.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointCloud {
    /// `[points]`.
    pub positions: Vec<DVec3>,
    /// `[points]`, of unit length; empty where they are not known. Which side they point to is not certain.
    pub normals: Vec<DVec3>,
    /// `[points]`, how much each is to be trusted; empty where nothing is said of it.
    pub confidence: Vec<f64>,
}
