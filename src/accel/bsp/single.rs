//! The kernel for one ray: eight cells at a time, then eight triangles at a time.

use super::builder::MAX_DEPTH;
use super::counters;
use super::error_bounds::Line;
use super::node8::{Child, Leaf, Node, Tree8, WIDTH};
use super::two_level::TwoLevelTree;
use crate::accel::brute::ray_in;
use crate::accel::shape_query::shape_hit;
use crate::accel::{Hit, LANES, RayPacket};
use crate::mesh::simd::{SimdLevel, lanes};
use crate::mesh::triangle::{PACK, Shear};
use crate::numeric::Ray;
use crate::scene::Geometry;

/// Cells that can wait at most: every level leaves all but one of its children behind, and the last writes a full set.
pub(super) const STACK: usize = MAX_DEPTH * (WIDTH - 1) + 2 * WIDTH;

/// Cells that wait for their turn, and where the ray enters them. Made once and used for many rays.
pub(super) struct Stack([(f32, Child); STACK]);

impl Stack {
    /// An empty one for each level.
    pub(super) fn pair(root: Child) -> Box<[Stack; 2]> {
        Box::new(std::array::from_fn(|_| Stack([(0.0, root); STACK])))
    }
}

/// What a question wants to know.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Query {
    /// The nearest hit.
    Nearest,
    /// Whether there is one.
    Any,
}

/// One ray as the kernel sees it.
pub(super) struct RayState {
    pub(super) line: Line,
    pub(super) shear: Shear,
    pub(super) t_near: f32,
    /// Which of low and high bounds the ray meets first, by axis.
    first: [usize; 3],
    pub(super) octant: usize,
}

impl RayState {
    #[inline(always)]
    pub(super) fn new(ray: &Ray) -> RayState {
        let line = Line::new(ray.origin.to_array(), ray.direction.to_array());
        let falls = |axis| usize::from(!line.rises(axis));
        let first = [falls(0), falls(1), falls(2)];
        RayState {
            line,
            shear: Shear::new(ray),
            t_near: ray.t_near,
            first,
            octant: first[0] | first[1] << 1 | first[2] << 2,
        }
    }
}

/// The best hit so far, by the numbers of one tree. It starts as a hit at the ray's end that every other one beats.
#[derive(Clone, Copy)]
pub(super) struct HitRecord {
    pub(super) t: f32,
    pub(super) u: f32,
    pub(super) v: f32,
    pub(super) number: u32,
    /// Where `number` is that of a placed mesh or a shape: its triangle or part.
    pub(super) primitive: u32,
}

impl HitRecord {
    #[inline(always)]
    pub(super) fn nothing(t_far: f32) -> HitRecord {
        HitRecord {
            t: t_far.min(f32::MAX),
            u: 0.0,
            v: 0.0,
            number: u32::MAX,
            primitive: u32::MAX,
        }
    }

    /// The start of a search within the placed mesh that has the number `number` in the world: what is found there at
    /// the same parameter must count exactly if (number, primitive) is smaller than what is known.
    #[inline(always)]
    pub(super) fn within(&self, number: u32) -> HitRecord {
        let bar = match number.cmp(&self.number) {
            std::cmp::Ordering::Less => u32::MAX,
            std::cmp::Ordering::Equal => self.primitive,
            std::cmp::Ordering::Greater => 0,
        };
        HitRecord { number: bar, ..*self }
    }

    #[inline(always)]
    pub(super) fn is_beaten_by(&self, t: f32, number: u32) -> bool {
        t < self.t || (t == self.t && number < self.number)
    }
}

/// Asks one ray after the other.
#[inline(always)]
pub(super) fn trace_singles(
    isa: impl SimdLevel,
    levels: &TwoLevelTree<Tree8>,
    packets: &mut [RayPacket],
    question: Query,
) {
    let mut stacks = Stack::pair(levels.world.tree.root());
    for packet in packets {
        packet.drop_untraceable();
        for lane in 0..LANES {
            if packet.is_active(lane) {
                trace_lane(isa, levels, (packet, lane), question, &mut stacks);
            }
        }
    }
}

/// Asks one lane.
#[inline(always)]
pub(super) fn trace_lane(
    isa: impl SimdLevel,
    levels: &TwoLevelTree<Tree8>,
    (packet, lane): (&mut RayPacket, usize),
    question: Query,
    stacks: &mut [Stack; 2],
) {
    let ray = packet.ray(lane);
    let [world_stack, object_stack] = stacks;
    let mut found = HitRecord::nothing(ray.t_far);
    let beam = RayState::new(&ray);
    let is_hit = walk(
        isa,
        &levels.world.tree,
        &beam,
        &mut found,
        (question, world_stack),
        |number, found| ask_whole(isa, levels, (&ray, number), found, (question, object_stack)),
    );
    match question {
        Query::Any if is_hit => packet.set_blocked(lane),
        Query::Nearest if is_hit => packet.set_hit(lane, &hit_of(levels, &found)),
        _ => (),
    }
}

#[inline(always)]
pub(super) fn hit_of(levels: &TwoLevelTree<Tree8>, found: &HitRecord) -> Hit {
    levels.hit(found.number, found.primitive, [found.t, found.u, found.v])
}

/// Asks a shape or a placed mesh; whether it was hit, nearer than what is known.
#[inline(always)]
pub(super) fn ask_whole(
    isa: impl SimdLevel,
    levels: &TwoLevelTree<Tree8>,
    (ray, number): (&Ray, u32),
    found: &mut HitRecord,
    (question, stack): (Query, &mut Stack),
) -> bool {
    let run = levels.world.primitives.run(number);
    if !levels.lets_through(run.instance, ray) {
        return false;
    }
    let instance = &levels.scene.instances[run.instance as usize];
    match &levels.scene.geometries[instance.geometry as usize] {
        Geometry::Shape(shape) => match shape_hit(run.instance, instance, shape, ray) {
            Some(hit) if found.is_beaten_by(hit.t, number) => {
                *found = HitRecord {
                    t: hit.t,
                    number,
                    primitive: hit.primitive,
                    u: 0.0,
                    v: 0.0,
                };
                true
            }
            _ => false,
        },
        Geometry::Mesh(_) => {
            let Some(object) = &levels.objects[instance.geometry as usize] else {
                return false;
            };
            let mut inner = found.within(number);
            let beam = RayState::new(&ray_in(instance, ray));
            let is_hit = walk(isa, &object.tree, &beam, &mut inner, (question, stack), |_, _| {
                false
            });
            if is_hit {
                *found = HitRecord {
                    number,
                    primitive: inner.number,
                    ..inner
                };
            }
            is_hit
        }
    }
}

/// Walks one tree; whether anything was hit. `ask` is shown the numbers that are no triangles.
#[inline(always)]
fn walk(
    isa: impl SimdLevel,
    tree: &Tree8,
    beam: &RayState,
    found: &mut HitRecord,
    (question, stack): (Query, &mut Stack),
    mut ask: impl FnMut(u32, &mut HitRecord) -> bool,
) -> bool {
    let mut is_hit = false;
    let mut child = tree.root();
    let mut waiting = 0;
    loop {
        while let Some(index) = child.node() {
            waiting = enter(isa, tree.node(index), (beam, found.t), stack, waiting);
            match next(stack, &mut waiting, found.t) {
                Some(nearest) => child = nearest,
                None => return is_hit,
            }
        }
        let Leaf { packs, wholes } = tree.leaf(child);
        for pack in packs {
            counters::pack();
            let hits = beam
                .shear
                .intersect_pack(isa, &pack.triangles, beam.t_near, found.t);
            for lane in lanes(hits.mask) {
                if question == Query::Any {
                    return true;
                }
                let lane = lane % PACK;
                if found.is_beaten_by(hits.t[lane], pack.numbers[lane]) {
                    is_hit = true;
                    found.t = hits.t[lane];
                    found.u = hits.u[lane];
                    found.v = hits.v[lane];
                    found.number = pack.numbers[lane];
                }
            }
        }
        for &number in wholes {
            is_hit |= ask(number, found);
            if is_hit && question == Query::Any {
                return true;
            }
        }
        match next(stack, &mut waiting, found.t) {
            Some(nearest) => child = nearest,
            None => return is_hit,
        }
    }
}

/// Takes the next cell that the ray enters before `t`.
#[inline(always)]
fn next(stack: &Stack, waiting: &mut usize, t: f32) -> Option<Child> {
    while *waiting > 0 {
        *waiting -= 1;
        let (enters, child) = stack.0[*waiting];
        if enters <= t {
            return Some(child);
        }
    }
    None
}

/// Puts the children that the ray meets up to `t_far` on the stack, the nearest on top; returns how many wait now.
#[inline(always)]
fn enter(
    isa: impl SimdLevel,
    node: &Node,
    (beam, t_far): (&RayState, f32),
    stack: &mut Stack,
    waiting: usize,
) -> usize {
    counters::node();
    let mut near = [beam.t_near; WIDTH];
    let mut far = [t_far; WIDTH];
    for axis in 0..3 {
        let first = beam.first[axis] & 1;
        let near_bounds = &node.bounds[first][axis];
        let far_bounds = &node.bounds[1 - first][axis];
        let (origin, enter, leave) = (
            beam.line.origin[axis],
            beam.line.enter[axis],
            beam.line.leave[axis],
        );
        for i in 0..WIDTH {
            let t0 = (near_bounds[i] - origin) * enter;
            let t1 = (far_bounds[i] - origin) * leave;
            // NaN, from a ray within a face, leaves the interval as it is.
            near[i] = if t0 > near[i] { t0 } else { near[i] };
            far[i] = if t1 < far[i] { t1 } else { far[i] };
        }
    }
    let mask = isa.le(&near, &far);
    if mask == 0 {
        return waiting;
    }
    let order = node.far_to_near[beam.octant & 7];
    let Some(slots) = stack.0[waiting..].first_chunk_mut::<WIDTH>() else {
        return waiting;
    };
    let mut count = 0;
    for i in 0..WIDTH {
        let slot = (order >> (4 * i)) as usize & (WIDTH - 1);
        // Written always, kept where it is met: no branch to mispredict.
        slots[count & (WIDTH - 1)] = (near[slot], node.children[slot]);
        count += (mask >> slot & 1) as usize;
    }
    waiting + count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tie_within_a_placed_mesh_goes_to_the_smaller_instance_then_to_the_smaller_triangle() {
        let known = HitRecord {
            t: 1.0,
            number: 5,
            primitive: 7,
            ..HitRecord::nothing(9.0)
        };
        assert!(known.within(4).is_beaten_by(1.0, 1000));
        assert!(!known.within(6).is_beaten_by(1.0, 0));
        assert!(known.within(5).is_beaten_by(1.0, 6));
        assert!(!known.within(5).is_beaten_by(1.0, 7));
        assert!(known.within(6).is_beaten_by(1f32.next_down(), 0));
    }

    #[test]
    fn a_hit_at_the_very_end_of_the_ray_counts() {
        assert!(HitRecord::nothing(2.0).is_beaten_by(2.0, 0));
        assert!(!HitRecord::nothing(2.0).is_beaten_by(2f32.next_up(), 0));
    }
}
