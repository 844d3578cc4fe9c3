//! Surface interactions: points and normals of hits, computed in f64 from the primitive.
//!
//! Backends report the primitive that was hit and the position on it. All else is computed here by the same code for
//! all backends, so that they can disagree only about *which* primitive is hit. Vertices of sixteen lanes are
//! gathered from the meshes and then processed with SIMD.

use std::time::Instant;

use glam::{DVec3, Vec3};
use multiversion::multiversion;

use super::super::plan::Plan;
use super::super::profile::Moment;
use super::super::settings::{HitPoint, RenderSettings};
use super::cone_source::ConeSource;
use super::instance_view::{InstanceView, InteractionKind, needs_uv_frames};
use super::packet::{SurfacePacket, lane};
use super::placed_packet::{PlacedHits, ViewedInstances, compute_placed_hits};
use super::texture_eval::{TextureLanes, TexturedHits, evaluate_textures};
use super::vertex_fetch::FetchedVertices;
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, SpawnPolicy, triangle_spawn_bound};
use crate::scene::{Effect, EffectSet, Instance, InstanceTransform, Material, Scene};
use crate::shading::{MaterialPacket, TextureSet};
use crate::shape::{Shape, vector};

/// Scene data needed to shade hits, with one entry per instance.
pub(in crate::render) struct SurfaceScene<'s> {
    scene: &'s Scene,
    textures: TextureSet<'s>,
    views: Vec<InstanceView<'s>>,
    /// True if the cones of rays that leave a surface depend on its curvature.
    needs_curvatures: bool,
    /// Mean scales of the transforms of instances, which curvatures depend on; NaN for moving ones. Empty where no
    /// curvatures are needed.
    mean_scales: Vec<f32>,
    pub(in crate::render) effects: EffectSet,
    /// Offset of ray origins from a surface; `None` if each point uses a bound on its error.
    offset: Option<f64>,
    hit_points: HitPoint,
}

/// Working memory for the surface interactions of a packet, reused from packet to packet.
pub(in crate::render) struct Surfaces {
    gathered: FetchedVertices,
    /// Working memory for hits on analytic shapes and transformed instances.
    placed: Box<PlacedHits>,
    /// Hit points and normals of the lanes.
    pub(in crate::render) points: SurfacePacket,
    /// Materials of the lanes, after textures and vertex colours.
    pub(in crate::render) materials: MaterialPacket,
    /// Instance whose uniform material fills every lane of `materials`, if there is one.
    filled_for: Option<u32>,
    textures: Box<TextureLanes>,
    /// Mean curvatures of the surfaces, positive where they are convex on the side of the incident ray; 0 where the
    /// surface is flat or its curvature is unknown, and where no ray cone depends on it.
    pub(in crate::render) curvatures: Lanes<f64>,
    /// Time at which texture look-ups began.
    pub(in crate::render) texturing: Moment,
}

impl<'s> SurfaceScene<'s> {
    /// Prepares `scene` for the effects of `plan`.
    pub(in crate::render) fn new(scene: &'s Scene, plan: &Plan) -> SurfaceScene<'s> {
        let effects = plan.effects();
        // Create views of the geometries, which instances share
        let kinds: Vec<InteractionKind> = scene
            .geometries
            .iter()
            .map(|geometry| InteractionKind::of(geometry, effects))
            .collect();
        let varies = |material: &Material| material.layers.iter().any(|layer| effects.has(layer.effect()));
        // A texture effect that is forced on without need treats every material as varying.
        let forced = plan.forced();
        let everywhere = [Effect::Texture, Effect::NormalMap, Effect::VertexColor]
            .into_iter()
            .any(|effect| forced.has(effect));
        // Create one view per instance
        let views = scene.instances.iter().map(|instance| {
            let material = &scene.materials[instance.material as usize];
            let kind = kinds[instance.geometry as usize].clone();
            let is_oriented = effects.has(Effect::Anisotropy) && material.anisotropic().is_some();
            let colored = kind.has_colors();
            let uniform = !(colored || is_oriented || varies(material) || everywhere);
            let looks_up = is_oriented || needs_uv_frames(material, scene, effects);
            InstanceView {
                needs_uv_frames: looks_up && kind.is_shape(),
                kind,
                material: instance.material,
                uniform,
                is_placed: !instance.is_identity(),
            }
        });
        let needs_curvatures = effects.tracks_cones();
        let mean_scales = scene.instances.iter().map(|instance| match instance.is_moving() {
            true => f32::NAN,
            false => mean_scale(&instance.pose(0.0)) as f32,
        });
        SurfaceScene {
            scene,
            textures: TextureSet::of_effects(scene, effects),
            views: views.collect(),
            needs_curvatures,
            mean_scales: if needs_curvatures {
                mean_scales.collect()
            } else {
                Vec::new()
            },
            effects,
            offset: None,
            hit_points: HitPoint::Refined,
        }
    }

    /// Returns the scene with the spawn policy and the hit-point rule of `settings`.
    pub(in crate::render) fn with_spawn_policy(self, settings: &RenderSettings) -> SurfaceScene<'s> {
        let size = || {
            let bounds = self.scene.bounds();
            if bounds.is_empty() {
                0.0
            } else {
                bounds.extent().length()
            }
        };
        // Spawn points by error bounds need no offset; other policies depend on the size of the scene
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
    pub(in crate::render) fn material_of(&self, view: &InstanceView) -> &'s Material {
        &self.scene.materials[view.material as usize]
    }

    /// Computes the surface interactions of a traced packet.
    pub(in crate::render) fn compute_interactions(
        &self,
        packet: &RayPacket,
        widths: ConeSource,
        surfaces: &mut Surfaces,
    ) {
        compute_interactions(self, packet, widths, surfaces);
    }

    #[inline(always)]
    fn compute_interactions_inlined(&self, packet: &RayPacket, widths: ConeSource, surfaces: &mut Surfaces) {
        let Surfaces {
            gathered,
            placed,
            points,
            materials,
            filled_for,
            texturing,
            textures,
            curvatures,
        } = surfaces;
        // Fetch vertices, as a whole if all lanes share an instance
        let common = Common::of(packet);
        let only = common
            .instance
            .and_then(|instance| self.views.get(instance as usize));
        gathered.needs_object_space = false;
        gathered.has_world_triangles = only.is_some_and(|view| !view.needs_object_space());
        match only {
            Some(view) => match (&view.kind, common.primitive) {
                (InteractionKind::Mesh(mesh), Some(primitive)) => {
                    gathered.needs_object_space = view.needs_object_space();
                    mesh.gather_everywhere(primitive, gathered);
                }
                (InteractionKind::Mesh(mesh), None) => {
                    gathered.needs_object_space = view.needs_object_space();
                    mesh.gather_lanes(packet, gathered);
                }
                (InteractionKind::Shape(_) | InteractionKind::Points(_), _) => {
                    gathered.needs_object_space = true;
                    gathered.smooth = [false; LANES];
                }
            },
            None => self.gather_by_lane(packet, gathered),
        }
        points.offset = self.offset;
        points.face_rays(packet);
        // Compute points and normals of world-space triangles; the rules are compiled separately, so that neither
        // pays for the other.
        match self.offset {
            _ if !gathered.has_world_triangles => {}
            None => triangle_surfaces::<true>(packet, gathered, points),
            Some(_) => triangle_surfaces::<false>(packet, gathered, points),
        }
        // Compute lanes of analytic shapes and transformed instances
        if gathered.needs_object_space {
            let scene = ViewedInstances {
                instances: &self.scene.instances,
                views: &self.views,
                only: common.instance.filter(|_| only.is_some()),
            };
            compute_placed_hits(&scene, (packet, gathered), placed, points);
        }
        // Apply the hit-point rule and compute ray origins
        if self.hit_points == HitPoint::Reported {
            points.report(packet);
        }
        points.spawn();
        if self.needs_curvatures {
            self.compute_curvatures(packet, (gathered, points), curvatures);
        }
        if let Some(layers) = &mut materials.layers {
            layers.coat_normal = points.ns;
        }
        // Evaluate materials, reusing a uniform one from the last packet
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
                let varies = match only {
                    Some(view) => {
                        materials.fill(self.material_of(view));
                        true
                    }
                    None => self.materials_by_lane(packet, materials),
                };
                if varies {
                    if matches!(texturing, Moment::Wanted) {
                        *texturing = Moment::Read(Instant::now());
                    }
                    let hits = TexturedHits {
                        packet,
                        widths,
                        gathered,
                    };
                    evaluate_textures(self, hits, points, materials, textures);
                }
            }
        }
    }

    /// Sets the materials of all hits before texturing. Returns whether any of them varies over its surface.
    // Not inlined, so that the steps that all packets take keep their registers.
    #[inline(never)]
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

    /// Gathers the vertices of the meshes lane by lane, for packets whose lanes hit several instances.
    fn gather_by_lane(&self, packet: &RayPacket, gathered: &mut FetchedVertices) {
        for l in 0..LANES {
            gathered.smooth[l] = false;
            if packet.instance[l] == NO_HIT {
                continue;
            }
            let view = &self.views[packet.instance[l] as usize];
            gathered.needs_object_space |= view.needs_object_space();
            gathered.has_world_triangles |= !view.needs_object_space();
            if let InteractionKind::Mesh(mesh) = &view.kind {
                mesh.gather(packet, l, gathered);
            }
        }
    }

    /// Returns the unit normal for reflection and refraction, on the side of the incident ray: interpolated if the
    /// mesh has vertex normals, otherwise the geometric normal to f64 accuracy.
    pub(in crate::render) fn interface_normal(
        &self,
        packet: &RayPacket,
        surfaces: &Surfaces,
        l: usize,
    ) -> DVec3 {
        let points = &surfaces.points;
        let shading = lane(&points.ns, l).as_dvec3().normalize();
        if surfaces.gathered.smooth[l] || points.ns_differs(l) {
            return shading;
        }
        if self.views[packet.instance[l] as usize].needs_object_space() {
            return vector(&points.exact_normal, l);
        }
        // Compute the geometric normal of a flat world-space triangle in f64
        let [a, b, c] = std::array::from_fn(|corner| lane(&surfaces.gathered.corners[corner], l).as_dvec3());
        let n = (b - a).cross(c - a).normalize();
        if n.dot(shading) < 0.0 { -n } else { n }
    }

    /// Computes the mean curvatures of the surfaces at the hits.
    #[inline(always)]
    fn compute_curvatures(
        &self,
        packet: &RayPacket,
        (gathered, points): (&FetchedVertices, &SurfacePacket),
        curvatures: &mut Lanes<f64>,
    ) {
        *curvatures = if gathered.smooth.contains(&true) {
            gathered.curvatures()
        } else {
            [0.0; LANES]
        };
        for l in 0..LANES {
            if packet.instance[l] == NO_HIT {
                continue;
            }
            let view = &self.views[packet.instance[l] as usize];
            let in_object = match &view.kind {
                InteractionKind::Shape(Shape::Sphere(sphere)) => 1.0 / sphere.radius,
                InteractionKind::Points(points) => 1.0 / points.cloud.radius,
                InteractionKind::Mesh(_) if gathered.smooth[l] => curvatures[l],
                _ => 0.0,
            };
            // Curvature is an inverse length, so divide by the mean scale of the transform
            let outside = in_object / self.mean_scale(packet, l);
            curvatures[l] = if points.front[l] { outside } else { -outside };
        }
    }

    /// Returns the mean scale of the transform of the instance that lane `l` hit.
    fn mean_scale(&self, packet: &RayPacket, l: usize) -> f64 {
        match self.mean_scales.get(packet.instance[l] as usize) {
            Some(scale) if scale.is_finite() => f64::from(*scale),
            _ => mean_scale(&self.pose(packet, l)),
        }
    }

    /// Returns the transform of the instance that lane `l` hit, at the time of the ray.
    pub(in crate::render) fn pose(&self, packet: &RayPacket, l: usize) -> InstanceTransform<'_> {
        self.scene.instances[packet.instance[l] as usize].pose(packet.time[l])
    }

    /// Returns the instances of the scene.
    pub(super) fn instances(&self) -> &[Instance] {
        &self.scene.instances
    }

    /// Returns the shading data of an instance.
    pub(in crate::render) fn view(&self, instance: u32) -> &InstanceView<'_> {
        &self.views[instance as usize]
    }

    /// Returns whether object space differs from world space for an instance.
    #[inline(always)]
    pub(super) fn is_placed(&self, instance: u32) -> bool {
        self.views
            .get(instance as usize)
            .is_some_and(|view| view.is_placed)
    }

    /// Returns the textures of the scene, prepared for look-up.
    pub(in crate::render) fn textures(&self) -> &TextureSet<'_> {
        &self.textures
    }
}

impl Surfaces {
    pub(in crate::render) fn new(effects: EffectSet) -> Surfaces {
        Surfaces {
            gathered: FetchedVertices::new(),
            placed: Box::new(PlacedHits::ZERO),
            points: SurfacePacket::new(),
            materials: MaterialPacket::of_effects(effects),
            filled_for: None,
            textures: Box::new(TextureLanes::new()),
            curvatures: [0.0; LANES],
            texturing: Moment::Unknown,
        }
    }

    /// Scales the emission of lane `l`. The next packet does not reuse the materials of this one.
    pub(in crate::render) fn scale_emission(&mut self, l: usize, factor: f32) {
        (0..3).for_each(|c| self.materials.emission[c][l] *= factor);
        self.filled_for = None;
    }

    /// Sets points and materials to those of a layer above `base` with the shading normals `ns`.
    pub(in crate::render) fn set_layer(
        &mut self,
        base: &Surfaces,
        ns: Lanes3<f32>,
        materials: MaterialPacket,
    ) {
        self.points = base.points.clone();
        self.points.ns = ns;
        self.materials = materials;
        self.curvatures = base.curvatures;
    }
}

/// Compiles [`SurfaceScene::compute_interactions`] for several instruction sets.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn compute_interactions(
    scene: &SurfaceScene,
    packet: &RayPacket,
    widths: ConeSource,
    surfaces: &mut Surfaces,
) {
    scene.compute_interactions_inlined(packet, widths, surfaces);
}

/// Returns the cube root of the factor by which a transform changes volumes.
fn mean_scale(pose: &InstanceTransform) -> f64 {
    pose.world_from_object().matrix3.determinant().abs().cbrt()
}

/// Instance and primitive that all hit lanes of a packet have in common.
struct Common {
    /// Instance of all hit lanes, if they agree.
    instance: Option<u32>,
    /// Primitive of all hit lanes, if they agree.
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

/// Returns the smallest and the largest instance index, and primitive index, among the hit lanes.
// Compiled by itself, as its caller would compare lane by lane with what it knows of each.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
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

/// Computes points and normals of all lanes, for triangles that are stored in world space.
#[inline(always)]
fn triangle_surfaces<const BOUNDED: bool>(
    packet: &RayPacket,
    gathered: &FetchedVertices,
    surfaces: &mut SurfacePacket,
) {
    let [a, b, c] = &gathered.corners;
    let [na, nb, nc] = &gathered.normals;
    // Compute points and unnormalized geometric normals in f64
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
    // Turn geometric normals towards the ray and bound the error of points
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
        // Interpolate shading normals
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

/// Returns `n` times an exact power of two that brings its length near 1, so that its square neither underflows nor
/// overflows in f32, however small the triangle is.
#[inline(always)]
fn brought_near_one(n: DVec3) -> Vec3 {
    const EXPONENT: u64 = 0x7ff0_0000_0000_0000;
    const DOUBLED_BIAS: u64 = 2046 << 52;
    // Clear all but the exponent of the largest component, and multiply by its reciprocal
    let exponent = n.abs().max_element().to_bits() & EXPONENT;
    (n * f64::from_bits(DOUBLED_BIAS.wrapping_sub(exponent))).as_vec3()
}
