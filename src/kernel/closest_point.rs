//! The closest points of a surface to many points.
//!
//! The CPU twin searches a [`Bvh`] in f64, queries in Morton order. The GPU twin walks the same tree in f32, in the tree's own
//! coordinates, and answers with a triangle and weights of its corners. The point and its distance are made of those in f64, so that
//! they are those of a point that is on the surface; f32 only decides which. A wrong choice between neighbours costs some
//! 1e-7 of the size of the mesh in distance, and errors of the weights count squared.

use super::Kernel;
use crate::device::{Buffer, Device, Gpu, Shader, shared_struct, source};
use crate::error::Result;
use crate::geometry::{Bvh, ClosestPoint, bvh, morton};
use crate::mesh::TriangleMesh;
use glam::DVec3;
use rayon::prelude::*;

/// Queries that one batch answers: few enough for every limit, many enough to fill any device.
const BATCH: usize = 1 << 20;

shared_struct! {
    /// The parameters of a dispatch.
    pub struct ClosestParams {
        /// The number of queries.
        queries: u32,
    }
}

shared_struct! {
    /// A node of the tree: the boxes of four children, coordinate by coordinate, and their references, as in [`Bvh`].
    pub struct TreeNode {
        /// Lowest x.
        lo_x: [f32; 4],
        /// Lowest y.
        lo_y: [f32; 4],
        /// Lowest z.
        lo_z: [f32; 4],
        /// Highest x.
        hi_x: [f32; 4],
        /// Highest y.
        hi_y: [f32; 4],
        /// Highest z.
        hi_z: [f32; 4],
        /// Nodes, or runs of leaves.
        children: [u32; 4],
    }
}

shared_struct! {
    /// A triangle of the tree, in the tree's coordinates.
    pub struct TreeLeaf {
        /// The first corner.
        a: [f32; 3],
        /// None.
        padding1: f32,
        /// From the first corner to the second.
        ab: [f32; 3],
        /// None.
        padding2: f32,
        /// From the first corner to the third.
        ac: [f32; 3],
        /// None.
        padding3: f32,
    }
}

/// `shaders/closest_point.wgsl`.
pub const SHADER: Shader = Shader {
    name: "closest_point",
    structs: &[ClosestParams::LAYOUT, TreeNode::LAYOUT, TreeLeaf::LAYOUT],
    sources: &[source!("shared/grid.wgsl"), source!("closest_point.wgsl")],
    constants: &[],
};

/// A surface made ready for closest-point queries on a device.
#[derive(Debug)]
pub struct ClosestPoints {
    bvh: Bvh,
    resident: Option<Resident>,
}

impl ClosestPoints {
    /// Builds the search tree of a mesh with finite positions and valid indices.
    ///
    /// # Errors
    /// Where the mesh has no triangle, or the device no room.
    pub fn new(device: &Device, mesh: &TriangleMesh) -> Result<Self> {
        let bvh = Bvh::new(&mesh.positions, &mesh.triangles)?;
        let resident = match device {
            Device::Cpu => None,
            Device::Gpu(gpu) => Some(Resident::new(gpu, &bvh)?),
        };
        Ok(Self { bvh, resident })
    }

    /// Follows the mesh when its vertices have moved; its triangles must be the same.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn refit(&mut self, mesh: &TriangleMesh) -> Result<()> {
        self.bvh.refit(&mesh.positions, &mesh.triangles);
        if let Some(resident) = &mut self.resident {
            resident.write(&self.bvh)?;
        }
        Ok(())
    }

    /// The closest point for each of `points`, in their order. On the CPU exact in f64, the same bits for any number of threads.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn query(&self, points: &[DVec3]) -> Result<Vec<ClosestPoint>> {
        self.query_beyond(points, 0.0)
    }

    /// The same of those points that are further than `enough` from the surface; for the others any point of the surface that is no further.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn query_beyond(&self, points: &[DVec3], enough: f64) -> Result<Vec<ClosestPoint>> {
        match &self.resident {
            None => Ok(self.bvh.closest_beyond(points, enough)),
            Some(resident) => resident.query(&self.bvh, points),
        }
    }

    /// The point closest to `p` of those triangles, by their index, that are `wanted`, if it is no further than `distance`. For the few points that
    /// the closest one of all does not suit: this is done on the host.
    pub fn query_of(
        &self,
        p: DVec3,
        distance: f64,
        wanted: impl Fn(u32) -> bool,
    ) -> Option<ClosestPoint> {
        self.bvh.closest_of(p, distance, wanted)
    }
}

/// A tree on a device.
#[derive(Debug)]
struct Resident {
    gpu: Gpu,
    nodes: Buffer<TreeNode>,
    leaves: Buffer<TreeLeaf>,
}

impl Resident {
    fn new(gpu: &Gpu, bvh: &Bvh) -> Result<Self> {
        let mut resident = Self {
            gpu: gpu.clone(),
            nodes: Buffer::zeroed(gpu, 0)?,
            leaves: Buffer::zeroed(gpu, 0)?,
        };
        resident.write(bvh)?;
        Ok(resident)
    }

    fn write(&mut self, bvh: &Bvh) -> Result<()> {
        let leaves: Vec<_> = bvh.leaves.iter().map(|leaf| local(bvh, leaf)).collect();
        self.nodes.write(bytemuck::cast_slice(&bvh.nodes))?;
        self.leaves.write(&leaves)
    }

    fn query(&self, bvh: &Bvh, points: &[DVec3]) -> Result<Vec<ClosestPoint>> {
        let order = morton::order(points);
        let mut answers = vec![None; points.len()];
        for part in order.chunks(BATCH) {
            let sorted: Vec<_> = part.iter().map(|&i| points[i as usize]).collect();
            for (&i, answer) in part.iter().zip(self.batch(bvh, &sorted)?) {
                answers[i as usize] = Some(answer);
            }
        }
        Ok(answers.into_iter().flatten().collect())
    }

    fn batch(&self, bvh: &Bvh, points: &[DVec3]) -> Result<Vec<ClosestPoint>> {
        let local: Vec<_> = points
            .iter()
            .map(|&p| {
                ((p - bvh.center) * bvh.scale)
                    .as_vec3()
                    .extend(0.0)
                    .to_array()
            })
            .collect();
        let queries = Buffer::from_slice(&self.gpu, &local)?;
        let answers = Buffer::<[u32; 4]>::zeroed(&self.gpu, points.len())?;
        let mut batch = self.gpu.batch();
        batch.dispatch(
            &self.gpu.pipeline(&SHADER, &[])?,
            points.len(),
            &ClosestParams {
                queries: points.len() as u32,
            },
            &[
                &self.nodes.binding(),
                &self.leaves.binding(),
                &queries.binding(),
                &answers.binding(),
            ],
        )?;
        let read = batch.read(&answers);
        let answers = batch.submit()?.get(&read);
        Ok(answers
            .par_iter()
            .zip(points)
            .with_min_len(1024)
            .map(|(answer, &p)| finish(bvh, *answer, p))
            .collect())
    }
}

/// A leaf in the coordinates of the tree.
fn local(bvh: &Bvh, leaf: &bvh::Leaf) -> TreeLeaf {
    let triangle = &leaf.triangle;
    let single = |v: DVec3| (v * bvh.scale).as_vec3().to_array();
    TreeLeaf {
        a: single(triangle.a - bvh.center),
        ab: single(triangle.ab),
        ac: single(triangle.ac),
        ..bytemuck::Zeroable::zeroed()
    }
}

/// The point that an answer of the device stands for, in f64; found here where the device left it open.
fn finish(bvh: &Bvh, [leaf, v, w, is_open]: [u32; 4], p: DVec3) -> ClosestPoint {
    if is_open != 0 {
        return bvh.closest(p);
    }
    let leaf = &bvh.leaves[(leaf as usize).min(bvh.leaves.len() - 1)];
    let weight = |bits: u32| f64::from(f32::from_bits(bits)).clamp(0.0, 1.0);
    let v = weight(v);
    let w = weight(w).min(1.0 - v);
    let barycentric = [1.0 - v - w, v, w];
    let point = leaf.triangle.point(barycentric);
    ClosestPoint {
        triangle: leaf.index,
        barycentric,
        point,
        distance_squared: (point - p).length_squared(),
    }
}

/// The twins of the closest point.
#[derive(Debug)]
pub struct ClosestPointTwins;

/// A surface and the points to find the closest points to.
#[derive(Debug, Clone)]
pub struct ClosestInput {
    /// With at least one triangle.
    pub mesh: TriangleMesh,
    /// The queries.
    pub points: Vec<DVec3>,
}

impl Kernel for ClosestPointTwins {
    const NAME: &'static str = SHADER.name;
    /// Of the query's distance from the middle of the mesh plus the size of the mesh: f32 rounds those to 6e-8, and with them
    /// the comparison of two triangles. Measured: 1.1e-8.
    const TOLERANCE: f64 = 5e-8;
    type Input = ClosestInput;
    type Output = Vec<ClosestPoint>;
    type Resident = (ClosestPoints, Vec<DVec3>);

    fn items(input: &ClosestInput) -> usize {
        input.points.len()
    }

    fn cpu(input: &ClosestInput) -> Vec<ClosestPoint> {
        Bvh::new(&input.mesh.positions, &input.mesh.triangles)
            .map(|bvh| bvh.closest_all(&input.points))
            .unwrap_or_default()
    }

    fn upload(gpu: &Gpu, input: &ClosestInput) -> Result<Self::Resident> {
        let surface = ClosestPoints::new(&Device::Gpu(gpu.clone()), &input.mesh)?;
        Ok((surface, input.points.clone()))
    }

    fn gpu(_: &Gpu, (surface, points): &mut Self::Resident) -> Result<Vec<ClosestPoint>> {
        surface.query(points)
    }

    /// Distances, not triangles: on a shared edge either is right.
    fn compare(input: &ClosestInput, cpu: &Vec<ClosestPoint>, gpu: &Vec<ClosestPoint>) -> f64 {
        let Some((lo, hi)) = input.mesh.bounding_box() else {
            return f64::INFINITY;
        };
        let (middle, size) = (0.5 * (lo + hi), (hi - lo).length());
        let distance = |c: &ClosestPoint| c.distance_squared.sqrt();
        super::worst_ratio(
            input
                .points
                .iter()
                .zip(cpu.iter().zip(gpu))
                .map(|(p, (a, b))| {
                    (
                        (distance(a) - distance(b)).abs(),
                        (*p - middle).length() + size,
                    )
                }),
        )
    }
}
