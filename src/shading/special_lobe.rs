//! What thin films and anisotropic lobes change of a material, for the few scenes that have any.

use super::anisotropic_lobe::{AnisotropicLobe, anisotropic_albedo, dot};
use super::layer::cosines;
use super::material::MaterialPacket;
use super::{ThinFilm, ThinFilmLanes};
use crate::numeric::{LANES, Lanes3};

impl MaterialPacket {
    /// Blends the reflectance of the thin film in lane `l` into `reflectance`, at this cosine of incidence.
    #[inline(never)]
    pub fn with_film(&self, reflectance: [f32; 3], cosine: f32, l: usize) -> [f32; 3] {
        // Keep the reflectance of lanes without a film
        let weight = self.extended.film[l];
        if !(weight > 0.0) {
            return reflectance;
        }
        let film = self.film_reflectance(cosine, l);
        std::array::from_fn(|c| self.blend_film(reflectance[c], film[c], l))
    }

    /// Blends the reflectance of the thin film in lane `l` into `reflectance`, by its weight.
    #[inline(always)]
    pub(super) fn blend_film(&self, reflectance: f32, film: f32, l: usize) -> f32 {
        let weight = self.extended.film[l];
        if weight > 0.0 {
            reflectance + weight * (film - reflectance)
        } else {
            reflectance
        }
    }

    /// Returns the reflectance of the thin film in lane `l` at this cosine of incidence.
    fn film_reflectance(&self, cosine: f32, l: usize) -> [f32; 3] {
        let film = ThinFilm {
            ior: self.extended.film_ior[l].into(),
            thickness: self.extended.film_thickness[l].into(),
        };
        let f0 = [0, 1, 2].map(|channel| f64::from(self.f0::<true>(channel, l)));
        let cosine = f64::from(cosine.clamp(0.0, 1.0));
        film.reflectance(cosine, f0).map(|x| x as f32)
    }

    #[inline(never)]
    pub(super) fn set_film_reflectance(&mut self, ns: &Lanes3<f32>, wo: &Lanes3<f32>) {
        if self.has_film() {
            self.extended.film_reflectance = self.films().reflectance(&cosines(ns, wo));
        }
    }

    /// Returns whether any lane has a thin film.
    pub(super) fn has_film(&self) -> bool {
        self.extended.film.iter().any(|&weight| weight > 0.0)
    }

    /// Returns the thin films of all lanes.
    #[inline(always)]
    pub(super) fn films(&self) -> ThinFilmLanes<'_> {
        let mut f0 = [[0.0; LANES]; 3];
        for channel in 0..3 {
            for l in 0..LANES {
                f0[channel][l] = self.f0::<true>(channel, l);
            }
        }
        ThinFilmLanes {
            ior: &self.extended.film_ior,
            thickness: &self.extended.film_thickness,
            f0,
        }
    }

    /// Replaces the albedos of anisotropic lobes.
    #[inline(never)]
    pub(super) fn set_anisotropic_albedos(&mut self, ns: &Lanes3<f32>, wo: &Lanes3<f32>) {
        for l in (0..LANES).filter(|&l| self.extended.anisotropy[l] > 0.0) {
            let [n, v] = [ns, wo].map(|v| [v[0][l], v[1][l], v[2][l]]);
            let lobe = AnisotropicLobe::of(self, n, l);
            let z = dot(n, v).abs().max(f32::MIN_POSITIVE);
            // Evaluate in the frame of the lobe
            let local = [dot(lobe.tangent, v), dot(lobe.bitangent, v), z];
            let albedo = anisotropic_albedo([lobe.along, lobe.across], local);
            self.lobe.set(l, albedo);
        }
    }
}
