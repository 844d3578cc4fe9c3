//! Points, spheres and rays in the unit cube.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use whit::accel::{LANES, RayPacket};
use whit::numeric::Ray;
use whit::scene::{Geometry, Instance, Scene};
use whit::shape::{Shape, Sphere};

/// The number of spheres at which their mean radius is [`RADIUS`].
pub(crate) const SPHERE_COUNT: usize = 100_000;
const RADIUS: f64 = 0.012;
/// Pixels a side of the film.
const SIDE: usize = 512;
/// Pixels a side of a packet.
const PACKET_SIDE: usize = 4;
/// Packets a side of the film.
const BLOCKS: usize = SIDE / PACKET_SIDE;

/// Returns the point of that number; the points fill the cube evenly (Weyl's sequence on the powers of the plastic
/// number).
pub(crate) fn point(i: usize) -> DVec3 {
    let fraction = |step: f64| (i as f64 * step).fract();
    DVec3::new(
        fraction(0.819_172_513_396_164_4),
        fraction(0.671_043_606_703_789_2),
        fraction(0.549_700_477_901_970_2),
    )
}

/// Returns a scene of that many spheres, which together have the same volume however many they are.
pub(crate) fn spheres(count: usize) -> Scene {
    let radius = RADIUS * (SPHERE_COUNT as f64 / count as f64).cbrt();
    let place = |i: usize| {
        let scale = DVec3::splat(radius * (0.5 + (i as f64 * 0.618_034).fract()));
        let map = DAffine3::from_scale_rotation_translation(scale, DQuat::IDENTITY, point(i));
        Instance::new("", 0, 0, map).unwrap()
    };
    Scene {
        geometries: vec![Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
        instances: (0..count).map(place).collect(),
        ..Scene::default()
    }
}

/// Returns the rays of a square film one below the eye, which looks down from `height` above the middle of the cube's
/// floor, in packets of 4 x 4.
pub(crate) fn film_rays(height: f32) -> Vec<RayPacket> {
    packets(LANES, |block, lane| {
        let x = block % BLOCKS * PACKET_SIDE + lane % PACKET_SIDE;
        let y = block / BLOCKS * PACKET_SIDE + lane / PACKET_SIDE;
        let at = |pixel: usize| (pixel as f32 + 0.5) / SIDE as f32;
        let eye = Vec3::new(0.5, 0.5, height);
        Ray::new(eye, Vec3::new(at(x), at(y), height - 1.0) - eye)
    })
}

/// Returns as many rays as a film has, from anywhere in the cube through anywhere else in it.
pub(crate) fn random_rays() -> Vec<RayPacket> {
    packets(LANES, |block, lane| {
        let i = 1 + block * LANES + lane;
        let (from, to) = (point(i * 3).as_vec3(), point(i * 7 + 1).as_vec3());
        Ray::new(from, to - from)
    })
}

/// Returns packets of `lanes` rays that start within 0.01 of each other and whose directions differ by at most twice
/// `spread` along each axis.
pub(crate) fn nearby_rays(spread: f64, lanes: usize) -> Vec<RayPacket> {
    packets(lanes, |block, lane| {
        let (center, to) = (point(block * 3), point(block * 7 + 1));
        let [a, b] = [1, 2].map(|k| 2.0 * point(k * (1 + block * LANES + lane)) - DVec3::ONE);
        let direction = (to - center).normalize() + spread * b;
        Ray::new((center + 0.005 * a).as_vec3(), direction.normalize().as_vec3())
    })
}

/// Returns packets of which `ray` gives the first `lanes` lanes, by the packet's number and the lane's.
fn packets(lanes: usize, ray: impl Fn(usize, usize) -> Ray) -> Vec<RayPacket> {
    let packet = |block: usize| {
        let mut packet = RayPacket::EMPTY;
        for lane in 0..lanes {
            packet.set(lane, &ray(block, lane));
        }
        packet
    };
    (0..BLOCKS * BLOCKS).map(packet).collect()
}
