//! Texture evaluation: applies textures and vertex colours to material inputs, alpha and shading normals of hits.
//!
//! Only for materials with textures or vertex colours. All lanes of one material are evaluated together, layer by
//! layer. Each look-up is averaged over the footprint of the ray: the intersection of its cone with the surface. Bump
//! maps are looked up lane by lane.

use glam::DVec3;
use multiversion::multiversion;

use super::cone_source::ConeSource;
use super::instance_view::InstanceView;
use super::interaction::SurfaceScene;
use super::object_points::set_object_points;
use super::packet::{SurfacePacket, lane};
use super::texel_inputs::{DEFAULT_DIRECTIONS, apply_extended, apply_layer, scale, tint};
use super::uv_frame::UvFrame;
use super::uv_packet::FootprintPacket;
use super::vertex_fetch::FetchedVertices;
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Anisotropy, Effect, InstanceTransform, MaterialInput, Model, Space, TextureBinding};
use crate::shading::normal_map::{
    TangentFrame, TangentPacket, bend_packet_toward_viewer, bumped, transformed_derivatives,
};
use crate::shading::ray_cone::uv_of;
use crate::shading::{
    Footprint, LookupMethod, MaterialPacket, PacketLookup, PatternPacket, TexturePoint, UvPacket,
};

/// Working memory of texture evaluation.
pub(super) struct TextureLanes {
    footprints: FootprintPacket,
    lookup: LayerLookup,
}

/// Points and texels of the last layer, of which the next one may use some.
struct LayerLookup {
    points: UvPacket,
    /// Set of texture coordinates that `points` are in; `None` if the lanes have changed since.
    set: Option<u32>,
    images: PacketLookup,
    pattern: PatternPacket,
}

impl TextureLanes {
    pub(super) fn new() -> TextureLanes {
        TextureLanes {
            footprints: FootprintPacket::ZERO,
            lookup: LayerLookup {
                points: UvPacket::ZERO,
                set: None,
                images: PacketLookup::new(),
                pattern: PatternPacket::ZERO,
            },
        }
    }
}

/// Inputs of the textures of a packet.
#[derive(Clone, Copy)]
pub(super) struct TexturedHits<'a> {
    pub(super) packet: &'a RayPacket,
    pub(super) widths: ConeSource<'a>,
    pub(super) gathered: &'a FetchedVertices,
}

/// Hits of a packet on one material.
#[derive(Clone, Copy)]
struct MaterialHits<'a> {
    packet: &'a RayPacket,
    /// Lanes that hit the material.
    mask: &'a Lanes<bool>,
    footprints: &'a FootprintPacket,
}

impl MaterialHits<'_> {
    /// Returns the lanes that hit the material.
    fn lanes(&self) -> impl Iterator<Item = usize> {
        (0..LANES).filter(|&l| self.mask[l])
    }
}

/// Evaluates textures and vertex colours for the lanes that have any; compiled for several instruction sets.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn evaluate_textures(
    scene: &SurfaceScene,
    hits: TexturedHits,
    points: &mut SurfacePacket,
    materials: &mut MaterialPacket,
    lanes: &mut TextureLanes,
) {
    let packet = hits.packet;
    let TextureLanes { footprints, lookup } = lanes;
    footprints.fill(scene, packet, hits.widths, points, hits.gathered);
    // Take the lanes of one material after the other
    let mut left: Lanes<bool> =
        std::array::from_fn(|l| packet.instance[l] != NO_HIT && !scene.view(packet.instance[l]).uniform);
    while let Some(first) = left.iter().position(|&is_left| is_left) {
        let material = scene.view(packet.instance[first]).material;
        let mut mask = [false; LANES];
        for l in first..LANES {
            mask[l] = left[l] && scene.view(packet.instance[l]).material == material;
            left[l] &= !mask[l];
        }
        lookup.set = None;
        let hits = MaterialHits {
            packet,
            mask: &mask,
            footprints,
        };
        scene.evaluate_material(&hits, points, materials, lookup);
    }
}

impl SurfaceScene<'_> {
    /// Evaluates textures and vertex colours at hits on one material, including its alpha and the shading normals.
    #[inline(always)]
    fn evaluate_material(
        &self,
        hits: &MaterialHits,
        points: &mut SurfacePacket,
        materials: &mut MaterialPacket,
        lookup: &mut LayerLookup,
    ) {
        let mask = hits.mask;
        let Some(first) = hits.lanes().next() else { return };
        let material = self.material_of(self.view(hits.packet.instance[first]));
        let mut alpha = [material.base_color[3]; LANES];
        let mut normals = PerturbedNormals {
            n: points.outward_normals(),
            lanes: [false; LANES],
        };
        let mut directions = DEFAULT_DIRECTIONS;
        for layer in &material.layers {
            if !self.effects.has(layer.effect()) {
                continue;
            }
            if layer.parameter == MaterialInput::Bump {
                self.bump_normals(layer, hits, points, &mut normals);
                continue;
            }
            // Look the texture up, and multiply the texels into the material input
            let texels = self.texels(layer, hits, points, lookup);
            match layer.parameter {
                MaterialInput::BaseColor => {
                    tint(&mut materials.base_color, texels, mask);
                    scale(&mut alpha, texels, 3, mask);
                }
                MaterialInput::Emission => tint(&mut materials.emission, texels, mask),
                MaterialInput::Roughness => scale(&mut materials.roughness, texels, 0, mask),
                MaterialInput::Metallic => scale(&mut materials.metallic, texels, 0, mask),
                MaterialInput::MetallicRoughness => {
                    scale(&mut materials.roughness, texels, 1, mask);
                    scale(&mut materials.metallic, texels, 2, mask);
                }
                MaterialInput::Normal => self.map_normals(layer, texels, hits, points, &mut normals),
                MaterialInput::Anisotropy => directions = *texels,
                MaterialInput::ClearcoatNormal => {
                    self.map_coat_normals(layer, texels, (hits, points), materials);
                }
                MaterialInput::IridescenceThickness => {
                    let [thin, thick] = material.iridescent().map_or([0.0; 2], |film| film.thickness);
                    for l in hits.lanes() {
                        materials.extended.film_thickness[l] = thin + texels[l][1] * (thick - thin);
                    }
                }
                input if input.effect() == Effect::Clearcoat || input.effect() == Effect::Sheen => {
                    apply_layer(layer, texels, mask, materials);
                }
                _ => apply_extended(layer, texels, mask, &mut materials.extended),
            }
        }
        self.apply_vertex_colors(hits, materials, &mut alpha);
        // Evaluate alpha and emission of the result, and turn the normals
        let is_unlit = material.model == Model::Unlit && self.effects.has(Effect::Emission);
        for l in hits.lanes() {
            materials.alpha[l] = materials.coverage(material, alpha[l]);
            if is_unlit {
                (0..3).for_each(|c| materials.emission[c][l] = materials.base_color[c][l]);
            }
        }
        if normals.lanes.contains(&true) {
            points.ns = points.bent(&normals);
        }
        if let Some(lobe) = material
            .anisotropic()
            .filter(|_| self.effects.has(Effect::Anisotropy))
        {
            self.orient_lobes(lobe, &directions, (hits, points), materials);
        }
    }

    /// Perturbs the normals of coats by a normal map of their own.
    #[inline(never)]
    fn map_coat_normals(
        &self,
        layer: &TextureBinding,
        texels: &Lanes<[f32; 4]>,
        (hits, points): (&MaterialHits, &SurfacePacket),
        materials: &mut MaterialPacket,
    ) {
        let mut normals = PerturbedNormals {
            n: points.outward_normals(),
            lanes: [false; LANES],
        };
        self.map_normals(layer, texels, hits, points, &mut normals);
        let bent = points.bent(&normals);
        let Some(layers) = &mut materials.layers else {
            return;
        };
        for l in hits.lanes() {
            (0..3).for_each(|axis| layers.coat_normal[axis][l] = bent[axis][l]);
        }
    }

    /// Sets the directions of anisotropic lobes from texels of directions and strengths. Lobes at hits without a tangent
    /// become isotropic.
    #[inline(never)]
    fn orient_lobes(
        &self,
        lobe: &Anisotropy,
        texels: &Lanes<[f32; 4]>,
        (hits, points): (&MaterialHits, &SurfacePacket),
        materials: &mut MaterialPacket,
    ) {
        // Smallest perceptual roughness across the direction (alpha = 0.001): a lobe without any width is a mirror
        const MIN_ROUGHNESS: f32 = 0.032;
        let extended = &mut materials.extended;
        let (sin, cos) = lobe.rotation.sin_cos();
        for l in hits.lanes() {
            // Rotate the direction in the tangent plane
            let [x, y, strength, _] = texels[l];
            let (x, y) = (2.0 * x - 1.0, 2.0 * y - 1.0);
            let (x, y) = (f64::from(cos * x - sin * y), f64::from(sin * x + cos * y));
            let n = points.shading_normal(l);
            let pose = self.pose(hits.packet, l);
            let frame = TexturedHit::new(self, (hits, points), l, &pose).surface_frame(n);
            // Make it perpendicular to the shading normal
            let direction = frame.and_then(|frame| {
                let direction = frame.tangent * x + frame.bitangent * y;
                (direction - n * n.dot(direction)).try_normalize()
            });
            extended.anisotropy[l] *= if direction.is_some() { strength } else { 0.0 };
            if extended.anisotropy[l] > 0.0 {
                materials.roughness[l] = materials.roughness[l].max(MIN_ROUGHNESS);
            }
            let direction = direction.unwrap_or_default();
            (0..3).for_each(|axis| extended.anisotropy_direction[axis][l] = direction[axis] as f32);
        }
    }

    /// Returns the texels of a layer at the hits; other lanes have any values.
    #[inline(always)]
    fn texels<'l>(
        &self,
        layer: &TextureBinding,
        hits: &MaterialHits,
        points: &SurfacePacket,
        lookup: &'l mut LayerLookup,
    ) -> &'l Lanes<[f32; 4]> {
        let LayerLookup {
            points: uv,
            set,
            images,
            pattern,
        } = lookup;
        let texture = layer.texture.texture;
        let method = self.textures().lookup_method(texture);
        // Compute the points of object space
        match method {
            LookupMethod::ByLane => {
                self.texels_by_lane(layer, hits, points, images.texels_mut());
                return images.texels();
            }
            LookupMethod::Pattern(Space::Object) => {
                let hit = (hits.packet, hits.mask);
                set_object_points(self.instances(), hit, (hits.footprints.axes(), points), pattern);
                return self
                    .textures()
                    .sample_pattern(texture, pattern, hits.mask, images);
            }
            LookupMethod::Image | LookupMethod::Pattern(Space::Uv) => {}
        }
        // Compute the texture coordinates, unless the layer before had the same
        if *set != Some(layer.texture.tex_coord) {
            *set = Some(layer.texture.tex_coord);
            self.uv_packet(
                layer.texture.tex_coord,
                (hits.packet, hits.mask),
                points,
                hits.footprints,
                uv,
            );
            images.begin();
        }
        if method != LookupMethod::Image {
            pattern.set_coordinates(uv, &layer.texture.transform);
            return self
                .textures()
                .sample_pattern(texture, pattern, hits.mask, images);
        }
        let encoding = layer.parameter.encoding();
        self.textures()
            .sample_packet(&layer.texture, encoding, uv, hits.mask, images)
    }

    /// Looks a texture up lane by lane: an image that is too large for packets.
    #[inline(never)]
    fn texels_by_lane(
        &self,
        layer: &TextureBinding,
        hits: &MaterialHits,
        points: &SurfacePacket,
        texels: &mut Lanes<[f32; 4]>,
    ) {
        let encoding = layer.parameter.encoding();
        for l in hits.lanes() {
            let pose = self.pose(hits.packet, l);
            let hit = TexturedHit::new(self, (hits, points), l, &pose);
            let (uv_frame, at) = hit.look_up(layer);
            let footprint = hit.footprint(layer, &uv_frame);
            texels[l] = self
                .textures()
                .sample_footprint(layer.texture.texture, encoding, &at, &footprint);
        }
    }

    /// Perturbs the normals by a bump map, lane by lane.
    #[inline(never)]
    fn bump_normals(
        &self,
        layer: &TextureBinding,
        hits: &MaterialHits,
        points: &SurfacePacket,
        normals: &mut PerturbedNormals,
    ) {
        for l in hits.lanes() {
            let pose = self.pose(hits.packet, l);
            let (uv_frame, at) = TexturedHit::new(self, (hits, points), l, &pose).look_up(layer);
            let object_from_world = pose.object_from_world().matrix3;
            let by_object = uv_frame
                .derivatives
                .map(|derivative| object_from_world * derivative);
            let gradient = self.textures().height_gradient(&layer.texture, &at, by_object);
            let slope = gradient.map(|g| g * layer.strength);
            let n = lane(&normals.n, l).as_dvec3().normalize();
            normals.set(l, bumped(n, uv_frame.derivatives, slope));
        }
    }

    /// Perturbs the interpolated normals by the texels of a normal map. Lanes without a tangent frame keep theirs.
    #[inline(always)]
    fn map_normals(
        &self,
        layer: &TextureBinding,
        texels: &Lanes<[f32; 4]>,
        hits: &MaterialHits,
        points: &SurfacePacket,
        normals: &mut PerturbedNormals,
    ) {
        // Interpolate the tangents of meshes
        let mut frames = TangentPacket::ZERO;
        let mut lacks_tangent = [false; LANES];
        for l in hits.lanes() {
            let instance = hits.packet.instance[l];
            match self.view(instance).tangent(hits.packet, l) {
                Some(tangent) => {
                    frames.set(l, tangent);
                    if self.is_placed(instance) {
                        let pose = self.pose(hits.packet, l);
                        // A mirroring transform flips the handedness.
                        frames.transform(l, &pose.world_from_object().matrix3, pose.is_mirrored());
                    }
                }
                None => lacks_tangent[l] = true,
            }
        }
        let n = points.outward_normals();
        let (mapped, has_frame) = frames.perturbed(&n, texels, layer.strength);
        for l in 0..LANES {
            normals.lanes[l] = hits.mask[l] & has_frame[l];
        }
        normals.n = mapped;
        // Without mesh tangents, use the derivatives of the texture coordinates
        if lacks_tangent.contains(&true) {
            for l in (0..LANES).filter(|&l| lacks_tangent[l]) {
                let pose = self.pose(hits.packet, l);
                let n = lane(&n, l).as_dvec3().normalize();
                let frame = TexturedHit::new(self, (hits, points), l, &pose).tangent_frame(layer, n);
                if let Some(frame) = frame {
                    let [x, y, z, _] = texels[l];
                    normals.set(l, frame.perturbed([x, y, z], layer.strength));
                }
            }
        }
    }

    /// Multiplies colours and alpha by the vertex colours of meshes that have any.
    #[inline(always)]
    fn apply_vertex_colors(
        &self,
        hits: &MaterialHits,
        materials: &mut MaterialPacket,
        alpha: &mut Lanes<f32>,
    ) {
        for l in hits.lanes() {
            let view = self.view(hits.packet.instance[l]);
            if let Some(color) = view.vertex_color(hits.packet, l) {
                (0..3).for_each(|c| materials.base_color[c][l] *= color[c]);
                alpha[l] *= color[3];
            }
        }
    }
}

impl SurfacePacket {
    /// Returns the shading normals on the outside of the surfaces.
    #[inline(always)]
    fn outward_normals(&self) -> Lanes3<f32> {
        let mut normals = self.ns;
        for axis in &mut normals {
            for l in 0..LANES {
                axis[l] = if self.front[l] { axis[l] } else { -axis[l] };
            }
        }
        normals
    }

    /// Returns the shading normals with those of `normals` in their lanes, limited to directions that keep the surface
    /// visible to the viewer.
    #[inline(always)]
    fn bent(&self, normals: &PerturbedNormals) -> Lanes3<f32> {
        let mut facing = normals.n;
        for axis in &mut facing {
            for l in 0..LANES {
                axis[l] = if self.front[l] { axis[l] } else { -axis[l] };
            }
        }
        let bent = bend_packet_toward_viewer(&facing, &self.ng, &self.wo);
        let mut ns = self.ns;
        for axis in 0..3 {
            for l in 0..LANES {
                ns[axis][l] = if normals.lanes[l] {
                    bent[axis][l]
                } else {
                    ns[axis][l]
                };
            }
        }
        ns
    }
}

/// Unit shading normals on the outside of the surfaces.
struct PerturbedNormals {
    n: Lanes3<f32>,
    /// Lanes whose normals are not the interpolated ones.
    lanes: Lanes<bool>,
}

impl PerturbedNormals {
    fn set(&mut self, l: usize, n: DVec3) {
        for axis in 0..3 {
            self.n[axis][l] = n[axis] as f32;
        }
        self.lanes[l] = true;
    }
}

/// Hit whose textures are looked up on its own.
struct TexturedHit<'a> {
    view: &'a InstanceView<'a>,
    pose: &'a InstanceTransform<'a>,
    packet: &'a RayPacket,
    points: &'a SurfacePacket,
    l: usize,
    /// Axes of the elliptical ray footprint on the surface, in world space.
    axes: [DVec3; 2],
}

impl<'a> TexturedHit<'a> {
    fn new(
        scene: &'a SurfaceScene,
        (hits, points): (&MaterialHits<'a>, &'a SurfacePacket),
        l: usize,
        pose: &'a InstanceTransform<'a>,
    ) -> TexturedHit<'a> {
        TexturedHit {
            view: scene.view(hits.packet.instance[l]),
            pose,
            packet: hits.packet,
            points,
            l,
            axes: hits.footprints.world_axes(l),
        }
    }

    /// Returns the texture coordinates of a layer and the world-space derivatives of the point by them, before its
    /// transform.
    fn uv_frame(&self, layer: &TextureBinding) -> UvFrame {
        let hits = (self.packet, self.points);
        self.view
            .uv_frame(self.pose, layer.texture.tex_coord, hits, self.l)
    }

    /// Returns the texture coordinates and the point of the look-up for a layer.
    fn look_up(&self, layer: &TextureBinding) -> (UvFrame, TexturePoint) {
        let points = self.points;
        let uv_frame = self.uv_frame(layer);
        // Take a point slightly below the surface, because a face of the solid may lie exactly between two cells of a
        // procedural pattern.
        let ng = points.geometric_normal(self.l);
        let inward = if points.front[self.l] { -ng } else { ng };
        let carved = points.point(self.l) + inward * points.error(self.l);
        let p_object = self.pose.object_from_world().transform_point3(carved);
        let at = TexturePoint::sharp(layer.texture.transform.apply(uv_frame.uv), p_object);
        (uv_frame, at)
    }

    /// Returns the footprint of the look-up for a layer, whose coordinates before its transform are `uv_frame`.
    fn footprint(&self, layer: &TextureBinding, uv_frame: &UvFrame) -> Footprint {
        let transform = &layer.texture.transform;
        let turned = |[u, v]: [f32; 2]| {
            let matrix = transform.matrix;
            [0, 1].map(|row| matrix[row][0] * u + matrix[row][1] * v)
        };
        // Transform the footprint to texture and object space
        let object_from_world = self.pose.object_from_world().matrix3;
        Footprint {
            uv: self.axes.map(|axis| turned(uv_of(axis, uv_frame.derivatives))),
            object: self.axes.map(|axis| object_from_world * axis),
        }
    }

    /// Returns the tangent frame of the surface with the unit normal `n`: from the mesh, else from the first set of
    /// texture coordinates.
    fn surface_frame(&self, n: DVec3) -> Option<TangentFrame> {
        // Use the derivatives of the texture coordinates without mesh tangents
        let Some([x, y, z, handedness]) = self.view.tangent(self.packet, self.l) else {
            let hits = (self.packet, self.points);
            let derivatives = self.view.uv_frame(self.pose, 0, hits, self.l).derivatives;
            return TangentFrame::from_derivatives(n, derivatives);
        };
        let tangent = DVec3::new(x.into(), y.into(), z.into());
        let handedness = if self.pose.is_mirrored() {
            -handedness
        } else {
            handedness
        };
        TangentFrame::from_tangent(n, self.pose.world_from_object().matrix3 * tangent, handedness)
    }

    /// Returns the tangent frame of a normal map on the surface with the outward unit normal `n`, from the texture
    /// coordinates.
    fn tangent_frame(&self, layer: &TextureBinding, n: DVec3) -> Option<TangentFrame> {
        let derivatives = self.uv_frame(layer).derivatives;
        let derivatives = transformed_derivatives(derivatives, &layer.texture.transform)?;
        TangentFrame::from_derivatives(n, derivatives)
    }
}
