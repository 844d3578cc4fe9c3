//! The checks behind which nothing can meet a bad index, a NaN or a singular matrix.

/// What is wrong with a scene, worded as advice.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{item}: {fault}")]
pub struct SceneError {
    /// Which geometry, instance, material ... by name and number.
    pub item: String,
    /// What is wrong and what to do.
    pub fault: String,
}
