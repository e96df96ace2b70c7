use super::{Pyramids, Volume};
use crate::error::Defect;
use crate::mesh::weld::equal_positions;
use crate::mesh::{CellShape, NodalVolume, VolumeMesh, check_volume};
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;

/// What a format's element is here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// A cell of a shape and polynomial order.
    Cell(CellShape, usize),
    /// An element of lower dimension, which a volume mesh is complete without.
    Flat,
    /// An element with a volume that cannot be used.
    Unsupported(&'static str),
}

/// What cells with a quad and four triangles are called in messages.
pub(super) const PYRAMIDS: &str = "pyramids";

/// The highest order that is read: what this program writes at most.
pub(super) const MAX_ORDER: usize = 16;

/// The order of a cell with so many nodes.
pub(super) fn order_of(shape: CellShape, nodes: usize) -> Option<usize> {
    (1..=MAX_ORDER).find(|&order| NodalVolume::node_count(shape, order) == nodes)
}

/// A volume while its file is read.
pub(super) struct Draft {
    /// The nodes, `[nodes]`, in the file's order.
    pub(super) positions: Vec<DVec3>,
    /// What a user should know.
    pub(super) warnings: Vec<String>,
    /// For each node of a cell in the format's order, its place among the nodes of a [`NodalVolume`].
    numbering: fn(CellShape, usize) -> Vec<usize>,
    /// The numbering of the shapes that have occurred.
    places: [Vec<usize>; 3],
    order: Option<usize>,
    shapes: Vec<CellShape>,
    nodes: Vec<u32>,
    flat: usize,
    /// How many there are of what cannot be used, and the first one's place.
    unsupported: BTreeMap<&'static str, (usize, String)>,
}

impl Draft {
    pub(super) fn new(numbering: fn(CellShape, usize) -> Vec<usize>) -> Self {
        Self {
            positions: Vec::new(),
            warnings: Vec::new(),
            numbering,
            places: [const { Vec::new() }; 3],
            order: None,
            shapes: Vec::new(),
            nodes: Vec::new(),
            flat: 0,
            unsupported: BTreeMap::new(),
        }
    }

    /// Appends an element; `nodes` are counted from 0, in the format's order.
    pub(super) fn push(
        &mut self,
        kind: Kind,
        nodes: &[i64],
        place: impl Fn() -> String,
    ) -> Result<(), Defect> {
        let refuse = |problem: String, remedy: &str| Err(Defect::new(place(), problem, remedy));
        let (shape, order) = match kind {
            Kind::Cell(shape, order) => (shape, order),
            Kind::Flat => {
                self.flat += 1;
                return Ok(());
            }
            Kind::Unsupported(name) => {
                self.unsupported
                    .entry(name)
                    .or_insert_with(|| (0, place()))
                    .0 += 1;
                return Ok(());
            }
        };
        let wanted = NodalVolume::node_count(shape, order);
        if nodes.len() != wanted {
            let problem = format!(
                "a {} of order {order} has {wanted} nodes, not {}",
                shape.name(),
                nodes.len()
            );
            return refuse(problem, "correct the element or export the file again");
        }
        if *self.order.get_or_insert(order) != order {
            let problem = format!(
                "a cell of order {order} stands in a mesh of order {}",
                self.order.unwrap_or(order)
            );
            return refuse(problem, "export all cells with one order");
        }
        if self.nodes.len() + wanted > u32::MAX as usize {
            return refuse(
                "there are more than 4,294,967,295 nodes of cells".into(),
                "split the mesh",
            );
        }
        let places = &mut self.places[shape as usize];
        if places.is_empty() {
            *places = (self.numbering)(shape, order);
        }
        let start = self.nodes.len();
        self.nodes.resize(start + wanted, 0);
        for (&node, &at) in nodes.iter().zip(&*places) {
            let Ok(node) = u32::try_from(node) else {
                let problem = format!("it names vertex {node} (counted from 0)");
                return refuse(problem, "the file is damaged: export it again");
            };
            self.nodes[start + at] = node;
        }
        self.shapes.push(shape);
        Ok(())
    }

    /// The checked volume.
    pub(super) fn finish(mut self, pyramids: Pyramids) -> Result<Volume, Defect> {
        if pyramids == Pyramids::LeftOut
            && let Some((count, _)) = self.unsupported.remove(PYRAMIDS)
        {
            let note = format!("{count} pyramids, left out: where they were is a hole");
            self.warnings.push(note);
        }
        self.check_usable()?;
        if self.flat > 0 {
            let note = format!("{} points, lines and surface elements, left out", self.flat);
            self.warnings.push(note);
        }
        let order = self.order.unwrap_or(1);
        let mut volume = NodalVolume::new(order, self.positions);
        let mut counts = [0; 3];
        let mut rest = self.nodes.as_slice();
        for &shape in &self.shapes {
            let (nodes, others) = rest.split_at(NodalVolume::node_count(shape, order));
            let number = &mut counts[shape as usize];
            check_nodes(nodes, &volume.positions).map_err(|problem| {
                let place = format!("{} {number} (counted from 0)", shape.name());
                Defect::new(
                    place,
                    problem,
                    "correct or remove the cell, or export the file again",
                )
            })?;
            *number += 1;
            volume.push_cell(shape, nodes);
            rest = others;
        }
        let volume = turn_mirrored(volume, &mut self.warnings);
        let mesh = volume.corners();
        if order == 1 && mesh.positions.len() < volume.positions.len() {
            let unused = volume.positions.len() - mesh.positions.len();
            self.warnings
                .push(format!("{unused} vertices that no cell uses, left out"));
        }
        let mesh = merge_equal(mesh, &mut self.warnings);
        self.warnings.extend(check_volume::sound(&mesh)?.warnings());
        Ok(Volume {
            nodes: (order > 1).then(|| share_nodes(&mesh, &volume)),
            mesh,
            warnings: self.warnings,
        })
    }

    fn check_usable(&self) -> Result<(), Defect> {
        if let Some((name, (count, place))) = self.unsupported.first_key_value() {
            let remedy = "mesh again with tetrahedra, prisms and hexahedra only";
            return Err(Defect::new(
                place.clone(),
                format!("here is the first of {count} {name}, which are not supported"),
                match *name {
                    PYRAMIDS => format!("{remedy}, or leave them out (--drop-pyramids)"),
                    _ => remedy.into(),
                },
            ));
        }
        if self.shapes.is_empty() {
            let problem = match self.flat {
                0 => "there are no cells".into(),
                flat => {
                    format!("there are {flat} points, lines and surface elements, but no cells")
                }
            };
            return Err(Defect::new(
                "cells",
                problem,
                "give a volume mesh of tetrahedra, prisms or hexahedra",
            ));
        }
        Ok(())
    }
}

/// What is wrong with the nodes of a cell.
fn check_nodes(nodes: &[u32], positions: &[DVec3]) -> Result<(), String> {
    for &node in nodes {
        let count = positions.len();
        let position = positions.get(node as usize);
        let position = position
            .ok_or_else(|| format!("it names vertex {node} (counted from 0) of {count}"))?;
        if !position.is_finite() {
            return Err(format!(
                "the coordinates of its vertex {node} (counted from 0) are not finite"
            ));
        }
    }
    Ok(())
}

/// Numbers the cells of a shape the other way round where none of them is positive: such a file follows another convention (VTK's own
/// description of prisms, for one). Where some are positive, the negative ones are inverted cells and stay.
fn turn_mirrored(volume: NodalVolume, warnings: &mut Vec<String>) -> NodalVolume {
    let mut signs = [[0usize; 2]; 3];
    for (shape, nodes) in volume.cells() {
        let determinant = mean_determinant(shape, nodes, &volume);
        if determinant != 0.0 {
            signs[shape as usize][usize::from(determinant > 0.0)] += 1;
        }
    }
    let mirrored = signs.map(|[negative, positive]| negative > 0 && positive == 0);
    if mirrored == [false; 3] {
        return volume;
    }
    let mut turned = NodalVolume::new(volume.order(), volume.positions.clone());
    let mut counts = BTreeMap::new();
    for (shape, nodes) in volume.cells() {
        if !mirrored[shape as usize] {
            turned.push_cell(shape, nodes);
            continue;
        }
        *counts.entry(shape).or_insert(0usize) += 1;
        let mut lattice = NodalVolume::lattice(shape, volume.order());
        lattice.iter_mut().for_each(|p| p.swap(0, 1));
        let places = NodalVolume::places(shape, volume.order(), &lattice);
        let nodes: Vec<u32> = places.into_iter().map(|at| nodes[at]).collect();
        turned.push_cell(shape, &nodes);
    }
    for (shape, count) in counts {
        warnings.push(format!(
            "all cells of shape {} ({count}) are numbered the other way round, and were turned",
            shape.name()
        ));
    }
    turned
}

/// The determinant of the mean derivatives of the cell with straight edges, whose sign tells on which side the numbering runs.
fn mean_determinant(shape: CellShape, nodes: &[u32], volume: &NodalVolume) -> f64 {
    let order = volume.order();
    let points = NodalVolume::corner_points(shape, order);
    let places = NodalVolume::places(shape, order, &points);
    let corners: Vec<DVec3> = places
        .iter()
        .map(|&at| volume.positions[nodes[at] as usize])
        .collect();
    let mut derivative = [DVec3::ZERO; 3];
    for &[a, b] in shape.edges() {
        let steps = [0, 1, 2].map(|d| points[b][d] as f64 - points[a][d] as f64);
        // Along an edge that runs in two directions at once nothing is learnt.
        if steps.iter().filter(|&&s| s != 0.0).count() == 1 {
            for d in 0..3 {
                derivative[d] += (corners[b] - corners[a]) * steps[d];
            }
        }
    }
    DMat3::from_cols_array_2d(&derivative.map(|d| d.to_array())).determinant()
}

/// The same cells with common nodes where neighbours meet, which files of discontinuous nodes do not have.
fn share_nodes(mesh: &VolumeMesh, volume: &NodalVolume) -> NodalVolume {
    let nodes = volume.cells().flat_map(|(_, nodes)| nodes);
    let points: Vec<DVec3> = nodes.map(|&n| volume.positions[n as usize]).collect();
    NodalVolume::from_cells(mesh, volume.order(), &points)
}

/// Merges corners at identical positions, which would keep neighbours apart.
fn merge_equal(mesh: VolumeMesh, warnings: &mut Vec<String>) -> VolumeMesh {
    let first = equal_positions(&mesh.positions);
    let doubles = first
        .iter()
        .enumerate()
        .filter(|&(v, &f)| f as usize != v)
        .count();
    if doubles == 0 {
        return mesh;
    }
    warnings.push(format!(
        "{doubles} vertices at the position of another, merged"
    ));
    let mut number = Vec::with_capacity(first.len());
    let mut merged = VolumeMesh::default();
    for (v, &f) in first.iter().enumerate() {
        if f as usize == v {
            number.push(merged.positions.len() as u32);
            merged.positions.push(mesh.positions[v]);
        } else {
            number.push(number[f as usize]);
        }
    }
    for (shape, vertices) in mesh.cells() {
        let vertices: Vec<u32> = vertices.iter().map(|&v| number[v as usize]).collect();
        merged.push_cell(shape, &vertices);
    }
    merged
}
