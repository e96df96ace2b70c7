//! Repeatable random numbers: the same seed gives the same sequence on every machine.

/// The SplitMix64 generator (Steele, Lea and Flood 2014): 64 bits of state, good enough for samples and noise, of no use for secrets.
#[derive(Debug, Clone)]
pub struct Random {
    state: u64,
}

impl Random {
    /// The sequence of a seed.
    pub fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// Sixty-four random bits.
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform below `n`, which must not be 0. The bias of n / 2⁶⁴ is of no account here.
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.bits()) * n as u128) >> 64) as usize
    }

    /// Normal with mean 0 and variance 1 (Box–Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sequence_is_that_of_splitmix64() {
        let mut random = Random::new(1234567);
        let published = [
            6457827717110365317,
            3203168211198807973,
            9817491932198370423,
        ];
        assert_eq!(published.map(|_| random.bits()), published);
    }

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut random = Random::new(0);
        let n = 100_000;
        let mean = |f: &mut dyn FnMut() -> f64| (0..n).map(|_| f()).sum::<f64>() / f64::from(n);
        let tolerance = 0.01; // Three standard errors of the widest of these means.
        assert!((mean(&mut || random.uniform()) - 0.5).abs() < tolerance);
        assert!(mean(&mut || random.normal()).abs() < tolerance);
        assert!((mean(&mut || random.normal().powi(2)) - 1.0).abs() < 2.0 * tolerance);
        assert!((mean(&mut || random.below(5) as f64) - 2.0).abs() < 2.0 * tolerance);
    }
}
