//! Media inside surfaces: `KHR_materials_ior`, `KHR_materials_volume`, `KHR_materials_dispersion` and the draft
//! `KHR_materials_volume_scatter`.
//!
//! A thickness of zero makes a thin wall that light crosses straight, and that reflects the Fresnel reflectance once, as
//! `KHR_materials_transmission` defines it; any other makes an interior. The path of light through the interior is
//! traced, so the stated thickness is not used.

use serde_json::{Map, Value};

use crate::gltf::extension::{Corrections, Extension};
use crate::optics::subsurface::{ETA_RANGE, Scattering};
use crate::optics::{Absorption, Cauchy, Dispersion, MIN_WAVELENGTH};
use crate::scene::{DEFAULT_IOR, MAX_OPAQUE_IOR, Medium, MediumKind};

/// Largest index of refraction that a scene accepts for a surface that transmits light.
const MAX_IOR: f64 = 16.0;
/// Largest number of changes of direction in a metre that a file may give; the smallest is its inverse.
const MAX_EXTINCTION: f64 = 1e12;
/// Index of refraction of an opaque surface whose reflectance at normal incidence rounds to 1 in f32: an index of 0, and
/// any larger index, request it.
pub(in crate::gltf) const REFLECTING_IOR: f64 = MAX_OPAQUE_IOR;

/// Returns the interior of a material that transmits or that states an index of refraction; `None` otherwise.
pub(in crate::gltf) fn interior(
    extensions: Option<&Map<String, Value>>,
    transmits: bool,
    corrections: &mut Corrections,
) -> Option<Medium> {
    let stated = Extension::of(extensions, "KHR_materials_ior", corrections);
    if !transmits && !stated.is_present() {
        return None;
    }
    let max = if transmits { MAX_IOR } else { REFLECTING_IOR };
    let ior = match stated.number("ior", DEFAULT_IOR, 0.0..=max, corrections) {
        // An index of 0 requests a surface that reflects everything; the largest index comes closest.
        0.0 => max,
        ior => corrections.within("ior", ior, 1.0..=max, DEFAULT_IOR),
    };
    // Read the thickness, which only decides whether there is an interior
    let volume = Extension::of(extensions, "KHR_materials_volume", corrections);
    let is_thin = volume.number("thicknessFactor", 0.0, 0.0..=f64::MAX, corrections) == 0.0;
    let thin = Medium {
        ior: Dispersion::Constant(ior),
        absorption: Absorption::NONE,
        priority: 0,
        kind: MediumKind::ThinFace,
    };
    if is_thin {
        return Some(thin);
    }
    Some(Medium {
        ior: dispersion(extensions, ior, corrections),
        absorption: absorption(&volume, corrections),
        kind: MediumKind::Solid,
        ..thin
    })
}

fn dispersion(
    extensions: Option<&Map<String, Value>>,
    ior: f64,
    corrections: &mut Corrections,
) -> Dispersion {
    let extension = Extension::of(extensions, "KHR_materials_dispersion", corrections);
    let strength = extension.number("dispersion", 0.0, 0.0..=f64::MAX, corrections);
    if strength == 0.0 {
        return Dispersion::Constant(ior);
    }
    let cauchy = Cauchy::from_gltf(ior, strength);
    if cauchy.ior(MIN_WAVELENGTH) <= MAX_IOR {
        return Dispersion::Cauchy(cauchy);
    }
    // Ignore a dispersion that exceeds the largest index in the visible range
    corrections.note("dispersion");
    Dispersion::Constant(ior)
}

fn absorption(volume: &Extension, corrections: &mut Corrections) -> Absorption {
    let color = volume.vector("attenuationColor", [1.0; 3], 0.0..=1.0, corrections);
    let any = f64::NEG_INFINITY..=f64::INFINITY;
    let distance = volume.number("attenuationDistance", f64::INFINITY, any, corrections);
    if distance <= 0.0 {
        corrections.note("attenuationDistance");
    }
    Absorption::from_color(color, distance)
}

/// Returns the subsurface scattering of a surface that lets light into its interior diffusely, with the reflectance
/// that the surface has in uniform light; `None` for a thin surface, or if the interior does not scatter.
///
/// The draft <https://github.com/KhronosGroup/glTF/pull/2453> gives the colour of the light that is scattered many
/// times, and the extinction by the attenuation of `KHR_materials_volume`. Scattering that is peaked forward changes
/// directions less often, by one minus the mean cosine.
pub(in crate::gltf) fn scattering(
    extensions: Option<&Map<String, Value>>,
    corrections: &mut Corrections,
) -> Option<Scattering> {
    let volume = Extension::of(extensions, "KHR_materials_volume", corrections);
    let scatter = Extension::of(extensions, "KHR_materials_volume_scatter", corrections);
    // Read the colour and the mean cosine of scattering
    let reflectance = scatter.vector("multiscatterColor", [0.0; 3], 0.0..=1.0, corrections);
    let mean_cosine = scatter.number("scatterAnisotropy", 0.0, -1.0..=1.0, corrections);
    let thickness = volume.number("thicknessFactor", 0.0, 0.0..=f64::MAX, corrections);
    let extinction = absorption(&volume, corrections).sigma_a;
    if thickness == 0.0 || reflectance == [0.0; 3] || extinction == [0.0; 3] {
        return None;
    }
    let stated = Extension::of(extensions, "KHR_materials_ior", corrections);
    let ior = stated.number("ior", DEFAULT_IOR, 0.0..=REFLECTING_IOR, corrections);
    // Convert the extinction to the path between two changes of direction
    let reduced = extinction.map(|sigma| sigma * (1.0 - mean_cosine));
    let mean_free_path = reduced.map(|sigma| sigma.clamp(MAX_EXTINCTION.recip(), MAX_EXTINCTION).recip());
    let eta = ior.clamp(*ETA_RANGE.start(), *ETA_RANGE.end());
    Scattering::from_reflectance(reflectance, mean_free_path, eta).ok()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn read(extensions: Value, transmits: bool) -> (Option<Medium>, Vec<&'static str>) {
        let mut corrections = Corrections::default();
        let found = interior(extensions.as_object(), transmits, &mut corrections);
        (found, corrections.names)
    }

    #[test]
    fn transmissive_surface_is_thin_glass_by_default() {
        let thin = Medium {
            ior: Dispersion::Constant(1.5),
            absorption: Absorption::NONE,
            priority: 0,
            kind: MediumKind::ThinFace,
        };
        assert_eq!(read(json!({}), true), (Some(thin), vec![]));
        assert_eq!(read(json!({}), false), (None, vec![]));
        let water = json!({"KHR_materials_ior": {"ior": 1.33}});
        assert_eq!(
            read(water, false).0.unwrap().ior,
            Dispersion::Constant(1.33),
            "its reflection depends on it"
        );
    }

    #[test]
    fn volume_material_absorbs_and_disperses() {
        let extensions = json!({
            "KHR_materials_ior": {"ior": 1.6},
            "KHR_materials_volume": {
                "thicknessFactor": 1e-9, "attenuationColor": [1, 0.5, 0.25], "attenuationDistance": 2
            },
            "KHR_materials_dispersion": {"dispersion": 0.5}
        });
        let (found, names) = read(extensions, true);
        let found = found.unwrap();
        assert!(names.is_empty() && !found.is_thin(), "{names:?}");
        // sigma = -ln(color) / 2.
        let ln2 = std::f64::consts::LN_2;
        assert_eq!(found.absorption.sigma_a, [0.0, ln2 / 2.0, ln2]);
        assert_eq!(found.ior, Dispersion::Cauchy(Cauchy::from_gltf(1.6, 0.5)));
    }

    #[test]
    fn interior_that_scatters_has_the_reflectance_and_the_path_of_its_volume() {
        let read = |volume: Value, scatter: Value| {
            let extensions = json!({"KHR_materials_volume": volume, "KHR_materials_volume_scatter": scatter});
            scattering(extensions.as_object(), &mut Corrections::default())
        };
        let half = (-0.5f64).exp();
        let volume = |thickness: f64| json!({"thicknessFactor": thickness, "attenuationColor": [half, half, half], "attenuationDistance": 0.25});
        let wax = json!({"multiscatterColor": [0.9, 0.6, 0.2]});
        // An extinction of 2 per metre and a mean cosine of 0.5: a change of direction each metre
        let forward = json!({"multiscatterColor": [0.9, 0.6, 0.2], "scatterAnisotropy": 0.5});
        let exact = |path: f64| Scattering::from_reflectance([0.9, 0.6, 0.2], [path; 3], 1.5).unwrap();
        for (scatter, path) in [(wax.clone(), 0.5), (forward, 1.0)] {
            let (found, exact) = (read(volume(1.0), scatter).unwrap(), exact(path));
            for c in 0..3 {
                let ratio = found.sigma_s_reduced[c] / exact.sigma_s_reduced[c];
                assert!((ratio - 1.0).abs() < 1e-12, "{found:?}, not {exact:?}");
            }
        }
        // Thin, black, and clear interiors do not scatter
        assert!(read(volume(0.0), wax.clone()).is_none());
        assert!(read(volume(1.0), json!({})).is_none());
        assert!(read(json!({"thicknessFactor": 1}), wax.clone()).is_none());
        // A clear channel is finite
        let red = json!({"thicknessFactor": 1, "attenuationColor": [1, 0.5, 0.5], "attenuationDistance": 1});
        assert!(
            read(red, wax)
                .unwrap()
                .sigma_s_reduced
                .iter()
                .all(|sigma| sigma.is_finite())
        );
    }

    #[test]
    fn out_of_range_numbers_are_clamped_and_reported() {
        let glass = |volume: Value, ior: Value, dispersion: Value| {
            let (found, names) = read(
                json!({"KHR_materials_ior": {"ior": ior}, "KHR_materials_volume": volume,
                    "KHR_materials_dispersion": {"dispersion": dispersion}}),
                true,
            );
            let found = found.unwrap();
            (found.ior, found.absorption, found.is_thin(), names)
        };
        let volume =
            || json!({"thicknessFactor": 1, "attenuationColor": [0.5, 0.5, 0.5], "attenuationDistance": -1});
        // An opaque surface may reflect everything
        let opaque = |ior: f64| read(json!({"KHR_materials_ior": {"ior": ior}}), false);
        assert_eq!(opaque(0.0).0.unwrap().ior, Dispersion::Constant(REFLECTING_IOR));
        assert_eq!(opaque(1000.0).0.unwrap().ior, Dispersion::Constant(1000.0));
        assert!(opaque(1000.0).1.is_empty());
        let (ior, absorption, is_thin, names) = glass(volume(), json!(1e6), json!(-1));
        assert_eq!((ior, absorption), (Dispersion::Constant(16.0), Absorption::NONE));
        assert!(!is_thin);
        assert_eq!(names, ["ior", "dispersion", "attenuationDistance"]);
        let (ior, .., names) = glass(json!({"thicknessFactor": -3}), json!(0.2), json!(0));
        assert_eq!(
            (ior, names),
            (Dispersion::Constant(1.0), vec!["ior", "thicknessFactor"])
        );
        let (ior, .., names) = glass(volume(), json!(0), json!(1e9));
        assert_eq!(ior, Dispersion::Constant(16.0));
        assert_eq!(names, ["dispersion", "attenuationDistance"]);
    }
}
