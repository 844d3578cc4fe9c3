//! Runner of numerically hard cases, with their oracles and test scenes.

mod case;
mod check;
mod correctness;
mod counts;
pub(super) mod cylinder_mesh;
mod engine;
mod exact_nearest;
pub(super) mod expansion;
mod figure_data;
mod formulas;
mod homogeneous_march;
mod query_result;
pub(super) mod reference;
mod runner;
mod system_under_test;
pub(super) mod terrain_mesh;
pub(super) mod test_meshes;
pub(super) mod test_scenes;
mod variant;
mod verdict_cache;
mod wireframe;

pub use case::{Case, CaseKind};
pub use check::{Outcome, Verdict, check};
pub use correctness::Correctness;
pub use counts::Counts;
pub use figure_data::{CloseUp, Error, FigureAxis, FigureData, TracedRay};
pub use formulas::{Formulas, Render};
pub use query_result::{QueryResult, describe, describe_ray};
pub use runner::Recording;
pub use system_under_test::{Build, SystemUnderTest};
pub use variant::{BackendVariant, VARIANTS, Watertightness, build_variant, has_instruction_set};
pub use verdict_cache::VerdictCache;
pub use wireframe::{Wireframe, view};

pub(super) use engine::{Engine, embree_identity, order, towards};
pub(super) use exact_nearest::{exact_nearest, judge_against};
pub(super) use runner::CaseRunner;
