//! Interval of a line inside a convex solid: a range of `t`, with the part of the surface at either end.
//!
//! Cyrus and Beck (1978): the interval inside an intersection of convex sets is the intersection of the intervals.
//! Comparisons are closed (≤) and nothing is compared with an epsilon, so a ray in a face, through an edge or through a
//! vertex has one definite result that is consistent for all adjacent parts.

use super::{Implicit, OriginSurface, ShapeHit, ShapeRay, Side};

/// Range [-1, 1] of most shapes along most axes.
pub(super) const UNIT: [f64; 2] = [-1.0, 1.0];

/// Interval of the line's parameter; empty if `enter.t > exit.t`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) enter: ShapeHit,
    pub(super) exit: ShapeHit,
}

impl Span {
    /// Interval of the whole line.
    pub(super) const ALL: Span = Span::new(f64::NEG_INFINITY, f64::INFINITY, 0);
    /// Empty interval, for a line that misses.
    pub(super) const NONE: Span = Span::new(f64::INFINITY, f64::NEG_INFINITY, 0);

    /// Creates the interval [t0, t1] inside one surface.
    #[inline(always)]
    pub(super) const fn new(t0: f64, t1: f64, part: u32) -> Span {
        Span {
            enter: ShapeHit { t: t0, part },
            exit: ShapeHit { t: t1, part },
        }
    }

    /// Returns the overlap of both intervals; at equal ends `self` has precedence.
    #[inline(always)]
    pub(super) fn overlap(self, other: Span) -> Span {
        Span {
            enter: if other.enter.t > self.enter.t {
                other.enter
            } else {
                self.enter
            },
            exit: if other.exit.t < self.exit.t {
                other.exit
            } else {
                self.exit
            },
        }
    }

    /// Returns the interval inside `low <= x <= high` for a coordinate given by `o + t d`.
    #[inline(always)]
    pub(super) fn slab(o: f64, d: f64, [low, high]: [f64; 2], [low_part, high_part]: [u32; 2]) -> Span {
        if d == 0.0 {
            return if low <= o && o <= high {
                Span::ALL
            } else {
                Span::NONE
            };
        }
        let low = ShapeHit {
            t: (low - o) / d,
            part: low_part,
        };
        let high = ShapeHit {
            t: (high - o) / d,
            part: high_part,
        };
        if d > 0.0 {
            Span {
                enter: low,
                exit: high,
            }
        } else {
            Span {
                enter: high,
                exit: low,
            }
        }
    }

    /// Returns whether the interval contains `t`.
    #[inline(always)]
    pub(super) fn contains(&self, t: f64) -> bool {
        self.enter.t <= t && t <= self.exit.t
    }

    /// Returns the hits on the surface of a convex solid whose interior is this interval.
    ///
    /// A ray that starts on the surface and goes outside never returns. One that goes inside starts in the closed
    /// solid, so its exit is not behind it, regardless of rounding; and it does not exit through the part that it
    /// started on unless that part is curved.
    #[inline(always)]
    pub(super) fn crossings_of_convex(&self, ray: &ShapeRay, own_is_curved: bool) -> Crossings {
        // A ray from elsewhere hits both ends
        match ray.origin_surface {
            None if self.enter.t <= self.exit.t => [self.enter, self.exit],
            None => NO_HITS,
            // A ray from the surface to the outside hits nothing
            Some(OriginSurface {
                side: Side::Outside, ..
            }) => NO_HITS,
            // A ray from the surface to the inside hits another part, or its own if curved
            Some(OriginSurface { part, .. }) => {
                let ShapeHit { t, part: exit } = self.exit;
                if exit != part {
                    [
                        NO_HIT,
                        ShapeHit {
                            t: t.max(0.0),
                            part: exit,
                        },
                    ]
                } else if own_is_curved && t > 0.0 {
                    [NO_HIT, self.exit]
                } else {
                    NO_HITS
                }
            }
        }
    }
}

/// Returns the hits on an open surface: a convex wall, whose interior covers the interval `wall` of the line, clipped
/// to `clip`.
///
/// A ray that starts on the outer side never returns; from the inside, only the far wall lies ahead.
#[inline(always)]
pub(super) fn crossings_of_wall(wall: &Span, clip: &Span, ray: &ShapeRay) -> Crossings {
    let cut = |hit: ShapeHit| if clip.contains(hit.t) { hit } else { NO_HIT };
    match ray.origin_surface {
        None if wall.enter.t <= wall.exit.t => [cut(wall.enter), cut(wall.exit)],
        Some(OriginSurface {
            side: Side::Inside, ..
        }) if wall.exit.t > 0.0 => [NO_HIT, cut(wall.exit)],
        _ => NO_HITS,
    }
}

/// Surface that a line hits twice at most.
pub(super) trait TwoHits: Implicit {
    /// Returns the hits of the ray.
    fn intersections(&self, ray: &ShapeRay) -> Crossings;
}

/// Up to two hits in ascending `t`; a missing hit has `t` NaN.
pub(super) type Crossings = [ShapeHit; 2];

/// Missing hit, whose parameter is NaN.
pub(super) const NO_HIT: ShapeHit = ShapeHit { t: f64::NAN, part: 0 };

/// Pair of missing hits, for a ray that misses.
pub(super) const NO_HITS: Crossings = [NO_HIT; 2];

/// Returns the first hit in the ray's range.
#[inline(always)]
pub(super) fn nearest(ray: &ShapeRay, [first, second]: Crossings) -> Option<ShapeHit> {
    if ray.in_range(first.t) {
        Some(first)
    } else {
        ray.in_range(second.t).then_some(second)
    }
}

/// Passes all hits in the ray's range to `out`.
#[inline(always)]
pub(super) fn report(ray: &ShapeRay, crossings: Crossings, out: &mut dyn FnMut(ShapeHit)) {
    crossings
        .into_iter()
        .filter(|hit| ray.in_range(hit.t))
        .for_each(out);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slab_is_entered_from_either_side_and_contains_a_line_along_it() {
        let up = Span::slab(-3.0, 2.0, UNIT, [1, 2]);
        assert_eq!(
            (up.enter.t, up.enter.part, up.exit.t, up.exit.part),
            (1.0, 1, 2.0, 2)
        );
        let down = Span::slab(3.0, -2.0, UNIT, [1, 2]);
        assert_eq!(
            (down.enter.t, down.enter.part, down.exit.t, down.exit.part),
            (1.0, 2, 2.0, 1)
        );
        for zero in [0.0, -0.0] {
            assert!(Span::slab(1.0, zero, UNIT, [1, 2]).contains(1e300));
            assert!(!Span::slab(1.0 + f64::EPSILON, zero, UNIT, [1, 2]).contains(0.0));
        }
    }

    #[test]
    fn the_overlap_with_nothing_is_empty() {
        let none = Span::slab(0.0, 1.0, UNIT, [0, 0]).overlap(Span::NONE);
        assert!(none.enter.t > none.exit.t);
    }

    #[test]
    fn a_ray_into_a_solid_exits_at_its_start_at_the_earliest_and_never_where_it_left() {
        let inward = |part| ShapeRay {
            origin_surface: Some(OriginSurface {
                part,
                side: Side::Inside,
            }),
            ..ShapeRay::new(glam::DVec3::ZERO, glam::DVec3::X)
        };
        // Here rounding has moved the exit behind the start.
        let span = Span::new(-1.0, -f64::EPSILON, 3);
        let exit = |ray: &ShapeRay| nearest(ray, span.crossings_of_convex(ray, true));
        assert_eq!(exit(&inward(2)), Some(ShapeHit { t: 0.0, part: 3 }));
        assert_eq!(exit(&inward(3)), None);
    }
}
