//! Single-ray traversal kernel: eight cells at a time, then eight triangles at a time.

use super::builder::MAX_DEPTH;
use super::counters;
use super::error_bounds::Line;
use super::node8::{Child, Leaf, Node8, Tree8, WIDTH};
use super::two_level::TwoLevelTree;
use crate::accel::brute::ray_in;
use crate::accel::shape_query::{point_hit, shape_hit};
use crate::accel::{Hit, LANES, Query, RayPacket};
use crate::mesh::simd::{SimdLevel, lanes};
use crate::mesh::triangle::{PACK, Shear};
use crate::numeric::Ray;
use crate::scene::Geometry;

/// Maximum number of stack entries: every level leaves all but one of its children behind, and the last writes a full
/// set.
pub(super) const STACK: usize = MAX_DEPTH * (WIDTH - 1) + 2 * WIDTH;

/// Traversal stack of cells with their entry parameters. Allocated once for many rays.
pub(super) struct NodeStack([(f32, Child); STACK]);

impl NodeStack {
    /// Allocates an empty stack for each of the two levels.
    pub(super) fn pair(root: Child) -> Box<[NodeStack; 2]> {
        Box::new(std::array::from_fn(|_| NodeStack([(0.0, root); STACK])))
    }
}

/// Ray with precomputed data for slab and triangle tests.
pub(super) struct RayState {
    pub(super) line: Line,
    pub(super) shear: Shear,
    pub(super) t_near: f32,
    /// Side of the box that the ray enters first, by axis: 0 for the low bound, 1 for the high one.
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

/// Nearest hit so far, by the indices of one tree. It is initialized as a hit at the ray's end that every other one
/// replaces.
#[derive(Clone, Copy)]
pub(super) struct HitRecord {
    pub(super) t: f32,
    pub(super) u: f32,
    pub(super) v: f32,
    pub(super) number: u32,
    /// Triangle or part, if `number` is that of an instanced mesh or a shape.
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

    /// Returns the initial record for a search within the instanced mesh with index `number` in the world: a hit there
    /// at the same parameter must count exactly if (number, primitive) is smaller than that of the record.
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

    /// Replaces the record by a hit on a shape or a point with index `number`, if that comes first; returns whether it
    /// does.
    #[inline(always)]
    fn offer(&mut self, number: u32, hit: Option<Hit>) -> bool {
        let Some(hit) = hit.filter(|hit| self.is_beaten_by(hit.t, number)) else {
            return false;
        };
        *self = HitRecord {
            t: hit.t,
            number,
            primitive: hit.primitive,
            u: 0.0,
            v: 0.0,
        };
        true
    }
}

/// Traces one ray after the other.
#[inline(always)]
pub(super) fn trace_singles(
    isa: impl SimdLevel,
    levels: &TwoLevelTree<Tree8>,
    packets: &mut [RayPacket],
    query: Query,
) {
    let mut stacks = NodeStack::pair(levels.world.tree.root());
    for packet in packets {
        packet.drop_untraceable();
        for lane in 0..LANES {
            if packet.is_active(lane) {
                trace_lane(isa, levels, (packet, lane), query, &mut stacks);
            }
        }
    }
}

/// Traces the ray of one lane.
#[inline(always)]
pub(super) fn trace_lane(
    isa: impl SimdLevel,
    levels: &TwoLevelTree<Tree8>,
    (packet, lane): (&mut RayPacket, usize),
    query: Query,
    stacks: &mut [NodeStack; 2],
) {
    // Traverse the world tree
    let ray = packet.ray(lane);
    let [world_stack, object_stack] = stacks;
    let mut found = HitRecord::nothing(ray.t_far);
    let ray_state = RayState::new(&ray);
    let is_hit = traverse(
        isa,
        &levels.world.tree,
        &ray_state,
        &mut found,
        (query, world_stack),
        |number, found| intersect_instance(isa, levels, (&ray, number), found, (query, object_stack)),
    );
    // Write the result into the packet
    match query {
        Query::Any if is_hit => packet.set_blocked(lane),
        Query::Nearest if is_hit => packet.set_hit(lane, &hit_of(levels, &found)),
        _ => (),
    }
}

#[inline(always)]
pub(super) fn hit_of(levels: &TwoLevelTree<Tree8>, found: &HitRecord) -> Hit {
    levels.hit(found.number, found.primitive, [found.t, found.u, found.v])
}

/// Intersects a shape, a point of a cloud or an instanced mesh as a whole; returns whether the hit replaces the record.
#[inline(always)]
pub(super) fn intersect_instance(
    isa: impl SimdLevel,
    levels: &TwoLevelTree<Tree8>,
    (ray, number): (&Ray, u32),
    found: &mut HitRecord,
    (query, stack): (Query, &mut NodeStack),
) -> bool {
    let run = levels.world.primitives.run(number);
    // Cull by the bounding sphere
    if !levels.may_hit(run.instance, ray) {
        return false;
    }
    let instance = &levels.scene.instances[run.instance as usize];
    // Intersect the shape, or transform the ray and traverse the mesh's own tree
    match &levels.scene.geometries[instance.geometry as usize] {
        Geometry::Shape(shape) => found.offer(number, shape_hit(run.instance, instance, shape, ray)),
        Geometry::Points(cloud) => {
            let point = number - run.first;
            found.offer(number, point_hit(run.instance, instance, cloud, point, ray))
        }
        Geometry::Mesh(_) => {
            let Some(object) = &levels.objects[instance.geometry as usize] else {
                return false;
            };
            // Break ties against the record of the world
            let mut inner = found.within(number);
            let ray_state = RayState::new(&ray_in(instance, ray));
            let is_hit = traverse(
                isa,
                &object.tree,
                &ray_state,
                &mut inner,
                (query, stack),
                |_, _| false,
            );
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

/// Traverses one tree and returns whether anything was hit. `visit` is called with the indices of primitives other than
/// triangles.
#[inline(always)]
fn traverse(
    isa: impl SimdLevel,
    tree: &Tree8,
    ray_state: &RayState,
    found: &mut HitRecord,
    (query, stack): (Query, &mut NodeStack),
    mut visit: impl FnMut(u32, &mut HitRecord) -> bool,
) -> bool {
    let mut is_hit = false;
    let mut child = tree.root();
    let mut waiting = 0;
    loop {
        // Descend to the nearest leaf
        while let Some(index) = child.node() {
            waiting = enter(isa, tree.node(index), (ray_state, found.t), stack, waiting);
            match next(stack, &mut waiting, found.t) {
                Some(nearest) => child = nearest,
                None => return is_hit,
            }
        }
        let Leaf { packs, wholes } = tree.leaf(child);
        // Intersect the triangles of the leaf, eight at a time
        for pack in packs {
            counters::pack();
            let hits = ray_state
                .shear
                .intersect_pack(isa, &pack.triangles, ray_state.t_near, found.t);
            for lane in lanes(hits.mask) {
                if query == Query::Any {
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
        // Intersect shapes and instanced meshes of the leaf
        for &number in wholes {
            is_hit |= visit(number, found);
            if is_hit && query == Query::Any {
                return true;
            }
        }
        // Continue with the next cell on the stack
        match next(stack, &mut waiting, found.t) {
            Some(nearest) => child = nearest,
            None => return is_hit,
        }
    }
}

/// Pops the next cell that the ray enters before `t`.
#[inline(always)]
fn next(stack: &NodeStack, waiting: &mut usize, t: f32) -> Option<Child> {
    while *waiting > 0 {
        *waiting -= 1;
        let (enters, child) = stack.0[*waiting];
        if enters <= t {
            return Some(child);
        }
    }
    None
}

/// Pushes the children that the ray intersects up to `t_far`, the nearest on top; returns the new stack size.
#[inline(always)]
fn enter(
    isa: impl SimdLevel,
    node: &Node8,
    (ray_state, t_far): (&RayState, f32),
    stack: &mut NodeStack,
    waiting: usize,
) -> usize {
    counters::node();
    // Intersect the ray with the eight boxes by the slab method
    let mut near = [ray_state.t_near; WIDTH];
    let mut far = [t_far; WIDTH];
    for axis in 0..3 {
        let first = ray_state.first[axis] & 1;
        let near_bounds = &node.bounds[first][axis];
        let far_bounds = &node.bounds[1 - first][axis];
        let (origin, enter, leave) = (
            ray_state.line.origin[axis],
            ray_state.line.enter[axis],
            ray_state.line.leave[axis],
        );
        for i in 0..WIDTH {
            let t0 = (near_bounds[i] - origin) * enter;
            let t1 = (far_bounds[i] - origin) * leave;
            // NaN, from a ray within a face, leaves the interval unchanged.
            near[i] = if t0 > near[i] { t0 } else { near[i] };
            far[i] = if t1 < far[i] { t1 } else { far[i] };
        }
    }
    let mask = isa.le(&near, &far);
    if mask == 0 {
        return waiting;
    }
    // Push the children from far to near, in the order stored for the octant
    let order = node.far_to_near[ray_state.octant & 7];
    let Some(slots) = stack.0[waiting..].first_chunk_mut::<WIDTH>() else {
        return waiting;
    };
    let mut count = 0;
    for i in 0..WIDTH {
        let slot = (order >> (4 * i)) as usize & (WIDTH - 1);
        // Write always, and advance only for a child that is hit: no branch to mispredict.
        slots[count & (WIDTH - 1)] = (near[slot], node.children[slot]);
        count += (mask >> slot & 1) as usize;
    }
    waiting + count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tie_goes_to_lower_instance_then_to_lower_triangle() {
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
    fn hit_at_t_far_counts() {
        assert!(HitRecord::nothing(2.0).is_beaten_by(2.0, 0));
        assert!(!HitRecord::nothing(2.0).is_beaten_by(2f32.next_up(), 0));
    }
}
