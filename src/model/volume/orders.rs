//! The orders of edges, faces and cells: how they are raised cell by cell, or along the boundary only.

use super::entities::Face;
use super::{CurvedVolume, Group};
use crate::error::{Error, Result};
use crate::mesh::CellShape;
use crate::model::element::{MAX_ORDER, mode_count, modes};
use glam::DVec3;
use std::collections::BTreeMap;
use std::ops::Range;

/// The orders of the edges, the faces or the cells, and where their coefficients are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Modes {
    pub(super) orders: Vec<u8>,
    /// `[entities + 1]`.
    starts: Vec<u32>,
}

impl Modes {
    /// Entities of the given orders, with `count(entity, order)` coefficients each from `first` on.
    pub(super) fn new(orders: Vec<u8>, first: u32, count: impl Fn(usize, usize) -> usize) -> Self {
        let mut starts = vec![first];
        for (k, &order) in orders.iter().enumerate() {
            starts.push(starts[k] + count(k, usize::from(order)) as u32);
        }
        Self { orders, starts }
    }

    pub(super) fn range(&self, k: usize) -> Range<u32> {
        self.starts[k]..self.starts[k + 1]
    }

    fn end(&self) -> u32 {
        self.starts[self.starts.len() - 1]
    }

    pub(super) fn order(&self, k: usize) -> usize {
        usize::from(self.orders[k])
    }

    /// The modes of an entity that make it one of its order rather than one less; `count` says how many an order has.
    fn top(&self, k: usize, count: impl Fn(usize) -> usize) -> Range<u32> {
        let range = self.range(k);
        let below = self.order(k).max(2) - 1;
        range.start + count(below) as u32..range.end
    }
}

impl CurvedVolume {
    /// The same volume with `orders[c]` in cell c, if that is more than it has: edges and faces get the highest order around
    /// them, new coefficients are zero, and the shape does not change.
    ///
    /// # Errors
    /// Where an order is not in 1 to [`MAX_ORDER`], or there would be more coefficients than 32-bit indices serve.
    pub fn raised(&self, orders: &[usize]) -> Result<Self> {
        assert_eq!(orders.len(), self.cell_count(), "orders of the cells");
        check_orders(orders)?;
        let modes: usize = (0..orders.len())
            .map(|c| mode_count(self.shape(c), orders[c]))
            .sum();
        if modes > i32::MAX as usize {
            return Err(Error::input(
                format!("these orders make {modes} modes"),
                "use a lower order or fewer cells",
            ));
        }
        let mut edges = self.edges.orders.clone();
        let mut faces = self.faces.orders.clone();
        let mut interiors = self.interiors.orders.clone();
        for (c, &order) in orders.iter().enumerate() {
            let raise = |o: &mut u8| *o = (*o).max(order as u8);
            raise(&mut interiors[c]);
            let of = &self.entities;
            of.edges_of(c)
                .iter()
                .for_each(|&e| raise(&mut edges[e as usize]));
            of.faces_of(c)
                .iter()
                .for_each(|&f| raise(&mut faces[f as usize]));
        }
        Ok(self.with_orders(edges, faces, interiors))
    }

    /// The same volume with `boundary[f]` on face f of [`CurvedVolume::boundary`], the highest order around them on the edges of
    /// these faces, and `inside` in everything else. New coefficients are zero; those of modes that an entity has no longer are dropped.
    ///
    /// # Errors
    /// As [`CurvedVolume::raised`], where cells of the highest of these orders would be too many.
    pub fn graded(&self, boundary: &[usize], inside: usize) -> Result<Self> {
        let list = self.boundary();
        assert_eq!(boundary.len(), list.len(), "orders of the boundary");
        check_orders(boundary)?;
        check_orders(&[inside])?;
        let mut edges = vec![0; self.edges.orders.len()];
        let mut faces = vec![inside as u8; self.faces.orders.len()];
        for (f, &order) in boundary.iter().enumerate() {
            faces[self.boundary_face(list[f])] = order as u8;
            for e in self.boundary_edges(list[f]) {
                edges[e] = edges[e].max(order as u8);
            }
        }
        for order in &mut edges {
            if *order == 0 {
                *order = inside as u8;
            }
        }
        Ok(self.with_orders(edges, faces, vec![inside as u8; self.cell_count()]))
    }

    fn with_orders(&self, edges: Vec<u8>, faces: Vec<u8>, interiors: Vec<u8>) -> Self {
        let vertices = self.vertex_count();
        let edges = Modes::new(edges, vertices as u32, |_, p| modes::edge_count(p));
        let faces = Modes::new(faces, edges.end(), |f, p| self.face_count(f, p));
        let interiors = Modes::new(interiors, faces.end(), |c, p| {
            modes::interior_count(self.shape(c), p)
        });
        let mut coefficients = self.coefficients[..vertices].to_vec();
        coefficients.resize(interiors.end() as usize, DVec3::ZERO);
        for (old, new) in [
            (&self.edges, &edges),
            (&self.faces, &faces),
            (&self.interiors, &interiors),
        ] {
            // Lists of modes are hierarchical: those of the lower order come first.
            for k in 0..old.orders.len() {
                let (from, to) = (old.range(k), new.range(k));
                let kept = from.len().min(to.len());
                coefficients[to.start as usize..][..kept]
                    .copy_from_slice(&self.coefficients[from.start as usize..][..kept]);
            }
        }
        Self {
            basis: self.basis,
            coefficients,
            cells: self.cells.clone(),
            entities: self.entities.clone(),
            edges,
            faces,
            interiors,
        }
    }

    /// The order that was asked for in cell `c`; the kernel order may be higher.
    pub fn order(&self, c: usize) -> usize {
        self.interiors.order(c)
    }

    /// The highest order of the entities of cell `c`, at which its kernels compute.
    pub fn kernel_order(&self, c: usize) -> usize {
        let edges = self
            .entities
            .edges_of(c)
            .iter()
            .map(|&e| self.edges.order(e as usize));
        let faces = self
            .entities
            .faces_of(c)
            .iter()
            .map(|&f| self.faces.order(f as usize));
        edges.chain(faces).fold(self.order(c), usize::max)
    }

    /// The highest kernel order of any cell: nodes of this order hold a volume of the Legendre basis exactly.
    pub fn highest_order(&self) -> usize {
        let orders = (0..self.cell_count()).map(|c| self.kernel_order(c));
        orders.max().unwrap_or(1)
    }

    /// All cells, by shape and kernel order.
    pub fn groups(&self) -> Vec<Group> {
        let mut groups: BTreeMap<(CellShape, usize), Vec<u32>> = BTreeMap::new();
        for c in 0..self.cell_count() {
            let key = (self.shape(c), self.kernel_order(c));
            groups.entry(key).or_default().push(c as u32);
        }
        groups
            .into_iter()
            .map(|((shape, order), cells)| Group {
                shape,
                order,
                cells,
            })
            .collect()
    }

    /// How many coefficients there would be with all entities of one order.
    pub fn full_count(&self, order: usize) -> usize {
        let faces = (0..self.entities.faces.len()).map(|f| self.face_count(f, order));
        let cells = (0..self.cell_count()).map(|c| modes::interior_count(self.shape(c), order));
        let edges = self.entities.edges.len() * modes::edge_count(order);
        self.vertex_count() + edges + faces.chain(cells).sum::<usize>()
    }

    /// The orders of the faces of [`CurvedVolume::boundary`].
    pub fn boundary_orders(&self) -> Vec<usize> {
        let list = self.boundary();
        list.into_iter()
            .map(|face| self.faces.order(self.boundary_face(face)))
            .collect()
    }

    /// Pairs of faces of [`CurvedVolume::boundary`] with a common edge, each pair once, ascending.
    pub fn boundary_neighbours(&self) -> Vec<[u32; 2]> {
        let mut around: BTreeMap<usize, Vec<u32>> = BTreeMap::new();
        for (f, &face) in self.boundary().iter().enumerate() {
            for e in self.boundary_edges(face) {
                around.entry(e).or_default().push(f as u32);
            }
        }
        let mut pairs: Vec<[u32; 2]> = around
            .values()
            .flat_map(|faces| {
                (1..faces.len()).flat_map(move |k| (0..k).map(move |j| [faces[j], faces[k]]))
            })
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        pairs
    }

    /// For each face of [`CurvedVolume::boundary`] the coefficients inside it and its edges that make these entities what they are rather
    /// than of an order less.
    pub fn boundary_top_modes(&self) -> Vec<Vec<u32>> {
        self.boundary()
            .into_iter()
            .map(|face| {
                let f = self.boundary_face(face);
                let inside = self.faces.top(f, |p| self.face_count(f, p));
                let edges = self.boundary_edges(face);
                edges
                    .flat_map(|e| self.edges.top(e, modes::edge_count))
                    .chain(inside)
                    .collect()
            })
            .collect()
    }

    /// The modes inside face `f` if it has the order.
    fn face_count(&self, f: usize, order: usize) -> usize {
        match self.entities.faces[f] {
            Face::Triangle(_) => modes::triangle_count(order),
            Face::Quad(_) => modes::quad_count(order),
        }
    }

    /// The number of a face of [`CurvedVolume::boundary`] among all.
    fn boundary_face(&self, (c, k): (u32, u32)) -> usize {
        self.entities.faces_of(c as usize)[k as usize] as usize
    }

    /// The numbers of its edges.
    fn boundary_edges(&self, face: (u32, u32)) -> impl Iterator<Item = usize> + '_ {
        let cycle = self.entities.faces[self.boundary_face(face)];
        let count = cycle.vertices().len();
        (0..count).map(move |k| {
            let [a, b] = [k, (k + 1) % count].map(|k| cycle.vertices()[k]);
            self.entities.edge_between(a, b)
        })
    }
}

fn check_orders(orders: &[usize]) -> Result<()> {
    match orders.iter().find(|o| !(1..=MAX_ORDER).contains(*o)) {
        None => Ok(()),
        Some(order) => Err(Error::input(
            format!("an element of order {order} was asked for"),
            format!("use an order from 1 to {MAX_ORDER}"),
        )),
    }
}
