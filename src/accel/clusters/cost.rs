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
}

impl Cost {
    /// Returns the cost of testing `count` members, at least one, relative to the probability of reaching them.
    ///
    /// A set that exceeds a cluster is taken to fill clusters to the same degree at any size: whole numbers of clusters
    /// would favour splits that fill some and leave others nearly empty.
    pub(super) fn of(&self, count: usize) -> f32 {
        let count = count as f32;
        (count / self.limit as f32).max(1.0) * self.visit + count * self.member
    }
}
