//! Numbers that carry their derivatives along (forward differentiation), real and complex.

use std::ops::{Add, Mul, Neg, Sub};

/// A value and its derivatives by N coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dual<const N: usize> {
    pub value: f64,
    pub gradient: [f64; N],
}

impl<const N: usize> Dual<N> {
    pub const ZERO: Self = Self::constant(0.0);
    pub const ONE: Self = Self::constant(1.0);

    pub const fn constant(value: f64) -> Self {
        Self {
            value,
            gradient: [0.0; N],
        }
    }

    /// Coordinate `k` itself.
    pub fn coordinate(k: usize, value: f64) -> Self {
        let mut x = Self::constant(value);
        x.gradient[k] = 1.0;
        x
    }

    /// f of this number, from the value and the derivative of f there.
    pub fn chain(self, value: f64, derivative: f64) -> Self {
        Self {
            value,
            gradient: self.gradient.map(|g| derivative * g),
        }
    }

    fn product(self, other: Self) -> Self {
        let slope = |k| self.value * other.gradient[k] + self.gradient[k] * other.value;
        Self {
            value: self.value * other.value,
            gradient: std::array::from_fn(slope),
        }
    }

    pub fn sin(self) -> Self {
        let (sin, cos) = self.value.sin_cos();
        self.chain(sin, cos)
    }

    pub fn cos(self) -> Self {
        let (sin, cos) = self.value.sin_cos();
        self.chain(cos, -sin)
    }
}

impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            gradient: std::array::from_fn(|k| self.gradient[k] + other.gradient[k]),
        }
    }
}

impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    fn neg(self) -> Self {
        self * -1.0
    }
}

impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        self.product(other)
    }
}

impl<const N: usize> Mul<f64> for Dual<N> {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        self.chain(self.value * factor, factor)
    }
}

/// A complex number over [`Dual`] parts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Complex<const N: usize> {
    pub re: Dual<N>,
    pub im: Dual<N>,
}

impl<const N: usize> Complex<N> {
    pub const ZERO: Self = Self::real(Dual::ZERO);
    pub const ONE: Self = Self::real(Dual::ONE);

    pub const fn real(re: Dual<N>) -> Self {
        Self { re, im: Dual::ZERO }
    }

    /// exp(iθ).
    pub fn unit(angle: Dual<N>) -> Self {
        Self {
            re: angle.cos(),
            im: angle.sin(),
        }
    }

    pub fn conjugate(self) -> Self {
        Self {
            re: self.re,
            im: -self.im,
        }
    }
}

impl<const N: usize> Add for Complex<N> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            re: self.re + other.re,
            im: self.im + other.im,
        }
    }
}

impl<const N: usize> Sub for Complex<N> {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self {
            re: self.re - other.re,
            im: self.im - other.im,
        }
    }
}

impl<const N: usize> Mul for Complex<N> {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self {
            re: self.re * other.re - self.im * other.im,
            im: self.re * other.im + self.im * other.re,
        }
    }
}
