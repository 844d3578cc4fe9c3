//! Subsurface scattering and diffuse transmission of materials of scene files.

use super::fault::Diagnostic;
use super::material_form::MaterialForm;
use crate::optics::{Absorption, Dispersion, LINE_D};
use crate::scene::{Material, Medium, MediumKind, Translucency, check_scattering};

impl MaterialForm {
    /// Adds subsurface scattering and diffuse transmission to `material`.
    pub(super) fn scatter(&self, material: &mut Material) -> Result<(), Diagnostic> {
        if let Some(form) = &self.subsurface {
            // The dipole uses the index at the d line
            let stated = material.interior.map(|inside| inside.ior.ior(LINE_D));
            let scattering = form.scattering(stated)?;
            material.subsurface = Some(scattering);
            // The surface's Fresnel reflection must agree with the scattering medium's index of refraction.
            material.interior.get_or_insert(Medium {
                ior: Dispersion::Constant(scattering.eta),
                absorption: Absorption::NONE,
                priority: 0,
                kind: MediumKind::Solid,
            });
            check_scattering(material).map_err(|sentence| form.fault(sentence))?;
        }
        // Set the diffuse transmission, which needs a factor
        match (&self.translucency, &self.translucency_color) {
            (None, None) => Ok(()),
            (None, Some(color)) => Err(color.fault("has no effect without `translucency`: add it")),
            (Some(factor), color) => {
                // The colour defaults to the base colour
                let [r, g, b, _] = material.base_color;
                material.translucency = Some(Translucency {
                    factor: **factor,
                    color: color.as_ref().map_or([r, g, b], |color| color.0),
                });
                check_scattering(material).map_err(|sentence| factor.fault(sentence))
            }
        }
    }
}
