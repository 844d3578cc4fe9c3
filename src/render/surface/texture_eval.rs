//! Texture evaluation: applies textures and vertex colours to material inputs, alpha and shading normals of hits.
//!
//! Works lane by lane, and only for materials with textures or vertex colours. Each look-up is averaged over the
//! footprint of the ray: the intersection of its cone with the surface.

use glam::DVec3;

use super::cone_source::ConeSource;
use super::interaction::{InstanceView, SurfaceScene};
use super::packet::SurfacePacket;
use super::uv_frame::UvFrame;
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes3};
use crate::scene::{Effect, InstanceTransform, MaterialInput, Model, TextureBinding};
use crate::shading::normal_map::{TangentFrame, bend_toward_viewer, bumped, transformed_derivatives};
use crate::shading::ray_cone::{axes_on_surface, uv_of};
use crate::shading::{ExtendedMaterialLanes, Footprint, MaterialPacket, TexturePoint};

/// Hit to be textured, in world space unless stated otherwise.
struct TexturedMaterial<'a> {
    view: &'a InstanceView<'a>,
    pose: &'a InstanceTransform<'a>,
    packet: &'a RayPacket,
    l: usize,
    p_object: DVec3,
    /// Axes of the elliptical ray footprint on the surface.
    axes: [DVec3; 2],
}

impl SurfaceScene<'_> {
    /// Evaluates textures and vertex colours for the lanes that have any.
    pub(super) fn evaluate_texture_lanes(
        &self,
        packet: &RayPacket,
        widths: ConeSource,
        points: &mut SurfacePacket,
        materials: &mut MaterialPacket,
    ) {
        for l in 0..LANES {
            if packet.instance[l] == NO_HIT {
                continue;
            }
            if !self.view(packet.instance[l]).uniform {
                self.evaluate_textures((packet, widths, l), points, materials);
            }
        }
    }

    /// Evaluates textures and vertex colours for lane `l`, including its alpha and its shading normal.
    #[cold]
    fn evaluate_textures(
        &self,
        (packet, widths, l): (&RayPacket, ConeSource, usize),
        points: &mut SurfacePacket,
        materials: &mut MaterialPacket,
    ) {
        let view = self.view(packet.instance[l]);
        let material = self.material_of(view);
        let pose = self.pose(packet, l);
        // Loop over the textures that active effects need
        let hit = TexturedMaterial::new((view, &pose), (packet, widths, l), points);
        let mut alpha = material.base_color[3];
        let mut normal = None;
        for layer in &material.layers {
            if !self.effects.has(layer.effect()) {
                continue;
            }
            let (uv_frame, at, footprint) = hit.look_up(layer);
            // Perturb the normal by a bump map
            if layer.parameter == MaterialInput::Bump {
                let object_from_world = pose.object_from_world().matrix3;
                let by_object = uv_frame
                    .derivatives
                    .map(|derivative| object_from_world * derivative);
                let gradient = self.textures().height_gradient(&layer.texture, &at, by_object);
                let n = normal.unwrap_or_else(|| points.outward_normal(l));
                let slope = gradient.map(|g| g * layer.strength);
                normal = Some(bumped(n, uv_frame.derivatives, slope));
                continue;
            }
            // Multiply the texel into its material input
            let encoding = layer.parameter.encoding();
            let texel = self
                .textures()
                .sample_footprint(layer.texture.texture, encoding, &at, &footprint);
            match layer.parameter {
                MaterialInput::BaseColor => {
                    (0..3).for_each(|c| materials.base_color[c][l] *= texel[c]);
                    alpha *= texel[3];
                }
                MaterialInput::Emission => (0..3).for_each(|c| materials.emission[c][l] *= texel[c]),
                MaterialInput::Roughness => materials.roughness[l] *= texel[0],
                MaterialInput::Metallic => materials.metallic[l] *= texel[0],
                MaterialInput::MetallicRoughness => {
                    materials.roughness[l] *= texel[1];
                    materials.metallic[l] *= texel[2];
                }
                MaterialInput::Normal => {
                    let n = points.outward_normal(l);
                    let frame = hit.tangent_frame(layer, &uv_frame, n);
                    let texel = [texel[0], texel[1], texel[2]];
                    normal = frame.map(|frame| frame.perturbed(texel, layer.strength));
                }
                _ => rich_layer(layer, &texel, l, &mut materials.extended),
            }
        }
        // Multiply by the vertex colour and evaluate alpha
        if let Some(color) = view.vertex_color(packet, l) {
            (0..3).for_each(|c| materials.base_color[c][l] *= color[c]);
            alpha *= color[3];
        }
        materials.alpha[l] = materials.coverage(material, alpha);
        if material.model == Model::Unlit && self.effects.has(Effect::Emission) {
            (0..3).for_each(|c| materials.emission[c][l] = materials.base_color[c][l]);
        }
        if let Some(n) = normal {
            points.bend(l, n);
        }
    }
}

impl SurfacePacket {
    /// Returns the unit shading normal of lane `l` on the outside of the surface.
    fn outward_normal(&self, l: usize) -> DVec3 {
        let n = self.shading_normal(l);
        if self.front[l] { n } else { -n }
    }

    /// Sets the shading normal of lane `l` to the outward unit vector `n`, limited to directions that keep the
    /// surface visible to the viewer.
    fn bend(&mut self, l: usize, n: DVec3) {
        let n = if self.front[l] { n } else { -n };
        let wo = DVec3::from([0, 1, 2].map(|axis| f64::from(self.wo[axis][l])));
        let n = bend_toward_viewer(n, self.geometric_normal(l), wo);
        for axis in 0..3 {
            self.ns[axis][l] = n[axis] as f32;
        }
    }
}

impl<'a> TexturedMaterial<'a> {
    fn new(
        (view, pose): (&'a InstanceView<'a>, &'a InstanceTransform<'a>),
        (packet, widths, l): (&'a RayPacket, ConeSource, usize),
        points: &SurfacePacket,
    ) -> TexturedMaterial<'a> {
        // Compute the footprint and the object-space point
        let direction = packet.ray(l).direction.as_dvec3();
        let length = direction.length();
        let ng = points.geometric_normal(l);
        // Slightly below the surface, because a face of the solid may lie exactly between two cells of a procedural
        // pattern.
        let inward = if points.front[l] { -ng } else { ng };
        let carved = points.point(l) + inward * points.error(l);
        let cone = widths.at_start(l).after(f64::from(packet.t_far[l]) * length);
        TexturedMaterial {
            view,
            pose,
            packet,
            l,
            p_object: pose.object_from_world().transform_point3(carved),
            axes: axes_on_surface(cone.width, direction / length, ng),
        }
    }

    /// Returns the texture coordinates, the point and the footprint of the look-up for a layer.
    fn look_up(&self, layer: &TextureBinding) -> (UvFrame, TexturePoint, Footprint) {
        let uv_frame = self
            .view
            .uv_frame(self.pose, layer.texture.tex_coord, self.packet, self.l);
        let transform = &layer.texture.transform;
        let turned = |[u, v]: [f32; 2]| {
            let matrix = transform.matrix;
            [0, 1].map(|row| matrix[row][0] * u + matrix[row][1] * v)
        };
        // Transform the footprint to texture and object space
        let object_from_world = self.pose.object_from_world().matrix3;
        let footprint = Footprint {
            uv: self.axes.map(|axis| turned(uv_of(axis, uv_frame.derivatives))),
            object: self.axes.map(|axis| object_from_world * axis),
        };
        let at = TexturePoint::sharp(transform.apply(uv_frame.uv), self.p_object);
        (uv_frame, at, footprint)
    }

    /// Returns the tangent frame of a normal map on the surface with the outward unit normal `n`, from mesh tangents
    /// if present, otherwise from texture coordinates.
    fn tangent_frame(&self, layer: &TextureBinding, uv_frame: &UvFrame, n: DVec3) -> Option<TangentFrame> {
        if let Some([x, y, z, w]) = self.view.tangent(self.packet, self.l) {
            let pose = self.pose;
            let tangent = DVec3::new(x.into(), y.into(), z.into());
            // A mirroring transform flips the handedness.
            let handedness = if pose.is_mirrored() { -w } else { w };
            let tangent = pose.world_from_object().matrix3 * tangent;
            return TangentFrame::from_tangent(n, tangent, handedness);
        }
        // Without mesh tangents, use the derivatives of the texture coordinates
        let derivatives = transformed_derivatives(uv_frame.derivatives, &layer.texture.transform)?;
        TangentFrame::from_derivatives(n, derivatives)
    }
}

/// Applies a texel to a material input of the extended set, which few materials use.
fn rich_layer(layer: &TextureBinding, texel: &[f32; 4], l: usize, extended: &mut ExtendedMaterialLanes) {
    let tint = |lanes: &mut Lanes3<f32>| (0..3).for_each(|c| lanes[c][l] *= texel[c]);
    match layer.parameter {
        MaterialInput::Specular => extended.specular[l] *= texel[3],
        MaterialInput::SpecularColor => tint(&mut extended.specular_color),
        MaterialInput::Reflection => tint(&mut extended.reflection),
        MaterialInput::Transmission if extended.is_phong[l] => tint(&mut extended.transmission),
        MaterialInput::Transmission => (0..3).for_each(|c| extended.transmission[c][l] *= texel[0]),
        MaterialInput::Occlusion => extended.occlusion[l] = 1.0 + layer.strength * (texel[0] - 1.0),
        _ => {}
    }
}
