//! The shaders of the shapes, and how a pass is split among threads and dispatches.

use super::ElementTables;
use super::tables::{Collapsed, Factors, Samples};
use crate::device::{MAX_ITERATIONS, Shader, Source, WORKGROUP_SIZE, shared_struct, source};
use crate::error::{Error, Result};
use crate::geometry::distortion::Distortion;

/// f32 in the workgroup memory that every device has.
const WORKGROUP_MEMORY: usize = 4096;

shared_struct! {
    /// The parameters of a dispatch.
    pub struct ElementParams {
        /// The number of elements.
        elements: u32,
        /// The first slab of this dispatch.
        first_slab: u32,
        /// The slab after its last.
        end_slab: u32,
    }
}

shared_struct! {
    /// The parameters of a change of basis.
    pub struct BasisParams {
        /// Elements times coordinates.
        vectors: u32,
        /// Coefficients of each.
        modes: u32,
    }
}

const DISTORTION: Source = source!("shared/distortion.wgsl");
const STRAIN: Source = source!("shared/distortion_strain.wgsl");
const DIRICHLET: Source = source!("shared/distortion_dirichlet.wgsl");
const CONDITION_NUMBER: Source = source!("shared/distortion_condition_number.wgsl");
const MEAN_RATIO: Source = source!("shared/distortion_mean_ratio.wgsl");
const ELEMENT_ENERGY: Source = source!("element_energy.wgsl");

/// `shaders/element_energy.wgsl` with the file of a shape. The shape is a constant too, so that the variants are told apart.
macro_rules! shader {
    ($path:literal, $constants:expr) => {
        Shader {
            name: "element_energy",
            structs: &[ElementParams::LAYOUT],
            sources: &[
                DISTORTION,
                STRAIN,
                DIRICHLET,
                CONDITION_NUMBER,
                MEAN_RATIO,
                source!($path),
                ELEMENT_ENERGY,
            ],
            constants: $constants,
        }
    };
}

/// For hexahedra; checked at order 2.
pub const HEXAHEDRON: Shader = shader!(
    "shared/element_hexahedron.wgsl",
    &[
        ("SHAPE", 0),
        ("DISTORTION", 0),
        ("GRADIENT", 1),
        ("ELEMENTS", 4),
        ("MODES", 27),
        ("POINTS", 64),
        ("SLAB_POINTS", 16),
        ("BEHIND", 144),
        ("SHARE", 180),
        ("POOL", 720),
        ("LINE_MODES", 3),
        ("LINE_POINTS", 4),
    ]
);

/// For prisms; checked at order 2.
pub const PRISM: Shader = shader!(
    "shared/element_prism.wgsl",
    &[
        ("SHAPE", 1),
        ("DISTORTION", 0),
        ("GRADIENT", 1),
        ("ELEMENTS", 4),
        ("MODES", 18),
        ("POINTS", 64),
        ("SLAB_POINTS", 16),
        ("SHARE", 180),
        ("POOL", 720),
        ("LINE_MODES", 3),
        ("LINE_POINTS", 4),
        ("TRIANGLE_MODES", 6),
    ]
);

/// For elements that do not factor; checked at order 2 of tetrahedra.
pub const DENSE: Shader = shader!(
    "shared/element_dense.wgsl",
    &[
        ("SHAPE", 2),
        ("DISTORTION", 0),
        ("GRADIENT", 1),
        ("ELEMENTS", 1),
        ("MODES", 10),
        ("POINTS", 64),
        ("SLAB_POINTS", 64),
        ("SHARE", 576),
        ("POOL", 576),
    ]
);

/// For tetrahedra in collapsed coordinates; checked at order 2.
pub const COLLAPSED: Shader = shader!(
    "shared/element_collapsed.wgsl",
    &[
        ("SHAPE", 3),
        ("DISTORTION", 0),
        ("GRADIENT", 1),
        ("ELEMENTS", 4),
        ("MODES", 10),
        ("POINTS", 64),
        ("SLAB_POINTS", 16),
        ("BEHIND", 144),
        ("SHARE", 180),
        ("POOL", 720),
        ("COUNT", 3),
        ("POINTS_S", 4),
        ("POINTS_T", 4),
        ("POINTS_R", 4),
    ]
);

/// `shaders/element_basis.wgsl`.
pub const BASIS: Shader = Shader {
    name: "element_basis",
    structs: &[BasisParams::LAYOUT],
    sources: &[source!("shared/grid.wgsl"), source!("element_basis.wgsl")],
    constants: &[],
};

/// How a pass is split among threads and dispatches.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    pub shader: &'static Shader,
    constants: Vec<(&'static str, u32)>,
    pub elements_a_group: usize,
    pub slabs: usize,
    /// Slabs of one dispatch: no thread may run too many iterations.
    pub slabs_at_once: usize,
}

/// What the shader of a shape needs to know, and where things are in an element's part of the workgroup memory.
struct Needs {
    shader: &'static Shader,
    /// Points of a slab.
    slab: usize,
    /// Where the numbers begin that lie behind the derivatives at the points.
    behind: usize,
    /// How many these are.
    extra: usize,
    /// Constants of the shape.
    own: Vec<(&'static str, usize)>,
}

impl Needs {
    /// With `threads` threads an element.
    fn of(factors: &Factors, threads: usize) -> Self {
        match factors {
            Factors::Hexahedron(line) => {
                let (n, q) = (line.modes, line.points());
                let behind = staged(q * q, n);
                Self {
                    shader: &HEXAHEDRON,
                    slab: q * q,
                    behind,
                    extra: 3 * n * q,
                    own: vec![("LINE_MODES", n), ("LINE_POINTS", q), ("BEHIND", behind)],
                }
            }
            Factors::Prism(triangle, line) => Self {
                shader: &PRISM,
                slab: triangle.points(),
                behind: 9 * triangle.points(),
                extra: 6 * triangle.modes,
                own: vec![
                    ("LINE_MODES", line.modes),
                    ("LINE_POINTS", line.points()),
                    ("TRIANGLE_MODES", triangle.modes),
                ],
            },
            Factors::Dense(_) => Self {
                shader: &DENSE,
                slab: threads,
                behind: 9 * threads,
                extra: 0,
                own: Vec::new(),
            },
            Factors::Collapsed(collapsed) => {
                let n = collapsed.first.modes;
                let [s, t, r] = collapsed.axes.each_ref().map(Vec::len);
                let behind = staged(s * t, n);
                Self {
                    shader: &COLLAPSED,
                    slab: s * t,
                    behind,
                    extra: 3 * n * t,
                    own: vec![
                        ("COUNT", n),
                        ("POINTS_S", s),
                        ("POINTS_T", t),
                        ("POINTS_R", r),
                        ("BEHIND", behind),
                    ],
                }
            }
        }
    }
}

/// Behind the derivatives at the points of a slab, and behind the first stage, which lies where those of the third coordinate will be.
fn staged(slab: usize, modes: usize) -> usize {
    (9 * slab).max(6 * slab + 2 * modes * modes)
}

impl Needs {
    /// Numbers in workgroup memory for an element; the sums of its threads are there at the end.
    fn share(&self, threads: usize) -> usize {
        (self.behind + self.extra).max(2 * threads)
    }
}

/// Elements that share a workgroup: as few as leave few of its threads idle.
fn elements_a_group(tables: &ElementTables) -> usize {
    let threads = |elements: usize| WORKGROUP_SIZE as usize / elements;
    let busy = |elements: usize| {
        let items = match &tables.factors {
            Factors::Dense(_) => tables.points(),
            factors => Needs::of(factors, threads(elements)).slab,
        };
        items as f64 / items.next_multiple_of(threads(elements)) as f64
    };
    let fits = |&elements: &usize| {
        let needs = Needs::of(&tables.factors, threads(elements));
        elements * needs.share(threads(elements)) <= WORKGROUP_MEMORY
    };
    let choices: Vec<usize> = [1, 2, 4, 8, 16].into_iter().filter(fits).collect();
    let best = choices.iter().map(|&e| busy(e)).fold(0.0, f64::max);
    let enough = choices.into_iter().find(|&e| busy(e) >= 0.9 * best);
    enough.unwrap_or(1)
}

impl Plan {
    pub fn new(tables: &ElementTables, with_gradient: bool) -> Result<Self> {
        let (modes, points) = (tables.modes(), tables.points());
        let elements = elements_a_group(tables);
        let threads = WORKGROUP_SIZE as usize / elements;
        let needs = Needs::of(&tables.factors, threads);
        let slab = needs.slab;
        let share = needs.share(threads);
        if elements * share > WORKGROUP_MEMORY {
            return Err(Error::device(
                format!(
                    "elements with {slab} points a slab pass the workgroup memory that every device has"
                ),
                "use fewer quadrature points, or run on the CPU",
            ));
        }
        let mut constants = vec![
            ("SHAPE", needs.shader.constants[0].1 as usize),
            ("GRADIENT", usize::from(with_gradient)),
            ("ELEMENTS", elements),
            ("MODES", modes),
            ("POINTS", points),
            ("SLAB_POINTS", slab),
            ("SHARE", share),
            ("POOL", elements * share),
        ];
        constants.extend(needs.own);
        let most = MAX_ITERATIONS / iterations(&tables.factors, modes, slab, threads);
        Ok(Self {
            shader: needs.shader,
            constants: constants
                .into_iter()
                .map(|(name, value)| (name, value as u32))
                .collect(),
            elements_a_group: elements,
            slabs: points.div_ceil(slab),
            slabs_at_once: most.max(1),
        })
    }

    pub fn constants(&self, distortion: Distortion) -> Vec<(&'static str, u32)> {
        let index = Distortion::ALL.iter().position(|&d| d == distortion);
        let mut constants = self.constants.clone();
        constants.push(("DISTORTION", index.unwrap_or(0) as u32));
        constants
    }

    /// As the file of the shape says.
    pub fn tables(&self, factors: &Factors) -> Vec<f32> {
        match factors {
            Factors::Hexahedron(line) => line_table(line),
            Factors::Prism(triangle, line) => {
                let [u, v] = [0, 1].map(|k| &triangle.derivatives[k]);
                let each = [&triangle.values, u, v];
                let columns = each.map(|t| transposed(t, triangle.modes)).concat();
                let rows = each.map(Vec::as_slice).concat();
                [singles(&columns), singles(&rows), line_table(line)].concat()
            }
            Factors::Dense(samples) => {
                let slab = WORKGROUP_SIZE as usize / self.elements_a_group;
                dense_table(samples, slab)
            }
            Factors::Collapsed(collapsed) => collapsed_table(collapsed),
        }
    }
}

/// An upper bound of what a thread loops in a slab.
fn iterations(factors: &Factors, modes: usize, slab: usize, threads: usize) -> usize {
    let share = |items: usize| items.div_ceil(threads);
    // Of three stages there and back, as on a hexahedron with n modes and q points an axis.
    let stages = |n: usize, q: usize| {
        let there = share(n * n) * n + share(n * q) * n + share(q * q) * n;
        let back = share(q * q) + share(n * q) * q + share(n * n) * (q + n);
        3 * (there + back)
    };
    let shape = match factors {
        Factors::Hexahedron(line) => stages(line.modes, line.points()),
        Factors::Prism(triangle, line) => {
            let n = triangle.modes;
            share(3 * n) * line.modes + share(slab) * n + share(n) * (slab + 4 * line.modes)
        }
        Factors::Dense(_) => modes + share(modes) * (slab + 4),
        Factors::Collapsed(collapsed) => {
            let most = collapsed.axes.iter().map(Vec::len).max();
            stages(collapsed.first.modes, most.unwrap_or(0))
        }
    };
    shape + 8 * share(slab) + threads
}

pub(super) fn singles(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&x| x as f32).collect()
}

/// `[columns, rows]` of `[rows, columns]`.
pub(super) fn transposed(entries: &[f64], columns: usize) -> Vec<f64> {
    let rows = entries.len() / columns;
    (0..entries.len())
        .map(|k| entries[k % rows * columns + k / rows])
        .collect()
}

fn line_table(line: &Samples) -> Vec<f32> {
    [singles(&line.values), singles(&line.derivatives[0])].concat()
}

/// `[slabs, modes, 3, slab]`.
fn dense_table(samples: &Samples, slab: usize) -> Vec<f32> {
    let (n, points) = (samples.modes, samples.points());
    let slabs = points.div_ceil(slab);
    let mut table = vec![0f32; slabs * n * 3 * slab];
    for (axis, derivative) in samples.derivatives.iter().enumerate() {
        for (k, &x) in derivative.iter().enumerate() {
            let (point, mode) = (k / n, k % n);
            let row = (point / slab * n + mode) * 3 + axis;
            table[row * slab + point % slab] = x as f32;
        }
    }
    table
}

/// Rows of the families filled up with zeros.
fn collapsed_table(collapsed: &Collapsed) -> Vec<f32> {
    let n = collapsed.first.modes;
    let mut table = line_table(&collapsed.first);
    for family in [&collapsed.second, &collapsed.third] {
        let values = |member: &Samples| padded(&member.values, member.modes, n);
        let slopes = |member: &Samples| padded(&member.derivatives[0], member.modes, n);
        table.extend(family.iter().flat_map(values));
        table.extend(family.iter().flat_map(slopes));
    }
    table.extend(collapsed.axes.iter().flatten().map(|&x| x as f32));
    table
}

fn padded(entries: &[f64], columns: usize, width: usize) -> Vec<f32> {
    entries
        .chunks_exact(columns)
        .flat_map(|row| (0..width).map(|c| row.get(c).map_or(0.0, |&x| x as f32)))
        .collect()
}
