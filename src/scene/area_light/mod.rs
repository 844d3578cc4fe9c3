//! Area lights: points on emissive objects to which shadow rays are sent.
//!
//! The irradiance from a light of radiance L is ∫ L cos θ dω over the directions in which the light is visible. A
//! sample is a direction with the density `pdf` per steradian with which it was chosen. The estimate L cos θ / pdf, or
//! 0 if the shadow ray is occluded, is unbiased for any density. Where the solid angle has a closed form, directions
//! are chosen uniformly in it, so that without occluders only the cosine varies; otherwise points are chosen uniformly
//! on the light, with the density d² / (cos θ' A) of directions (P. Shirley, C. Wang, K. Zimmerman, "Monte Carlo
//! Techniques for Direct Lighting Calculations", ACM TOG 15(1), 1996). All quantities are in world space and f64.

mod disk;
mod mesh;
mod quad;
mod shape_light;
mod sphere;

use glam::DVec3;
use multiversion::multiversion;

use self::quad::SphericalRectanglePacket;
use crate::numeric::{LANES, Lanes, Lanes3};

pub use disk::DiskLight;
pub use mesh::MeshLight;
pub use quad::QuadLight;
pub use shape_light::ShapeLight;
pub use sphere::SphereLight;

/// Point sampled on a light, relative to the point that it illuminates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// Position on the light in world space.
    pub position: DVec3,
    /// Unit vector from the shaded point to the light's point.
    pub direction: DVec3,
    /// Distance between the two points in metres.
    pub distance: f64,
    /// Unit normal of the light there, on the side of its front; outward for a sphere.
    pub normal: DVec3,
    /// Index of the mesh triangle, in the order in which the light was given its triangles, or of the part of an
    /// analytic shape; 0 for other lights.
    pub primitive: u32,
    /// Density of the direction per steradian; positive and finite.
    pub pdf: f64,
}

impl LightSample {
    /// Returns whether the light's front faces the shaded point. A one-sided light contributes only if it does.
    #[inline(always)]
    pub fn is_front(&self) -> bool {
        self.direction.dot(self.normal) < 0.0
    }
}

/// Point chosen uniformly from the surface of a light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfacePoint {
    /// Position in world space.
    pub(crate) position: DVec3,
    /// Unit normal, on the side of the light's front; outward for a sphere.
    pub(crate) normal: DVec3,
    /// Index of the mesh triangle; 0 for other lights.
    pub(crate) primitive: u32,
}

/// Vector to a sampled point of a light.
#[derive(Clone, Copy, Debug)]
struct LightVector {
    /// Vector from the shaded point to the light's point.
    to_light: DVec3,
    /// Density of the direction per steradian; not positive and finite where there is no sample.
    pdf: f64,
    /// True if the light's front faces the shaded point.
    is_front: bool,
}

impl LightVector {
    /// Returns the vector to a point that was chosen uniformly from a flat `area` of unit normal `normal`.
    #[inline(always)]
    fn of_area(to_light: DVec3, normal: DVec3, area: f64) -> LightVector {
        // Convert the density per area into a density per solid angle
        let squared = to_light.length_squared();
        let approach = to_light.dot(normal);
        LightVector {
            to_light,
            pdf: squared * squared.sqrt() / (approach.abs() * area),
            is_front: approach < 0.0,
        }
    }

    /// Returns this vector if `is_chosen`, otherwise `other`.
    #[inline(always)]
    fn or(self, other: LightVector, is_chosen: bool) -> LightVector {
        let choose = |a: f64, b: f64| if is_chosen { a } else { b };
        LightVector {
            to_light: DVec3::new(
                choose(self.to_light.x, other.to_light.x),
                choose(self.to_light.y, other.to_light.y),
                choose(self.to_light.z, other.to_light.z),
            ),
            pdf: choose(self.pdf, other.pdf),
            is_front: if is_chosen { self.is_front } else { other.is_front },
        }
    }

    /// Returns the sample of a flat light of unit normal `normal`; `None` where there is none.
    #[inline(always)]
    fn sample_of_flat(self, p: DVec3, normal: DVec3) -> Option<LightSample> {
        let distance = self.to_light.length();
        (is_density(self.pdf) && is_density(distance)).then(|| LightSample {
            position: p + self.to_light,
            direction: self.to_light / distance,
            distance,
            normal,
            primitive: 0,
            pdf: self.pdf,
        })
    }
}

/// Points sampled on a light for sixteen points that it illuminates, as structure of arrays.
#[derive(Clone, Debug)]
pub(crate) struct LightSamplePacket {
    /// Positions on the light in world space.
    pub(crate) position: Lanes3<f64>,
    /// Unit vectors from the shaded points to the light's points.
    pub(crate) direction: Lanes3<f64>,
    /// Densities of the directions per steradian; 0 in lanes without a sample on the light's front.
    pub(crate) pdf: Lanes<f64>,
}

/// Light as seen from sixteen points: what all its samples at these points share.
pub(crate) struct LightView {
    /// Projections of a rectangular light; 0 for other lights.
    rectangle: SphericalRectanglePacket,
}

/// Light with an area, in world space.
#[derive(Clone, Debug)]
pub enum AreaLight {
    /// Parallelogram light, sampled by solid angle where possible.
    Quad(QuadLight),
    /// Elliptic disk light, sampled by area.
    Disk(DiskLight),
    /// Sphere light, sampled by solid angle.
    Sphere(SphereLight),
    /// Triangle mesh light, sampled by area.
    Mesh(MeshLight),
    /// Light of another analytic shape, sampled by area.
    Shape(Box<ShapeLight>),
}

/// Reason why an object cannot be an area light, worded as advice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AreaLightError {
    /// Area that is zero, not finite, or outside the range of numbers.
    #[error("a light's area is zero or not finite: give it an extent, or make it a point light")]
    NoArea,
    /// Mesh of more triangles than an index can number.
    #[error("a light's mesh has more than 2^32 triangles: split it")]
    TooManyTriangles,
}

impl AreaLight {
    /// Samples the point of the light that `u` in [0, 1)² selects for the point `p`. Returns `None` where the light is
    /// not visible from `p`, as in the plane of a flat one, or on the light itself.
    #[inline]
    pub fn sample(&self, p: DVec3, u: [f64; 2]) -> Option<LightSample> {
        match self {
            AreaLight::Quad(light) => light.sample(p, u),
            AreaLight::Disk(light) => light.sample(p, u),
            AreaLight::Sphere(light) => light.sample(p, u),
            AreaLight::Mesh(light) => light.sample(p, u),
            AreaLight::Shape(light) => light.sample(p, u),
        }
    }

    /// Returns the density per steradian with which [`AreaLight::sample`] chooses for `p` the direction to `position`, a
    /// point of the light that is visible from `p` and has the unit `normal`; 0 where it chooses none, as edge-on.
    pub fn pdf(&self, p: DVec3, position: DVec3, normal: DVec3) -> f64 {
        let pdf = match self {
            AreaLight::Quad(light) => light.pdf(p, position),
            AreaLight::Sphere(light) => light.pdf(p),
            AreaLight::Shape(light) => light.pdf(p, position, normal),
            AreaLight::Disk(_) | AreaLight::Mesh(_) => {
                LightVector::of_area(position - p, normal, self.area()).pdf
            }
        };
        if is_density(pdf) { pdf } else { 0.0 }
    }

    /// Prepares [`AreaLight::sample_packet`] at the points `p`.
    pub(crate) fn view_packet(&self, p: &Lanes3<f64>) -> LightView {
        let mut view = LightView {
            rectangle: SphericalRectanglePacket::ZERO,
        };
        if let AreaLight::Quad(light) = self {
            project_quad(light, p, &mut view.rectangle);
        }
        view
    }

    /// Samples the points of the light's front that `u` in [0, 1)² selects for the points `p`: see
    /// [`AreaLight::sample`]. `view` is the light as seen from `p`.
    pub(crate) fn sample_packet(
        &self,
        view: &LightView,
        p: &Lanes3<f64>,
        u: &[Lanes<f64>; 2],
    ) -> LightSamplePacket {
        let mut samples = LightSamplePacket {
            position: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            pdf: [0.0; LANES],
        };
        sample_packet(self, view, (p, u), &mut samples);
        samples
    }

    /// Returns the point that `u` in [0, 1)² selects uniformly from the surface of one side; `None` for lights of analytic
    /// shapes that have no such map.
    pub(crate) fn surface_point(&self, u: [f64; 2]) -> Option<SurfacePoint> {
        match self {
            AreaLight::Quad(light) => Some(light.surface_point(u)),
            AreaLight::Disk(light) => Some(light.surface_point(u)),
            AreaLight::Sphere(light) => Some(light.surface_point(u)),
            AreaLight::Mesh(light) => Some(light.surface_point(u)),
            AreaLight::Shape(_) => None,
        }
    }

    /// Returns the emissive area of one side in square metres.
    pub fn area(&self) -> f64 {
        match self {
            AreaLight::Quad(light) => light.area(),
            AreaLight::Disk(light) => light.area(),
            AreaLight::Sphere(light) => light.area(),
            AreaLight::Mesh(light) => light.area(),
            AreaLight::Shape(light) => light.area(),
        }
    }
}

/// Compiles [`QuadLight::project`] for several instruction sets.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn project_quad(light: &QuadLight, p: &Lanes3<f64>, view: &mut SphericalRectanglePacket) {
    light.project(p, view);
}

/// Compiles [`AreaLight::sample_packet`] for several instruction sets.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn sample_packet(
    light: &AreaLight,
    view: &LightView,
    (p, u): (&Lanes3<f64>, &[Lanes<f64>; 2]),
    samples: &mut LightSamplePacket,
) {
    match light {
        AreaLight::Quad(light) => {
            samples.fill(p, u, |lane, u| light.sample_vector_of(&view.rectangle, lane, u))
        }
        AreaLight::Disk(light) => samples.fill(p, u, |(_, p), u| light.sample_vector(p, u)),
        AreaLight::Sphere(light) => samples.fill(p, u, |(_, p), u| light.sample_vector(p, u)),
        AreaLight::Mesh(_) | AreaLight::Shape(_) => {
            for l in 0..LANES {
                let sample = light.sample(lane(p, l), [u[0][l], u[1][l]]);
                if let Some(sample) = sample.filter(LightSample::is_front) {
                    samples.set(l, sample.position, sample.direction, sample.pdf);
                }
            }
        }
    }
}

impl LightSamplePacket {
    /// Sets all lanes to the samples that `sample` takes of a lane and its point.
    #[inline(always)]
    fn fill(
        &mut self,
        p: &Lanes3<f64>,
        u: &[Lanes<f64>; 2],
        sample: impl Fn((usize, DVec3), [f64; 2]) -> LightVector,
    ) {
        for l in 0..LANES {
            let p = lane(p, l);
            let LightVector {
                to_light,
                pdf,
                is_front,
            } = sample((l, p), [u[0][l], u[1][l]]);
            let distance = to_light.length_squared().sqrt();
            let is_sample = is_front & (pdf > 0.0) & (pdf < f64::INFINITY);
            let is_sample = is_sample & (distance > 0.0) & (distance < f64::INFINITY);
            self.set(
                l,
                p + to_light,
                to_light / distance,
                if is_sample { pdf } else { 0.0 },
            );
        }
    }

    #[inline(always)]
    fn set(&mut self, l: usize, position: DVec3, direction: DVec3, pdf: f64) {
        for axis in 0..3 {
            self.position[axis][l] = position[axis];
            self.direction[axis][l] = direction[axis];
        }
        self.pdf[l] = pdf;
    }
}

#[inline(always)]
fn lane(v: &Lanes3<f64>, l: usize) -> DVec3 {
    DVec3::new(v[0][l], v[1][l], v[2][l])
}

/// Returns the sample at `position`, chosen uniformly from a flat `area` of unit normal `normal`.
#[inline(always)]
fn sample_of_area(p: DVec3, position: DVec3, normal: DVec3, area: f64) -> Option<LightSample> {
    let sample = LightVector::of_area(position - p, normal, area).sample_of_flat(p, normal)?;
    Some(LightSample { position, ..sample })
}

/// Returns whether `pdf` is positive and finite, so that it can be divided by; false for NaN.
#[inline(always)]
fn is_density(pdf: f64) -> bool {
    pdf > 0.0 && pdf < f64::INFINITY
}

/// Returns area and unit normal of the parallelogram of sides `a` and `b`.
fn area_and_normal(a: DVec3, b: DVec3) -> Result<(f64, DVec3), AreaLightError> {
    let across = a.cross(b);
    let area = across.length();
    if !(is_density(area) && is_density(area.recip())) {
        return Err(AreaLightError::NoArea);
    }
    Ok((area, across / area))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    /// Returns the mean of `value` over the samples of a grid of `cells` by `cells` midpoints; missing samples count as
    /// 0.
    pub(super) fn mean(light: &AreaLight, p: DVec3, cells: u32, value: impl Fn(&LightSample) -> f64) -> f64 {
        let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(cells);
        let sum: f64 = (0..cells * cells)
            .filter_map(|i| light.sample(p, [middle(i % cells), middle(i / cells)]))
            .map(|sample| value(&sample))
            .sum();
        sum / f64::from(cells * cells)
    }

    pub(super) fn lights() -> [AreaLight; 4] {
        let (u, v) = (DVec3::new(1.0, 0.0, 0.5), DVec3::new(-0.3, 0.8, 0.6));
        let center = DVec3::new(0.5, -1.0, 3.0);
        let triangle = [center, center + u, center + v];
        [
            AreaLight::Quad(QuadLight::new(center, u, v).unwrap()),
            AreaLight::Disk(DiskLight::new(center, u, v).unwrap()),
            AreaLight::Sphere(SphereLight::new(center, 0.7).unwrap()),
            AreaLight::Mesh(MeshLight::new([triangle]).unwrap()),
        ]
    }

    #[test]
    fn sample_fields_are_consistent() {
        for light in lights() {
            for p in [
                DVec3::ZERO,
                DVec3::new(-20.0, 3.0, 1.0),
                DVec3::new(0.5, -1.1, 2.0),
            ] {
                mean(&light, p, 16, |sample| {
                    assert!((sample.direction.length() - 1.0).abs() < 4.0 * f64::EPSILON);
                    assert!((sample.normal.length() - 1.0).abs() < 8.0 * f64::EPSILON);
                    let there = p + sample.distance * sample.direction;
                    assert!((there - sample.position).length() < 1e-13, "{light:?} {p}");
                    assert!(sample.pdf > 0.0 && sample.pdf.is_finite());
                    0.0
                });
            }
        }
    }

    #[test]
    fn the_density_of_a_direction_is_that_of_the_sample_in_it() {
        for light in lights() {
            for p in [
                DVec3::ZERO,
                DVec3::new(-20.0, 3.0, 1.0),
                DVec3::new(0.45, -1.05, 2.9),
                DVec3::new(0.3, -1e4, 80.0),
            ] {
                mean(&light, p, 16, |sample| {
                    let pdf = light.pdf(p, sample.position, sample.normal);
                    assert!((pdf / sample.pdf - 1.0).abs() < 1e-9, "{light:?} {p}: {pdf}");
                    0.0
                });
            }
        }
        // Edge-on, a flat light has no density
        let edge = MeshLight::new([[DVec3::ZERO, DVec3::X, DVec3::Y]]).unwrap();
        assert_eq!(
            AreaLight::Mesh(edge).pdf(2.0 * DVec3::X, DVec3::ZERO, DVec3::Z),
            0.0
        );
    }

    #[test]
    fn sixteen_samples_equal_single_ones() {
        let mut random = SplitMix64::new(5, 0);
        for light in lights() {
            for _ in 0..200 {
                let p: [DVec3; LANES] = std::array::from_fn(|_| 4.0 * random.in_cube());
                let u: [Lanes<f64>; 2] = [0; 2].map(|_| std::array::from_fn(|_| random.unit()));
                let points = [0, 1, 2].map(|axis| p.map(|p| p[axis]));
                let packet = light.sample_packet(&light.view_packet(&points), &points, &u);
                for l in 0..LANES {
                    let sample = light.sample(p[l], [u[0][l], u[1][l]]);
                    let Some(sample) = sample.filter(LightSample::is_front) else {
                        assert_eq!(packet.pdf[l], 0.0, "{light:?} {}", p[l]);
                        continue;
                    };
                    assert!(
                        (packet.pdf[l] / sample.pdf - 1.0).abs() < 1e-14,
                        "{light:?} {}",
                        p[l]
                    );
                    let difference = lane(&packet.direction, l) - sample.direction;
                    assert!(difference.length() < 1e-15, "{light:?} {}", p[l]);
                    assert!((lane(&packet.position, l) - sample.position).length() < 1e-14);
                }
            }
        }
    }

    #[test]
    fn the_area_seen_through_the_samples_is_the_area() {
        for light in lights()
            .iter()
            .filter(|light| !matches!(light, AreaLight::Sphere(_)))
        {
            let p = DVec3::new(0.2, 4.0, -1.0);
            // dA = d² dω / cos.
            let area = mean(light, p, 256, |s| {
                s.distance * s.distance / (s.pdf * s.direction.dot(s.normal).abs())
            });
            assert!((area / light.area() - 1.0).abs() < 1e-5, "{light:?}: {area}");
        }
    }

    #[test]
    fn point_on_the_light_or_its_plane_gives_finite_samples() {
        for light in lights() {
            let p = DVec3::new(0.5, -1.0, 3.0);
            for p in [
                p,
                p + DVec3::new(10.0, 0.0, 5.0),
                p + DVec3::new(1e-300, 0.0, 0.0),
                DVec3::splat(1e200),
            ] {
                mean(&light, p, 8, |sample| {
                    assert!(sample.pdf > 0.0 && sample.pdf.is_finite() && sample.direction.is_finite());
                    0.0
                });
            }
        }
    }

    #[test]
    fn lights_without_area_are_rejected() {
        let tall = DVec3::new(0.0, f64::NAN, 0.0);
        for (u, v) in [
            (DVec3::X, 2.0 * DVec3::X),
            (DVec3::X, DVec3::ZERO),
            (DVec3::X, tall),
        ] {
            assert!(QuadLight::new(DVec3::ZERO, u, v).is_err());
            assert!(DiskLight::new(DVec3::ZERO, u, v).is_err());
            assert!(MeshLight::new([[DVec3::ZERO, u, v]]).is_err());
        }
        for radius in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(SphereLight::new(DVec3::ZERO, radius).is_err());
        }
        assert!(MeshLight::new([]).is_err());
    }
}
