//! Dielectrics of the reference tracer: Snell's law, Fresnel's equations, the Beer-Lambert law, and nested interiors by
//! priority.
//!
//! Of `whit`, only its tables of refractive indices are used.

use glam::DVec3;
use whit::scene::{Geometry, Material, MediumKind, Scene};

use super::approx::{Approx, Approx3, ROUNDING};
use super::hits::{Decision, Doubt, corners};
use super::shapes;

/// Interiors around a point, as indices of their materials.
#[derive(Clone, Debug, Default)]
pub struct Bodies(Vec<u32>);

/// Boundary that a ray crosses, given the interiors around it.
pub struct Boundary<'s> {
    pub material: &'s Material,
    /// Interiors before and behind the boundary; `None` for the outside.
    pub sides: [Option<u32>; 2],
    /// True if an interior of higher priority hides the boundary.
    pub is_hidden: bool,
    /// All interiors around the ray after transmission.
    pub through: Bodies,
}

impl Bodies {
    /// Returns the interiors around `p`, by the winding number of their surfaces.
    pub fn around(scene: &Scene, p: DVec3) -> Bodies {
        let mut around = Bodies::default();
        for index in 0..scene.materials.len() as u32 {
            if is_body(&scene.materials[index as usize]) && winding(scene, index, p) > 0.5 {
                around.0.push(index);
            }
        }
        around
    }

    /// Returns the effective interior: of the highest priority, among equals the first in the scene.
    pub fn present(&self, scene: &Scene) -> Option<u32> {
        let priority = |id: u32| scene.materials[id as usize].interior.unwrap().priority;
        self.0
            .iter()
            .copied()
            .reduce(|a, b| if (priority(b), a) > (priority(a), b) { b } else { a })
    }

    /// Returns the boundary at the surface of material `id`, seen from outside or inside.
    pub fn boundary<'s>(&self, scene: &'s Scene, id: u32, from_outside: bool) -> Boundary<'s> {
        let material = &scene.materials[id as usize];
        let mut through = self.clone();
        if is_body(material) {
            through.0.retain(|&body| body != id);
            if from_outside {
                through.0.push(id);
            }
        }
        let sides = [self.present(scene), through.present(scene)];
        Boundary {
            material,
            sides,
            is_hidden: is_body(material) && sides[0] == sides[1],
            through,
        }
    }

    /// Returns exp(-σ d) of the effective interior; `None` is an infinite distance.
    pub fn transmittance(&self, scene: &Scene, distance: Option<Approx>) -> Approx3 {
        let Some(id) = self.present(scene) else {
            return Approx3::ONE;
        };
        let left = |sigma: f64| match distance {
            _ if sigma == 0.0 => Approx::ONE,
            None => Approx::ZERO,
            Some(distance) => (-(distance * Approx::rounded(sigma))).exp(),
        };
        let absorption = scene.materials[id as usize].interior.unwrap().absorption;
        Approx3::from(absorption.sigma_a.map(left))
    }
}

/// Returns whether a material transmits light and has an interior.
fn is_body(material: &Material) -> bool {
    material.transmits() && material.interior.is_some_and(|inside| !inside.is_thin())
}

/// Returns the winding number of a material's surfaces around `p`: the solid angles of their triangles over 4π (Van
/// Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30(2), 1983).
fn winding(scene: &Scene, material: u32, p: DVec3) -> f64 {
    let of = |geometry: &Geometry, p: DVec3| match geometry {
        Geometry::Points(_) => panic!("the textbook has no point clouds"),
        Geometry::Shape(shape) => f64::from(u8::from(shapes::contains(shape, p))),
        Geometry::Mesh(mesh) => {
            let angles = (0..mesh.triangles.len() as u32).map(|primitive| {
                let [a, b, c] = corners(mesh, primitive).map(|corner| corner - p);
                let [la, lb, lc] = [a, b, c].map(DVec3::length);
                let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
                2.0 * a.dot(b.cross(c)).atan2(below)
            });
            angles.sum::<f64>() / (4.0 * std::f64::consts::PI)
        }
    };
    let placed = scene.instances.iter().filter(|i| i.material == material);
    placed
        .map(|i| {
            let local = i.world_from_object().inverse().transform_point3(p);
            of(&scene.geometries[i.geometry as usize], local)
        })
        .sum()
}

/// Returns the refractive index of an interior, or of the outside, at `wavelength` nanometres.
pub fn index(scene: &Scene, body: Option<u32>, wavelength: f64) -> Approx {
    body.map_or(Approx::ONE, |id| {
        index_of(&scene.materials[id as usize], wavelength)
    })
}

/// Returns the refractive index of a material; glTF's default is 1.5.
fn index_of(material: &Material, wavelength: f64) -> Approx {
    material.interior.map_or(Approx::exact(1.5), |inside| {
        let at = |wavelength: f64| inside.ior.ior(wavelength);
        // Other implementations may store the wavelength in f32.
        let change = at(wavelength * (1.0 + ROUNDING)) - at(wavelength);
        Approx::exact(at(wavelength)).widened(change.abs())
    })
}

/// Returns whether an interior's index depends on the wavelength.
pub fn disperses(scene: &Scene, body: Option<u32>) -> bool {
    body.is_some_and(|id| {
        let inside = scene.materials[id as usize].interior.unwrap();
        inside.ior.spread() != 0.0
    })
}

/// Direction incident on a boundary.
pub struct Incidence {
    /// Unit direction of propagation.
    pub d: Approx3,
    /// Unit normal, opposed to the direction.
    pub n: Approx3,
    /// Cosine of the angle of incidence.
    cos: Approx,
}

/// Division of unpolarised light at a boundary.
pub struct Division {
    pub reflectance: Approx,
    pub transmittance: Approx,
    pub is_total: bool,
}

impl Incidence {
    pub fn new(d: Approx3, n: Approx3) -> Incidence {
        let cos = (-d.dot(n)).clamp(0.0, 1.0);
        Incidence { d, n, cos }
    }

    pub fn mirrored(&self) -> Approx3 {
        let along = self.d.dot(self.n);
        self.d - self.n * (along + along)
    }

    /// Returns the cosines of the incident and the refracted angle.
    pub fn cosines(&self, refracted: Approx3) -> [Approx; 2] {
        [self.cos, refracted.dot(self.n).abs()]
    }

    /// Returns cos θt by Snell's law, sin θt = η sin θi with η = η_i / η_t; `None` beyond the critical angle.
    fn cos_refracted(&self, [eta_i, eta_t]: [Approx; 2], doubt: &mut Doubt) -> Option<Approx> {
        let across = self.n.cross(self.d);
        let rest = 1.0 - (eta_i / eta_t).squared() * across.dot(across);
        doubt.note(Decision::TotalReflection, rest.slack());
        (rest.value > 0.0).then(|| rest.sqrt())
    }

    /// Returns the refracted direction d' = η d + (η cos θi - cos θt) n.
    pub fn refracted(&self, etas: [Approx; 2], doubt: &mut Doubt) -> Option<Approx3> {
        let cos_t = self.cos_refracted(etas, doubt)?;
        let eta = etas[0] / etas[1];
        Some((self.d * eta + self.n * (eta * self.cos - cos_t)).normalize())
    }

    /// Evaluates Fresnel's equations at a boundary: the squares of both amplitudes.
    fn fresnel(&self, etas: [Approx; 2], doubt: &mut Doubt) -> Option<[Approx; 2]> {
        let cos_t = self.cos_refracted(etas, doubt)?;
        let [eta_i, eta_t] = etas;
        let amplitude = |a: Approx, b: Approx| (a - b) / (a + b);
        let s = amplitude(eta_i * self.cos, eta_t * cos_t);
        let p = amplitude(eta_t * self.cos, eta_i * cos_t);
        Some([s, p].map(|r| r.squared().known_within(0.0, 1.0)))
    }

    /// Returns the division of light at the boundary of two interiors.
    pub fn at_boundary(&self, etas: [Approx; 2], doubt: &mut Doubt) -> Division {
        let shares = self.fresnel(etas, doubt);
        Division::of(shares.map(|shares| shares.map(|r| (r, 1.0 - r))))
    }

    /// Returns the division of light at a thin wall, with all reflections between its faces: 2R / (1 + R) and
    /// (1 - R) / (1 + R).
    fn at_wall(&self, etas: [Approx; 2], doubt: &mut Doubt) -> Division {
        let shares = self.fresnel(etas, doubt);
        let series = |r: Approx| ((r + r) / (Approx::ONE + r), (1.0 - r) / (Approx::ONE + r));
        Division::of(shares.map(|shares| shares.map(series)))
    }
}

impl Division {
    fn of(polarised: Option<[(Approx, Approx); 2]>) -> Division {
        let Some([s, p]) = polarised else {
            return Division {
                reflectance: Approx::ONE,
                transmittance: Approx::ZERO,
                is_total: true,
            };
        };
        Division {
            reflectance: (s.0 + p.0) * 0.5,
            transmittance: (s.1 + p.1) * 0.5,
            is_total: false,
        }
    }
}

impl Boundary<'_> {
    /// Returns whether it is a thin wall without interior, through which light passes straight.
    pub fn is_wall(&self) -> bool {
        !is_body(self.material)
    }

    /// Returns the indices before and behind the boundary.
    pub fn etas(&self, scene: &Scene, wavelength: f64) -> [Approx; 2] {
        self.sides.map(|body| index(scene, body, wavelength))
    }

    /// Returns the division of light of this wavelength.
    pub fn division(
        &self,
        scene: &Scene,
        incidence: &Incidence,
        wavelength: f64,
        doubt: &mut Doubt,
    ) -> Division {
        let etas = self.etas(scene, wavelength);
        match self.material.interior {
            _ if !self.is_wall() => incidence.at_boundary(etas, doubt),
            Some(inside) => {
                let etas = [etas[0], index_of(self.material, wavelength)];
                match inside.kind {
                    MediumKind::ThinFace => incidence.at_boundary(etas, doubt),
                    _ => incidence.at_wall(etas, doubt),
                }
            }
            // A thin surface without an index: transmits all light.
            None => Division {
                reflectance: Approx::ZERO,
                transmittance: Approx::ONE,
                is_total: false,
            },
        }
    }
}
