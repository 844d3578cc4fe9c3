//! Bounds, normalisation and validation of a scene's volumes and fog.

use glam::DAffine3;

use super::validate_value::check_coordinate_range;
use super::{Normalisation, Scene};
use crate::numeric::Bounds;
use crate::volume::Volume;

impl Scene {
    /// Returns whether fog attenuates light.
    pub(crate) fn has_fog(&self) -> bool {
        self.fog.is_some_and(|fog| fog.extinction() > 0.0)
    }

    /// Returns the world-space box around all volumes.
    pub(crate) fn volume_bounds(&self) -> Bounds {
        let bounds = self.volumes.iter().map(Volume::bounds);
        bounds.fold(Bounds::EMPTY, Bounds::union)
    }

    /// Maps volumes and fog by `normalisation`, so that the image stays the same.
    pub(super) fn transform_volumes(&mut self, normalisation: &Normalisation) {
        let scale = normalisation.scale;
        for volume in &mut self.volumes {
            let old = volume.world_from_cube();
            let place = DAffine3 {
                matrix3: old.matrix3 * scale,
                translation: normalisation.point(old.translation),
            };
            // The factor is a power of two: a map that had an inverse keeps one.
            match volume.rescaled(scale, place) {
                Ok(moved) => *volume = moved,
                Err(fault) => debug_assert!(false, "{fault}"),
            }
        }
        self.fog = self.fog.map(|fog| fog.rescaled(scale));
    }

    /// Multiplies the length of ray-marching steps by `factor`, for every volume and the fog.
    pub(crate) fn scale_march_steps(&mut self, factor: f64) {
        for volume in &mut self.volumes {
            *volume = volume.clone().with_steps(factor);
        }
        self.fog = self.fog.map(|fog| fog.with_steps(factor));
    }

    /// Checks that volumes are within the range of coordinates; an error comes with the volume's index.
    pub(super) fn check_volumes(&self) -> Result<(), (usize, String)> {
        self.volumes.iter().enumerate().try_for_each(|(index, volume)| {
            check_coordinate_range(volume.bounds().magnitude()).map_err(|fault| (index, fault))
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::DVec3;

    use super::*;
    use crate::volume::{
        Fog, Grid, GridSamples, March, RaySegment, Thickness, Transfer, TransferNode, VolumeDescription,
    };

    fn volume(thickness: Thickness) -> Volume {
        let node = |value: f64, thickness: f64| TransferNode {
            value,
            thickness,
            color: [0.5; 3],
            emission: [0.25, 0.0, 0.0],
        };
        let grid = Grid::new([2, 1, 1], GridSamples::Floats(vec![0.25, 1.0])).unwrap();
        Volume::new(VolumeDescription {
            density: Arc::new(grid),
            color: None,
            transfer: Transfer::new(&[node(0.0, 0.0), node(1.0, 0.75)], thickness).unwrap(),
            world_from_cube: DAffine3::from_translation(DVec3::new(1e6, 0.0, 0.0)),
            step: Some(0.125),
        })
        .unwrap()
    }

    #[test]
    fn normalisation_preserves_radiance_through_volumes_and_fog() {
        for thickness in [Thickness::Extinction, Thickness::OpacityOver(0.5)] {
            let fog = Fog::new(0.125, [0.5; 3], [0.0, 0.25, 0.0], 0.25).unwrap();
            let mut scene = Scene {
                volumes: vec![volume(thickness)],
                fog: Some(fog),
                ..Scene::default()
            };
            // March the same segment, in units of the scene
            let seen = |scene: &Scene, x: f64, scale: f64| {
                let stretch = RaySegment {
                    origin: DVec3::new(x, 0.25 * scale, 0.5 * scale),
                    direction: DVec3::X,
                    t_near: 0.0,
                    t_far: 6.0 * scale,
                };
                March::new(&scene.volumes, scene.fog).radiance(&stretch, None)
            };
            let before = seen(&scene, 1e6 - 3.0, 1.0);
            scene.apply_normalisation(Normalisation {
                center: DVec3::new(1e6, 0.0, 0.0),
                scale: 16.0,
            });
            // The medium must have an effect for the comparison to mean anything
            assert!(before.transmittance < 0.8);
            // The scales are powers of two: only the translation may round, and here it does not.
            assert_eq!(before, seen(&scene, -48.0, 16.0));
        }
    }

    #[test]
    fn out_of_range_volume_is_rejected_by_number() {
        let far = DAffine3::from_translation(DVec3::new(1e30, 0.0, 0.0));
        let volumes = vec![
            volume(Thickness::Extinction),
            volume(Thickness::Extinction).rescaled(1.0, far).unwrap(),
        ];
        let scene = Scene {
            volumes,
            ..Scene::default()
        };
        let fault = scene.validate().unwrap_err().to_string();
        assert!(fault.starts_with("volume 1"), "{fault}");
    }
}
