//! Transform of an instance at one time.

use glam::DAffine3;

use super::Instance;
use super::instance::Affine;
use crate::shape::Sphere;

/// Transform of an instance at the time of a ray: borrowed from an instance at rest, interpolated for a moving one.
#[derive(Clone, Debug)]
pub struct InstanceTransform<'i>(TransformSource<'i>);

#[derive(Clone, Debug)]
enum TransformSource<'i> {
    AtRest(&'i Instance),
    Moving(Affine),
}

impl Instance {
    /// Returns the transform at `time`, from 0 at the start of motions to 1 at their end.
    #[inline(always)]
    pub fn pose(&self, time: f32) -> InstanceTransform<'_> {
        InstanceTransform(match self.moving_at(time) {
            None => TransformSource::AtRest(self),
            Some(affine) => TransformSource::Moving(affine),
        })
    }
}

impl InstanceTransform<'_> {
    /// Returns the object-to-world map at this time.
    #[inline]
    pub fn world_from_object(&self) -> DAffine3 {
        match &self.0 {
            TransformSource::AtRest(instance) => instance.world_from_object(),
            TransformSource::Moving(affine) => affine.world_from_object,
        }
    }

    /// Returns the world-to-object map at this time.
    #[inline]
    pub fn object_from_world(&self) -> DAffine3 {
        match &self.0 {
            TransformSource::AtRest(instance) => instance.object_from_world(),
            TransformSource::Moving(affine) => affine.object_from_world,
        }
    }

    /// Returns whether object space is world space at all times, as for every baked mesh.
    #[inline(always)]
    pub fn is_identity(&self) -> bool {
        match &self.0 {
            TransformSource::AtRest(instance) => instance.is_identity(),
            TransformSource::Moving(_) => false,
        }
    }

    /// Returns whether the transform mirrors, so that windings run clockwise when seen from the front.
    pub fn is_mirrored(&self) -> bool {
        match &self.0 {
            TransformSource::AtRest(instance) => instance.is_mirrored(),
            TransformSource::Moving(affine) => affine.world_from_object.matrix3.determinant() < 0.0,
        }
    }

    /// Returns the sphere in world space if the instance is at rest and its transform keeps it a sphere without a
    /// rotation; `None` otherwise.
    #[inline(always)]
    pub(crate) fn world_sphere(&self, sphere: &Sphere) -> Option<Sphere> {
        match &self.0 {
            TransformSource::AtRest(instance) => instance.world_sphere(sphere),
            TransformSource::Moving(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn transform_follows_motion_only_for_moving_instances() {
        let from = DAffine3::from_translation(DVec3::X);
        let to = DAffine3::from_translation(DVec3::new(3.0, 4.0, 0.0));
        let moving = Instance::moving("", 0, 0, [from, to]).unwrap();
        // A quarter of the way from (1, 0, 0) to (3, 4, 0).
        let pose = moving.pose(0.25);
        assert_eq!(pose.world_from_object().translation, DVec3::new(1.5, 1.0, 0.0));
        assert_eq!(pose.object_from_world().translation, DVec3::new(-1.5, -1.0, 0.0));
        assert!(!pose.is_identity() && !pose.is_mirrored());
        let still = Instance::new("", 0, 0, from).unwrap();
        assert_eq!(still.pose(0.25).world_from_object(), from);
        assert!(
            Instance::new("", 0, 0, DAffine3::IDENTITY)
                .unwrap()
                .pose(0.5)
                .is_identity()
        );
    }
}
