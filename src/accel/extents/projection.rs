//! Screen-space bounding boxes of objects as seen by a camera.
//!
//! A point is projected to the film by one matrix, the inverse of the columns that span it: for a perspective camera
//! `(X, Y, Z) = A (p - E)` projects to `(X / Z, Y / Z)` at depth Z, for an orthographic camera `A (p - corner)` is
//! position and depth at once. Rays are projected by the same matrix, from the f32 numbers that are traced: so the
//! matrix need not be exact, only the same for both.
//!
//! Objects behind the camera, or nearer than the near plane, have an empty box; objects that reach around the
//! projection centre have an infinite one.

use glam::{DMat3, DVec3, Vec3};

use super::guard::{HitError, UNIT};
use super::hull::{HullPoints, hulls_of};
use crate::accel::RayPacket;
use crate::numeric::LANES;
use crate::parallel;
use crate::scene::{CameraView, Instance, Scene};

/// Padding on all sides of screen-space boxes: far more than the error of a position in f64.
const FILM_SLACK: f64 = 1.0 / (1u64 << 30) as f64;
/// Largest ratio by which a camera's matrix may mix coordinates. Beyond it 16 roundings of 2^-53 of them would come
/// near [`FILM_SLACK`], and the camera has no projection: its angle is under a thousandth of a radian.
const MAX_MIXING: f64 = (1u32 << 12) as f64;
/// Bound on the difference from 1 of the depth of a direction that is rounded to f32: u times [`MAX_MIXING`], with a
/// margin.
const DEPTH_SLACK: f64 = 1.0 / (1u32 << 10) as f64;
/// Error of f64 computations relative to their terms: a dozen roundings of 2^-53.
const WIDE_SLACK: f64 = 1.0 / (1u64 << 48) as f64;

/// A box in screen space: x from 0 at the left edge of the image to 1 at the right, y from 0 at the top to 1 at the
/// bottom. Positions outside the image are valid, too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScreenBox {
    /// Left and top bounds.
    pub low: [f32; 2],
    /// Right and bottom bounds.
    pub high: [f32; 2],
    /// Lower bound on the depth of hits, in the camera's own parameter.
    pub depth: f32,
}

impl ScreenBox {
    /// Empty box, for objects that cannot be seen.
    pub const EMPTY: ScreenBox = ScreenBox {
        low: [f32::INFINITY; 2],
        high: [f32::NEG_INFINITY; 2],
        depth: f32::INFINITY,
    };

    /// Infinite box, for objects without a bound.
    pub const INFINITE: ScreenBox = ScreenBox {
        low: [f32::NEG_INFINITY; 2],
        high: [f32::INFINITY; 2],
        depth: f32::NEG_INFINITY,
    };

    /// Returns whether two boxes have a point in common.
    #[inline(always)]
    pub fn overlaps(&self, other: &ScreenBox) -> bool {
        (self.low[0] <= other.high[0])
            & (other.low[0] <= self.high[0])
            & (self.low[1] <= other.high[1])
            & (other.low[1] <= self.high[1])
    }

    /// Returns whether the box is empty.
    pub fn is_nowhere(&self) -> bool {
        !(self.low[0] <= self.high[0] && self.low[1] <= self.high[1])
    }
}

/// Screen-space boxes of the objects of a scene for one camera.
pub struct ScreenBounds {
    film: FilmBox,
    boxes: Vec<ScreenBox>,
}

/// Projection from world space to the film.
#[derive(Clone, Copy, Debug)]
struct FilmBox {
    /// Projection matrix A of the module documentation.
    film_from_world: DMat3,
    /// Projection centre E, or the corner of the film for an orthographic camera.
    origin: DVec3,
    rays: CameraRays,
    t_near: f64,
    /// Error of an f64 depth at the start of a ray.
    depth_slack: f64,
    /// Largest coordinate of a ray origin.
    reach: f64,
}

/// Property that all rays of a camera share, as they are traced.
#[derive(Clone, Copy, Debug)]
enum CameraRays {
    /// Common origin of perspective rays.
    From(Vec3),
    /// Common direction of orthographic rays.
    Along(Vec3),
}

impl ScreenBounds {
    /// Computes the boxes of all instances of a validated scene; `None` for cameras of extremely narrow angles.
    pub fn new(scene: &Scene, view: &CameraView) -> Option<ScreenBounds> {
        ScreenBounds::of_hulls(scene, &hulls_of(scene), view)
    }

    /// Computes the boxes from known hulls, one per geometry.
    pub(super) fn of_hulls(
        scene: &Scene,
        hulls: &[Option<HullPoints>],
        view: &CameraView,
    ) -> Option<ScreenBounds> {
        let film = FilmBox::new(view)?;
        let boxes = parallel::map(scene.instances.len(), &|index| {
            let instance = &scene.instances[index];
            film.box_of(scene, instance, hulls[instance.geometry as usize].as_ref())
        });
        Some(ScreenBounds { film, boxes })
    }

    /// Returns the box of an instance: infinite for planes, and for transforms too extreme for an error bound.
    pub fn screen_box(&self, instance: u32) -> ScreenBox {
        self.boxes[instance as usize]
    }

    /// Returns the boxes of all instances, in their order.
    pub(super) fn boxes(&self) -> &[ScreenBox] {
        &self.boxes
    }

    /// Returns the screen-space box of the active rays of a packet, or `None` if they are not the camera's. The pair
    /// `[scale, base]` bounds the depth of the rays at parameter `t` by `scale * t + base`.
    #[inline(always)]
    pub(super) fn screen_box_of(&self, packet: &RayPacket) -> Option<(ScreenBox, [f32; 2])> {
        self.film.of_packet(packet)
    }
}

impl FilmBox {
    fn new(view: &CameraView) -> Option<FilmBox> {
        // Take the columns that span the film from three rays
        let [corner, right, below] = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)].map(|(x, y)| view.ray(x, y));
        let (columns, origin, rays, reach) = match view.eye() {
            Some(eye) => {
                let traced = eye.as_vec3();
                let [across, down] = [right, below].map(|ray| ray.direction - corner.direction);
                let columns = [across, down, corner.direction];
                (
                    columns,
                    traced.as_dvec3(),
                    CameraRays::From(traced),
                    eye.abs().max_element(),
                )
            }
            None => {
                let traced = corner.direction.as_vec3();
                let [across, down] = [right, below].map(|ray| ray.origin - corner.origin);
                let columns = [across, down, traced.as_dvec3()];
                // Allow origins up to a film's width beyond the film
                let reach = corner.origin.abs() + 2.0 * (across.abs() + down.abs());
                (
                    columns,
                    corner.origin,
                    CameraRays::Along(traced),
                    reach.max_element(),
                )
            }
        };
        // Invert the columns, and reject matrices that amplify rounding errors too much
        let [across, down, forward] = columns;
        let film_from_world = DMat3::from_cols(across, down, forward).inverse();
        let terms = rows(&film_from_world) * (across.abs() + down.abs() + forward.abs());
        let mixing = match rays {
            CameraRays::From(_) => terms.max_element(),
            // The depth of orthographic rays is a length, not a ratio.
            CameraRays::Along(_) => terms.x.max(terms.y),
        };
        (mixing <= MAX_MIXING).then_some(FilmBox {
            film_from_world,
            origin,
            rays,
            t_near: view.t_near(),
            depth_slack: WIDE_SLACK * terms.z,
            reach,
        })
    }

    fn box_of(&self, scene: &Scene, instance: &Instance, hull: Option<&HullPoints>) -> ScreenBox {
        let geometry = &scene.geometries[instance.geometry as usize];
        let Some(hull) = hull else {
            return if geometry.is_unbounded() {
                ScreenBox::INFINITE
            } else {
                ScreenBox::EMPTY
            };
        };
        let Some(guard) = HitError::of(instance, geometry, hull.object_bounds()) else {
            return ScreenBox::INFINITE;
        };
        let map = instance.world_from_object();
        let world = instance.world_bounds(geometry, hull.object_bounds());
        self.box_of_points(&hull.world_points(&map, &world), &guard)
    }

    /// Returns the box around points, each of which may be displaced by the guard's bounds.
    fn box_of_points(&self, points: &[DVec3], guard: &HitError) -> ScreenBox {
        let pad = DVec3::splat(guard.origin_factor * self.reach + guard.own);
        let magnitudes = rows(&self.film_from_world);
        let depth_of_meshes = guard.depth * self.film_from_world.row(2).length();
        // Project the points, with error bounds
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (mut nearest, mut farthest) = (f64::INFINITY, f64::NEG_INFINITY);
        for p in points {
            let from_origin = *p - self.origin;
            let q = self.film_from_world * from_origin;
            let error = magnitudes * (pad + WIDE_SLACK * (from_origin.abs() + p.abs()));
            let (from, to) = (q - error, q + error);
            nearest = nearest.min(from.z);
            farthest = farthest.max(to.z);
            if let CameraRays::From(_) = self.rays {
                for divisor in [from.z, to.z] {
                    let (a, b) = (from / divisor, to / divisor);
                    low = low.min(a.min(b));
                    high = high.max(a.max(b));
                }
            } else {
                low = low.min(from);
                high = high.max(to);
            }
        }
        // Parallel rays start on the film, except for the rounding of their origins.
        let off_film = (magnitudes * DVec3::splat(2.0 * UNIT * self.reach)).z;
        let last = farthest + depth_of_meshes + off_film + self.depth_slack;
        // Reject objects behind the camera or the near plane
        if last < 0.0 || last * (1.0 + DEPTH_SLACK) < self.t_near {
            return ScreenBox::EMPTY;
        }
        let depth = ((nearest - depth_of_meshes - self.depth_slack) as f32).next_down();
        // Return an infinite box if the object reaches around the projection centre
        if matches!(self.rays, CameraRays::From(_)) && !(nearest > 0.0) {
            return ScreenBox {
                depth,
                ..ScreenBox::INFINITE
            };
        }
        let down = |x: f64| ((x - FILM_SLACK) as f32).next_down();
        let up = |x: f64| ((x + FILM_SLACK) as f32).next_up();
        ScreenBox {
            low: [down(low.x), down(low.y)],
            high: [up(high.x), up(high.y)],
            depth,
        }
    }

    #[inline(always)]
    fn of_packet(&self, packet: &RayPacket) -> Option<(ScreenBox, [f32; 2])> {
        // Project the rays and check that they are the camera's
        let (same, shared, moving, origin) = match self.rays {
            CameraRays::From(origin) => (&packet.origin, origin, &packet.direction, DVec3::ZERO),
            CameraRays::Along(direction) => (&packet.direction, direction, &packet.origin, self.origin),
        };
        let a = &self.film_from_world;
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        let mut places = [[0.0f64; LANES]; 3];
        let mut are_the_cameras = true;
        for l in 0..LANES {
            let is_shared = (same[0][l] == shared.x) & (same[1][l] == shared.y) & (same[2][l] == shared.z);
            are_the_cameras &= is_shared | (packet.active[l] == 0);
            let x = f64::from(moving[0][l]) - origin.x;
            let y = f64::from(moving[1][l]) - origin.y;
            let z = f64::from(moving[2][l]) - origin.z;
            places[0][l] = a.x_axis.x * x + a.y_axis.x * y + a.z_axis.x * z;
            places[1][l] = a.x_axis.y * x + a.y_axis.y * y + a.z_axis.y * z;
            places[2][l] = a.x_axis.z * x + a.y_axis.z * y + a.z_axis.z * z;
        }
        if !(are_the_cameras && packet.any_active()) {
            return None;
        }
        let is_perspective = matches!(self.rays, CameraRays::From(_));
        // Divide by depth for perspective
        if is_perspective {
            for l in 0..LANES {
                let inverse = 1.0 / places[2][l];
                places[0][l] *= inverse;
                places[1][l] *= inverse;
            }
        }
        // Bound the active lanes
        for axis in 0..3 {
            for l in 0..LANES {
                let counts = packet.active[l] != 0;
                let value = places[axis][l];
                low[axis] = if counts & (value < low[axis]) {
                    value
                } else {
                    low[axis]
                };
                high[axis] = if counts & (value > high[axis]) {
                    value
                } else {
                    high[axis]
                };
            }
        }
        // Accept only rays within a film's width of the film, where the error bounds hold; NaN fails the test
        let near_film = (0..2).all(|axis| low[axis] >= -1.0 && high[axis] <= 2.0);
        if !near_film || is_perspective && !(low[2] > 0.5) {
            return None;
        }
        let film = ScreenBox {
            low: [(low[0] as f32).next_down(), (low[1] as f32).next_down()],
            high: [(high[0] as f32).next_up(), (high[1] as f32).next_up()],
            depth: 0.0,
        };
        let deepest = (high[2] * (1.0 + 4.0 * UNIT)) as f32;
        Some((
            film,
            if is_perspective {
                [deepest, 0.0]
            } else {
                [1.0, deepest.next_up()]
            },
        ))
    }
}

/// Returns the matrix of magnitudes.
fn rows(m: &DMat3) -> DMat3 {
    DMat3::from_cols(m.x_axis.abs(), m.y_axis.abs(), m.z_axis.abs())
}
