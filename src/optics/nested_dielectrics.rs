//! Nested dielectrics by priority: the medium of a ray where interiors overlap.
//!
//! Solids that touch, such as water in a glass, are modelled as overlapping, because with coincident surfaces rounding
//! decides which is hit first. Every interior has a priority, and where several overlap only the one of highest
//! priority is present; a boundary is real only if it changes which interior is present (Schmidt and Budge, "Simple
//! Nested Dielectrics in Ray Traced Images", Journal of Graphics Tools 7(2), 2002). Equal priorities are resolved by
//! the lower id.
//!
//! A hit at an edge may be reported twice or not at all. So an interior is in the list at most once, entering it twice
//! or leaving it unentered has no effect, and each such event is counted.

/// Largest number of interiors that may overlap at one point of a ray's path.
pub const MAX_NESTED_INTERIORS: usize = 8;

/// Closed interior of some medium. Parts of one interior must not overlap each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NestedInterior {
    /// Identifier that is unique among interiors.
    pub id: u32,
    /// Priority where interiors overlap: only the highest is present.
    pub priority: i32,
}

impl NestedInterior {
    /// Returns whether this interior displaces `other` where both overlap.
    #[inline(always)]
    fn has_priority_over(self, other: NestedInterior) -> bool {
        (self.priority, other.id) > (other.priority, self.id)
    }
}

/// Value of unused slots of the list, so that equal lists compare equal.
const NO_INTERIOR: NestedInterior = NestedInterior { id: 0, priority: 0 };

/// Direction in which a ray crosses the surface of an interior.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoundaryEvent {
    /// Entry of the ray into the interior.
    Enter,
    /// Exit of the ray from the interior.
    Leave,
}

/// Effect of a surface on the medium of a ray that passes through it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundaryCrossing {
    /// Interior present on the near side; `None` for the outside.
    pub before: Option<NestedInterior>,
    /// Interior present on the far side; `None` for the outside.
    pub after: Option<NestedInterior>,
    /// Interiors around a ray after passing through; a reflected ray keeps those it had.
    pub through: InteriorStack,
}

impl BoundaryCrossing {
    /// Returns whether the medium changes. If not, the ray continues as if there were no surface.
    #[inline(always)]
    pub fn is_real(&self) -> bool {
        self.before.map(|interior| interior.id) != self.after.map(|interior| interior.id)
    }
}

/// Interiors around a point of a ray's path, the one that is present first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InteriorStack {
    /// Interiors in descending order of precedence; only the first `count` slots are valid.
    interiors: [NestedInterior; MAX_NESTED_INTERIORS],
    count: u8,
    anomalies: u8,
}

impl Default for InteriorStack {
    fn default() -> InteriorStack {
        InteriorStack::EMPTY
    }
}

impl InteriorStack {
    /// Stack of a point outside of all interiors.
    pub const EMPTY: InteriorStack = InteriorStack {
        interiors: [NO_INTERIOR; MAX_NESTED_INTERIORS],
        count: 0,
        anomalies: 0,
    };

    /// Creates the stack of a point inside one interior.
    #[inline(always)]
    pub fn of(interior: NestedInterior) -> InteriorStack {
        let mut stack = InteriorStack::EMPTY;
        stack.interiors[0] = interior;
        stack.count = 1;
        stack
    }

    /// Returns the interior that is present; `None` outside of all.
    #[inline(always)]
    pub fn current(&self) -> Option<NestedInterior> {
        self.interiors().first().copied()
    }

    /// Returns all interiors around the point, the one that is present first.
    #[inline(always)]
    pub fn interiors(&self) -> &[NestedInterior] {
        &self.interiors[..usize::from(self.count)]
    }

    /// Returns the number of impossible events: interiors entered twice, left without being entered, or too many at
    /// once. Saturates at 255.
    pub fn anomalies(&self) -> u8 {
        self.anomalies
    }

    /// Returns the effect of the surface of `interior` on a ray inside these interiors.
    #[inline(always)]
    pub fn crossing(&self, interior: NestedInterior, event: BoundaryEvent) -> BoundaryCrossing {
        BoundaryCrossing {
            before: self.current(),
            after: self.after(interior, event),
            through: self.through(interior, event),
        }
    }

    /// Returns the interior that is present behind the surface of `interior`; `None` for the outside.
    #[inline(always)]
    pub fn after(&self, interior: NestedInterior, event: BoundaryEvent) -> Option<NestedInterior> {
        let current = self.current();
        match event {
            BoundaryEvent::Enter => current
                .filter(|present| present.has_priority_over(interior))
                .or(Some(interior)),
            BoundaryEvent::Leave if current.is_some_and(|present| present.id == interior.id) => {
                self.interiors().get(1).copied()
            }
            BoundaryEvent::Leave => current,
        }
    }

    /// Returns the interiors around a ray behind the surface of `interior`.
    #[inline(always)]
    pub fn through(&self, interior: NestedInterior, event: BoundaryEvent) -> InteriorStack {
        let mut through = *self;
        match event {
            BoundaryEvent::Enter => through.enter(interior),
            BoundaryEvent::Leave => through.leave(interior.id),
        }
        through
    }

    /// Adds `interior`. If the list is full, the interior of lowest precedence is dropped.
    pub fn enter(&mut self, interior: NestedInterior) {
        if self.position(interior.id).is_some() {
            return self.count_anomaly();
        }
        // Find the slot by descending precedence
        let count = usize::from(self.count);
        let slot = self
            .interiors()
            .iter()
            .take_while(|other| other.has_priority_over(interior))
            .count();
        if count == MAX_NESTED_INTERIORS {
            self.count_anomaly();
            if slot == MAX_NESTED_INTERIORS {
                return;
            }
        } else {
            self.count += 1;
        }
        // Shift the lower ones and insert
        let last = count.min(MAX_NESTED_INTERIORS - 1);
        self.interiors.copy_within(slot..last, slot + 1);
        self.interiors[slot] = interior;
    }

    /// Removes the interior `id`; counts an anomaly if it is not in the list.
    pub fn leave(&mut self, id: u32) {
        let Some(slot) = self.position(id) else {
            return self.count_anomaly();
        };
        self.interiors
            .copy_within(slot + 1..usize::from(self.count), slot);
        self.count -= 1;
        self.interiors[usize::from(self.count)] = NO_INTERIOR;
    }

    /// Returns the slot of the interior `id`.
    fn position(&self, id: u32) -> Option<usize> {
        self.interiors().iter().position(|interior| interior.id == id)
    }

    /// Counts an impossible event, saturating at 255.
    fn count_anomaly(&mut self) {
        self.anomalies = self.anomalies.saturating_add(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WATER: NestedInterior = NestedInterior { id: 1, priority: 10 };
    const ICE: NestedInterior = NestedInterior { id: 2, priority: 20 };
    const GLASS: NestedInterior = NestedInterior { id: 3, priority: 30 };

    fn around(interiors: &[NestedInterior]) -> InteriorStack {
        let mut stack = InteriorStack::EMPTY;
        interiors.iter().for_each(|interior| stack.enter(*interior));
        stack
    }

    fn ids(stack: &InteriorStack) -> Vec<u32> {
        stack.interiors().iter().map(|interior| interior.id).collect()
    }

    /// Crosses surfaces one after the other and returns the real boundaries: the ids before and after, 0 for the
    /// outside.
    fn walk(surfaces: &[(NestedInterior, BoundaryEvent)]) -> (Vec<(u32, u32)>, InteriorStack) {
        let mut stack = InteriorStack::EMPTY;
        let mut real = Vec::new();
        let id = |interior: Option<NestedInterior>| interior.map_or(0, |interior| interior.id);
        for (interior, event) in surfaces {
            let crossing = stack.crossing(*interior, *event);
            if crossing.is_real() {
                real.push((id(crossing.before), id(crossing.after)));
            }
            stack = crossing.through;
        }
        (real, stack)
    }

    #[test]
    fn a_ray_through_ice_in_water_in_a_glass_sees_each_medium_once() {
        // The water extends into the wall of the glass, the ice floats inside the water.
        let (real, stack) = walk(&[
            (GLASS, BoundaryEvent::Enter),
            (WATER, BoundaryEvent::Enter),
            (GLASS, BoundaryEvent::Leave),
            (ICE, BoundaryEvent::Enter),
            (ICE, BoundaryEvent::Leave),
            (GLASS, BoundaryEvent::Enter),
            (WATER, BoundaryEvent::Leave),
            (GLASS, BoundaryEvent::Leave),
        ]);
        assert_eq!(real, [(0, 3), (3, 1), (1, 2), (2, 1), (1, 3), (3, 0)]);
        assert_eq!(stack, InteriorStack::EMPTY);
    }

    #[test]
    fn ice_that_rises_above_the_water_leaves_into_air() {
        let (real, stack) = walk(&[
            (WATER, BoundaryEvent::Enter),
            (ICE, BoundaryEvent::Enter),
            (WATER, BoundaryEvent::Leave),
            (ICE, BoundaryEvent::Leave),
        ]);
        assert_eq!(real, [(0, 1), (1, 2), (2, 0)]);
        assert_eq!(stack, InteriorStack::EMPTY);
    }

    #[test]
    fn reflected_ray_keeps_its_media_and_transmitted_ray_adds_one() {
        let stack = around(&[WATER]);
        let crossing = stack.crossing(ICE, BoundaryEvent::Enter);
        assert_eq!(ids(&stack), [1]);
        assert_eq!(ids(&crossing.through), [2, 1]);
    }

    #[test]
    fn camera_inside_media_starts_with_them() {
        let stack = around(&[WATER, ICE]);
        let crossing = stack.crossing(ICE, BoundaryEvent::Leave);
        assert!(crossing.is_real());
        assert_eq!((crossing.before, crossing.after), (Some(ICE), Some(WATER)));
        // If the start were taken to be outside, the first surface would only be counted as an anomaly.
        let crossing = InteriorStack::EMPTY.crossing(ICE, BoundaryEvent::Leave);
        assert!(!crossing.is_real());
        assert_eq!(crossing.through.anomalies(), 1);
    }

    #[test]
    fn interior_behind_a_surface_is_that_of_the_list_behind_it() {
        let all = [WATER, ICE, GLASS, NestedInterior { id: 0, priority: 20 }];
        // Visit all lists of up to three of these interiors
        for members in all
            .into_iter()
            .flat_map(|a| all.map(|b| all.map(|c| [a, b, c])))
            .flatten()
        {
            for count in 0..=members.len() {
                let stack = around(&members[..count]);
                for (interior, event) in all.into_iter().flat_map(|interior| {
                    [BoundaryEvent::Enter, BoundaryEvent::Leave].map(|event| (interior, event))
                }) {
                    let expected = stack.through(interior, event).current();
                    assert_eq!(
                        stack.after(interior, event),
                        expected,
                        "{stack:?} {interior:?} {event:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn equal_priority_media_are_ordered_by_lower_id() {
        let (a, b) = (
            NestedInterior { id: 7, priority: 5 },
            NestedInterior { id: 9, priority: 5 },
        );
        assert_eq!(around(&[a, b]).current(), Some(a));
        assert_eq!(around(&[b, a]).current(), Some(a));
    }

    #[test]
    fn the_order_of_entering_does_not_matter() {
        let expected = around(&[WATER, ICE, GLASS]);
        for order in [
            [WATER, GLASS, ICE],
            [ICE, WATER, GLASS],
            [ICE, GLASS, WATER],
            [GLASS, WATER, ICE],
            [GLASS, ICE, WATER],
        ] {
            assert_eq!(around(&order), expected);
        }
        assert_eq!(ids(&expected), [3, 2, 1]);
    }

    #[test]
    fn a_surface_reported_twice_changes_nothing_but_the_count() {
        let (real, stack) = walk(&[
            (WATER, BoundaryEvent::Enter),
            (WATER, BoundaryEvent::Enter),
            (WATER, BoundaryEvent::Leave),
            (WATER, BoundaryEvent::Leave),
        ]);
        assert_eq!(real, [(0, 1), (1, 0)]);
        assert_eq!((stack.current(), stack.anomalies()), (None, 2));
    }

    #[test]
    fn too_many_media_drop_the_lowest_priority() {
        let interiors: Vec<NestedInterior> = (0..9)
            .map(|id| NestedInterior {
                id,
                priority: id as i32,
            })
            .collect();
        let stack = around(&interiors);
        assert_eq!(ids(&stack), [8, 7, 6, 5, 4, 3, 2, 1]);
        assert_eq!(stack.anomalies(), 1);
        let mut stack = around(&interiors[1..]);
        stack.enter(interiors[0]);
        assert_eq!(ids(&stack), [8, 7, 6, 5, 4, 3, 2, 1]);
        assert_eq!(stack.anomalies(), 1);
    }

    #[test]
    fn anomalies_do_not_overflow() {
        let mut stack = InteriorStack::EMPTY;
        (0..300).for_each(|_| stack.leave(1));
        assert_eq!(stack.anomalies(), 255);
    }
}
