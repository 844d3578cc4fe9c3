//! Shading data of instances: the arrays of a mesh or an analytic shape, and whether its material varies.

use std::sync::Arc;

use super::packet::SurfacePacket;
use super::shape_hit::shape_frame;
use super::uv_frame::UvFrame;
use super::vertex_fetch::MeshView;
use crate::accel::RayPacket;
use crate::mesh::PointCloud;
use crate::scene::{
    Effect, EffectSet, Geometry, InstanceTransform, Material, MaterialInput, Procedural, Scene, Space,
    Texture,
};
use crate::shape::Shape;

/// Data of one instance that hits on it need.
pub(in crate::render) struct InstanceView<'s> {
    pub(super) kind: InteractionKind<'s>,
    /// Index into the materials of the scene.
    pub(super) material: u32,
    /// True if the material is constant over the surface: no texture and no vertex colour.
    pub(in crate::render) uniform: bool,
    /// True if object space differs from world space.
    pub(super) is_placed: bool,
    /// True if texture coordinates of analytic shapes are stored with each hit, because the material uses them.
    pub(super) needs_uv_frames: bool,
}

/// Geometry of an instance.
#[derive(Clone)]
pub(super) enum InteractionKind<'s> {
    /// Mesh data, shared by all instances of the mesh.
    Mesh(Arc<MeshView<'s>>),
    Shape(&'s Shape),
    /// Data of a point cloud, shared by all instances of the cloud.
    Points(Arc<PointsView<'s>>),
}

/// Arrays of a point cloud that the effects need.
pub(super) struct PointsView<'s> {
    pub(super) cloud: &'s PointCloud,
    pub(super) colors: Option<&'s [[f32; 4]]>,
}

impl InstanceView<'_> {
    /// Returns whether hits are computed with the transform of the instance: on analytic shapes, points and transformed
    /// meshes.
    pub(super) fn needs_object_space(&self) -> bool {
        self.is_placed || self.is_shape()
    }

    /// Returns the texture coordinates of a hit and the world-space derivatives of the point by them; zero where the
    /// mesh has none.
    pub(in crate::render) fn uv_frame(
        &self,
        pose: &InstanceTransform,
        set: u32,
        (packet, points): (&RayPacket, &SurfacePacket),
        l: usize,
    ) -> UvFrame {
        // Interpolate mesh coordinates; those of shapes are stored if the material uses them, and else computed
        match &self.kind {
            InteractionKind::Mesh(mesh) => match mesh.tex_coords.get(set as usize) {
                Some(set) => {
                    let linear = pose.world_from_object().matrix3;
                    UvFrame {
                        uv: mesh.interpolate(set, packet, l),
                        derivatives: mesh.derivatives(set, packet.primitive[l]).map(|d| linear * d),
                    }
                }
                None => UvFrame::ZERO,
            },
            _ if self.needs_uv_frames => points.shape_frames[l],
            InteractionKind::Shape(shape) => shape_frame(pose, shape, &packet.ray(l), packet.primitive[l]),
            InteractionKind::Points(points) => {
                // A sphere has one part
                shape_frame(pose, &points.cloud.shape(packet.primitive[l]), &packet.ray(l), 0)
            }
        }
    }

    /// Returns the texture coordinates of the corners of a triangle; `None` for shapes and points, and for meshes without
    /// the set.
    #[inline(always)]
    pub(super) fn corner_coordinates(&self, set: u32, primitive: u32) -> Option<[[f32; 2]; 3]> {
        match &self.kind {
            InteractionKind::Mesh(mesh) => {
                let set = mesh.tex_coords.get(set as usize)?;
                Some(mesh.triangles[primitive as usize].map(|vertex| set[vertex as usize]))
            }
            InteractionKind::Shape(_) | InteractionKind::Points(_) => None,
        }
    }

    /// Returns whether hits are on analytic shapes, such as the spheres of points.
    #[inline(always)]
    pub(super) fn is_shape(&self) -> bool {
        self.kind.is_shape()
    }

    /// Returns the interpolated mesh tangent at a hit, in object space, with its handedness.
    pub(in crate::render) fn tangent(&self, packet: &RayPacket, l: usize) -> Option<[f32; 4]> {
        match &self.kind {
            InteractionKind::Mesh(mesh) => mesh
                .tangents
                .map(|tangents| mesh.interpolate(tangents, packet, l)),
            InteractionKind::Shape(_) | InteractionKind::Points(_) => None,
        }
    }

    pub(in crate::render) fn vertex_color(&self, packet: &RayPacket, l: usize) -> Option<[f32; 4]> {
        match &self.kind {
            InteractionKind::Mesh(mesh) => mesh.colors.map(|colors| mesh.interpolate(colors, packet, l)),
            InteractionKind::Points(points) => {
                points.colors.map(|colors| colors[packet.primitive[l] as usize])
            }
            InteractionKind::Shape(_) => None,
        }
    }
}

/// Returns whether textures of `material` are looked up by texture coordinates or perturb normals along them. Patterns
/// in object space are not.
pub(super) fn needs_uv_frames(material: &Material, scene: &Scene, effects: EffectSet) -> bool {
    material.layers.iter().any(|layer| {
        let is_carved = matches!(
            scene.textures.get(layer.texture.texture as usize),
            Some(Texture::Procedural(Procedural {
                space: Space::Object,
                ..
            }))
        );
        let turns_normals = matches!(
            layer.parameter,
            MaterialInput::Bump | MaterialInput::Normal | MaterialInput::ClearcoatNormal
        );
        effects.has(layer.effect()) && (turns_normals || !is_carved)
    })
}

impl<'s> InteractionKind<'s> {
    /// Returns whether hits are on analytic shapes, such as the spheres of points.
    #[inline(always)]
    pub(super) fn is_shape(&self) -> bool {
        matches!(self, InteractionKind::Shape(_) | InteractionKind::Points(_))
    }

    /// Returns whether the vertices or points have colours that the effects need.
    pub(super) fn has_colors(&self) -> bool {
        match self {
            InteractionKind::Mesh(mesh) => mesh.colors.is_some(),
            InteractionKind::Points(points) => points.colors.is_some(),
            InteractionKind::Shape(_) => false,
        }
    }

    pub(super) fn of(geometry: &'s Geometry, effects: EffectSet) -> InteractionKind<'s> {
        match geometry {
            Geometry::Mesh(mesh) => InteractionKind::Mesh(Arc::new(MeshView::of(mesh, effects))),
            Geometry::Shape(shape) => InteractionKind::Shape(shape),
            Geometry::Points(cloud) => InteractionKind::Points(Arc::new(PointsView {
                cloud,
                colors: cloud
                    .colors
                    .as_deref()
                    .filter(|_| effects.has(Effect::VertexColor)),
            })),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instance_view_takes_at_most_24_bytes() {
        assert!(size_of::<InstanceView>() <= 24, "{}", size_of::<InstanceView>());
    }
}
