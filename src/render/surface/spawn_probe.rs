//! Spawn points of rays that leave hit surfaces, exposed for tests outside of the renderer.

use glam::DVec3;

use super::super::plan::Plan;
use super::cone_source::ConeSource;
use super::interaction::{SurfaceScene, Surfaces};
use crate::accel::{LANES, RayPacket};
use crate::scene::{Camera, EffectOverrides, Scene};

/// Surface point from which new rays start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpawnPoint {
    /// Hit point in world space.
    pub p: DVec3,
    /// Unit geometric normal on the side of the incident ray.
    pub ng: DVec3,
    /// Bound on the error of `p`, by which [`crate::numeric::spawn_point`] moves the origin of a new ray along the
    /// normal.
    pub error: f64,
}

/// Surface interactions of a scene, as computed by the renderer.
pub struct SpawnProbe<'s>(SurfaceScene<'s>);

impl<'s> SpawnProbe<'s> {
    /// Prepares a scene, which must have passed [`Scene::validate`].
    pub fn new(scene: &'s Scene) -> SpawnProbe<'s> {
        let plan = Plan::new(scene, &Camera::default(), &EffectOverrides::default());
        SpawnProbe(SurfaceScene::new(scene, &plan))
    }

    /// Returns the spawn point of each lane of a traced packet that has a hit.
    pub fn of(&self, packet: &RayPacket) -> [Option<SpawnPoint>; LANES] {
        let mut surfaces = Surfaces::new(self.0.effects);
        self.0
            .compute_interactions(packet, ConeSource::None, &mut surfaces);
        let points = &surfaces.points;
        std::array::from_fn(|l| {
            packet.hit(l).map(|_| SpawnPoint {
                p: points.point(l),
                ng: points.geometric_normal(l),
                error: points.error(l),
            })
        })
    }
}
