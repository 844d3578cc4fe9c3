//! System under test: acceleration structure and formulas.

use super::formulas::Formulas;
use super::verdict_cache::VerdictCache;
use crate::accel::{Accel, AccelError};
use crate::scene::Scene;

/// Function that builds the acceleration structure of a scene.
pub type Build<'a> = dyn for<'s> Fn(&'s Scene) -> Result<Box<dyn Accel + 's>, AccelError> + Sync + 'a;

/// System under test: acceleration structure and formulas.
pub struct SystemUnderTest<'a> {
    /// Builder of the acceleration structure.
    pub build: &'a Build<'a>,
    /// Functions that need no scene.
    pub formulas: Formulas,
    /// Cached verdicts on the results of other systems under test for this case.
    pub verdict_cache: &'a VerdictCache,
}
