//! The parameter domains of faces: their corners, edges and quarters.

use crate::model::refinement::Split;
use glam::{DMat2, DVec2};

/// An affine map of parameters.
#[derive(Debug, Clone, Copy)]
pub struct Affine {
    pub linear: DMat2,
    pub offset: DVec2,
}

impl Affine {
    fn new(columns: [[f64; 2]; 2], offset: [f64; 2]) -> Self {
        Self {
            linear: DMat2::from_cols_array_2d(&columns),
            offset: DVec2::from_array(offset),
        }
    }

    pub fn apply(&self, at: DVec2) -> DVec2 {
        self.linear * at + self.offset
    }
}

/// The number of corners of a face.
pub fn corner_count(split: Split) -> usize {
    match split {
        Split::Triangles => 3,
        Split::Quads => 4,
    }
}

/// The map to the frame of corner `k`: it becomes corner 0, the edge that leaves it the first axis. Its inverse is that of
/// corner `corner_count − k`.
pub fn to_corner(split: Split, k: usize) -> Affine {
    match (split, k) {
        (Split::Triangles, 1) => Affine::new([[0.0, -1.0], [1.0, -1.0]], [0.0, 1.0]),
        (Split::Triangles, 2) => Affine::new([[-1.0, 1.0], [-1.0, 0.0]], [1.0, 0.0]),
        (Split::Quads, 1) => Affine::new([[0.0, -1.0], [1.0, 0.0]], [0.0, 1.0]),
        (Split::Quads, 2) => Affine::new([[-1.0, 0.0], [0.0, -1.0]], [1.0, 1.0]),
        (Split::Quads, 3) => Affine::new([[0.0, 1.0], [-1.0, 0.0]], [1.0, 0.0]),
        _ => Affine::new([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0]),
    }
}

/// The inverse of [`to_corner`].
pub fn from_corner(split: Split, k: usize) -> Affine {
    to_corner(split, (corner_count(split) - k) % corner_count(split))
}

/// Of the four faces that a refinement cuts a face into, the one at a parameter, and the map to its own parameters. The face at
/// corner k is number k and has the corner as its corner 0; the triangle in the middle is number 3.
pub fn quarter(split: Split, at: DVec2) -> (usize, Affine) {
    let k = match split {
        Split::Triangles if at.x >= 0.5 => 1,
        Split::Triangles if at.y >= 0.5 => 2,
        Split::Triangles if at.x + at.y >= 0.5 => {
            return (3, Affine::new([[2.0, -2.0], [2.0, 0.0]], [-1.0, 1.0]));
        }
        Split::Triangles => 0,
        Split::Quads => match (at.x >= 0.5, at.y >= 0.5) {
            (false, false) => 0,
            (true, false) => 1,
            (true, true) => 2,
            (false, true) => 3,
        },
    };
    let Affine { linear, offset } = to_corner(split, k);
    let doubled = Affine {
        linear: 2.0 * linear,
        offset: 2.0 * offset,
    };
    (k, doubled)
}

/// How often a parameter is doubled until it leaves the quarter at corner 0; `None` at the corner itself.
pub fn depth(split: Split, at: DVec2) -> Option<u32> {
    let distance = match split {
        Split::Triangles => at.x + at.y,
        Split::Quads => at.x.max(at.y),
    };
    // Below, the sum may not be exact and 2^depth overflow.
    if distance < 1e-300 {
        return None;
    }
    let exponent = (distance.to_bits() >> 52) as i32 - 1023;
    Some((-1 - exponent).max(0) as u32)
}

/// The domain's point at a parameter that rounding may have taken just outside.
pub fn clamp(split: Split, at: DVec2) -> DVec2 {
    let at = at.clamp(DVec2::ZERO, DVec2::ONE);
    match split {
        Split::Triangles if at.x + at.y > 1.0 => {
            let x = at.x / (at.x + at.y);
            DVec2::new(x, 1.0 - x)
        }
        _ => at,
    }
}

/// The middle of the domain.
pub fn center(split: Split) -> DVec2 {
    match split {
        Split::Triangles => DVec2::splat(1.0 / 3.0),
        Split::Quads => DVec2::splat(0.5),
    }
}

/// The map from the parameters of quarter `k` back to the face's: a linear part and an offset.
pub fn quarter_to_face(split: Split, k: usize) -> (DMat2, DVec2) {
    if split == Split::Triangles && k == 3 {
        let linear = DMat2::from_cols_array(&[0.0, 0.5, -0.5, 0.5]);
        return (linear, DVec2::new(0.5, 0.0));
    }
    let Affine { linear, offset } = from_corner(split, k);
    (0.5 * linear, offset)
}
