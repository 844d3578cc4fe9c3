//! Nested dielectrics: the sequence of media along a ray where objects overlap and priorities decide.
//!
//! Rays pass straight down through a stack of layers, so their direction does not change. Each boundary that counts
//! transmits a share given by Fresnel's equations, and each medium absorbs by its thickness with a different
//! coefficient in each channel: the transmitted radiance reveals the sequence. With the indices used here one boundary
//! more or less changes the radiance by 4·10^-4 or more.

use glam::{DAffine3, DVec3};

use crate::accel::AccelError;
use crate::mesh::Mesh;
use crate::numeric::SplitMix64;
use crate::optics::{Absorption, Dispersion};
use crate::scene::{
    Background, Camera, Geometry, Instance, Material, Medium, MediumKind, Model, Phong, Projection, Scene,
};
use crate::shape::Shape;
use crate::verify::harness::test_meshes::{lattice_cube, scene};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H38",
    title: "nested dielectrics",
    construction: "stacks of 2 to 6 media of any priorities, nested, overlapping or with walls 64 roundings apart, \
        seen from outside and from inside",
    oracle: "the walls in order along the ray: the transmittances of the effective ones, and the depths between them",
    bound: "no boundary more or less: radiance to the derived f32 rounding bound",
    unit: "of the bound",
    run: nested,
    ..Case::SHAPES
}];

/// Indices of refraction, any two of which reflect at least 4·10^-4.
const INDICES: [f64; 6] = [1.2, 1.31, 1.45, 1.6, 1.9, 2.42];
/// Smallest distance between two boundaries, 64 roundings of coordinates up to 1.
const GAP: f32 = 1.0 / (1 << 17) as f32;
/// Approximate number of rays of an image of 16 pixels.
const RAYS_PER_IMAGE: u64 = 16 * FOLLOWED;
/// Approximate number of rays a pixel, one for each boundary.
const FOLLOWED: u64 = 8;
/// Largest number of stacks; beyond it, their images get larger.
const MAX_STACKS: u64 = 2000;

/// Dielectric layer between two heights.
struct MediumLayer {
    low: f32,
    high: f32,
    /// Half width of the layer, larger than the view and different for each layer, so that sides never coincide.
    half: f32,
    priority: i32,
    ior: f64,
    /// Absorption coefficient per unit of length in each channel.
    sigma: [f64; 3],
    is_mesh: bool,
}

/// Layers in the order of their instances, and the height of the camera, which looks down.
struct MediumStack {
    layers: Vec<MediumLayer>,
    camera_height: f32,
}

impl MediumStack {
    /// Returns a random stack in which the boundaries are far enough apart, and the camera from all of them.
    fn any(random: &mut SplitMix64) -> MediumStack {
        loop {
            let count = 2 + random.below(5);
            let mut boundaries: Vec<f32> = Vec::new();
            // Choose heights anywhere, or close to another boundary
            while boundaries.len() < 2 * count {
                let beside = GAP * (random.below(129) as f32 - 64.0);
                let near = if boundaries.is_empty() {
                    0.0
                } else {
                    random.choose(&boundaries)
                };
                let anywhere = random.within(-1.0, 1.0) as f32;
                boundaries.push(random.choose(&[near + beside, anywhere]));
            }
            // Place the camera above the stack or inside it
            let anywhere = random.within(-1.0, 1.0) as f32;
            let camera_height = random.choose(&[2.0, anywhere]);
            let mut sorted = boundaries.clone();
            sorted.sort_by(f32::total_cmp);
            // Reject boundaries that are too close to each other or to the camera
            let is_wide = sorted.windows(2).all(|pair| pair[1] - pair[0] >= GAP);
            if is_wide
                && boundaries
                    .iter()
                    .all(|wall| (wall - camera_height).abs() > 1024.0 * GAP)
            {
                let pairs = boundaries.chunks_exact(2).enumerate();
                let layers = pairs.map(|(number, pair)| MediumLayer::any(number, pair, random));
                return MediumStack {
                    layers: layers.collect(),
                    camera_height,
                };
            }
        }
    }

    /// Returns the layer whose medium prevails among the overlapping layers `around`: the highest priority, then the
    /// first.
    fn present(&self, around: &[usize]) -> Option<usize> {
        let rank = |&number: &usize| (self.layers[number].priority, -(number as i64));
        around.iter().copied().max_by_key(rank)
    }

    /// Returns the radiance from below if it enters with 1 in each channel, and its relative error bound.
    fn light(&self) -> ([f64; 3], f64) {
        let mut boundaries: Vec<(f32, usize)> = Vec::new();
        let mut around: Vec<usize> = Vec::new();
        // Find the layers around the camera and the boundaries below it
        for (number, layer) in self.layers.iter().enumerate() {
            boundaries.extend([(layer.low, number), (layer.high, number)]);
            if layer.low < self.camera_height && self.camera_height < layer.high {
                around.push(number);
            }
        }
        boundaries.retain(|&(z, _)| z < self.camera_height);
        boundaries.sort_by(|a, b| b.0.total_cmp(&a.0));
        // Walk down through the boundaries
        let (mut light, mut depth, mut z) = (1.0, [0.0; 3], f64::from(self.camera_height));
        for &(wall, number) in &boundaries {
            let before = self.present(&around);
            // Absorb along the way to this boundary
            let thickness = z - f64::from(wall);
            if let Some(before) = before {
                (0..3).for_each(|c| depth[c] += self.layers[before].sigma[c] * thickness);
            }
            z = wall.into();
            // Enter or leave the layer
            match around.iter().position(|&other| other == number) {
                Some(place) => drop(around.remove(place)),
                None => around.push(number),
            }
            // Apply the Fresnel transmittance at normal incidence, which is 1 between equal media
            let [a, b] = [before, self.present(&around)]
                .map(|layer| layer.map_or(1.0, |layer| self.layers[layer].ior));
            light *= 4.0 * a * b / ((a + b) * (a + b));
        }
        // Transmittance, throughput and exponential are rounded at each boundary, as are their products; a spawned ray
        // starts up to half a gap behind the boundary.
        let roundings = 8.0 / f64::from(1 << 24);
        // Even without a boundary below, the sum is rounded once.
        let bound = boundaries.len().max(1) as f64 * (roundings + MAX_SIGMA * 0.5 * f64::from(GAP));
        (depth.map(|depth: f64| light * (-depth).exp()), bound)
    }

    fn scene(&self) -> Scene {
        let geometries = self.layers.iter().map(|layer| match layer.is_mesh {
            true => Geometry::Mesh(layer.mesh()),
            false => Geometry::Shape(Shape::Cube),
        });
        let mut scene = scene(geometries.collect());
        scene.background = Background::Uniform([1.0; 3]);
        scene.materials = self.layers.iter().map(MediumLayer::material).collect();
        let instances = self.layers.iter().zip(0..).map(|(layer, number)| {
            let map = match layer.is_mesh {
                true => DAffine3::IDENTITY,
                false => layer.map(),
            };
            Instance::new("", number, number, map)
        });
        scene.instances = instances.filter_map(Result::ok).collect();
        scene
    }

    /// Returns a camera that looks down, slightly off the axis so that no ray runs along a diagonal.
    fn camera(&self) -> Camera {
        Camera {
            world_from_camera: DAffine3::from_translation(DVec3::new(
                0.013,
                0.029,
                self.camera_height.into(),
            )),
            projection: Projection::Orthographic {
                y_mag: 0.4,
                x_mag: None,
            },
            ..Camera::default()
        }
    }
}

/// Largest absorption coefficient per unit of length.
const MAX_SIGMA: f64 = 0.5;

impl MediumLayer {
    fn any(number: usize, boundaries: &[f32], random: &mut SplitMix64) -> MediumLayer {
        MediumLayer {
            half: 1.5 + 0.125 * number as f32,
            low: boundaries[0].min(boundaries[1]),
            high: boundaries[0].max(boundaries[1]),
            priority: random.below(4) as i32,
            ior: random.choose(&INDICES),
            sigma: [(); 3].map(|()| MAX_SIGMA * random.unit()),
            is_mesh: random.below(2) == 0,
        }
    }

    /// Returns the transform from the cube [-1, 1]³ to the layer.
    fn map(&self) -> DAffine3 {
        let (low, high) = (f64::from(self.low), f64::from(self.high));
        let half = f64::from(self.half);
        let scale = DVec3::new(half, half, 0.5 * (high - low));
        DAffine3 {
            matrix3: glam::DMat3::from_diagonal(scale),
            translation: 0.5 * (high + low) * DVec3::Z,
        }
    }

    fn mesh(&self) -> Mesh {
        let cube = lattice_cube(1);
        let place = |&[x, y, z]: &[f32; 3]| {
            let height = if z == 0.0 { self.low } else { self.high };
            let [x, y] = [x, y].map(|side| (2.0 * side - 1.0) * self.half);
            [x, y, height]
        };
        let positions: Vec<[f32; 3]> = cube.positions.iter().map(place).collect();
        Mesh {
            positions: positions.into(),
            ..cube
        }
    }

    fn material(&self) -> Material {
        Material {
            // Transmit everything that is not reflected, and ignore the reflection
            model: Model::Phong(Phong {
                ambient: [0.0; 3],
                diffuse: [0.0; 3],
                transmission: [1.0; 3],
                fresnel: true,
                ..Phong::DEFAULT
            }),
            interior: Some(Medium {
                ior: Dispersion::Constant(self.ior),
                absorption: Absorption { sigma_a: self.sigma },
                priority: self.priority,
                kind: MediumKind::Solid,
            }),
            ..Material::default()
        }
    }
}

fn nested(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let stack_count = trial.rays.div_ceil(RAYS_PER_IMAGE).min(MAX_STACKS);
    let size = (trial.rays / (FOLLOWED * stack_count)).isqrt().max(4) as u32;
    trial.over_parts(stack_count as usize, &|number, _| {
        let mut tally = Counts::default();
        // Render a random stack
        let stack = MediumStack::any(&mut SplitMix64::new(0x38, number as u64));
        let scene = stack.scene();
        let Some(rendering) = trial.render_image((&scene, &stack.camera()), size, (64, 0.0))? else {
            return Ok(tally);
        };
        // Compare each pixel with the expected radiance
        let (light, bound) = stack.light();
        for pixel in &rendering.image.pixels {
            let off = |c: usize| (f64::from(pixel[c]) - light[c]).abs() / (bound * light[c]);
            let worst = off(0).max(off(1)).max(off(2));
            tally.record_error(worst);
            tally.count(Correctness::wrong_if(!(worst <= 1.0)), || {
                format!("stack {number}: {pixel:?}, not {light:?}")
            });
        }
        tally.count_secondary_rays(&rendering);
        Ok(tally)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layer(low: f32, high: f32, priority: i32, ior: f64) -> MediumLayer {
        MediumLayer {
            low,
            high,
            half: 1.0,
            priority,
            ior,
            sigma: [0.25, 0.5, 0.0],
            is_mesh: false,
        }
    }

    #[test]
    fn stack_transmittance_equals_product_of_its_walls() {
        // The medium over [0, 1] has priority and hides the upper part of the one over [-1, 0.5].
        let share = |a: f64, b: f64| 4.0 * a * b / ((a + b) * (a + b));
        let seen = |camera_height| {
            let stack = MediumStack {
                layers: vec![layer(0.0, 1.0, 1, 1.5), layer(-1.0, 0.5, 0, 1.25)],
                camera_height,
            };
            stack.light().0
        };
        let boundaries = share(1.0, 1.5) * share(1.5, 1.25) * share(1.25, 1.0);
        // The path is two units long, with absorption coefficient 1/4.
        assert!((seen(2.0)[0] - boundaries * (-0.5f64).exp()).abs() < 1e-15);
        let inner = share(1.25, 1.0) * (-0.125f64).exp();
        assert!((seen(-0.5)[0] - inner).abs() < 1e-15);
    }
}
