//! Nested dielectrics: which bodies light goes through, one after the other, where they overlap by priority.
//!
//! Light falls straight through a stack of bodies, so it goes on straight. Each boundary that counts takes its share by
//! Fresnel's equations and each body swallows by its thickness, in each channel another part: what comes out tells the
//! sequence. With the indices here a boundary more or less changes it by 4·10^-4 or more.

use glam::{DAffine3, DVec3};

use super::meshes::{lattice_cube, scene};
use super::trial::{Answer, Tally, Trial};
use super::{Asks, Case, Closes};
use crate::accel::AccelError;
use crate::mesh::Mesh;
use crate::numeric::SplitMix64;
use crate::optics::{Absorption, Dispersion};
use crate::scene::{
    Background, Camera, Geometry, Instance, Interior, Lecture, Material, Model, Projection, Scene,
};
use crate::shape::Shape;

pub(super) const CASES: &[Case] = &[Case {
    id: "H38",
    title: "nested dielectrics",
    construction: "stacks of 2 to 6 bodies of any priorities, each within others, across them or with walls 64 roundings apart, seen from outside and from inside",
    oracle: "the walls in their order along the ray: the shares of those that count, and the depths between them",
    bound: "no boundary more or less: light to the derived roundings of f32",
    unit: "of the bound",
    asks: Asks::Shapes,
    required: Closes::Faces,
    run: nested,
}];

/// Indices of refraction, any two of which reflect at least 4·10^-4.
const INDICES: [f64; 6] = [1.2, 1.31, 1.45, 1.6, 1.9, 2.42];
/// Walls are at least so far apart, 64 roundings of coordinates up to 1.
const GAP: f32 = 1.0 / (1 << 17) as f32;
/// Rays of a picture, about: of 16 pixels.
const RAYS_A_PICTURE: u64 = 16 * FOLLOWED;
/// Rays a pixel, about: one for each wall.
const FOLLOWED: u64 = 8;
/// Stacks at most: larger pictures of each where there are more questions.
const MAX_STACKS: u64 = 2000;

/// A body between two heights.
struct Layer {
    low: f32,
    high: f32,
    /// Half its width, more than what is seen: another for each, so that no walls coincide at the sides either.
    half: f32,
    priority: i32,
    ior: f64,
    /// Per unit of length.
    sigma: [f64; 3],
    is_mesh: bool,
}

/// Layers from the first on, and the height of the eye, which looks down.
struct Stack {
    layers: Vec<Layer>,
    eye: f32,
}

impl Stack {
    /// A stack whose walls are far enough apart, as is the eye from all of them.
    fn any(random: &mut SplitMix64) -> Stack {
        loop {
            let count = 2 + random.below(5);
            let mut walls: Vec<f32> = Vec::new();
            while walls.len() < 2 * count {
                let beside = GAP * (random.below(129) as f32 - 64.0);
                let near = if walls.is_empty() {
                    0.0
                } else {
                    random.pick(&walls)
                };
                let anywhere = random.within(-1.0, 1.0) as f32;
                walls.push(random.pick(&[near + beside, anywhere]));
            }
            let anywhere = random.within(-1.0, 1.0) as f32;
            let eye = random.pick(&[2.0, anywhere]);
            let mut sorted = walls.clone();
            sorted.sort_by(f32::total_cmp);
            let is_wide = sorted.windows(2).all(|pair| pair[1] - pair[0] >= GAP);
            if is_wide && walls.iter().all(|wall| (wall - eye).abs() > 1024.0 * GAP) {
                let pairs = walls.chunks_exact(2).enumerate();
                let layers = pairs.map(|(number, pair)| Layer::any(number, pair, random));
                return Stack {
                    layers: layers.collect(),
                    eye,
                };
            }
        }
    }

    /// The layer that is there where those of `around` are, by priority and then the first.
    fn present(&self, around: &[usize]) -> Option<usize> {
        let rank = |&number: &usize| (self.layers[number].priority, -(number as i64));
        around.iter().copied().max_by_key(rank)
    }

    /// What comes from below with 1 in each channel, and by what share of itself it may be off.
    fn light(&self) -> ([f64; 3], f64) {
        let mut walls: Vec<(f32, usize)> = Vec::new();
        let mut around: Vec<usize> = Vec::new();
        for (number, layer) in self.layers.iter().enumerate() {
            walls.extend([(layer.low, number), (layer.high, number)]);
            if layer.low < self.eye && self.eye < layer.high {
                around.push(number);
            }
        }
        walls.retain(|&(z, _)| z < self.eye);
        walls.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut light, mut depth, mut z) = (1.0, [0.0; 3], f64::from(self.eye));
        for &(wall, number) in &walls {
            let before = self.present(&around);
            let thickness = z - f64::from(wall);
            if let Some(before) = before {
                (0..3).for_each(|c| depth[c] += self.layers[before].sigma[c] * thickness);
            }
            z = wall.into();
            match around.iter().position(|&other| other == number) {
                Some(place) => drop(around.remove(place)),
                None => around.push(number),
            }
            let [a, b] = [before, self.present(&around)]
                .map(|layer| layer.map_or(1.0, |layer| self.layers[layer].ior));
            light *= 4.0 * a * b / ((a + b) * (a + b));
        }
        // A share, a weight and an exponential are rounded at each wall, and so are their products; a ray starts up to
        // half a gap behind the wall that it has passed.
        let roundings = 8.0 / f64::from(1 << 24);
        // Where nothing is below, nothing is rounded but the sum.
        let bound = walls.len().max(1) as f64 * (roundings + MAX_SIGMA * 0.5 * f64::from(GAP));
        (depth.map(|depth: f64| light * (-depth).exp()), bound)
    }

    fn scene(&self) -> Scene {
        let geometries = self.layers.iter().map(|layer| match layer.is_mesh {
            true => Geometry::Mesh(layer.mesh()),
            false => Geometry::Shape(Shape::Cube),
        });
        let mut scene = scene(geometries.collect());
        scene.background = Background::Uniform([1.0; 3]);
        scene.materials = self.layers.iter().map(Layer::material).collect();
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

    /// Looks down from the eye, a little aside so that no ray runs along a diagonal.
    fn camera(&self) -> Camera {
        Camera {
            world_from_camera: DAffine3::from_translation(DVec3::new(0.013, 0.029, self.eye.into())),
            projection: Projection::Orthographic {
                y_mag: 0.4,
                x_mag: None,
            },
            ..Camera::default()
        }
    }
}

/// Most that a unit of length swallows, as an exponent.
const MAX_SIGMA: f64 = 0.5;

impl Layer {
    fn any(number: usize, walls: &[f32], random: &mut SplitMix64) -> Layer {
        Layer {
            half: 1.5 + 0.125 * number as f32,
            low: walls[0].min(walls[1]),
            high: walls[0].max(walls[1]),
            priority: random.below(4) as i32,
            ior: random.pick(&INDICES),
            sigma: [(); 3].map(|()| MAX_SIGMA * random.unit()),
            is_mesh: random.below(2) == 0,
        }
    }

    /// From the cube [-1, 1]³.
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
            // All that is let through, nothing mirrored.
            model: Model::Lecture(Lecture {
                ambient: [0.0; 3],
                diffuse: [0.0; 3],
                transmission: [1.0; 3],
                fresnel: true,
                ..Lecture::DEFAULT
            }),
            interior: Some(Interior {
                ior: Dispersion::Constant(self.ior),
                absorption: Absorption { sigma_a: self.sigma },
                priority: self.priority,
                is_thin: false,
            }),
            ..Material::default()
        }
    }
}

fn nested(trial: &Trial) -> Result<Tally, AccelError> {
    let stack_count = trial.rays.div_ceil(RAYS_A_PICTURE).min(MAX_STACKS);
    let size = (trial.rays / (FOLLOWED * stack_count)).isqrt().max(4) as u32;
    trial.over_parts(stack_count as usize, &|number, _| {
        let mut tally = Tally::default();
        let stack = Stack::any(&mut SplitMix64::new(0x38, number as u64));
        let scene = stack.scene();
        let Some(rendering) = trial.picture((&scene, &stack.camera()), size, (64, 0.0))? else {
            return Ok(tally);
        };
        let (light, bound) = stack.light();
        for pixel in &rendering.image.pixels {
            let off = |c: usize| (f64::from(pixel[c]) - light[c]).abs() / (bound * light[c]);
            let worst = off(0).max(off(1)).max(off(2));
            tally.note(worst);
            tally.count(Answer::wrong_if(!(worst <= 1.0)), || {
                format!("stack {number}: {pixel:?}, not {light:?}")
            });
        }
        tally.count_followed(&rendering);
        Ok(tally)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layer(low: f32, high: f32, priority: i32, ior: f64) -> Layer {
        Layer {
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
    fn a_stack_seen_from_above_and_from_inside_lets_through_what_its_walls_do() {
        // Glass over [0, 1] hides the upper half of what fills [-1, 0.5].
        let share = |a: f64, b: f64| 4.0 * a * b / ((a + b) * (a + b));
        let seen = |eye| {
            let stack = Stack {
                layers: vec![layer(0.0, 1.0, 1, 1.5), layer(-1.0, 0.5, 0, 1.25)],
                eye,
            };
            stack.light().0
        };
        let walls = share(1.0, 1.5) * share(1.5, 1.25) * share(1.25, 1.0);
        // Two units of way, a quarter swallowed in each.
        assert!((seen(2.0)[0] - walls * (-0.5f64).exp()).abs() < 1e-15);
        let inner = share(1.25, 1.0) * (-0.125f64).exp();
        assert!((seen(-0.5)[0] - inner).abs() < 1e-15);
    }
}
