//! Cost model of testing rays against clusters.

/// Cost model of testing a ray against clusters.
#[derive(Clone, Copy, Debug)]
pub(in crate::accel) struct Cost {
    /// Maximum number of members of a cluster; not 0.
    pub(in crate::accel) limit: u32,
    /// Cost of reaching a cluster.
    pub(in crate::accel) visit: f64,
    /// Cost of testing each member.
    pub(in crate::accel) member: f64,
    /// Cost of one further split in the tree.
    pub(in crate::accel) split: f64,
}

impl Cost {
    /// Returns the cost of testing `count` members, at least one, relative to the probability of reaching them.
    #[inline(always)]
    pub(super) fn of(&self, count: u32) -> f64 {
        // With half of one less no quotient is near a whole number; division of integers takes longer.
        let full = ((f64::from(count) - 0.5) / f64::from(self.limit)) as u32;
        f64::from(full + 1) * self.visit + f64::from(count) * self.member
    }
}
