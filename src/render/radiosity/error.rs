//! Reasons why a scene has no radiosity solution.

/// Largest number of elements: with two sides of 256 rays each, their hits take 2 gigabytes.
pub const MAX_ELEMENTS: usize = 1 << 20;

/// Reason why a scene has no radiosity solution.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RadiosityError {
    /// Scene without a mesh or bounded shape of finite area.
    #[error("the scene has no mesh and no bounded shape, so there is no surface to bake: add one")]
    NoSurface,
    /// Scene that needs more elements than the limit.
    #[error(
        "the bake takes more than {MAX_ELEMENTS} triangles: give fewer `--elements`, or a scene with fewer triangles"
    )]
    TooManyElements,
    /// Rays whose hits exceed the limit of memory.
    #[error(
        "{rays} rays from both sides of {elements} triangles take more than 2 gigabytes of memory: give fewer \
         `--elements` or `--rays`"
    )]
    TooManyRays {
        /// Number of elements with rays.
        elements: usize,
        /// Number of rays of each side.
        rays: usize,
    },
    /// Moving instance without a transform at the start of its motion.
    #[error("the object `{0}` has no extent where its motion begins: change its motion")]
    Singular(String),
}
