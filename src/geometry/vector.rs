//! Loops compiled for what the machine has: AVX2 with fused multiply-add where it is there, the plain target elsewhere.
//!
//! Code that is to be vectorized is written as plain loops over arrays and put behind [`Work`]; [`fastest`] runs it in the best of its
//! versions. Fused multiplication rounds once instead of twice, so results differ in the last bits from one kind of machine to the other;
//! on one machine they are always the same.

/// How a product is added.
pub trait Arithmetic: Copy {
    /// a b + c.
    fn mul_add(a: f64, b: f64, c: f64) -> f64;
}

/// Rounds once. Fast only where the instruction exists.
#[derive(Debug, Clone, Copy)]
pub struct Fused;

/// Rounds the product and the sum.
#[derive(Debug, Clone, Copy)]
pub struct Separate;

impl Arithmetic for Fused {
    #[inline(always)]
    fn mul_add(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }
}

impl Arithmetic for Separate {
    #[inline(always)]
    fn mul_add(a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }
}

/// Something to compute that exists in several versions. `run` and all that it calls must be `#[inline(always)]`: what is not inlined is
/// compiled once, for the plain target.
pub trait Work {
    /// Computes.
    fn run<A: Arithmetic>(self);
}

/// Computes in the fastest version for this machine.
#[inline]
pub fn fastest<W: Work>(work: W) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        fn fused<W: Work>(work: W) {
            work.run::<Fused>();
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: the machine has both features.
            return unsafe { fused(work) };
        }
    }
    work.run::<Separate>();
}

/// The bits of √½: a mantissa is taken from [√½, √2).
const SQRT_HALF_BITS: u64 = 0x3fe6_a09e_667f_3bcd;
const MANTISSA: u32 = 52;
/// An integer k below 2⁵² in the low bits of this is the number 2⁵² + k.
const INTEGER: u64 = 0x4330_0000_0000_0000;
/// Added to exponents so that none is negative.
const BIAS: u64 = 2048;
const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1;
const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;

/// The natural logarithm of a positive normal number, without branches or calls so that loops of it vectorize. Relative error under
/// 4e-16 away from 1, absolute error under 1e-16 near it.
///
/// x = 2^e m with m in [√½, √2); ln m = 2 artanh f = 2 (f + f³/3 + …), f = (m − 1)/(m + 1), |f| < 0.172.
#[inline(always)]
pub fn ln<A: Arithmetic>(x: f64) -> f64 {
    let shifted = x
        .to_bits()
        .wrapping_sub(SQRT_HALF_BITS)
        .wrapping_add(BIAS << MANTISSA);
    let exponent = shifted >> MANTISSA;
    let mantissa = x
        .to_bits()
        .wrapping_sub((exponent.wrapping_sub(BIAS)) << MANTISSA);
    let m = f64::from_bits(mantissa);
    let e = f64::from_bits(INTEGER | exponent) - (f64::from_bits(INTEGER) + BIAS as f64);
    let f = (m - 1.0) / (m + 1.0);
    let s = f * f;
    let mut series = 1.0 / 23.0;
    for k in (1..11).rev() {
        series = A::mul_add(series, s, 1.0 / f64::from(2 * k + 1));
    }
    let tail = A::mul_add(f * s, 2.0 * series, e * LN_2_LOW);
    A::mul_add(e, LN_2_HIGH, 2.0 * f + tail)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithms_are_those_of_the_library() {
        assert_eq!(ln::<Separate>(1.0), 0.0);
        for k in -4000..4000 {
            for x in [
                (f64::from(k) * 0.17).exp(),
                1.0 + f64::from(k) * 1e-5,
                1.0 + f64::from(k) * 1e-12,
            ] {
                if x.is_normal() {
                    let error = (ln::<Separate>(x) - x.ln()).abs();
                    assert!(error <= 4e-16 * x.ln().abs() + 1e-16, "{x}: {error}");
                }
            }
        }
    }
}
