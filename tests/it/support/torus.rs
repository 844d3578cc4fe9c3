//! Intersections of a line with a torus without solving a quartic: the distance from the tube's surface is sampled
//! along the line, its extrema are found between the samples, and its zeros between the extrema.

use glam::DVec3;

use super::approx::Approx;
use super::hits::{Left, Ray};

/// Samples of the line's way past the torus; between two of them is at most one extremum.
const SAMPLES: usize = 96;
/// Steps that halve an interval, or nearly, until f64 has no more digits of it.
const HALVINGS: usize = 80;

/// The distance from the surface of the torus around z whose tube of radius `r` has the unit circle as its middle.
pub fn distance(p: DVec3, r: f64) -> f64 {
    (p.truncate().length() - 1.0).hypot(p.z) - r
}

/// An extremum of the distance along the line.
#[derive(Clone, Copy)]
struct Extremum {
    t: f64,
    distance: f64,
}

/// The line, and how far its points may be off.
struct Line<'a> {
    ray: &'a Ray,
    r: f64,
}

impl Line<'_> {
    fn distance(&self, t: f64) -> f64 {
        distance(self.ray.origin.value() + t * self.ray.direction.value(), self.r)
    }

    /// The distance's own error: its gradient has length 1.
    fn error(&self, t: f64) -> f64 {
        self.ray.origin.error().length() + t.abs() * self.ray.direction.error().length()
    }

    /// Lowest and highest points in turn, from outside to outside.
    fn extrema(&self) -> Vec<Extremum> {
        let (o, d) = (self.ray.origin.value(), self.ray.direction.value());
        let (middle, half) = (-o.dot(d) / d.length_squared(), 2.0 / d.length());
        let sample = |k: usize| middle + half * (2.0 * k as f64 / SAMPLES as f64 - 1.0);
        let mut found = Vec::new();
        for k in 1..SAMPLES {
            let around = [sample(k - 1), sample(k), sample(k + 1)];
            let [before, here, after] = around.map(|t| self.distance(t));
            let is_lowest = here < before && here <= after;
            if is_lowest || here > before && here >= after {
                let sign = if is_lowest { 1.0 } else { -1.0 };
                let t = lowest(|t| sign * self.distance(t), around[0], around[2]);
                found.push(Extremum {
                    t,
                    distance: self.distance(t),
                });
            }
        }
        found
    }

    /// The zero between a point inside and one outside.
    fn zero(&self, mut inside: f64, mut outside: f64) -> Approx {
        for _ in 0..HALVINGS {
            let middle = 0.5 * (inside + outside);
            if self.distance(middle) < 0.0 {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        let step = 1e-6 / self.ray.direction.value().length();
        let slope = (self.distance(inside + step) - self.distance(inside - step)) / (2.0 * step);
        let error = self.error(inside) / slope.abs() + 1e-13 * inside.abs();
        Approx::exact(inside).widened(error.min(1e30))
    }
}

/// The place of the minimum of `f`, which has one between `a` and `b` (golden section).
fn lowest(f: impl Fn(f64) -> f64, mut a: f64, mut b: f64) -> f64 {
    for _ in 0..HALVINGS {
        let (left, right) = (a + 0.382 * (b - a), a + 0.618 * (b - a));
        if f(left) <= f(right) {
            b = right;
        } else {
            a = left;
        }
    }
    0.5 * (a + b)
}

/// All four crossings, two around each place where the line is deepest, with how surely they are there; what is surely
/// not there has a negative slack.
fn crossings(line: &Line) -> Vec<(Approx, f64)> {
    let extrema = line.extrema();
    let lowest = extrema.iter().enumerate().filter(|(i, _)| i % 2 == 0);
    let far = 4.0 / line.ray.direction.value().length();
    let mut all = Vec::new();
    for (i, low) in lowest {
        let depth = -low.distance / line.error(low.t).max(1e-15);
        for (neighbour, side) in [(i.wrapping_sub(1), -1.0), (i + 1, 1.0)] {
            let high = extrema.get(neighbour);
            let gap = high.map_or(f64::INFINITY, |high| {
                high.distance / line.error(high.t).max(1e-15)
            });
            let slack = depth.min(gap);
            let outside = high.map_or(low.t + side * far, |high| high.t);
            let t = if slack > 0.0 {
                line.zero(low.t, outside)
            } else {
                Approx::exact(if depth > 0.0 { outside } else { low.t })
            };
            all.push((t, slack));
        }
    }
    all
}

/// The `root`-th of four crossings. A ray that begins on the torus does not cross it there.
pub fn crossing(r: f64, ray: &Ray, root: u32, leaves: Option<Left>) -> Option<(Approx, f64)> {
    let line = Line { ray, r };
    let all = crossings(&line);
    let found = *all.get(root as usize)?;
    if leaves.is_some() {
        let start = ray.t_near.value;
        let aside = |t: Approx| (t.value - start).abs();
        let real = all.iter().filter(|(_, slack)| *slack > 0.0);
        let own = real
            .map(|&(t, _)| t)
            .min_by(|a, b| aside(*a).total_cmp(&aside(*b)))?;
        // Between the start and its own root there is nothing but the start's error.
        let between = line.distance(0.5 * (start + own.value)).abs();
        if own.value == found.0.value && between <= 8.0 * line.error(start) + 1e-6 {
            return None;
        }
    }
    Some(found)
}
