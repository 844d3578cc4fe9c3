//! Random numbers for numerical tests: reproducible on every machine and for every number of threads.

use std::f64::consts::TAU;

use glam::DVec3;

/// SplitMix64 generator, whose whole state is its seed (Steele, Lea and Flood, "Fast splittable pseudorandom number
/// generators", OOPSLA 2014).
#[derive(Clone, Debug)]
pub struct SplitMix64(u64);

impl SplitMix64 {
    /// Creates generator number `index` of a family; any two of them are statistically independent.
    pub fn new(family: u64, index: u64) -> SplitMix64 {
        let mut random = SplitMix64(family);
        let salt = random.bits();
        SplitMix64(salt ^ SplitMix64(index).bits())
    }

    /// Returns 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a uniform number in [0, 1) with the 53 bits that f64 holds.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * 0.5f64.powi(53)
    }

    /// Returns a uniform number in [`low`, `high`).
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Returns a uniform integer among 0, ..., `count` - 1; `count` must not be 0.
    pub fn below(&mut self, count: usize) -> usize {
        // A multiplication instead of a remainder makes small counts uniform to 2^-64.
        ((u128::from(self.bits()) * count as u128) >> 64) as usize
    }

    /// Returns one of several values, each equally likely; there must be at least one.
    pub fn choose<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len())]
    }

    /// Returns a uniform point in the cube [-1, 1)³.
    pub fn in_cube(&mut self) -> DVec3 {
        DVec3::new(
            self.within(-1.0, 1.0),
            self.within(-1.0, 1.0),
            self.within(-1.0, 1.0),
        )
    }

    /// Returns a unit vector, uniform over the sphere.
    pub fn direction(&mut self) -> DVec3 {
        // Archimedes: z is uniform over the sphere
        let z = self.within(-1.0, 1.0);
        let (sin, cos) = (TAU * self.unit()).sin_cos();
        let r = ((1.0 - z) * (1.0 + z)).sqrt();
        DVec3::new(r * cos, r * sin, z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_match_the_published_generator() {
        // These are the first outputs of SplitMix64 for the seed 0.
        let mut random = SplitMix64(0);
        assert_eq!(random.bits(), 0xe220_a839_7b1d_cdaf);
        assert_eq!(random.bits(), 0x6e78_9e6a_a1b9_65f4);
    }

    #[test]
    fn values_below_a_bound_are_uniform() {
        let mut random = SplitMix64::new(1, 2);
        let mut counts = [0; 7];
        (0..7000).for_each(|_| counts[random.below(7)] += 1);
        // The bound is six standard deviations of a share of 1/7 among 7000: 6 √(1000 · 6/7) = 176.
        assert!(
            counts.iter().all(|&count: &i32| (count - 1000).abs() < 176),
            "{counts:?}"
        );
    }

    #[test]
    fn directions_are_unit_vectors_and_neighbouring_generators_differ() {
        let mut a = SplitMix64::new(5, 0);
        let mut b = SplitMix64::new(5, 1);
        for _ in 0..1000 {
            // The error is that of the squares of three rounded coordinates.
            assert!((a.direction().length_squared() - 1.0).abs() <= 8.0 * f64::EPSILON);
        }
        assert_ne!(a.bits(), b.bits());
    }
}
