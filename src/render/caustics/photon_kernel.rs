//! Kernels over which the power of photons spreads: discs, and ellipses along the bundle of light that a photon is in.
//!
//! Photons that leave a light without extent next to each other, and arrive on one object after as many steps, are a
//! bundle. Sixteen of them fill a small cell of what the light emits, and a linear map from there to where they arrive says
//! how the mirrors and bodies between stretch it: widely along a focal curve, and hardly across it. An ellipse of that shape
//! keeps focal curves sharp where a disc of as many photons would blur them (L. Schjøth, J. R. Frisvad, K. Erleben, J.
//! Sporring, "Photon Differentials", 2007, who trace derivatives instead). Its size is that which holds a given number of
//! photons, as that of a disc.
//!
//! A kernel is Epanechnikov's, 2 / (π r₁ r₂) (1 - q) for q < 1 with the radii r₁ ≥ r₂ of the ellipse, whose integral over
//! the ellipse is 1. With the offset d from the photon and the unit vector u along the longer radius, q is
//! |d|² / r₂² - (d · u)² (1 / r₂² - 1 / r₁²).

use std::f32::consts::FRAC_2_PI;

use glam::{DMat3, DVec2, DVec3, Vec3};

use super::photon_tree::{Photon, sort_into_leaves};
use crate::numeric::LANES;
use crate::parallel;
use crate::shape::tangents;

/// Least number of photons of a bundle that shapes a kernel.
const MIN_BUNDLE: usize = 6;
/// Least cosine between the directions from which photons of a bundle arrive: 60 degrees.
const MIN_COS: f32 = 0.5;
/// Largest ratio of the radii of an ellipse. The search for its size visits as many times the photons of a disc.
const MAX_RATIO: f64 = 16.0;
/// Variance across the plane of a bundle's origins that is added to theirs, as a part of the whole, so that it has an inverse.
const FLATNESS: f64 = 1e-3;
/// Number of bundles whose shapes one task computes.
const BUNDLES_PER_TASK: usize = 1 << 6;

/// Way of a photon that left a light without extent, by which the photons of a bundle find each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::render) struct PhotonOrigin {
    /// Point on a plane across parallel light, or direction from a light at a point.
    pub(in crate::render) emitted: [f32; 3],
    /// Light, number of steps, object of arrival, and 1 + stratum of the wavelength or 0, which the photons of a bundle
    /// have in common.
    pub(in crate::render) group: [u32; 4],
}

/// Shape of a photon's kernel: that of an ellipse of any size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct KernelShape {
    /// Unit vector along the longer radius.
    along: [f32; 3],
    /// Square of the longer radius over the shorter one, less 1: 0 for discs.
    narrowing: f32,
}

impl KernelShape {
    pub(super) const DISC: KernelShape = KernelShape {
        along: [0.0; 3],
        narrowing: 0.0,
    };

    /// Returns the square of the longer radius of the ellipse around the photon that reaches to an offset from it, whose
    /// square is given; that is nowhere smaller.
    #[inline(always)]
    pub(super) fn squared_reach(&self, offset: Vec3, squared_distance: f32) -> f32 {
        let along = offset.dot(self.along.into());
        squared_distance + self.narrowing * (squared_distance - along * along).max(0.0)
    }
}

/// Kernel of a photon.
#[derive(Clone, Copy, Debug)]
pub(super) struct PhotonKernel {
    /// Unit vector along the longer radius, times the root of the difference of the inverse squares of the radii; zero for
    /// discs.
    axis: [f32; 3],
    /// Inverse square of the shorter radius.
    inverse_square: f32,
    /// Value at the photon, per square metre.
    peak: f32,
}

impl PhotonKernel {
    /// Returns the kernel of a shape with the square of its longer radius; the shorter one is not below `least`, nor above
    /// the longer one.
    pub(super) fn new(shape: &KernelShape, squared_radius: f32, least: f32) -> PhotonKernel {
        let inverse = squared_radius.recip();
        let most = (least * least).recip().max(inverse);
        let inverse_square = (inverse * (1.0 + shape.narrowing)).min(most);
        let difference = (inverse_square - inverse).max(0.0);
        PhotonKernel {
            axis: (difference.sqrt() * Vec3::from(shape.along)).to_array(),
            inverse_square,
            peak: FRAC_2_PI * inverse.sqrt() * inverse_square.sqrt(),
        }
    }

    /// Returns the value at an offset from the photon whose square is given, per square metre; 0 outside.
    #[inline(always)]
    pub(super) fn value(&self, offset: Vec3, squared_distance: f32) -> f32 {
        let along = offset.dot(self.axis.into());
        let q = self.inverse_square * squared_distance - along * along;
        // Rounding may carry q below 0 for long ellipses
        self.peak * (1.0 - q).clamp(0.0, 1.0)
    }
}

/// Returns the shapes of the kernels of all photons, which will hold `neighbours` of them.
pub(super) fn shapes(
    photons: &[Photon],
    origins: &[Option<PhotonOrigin>],
    neighbours: usize,
) -> Vec<KernelShape> {
    let mut shapes = vec![KernelShape::DISC; photons.len()];
    // Divide the photons into bundles, and fit the shapes of each
    let bundles = bundles(origins);
    let of_bundles = parallel::map_chunks(&bundles, BUNDLES_PER_TASK, &|_, bundles| {
        let mut found = Vec::new();
        for bundle in bundles {
            for &index in bundle {
                let others = bundle.iter().filter_map(|&other| {
                    let other = other as usize;
                    Some((&photons[other], origins[other]?))
                });
                let shape = shape(&photons[index as usize], others, neighbours);
                found.extend(shape.map(|shape| (index, shape)));
            }
        }
        found
    });
    for (index, shape) in of_bundles.concat() {
        shapes[index as usize] = shape;
    }
    shapes
}

/// Returns the indices of the photons of each bundle: up to [`LANES`] of one group that were emitted next to each other.
fn bundles(origins: &[Option<PhotonOrigin>]) -> Vec<Vec<u32>> {
    // Sort by groups
    let known = (0u32..)
        .zip(origins)
        .filter_map(|(index, origin)| Some((index, (*origin)?)));
    let mut known: Vec<(u32, PhotonOrigin)> = known.collect();
    known.sort_unstable_by_key(|(index, origin)| (origin.group, *index));
    // Sort each group into cells
    let groups = known.chunk_by(|(_, one), (_, next)| one.group == next.group);
    let mut bundles = Vec::new();
    for group in groups {
        let mut keys: Vec<([f32; 3], u32)> = group
            .iter()
            .map(|(index, origin)| (origin.emitted, *index))
            .collect();
        sort_into_leaves(&mut keys);
        let cells = keys.chunks(LANES).filter(|cell| cell.len() >= MIN_BUNDLE);
        bundles.extend(cells.map(|cell| cell.iter().map(|&(_, index)| index).collect()));
    }
    bundles
}

/// Returns the shape of a photon's kernel; `None` if too few of its bundle arrive beside it.
fn shape<'p>(
    photon: &Photon,
    bundle: impl Iterator<Item = (&'p Photon, PhotonOrigin)>,
    neighbours: usize,
) -> Option<KernelShape> {
    // Collect what arrives beside the photon: offsets in its plane, and origins
    let tangents = tangents(Vec3::from(photon.normal).as_dvec3().normalize());
    let mut moments = BundleMoments::NONE;
    for (other, origin) in bundle {
        let offset = Vec3::from(other.position) - Vec3::from(photon.position);
        let is_aligned = Vec3::from(other.direction).dot(photon.direction.into()) >= MIN_COS;
        let is_beside = photon.shares_surface(
            other.position.into(),
            other.normal.into(),
            offset.length_squared(),
        );
        if is_aligned && is_beside {
            let arrival = tangents.map(|tangent| tangent.dot(offset.as_dvec3()));
            moments.add(arrival.into(), Vec3::from(origin.emitted).as_dvec3());
        }
    }
    // Take the principal axes of the matrix of the squared radii
    let [xx, xy, yy] = moments.of_kernel(neighbours)?;
    let half = 0.5 * (xx - yy);
    let root = half.hypot(xy);
    let angle = 0.5 * xy.atan2(half);
    let along = angle.cos() * tangents[0] + angle.sin() * tangents[1];
    let [longer, shorter] = [0.5 * (xx + yy) + root, (0.5 * (xx + yy) - root).max(0.0)];
    let squared_ratio = (longer / shorter).min(MAX_RATIO * MAX_RATIO);
    let shape = KernelShape {
        along: along.as_vec3().to_array(),
        narrowing: (squared_ratio - 1.0) as f32,
    };
    (longer > 0.0 && shape.narrowing >= 0.0).then_some(shape)
}

/// Sums over the photons of a bundle: arrivals in two dimensions, origins in three, and their products.
struct BundleMoments {
    count: f64,
    arrivals: DVec2,
    origins: DVec3,
    /// Products of arrivals: xx, xy and yy.
    squares: [f64; 3],
    /// Products of each coordinate of arrivals with the origins.
    mixed: [DVec3; 2],
    /// Products of the coordinates of origins.
    outer: DMat3,
}

impl BundleMoments {
    const NONE: BundleMoments = BundleMoments {
        count: 0.0,
        arrivals: DVec2::ZERO,
        origins: DVec3::ZERO,
        squares: [0.0; 3],
        mixed: [DVec3::ZERO; 2],
        outer: DMat3::ZERO,
    };

    fn add(&mut self, arrival: DVec2, origin: DVec3) {
        self.count += 1.0;
        self.arrivals += arrival;
        self.origins += origin;
        let [x, y] = arrival.to_array();
        for (sum, product) in self.squares.iter_mut().zip([x * x, x * y, y * y]) {
            *sum += product;
        }
        self.mixed[0] += x * origin;
        self.mixed[1] += y * origin;
        self.outer += outer(origin, origin);
    }

    /// Returns the matrix (xx, xy and yy) of the squared radii of a kernel over `neighbours` photons of the bundle, or `None`
    /// if there are too few of them.
    ///
    /// The linear map from origins to arrivals, fitted by least squares, stretches a disc of origins. The covariance that it
    /// does not explain, where light bends more than linearly, widens the kernel.
    fn of_kernel(&self, neighbours: usize) -> Option<[f64; 3]> {
        if self.count < MIN_BUNDLE as f64 {
            return None;
        }
        // Take the covariances about the means
        let per = self.count.recip();
        let (arrival, origin) = (per * self.arrivals, per * self.origins);
        let [x, y] = arrival.to_array();
        let products = [x * x, x * y, y * y];
        let arrivals: [f64; 3] = std::array::from_fn(|i| per * self.squares[i] - products[i]);
        let mixed = [0, 1].map(|i| per * self.mixed[i] - arrival[i] * origin);
        let origins = per * self.outer - outer(origin, origin);
        // An even square has a twelfth of its area as the variance of each coordinate
        let trace = trace_of(origins);
        let area = 12.0
            * (0.5 * (trace * trace - trace_of(origins * origins)))
                .max(0.0)
                .sqrt();
        // Fit the map; across the plane of the origins there is next to no variance, and no fit
        let inverse = (origins + FLATNESS * trace * DMat3::IDENTITY).inverse();
        let map = mixed.map(|row| inverse * row);
        let explained = [(0, 0), (0, 1), (1, 1)].map(|(i, j)| map[i].dot(origins * map[j]));
        let disc = neighbours as f64 * per * area * std::f64::consts::FRAC_1_PI;
        let stretched = [(0, 0), (0, 1), (1, 1)].map(|(i, j)| disc * map[i].dot(map[j]));
        let kernel: [f64; 3] = std::array::from_fn(|i| stretched[i] + arrivals[i] - explained[i]);
        kernel.iter().all(|value| value.is_finite()).then_some(kernel)
    }
}

/// Returns the matrix of the products of the coordinates of two vectors.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(b.x * a, b.y * a, b.z * a)
}

fn trace_of(matrix: DMat3) -> f64 {
    matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    /// Returns photons that arrive on a floor where `map` takes points of the unit square.
    fn arrivals(
        count: usize,
        map: impl Fn(f64, f64) -> [f64; 2],
    ) -> (Vec<Photon>, Vec<Option<PhotonOrigin>>) {
        let mut random = SplitMix64::new(21, 1);
        let photons = (0..count).map(|_| {
            let [u, v] = [random.unit(), random.unit()];
            let [x, y] = map(u, v);
            let photon = Photon {
                position: [x as f32, y as f32, 0.0],
                direction: [0.0, 0.0, 1.0],
                normal: [0.0, 0.0, 1.0],
                power: [1.0; 3],
                light: 0,
            };
            let origin = PhotonOrigin {
                emitted: [u as f32, v as f32, 0.0],
                group: [0, 2, 5, 0],
            };
            (photon, Some(origin))
        });
        photons.unzip()
    }

    #[test]
    fn ellipses_are_stretched_as_the_light_is() {
        // Turned by 30 degrees, ten times as long as wide
        let (sin, cos) = 30f64.to_radians().sin_cos();
        let (photons, origins) = arrivals(4096, |u, v| {
            let [along, across] = [u, 0.1 * v];
            [cos * along - sin * across, sin * along + cos * across]
        });
        let along = DVec3::new(cos, sin, 0.0).as_vec3();
        for shape in shapes(&photons, &origins, 32) {
            let ratio = (1.0 + shape.narrowing).sqrt();
            assert!((9.9..10.1).contains(&ratio), "{ratio}");
            let axis = Vec3::from(shape.along);
            assert!(axis.dot(along).abs() > 0.9999, "{axis}");
            // The ellipse through its ends has their radii
            let across = axis.cross(Vec3::Z);
            for (offset, reach) in [(axis, 1.0), (0.1 * across, 0.1 * ratio)] {
                let squared = shape.squared_reach(offset, offset.length_squared());
                assert!((squared.sqrt() / reach - 1.0).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn photons_that_bend_more_than_linearly_have_wider_ellipses() {
        // A fold along y = 0: its photons lie on one side, by the square of v
        let (photons, origins) = arrivals(4096, |u, v| [u, (v - 0.5).powi(2)]);
        let shapes = shapes(&photons, &origins, 32);
        let near = |photon: &&Photon| photon.position[1] < 1e-4;
        let folded: Vec<f32> = photons
            .iter()
            .zip(&shapes)
            .filter(|(photon, _)| near(photon))
            .map(|(_, shape)| shape.narrowing)
            .collect();
        assert!(
            folded.len() > 20 && folded.iter().all(|narrowing| *narrowing > 16.0),
            "{folded:?}"
        );
    }

    #[test]
    fn kernels_integrate_to_one() {
        for (narrowing, least) in [(0.0, 1e-6), (8.0, 1e-6), (255.0, 1e-6), (255.0, 0.2)] {
            let shape = KernelShape {
                along: [0.6, 0.8, 0.0],
                narrowing,
            };
            let kernel = PhotonKernel::new(&shape, 0.25, least);
            let cells = 1000;
            let cell = 1.0 / f64::from(cells);
            let mut sum = 0.0;
            for index in 0..cells * cells {
                let at = [index % cells, index / cells].map(|i| (f64::from(i) + 0.5) * cell - 0.5);
                let offset = DVec3::new(at[0], at[1], 0.0).as_vec3();
                sum += f64::from(kernel.value(offset, offset.length_squared())) * cell * cell;
            }
            assert!((sum - 1.0).abs() < 1e-3, "{sum}");
        }
    }

    #[test]
    fn scarce_bundles_have_discs() {
        // Each object holds five of them
        let (photons, mut origins) = arrivals(1000, |u, v| [u, v]);
        for (index, origin) in origins.iter_mut().enumerate() {
            origin.as_mut().unwrap().group[2] = index as u32 / 5;
        }
        let shapes = shapes(&photons, &origins, 32);
        assert!(shapes.iter().all(|shape| *shape == KernelShape::DISC));
    }
}
