//! Line drawings, clipped to a square view.

use std::collections::BTreeMap;
use std::fmt::Write;

use glam::DVec2;
use serde::Serialize;

/// Square region of the plane, with the y axis upwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// Centre of the square.
    pub center: DVec2,
    /// Half side of the square; positive.
    pub half: f64,
}

impl Region {
    /// Returns a region with a margin around the bulk of the points: centred by trimmed extremes, and large enough for
    /// all but the farthest seventh. `None` without points, or if all coincide.
    pub fn around(points: &[DVec2]) -> Option<Region> {
        // Ignore points that are not finite
        let mut all: Vec<DVec2> = points.iter().copied().filter(|p| p.is_finite()).collect();
        let last = all.len().checked_sub(1)?;
        let mut middle = |of: fn(&DVec2) -> f64| {
            all.sort_by(|a, b| of(a).total_cmp(&of(b)));
            // Take the middle of the trimmed extremes rather than the median, so that an evenly spaced set is centred.
            0.5 * (of(&all[last / 14]) + of(&all[last - last / 14]))
        };
        let center = DVec2::new(middle(|p| p.x), middle(|p| p.y));
        // Trim the farthest points
        let mut far: Vec<f64> = all.iter().map(|p| (*p - center).abs().max_element()).collect();
        far.sort_by(f64::total_cmp);
        let half = ROOM * far[last - last / 7];
        (half > 0.0 && half < f64::INFINITY).then_some(Region { center, half })
    }

    /// Returns a region with a margin that contains all finite points; `None` without points, or if all coincide.
    pub fn holding(points: &[DVec2]) -> Option<Region> {
        let finite = || points.iter().filter(|p| p.is_finite());
        let low = finite().copied().reduce(DVec2::min)?;
        let high = finite().copied().reduce(DVec2::max)?;
        let half = ROOM * 0.5 * (high - low).max_element();
        let center = 0.5 * (low + high);
        (half > 0.0 && half < f64::INFINITY).then_some(Region { center, half })
    }
}

/// Ratio of a view's size to the size of its contents.
const ROOM: f64 = 1.12;

/// Drawing of lines and dots by CSS class.
#[derive(Clone, Debug, Serialize)]
pub struct Drawing {
    #[serde(skip)]
    region: Region,
    /// Side of the drawing in pixels.
    size: f64,
    /// Description of the drawing for screen readers.
    words: String,
    /// Paths of SVG by the class of their lines.
    lines: BTreeMap<&'static str, String>,
    /// Class and position of each dot in pixels.
    dots: Vec<(&'static str, f64, f64)>,
}

impl Drawing {
    /// Returns an empty drawing of `size` pixels each way.
    pub fn new(region: Region, size: u32) -> Drawing {
        Drawing {
            region,
            size: f64::from(size),
            words: String::new(),
            lines: BTreeMap::new(),
            dots: Vec::new(),
        }
    }

    /// Returns a point's position relative to the centre, in units of half the side.
    fn place(&self, p: DVec2) -> DVec2 {
        (p - self.region.center) / self.region.half
    }

    /// Returns a position in pixels from the upper left corner.
    fn pixel(&self, place: DVec2) -> DVec2 {
        0.5 * self.size * DVec2::new(1.0 + place.x, 1.0 - place.y)
    }

    /// Adds the visible part of a line.
    pub fn line(&mut self, class: &'static str, ends: [DVec2; 2]) {
        let Some(ends) = clipped(ends.map(|p| self.place(p))) else {
            return;
        };
        let [a, b] = ends.map(|p| self.pixel(p));
        // Writing to a string cannot fail.
        let path = self.lines.entry(class).or_default();
        let _ = write!(path, "M{:.1} {:.1}L{:.1} {:.1}", a.x, a.y, b.x, b.y);
    }

    /// Adds the visible parts of a triangle's sides.
    pub fn triangle(&mut self, class: &'static str, [a, b, c]: [DVec2; 3]) {
        for side in [[a, b], [b, c], [c, a]] {
            self.line(class, side);
        }
    }

    /// Adds a dot, unless it is outside the view.
    pub fn dot(&mut self, class: &'static str, at: DVec2) {
        let place = self.place(at);
        if place.abs().max_element() <= 1.0 {
            let p = self.pixel(place).map(|x| (10.0 * x).round() / 10.0);
            self.dots.push((class, p.x, p.y));
        }
    }

    /// Returns the drawing with its description for screen readers.
    #[must_use]
    pub fn described(mut self, words: &str) -> Drawing {
        words.clone_into(&mut self.words);
        self
    }
}

/// Clips a line to [-1, 1]² (Liang and Barsky, 1984); `None` where no part is inside or an end is not finite.
fn clipped([a, b]: [DVec2; 2]) -> Option<[DVec2; 2]> {
    if !a.is_finite() || !b.is_finite() {
        return None;
    }
    // Intersect the line's parameter range with each half-plane
    let along = b - a;
    let (mut enter, mut leave) = (0.0, 1.0);
    for (slope, room) in [
        (along.x, 1.0 - a.x),
        (-along.x, 1.0 + a.x),
        (along.y, 1.0 - a.y),
        (-along.y, 1.0 + a.y),
    ] {
        if slope > 0.0 {
            leave = f64::min(leave, room / slope);
        } else if slope < 0.0 {
            enter = f64::max(enter, room / slope);
        } else if room < 0.0 {
            return None;
        }
    }
    (enter < leave).then(|| [a + enter * along, a + leave * along])
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: Region = Region {
        center: DVec2::ZERO,
        half: 1.0,
    };

    #[test]
    fn lines_are_clipped_at_the_edges_or_omitted() {
        let at = DVec2::new;
        assert_eq!(
            clipped([at(-3.0, 0.0), at(3.0, 0.0)]),
            Some([at(-1.0, 0.0), at(1.0, 0.0)])
        );
        assert_eq!(clipped([at(-3.0, 2.0), at(3.0, 2.0)]), None);
        assert_eq!(clipped([at(2.0, 2.0), at(3.0, 3.0)]), None);
        assert_eq!(clipped([at(f64::NAN, 0.0), at(0.0, 0.0)]), None);
    }

    #[test]
    fn y_points_up_and_dots_outside_are_omitted() {
        let mut drawing = Drawing::new(UNIT, 100);
        drawing.dot("wrong", DVec2::new(0.0, 1.0));
        drawing.dot("wrong", DVec2::new(0.0, 1.5));
        assert_eq!(drawing.dots, [("wrong", 50.0, 0.0)]);
    }

    #[test]
    fn view_encloses_clustered_points_without_outliers() {
        let mut points: Vec<DVec2> = (0..100)
            .map(|i| DVec2::new(f64::from(i % 10), f64::from(i / 10)))
            .collect();
        points.push(DVec2::splat(1e9));
        points.push(DVec2::NAN);
        let region = Region::around(&points).unwrap();
        assert!(region.half < 10.0, "{region:?}");
        assert_eq!(Region::around(&[DVec2::ONE]), None);
        assert_eq!(Region::holding(&[]), None);
        assert!(Region::holding(&points).unwrap().half > 4e8);
    }
}
