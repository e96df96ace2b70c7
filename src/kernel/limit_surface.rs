//! The closest points of a limit surface to many points, each tracked from a point of the surface nearby.
//!
//! **Theory.** Newton's method on the exact surface, over the edges of its faces ([`Patches::descend`]). What fails, or ends on a boundary that it would have crossed, is
//! found by a search of all patches that cannot miss ([`PatchSearch`]).
//!
//! **Practice.** The CPU twin runs in f64. The GPU twin takes the same steps in f32, in coordinates where the surface is centred and about 1 in
//! size, relative to the query, on tables of the first `LEVELS` levels around irregular corners; what is nearer to such a corner it leaves open. It answers
//! with parameters; the host finishes them with the f64 twin, mostly one step, so that the point and its distance are exact. The GPU
//! twin is for Loop surfaces; Catmull–Clark surfaces run on the CPU. Evaluation and both searches in f64 are at home in the model, which this kernel alone reaches
//! up to.

use super::Kernel;
use crate::device::{Buffer, Device, Gpu, Shader, shared_struct, source};
use crate::error::Result;
use crate::kernel::closest_point::ClosestPoints;
use crate::mesh::{ControlMesh, Scheme, TriangleMesh};
use crate::model::limit_surface::{
    LimitSurface, PatchSearch, Patches, Range, Status, SurfaceParameter, SurfacePoint,
};
use glam::DVec3;
use rayon::prelude::*;

/// Queries that one thread answers in a row.
const CHUNK: usize = 256;
/// Queries that one batch answers.
const BATCH: usize = 1 << 20;
/// Levels around an irregular corner that the device has tables for: below, f32 does not resolve the parameter any more.
const LEVELS: usize = 10;
/// How far a point may be from where Newton's method converges to, relative to the size of the surface.
const SETTLED: f64 = 1e-10;
/// How much nearer than the one found for a query that failed there may be another point of the surface, relative to the size of the surface.
const SEARCHED: f64 = 1e-6;
/// The status of an answer of the device.
const CONVERGED: u32 = 1;
const LEFT_SURFACE: u32 = 2;

/// A point to find the closest point to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimitQuery {
    /// The point.
    pub point: DVec3,
    /// Where to start from on the surface.
    pub start: SurfaceParameter,
    /// Whether the start is to be kept as it is; it then counts as converged.
    pub is_settled: bool,
}

shared_struct! {
    /// The parameters of a dispatch.
    pub struct LimitParams {
        /// The number of queries.
        queries: u32,
    }
}

shared_struct! {
    /// A [`LimitQuery`] in the coordinates of the device.
    pub struct DeviceQuery {
        /// The point.
        point: [f32; 3],
        /// 1 if there is nothing to do.
        is_settled: u32,
        /// The control face to start from.
        face: u32,
        /// Its u.
        u: f32,
        /// Its v.
        v: f32,
        /// None.
        padding: u32,
    }
}

/// `shaders/limit_surface.wgsl`.
pub const SHADER: Shader = Shader {
    name: "limit_surface",
    structs: &[LimitParams::LAYOUT, DeviceQuery::LAYOUT],
    sources: &[
        source!("shared/grid.wgsl"),
        source!("shared/box_spline.wgsl"),
        source!("limit_surface.wgsl"),
    ],
    constants: &[("LEVELS", LEVELS as u32)],
};

/// A limit surface with its control points, made ready for closest-point queries on a device.
#[derive(Debug)]
pub struct ClosestOnLimit<'a> {
    patches: &'a Patches<'a>,
    /// The diagonal of the box of the surface's points.
    size: f64,
    /// How far an answer may be from where Newton's method converges to: a length.
    settled: f64,
    resident: Option<Resident>,
}

impl<'a> ClosestOnLimit<'a> {
    /// Uploads the surface where the device is a GPU and the scheme Loop.
    ///
    /// # Errors
    /// Where the device has no room.
    pub fn new(device: &Device, patches: &'a Patches<'a>) -> Result<Self> {
        let frame = Frame::of(patches);
        let resident = match device {
            Device::Gpu(gpu) if patches.surface().is_loop() => {
                let mut resident = Resident::new(gpu, patches.surface())?;
                resident.bind(patches)?;
                Some(resident)
            }
            _ => None,
        };
        Ok(Self {
            patches,
            size: frame.size,
            settled: SETTLED * frame.size,
            resident,
        })
    }

    /// The same with answers as far as `length` from where Newton's method converges to: fewer steps where that is enough.
    #[must_use]
    pub fn within(self, length: f64) -> Self {
        Self {
            settled: length,
            ..self
        }
    }

    /// A start for each point: the closest point on triangles between limit points, with their parameters.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn first_guess(&self, device: &Device, points: &[DVec3]) -> Result<Vec<SurfaceParameter>> {
        let (mesh, corners) = facets(self.patches);
        let found = ClosestPoints::new(device, &mesh)?.query(points)?;
        Ok(found
            .iter()
            .map(|c| {
                let corners = corners[c.triangle as usize];
                let mix = |pick: fn(&SurfaceParameter) -> f64| {
                    (0..3).map(|k| c.barycentric[k] * pick(&corners[k])).sum()
                };
                SurfaceParameter {
                    face: corners[0].face,
                    u: mix(|p| p.u),
                    v: mix(|p| p.v),
                }
            })
            .collect())
    }

    /// The closest point for each query, tracked from its start: the foot point nearby, which on a surface that folds back need not be the nearest of all. What
    /// fails or leaves the surface is searched for; so every answer has converged. The same bits for any number of threads.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn track(&self, queries: &[LimitQuery]) -> Result<Vec<SurfacePoint>> {
        let mut found = self.descend(queries)?;
        let failed: Vec<usize> = (0..queries.len())
            .filter(|&i| found[i].status != Status::Converged)
            .collect();
        if !failed.is_empty() {
            let points: Vec<DVec3> = failed.iter().map(|&i| queries[i].point).collect();
            let known: Vec<SurfacePoint> = failed.iter().map(|&i| found[i]).collect();
            for (i, point) in
                failed
                    .into_iter()
                    .zip(self.search(&points, &known, SEARCHED * self.size)?)
            {
                found[i] = point;
            }
        }
        Ok(found)
    }

    /// What Newton's method finds from the start of each query, whatever its status.
    ///
    /// # Errors
    /// Where the device fails.
    pub fn descend(&self, queries: &[LimitQuery]) -> Result<Vec<SurfacePoint>> {
        let Some(resident) = &self.resident else {
            return Ok(newton(self.patches, queries, self.settled));
        };
        let raw = resident.query(queries)?;
        let polish = |(query, answer): (&LimitQuery, &Answer)| match query.is_settled {
            true => settled(self.patches, query),
            false => {
                self.patches
                    .descend(query.point, answer.parameter, Range::Surface, self.settled)
            }
        };
        Ok((queries.par_iter().zip(&raw))
            .with_min_len(CHUNK)
            .map(polish)
            .collect())
    }

    /// About where [`descend`](Self::descend) ends for each query, whatever its status: nearer to it by far than a length `near`
    /// ([`Patches::approach`]).
    ///
    /// # Errors
    /// Where the device fails.
    pub fn approach(&self, queries: &[LimitQuery], near: f64) -> Result<Vec<SurfaceParameter>> {
        let raw = match &self.resident {
            Some(resident) => Some(resident.query(queries)?),
            None => None,
        };
        let answer = |(i, query): (usize, &LimitQuery)| match query.is_settled {
            true => query.start,
            false => {
                let start = raw.as_ref().map_or(query.start, |raw| raw[i].parameter);
                self.patches.approach(query.point, start, near)
            }
        };
        Ok((queries.par_iter().enumerate())
            .with_min_len(CHUNK)
            .map(answer)
            .collect())
    }

    /// The nearest point of the whole surface to each of `points`: none is nearer by more than `tolerance`, a length. `known`: a point of the surface for each to
    /// begin with, or an empty list. Runs on the CPU; the time grows as the tolerance shrinks.
    ///
    /// # Errors
    /// None for a surface that could be made.
    pub fn search(
        &self,
        points: &[DVec3],
        known: &[SurfacePoint],
        tolerance: f64,
    ) -> Result<Vec<SurfacePoint>> {
        Ok(PatchSearch::new(self.patches, tolerance)?.nearest_all(points, known))
    }
}

/// The coordinates of the device.
#[derive(Debug, Clone, Copy)]
struct Frame {
    origin: DVec3,
    /// The diagonal of the box of the surface's points.
    size: f64,
}

impl Frame {
    fn of(patches: &Patches<'_>) -> Self {
        let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let points = patches.flat_points().iter();
        let (lo, hi) = points.fold(empty, |(lo, hi), &p| (lo.min(p), hi.max(p)));
        Self {
            origin: patches.origin(),
            size: (hi - lo).length().max(f64::MIN_POSITIVE),
        }
    }
}

/// The f64 twin.
fn newton(patches: &Patches<'_>, queries: &[LimitQuery], tolerance: f64) -> Vec<SurfacePoint> {
    let answer = |query: &LimitQuery| match query.is_settled {
        true => settled(patches, query),
        false => patches.descend(query.point, query.start, Range::Surface, tolerance),
    };
    queries.par_iter().with_min_len(CHUNK).map(answer).collect()
}

/// The start of a query as its answer.
fn settled(patches: &Patches<'_>, query: &LimitQuery) -> SurfacePoint {
    point_at(patches, query, query.start, Status::Converged)
}

fn point_at(
    patches: &Patches<'_>,
    query: &LimitQuery,
    parameter: SurfaceParameter,
    status: Status,
) -> SurfacePoint {
    let position = patches.evaluate(parameter).position;
    SurfacePoint {
        parameter,
        position,
        distance: (position - query.point).length(),
        status,
    }
}

/// Four triangles or eight to a control face, between points of the surface, and the parameters of their corners.
fn facets(patches: &Patches<'_>) -> (TriangleMesh, Vec<[SurfaceParameter; 3]>) {
    let mesh = patches.surface().connectivity();
    let (vertices, edges) = (mesh.vertex_count(), mesh.edge_count());
    let corners: &[[f64; 2]] = match patches.surface().is_loop() {
        true => &[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
        false => &[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
    };
    let n = corners.len();
    // Of a face: its corners, the middles of its edges, and its own middle.
    let middle = |a: [f64; 2], b: [f64; 2]| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
    let mut places = corners.to_vec();
    places.extend((0..n).map(|k| middle(corners[k], corners[(k + 1) % n])));
    places.push([0.5; 2]);
    let before = |k: usize| n + (k + n - 1) % n;
    let mut of_face: Vec<[usize; 3]> = (0..n).map(|k| [k, n + k, before(k)]).collect();
    match n {
        3 => of_face.push([3, 4, 5]),
        _ => of_face.extend((0..n).map(|k| [n + k, 2 * n, before(k)])),
    }
    let number = |f: usize, place: usize| {
        let half_edge = mesh.half_edges(f).start + (place % n) as u32;
        match place / n {
            0 => mesh.origin(half_edge) as usize,
            1 => vertices + mesh.edge_of(half_edge) as usize,
            _ => vertices + edges + f,
        }
    };
    let mut spots: Vec<Option<SurfaceParameter>> = vec![None; vertices + edges + mesh.face_count()];
    let (mut triangles, mut parameters) = (Vec::new(), Vec::new());
    for f in 0..mesh.face_count() {
        let at = |place: usize| SurfaceParameter {
            face: f as u32,
            u: places[place][0],
            v: places[place][1],
        };
        for triangle in &of_face {
            for &place in triangle {
                spots[number(f, place)].get_or_insert(at(place));
            }
            triangles.push(triangle.map(|place| number(f, place) as u32));
            parameters.push(triangle.map(at));
        }
    }
    let position = |spot: &Option<SurfaceParameter>| {
        spot.map_or(patches.origin(), |at| patches.evaluate(at).position)
    };
    let positions = spots.par_iter().map(position).collect();
    (
        TriangleMesh {
            positions,
            triangles,
        },
        parameters,
    )
}

/// A surface on a device.
#[derive(Debug)]
struct Resident {
    gpu: Gpu,
    quarters: Buffer<[u32; 4]>,
    indices: Buffer<u32>,
    pickings: Buffer<f32>,
    neighbours: Buffer<u32>,
    points: Buffer<[f32; 4]>,
    frame: Frame,
}

/// An answer of the device.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Answer {
    parameter: SurfaceParameter,
    status: Status,
}

impl Resident {
    fn new(gpu: &Gpu, surface: &LimitSurface) -> Result<Self> {
        let tables = surface.flat_tables(LEVELS);
        Ok(Self {
            gpu: gpu.clone(),
            quarters: Buffer::from_slice(gpu, &tables.quarters)?,
            indices: Buffer::from_slice(gpu, &tables.indices)?,
            pickings: Buffer::from_slice(gpu, &tables.pickings)?,
            neighbours: Buffer::from_slice(gpu, &tables.neighbours)?,
            points: Buffer::zeroed(gpu, 0)?,
            frame: Frame {
                origin: DVec3::ZERO,
                size: 1.0,
            },
        })
    }

    /// Takes over new control points.
    fn bind(&mut self, patches: &Patches<'_>) -> Result<()> {
        let frame = Frame::of(patches);
        let local: Vec<[f32; 4]> = (patches.flat_points().iter())
            .map(|&p| (p / frame.size).as_vec3().extend(0.0).to_array())
            .collect();
        self.frame = frame;
        self.points.write(&local)
    }

    fn query(&self, queries: &[LimitQuery]) -> Result<Vec<Answer>> {
        let mut answers = Vec::with_capacity(queries.len());
        for part in queries.chunks(BATCH) {
            answers.extend(self.batch(part)?);
        }
        Ok(answers)
    }

    fn batch(&self, queries: &[LimitQuery]) -> Result<Vec<Answer>> {
        let local: Vec<DeviceQuery> = (queries.iter())
            .map(|q| DeviceQuery {
                point: ((q.point - self.frame.origin) / self.frame.size)
                    .as_vec3()
                    .to_array(),
                is_settled: u32::from(q.is_settled),
                face: q.start.face,
                u: q.start.u as f32,
                v: q.start.v as f32,
                padding: 0,
            })
            .collect();
        let uploaded = Buffer::from_slice(&self.gpu, &local)?;
        let answers = Buffer::<[u32; 4]>::zeroed(&self.gpu, queries.len())?;
        let mut batch = self.gpu.batch();
        batch.dispatch(
            &self.gpu.pipeline(&SHADER, SHADER.constants)?,
            queries.len(),
            &LimitParams {
                queries: queries.len() as u32,
            },
            &[
                &self.quarters.binding(),
                &self.indices.binding(),
                &self.points.binding(),
                &self.pickings.binding(),
                &self.neighbours.binding(),
                &uploaded.binding(),
                &answers.binding(),
            ],
        )?;
        let read = batch.read(&answers);
        let answers = batch.submit()?.get(&read);
        Ok(answers
            .into_iter()
            .zip(queries)
            .map(|(a, q)| Answer::of(a, q))
            .collect())
    }
}

impl Answer {
    /// Checked, since a fault of the device must not become an index.
    fn of([face, u, v, status]: [u32; 4], query: &LimitQuery) -> Self {
        let (u, v) = (f32::from_bits(u), f32::from_bits(v));
        let status = match status {
            CONVERGED => Status::Converged,
            LEFT_SURFACE => Status::LeftSurface,
            _ => Status::NotConverged,
        };
        let is_inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
        if query.is_settled || !is_inside {
            return Self {
                parameter: query.start,
                status,
            };
        }
        let parameter = SurfaceParameter {
            face,
            u: u.into(),
            v: v.into(),
        };
        Self { parameter, status }
    }
}

/// The twins of the limit surface: Newton's method, before anything is searched for.
#[derive(Debug)]
pub struct LimitSurfaceTwins;

/// A surface and its queries.
#[derive(Debug, Clone)]
pub struct LimitInput {
    /// One that [`LimitSurface::new`] accepts.
    pub control: ControlMesh,
    /// Loop for the GPU.
    pub scheme: Scheme,
    /// With starts on the surface.
    pub queries: Vec<LimitQuery>,
}

/// A surface on a device, with what its answers need to become points.
#[derive(Debug)]
pub struct ResidentLimit {
    surface: LimitSurface,
    control_points: Vec<DVec3>,
    queries: Vec<LimitQuery>,
    resident: Resident,
}

/// The share of the queries that one twin may leave open and the other not: nearer to an irregular corner than the tables of the device, or so flat a minimum that
/// f32 sees no descent.
const OPEN_SHARE: f64 = 0.02;

impl Kernel for LimitSurfaceTwins {
    const NAME: &'static str = SHADER.name;
    /// Of the query's distance from the middle of the surface plus the size of the surface: f32 rounds the control points to 6e-8 of it and settles within 2e-6, which
    /// at a query on the surface itself is the error of the distance. Measured: 7e-7.
    const TOLERANCE: f64 = 4e-6;
    type Input = LimitInput;
    type Output = Vec<SurfacePoint>;
    type Resident = ResidentLimit;

    fn items(input: &LimitInput) -> usize {
        input.queries.len()
    }

    fn cpu(input: &LimitInput) -> Vec<SurfacePoint> {
        LimitSurface::new(&input.control, input.scheme)
            .map(|surface| {
                let patches = surface.patches(&input.control.mesh.positions);
                newton(&patches, &input.queries, SETTLED * Frame::of(&patches).size)
            })
            .unwrap_or_default()
    }

    fn upload(gpu: &Gpu, input: &LimitInput) -> Result<ResidentLimit> {
        let surface = LimitSurface::new(&input.control, input.scheme)?;
        let mut resident = Resident::new(gpu, &surface)?;
        let control_points = input.control.mesh.positions.clone();
        resident.bind(&surface.patches(&control_points))?;
        Ok(ResidentLimit {
            surface,
            control_points,
            queries: input.queries.clone(),
            resident,
        })
    }

    fn gpu(_: &Gpu, held: &mut ResidentLimit) -> Result<Vec<SurfacePoint>> {
        let patches = held.surface.patches(&held.control_points);
        held.resident.bind(&patches)?;
        let answers = held.resident.query(&held.queries)?;
        Ok((held.queries.par_iter().zip(&answers))
            .with_min_len(CHUNK)
            .map(|(query, answer)| point_at(&patches, query, answer.parameter, answer.status))
            .collect())
    }

    /// Distances where both twins have settled; where more than a few have settled on one only, the twins disagree.
    fn compare(input: &LimitInput, cpu: &Vec<SurfacePoint>, gpu: &Vec<SurfacePoint>) -> f64 {
        let points = || input.control.mesh.positions.iter();
        let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (lo, hi) = points().fold(empty, |(lo, hi), &p| (lo.min(p), hi.max(p)));
        let (middle, size) = (0.5 * (lo + hi), (hi - lo).length());
        let is_open = |p: &SurfacePoint| p.status == Status::NotConverged;
        let pairs = || cpu.iter().zip(gpu);
        let differ = pairs().filter(|(a, b)| is_open(a) != is_open(b)).count();
        if differ as f64 > OPEN_SHARE * cpu.len() as f64 {
            return f64::INFINITY;
        }
        super::worst_ratio(
            (input.queries.iter().zip(pairs()))
                .filter(|(_, (a, b))| !is_open(a) && !is_open(b))
                .map(|(query, (a, b))| {
                    let scale = (query.point - middle).length() + size;
                    ((a.distance - b.distance).abs(), scale)
                }),
        )
    }
}
