//! Radiosity: the diffuse light of a scene, solved for all surfaces at once and independently of a camera.
//!
//! Surfaces are covered with small triangles, the *elements* ([`ElementScene`]). Each side of an element sends numbered
//! rays, and the light on what they hit is gathered until nothing changes (Goral et al.,
//! "Modeling the Interaction of Light Between Diffuse Surfaces", SIGGRAPH 1984). The result is baked into colours of
//! vertices ([`Bake`]).
//!
//! Surfaces have two sides, as in interreflection. Elements are flat and opaque, and reflect by the diffuse part of their
//! materials, seen along the normal. Lights and shadows are those of images. The same scene gives the same bits on any
//! number of threads.

mod bake;
mod elements;
mod error;
mod gather;
mod result;
mod settings;
mod solve;
mod tessellation;
mod transport;

pub use bake::{Bake, BakedMesh};
pub use elements::{ElementScene, SurfaceElement};
pub use error::{MAX_ELEMENTS, RadiosityError};
pub use result::{EnergyBalance, RadiosityReport, RadiositySolution, SideLight};
pub use settings::RadiositySettings;
pub use solve::solve;
pub use transport::MAX_SWEEPS;
