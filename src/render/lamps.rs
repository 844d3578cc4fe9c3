//! Lights with an extent as a frame asks them; among them lamps, which are objects.
//!
//! Other lights are not seen, and have nothing that a shadow ray could meet. A lamp's surface is there, and the shadow
//! ray to a point of it must neither meet that surface at its end nor miss what lies close before it. So it ends off the
//! surface, on the side that it comes from, by a bound on the rounding of both: that of a ray which leaves the surface
//! there ([`HitErrorBound`]) and that of a traversal over the shadow ray's length. A convex lamp thus never hides its
//! points, and a dented one where it does.

use glam::{DMat3, DVec3};

use crate::mesh::Mesh;
use crate::numeric::{HitErrorBound, triangle_spawn_error};
use crate::scene::{
    AreaShape, Effect, EffectSet, Geometry, Instance, LightKind, MaterialInput, Scene, TextureBinding,
};
use crate::shading::{AreaLight, DiskLight, LightSample, QuadLight, SphereLight, TexturePoint, TextureSet};
use crate::shape::Implicit;

/// What the roundings of a traversal in f32 move a shadow ray's end by, and the surface that it ends at, relative to its
/// length along each axis of object space: 2^-24 for the direction, for the corners less the origin, for each of three
/// products and two sums of the distance from a plane and of the approach to it, and for their quotient; and three each
/// for what a placement makes of origin and direction.
const SHADOW_RAY_ERROR: f64 = 19.0 / (1 << 24) as f64;

/// A light with an extent.
pub(super) struct SoftLight<'s> {
    shape: AreaLight,
    lamp: Option<Lamp<'s>>,
}

/// The object that a lamp is.
struct Lamp<'s> {
    geometry: &'s Geometry,
    instance: &'s Instance,
    /// The texture on its emission, if there is one and it counts.
    texture: Option<&'s TextureBinding>,
}

/// A point of a light, for a point that asks.
pub(super) struct SoftSample {
    /// Unit vector to there.
    pub(super) direction: DVec3,
    /// Where a shadow ray to there ends.
    pub(super) end: DVec3,
    /// Density of the direction per steradian.
    pub(super) pdf: f64,
    /// What the light's radiance is multiplied by there, linear RGB.
    pub(super) tint: [f32; 3],
}

/// Those of a scene, one a light; `None` for lights without an extent.
pub(super) fn soft_lights(scene: &Scene, effects: EffectSet) -> Vec<Option<SoftLight<'_>>> {
    let with_extent = |kind: &LightKind| match kind {
        LightKind::Area { shape, .. } => SoftLight::of(scene, shape, effects),
        _ => None,
    };
    scene
        .lights
        .iter()
        .map(|light| with_extent(&light.kind))
        .collect()
}

impl<'s> SoftLight<'s> {
    fn of(scene: &'s Scene, shape: &AreaShape, effects: EffectSet) -> Option<SoftLight<'s>> {
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
                let shape = scene.lamp_surface(instance).ok()?;
                let lamp = Some(Lamp::of(scene, &scene.instances[instance as usize], effects));
                return Some(SoftLight { shape, lamp });
            }
        };
        shape.map(|shape| SoftLight { shape, lamp: None })
    }

    /// Whether rays can meet it.
    pub(super) fn is_seen(&self) -> bool {
        self.lamp.is_some()
    }

    /// The point that `u` picks for `p`, if the light turns a side that shines to there. For a light that is seen, `p`
    /// must lie off the surface of whatever is there, the light's own too, on the side that asks.
    pub(super) fn sample(&self, textures: &TextureSet, p: DVec3, u: [f64; 2]) -> Option<SoftSample> {
        let sample = self.shape.sample(p, u)?;
        let (end, tint) = match &self.lamp {
            None if !sample.is_front() => return None,
            None => (sample.position, [1.0; 3]),
            Some(lamp) => {
                let p_object = lamp
                    .instance
                    .object_from_world()
                    .transform_point3(sample.position);
                (
                    lamp.end(&sample, p_object),
                    lamp.tint(textures, &sample, p_object),
                )
            }
        };
        Some(SoftSample {
            direction: sample.direction,
            end,
            pdf: sample.pdf,
            tint,
        })
    }
}

impl<'s> Lamp<'s> {
    fn of(scene: &'s Scene, instance: &'s Instance, effects: EffectSet) -> Lamp<'s> {
        let material = &scene.materials[instance.material as usize];
        Lamp {
            geometry: &scene.geometries[instance.geometry as usize],
            instance,
            texture: material
                .layer(MaterialInput::Emission)
                .filter(|_| effects.has(Effect::Texture)),
        }
    }

    /// Where a shadow ray to a point of the lamp ends: off the surface, to the side that it comes from.
    fn end(&self, sample: &LightSample, p_object: DVec3) -> DVec3 {
        let (map, inverse) = (
            self.instance.world_from_object(),
            self.instance.object_from_world(),
        );
        let on_surface = match self.geometry {
            Geometry::Mesh(mesh) => {
                let [a, b, c] = mesh.corners(sample.primitive);
                triangle_spawn_error(a, b - a, c - a)
            }
            Geometry::Shape(shape) => shape.point(p_object, sample.primitive).error,
        };
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

    /// What the texture on its emission, if there is one, makes of that.
    fn tint(&self, textures: &TextureSet, sample: &LightSample, p_object: DVec3) -> [f32; 3] {
        let Some(layer) = self.texture else {
            return [1.0; 3];
        };
        let uv = match self.geometry {
            Geometry::Mesh(mesh) => tex_coords(mesh, layer.texture.tex_coord, sample.primitive, p_object),
            Geometry::Shape(shape) => shape.point(p_object, sample.primitive).uv.map(|x| x as f32),
        };
        let at = TexturePoint::sharp(layer.texture.transform.apply(uv), p_object);
        let [r, g, b, _] = textures.sample(layer.texture.texture, layer.parameter.encoding(), &at);
        [r, g, b]
    }
}

/// Texture coordinates of set `set` at `p` in a triangle; its shares of the corners are those of the areas against
/// them.
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
