//! Image as it is requested before its scene is opened, and the preparation of the scene for it: loading, the
//! acceleration structure, and the metadata of the file.

mod aov;
mod camera;
mod environment;
mod error;
mod metadata;
mod prepare;
mod render_request;
mod resolved;
mod scene_change;
mod settings;
mod tracing;

pub(super) use aov::{ALPHA, sample_layers};
pub use aov::{AovGroup, channels};
pub use camera::choose_camera;
pub use environment::{EnvironmentRequest, EnvironmentSource};
pub use error::RequestError;
pub use metadata::Notes;
pub(super) use prepare::check;
pub use prepare::{ProjectedAccel, is_scene_file, load, load_scene};
pub use render_request::{ImageEncoding, RenderRequest};
pub use resolved::{ResolvedSettings, check_memory, render_settings};
pub use scene_change::SceneChange;
pub use settings::Settings;
pub use tracing::{HitPath, TracingOptions};
