//! Image as it is requested before its scene is opened, and the preparation of the scene for it: loading, the
//! acceleration structure, and the metadata of the file.

mod aov;
mod camera;
mod error;
mod load;
mod metadata;
mod prepare;
mod render_request;
mod resolved;
mod scene_change;
mod settings;
mod tracing;

pub use aov::{AovGroup, channels};
pub use camera::choose_camera;
pub use error::RequestError;
pub use load::{is_scene_file, load_scene};
pub use metadata::Notes;
pub use prepare::{ProjectedAccel, SceneSource, build, load};
pub use render_request::{ImageEncoding, RenderRequest};
pub use resolved::{ResolvedSettings, check_memory, render_settings};
pub use scene_change::SceneChange;
pub use settings::Settings;
pub use tracing::{HitPath, TracingOptions, effective_precision};
