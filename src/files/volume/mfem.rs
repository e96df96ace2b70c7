//! MFEM's mesh format, version 1.0: cells by their vertices, and the curved geometry as a grid function `nodes` of some finite element
//! collection.
//!
//! Read whole: straight meshes, and nodes of the discontinuous collections with equispaced closed points (`L2_T4_3D_Pp`, and any other L2
//! collection with closed points up to order 2, where all of them agree), which are also what is written: their order within a cell is
//! the plain lattice, and they do not depend on MFEM's own numbering of edges and faces. Of the continuous collections
//! (`H1_3D_Pp`, Linear, Quadratic, Cubic), whose first values are the vertices, only the vertices are taken beyond order 1, with a warning.

use super::VolumeToWrite;
use super::draft::{Draft, Kind, MAX_ORDER, PYRAMIDS};
use super::scan::{Number, Scanner, points};
use crate::error::Defect;
use crate::files::quoted;
use crate::mesh::check_volume::boundary_faces;
use crate::mesh::{CellShape, NodalVolume};
use glam::DVec3;
use std::io::{self, Write};

pub(super) const MAGIC: &[u8] = b"MFEM ";

/// MFEM's geometries by number: the number of vertices and what they are here.
const GEOMETRIES: [(usize, Kind); 8] = [
    (1, Kind::Flat),
    (2, Kind::Flat),
    (3, Kind::Flat),
    (4, Kind::Flat),
    (4, Kind::Cell(CellShape::Tetrahedron, 1)),
    (8, Kind::Cell(CellShape::Hexahedron, 1)),
    (6, Kind::Cell(CellShape::Prism, 1)),
    (5, Kind::Unsupported(PYRAMIDS)),
];

/// How far the nodes of cells may be from a common vertex, relative to the largest coordinate: text has 6 digits at least.
const SAME_VERTEX: f64 = 1e-6;

pub(super) fn read(bytes: &[u8]) -> Result<Draft, Defect> {
    let mut scan = Scanner::with_comments(bytes);
    let header = String::from_utf8_lossy(scan.rest_of_line()).into_owned();
    if !header.starts_with("MFEM mesh v1.") {
        let problem = format!("{} is not MFEM mesh v1.0", quoted(&header));
        return Err(Defect::new(
            "line 1",
            problem,
            "save the mesh with Mesh::Save, conforming and not NURBS",
        ));
    }
    let mut file = File::default();
    while let Some(section) = scan.next()? {
        match section {
            "dimension" => check_dimension(&mut scan)?,
            "elements" => file.cells = read_elements(&mut scan)?,
            "boundary" => drop(read_elements(&mut scan)?),
            "vertices" => file.read_vertices(&mut scan)?,
            "nodes" => file.nodes = Some(Nodes::read(&mut scan)?),
            "mfem_mesh_end" => break,
            other => return Err(scan.defect(format!("{} is no section known here", quoted(other)))),
        }
    }
    file.draft()
}

fn check_dimension(scan: &mut Scanner<'_>) -> Result<(), Defect> {
    match scan.number("the dimension")? {
        3 => Ok(()),
        other => Err(scan.defect(format!("the mesh has {other} dimensions, not 3"))),
    }
}

/// An element of the list: what it is, its vertices, its line.
struct Element {
    kind: Kind,
    vertices: Vec<i64>,
    place: String,
}

fn read_elements(scan: &mut Scanner<'_>) -> Result<Vec<Element>, Defect> {
    let count: usize = scan.number("the number of elements")?;
    let mut elements = Vec::new();
    for _ in 0..count {
        scan.number::<i64>("an attribute")?;
        let geometry: usize = scan.number("a geometry")?;
        let &(vertices, kind) = GEOMETRIES
            .get(geometry)
            .ok_or_else(|| scan.defect(format!("{geometry} is no geometry")))?;
        elements.push(Element {
            kind,
            vertices: scan.integers(vertices, Number::I32)?,
            place: scan.place(),
        });
    }
    Ok(elements)
}

#[derive(Default)]
struct File {
    cells: Vec<Element>,
    vertex_count: usize,
    /// Empty where the nodes say where the vertices are.
    vertices: Vec<DVec3>,
    nodes: Option<Nodes>,
}

impl File {
    fn read_vertices(&mut self, scan: &mut Scanner<'_>) -> Result<(), Defect> {
        self.vertex_count = scan.number("the number of vertices")?;
        if scan
            .peek()
            .is_some_and(|word| word.parse::<usize>().is_ok())
        {
            if scan.number::<usize>("the dimension")? != 3 {
                return Err(scan.defect("the vertices do not have three coordinates"));
            }
            for _ in 0..self.vertex_count {
                self.vertices.extend(points(&scan.reals(3, Number::F64)?));
            }
        }
        Ok(())
    }

    fn draft(mut self) -> Result<Draft, Defect> {
        let mut draft =
            Draft::new(|shape, order| (0..NodalVolume::node_count(shape, order)).collect());
        match self.nodes.take() {
            None => {
                draft.positions = std::mem::take(&mut self.vertices);
                self.push_straight(&mut draft)?;
            }
            Some(nodes) => match nodes.collection {
                Collection::Continuous(order) => {
                    if order > 1 {
                        draft.warnings.push(format!(
                            "the curved geometry (order {order}) is left out, the cells are straight; save the mesh with nodes L2_T4_3D_P{order} to keep it"
                        ));
                    }
                    draft.positions = nodes.range(0, self.vertex_count)?;
                    self.push_straight(&mut draft)?;
                }
                Collection::Cellwise(order) => self.push_cellwise(&nodes, order, &mut draft)?,
            },
        }
        Ok(draft)
    }

    fn push_straight(&self, draft: &mut Draft) -> Result<(), Defect> {
        for Element {
            kind,
            vertices,
            place,
        } in &self.cells
        {
            let nodes = match kind {
                Kind::Cell(shape, _) => at_corners(*shape, 1, vertices, vec![0; vertices.len()]),
                _ => vertices.clone(),
            };
            draft.push(*kind, &nodes, || place.clone())?;
        }
        Ok(())
    }

    /// Cells with nodes of their own, whose corners are the common vertices.
    fn push_cellwise(&self, nodes: &Nodes, order: usize, draft: &mut Draft) -> Result<(), Defect> {
        let mut common = vec![None; self.vertex_count.min(nodes.len())];
        let mut start = 0;
        let mut own = Vec::new();
        for Element {
            kind,
            vertices,
            place,
        } in &self.cells
        {
            let Kind::Cell(shape, _) = *kind else {
                draft.push(*kind, vertices, || place.clone())?;
                continue;
            };
            let count = NodalVolume::node_count(shape, order);
            let points = nodes.range(start, count)?;
            start += count;
            let corners =
                NodalVolume::places(shape, order, &NodalVolume::corner_points(shape, order));
            for (&v, at) in vertices.iter().zip(corners) {
                let place = || place.clone();
                let slot = usize::try_from(v).ok().and_then(|v| common.get_mut(v));
                let slot: &mut Option<DVec3> = slot.ok_or_else(|| {
                    Defect::new(
                        place(),
                        format!("it names vertex {v} of {}", self.vertex_count),
                        "the file is damaged: save it again",
                    )
                })?;
                let vertex = *slot.get_or_insert(points[at]);
                if (vertex - points[at]).length()
                    > SAME_VERTEX * vertex.length().max(points[at].length())
                {
                    let problem = format!(
                        "vertex {v} is elsewhere in another cell: the mesh is periodic or torn"
                    );
                    return Err(Defect::new(
                        place(),
                        problem,
                        "save it with continuous nodes (Mesh::SetCurvature)",
                    ));
                }
            }
            own.push((shape, vertices, points, place));
        }
        draft.positions = common
            .into_iter()
            .map(|v| v.unwrap_or(DVec3::ZERO))
            .collect();
        for (shape, vertices, points, place) in own {
            let next = draft.positions.len() as i64;
            draft.positions.extend(&points);
            let nodes = (next..next + points.len() as i64).collect();
            let nodes = at_corners(shape, order, vertices, nodes);
            draft.push(Kind::Cell(shape, order), &nodes, || place.clone())?;
        }
        Ok(())
    }
}

/// The nodes of a cell with its vertices at the corners.
fn at_corners(shape: CellShape, order: usize, vertices: &[i64], mut nodes: Vec<i64>) -> Vec<i64> {
    let corners = NodalVolume::places(shape, order, &NodalVolume::corner_points(shape, order));
    for (at, &v) in corners.into_iter().zip(vertices) {
        nodes[at] = v;
    }
    nodes
}

/// What is known of a finite element collection.
enum Collection {
    /// Of an order, with the vertices first.
    Continuous(usize),
    /// Of an order, cell after cell on an even lattice.
    Cellwise(usize),
}

impl Collection {
    fn of(name: &str) -> Option<Self> {
        let order = || {
            name.rsplit_once("_P")?
                .1
                .parse()
                .ok()
                .filter(|order| (1..=MAX_ORDER).contains(order))
        };
        match name {
            "Linear" => Some(Self::Continuous(1)),
            "Quadratic" => Some(Self::Continuous(2)),
            "Cubic" => Some(Self::Continuous(3)),
            _ if name.starts_with("H1_3D_P") => Some(Self::Continuous(order()?)),
            _ if name.starts_with("L2_T4_3D_P") => Some(Self::Cellwise(order()?)),
            // Gauss–Lobatto points are even ones up to order 2.
            _ if name.starts_with("L2_T1_3D_P") => {
                Some(Self::Cellwise(order().filter(|&order| order <= 2)?))
            }
            _ => None,
        }
    }
}

/// A grid function of three components.
struct Nodes {
    collection: Collection,
    values: Vec<f64>,
    /// Whether the three components of a node stand together.
    by_node: bool,
}

impl Nodes {
    fn read(scan: &mut Scanner<'_>) -> Result<Self, Defect> {
        scan.keyword("FiniteElementSpace")?;
        scan.keyword("FiniteElementCollection:")?;
        let name = scan.word("a finite element collection")?;
        let collection = Collection::of(name).ok_or_else(|| {
            Defect::new(
                scan.place(),
                format!("nodes of the collection {} are not supported", quoted(name)),
                format!("save the mesh with nodes of H1_3D_P1 or L2_T4_3D_Pp, p up to {MAX_ORDER}"),
            )
        })?;
        scan.keyword("VDim:")?;
        if scan.number::<usize>("the number of components")? != 3 {
            return Err(scan.defect("the nodes do not have three components"));
        }
        scan.keyword("Ordering:")?;
        let by_node = scan.number::<usize>("the ordering")? == 1;
        let mut values = Vec::new();
        while scan.peek().is_some_and(|word| word.parse::<f64>().is_ok()) {
            values.push(scan.number("a number")?);
        }
        if values.len() % 3 != 0 {
            return Err(scan.defect(format!("{} numbers are no points", values.len())));
        }
        Ok(Self {
            collection,
            values,
            by_node,
        })
    }

    fn len(&self) -> usize {
        self.values.len() / 3
    }

    fn at(&self, node: usize) -> DVec3 {
        let number = |d| {
            if self.by_node {
                self.values[3 * node + d]
            } else {
                self.values[d * self.len() + node]
            }
        };
        DVec3::new(number(0), number(1), number(2))
    }

    fn range(&self, start: usize, count: usize) -> Result<Vec<DVec3>, Defect> {
        if count > self.len().saturating_sub(start) {
            let problem = format!("there are {} nodes, too few for the cells", self.len());
            return Err(Defect::new(
                "nodes",
                problem,
                "the file is truncated or damaged: save it again",
            ));
        }
        Ok((start..start + count).map(|node| self.at(node)).collect())
    }
}

pub(super) fn write(out: &mut dyn Write, volume: &VolumeToWrite<'_>) -> io::Result<()> {
    let nodes = volume.nodes;
    let mesh = nodes.corners();
    let cells = mesh.cell_count();
    writeln!(out, "MFEM mesh v1.0\n\ndimension\n3\n\nelements\n{cells}")?;
    for (shape, vertices) in mesh.cells() {
        let is_shape = |&(_, kind): &(usize, Kind)| kind == Kind::Cell(shape, 1);
        let geometry = GEOMETRIES.iter().position(is_shape).unwrap_or_default();
        write!(out, "1 {geometry}")?;
        vertices.iter().try_for_each(|v| write!(out, " {v}"))?;
        writeln!(out)?;
    }
    let boundary = boundary_faces(&mesh);
    writeln!(out, "\nboundary\n{}", boundary.len())?;
    for (cell, face) in boundary {
        let corners = mesh.shape(cell).faces()[face];
        // Triangles are geometry 2, squares geometry 3.
        write!(out, "1 {}", corners.len() - 1)?;
        corners
            .iter()
            .try_for_each(|&k| write!(out, " {}", mesh.cell(cell)[k]))?;
        writeln!(out)?;
    }
    writeln!(out, "\nvertices\n{}", mesh.positions.len())?;
    if nodes.order() == 1 {
        writeln!(out, "3")?;
        return write_points(out, mesh.positions.iter().copied());
    }
    let order = nodes.order();
    writeln!(
        out,
        "\nnodes\nFiniteElementSpace\nFiniteElementCollection: L2_T4_3D_P{order}\nVDim: 3\nOrdering: 1\n"
    )?;
    let cell_nodes = nodes.cells().flat_map(|(_, cell)| cell);
    write_points(out, cell_nodes.map(|&node| nodes.positions[node as usize]))
}

fn write_points(out: &mut dyn Write, mut points: impl Iterator<Item = DVec3>) -> io::Result<()> {
    points.try_for_each(|p| writeln!(out, "{} {} {}", p.x, p.y, p.z))
}
