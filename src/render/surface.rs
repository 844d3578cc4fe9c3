//! From a hit to something to shade: point and normals in f64, from the primitive itself.
//!
//! Backends say which primitive was hit and where on it; everything else is computed here, the same way for all of
//! them, so that they can only disagree about *which* hit. Sixteen lanes are gathered from the meshes and then worked
//! on side by side.

use std::sync::Arc;
use std::time::Instant;

use glam::{DVec3, Vec3};
use multiversion::multiversion;
use serde::{Deserialize, Serialize};

use super::RenderSettings;
use super::gather::{Gathered, MeshView};
use super::meter::Moment;
use super::plan::Plan;
use super::shape_point::world_point;
pub(super) use super::surface_packet::SurfacePacket;
use super::surface_packet::lane;
use super::texturing::{Chart, Widths};
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{
    HitErrorBound, LANES, Lanes3, SpawnPolicy, transform_normal, triangle_spawn_bound, triangle_spawn_error,
};
use crate::scene::{Effect, EffectSet, Geometry, InstanceTransform, Material, Scene};
use crate::shading::ray_cone::triangle_curvature;
use crate::shading::{MaterialPacket, TextureSet};
use crate::shape::Shape;

/// Where on a surface a hit lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HitPoint {
    /// Worked out in f64 from the primitive: of a triangle from its corners, of a shape from its equation.
    #[default]
    Refined,
    /// Along the ray at the f32 parameter that the backend reports, in f32.
    Reported,
}

/// The scene, seen from its hits: one entry an instance.
pub(super) struct SurfaceScene<'s> {
    scene: &'s Scene,
    textures: TextureSet<'s>,
    views: Vec<InstanceView<'s>>,
    pub(super) effects: EffectSet,
    /// By how much rays start off a surface; absent where that is a bound on its error.
    offset: Option<f64>,
    hit_points: HitPoint,
}

pub(super) struct InstanceView<'s> {
    kind: Kind<'s>,
    /// Index into the scene's materials.
    material: u32,
    /// Whether the material is the same at every point: no texture, no vertex colour.
    pub(super) uniform: bool,
    /// Whether object space is elsewhere than world space.
    is_placed: bool,
}

#[derive(Clone)]
enum Kind<'s> {
    /// Shared by all instances of the mesh.
    Mesh(Arc<MeshView<'s>>),
    Shape(&'s Shape),
}

/// Working memory for the surfaces of one packet after another.
pub(super) struct Surfaces {
    gathered: Gathered,
    /// Points and normals.
    pub(super) points: SurfacePacket,
    /// Materials, textures and vertex colours multiplied in.
    pub(super) materials: MaterialPacket,
    /// The instance whose one material `materials` holds in every lane, if it does.
    filled_for: Option<u32>,
    /// When the look-ups of textures began.
    pub(super) texturing: Moment,
}

impl<'s> SurfaceScene<'s> {
    /// The scene with the effects of `plan`.
    pub(super) fn new(scene: &'s Scene, plan: &Plan) -> SurfaceScene<'s> {
        let effects = plan.effects();
        let kinds: Vec<Kind> = scene
            .geometries
            .iter()
            .map(|geometry| Kind::of(geometry, effects))
            .collect();
        let varies = |material: &Material| material.layers.iter().any(|layer| effects.has(layer.effect()));
        // Where it is to be simulated though nothing calls for it, everything counts as varying.
        let forced = plan.forced();
        let everywhere = [Effect::Texture, Effect::NormalMap, Effect::VertexColor]
            .into_iter()
            .any(|effect| forced.has(effect));
        let views = scene.instances.iter().map(|instance| {
            let material = &scene.materials[instance.material as usize];
            let kind = kinds[instance.geometry as usize].clone();
            let colored = matches!(&kind, Kind::Mesh(mesh) if mesh.colors.is_some());
            InstanceView {
                kind,
                material: instance.material,
                uniform: !(colored || varies(material) || everywhere),
                is_placed: !instance.is_identity(),
            }
        });
        SurfaceScene {
            scene,
            textures: TextureSet::of_effects(scene, effects),
            views: views.collect(),
            effects,
            offset: None,
            hit_points: HitPoint::Refined,
        }
    }

    /// The same, which rays leave as these settings say.
    pub(super) fn left_as(self, settings: &RenderSettings) -> SurfaceScene<'s> {
        let size = || {
            let bounds = self.scene.bounds();
            if bounds.is_empty() {
                0.0
            } else {
                bounds.extent().length()
            }
        };
        let offset = match settings.spawn {
            SpawnPolicy::Bounded => None,
            policy => policy.offset(size()),
        };
        SurfaceScene {
            offset,
            hit_points: settings.hit_points,
            ..self
        }
    }

    #[inline(always)]
    pub(super) fn material_of(&self, view: &InstanceView) -> &'s Material {
        &self.scene.materials[view.material as usize]
    }

    /// Works out the surfaces that a traced packet has met.
    pub(super) fn meet(&self, packet: &RayPacket, widths: Widths, surfaces: &mut Surfaces) {
        meet(self, packet, widths, surfaces);
    }

    #[inline(always)]
    fn meet_inlined(&self, packet: &RayPacket, widths: Widths, surfaces: &mut Surfaces) {
        let Surfaces {
            gathered,
            points,
            materials,
            filled_for,
            texturing,
        } = surfaces;
        let common = Common::of(packet);
        let only = common
            .instance
            .and_then(|instance| self.views.get(instance as usize));
        gathered.odd = false;
        match only {
            Some(view) => match (&view.kind, common.primitive) {
                (Kind::Mesh(mesh), Some(primitive)) => {
                    gathered.odd = view.is_odd();
                    mesh.gather_everywhere(primitive, gathered);
                }
                (Kind::Mesh(mesh), None) => {
                    gathered.odd = view.is_odd();
                    mesh.gather_lanes(packet, gathered);
                }
                (Kind::Shape(_), _) => {
                    gathered.odd = true;
                    gathered.smooth = [false; LANES];
                }
            },
            None => self.gather_by_lane(packet, gathered),
        }
        points.offset = self.offset;
        // Once a packet, so that rays by the bound pay for no other rule, nor others for the bound.
        match self.offset {
            None => triangle_surfaces::<true>(packet, gathered, points),
            Some(_) => triangle_surfaces::<false>(packet, gathered, points),
        }
        if gathered.odd {
            self.place_odd_lanes(packet, gathered, points);
        }
        if self.hit_points == HitPoint::Reported {
            points.report(packet);
        }
        points.spawn();
        match only {
            // Lanes without a hit may hold any material.
            Some(view) if view.uniform => {
                if *filled_for != common.instance {
                    materials.fill(self.material_of(view));
                    *filled_for = common.instance;
                }
            }
            _ => {
                *filled_for = None;
                if self.materials_by_lane(packet, materials) {
                    if matches!(texturing, Moment::Wanted) {
                        *texturing = Moment::Read(Instant::now());
                    }
                    self.vary_lanes(packet, widths, points, materials);
                }
            }
        }
    }

    /// The materials of all hits as they are written. Returns whether any varies over its surface.
    fn materials_by_lane(&self, packet: &RayPacket, materials: &mut MaterialPacket) -> bool {
        let mut varies = false;
        materials.set_lanes(|l| {
            if packet.instance[l] == NO_HIT {
                return None;
            }
            let view = &self.views[packet.instance[l] as usize];
            varies |= !view.uniform;
            Some(self.material_of(view))
        });
        varies
    }

    /// Collects what the vector code needs from the meshes, where lanes have hit several instances.
    fn gather_by_lane(&self, packet: &RayPacket, gathered: &mut Gathered) {
        for l in 0..LANES {
            gathered.smooth[l] = false;
            if packet.instance[l] == NO_HIT {
                continue;
            }
            let view = &self.views[packet.instance[l] as usize];
            gathered.odd |= view.is_odd();
            if let Kind::Mesh(mesh) = &view.kind {
                mesh.gather(packet, l, gathered);
            }
        }
    }

    /// Replaces the lanes that are analytic shapes or stand elsewhere than their object space.
    #[cold]
    fn place_odd_lanes(&self, packet: &RayPacket, gathered: &Gathered, surfaces: &mut SurfacePacket) {
        for l in 0..LANES {
            if packet.instance[l] == NO_HIT {
                continue;
            }
            let view = &self.views[packet.instance[l] as usize];
            let pose = self.pose(packet, l);
            let placed = match &view.kind {
                Kind::Mesh(_) if !view.is_placed => continue,
                Kind::Mesh(_) => placed_triangle(packet, gathered, l, &pose),
                Kind::Shape(shape) => placed_shape(packet, l, shape, &pose),
            };
            let wo = lane(&surfaces.wo, l).as_dvec3();
            let front = !(placed.ng.dot(wo) < 0.0);
            let ng = if front { placed.ng } else { -placed.ng };
            surfaces.front[l] = front;
            surfaces.exact_normal[l] = ng;
            let mut ns = placed.ns.unwrap_or(ng);
            if ns.dot(ng) < 0.0 {
                ns = -ns;
            }
            if !(ns.dot(wo) > 0.0) {
                ns = ng;
            }
            for axis in 0..3 {
                surfaces.p[axis][l] = placed.p[axis];
                surfaces.ng[axis][l] = ng[axis] as f32;
                surfaces.ns[axis][l] = ns[axis] as f32;
            }
            surfaces.error[l] = placed.error.along(ng);
        }
    }

    /// The unit normal of a hit that counts for optics, on the side that the ray came from: interpolated where the mesh
    /// has normals, otherwise to f64 accuracy.
    pub(super) fn interface_normal(&self, packet: &RayPacket, surfaces: &Surfaces, l: usize) -> DVec3 {
        let points = &surfaces.points;
        let shading = lane(&points.ns, l).as_dvec3().normalize();
        if surfaces.gathered.smooth[l] || points.ns_differs(l) {
            return shading;
        }
        if self.views[packet.instance[l] as usize].is_odd() {
            return points.exact_normal[l];
        }
        let [a, b, c] = std::array::from_fn(|corner| lane(&surfaces.gathered.corners[corner], l).as_dvec3());
        let n = (b - a).cross(c - a).normalize();
        if n.dot(shading) < 0.0 { -n } else { n }
    }

    /// The mean curvature of the surface at lane `l`, positive where it bulges to the side that the ray came from; 0
    /// where it is flat, or not known.
    pub(super) fn curvature(&self, packet: &RayPacket, surfaces: &Surfaces, l: usize) -> f64 {
        let view = &self.views[packet.instance[l] as usize];
        let map = self.pose(packet, l).world_from_object();
        let scale = map.matrix3.determinant().abs().cbrt();
        let outside = match &view.kind {
            Kind::Shape(Shape::Sphere(sphere)) => 1.0 / (sphere.radius * scale),
            Kind::Mesh(_) if surfaces.gathered.smooth[l] => {
                let wide = |lanes: &Lanes3<f32>| lane(lanes, l).as_dvec3();
                let corners = surfaces.gathered.corners.each_ref().map(wide);
                let normals = surfaces.gathered.normals.each_ref().map(wide);
                triangle_curvature(corners, normals.map(DVec3::normalize_or_zero)) / scale
            }
            _ => 0.0,
        };
        if surfaces.points.front[l] {
            outside
        } else {
            -outside
        }
    }

    /// Where the instance stands that lane `l` has hit, at the time of the ray.
    pub(super) fn pose(&self, packet: &RayPacket, l: usize) -> InstanceTransform<'_> {
        self.scene.instances[packet.instance[l] as usize].pose(packet.time[l])
    }

    /// The instance of a hit, as it is shaded.
    pub(super) fn view(&self, instance: u32) -> &InstanceView<'_> {
        &self.views[instance as usize]
    }

    /// The scene's textures, made ready.
    pub(super) fn textures(&self) -> &TextureSet<'_> {
        &self.textures
    }
}

impl InstanceView<'_> {
    /// Whether its hits are no plain triangles in world space.
    fn is_odd(&self) -> bool {
        self.is_placed || matches!(self.kind, Kind::Shape(_))
    }

    /// Texture coordinates of a hit and the point's derivatives by them, in world space; zero where there are none.
    pub(super) fn chart(&self, pose: &InstanceTransform, set: u32, packet: &RayPacket, l: usize) -> Chart {
        match &self.kind {
            Kind::Mesh(mesh) => match mesh.tex_coords.get(set as usize) {
                Some(set) => {
                    let linear = pose.world_from_object().matrix3;
                    Chart {
                        uv: mesh.interpolate(set, packet, l),
                        derivatives: mesh.derivatives(set, packet.primitive[l]).map(|d| linear * d),
                    }
                }
                None => Chart {
                    uv: [0.0; 2],
                    derivatives: [DVec3::ZERO; 2],
                },
            },
            Kind::Shape(shape) => {
                let point = world_point(pose, shape, &packet.ray(l), packet.primitive[l]);
                Chart {
                    uv: point.uv.map(|x| x as f32),
                    derivatives: [point.dpdu, point.dpdv],
                }
            }
        }
    }

    /// The interpolated tangent of the mesh at a hit, in object space, with its handedness.
    pub(super) fn tangent(&self, packet: &RayPacket, l: usize) -> Option<[f32; 4]> {
        match &self.kind {
            Kind::Mesh(mesh) => mesh
                .tangents
                .map(|tangents| mesh.interpolate(tangents, packet, l)),
            Kind::Shape(_) => None,
        }
    }

    pub(super) fn vertex_color(&self, packet: &RayPacket, l: usize) -> Option<[f32; 4]> {
        match &self.kind {
            Kind::Mesh(mesh) => mesh.colors.map(|colors| mesh.interpolate(colors, packet, l)),
            Kind::Shape(_) => None,
        }
    }
}

impl<'s> Kind<'s> {
    fn of(geometry: &'s Geometry, effects: EffectSet) -> Kind<'s> {
        match geometry {
            Geometry::Mesh(mesh) => Kind::Mesh(Arc::new(MeshView::of(mesh, effects))),
            Geometry::Shape(shape) => Kind::Shape(shape),
        }
    }
}

impl Surfaces {
    pub(super) fn new(effects: EffectSet) -> Surfaces {
        Surfaces {
            gathered: Gathered::new(),
            points: SurfacePacket::new(),
            materials: MaterialPacket {
                effects,
                ..MaterialPacket::BLACK
            },
            filled_for: None,
            texturing: Moment::Unknown,
        }
    }
}

/// [`SurfaceScene::meet`], for the processor at hand.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn meet(scene: &SurfaceScene, packet: &RayPacket, widths: Widths, surfaces: &mut Surfaces) {
    scene.meet_inlined(packet, widths, surfaces);
}

/// What all hit lanes of a packet share.
struct Common {
    /// Their instance, if it is one.
    instance: Option<u32>,
    /// Their primitive, if it is one.
    primitive: Option<u32>,
}

impl Common {
    #[inline(always)]
    fn of(packet: &RayPacket) -> Common {
        let [instances, primitives] = ranges(packet);
        let one = |[low, high]: [u32; 2]| (low == high).then_some(low);
        Common {
            instance: one(instances),
            primitive: one(primitives),
        }
    }
}

/// The lowest and the highest instance, and primitive, among the hit lanes.
#[inline(always)]
fn ranges(packet: &RayPacket) -> [[u32; 2]; 2] {
    let mut ranges = [[NO_HIT, 0]; 2];
    for (numbers, range) in [&packet.instance, &packet.primitive].into_iter().zip(&mut ranges) {
        let [mut low, mut high] = *range;
        for l in 0..LANES {
            let hit = packet.instance[l] != NO_HIT;
            low = low.min(if hit { numbers[l] } else { NO_HIT });
            high = high.max(if hit { numbers[l] } else { 0 });
        }
        *range = [low, high];
    }
    ranges
}

/// Points and normals of triangles that are stored in world space, all lanes at once.
#[inline(always)]
fn triangle_surfaces<const BOUNDED: bool>(
    packet: &RayPacket,
    gathered: &Gathered,
    surfaces: &mut SurfacePacket,
) {
    let [a, b, c] = &gathered.corners;
    let [na, nb, nc] = &gathered.normals;
    let d = &packet.direction;
    for l in 0..LANES {
        surfaces.hit[l] = packet.instance[l] != NO_HIT;
    }
    for l in 0..LANES {
        let length = (d[0][l] * d[0][l] + d[1][l] * d[1][l] + d[2][l] * d[2][l]).sqrt();
        let scale = -1.0 / length;
        for axis in 0..3 {
            surfaces.wo[axis][l] = d[axis][l] * scale;
        }
    }
    let mut across = [[0.0; LANES]; 3];
    for l in 0..LANES {
        let wide = |v: &Lanes3<f32>| DVec3::new(v[0][l].into(), v[1][l].into(), v[2][l].into());
        let v0 = wide(a);
        let (e1, e2) = (wide(b) - v0, wide(c) - v0);
        let p = v0 + f64::from(packet.u[l]) * e1 + f64::from(packet.v[l]) * e2;
        let n = brought_near_one(e1.cross(e2));
        for axis in 0..3 {
            surfaces.p[axis][l] = p[axis];
            across[axis][l] = n[axis];
        }
    }
    for l in 0..LANES {
        let (n, wo) = (lane(&across, l), lane(&surfaces.wo, l));
        let front = !(n.dot(wo) < 0.0);
        surfaces.front[l] = front;
        let facing = if front { 1.0 } else { -1.0 };
        let ng = n * (facing / n.dot(n).sqrt());
        if BOUNDED {
            let v0 = lane(a, l);
            let bound = triangle_spawn_bound(v0, lane(b, l) - v0, lane(c, l) - v0);
            surfaces.error[l] = bound.dot(ng.abs()).into();
        }
        let (u, v) = (packet.u[l], packet.v[l]);
        let w = 1.0 - u - v;
        let mut ns = [0.0; 3];
        for axis in 0..3 {
            surfaces.ng[axis][l] = ng[axis];
            ns[axis] = w * na[axis][l] + u * nb[axis][l] + v * nc[axis][l];
        }
        let squared = ns[0] * ns[0] + ns[1] * ns[1] + ns[2] * ns[2];
        let side = ns[0] * ng[0] + ns[1] * ng[1] + ns[2] * ng[2];
        let scale = if side < 0.0 { -1.0 } else { 1.0 } / squared.sqrt();
        let seen =
            (ns[0] * surfaces.wo[0][l] + ns[1] * surfaces.wo[1][l] + ns[2] * surfaces.wo[2][l]) * scale;
        // Zero normals give NaN or infinity here, and compare false.
        let smooth = gathered.smooth[l] & (seen > 0.0) & (squared > 0.0) & (squared < f32::INFINITY);
        for axis in 0..3 {
            surfaces.ns[axis][l] = if smooth { ns[axis] * scale } else { ng[axis] };
        }
    }
}

/// `n` times an exact power of two that brings it to a length near 1, whose square no f32 loses, however small the
/// triangle.
#[inline(always)]
fn brought_near_one(n: DVec3) -> Vec3 {
    const EXPONENT: u64 = 0x7ff0_0000_0000_0000;
    const DOUBLED_BIAS: u64 = 2046 << 52;
    let exponent = n.abs().max_element().to_bits() & EXPONENT;
    (n * f64::from_bits(DOUBLED_BIAS.wrapping_sub(exponent))).as_vec3()
}

/// One lane, worked out in world space; normals on either side.
struct Placed {
    p: DVec3,
    ng: DVec3,
    ns: Option<DVec3>,
    error: HitErrorBound,
}

fn placed_triangle(packet: &RayPacket, gathered: &Gathered, l: usize, pose: &InstanceTransform) -> Placed {
    let [a, b, c] = std::array::from_fn(|corner| lane(&gathered.corners[corner], l).as_dvec3());
    let (e1, e2) = (b - a, c - a);
    let (u, v) = (f64::from(packet.u[l]), f64::from(packet.v[l]));
    let map = pose.world_from_object();
    let p = map.transform_point3(a + u * e1 + v * e2);
    let ns = gathered.smooth[l].then(|| {
        let [na, nb, nc] = std::array::from_fn(|corner| lane(&gathered.normals[corner], l).as_dvec3());
        transform_normal(&map.matrix3, (1.0 - u - v) * na + u * nb + v * nc)
    });
    Placed {
        p,
        ng: transform_normal(&map.matrix3, e1.cross(e2).normalize_or_zero()),
        ns: ns.filter(|n| *n != DVec3::ZERO),
        error: triangle_spawn_error(a.as_vec3(), e1.as_vec3(), e2.as_vec3()).transformed(
            &map,
            &pose.object_from_world(),
            p,
        ),
    }
}

fn placed_shape(packet: &RayPacket, l: usize, shape: &Shape, pose: &InstanceTransform) -> Placed {
    let point = world_point(pose, shape, &packet.ray(l), packet.primitive[l]);
    Placed {
        p: point.p,
        ng: point.n,
        ns: None,
        error: point.error,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_instance_takes_the_renderer_at_most_24_bytes() {
        assert!(size_of::<InstanceView>() <= 24, "{}", size_of::<InstanceView>());
    }
}
