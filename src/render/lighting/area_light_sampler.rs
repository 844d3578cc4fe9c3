//! Area lights of a scene, prepared for sampling, including emissive objects.
//!
//! Other area lights are invisible and cannot be hit by shadow rays. The surface of an emissive object exists in the
//! scene: a shadow ray to a point on it must neither hit that surface at its end nor miss an occluder close to it.
//! The shadow ray therefore ends off the surface, on its own side, by a bound on the rounding errors of both: that of
//! a ray which leaves the surface there ([`ShadowRayEnds`]) and that of a traversal over the length of the shadow
//! ray. A convex emissive object thus never occludes its own points, and a concave one does so where it should.

use glam::{DVec3, Vec3};

use super::emissive_mesh::{sample_emissive_mesh, triangle_errors};
use super::shadow_ray_end::ShadowRayEnds;
use crate::mesh::Mesh;
use crate::numeric::{HitErrorBound, Lanes, Lanes3};
use crate::scene::{
    AreaShape, Effect, EffectSet, Geometry, Instance, LightKind, LightSamplePacket, LightView, MaterialInput,
    Scene, SurfacePoint, TextureBinding,
};
use crate::shading::{AreaLight, DiskLight, LightSample, QuadLight, SphereLight, TexturePoint, TextureSet};
use crate::shape::Implicit;

/// Area light of a scene, prepared for sampling.
pub(in crate::render) struct AreaLightSampler<'s> {
    shape: AreaLight,
    emissive_object: Option<EmissiveObject<'s>>,
}

/// Emissive object behind an area light.
struct EmissiveObject<'s> {
    geometry: &'s Geometry,
    instance: &'s Instance,
    ends: ShadowRayEnds,
    /// Texture of the emission, if there is one and textures are simulated.
    texture: Option<&'s TextureBinding>,
    /// Bounds on the rounding errors of rays that leave each triangle of a mesh, along each axis of object space.
    triangle_errors: Vec<Vec3>,
}

/// Sampled point of an area light, for one shaded point.
pub(in crate::render) struct AreaLightSample {
    /// Unit vector from the shaded point to the light point.
    pub(in crate::render) direction: DVec3,
    /// End point of the shadow ray.
    pub(in crate::render) end: DVec3,
    /// Density of the direction per steradian.
    pub(in crate::render) pdf: f64,
    /// Factor on the radiance of the light at the sampled point, linear RGB.
    pub(in crate::render) tint: [f32; 3],
}

/// Ray that leaves the surface of a light.
pub(in crate::render) struct EmittedRay {
    /// Origin of the ray, off the surface of an object.
    pub(in crate::render) origin: DVec3,
    /// Cosine between the ray and the normal of the surface, positive.
    pub(in crate::render) cosine: f64,
}

/// Returns the area lights of a scene, with one entry per light; `None` for other lights.
pub(in crate::render) fn area_lights(scene: &Scene, effects: EffectSet) -> Vec<Option<AreaLightSampler<'_>>> {
    let with_extent = |kind: &LightKind| match kind {
        LightKind::Area { shape, .. } => AreaLightSampler::of(scene, shape, effects),
        _ => None,
    };
    scene
        .lights
        .iter()
        .map(|light| with_extent(&light.kind))
        .collect()
}

impl<'s> AreaLightSampler<'s> {
    fn of(scene: &'s Scene, shape: &AreaShape, effects: EffectSet) -> Option<AreaLightSampler<'s>> {
        // Build analytic lights, which are invisible
        let shape = match *shape {
            AreaShape::Quad {
                center,
                half_u,
                half_v,
            } => QuadLight::new(center, half_u, half_v).ok().map(AreaLight::Quad),
            AreaShape::Disk {
                center,
                half_u,
                half_v,
            } => DiskLight::new(center, half_u, half_v).ok().map(AreaLight::Disk),
            AreaShape::Sphere { center, radius } => {
                SphereLight::new(center, radius).ok().map(AreaLight::Sphere)
            }
            AreaShape::Object { instance } => {
                // Use the surface of an emissive object
                let shape = scene.emissive_surface(instance).ok()?;
                let emissive_object = Some(EmissiveObject::of(
                    scene,
                    &scene.instances[instance as usize],
                    effects,
                ));
                return Some(AreaLightSampler {
                    shape,
                    emissive_object,
                });
            }
        };
        shape.map(|shape| AreaLightSampler {
            shape,
            emissive_object: None,
        })
    }

    /// Returns whether rays can hit the light.
    pub(in crate::render) fn is_seen(&self) -> bool {
        self.emissive_object.is_some()
    }

    /// Returns the light as seen from the points `p`, if rays cannot hit it; `None` otherwise.
    pub(in crate::render) fn view_packet(&self, p: &Lanes3<f64>) -> Option<LightView> {
        (!self.is_seen()).then(|| self.shape.view_packet(p))
    }

    /// Samples the points that `u` selects for the points `p` of a light that rays cannot hit.
    pub(in crate::render) fn sample_packet(
        &self,
        view: &LightView,
        p: &Lanes3<f64>,
        u: &[Lanes<f64>; 2],
    ) -> LightSamplePacket {
        self.shape.sample_packet(view, p, u)
    }

    /// Returns whether photons can be emitted: from points chosen uniformly, without a texture of the emission.
    pub(in crate::render) fn emits_from_points(&self) -> bool {
        let is_textured = self
            .emissive_object
            .as_ref()
            .is_some_and(|object| object.texture.is_some());
        !is_textured && self.surface_point([0.5; 2]).is_some()
    }

    /// Returns the point that `u` in [0, 1)² selects uniformly from the surface of one side.
    pub(in crate::render) fn surface_point(&self, u: [f64; 2]) -> Option<SurfacePoint> {
        self.shape.surface_point(u)
    }

    /// Returns the area of one side in square metres.
    pub(in crate::render) fn area(&self) -> f64 {
        self.shape.area()
    }

    /// Returns the emission in `direction`, a unit vector, from a point of the surface; `None` on the side of the light
    /// that does not emit.
    pub(in crate::render) fn emitted(&self, point: &SurfacePoint, direction: DVec3) -> Option<EmittedRay> {
        let cosine = direction.dot(point.normal);
        let Some(object) = &self.emissive_object else {
            return (cosine > 0.0).then_some(EmittedRay {
                origin: point.position,
                cosine,
            });
        };
        // Start off the surface of an object, on the side of the direction
        let sample = LightSample {
            position: point.position,
            direction: -direction,
            distance: 0.0,
            normal: point.normal,
            primitive: point.primitive,
            pdf: 1.0,
        };
        let p_object = object
            .instance
            .object_from_world()
            .transform_point3(point.position);
        Some(EmittedRay {
            origin: object.end(&sample, p_object),
            cosine: cosine.abs(),
        })
    }

    /// Returns the density per steradian with which [`AreaLightSampler::sample`] chooses for `p` the direction to
    /// `position`, a point of the light with the unit `normal`; 0 where it has none.
    pub(in crate::render) fn pdf(&self, p: DVec3, position: DVec3, normal: DVec3) -> f64 {
        self.shape.pdf(p, position, normal)
    }

    /// Samples the points that `u` selects for the points `p`, offset as for [`AreaLightSampler::sample`], if the light is an
    /// emissive mesh without a texture.
    pub(super) fn sample_mesh(&self, p: &Lanes3<f32>, u: &[Lanes<f64>; 2]) -> Option<LightSamplePacket> {
        let object = self.emissive_object.as_ref()?;
        match &self.shape {
            AreaLight::Mesh(light) if object.texture.is_none() => {
                let surface = (&*object.triangle_errors, &object.ends);
                Some(sample_emissive_mesh(light, surface, (p, u)))
            }
            _ => None,
        }
    }

    /// Samples the point that `u` selects for `p`; `None` if the light does not emit towards `p`.
    ///
    /// For a light that rays can hit, `p` must be offset from the surface it belongs to, which may be that of the
    /// light itself, on the side that is shaded.
    pub(in crate::render) fn sample(
        &self,
        textures: &TextureSet,
        p: DVec3,
        u: [f64; 2],
    ) -> Option<AreaLightSample> {
        // Sample a point by the density of its direction
        let sample = self.shape.sample(p, u)?;
        // Offset the shadow ray's end from an emissive surface
        let (end, tint) = match &self.emissive_object {
            None if !sample.is_front() => return None,
            None => (sample.position, [1.0; 3]),
            Some(object) => {
                let p_object = object
                    .instance
                    .object_from_world()
                    .transform_point3(sample.position);
                (
                    object.end(&sample, p_object),
                    object.tint(textures, &sample, p_object),
                )
            }
        };
        Some(AreaLightSample {
            direction: sample.direction,
            end,
            pdf: sample.pdf,
            tint,
        })
    }
}

impl<'s> EmissiveObject<'s> {
    fn of(scene: &'s Scene, instance: &'s Instance, effects: EffectSet) -> EmissiveObject<'s> {
        let material = &scene.materials[instance.material as usize];
        let geometry = &scene.geometries[instance.geometry as usize];
        EmissiveObject {
            geometry,
            triangle_errors: match geometry {
                Geometry::Mesh(mesh) => triangle_errors(mesh),
                Geometry::Shape(_) | Geometry::Points(_) => Vec::new(),
            },
            instance,
            ends: ShadowRayEnds::of(instance),
            texture: material
                .layer(MaterialInput::Emission)
                .filter(|_| effects.has(Effect::Texture)),
        }
    }

    /// Returns the end of a shadow ray to a point of the object: offset from the surface, on the side that the ray
    /// comes from.
    fn end(&self, sample: &LightSample, p_object: DVec3) -> DVec3 {
        // Bound the error of rays that leave the surface
        let on_surface = match self.geometry {
            Geometry::Mesh(_) => HitErrorBound(self.triangle_errors[sample.primitive as usize].as_dvec3()),
            Geometry::Shape(shape) => shape.point(p_object, sample.primitive).error,
            Geometry::Points(cloud) => cloud.shape(sample.primitive).point(p_object, 0).error,
        };
        let n = if sample.is_front() {
            sample.normal
        } else {
            -sample.normal
        };
        let way = sample.distance * sample.direction;
        self.ends.end(sample.position, n, way, on_surface.0)
    }

    /// Returns the emission texture at a sampled point, or 1 without a texture.
    fn tint(&self, textures: &TextureSet, sample: &LightSample, p_object: DVec3) -> [f32; 3] {
        let Some(layer) = self.texture else {
            return [1.0; 3];
        };
        // Interpolate the texture coordinates of the light point
        let uv = match self.geometry {
            Geometry::Mesh(mesh) => tex_coords(mesh, layer.texture.tex_coord, sample.primitive, p_object),
            Geometry::Shape(shape) => shape.point(p_object, sample.primitive).uv.map(|x| x as f32),
            Geometry::Points(_) => [0.0; 2],
        };
        let at = TexturePoint::sharp(layer.texture.transform.apply(uv), p_object);
        let [r, g, b, _] = textures.sample(layer.texture.texture, layer.parameter.encoding(), &at);
        [r, g, b]
    }
}

/// Interpolates texture coordinates of set `set` at `p` in a triangle; the barycentric coordinates are ratios of
/// areas.
fn tex_coords(mesh: &Mesh, set: u32, triangle: u32, p: DVec3) -> [f32; 2] {
    let Some(set) = mesh.tex_coords.get(set as usize) else {
        return [0.0; 2];
    };
    let [a, b, c] = mesh.corners_f64(triangle);
    let across = (b - a).cross(c - a);
    let share = |area: DVec3| area.dot(across) / across.length_squared();
    let (to_b, to_c) = (share((p - a).cross(c - a)), share((b - a).cross(p - a)));
    let [ta, tb, tc] = mesh.triangles[triangle as usize].map(|v| set[v as usize].map(f64::from));
    [0, 1].map(|i| (ta[i] + to_b * (tb[i] - ta[i]) + to_c * (tc[i] - ta[i])) as f32)
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use crate::numeric::{LANES, SplitMix64};
    use crate::scene::{Light, Material};

    #[test]
    fn samples_in_lanes_have_the_bits_of_single_samples() {
        // Build an emissive mesh under a skew transform
        let mesh = Mesh {
            positions: vec![
                [0.0, 0.0, 0.0],
                [1.0, 0.1, 0.0],
                [0.2, 1.3, 0.4],
                [1.1, 0.9, -0.7],
            ]
            .into(),
            triangles: vec![[0, 1, 2], [2, 1, 3], [0, 0, 1]].into(),
            ..Mesh::default()
        };
        let mut material = Material::metallic_roughness([0.5; 3], 0.0, 1.0);
        material.emission = [2.0; 3];
        let place = DAffine3::from_axis_angle(DVec3::ONE.normalize(), 0.7)
            * DAffine3::from_scale(DVec3::new(0.3, 2.0, -1.1));
        let scene = Scene {
            geometries: vec![Geometry::Mesh(mesh)],
            materials: vec![material],
            instances: vec![Instance::new("lamp", 0, 0, place).unwrap()],
            lights: vec![Light {
                name: "lamp".into(),
                intensity: [2.0; 3],
                kind: LightKind::Area {
                    shape: AreaShape::Object { instance: 0 },
                    samples: 1,
                },
            }],
            ..Scene::default()
        };
        let effects = EffectSet::NONE;
        let lights = area_lights(&scene, effects);
        let light = lights[0].as_ref().unwrap();
        let textures = TextureSet::new(&scene);
        // Compare random samples, from points far away and near the surface
        let mut random = SplitMix64::new(5, 1);
        for _ in 0..200 {
            let mut p = [[0.0f32; LANES]; 3];
            let mut u = [[0.0; LANES]; 2];
            for l in 0..LANES {
                (0..3).for_each(|axis| p[axis][l] = (4.0 * random.unit() - 2.0) as f32);
                (0..2).for_each(|number| u[number][l] = random.unit());
            }
            let packet = light.sample_mesh(&p, &u).unwrap();
            for l in 0..LANES {
                let lane = |v: &Lanes3<f64>| DVec3::new(v[0][l], v[1][l], v[2][l]);
                let shaded = DVec3::new(p[0][l].into(), p[1][l].into(), p[2][l].into());
                let Some(sample) = light.sample(&textures, shaded, [u[0][l], u[1][l]]) else {
                    assert_eq!(packet.pdf[l], 0.0);
                    continue;
                };
                assert_eq!(packet.pdf[l].to_bits(), sample.pdf.to_bits());
                assert_eq!(lane(&packet.direction), sample.direction);
                assert_eq!(lane(&packet.position), sample.end);
            }
        }
    }
}
