//! Layers of light (AOVs): the contribution of each light, and of each effect at the first bounce. Each kind adds up
//! to the image.
//!
//! All radiance that is added to a tile's film has a [`LightSource`]. The first step of its path from the camera is part
//! of the label that every ray carries with its pixel, so queues need no extra memory: rays receive it when their
//! generation is traced, and rays that they send inherit it. Layers are sums in addition to the sum of the image.

use super::super::film::{STEP_SHIFT, STEPS, number_of, pixel_of};
use super::super::profile::Category;
use super::super::subset::Region;
use super::super::tile::TILE;
use super::buffers::TileLayer;
use super::layer::Layer;
use super::selection::LightAovs;
use crate::image::ChannelKind;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Effect, EffectSet, Light};

/// Origin of radiance that reaches the film.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::render) enum LightSource {
    /// Light that is seen without a shadow ray.
    Emission,
    /// Light of the scene with that index.
    Light(u32),
    /// Several lights, of which each lane has its own ([`LightGroupFilm::add_to_lights`]).
    Chosen,
    /// Environment map, sampled by shadow rays.
    Environment,
    /// Object with subsurface scattering.
    Subsurface,
    /// Smoke, fire and fog; their light is divided by light source separately.
    Volume,
}

/// Requested layers of light, as planes of three channels each.
#[derive(Clone, Default)]
pub(in crate::render) struct LightGroups {
    names: Vec<String>,
    /// Number of planes of lights; planes of effects follow them.
    light_planes: usize,
    environment: Option<usize>,
    subsurface: Option<usize>,
    /// Planes by the number of the first step; `None` without layers by effect.
    steps: Option<[usize; STEPS.len() + 1]>,
}

impl LightGroups {
    /// Returns the layers of a scene with these lights.
    pub(in crate::render) fn new(wanted: LightAovs, lights: &[Light], effects: EffectSet) -> LightGroups {
        let mut groups = LightGroups::default();
        if wanted.lights {
            groups.add_lights(lights, effects);
        }
        groups.light_planes = groups.names.len();
        if wanted.effects {
            groups.add_effects(effects);
        }
        groups
    }

    fn add_lights(&mut self, lights: &[Light], effects: EffectSet) {
        self.names.push("light.emission".into());
        let names = light_names(lights);
        self.names
            .extend(names.iter().map(|name| format!("light.{name}")));
        for (effect, plane) in [
            (Effect::Environment, &mut self.environment),
            (Effect::Subsurface, &mut self.subsurface),
        ] {
            if effects.has(effect) {
                *plane = Some(self.names.len());
                self.names.push(format!("light.{}", effect.name()));
            }
        }
    }

    fn add_effects(&mut self, effects: EffectSet) {
        let direct = self.names.len();
        self.names.push("effect.direct".into());
        // Steps without a layer of their own count as direct
        let mut steps = [direct; STEPS.len() + 1];
        for step in STEPS {
            let is_on = Effect::ALL
                .into_iter()
                .any(|effect| effects.has(effect) && Category::of(effect) == Some(step));
            if is_on {
                steps[number_of(step)] = self.names.len();
                self.names.push(format!("effect.{}", step.name()));
            }
        }
        self.steps = Some(steps);
    }

    /// Returns whether any layer is requested.
    pub(in crate::render) fn is_wanted(&self) -> bool {
        !self.names.is_empty()
    }

    /// Returns whether layers by light are requested.
    pub(in crate::render) fn has_lights(&self) -> bool {
        self.light_planes > 0
    }

    /// Returns the number of planes of lights.
    pub(in crate::render) fn light_planes(&self) -> usize {
        self.light_planes
    }

    /// Returns the number of layers, which are channels.
    pub(in crate::render) fn layer_count(&self) -> usize {
        3 * self.names.len()
    }

    /// Returns the plane of the light from `source`, if layers by light are requested and it has one.
    pub(in crate::render) fn plane_of(&self, source: LightSource) -> Option<usize> {
        let plane = match source {
            LightSource::Emission => Some(0),
            LightSource::Light(number) => Some(1 + number as usize),
            LightSource::Environment => self.environment,
            LightSource::Subsurface => self.subsurface,
            LightSource::Chosen | LightSource::Volume => None,
        };
        plane.filter(|&plane| plane < self.light_planes)
    }

    /// Returns the plane of the effect for radiance from `source` along a ray with that label.
    fn effect_plane(&self, label: u32, source: LightSource) -> Option<usize> {
        let steps = self.steps?;
        // Scattering in volumes and below surfaces is the first step of a path that has none
        let step = match (label >> STEP_SHIFT, source) {
            (0, LightSource::Volume) => number_of(Category::Volume),
            (0, LightSource::Subsurface) => number_of(Category::Subsurface),
            (step, _) => step as usize,
        };
        steps.get(step).copied()
    }

    /// Returns the layers of `region`, filled with zero.
    pub(in crate::render) fn blank(&self, region: &Region) -> Vec<Layer> {
        let channels = self
            .names
            .iter()
            .flat_map(|name| ["R", "G", "B"].map(|channel| format!("{name}.{channel}")));
        channels
            .map(|name| Layer::blank(name, ChannelKind::Color, region))
            .collect()
    }
}

/// Returns channel names for the lights, all different.
///
/// Every character other than ASCII letters, digits, `-` and `_` becomes `_`. Names that clash with an earlier one,
/// or with the layer of another source, get the first free suffix of `_2`, `_3` and so on.
fn light_names(lights: &[Light]) -> Vec<String> {
    let mut taken: Vec<String> = ["emission", "environment", "subsurface"].map(String::from).into();
    let reserved = taken.len();
    for (number, light) in lights.iter().enumerate() {
        // Replace characters that channel names do not allow
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let called: String = light
            .name
            .chars()
            .map(|c| if allowed(c) { c } else { '_' })
            .collect();
        let called = match called.is_empty() {
            true => format!("light_{number}"),
            false => called,
        };
        // Append the first free number to names in use
        let mut free = called.clone();
        let mut next = 2;
        while taken.contains(&free) {
            free = format!("{called}_{next}");
            next += 1;
        }
        taken.push(free);
    }
    taken.split_off(reserved)
}

/// Sums of the layers over one tile, plane by plane.
pub(in crate::render) struct LightGroupFilm {
    sheet: LightGroups,
    /// Sums of each plane, `TILE` pixels per row.
    planes: Vec<Vec<[f64; 3]>>,
}

impl LightGroupFilm {
    /// Returns an empty film if any layer is requested.
    pub(in crate::render) fn of(groups: &LightGroups) -> Option<LightGroupFilm> {
        let plane = || vec![[0.0; 3]; (TILE * TILE) as usize];
        groups.is_wanted().then(|| LightGroupFilm {
            planes: groups.names.iter().map(|_| plane()).collect(),
            sheet: groups.clone(),
        })
    }

    pub(in crate::render) fn clear(&mut self) {
        self.planes.iter_mut().for_each(|plane| plane.fill([0.0; 3]));
    }

    /// Returns the bytes of all sums.
    pub(in crate::render) fn byte_count(&self) -> usize {
        self.planes.iter().map(|plane| size_of_val(&plane[..])).sum()
    }

    /// Adds one value per lane to the layers of light from `source`.
    pub(in crate::render) fn add(&mut self, label: &Lanes<u32>, radiance: &Lanes3<f32>, source: LightSource) {
        if let Some(plane) = self.plane_of(source) {
            self.add_to_plane(plane, label, radiance);
        }
        for l in 0..LANES {
            if let Some(plane) = self.sheet.effect_plane(label[l], source) {
                add_lane(&mut self.planes[plane], label[l], radiance, l);
            }
        }
    }

    fn plane_of(&self, source: LightSource) -> Option<usize> {
        self.sheet.plane_of(source)
    }

    /// Adds one value per lane to the layer of a light for each lane.
    pub(in crate::render) fn add_to_lights(
        &mut self,
        label: &Lanes<u32>,
        radiance: &Lanes3<f32>,
        lights: &Lanes<u32>,
    ) {
        for l in 0..LANES {
            if let Some(plane) = self.plane_of(LightSource::Light(lights[l])) {
                add_lane(&mut self.planes[plane], label[l], radiance, l);
            }
        }
    }

    /// Adds one value per lane to one plane.
    pub(in crate::render) fn add_to_plane(
        &mut self,
        plane: usize,
        label: &Lanes<u32>,
        radiance: &Lanes3<f32>,
    ) {
        for l in 0..LANES {
            add_lane(&mut self.planes[plane], label[l], radiance, l);
        }
    }

    /// Returns the layers of a tile: means over `spp` samples.
    pub(in crate::render) fn layers(&self, spp: u32) -> impl Iterator<Item = TileLayer<'_>> {
        let scale = f64::from(spp).recip();
        self.planes
            .iter()
            .flat_map(move |sums| (0..3).map(move |channel| TileLayer::Channel { sums, channel, scale }))
    }
}

fn add_lane(plane: &mut [[f64; 3]], label: u32, radiance: &Lanes3<f32>, l: usize) {
    let sum = &mut plane[pixel_of(label) as usize];
    for channel in 0..3 {
        sum[channel] += f64::from(radiance[channel][l]);
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::scene::LightKind;

    fn light(name: &str) -> Light {
        Light {
            name: name.into(),
            intensity: [1.0; 3],
            kind: LightKind::Directional { to_light: DVec3::Z },
        }
    }

    #[test]
    fn light_channel_names_are_valid_and_unique() {
        let lights = ["sun", "light 3", "sun", "sun_2", "emission", "a.b", "", "ö"].map(light);
        assert_eq!(
            light_names(&lights),
            [
                "sun",
                "light_3",
                "sun_2",
                "sun_2_2",
                "emission_2",
                "a_b",
                "light_6",
                "_"
            ]
        );
    }

    #[test]
    fn only_effects_that_are_on_have_layers() {
        let wanted = LightAovs {
            lights: true,
            effects: true,
        };
        let groups = LightGroups::new(wanted, &[light("sun")], EffectSet::NONE.with(Effect::Reflection));
        assert_eq!(
            groups.names,
            [
                "light.emission",
                "light.sun",
                "effect.direct",
                "effect.reflection"
            ]
        );
        assert!(!LightGroups::new(LightAovs::NONE, &[light("sun")], EffectSet::NONE).is_wanted());
    }
}
