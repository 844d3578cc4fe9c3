//! Area lights of a scene, prepared for sampling, including emissive objects.
//!
//! Other area lights are invisible and cannot be hit by shadow rays. The surface of an emissive object exists in the
//! scene: a shadow ray to a point on it must neither hit that surface at its end nor miss an occluder close to it.
//! The shadow ray therefore ends off the surface, on its own side, by a bound on the rounding errors of both: that of
//! a ray which leaves the surface there ([`HitErrorBound`]) and that of a traversal over the length of the shadow
//! ray. A convex emissive object thus never occludes its own points, and a concave one does so where it should.

use glam::{DMat3, DVec3};

use crate::mesh::Mesh;
use crate::numeric::{HitErrorBound, Lanes, Lanes3, triangle_spawn_error};
use crate::scene::{
    AreaShape, Effect, EffectSet, Geometry, Instance, LightKind, LightSamplePacket, LightView, MaterialInput,
    Scene, TextureBinding,
};
use crate::shading::{AreaLight, DiskLight, LightSample, QuadLight, SphereLight, TexturePoint, TextureSet};
use crate::shape::Implicit;

/// Relative bound on the rounding errors of a traversal in f32: on how far they move the end of a shadow ray and the
/// surface that it ends at, relative to the length of the ray along each axis of object space.
///
/// It counts 2^-24 for each of: the direction; the vertices minus the origin; three products and two sums each of the
/// distance from a plane and of the approach to it; their quotient; and three each for the instance transform of
/// origin and direction.
const SHADOW_RAY_ERROR: f64 = 19.0 / (1 << 24) as f64;

/// Area light of a scene, prepared for sampling.
pub(in crate::render) struct AreaLightSampler<'s> {
    shape: AreaLight,
    emissive_object: Option<EmissiveObject<'s>>,
}

/// Emissive object behind an area light.
struct EmissiveObject<'s> {
    geometry: &'s Geometry,
    instance: &'s Instance,
    /// Texture of the emission, if there is one and textures are simulated.
    texture: Option<&'s TextureBinding>,
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

    /// Returns the density per steradian with which [`AreaLightSampler::sample`] chooses for `p` the direction to
    /// `position`, a point of the light with the unit `normal`; 0 where it has none.
    pub(in crate::render) fn pdf(&self, p: DVec3, position: DVec3, normal: DVec3) -> f64 {
        self.shape.pdf(p, position, normal)
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
        EmissiveObject {
            geometry: &scene.geometries[instance.geometry as usize],
            instance,
            texture: material
                .layer(MaterialInput::Emission)
                .filter(|_| effects.has(Effect::Texture)),
        }
    }

    /// Returns the end of a shadow ray to a point of the object: offset from the surface, on the side that the ray
    /// comes from.
    fn end(&self, sample: &LightSample, p_object: DVec3) -> DVec3 {
        let (map, inverse) = (
            self.instance.world_from_object(),
            self.instance.object_from_world(),
        );
        // Bound the error of rays that leave the surface
        let on_surface = match self.geometry {
            Geometry::Mesh(mesh) => {
                let [a, b, c] = mesh.corners(sample.primitive);
                triangle_spawn_error(a, b - a, c - a)
            }
            Geometry::Shape(shape) => shape.point(p_object, sample.primitive).error,
            Geometry::Points(cloud) => cloud.shape(sample.primitive).point(p_object, 0).error,
        };
        // Add the error of the traversal over the ray's length
        let way = (sample.distance * sample.direction).abs();
        let in_object = SHADOW_RAY_ERROR * (abs(&inverse.matrix3) * way);
        let error = HitErrorBound(on_surface.0 + in_object).transformed(&map, &inverse, sample.position);
        let n = if sample.is_front() {
            sample.normal
        } else {
            -sample.normal
        };
        sample.position + error.along(n) * n
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

fn abs(map: &DMat3) -> DMat3 {
    DMat3::from_cols(map.x_axis.abs(), map.y_axis.abs(), map.z_axis.abs())
}
