//! Analytic shapes: each by its implicit form in object space, in f64, one file a shape.
//!
//! A shape knows nothing of instances, materials or acceleration structures. It is asked with the exact f64 extension
//! of an f32 ray and answers with the parameter in f64.

mod sphere;

pub use sphere::Sphere;
