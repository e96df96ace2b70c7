use super::*;
use crate::geometry::random::Random;
use crate::mesh::{Connectivity, PolygonMesh};

const SHAPES: [CellShape; 3] = [
    CellShape::Tetrahedron,
    CellShape::Prism,
    CellShape::Hexahedron,
];
/// Shapes that can share a face of that many corners.
const NEIGHBOURS: [([CellShape; 2], usize); 6] = {
    use CellShape::{Hexahedron as H, Prism as P, Tetrahedron as T};
    [
        ([H, H], 4),
        ([H, P], 4),
        ([P, P], 4),
        ([P, P], 3),
        ([T, T], 3),
        ([P, T], 3),
    ]
};
const BASES: [Basis; 2] = [Basis::Legendre, Basis::Fourier];

fn random_vector(random: &mut Random) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|_| random.between(-1.0, 1.0)))
}

/// Renumbers the vertices at random.
fn relabelled(random: &mut Random, mesh: &VolumeMesh) -> VolumeMesh {
    let mut labels: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    for k in (1..labels.len()).rev() {
        labels.swap(k, random.below(k + 1));
    }
    let mut positions = mesh.positions.clone();
    for (&label, &p) in labels.iter().zip(&mesh.positions) {
        positions[label as usize] = p;
    }
    let mut result = VolumeMesh::new(positions);
    for (shape, cell) in mesh.cells() {
        let cell: Vec<u32> = cell.iter().map(|&v| labels[v as usize]).collect();
        result.push_cell(shape, &cell);
    }
    result
}

/// Two cells that share a random pair of faces with `corners` corners in a random rotation, and that face of each.
fn glued(
    random: &mut Random,
    shapes: [CellShape; 2],
    corners: usize,
) -> (VolumeMesh, [&'static [usize]; 2]) {
    let faces = shapes.map(|shape| {
        let fit: Vec<_> = shape
            .faces()
            .iter()
            .filter(|f| f.len() == corners)
            .collect();
        *fit[random.below(fit.len())]
    });
    let rotation = random.below(corners);
    let first: Vec<u32> = (0..shapes[0].vertex_count() as u32).collect();
    let mut count = first.len() as u32;
    let second: Vec<u32> = (0..shapes[1].vertex_count())
        .map(|v| match faces[1].iter().position(|&k| k == v) {
            // Seen from the other side, a face runs backwards.
            Some(k) => first[faces[0][(2 * corners - k + rotation) % corners]],
            None => {
                count += 1;
                count - 1
            }
        })
        .collect();
    let mut mesh = VolumeMesh::new((0..count).map(|_| random_vector(random)).collect());
    mesh.push_cell(shapes[0], &first);
    mesh.push_cell(shapes[1], &second);
    (mesh, faces)
}

/// The reference coordinates of the point of a cell whose weights at some vertices are given.
fn point_on(volume: &CurvedVolume, c: usize, weights: &[(u32, f64)]) -> DVec3 {
    let ids = volume.vertices(c);
    weights
        .iter()
        .map(|&(v, w)| {
            let k = ids.iter().position(|&id| id == v).unwrap();
            w * corners(volume.shape(c))[k]
        })
        .sum()
}

fn randomized(
    random: &mut Random,
    mesh: &VolumeMesh,
    basis: Basis,
    orders: &[usize],
) -> CurvedVolume {
    let mut volume = CurvedVolume::new(mesh, basis)
        .unwrap()
        .raised(orders)
        .unwrap();
    volume
        .coefficients
        .iter_mut()
        .for_each(|c| *c = random_vector(random));
    volume
}

/// A random point of the face that two cells share, `face` of the first, as either sees it.
fn seen_from_both(
    random: &mut Random,
    volume: &CurvedVolume,
    mesh: &VolumeMesh,
    face: &[usize],
) -> [DVec3; 2] {
    let [x, y] = [random.uniform(), random.uniform()];
    let weights = match face.len() {
        4 => vec![(1.0 - x) * (1.0 - y), x * (1.0 - y), x * y, (1.0 - x) * y],
        _ => vec![1.0 - x, x * (1.0 - y), x * y],
    };
    let shared = face.iter().map(|&k| mesh.cell(0)[k]);
    let weights: Vec<(u32, f64)> = shared.zip(weights).collect();
    [0, 1].map(|c| volume.evaluate(c, point_on(volume, c, &weights)).0)
}

#[test]
fn every_pair_of_cells_conforms_whatever_the_labels_and_orders() {
    let mut random = Random::new(1);
    for (shapes, corners) in NEIGHBOURS {
        for basis in BASES {
            for round in 0..25 {
                let (mesh, faces) = glued(&mut random, shapes, corners);
                let mesh = relabelled(&mut random, &mesh);
                let highest = if round < 24 { 6 } else { 12 };
                let orders = [0, 1].map(|_| 1 + random.below(highest));
                let volume = randomized(&mut random, &mesh, basis, &orders);
                let [a, b] = seen_from_both(&mut random, &volume, &mesh, faces[0]);
                assert!(
                    a.distance(b) < 1e-12,
                    "{shapes:?} {basis:?} {orders:?}: {a} {b}"
                );
            }
        }
    }
}

#[test]
fn every_pair_of_cells_conforms_whatever_the_orders_of_their_boundaries() {
    let mut random = Random::new(11);
    for (shapes, corners) in NEIGHBOURS {
        for basis in BASES {
            for _ in 0..10 {
                let (mesh, faces) = glued(&mut random, shapes, corners);
                let mesh = relabelled(&mut random, &mesh);
                let flat = CurvedVolume::new(&mesh, basis).unwrap();
                let boundary = flat.boundary().into_iter();
                let orders: Vec<usize> = boundary.map(|_| 1 + random.below(7)).collect();
                let mut volume = flat.graded(&orders, 1 + random.below(4)).unwrap();
                assert_eq!(volume.boundary_orders(), orders);
                for c in &mut volume.coefficients {
                    *c = random_vector(&mut random);
                }
                let [a, b] = seen_from_both(&mut random, &volume, &mesh, faces[0]);
                assert!(a.distance(b) < 1e-12, "{shapes:?} {orders:?}: {a} {b}");
                // Elevated to one order, for files, it is the same.
                if basis == Basis::Legendre {
                    let nodes = volume.nodes(volume.highest_order());
                    let error = volume.interpolation_error(&nodes).unwrap();
                    assert!(error < 1e-10, "{shapes:?} {orders:?}: {error}");
                }
            }
        }
    }
}

#[test]
fn grading_keeps_what_the_new_orders_hold_and_drops_the_rest() {
    let mut random = Random::new(12);
    for shape in SHAPES {
        let mesh = relabelled(&mut random, &block(shape, 2));
        let cells: Vec<u32> = (0..mesh.cell_count() as u32).collect();
        let flat = CurvedVolume::new(&mesh, Basis::Legendre).unwrap();
        let faces = flat.boundary().len();
        let low: Vec<usize> = (0..faces).map(|_| 2 + random.below(3)).collect();
        let mut volume = flat.graded(&low, 2).unwrap();
        for c in &mut volume.coefficients {
            *c = random_vector(&mut random);
        }
        let high: Vec<usize> = low.iter().map(|p| p + random.below(3)).collect();
        let raised = volume.graded(&high, 4).unwrap();
        let grid = Grid::lattice(shape, 3);
        let pairs = volume.positions(&cells, &grid).into_iter();
        for (a, b) in pairs.zip(raised.positions(&cells, &grid)) {
            assert!(a.distance(b) < 1e-12, "{shape:?}");
        }
        assert!(raised.graded(&low, 2).unwrap() == volume);
        assert_eq!(
            flat.full_count(5),
            flat.raised(&vec![5; cells.len()])
                .unwrap()
                .coefficients
                .len()
        );
        // The highest modes of a face and its edges are those that one order less has not.
        let tops = raised.boundary_top_modes();
        for (f, &order) in high.iter().enumerate().filter(|f| *f.1 > 2) {
            let mut orders = high.clone();
            orders[f] = order - 1;
            let lowered = raised.graded(&orders, 4).unwrap();
            let lost = raised.coefficients.len() - lowered.coefficients.len();
            assert!((1..=tops[f].len()).contains(&lost), "{shape:?}: {lost}");
        }
        let pairs = raised.boundary_neighbours();
        // A closed surface: every edge has two faces.
        let sides: usize = flat
            .boundary()
            .iter()
            .map(|&(c, k)| flat.shape(c as usize).faces()[k as usize].len())
            .sum();
        assert_eq!(2 * pairs.len(), sides, "{shape:?}");
        assert!(flat.graded(&vec![0; faces], 2).is_err() && flat.graded(&low, 17).is_err());
    }
}

#[test]
fn traces_see_every_mode_of_the_face_between() {
    // Else the test above could pass with all inner modes lost.
    let mut random = Random::new(2);
    let (mesh, faces) = glued(&mut random, [CellShape::Prism, CellShape::Tetrahedron], 3);
    let volume = randomized(&mut random, &mesh, Basis::Legendre, &[6, 6]);
    let shared: Vec<u32> = faces[0].iter().map(|&k| mesh.cell(0)[k]).collect();
    let weights: Vec<(u32, f64)> = shared.iter().copied().zip([0.2, 0.3, 0.5]).collect();
    let face = volume.face_over(&shared);
    for c in 0..2 {
        let at = point_on(&volume, c, &weights);
        let before = volume.evaluate(c, at).0;
        for mode in volume.face_modes(face) {
            let mut moved = volume.clone();
            moved.coefficients[mode as usize] += DVec3::X;
            assert!(moved.evaluate(c, at).0.distance(before) > 1e-6, "{mode}");
        }
    }
}

/// A cell in its ideal shape.
fn single(shape: CellShape) -> VolumeMesh {
    let a = reference_matrix(shape);
    let mut mesh = VolumeMesh::new(corners(shape).iter().map(|&u| a * u).collect());
    let all: Vec<u32> = (0..shape.vertex_count() as u32).collect();
    mesh.push_cell(shape, &all);
    mesh
}

#[test]
fn ideal_shapes_have_the_identity_as_jacobian_under_every_labelling() {
    let mut random = Random::new(3);
    for shape in SHAPES {
        for _ in 0..20 {
            let mesh = relabelled(&mut random, &single(shape));
            let volume = CurvedVolume::new(&mesh, Basis::Legendre)
                .unwrap()
                .raised(&[3])
                .unwrap();
            let local = volume.gather(&[0]).apply(&volume.coefficients);
            let grid = Grid::lattice(shape, 2);
            for gradient in Tables::new(Basis::Legendre, 3, &grid).gradients(&local) {
                let jacobian = gradient * volume.reference_inverse(0);
                assert!(
                    (jacobian - DMat3::IDENTITY).abs_diff_eq(DMat3::ZERO, 1e-14),
                    "{shape:?}"
                );
            }
        }
    }
}

#[test]
fn grids_points_and_derivatives_agree() {
    let mut random = Random::new(4);
    for shape in SHAPES {
        for basis in BASES {
            let mesh = relabelled(&mut random, &single(shape));
            let volume = randomized(&mut random, &mesh, basis, &[5]);
            let grid = Grid::lattice(shape, 3);
            let positions = volume.positions(&[0], &grid);
            for (u, x) in grid.points().into_iter().zip(positions) {
                let (at, gradient) = volume.evaluate(0, u);
                assert!(at.distance(x) < 1e-12);
                let h = 1e-6;
                for k in 0..3 {
                    let step = h * DVec3::AXES[k];
                    let difference =
                        volume.evaluate(0, u + step).0 - volume.evaluate(0, u - step).0;
                    let error = (difference / (2.0 * h) - gradient.col(k)).length();
                    assert!(error < 1e-6, "{shape:?} {basis:?} {k}: {error:e}");
                }
            }
        }
    }
}

/// n³ unit cubes, each one hexahedron, two prisms or six tetrahedra (Kuhn's).
fn block(shape: CellShape, n: u32) -> VolumeMesh {
    let m = n + 1;
    let point = |k: u32| {
        DVec3::new(
            f64::from(k % m),
            f64::from(k / m % m),
            f64::from(k / (m * m)),
        )
    };
    let mut mesh = VolumeMesh::new((0..m * m * m).map(point).collect());
    for cube in 0..n * n * n {
        let (x, y, z) = (cube % n, cube / n % n, cube / (n * n));
        let at = |u: [u32; 3]| x + u[0] + m * (y + u[1] + m * (z + u[2]));
        let quad = |z| [[0, 0, z], [1, 0, z], [1, 1, z], [0, 1, z]].map(at);
        let (low, high) = (quad(0), quad(1));
        match shape {
            CellShape::Hexahedron => mesh.push_cell(shape, &[low, high].concat()),
            CellShape::Prism => {
                for t in [[0, 1, 2], [0, 2, 3]] {
                    mesh.push_cell(shape, &[t.map(|k| low[k]), t.map(|k| high[k])].concat());
                }
            }
            CellShape::Tetrahedron => {
                for [a, b, c] in [
                    [0, 1, 2],
                    [1, 2, 0],
                    [2, 0, 1],
                    [0, 2, 1],
                    [2, 1, 0],
                    [1, 0, 2],
                ] {
                    let mut u = [0; 3];
                    let mut path = vec![at(u)];
                    for axis in [a, b, c] {
                        u[axis] += 1;
                        path.push(at(u));
                    }
                    if (b + 3 - a) % 3 != 1 {
                        path.swap(1, 2);
                    }
                    mesh.push_cell(shape, &path);
                }
            }
        }
    }
    mesh
}

#[test]
fn the_coefficients_of_a_block_are_as_many_as_its_lagrange_nodes() {
    for shape in SHAPES {
        let mesh = block(shape, 2);
        for order in [1, 2, 3, 5] {
            let volume = CurvedVolume::new(&mesh, Basis::Legendre)
                .unwrap()
                .raised(&vec![order; mesh.cell_count()])
                .unwrap();
            assert_eq!(
                volume.coefficients.len(),
                (2 * order + 1).pow(3),
                "{shape:?} {order}"
            );
            assert_eq!(volume.groups().len(), 1);
            let gather = volume.gather(&volume.groups()[0].cells);
            assert_eq!(
                gather.row_count(),
                mesh.cell_count() * mode_count(shape, order)
            );
            // Every local mode has a coefficient, every coefficient is in use.
            assert!(gather.offsets.windows(2).all(|w| w[0] < w[1]));
            assert!(gather.transpose().offsets.windows(2).all(|w| w[0] < w[1]));
        }
    }
}

#[test]
fn raising_orders_keeps_the_shape_and_makes_neighbours_agree() {
    let mut random = Random::new(5);
    for shape in SHAPES {
        let mesh = relabelled(&mut random, &block(shape, 2));
        let cells: Vec<u32> = (0..mesh.cell_count() as u32).collect();
        let orders = |random: &mut Random| -> Vec<usize> {
            cells.iter().map(|_| 1 + random.below(4)).collect()
        };
        let low = orders(&mut random);
        let before = randomized(&mut random, &mesh, Basis::Fourier, &low);
        let high = orders(&mut random);
        let after = before.raised(&high).unwrap();
        let grid = Grid::lattice(shape, 2);
        let moved = before.positions(&cells, &grid);
        for (a, b) in moved.iter().zip(after.positions(&cells, &grid)) {
            assert!(a.distance(b) < 1e-12);
        }
        for c in 0..cells.len() {
            assert_eq!(after.order(c), low[c].max(high[c]));
            assert!(after.kernel_order(c) >= after.order(c));
        }
        let counted: usize = after.groups().iter().map(|g| g.cells.len()).sum();
        assert_eq!(counted, cells.len());
    }
}

#[test]
fn the_boundary_of_a_block_is_closed_outward_and_on_its_cells() {
    let mut random = Random::new(6);
    for shape in SHAPES {
        for basis in BASES {
            let mesh = relabelled(&mut random, &block(shape, 2));
            let orders: Vec<usize> = (0..mesh.cell_count())
                .map(|_| 1 + random.below(4))
                .collect();
            let mut volume = CurvedVolume::new(&mesh, basis)
                .unwrap()
                .raised(&orders)
                .unwrap();
            for n in [1, 2, 5] {
                let surface = volume.boundary_surface(n);
                let polygons = PolygonMesh::from_faces(
                    surface.mesh(&volume.coefficients).positions,
                    surface.triangles.iter().map(|t| &t[..]),
                );
                let edges = Connectivity::of(&polygons).unwrap();
                assert!((0..edges.edge_count() as u32).all(|e| !edges.is_boundary_edge(e)));
                let enclosed: f64 = surface
                    .triangles
                    .iter()
                    .map(|t| t.map(|v| polygons.positions[v as usize]))
                    .map(|[a, b, c]| a.dot(b.cross(c)) / 6.0)
                    .sum();
                assert!((enclosed - 8.0).abs() < 1e-12, "{shape:?}: {enclosed}");
            }
            let vertices = volume.vertex_count();
            for c in &mut volume.coefficients[vertices..] {
                *c = 0.1 * random_vector(&mut random);
            }
            let n = 4;
            let surface = volume.boundary_surface(n);
            let samples = surface.mesh(&volume.coefficients);
            let grid = Grid::lattice(shape, n);
            for (patch, &(c, _)) in volume.boundary().iter().enumerate() {
                let points = volume.positions(&[c], &grid);
                let mine = surface.patches.iter().zip(&surface.triangles);
                for (_, t) in mine.filter(|(p, _)| **p as usize == patch) {
                    for v in t {
                        let x = samples.positions[*v as usize];
                        assert!(points.iter().any(|p| p.distance(x) < 1e-12), "{shape:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn tables_do_not_depend_on_the_number_of_threads() {
    let mesh = block(CellShape::Prism, 3);
    let orders: Vec<usize> = (0..mesh.cell_count()).map(|c| 1 + c % 5).collect();
    let volume = CurvedVolume::new(&mesh, Basis::Fourier)
        .unwrap()
        .raised(&orders)
        .unwrap();
    let cells: Vec<u32> = (0..mesh.cell_count() as u32).collect();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| (volume.gather(&cells), volume.boundary_surface(3)))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn meshes_that_are_no_volume_are_refused_by_name() {
    let message = |mesh: &VolumeMesh| {
        CurvedVolume::new(mesh, Basis::Legendre)
            .unwrap_err()
            .to_string()
    };
    let positions = vec![DVec3::ZERO; 7];
    let mut mesh = VolumeMesh::new(positions.clone());
    assert!(message(&mesh).contains("no cells"));
    mesh.push_cell(CellShape::Tetrahedron, &[0, 1, 2, 7]);
    assert!(message(&mesh).contains("vertex 7 of 7"));
    let mut mesh = VolumeMesh::new(positions.clone());
    mesh.push_cell(CellShape::Tetrahedron, &[0, 1, 2, 1]);
    assert!(message(&mesh).contains("vertex 1 twice"));
    let mut mesh = VolumeMesh::new(positions.clone());
    for apex in 3..6 {
        mesh.push_cell(CellShape::Tetrahedron, &[0, 1, 2, apex]);
    }
    assert!(message(&mesh).contains("3 cells"));
    let mut mesh = VolumeMesh::new(vec![DVec3::ZERO; 12]);
    mesh.push_cell(CellShape::Hexahedron, &[0, 1, 2, 3, 4, 5, 6, 7]);
    mesh.push_cell(CellShape::Hexahedron, &[0, 2, 1, 3, 8, 9, 10, 11]);
    assert!(message(&mesh).contains("cycles"));
    let mut mesh = VolumeMesh::new(positions);
    mesh.positions[3].y = f64::NAN;
    mesh.push_cell(CellShape::Tetrahedron, &[0, 1, 2, 3]);
    assert!(message(&mesh).contains("vertex 3"));
    mesh.positions[3].y = 0.0;
    let volume = CurvedVolume::new(&mesh, Basis::Legendre).unwrap();
    for order in [0, 17] {
        assert!(volume.raised(&[order]).is_err());
    }
}

#[test]
fn rows_of_boundary_points_are_on_the_curved_boundary() {
    let mut random = Random::new(11);
    for shape in SHAPES {
        let mesh = relabelled(&mut random, &block(shape, 1));
        let orders = vec![4; mesh.cell_count()];
        let volume = randomized(&mut random, &mesh, Basis::Legendre, &orders);
        let (coarse, fine) = (volume.boundary_surface(2), volume.boundary_surface(4));
        let samples = fine.matrix.apply(&volume.coefficients);
        let corners = coarse.matrix.apply(&volume.coefficients);
        for (t, triangle) in coarse.triangles.iter().enumerate() {
            let at = |barycentric| BoundaryPoint {
                triangle: t as u32,
                barycentric,
            };
            let points = [
                at([0.0, 1.0, 0.0]),
                at([0.5, 0.5, 0.0]),
                at([0.0, 0.5, 0.5]),
            ];
            let rows = volume.boundary_rows(&coarse, &points);
            let found = rows.apply(&volume.coefficients);
            assert!(found[0].distance(corners[triangle[1] as usize]) < 1e-12);
            for middle in &found[1..] {
                // A middle of two samples in parameters is a sample at half the spacing.
                let distances = samples.iter().map(|s| s.distance(*middle));
                assert!(distances.fold(f64::INFINITY, f64::min) < 1e-12);
            }
        }
    }
}
