//! Boundaries between media, with the interiors on both sides and Fresnel's factors.

use super::super::context::RenderContext;
use crate::optics::{
    BoundaryCrossing, BoundaryEvent, InteriorStack, NestedInterior, Polarised, dielectric, thin_slab,
};
use crate::scene::{Effect, Material, MediumKind};

/// Boundary between two media that a ray hits.
pub(in crate::render) struct Boundary<'m> {
    pub(in crate::render) material: &'m Material,
    pub(in crate::render) crossing: BoundaryCrossing,
    /// True if the surface bounds a transmissive interior.
    is_solid: bool,
}

impl Boundary<'_> {
    /// Returns whether the surface is thin, so that a ray is never inside it.
    pub(in crate::render) fn is_thin_surface(&self) -> bool {
        self.material.is_thin_surface()
    }

    /// Returns whether an interior of higher priority hides the boundary, so that the ray passes unchanged.
    pub(in crate::render) fn is_hidden(&self) -> bool {
        self.is_solid && !self.crossing.is_real()
    }
}

/// Surface that a ray hits, with the interior that begins or ends there.
pub(in crate::render) struct CrossedSurface<'m> {
    pub(in crate::render) material: &'m Material,
    /// Interior that the surface bounds; `None` unless it is solid and transmissive.
    pub(in crate::render) interior: Option<NestedInterior>,
    /// Direction in which the ray crosses the surface.
    event: BoundaryEvent,
}

impl CrossedSurface<'_> {
    /// Returns the interior that is present behind the surface for a ray inside `media`.
    #[inline(always)]
    pub(in crate::render) fn after(&self, media: &InteriorStack) -> Option<NestedInterior> {
        match self.interior {
            Some(interior) => media.after(interior, self.event),
            None => media.current(),
        }
    }

    /// Returns the interiors behind the surface around a ray inside `media`.
    #[inline(always)]
    pub(in crate::render) fn through(&self, media: &InteriorStack) -> InteriorStack {
        match self.interior {
            Some(interior) => media.through(interior, self.event),
            None => *media,
        }
    }

    /// Returns the effect of the surface on a ray inside `media`.
    #[inline(always)]
    fn crossing(&self, media: &InteriorStack) -> BoundaryCrossing {
        match self.interior {
            Some(interior) => media.crossing(interior, self.event),
            None => BoundaryCrossing {
                before: media.current(),
                after: media.current(),
                through: *media,
            },
        }
    }

    /// Returns whether an interior of higher priority hides the surface from a ray inside `media`.
    #[inline(always)]
    pub(in crate::render) fn is_hidden(&self, media: &InteriorStack) -> bool {
        let id = |interior: NestedInterior| interior.id;
        self.interior.is_some() && media.current().map(id) == self.after(media).map(id)
    }
}

impl Material {
    /// Returns whether the material is thin, so that a ray is never inside it.
    pub(in crate::render) fn is_thin_surface(&self) -> bool {
        self.interior.is_none_or(|inside| inside.is_thin())
    }
}

impl RenderContext<'_> {
    /// Returns the boundary that instance `instance` forms for a ray inside `media`; the ray arrives on the outside
    /// of the surface if `from_outside`.
    pub(in crate::render) fn boundary(
        &self,
        instance: u32,
        from_outside: bool,
        media: &InteriorStack,
    ) -> Boundary<'_> {
        let surface = self.crossed_surface(instance, from_outside);
        Boundary {
            material: surface.material,
            crossing: surface.crossing(media),
            is_solid: surface.interior.is_some(),
        }
    }

    /// Returns the surface of instance `instance` for a ray that arrives on its outside if `from_outside`.
    #[inline(always)]
    pub(in crate::render) fn crossed_surface(&self, instance: u32, from_outside: bool) -> CrossedSurface<'_> {
        let index = self.scene.instances[instance as usize].material;
        let material = &self.scene.materials[index as usize];
        // Update the interior stack only at transmissive solids
        let is_solid =
            self.effects().has(Effect::Refraction) && material.transmits() && !material.is_thin_surface();
        let priority = material.interior.map_or(0, |inside| inside.priority);
        CrossedSurface {
            material,
            interior: is_solid.then_some(NestedInterior { id: index, priority }),
            event: if from_outside {
                BoundaryEvent::Enter
            } else {
                BoundaryEvent::Leave
            },
        }
    }

    fn interior_material(&self, body: Option<NestedInterior>) -> Option<&Material> {
        body.and_then(|body| self.scene.materials.get(body.id as usize))
    }

    /// Returns the index of refraction inside `body`, or of the background medium for `None`.
    pub(in crate::render) fn ior(&self, body: Option<NestedInterior>, wavelength: f64) -> f64 {
        self.interior_material(body)
            .map_or(1.0, |material| material.ior(wavelength))
    }

    pub(in crate::render) fn disperses(&self, body: Option<NestedInterior>) -> bool {
        let interior = self
            .interior_material(body)
            .and_then(|material| material.interior);
        interior.is_some_and(|inside| inside.ior.spread() != 0.0)
    }

    /// Returns the transmittance over `distance` inside the innermost interior of `media`, per channel.
    pub(in crate::render) fn transmittance(&self, media: &InteriorStack, distance: f64) -> [f32; 3] {
        match self.interior_material(media.current()).and_then(|m| m.interior) {
            Some(inside) => inside.absorption.transmittance(distance).map(|x| x as f32),
            None => [1.0; 3],
        }
    }

    /// Returns the reflected and the transmitted share at a boundary, averaged over polarization.
    ///
    /// A thin wall is evaluated between two sides of the surrounding medium: as a slab, or as one face.
    pub(in crate::render) fn fresnel_factors(
        &self,
        boundary: &Boundary,
        cos_i: f64,
        wavelength: f64,
    ) -> (f64, f64) {
        let material = boundary.material;
        let outside = self.ior(boundary.crossing.before, wavelength);
        let mean = |r: Polarised, t: Polarised| (r.mean(), t.mean());
        let Some(medium) = material.interior else {
            return (0.0, 1.0);
        };
        let inside = match medium.kind {
            // Evaluate a thin slab with its internal reflections
            MediumKind::ThinSlab => {
                let slab = thin_slab(cos_i, outside, material.ior(wavelength));
                return mean(slab.reflectance, slab.transmittance);
            }
            MediumKind::ThinFace => material.ior(wavelength),
            MediumKind::Solid => self.ior(boundary.crossing.after, wavelength),
        };
        // Evaluate Fresnel's equations of a single interface
        let fresnel = dielectric(cos_i, outside, inside);
        mean(fresnel.reflectance, fresnel.transmittance)
    }
}
