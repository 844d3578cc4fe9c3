//! Where the renderer lets rays start that leave what has been hit: for those who test it from outside.

use glam::DVec3;

use super::plan::Plan;
use super::surface::{SurfaceScene, Surfaces};
use super::texturing::Widths;
use crate::accel::{LANES, RayPacket};
use crate::scene::{Camera, EffectOverrides, Scene};

/// A point on a surface that rays may leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Departure {
    /// The point, in world space.
    pub p: DVec3,
    /// The unit geometric normal on the side that the ray came from.
    pub ng: DVec3,
    /// What [`crate::numeric::spawn_point`] is to move a new ray's origin by, along the normal.
    pub error: f64,
}

/// The surfaces of a scene, as the renderer works them out.
pub struct Departures<'s>(SurfaceScene<'s>);

impl<'s> Departures<'s> {
    /// `scene` must have passed [`Scene::validate`].
    pub fn new(scene: &'s Scene) -> Departures<'s> {
        let plan = Plan::new(scene, &Camera::default(), &EffectOverrides::default());
        Departures(SurfaceScene::new(scene, &plan))
    }

    /// What each lane of a traced packet has hit, if anything.
    pub fn of(&self, packet: &RayPacket) -> [Option<Departure>; LANES] {
        let mut surfaces = Surfaces::new(self.0.effects);
        self.0.meet(packet, Widths::None, &mut surfaces);
        let points = &surfaces.points;
        std::array::from_fn(|l| {
            packet.hit(l).map(|_| Departure {
                p: points.point(l),
                ng: points.geometric_normal(l),
                error: points.error(l),
            })
        })
    }
}
