//! Cost model of testing rays against clusters.

/// Cost model of testing a ray against clusters.
#[derive(Clone, Copy, Debug)]
pub(in crate::accel) struct Cost {
    /// Maximum number of members of a cluster; not 0.
    pub(in crate::accel) limit: u32,
    /// Cost of reaching a cluster.
    pub(in crate::accel) visit: f32,
    /// Cost of testing each member.
    pub(in crate::accel) member: f32,
    /// Cost of one further split in the tree.
    pub(in crate::accel) split: f32,
    /// Maximum number of clusters of a set that are counted as whole ones; not 0. Those of a larger set are in proportion
    /// to its members: clusters are less full then, and smaller.
    pub(in crate::accel) whole_limit: u32,
}

impl Cost {
    /// Returns the cost of testing `count` members, at least one, relative to the probability of reaching them.
    pub(super) fn of(&self, count: usize) -> f32 {
        let clusters = count as f32 / self.limit as f32;
        let clusters = if clusters <= self.whole_limit as f32 {
            clusters.ceil()
        } else {
            clusters
        };
        clusters * self.visit + count as f32 * self.member
    }
}
