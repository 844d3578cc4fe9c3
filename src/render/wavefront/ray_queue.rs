//! Ray queues of the wavefront: secondary rays with their path state.
//!
//! Memory is reused from tile to tile; packets are refilled instead of allocated.

use glam::Vec3;

use super::super::context::RenderContext;
use super::super::film::with_step;
use super::super::profile::{Accounts, Category, Memory, RayTypeCounts};
use super::super::settings::RenderSettings;
use super::path_state::{BouncedStates, CameraPaths, FreeLane, PathState, PathStatePacket, PathStates};
use crate::accel::RayPacket;
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::scene::EffectSet;

/// Number of octants of directions.
const OCTANTS: usize = 8;

/// Pixels and throughput of the paths of one ray packet.
#[derive(Clone)]
pub(in crate::render) struct PathPacket {
    /// Pixel within the tile's film, with the sample and first-step bits of its label.
    pub(in crate::render) pixel: Lanes<u32>,
    /// Path throughput, linear RGB.
    pub(in crate::render) weight: Lanes3<f32>,
}

impl PathPacket {
    const EMPTY: PathPacket = PathPacket {
        pixel: [0; LANES],
        weight: [[0.0; LANES]; 3],
    };
}

/// Secondary ray to be queued, with its path state.
pub(in crate::render) struct RayWorkItem {
    pub(in crate::render) ray: Ray,
    pub(in crate::render) pixel: u32,
    pub(in crate::render) weight: [f32; 3],
    /// Account of the effect that sent the ray; used for bookkeeping if the ray is of all wavelengths.
    pub(in crate::render) sender: Category,
    /// Path state, in scenes whose paths carry one.
    pub(in crate::render) travel: Option<PathState>,
}

/// Rays that leave sixteen surfaces.
pub(in crate::render) struct RayLanes<'a> {
    pub(in crate::render) origin: &'a Lanes3<f32>,
    pub(in crate::render) direction: &'a Lanes3<f32>,
    /// Labels on the film.
    pub(in crate::render) pixel: &'a Lanes<u32>,
    /// Path throughput, linear RGB.
    pub(in crate::render) weight: &'a Lanes3<f32>,
}

impl RayTypeCounts {
    #[inline(always)]
    fn count(&mut self, sent: &RayWorkItem) {
        let is_color = sent.account() == Category::Dispersion;
        match (sent.sender, is_color) {
            (Category::RoughReflection | Category::RoughRefraction, true) => self.rough_colors += 1,
            (Category::Interreflection, false) => self.bounced += 1,
            (Category::Interreflection, true) => self.bounced_colors += 1,
            (Category::RoughReflection, false) => self.rough_reflected += 1,
            (Category::RoughRefraction, false) => self.rough_refracted += 1,
            (Category::Refraction, true) => self.refracted_colors += 1,
            (Category::Refraction, false) => self.refracted += 1,
            (_, true) => self.mirrored_colors += 1,
            (_, false) => {}
        }
    }
}

impl RayWorkItem {
    fn account(&self) -> Category {
        match &self.travel {
            Some(travel) if travel.wavelength != 0.0 => Category::Dispersion,
            _ => self.sender,
        }
    }
}

/// Queue of the rays of one wavefront generation. Packets are kept for reuse.
pub(in crate::render) struct RayQueue {
    packets: Vec<RayPacket>,
    paths: Vec<PathPacket>,
    path_states: PathStates,
    /// Number of packets in use.
    count: usize,
    /// True if rays of each octant of directions have packets of their own, which traverse fewer nodes.
    sorts_directions: bool,
    /// Next free lane for rays of each octant of directions; only the first unless they are sorted.
    free: [FreeLane; OCTANTS],
    ray_types: RayTypeCounts,
    /// Account of each ray, if pixel costs or layers by effect are requested.
    accounts: Option<Vec<Lanes<Category>>>,
}

impl RayQueue {
    /// Returns an empty queue for rays of `effects`, whose paths may carry ray cones.
    pub(in crate::render) fn new(effects: EffectSet, combines_samples: bool) -> RayQueue {
        RayQueue {
            packets: Vec::new(),
            paths: Vec::new(),
            path_states: PathStates::new(effects, combines_samples),
            count: 0,
            sorts_directions: false,
            free: [FreeLane::NONE; OCTANTS],
            ray_types: RayTypeCounts::default(),
            accounts: None,
        }
    }

    /// Returns an empty queue for the rays of a render.
    pub(in crate::render) fn of_frame(frame: &RenderContext) -> RayQueue {
        RayQueue::new(frame.effects(), frame.combined.is_any()).with_accounts(&frame.settings)
    }

    /// Returns an empty queue for the rays of a render that continue at random, in scenes that have any.
    pub(in crate::render) fn of_bounces(frame: &RenderContext) -> Option<Box<RayQueue>> {
        let has_paths = frame.effects().has_random_paths();
        has_paths.then(|| {
            Box::new(RayQueue {
                sorts_directions: true,
                ..RayQueue::of_frame(frame)
            })
        })
    }

    /// Returns the queue with an account per ray if `settings` request pixel costs or layers by effect.
    pub(in crate::render) fn with_accounts(self, settings: &RenderSettings) -> RayQueue {
        RayQueue {
            accounts: (settings.cost_aovs || settings.light_layers.effects).then(Vec::new),
            ..self
        }
    }

    /// Removes all rays from the queue.
    pub(in crate::render) fn clear(&mut self) {
        self.count = 0;
        self.free = [FreeLane::NONE; OCTANTS];
        self.ray_types = RayTypeCounts::default();
        self.path_states.clear();
    }

    /// Writes the type of the first step of each path into the labels of rays that have not got one.
    ///
    /// Rays that continue behind fully transparent surfaces have depth 0; their paths have not taken a step yet.
    pub(in crate::render) fn label_steps(&mut self, effects: EffectSet) {
        let Some(accounts) = &self.accounts else { return };
        for (packet, accounts) in accounts.iter().enumerate().take(self.count) {
            for l in 0..LANES {
                // Skip free lanes, and paths that have not bounced yet
                if !self.packets[packet].is_active(l) {
                    continue;
                }
                if effects.counts_bounces() && self.path_states.at(packet).depth(l) == 0 {
                    continue;
                }
                let label = &mut self.paths[packet].pixel[l];
                *label = with_step(*label, accounts[l]);
            }
        }
    }

    /// Returns the numbers of rays by type that [`RayQueue::push`] counted.
    pub(in crate::render) fn ray_types(&self) -> RayTypeCounts {
        self.ray_types
    }

    /// Returns the number of packets in use.
    pub(in crate::render) fn len(&self) -> usize {
        self.count
    }

    /// Number of bytes of a ray packet and its path packet.
    pub(in crate::render) const PACKET_BYTES: usize = size_of::<RayPacket>() + size_of::<PathPacket>();

    /// Returns the bytes of all ray packets and path packets, in use or not.
    pub(in crate::render) fn byte_count(&self) -> usize {
        self.packets.capacity() * size_of::<RayPacket>() + self.paths.capacity() * size_of::<PathPacket>()
    }

    /// Adds the bytes of the optional arrays.
    pub(in crate::render) fn add_columns_to(&self, memory: &mut Memory, effects: EffectSet) {
        self.path_states.add_to(memory, effects);
        let accounts = self.accounts.as_ref().map_or(0, Vec::capacity);
        memory.add("other", "ray counters", accounts * size_of::<Lanes<Category>>());
    }

    /// Returns the packets in use and their paths.
    pub(in crate::render) fn parts(&mut self) -> (&mut [RayPacket], Paths<'_>) {
        let paths = Paths {
            paths: &self.paths[..self.count],
            path_states: &self.path_states,
            accounts: self.accounts.as_deref(),
            first: 0,
        };
        (&mut self.packets[..self.count], paths)
    }

    /// Sets the states of the paths of the packet pushed last to those of camera rays.
    pub(in crate::render) fn begin_paths(&mut self, paths: &CameraPaths) {
        self.path_states.resize(self.count);
        self.path_states.begin(self.count - 1, paths);
    }

    /// Returns the packet that was pushed last.
    pub(in crate::render) fn last_packet(&mut self) -> &mut RayPacket {
        &mut self.packets[self.count - 1]
    }

    /// Appends an empty packet and returns it with its path packet.
    #[inline(always)]
    pub(in crate::render) fn push_packet(&mut self) -> (&mut RayPacket, &mut PathPacket) {
        if self.count == self.packets.len() {
            self.packets.push(RayPacket::EMPTY);
            self.paths.push(PathPacket::EMPTY);
        }
        let last = self.count;
        self.count += 1;
        self.packets[last].recycle();
        (&mut self.packets[last], &mut self.paths[last])
    }

    /// Appends one ray to the packet for its direction.
    #[inline(always)]
    pub(in crate::render) fn push(&mut self, sent: &RayWorkItem) {
        let FreeLane { packet, lane } = self.free_lane(sent.ray.direction);
        // Write the ray, its pixel and its throughput
        self.packets[packet].set(lane, &sent.ray);
        self.paths[packet].pixel[lane] = sent.pixel;
        for channel in 0..3 {
            self.paths[packet].weight[channel][lane] = sent.weight[channel];
        }
        // Count the ray and write its optional state
        self.ray_types.count(sent);
        if let Some(accounts) = &mut self.accounts {
            accounts.resize(self.count.max(accounts.len()), [Category::Reflection; LANES]);
            accounts[packet][lane] = sent.account();
        }
        if let Some(travel) = &sent.travel {
            self.packets[packet].time[lane] = travel.time;
            self.path_states.resize(self.count);
            self.path_states.set(packet, lane, travel);
        }
    }

    /// Appends those of the rays from diffuse surfaces that are in `lanes`, in this order.
    pub(in crate::render) fn push_bounces(&mut self, rays: &RayLanes, states: &BouncedStates, lanes: &[u8]) {
        // Find a free lane for each
        let mut places = [0; LANES];
        for (place, &l) in places.iter_mut().zip(lanes) {
            let [x, y, z] = rays.direction.each_ref().map(|axis| axis[usize::from(l) % LANES]);
            *place = self.free_lane(Vec3::new(x, y, z)).index();
        }
        let places = &places[..lanes.len()];
        self.path_states.resize(self.count);
        // Write the rays, their pixels and their throughput
        let times = states.arrival.times();
        for (&place, &l) in places.iter().zip(lanes) {
            let (packet, lane, l) = (place / LANES, place % LANES, usize::from(l) % LANES);
            let (packet, path) = (&mut self.packets[packet], &mut self.paths[packet]);
            let ray = [rays.origin, rays.direction].map(|[x, y, z]| [x[l], y[l], z[l]]);
            packet.begin_ray(lane, ray, times[l]);
            path.pixel[lane] = rays.pixel[l];
            for channel in 0..3 {
                path.weight[channel][lane] = rays.weight[channel][l];
            }
        }
        self.path_states.set_bounced(states, places, lanes);
        // Count the rays
        let wavelengths = states.arrival.wavelengths();
        let is_color = |l: u8| wavelengths[usize::from(l) % LANES] != 0.0;
        let color_count = lanes.iter().filter(|&&l| is_color(l)).count() as u64;
        self.ray_types.bounced_colors += color_count;
        self.ray_types.bounced += lanes.len() as u64 - color_count;
        if let Some(accounts) = &mut self.accounts {
            accounts.resize(self.count.max(accounts.len()), [Category::Reflection; LANES]);
            let accounts = accounts.as_flattened_mut();
            for (&place, &l) in places.iter().zip(lanes) {
                accounts[place] = match is_color(l) {
                    true => Category::Dispersion,
                    false => Category::Interreflection,
                };
            }
        }
    }

    /// Returns the lane for the next ray of that direction, in a new packet if the one for such directions is full.
    #[inline(always)]
    fn free_lane(&mut self, direction: Vec3) -> FreeLane {
        let octant = match self.sorts_directions {
            true => octant(direction),
            false => 0,
        };
        if self.free[octant].lane == LANES {
            self.push_packet();
            self.free[octant] = FreeLane {
                packet: self.count - 1,
                lane: 0,
            };
        }
        let place = self.free[octant];
        self.free[octant].lane += 1;
        place
    }
}

/// Returns the index of the octant of a direction, from the signs of its coordinates.
#[inline(always)]
fn octant(direction: Vec3) -> usize {
    let [x, y, z] = direction.to_array().map(|axis| (axis.to_bits() >> 31) as usize);
    x | y << 1 | z << 2
}

/// View of the paths of consecutive packets of a generation.
#[derive(Clone, Copy)]
pub(in crate::render) struct Paths<'a> {
    paths: &'a [PathPacket],
    path_states: &'a PathStates,
    accounts: Option<&'a [Lanes<Category>]>,
    /// Index of the first packet of the view within the generation.
    first: usize,
}

impl<'a> Paths<'a> {
    /// Returns the path packet of packet `index`, and its path states if any effect needs them.
    #[inline(always)]
    pub(in crate::render) fn at(&self, index: usize) -> (&'a PathPacket, Option<PathStatePacket<'a>>) {
        let packet = self.first + index;
        let path_states = (!self.path_states.is_void()).then(|| self.path_states.at(packet));
        (&self.paths[packet], path_states)
    }

    /// Returns the pixel labels of packet `index` and the accounts of its rays: `otherwise` if rays have no own
    /// account.
    pub(in crate::render) fn labels_and_accounts(
        &self,
        index: usize,
        otherwise: Category,
    ) -> (&'a Lanes<u32>, Accounts<'a>) {
        let packet = self.first + index;
        let accounts = match self.accounts.and_then(|accounts| accounts.get(packet)) {
            Some(accounts) => Accounts::Each(accounts),
            None => Accounts::All(otherwise),
        };
        (&self.paths[packet].pixel, accounts)
    }

    /// Returns the view that begins at packet `first` of this one.
    pub(in crate::render) fn from(&self, first: usize) -> Paths<'a> {
        Paths {
            first: self.first + first,
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::numeric::SplitMix64;
    use crate::scene::Effect;

    /// Ray with the state of its path, in bits.
    #[derive(Debug, PartialEq)]
    struct QueuedRay {
        direction: [u32; 3],
        pixel: u32,
        weight: [u32; 3],
        counts: [u32; 4],
        density: f32,
    }

    /// Returns the rays of a queue in order.
    fn queued(queue: &mut RayQueue) -> Vec<QueuedRay> {
        let (packets, paths) = queue.parts();
        let mut rays = Vec::new();
        for (index, packet) in packets.iter().enumerate() {
            let (path, states) = paths.at(index);
            for l in (0..LANES).filter(|&l| packet.is_active(l)) {
                let state = states.unwrap().lane(l);
                let direction = packet.ray(l).direction;
                assert_eq!(state.direction.as_vec3(), direction);
                rays.push(QueuedRay {
                    direction: direction.to_array().map(f32::to_bits),
                    pixel: path.pixel[l],
                    weight: [0, 1, 2].map(|channel| path.weight[channel][l].to_bits()),
                    counts: [state.depth, state.bounces, state.sample, state.split],
                    density: state.density,
                });
            }
        }
        rays
    }

    #[test]
    fn bounces_queued_together_equal_those_queued_one_by_one_sorted_by_octant() {
        let effects = EffectSet::NONE
            .with(Effect::Interreflection)
            .with(Effect::Refraction)
            .with(Effect::RoughReflection)
            .with(Effect::AreaLight);
        let sorted = || RayQueue {
            sorts_directions: true,
            ..RayQueue::new(effects, true)
        };
        let mut random = SplitMix64::new(4, 1);
        // Queue rays that arrive at the surfaces
        let mut arriving = RayQueue::new(effects, true);
        for l in 0..LANES as u32 {
            let travel = PathState {
                depth: 3 + l,
                bounces: l % 3,
                sample: 7 * l,
                split: 1 + l % 2,
                density: 0.5,
                ..PathState::NONE
            };
            arriving.push(&RayWorkItem {
                ray: Ray::new(Vec3::ZERO, Vec3::X),
                pixel: l,
                weight: [1.0; 3],
                sender: Category::Interreflection,
                travel: Some(travel),
            });
        }
        let (_, paths) = arriving.parts();
        let (_, states) = paths.at(0);
        let arrival = states.unwrap();
        let (mut together, mut single) = (sorted(), sorted());
        for _ in 0..20 {
            // Bounce into random directions from some of the surfaces
            let (mut exact, mut direction, mut weight) =
                ([[0.0; LANES]; 3], [[0.0; LANES]; 3], [[0.0; LANES]; 3]);
            let pixel: Lanes<u32> = std::array::from_fn(|l| 100 + l as u32);
            for l in 0..LANES {
                let towards = random.direction();
                for axis in 0..3 {
                    exact[axis][l] = towards[axis];
                    direction[axis][l] = towards[axis] as f32;
                    weight[axis][l] = random.unit() as f32;
                }
            }
            let kept: Vec<u8> = (0..LANES as u8).filter(|_| random.unit() < 0.7).collect();
            let states = BouncedStates {
                arrival,
                direction: &exact,
                cone: &[PathState::NONE.cone; LANES],
            };
            let rays = RayLanes {
                origin: &[[0.5; LANES]; 3],
                direction: &direction,
                pixel: &pixel,
                weight: &weight,
            };
            together.push_bounces(&rays, &states, &kept);
            for l in kept.into_iter().map(usize::from) {
                let before = arrival.lane(l);
                single.push(&RayWorkItem {
                    ray: Ray::new(Vec3::splat(0.5), Vec3::from(direction.map(|axis| axis[l]))),
                    pixel: pixel[l],
                    weight: weight.map(|channel| channel[l]),
                    sender: Category::Interreflection,
                    travel: Some(PathState {
                        depth: before.depth + 1,
                        bounces: before.bounces + 1,
                        direction: DVec3::from(exact.map(|axis| axis[l])),
                        density: 0.0,
                        ..before
                    }),
                });
            }
        }
        assert_eq!(together.ray_types().bounced, single.ray_types().bounced);
        assert_eq!(queued(&mut together), queued(&mut single));
        // Each packet holds directions of one octant
        let (packets, _) = together.parts();
        assert!(packets.len() < 30, "{}", packets.len());
        for packet in packets {
            let directions = (0..LANES)
                .filter(|&l| packet.is_active(l))
                .map(|l| packet.ray(l).direction);
            let octants: Vec<usize> = directions.map(octant).collect();
            assert!(octants.iter().all(|&octant| octant == octants[0]), "{octants:?}");
        }
    }
}
