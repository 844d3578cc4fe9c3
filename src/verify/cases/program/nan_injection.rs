//! NaN injection: a NaN in any number of a scene must be rejected before it reaches an image.

use bytemuck::Pod;
use glam::{DAffine3, DVec3};

use crate::accel::AccelError;
use crate::buffer::Buffer;
use crate::mesh::Mesh;
use crate::numeric::{Bounds, SplitMix64};
use crate::optics::subsurface::Scattering;
use crate::optics::{Absorption, Dispersion};
use crate::scene::{
    AlphaMode, Aperture, AreaShape, Background, Camera, Falloff, Filter, Geometry, Image, Instance, Lens,
    Light, LightKind, Material, MaterialInput, Medium, MediumKind, MetallicRoughness, Model, Pattern, Phong,
    Procedural, Projection, Sampler, Scene, Shutter, Space, Texels, Texture, TextureBinding, TextureUse,
    Translucency, Wrap,
};
use crate::shape::{HalfSpace, Polyhedron, Quadric, Shape, Sphere, Torus};
use crate::verify::harness::test_meshes::{icosphere, scene};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts};
use crate::volume::{Fog, Grid, GridSamples};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H45",
    title: "NaN in every input",
    construction: "NaN in a vertex, a texel, a light, an index of refraction, a transform, a camera and so on, one at a time",
    oracle: "NaN is never valid, and adding 0 changes nothing",
    bound: "rejected before the render with the name of its item; the same scene without NaN is accepted",
    run: inject_nan,
    ..Case::FORMULAS
}];

/// Returns a valid scene with an object of each kind, so that NaN can be injected anywhere.
fn sound_scene() -> Scene {
    // Give the mesh every vertex attribute
    let mut mesh = icosphere(1);
    let count = mesh.positions.len();
    mesh.normals = Some(mesh.positions.clone());
    mesh.tangents = Some(vec![[1.0, 0.0, 0.0, 1.0]; count].into());
    mesh.tex_coords = vec![vec![[0.25; 2]; count].into()];
    mesh.colors = Some(vec![[1.0; 4]; count].into());
    let image = |name: &str| Image {
        name: name.into(),
        width: 4,
        height: 4,
        texels: Texels::Floats(vec![[0.5, 0.5, 1.0, 1.0]; 16].into()),
    };
    Scene {
        images: vec![image("texels")],
        textures: vec![Texture::Image {
            image: 0,
            sampler: Sampler {
                wrap_u: Wrap::Repeat,
                wrap_v: Wrap::Repeat,
                filter: Filter::Linear,
            },
        }],
        cameras: vec![Camera::default()],
        ..scene(vec![
            Geometry::Mesh(mesh),
            Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
        ])
    }
}

/// Function that adds 0 or NaN to a number of a scene.
type Add = fn(&mut Scene, &mut SplitMix64, f64) -> Result<(), String>;

/// Items that an error must name, with the functions that change their numbers. Where a constructor rejects the value
/// before there is a scene, the returned error must name the item.
static INPUTS: [(&str, &[Add]); 16] = [
    // Vertex attributes
    (
        "geometry 0",
        &[
            |s, r, x| mesh(s, |m| m.positions = with(&m.positions, r, x)),
            |s, r, x| mesh(s, |m| m.normals = m.normals.as_ref().map(|v| with(v, r, x))),
            |s, r, x| mesh(s, |m| m.tangents = m.tangents.as_ref().map(|v| with(v, r, x))),
            |s, r, x| mesh(s, |m| m.colors = m.colors.as_ref().map(|v| with(v, r, x))),
            |s, r, x| mesh(s, |m| m.tex_coords[0] = with(&m.tex_coords[0], r, x)),
        ],
    ),
    // Shapes and transforms
    (
        "geometry 1",
        &[
            |s, _, x| sphere(s, DVec3::ZERO, 1.0 + x),
            |s, r, x| sphere(s, add_to_one(DVec3::ZERO, r, x), 1.0),
            |s, _, x| {
                s.geometries[1] = Geometry::Shape(Shape::Torus(Torus {
                    minor_radius: 0.5 + x,
                }));
                Ok(())
            },
        ],
    ),
    (
        "quadric",
        &[|_, r, x| {
            let mut q = [1.0; 10];
            q[r.below(10)] += x;
            constructor_result(Quadric::new(q, Bounds::of_points([-DVec3::ONE, DVec3::ONE])))
        }],
    ),
    (
        "polyhedron",
        &[|_, r, x| {
            let mut corners = [DVec3::ONE, -DVec3::X, -DVec3::Y, -DVec3::Z];
            let side = r.below(4);
            corners[side] = add_to_one(corners[side], r, x);
            constructor_result(Polyhedron::from_half_spaces(
                &corners.map(|n| HalfSpace { n, h: 1.0 }),
            ))
        }],
    ),
    (
        "matrix",
        &[
            |_, r, x| constructor_result(Instance::new("", 0, 0, map(r, x))),
            |_, r, x| {
                let moved = DAffine3::from_translation(DVec3::X);
                let mut maps = [map(r, x), moved];
                maps.swap(0, r.below(2));
                constructor_result(Instance::moving("", 0, 0, maps))
            },
        ],
    ),
    // Materials
    (
        "material 0",
        &[
            |s, r, x| material(s, |m| m.base_color[r.below(4)] += x as f32),
            |s, r, x| material(s, |m| m.emission[r.below(3)] += x as f32),
            |s, _, x| material(s, |m| m.alpha = AlphaMode::Mask(0.5 + x as f32)),
            |s, _, x| gltf(s, |m| m.metallic += x as f32),
            |s, _, x| gltf(s, |m| m.roughness += x as f32),
            |s, _, x| gltf(s, |m| m.specular += x as f32),
            |s, r, x| gltf(s, |m| m.specular_color[r.below(3)] += x as f32),
            |s, _, x| gltf(s, |m| m.transmission += x as f32),
            |s, r, x| phong(s, |m| m.ambient[r.below(3)] += x as f32),
            |s, r, x| phong(s, |m| m.diffuse[r.below(3)] += x as f32),
            |s, r, x| phong(s, |m| m.specular[r.below(3)] += x as f32),
            |s, _, x| phong(s, |m| m.exponent += x as f32),
            |s, r, x| phong(s, |m| m.reflection[r.below(3)] += x as f32),
            |s, r, x| phong(s, |m| m.transmission[r.below(3)] += x as f32),
            // Interiors and translucency
            |s, _, x| interior(s, |i| i.ior = Dispersion::Constant(1.5 + x)),
            |s, r, x| interior(s, |i| i.absorption.sigma_a[r.below(3)] += x),
            |s, r, x| scattering(s, |medium| medium.sigma_s_reduced[r.below(3)] += x),
            |s, r, x| scattering(s, |medium| medium.sigma_a[r.below(3)] += x),
            |s, _, x| scattering(s, |medium| medium.eta += x),
            |s, _, x| translucency(s, |t| t.factor += x as f32),
            |s, r, x| translucency(s, |t| t.color[r.below(3)] += x as f32),
            // Textures
            |s, _, x| layer(s, MaterialInput::Normal, |l| l.strength += x as f32),
            |s, r, x| {
                let (row, column) = (r.below(2), r.below(2));
                layer(s, MaterialInput::BaseColor, |l| {
                    l.texture.transform.matrix[row][column] += x as f32
                })
            },
            |s, r, x| {
                layer(s, MaterialInput::BaseColor, |l| {
                    l.texture.transform.offset[r.below(2)] += x as f32
                })
            },
            |s, r, x| texel(s, MaterialInput::BaseColor, r.below(4), (r, x)),
            |s, r, x| texel(s, MaterialInput::Emission, r.below(3), (r, x)),
            |s, r, x| texel(s, MaterialInput::MetallicRoughness, 1 + r.below(2), (r, x)),
            |s, r, x| texel(s, MaterialInput::Specular, 3, (r, x)),
            |s, r, x| texel(s, MaterialInput::SpecularColor, r.below(3), (r, x)),
            |s, r, x| texel(s, MaterialInput::Occlusion, 0, (r, x)),
            |s, r, x| texel(s, MaterialInput::Normal, r.below(3), (r, x)),
            |s, r, x| texel(s, MaterialInput::Bump, 0, (r, x)),
        ],
    ),
    (
        "texture 0",
        &[
            |s, r, x| procedural(s, |p| p.colors[r.below(2)][r.below(4)] += x as f32),
            |s, r, x| procedural(s, |p| p.scale[r.below(3)] += x),
            |s, _, x| procedural(s, |p| p.pattern = Pattern::Wood { turbulence: 1.0 + x }),
        ],
    ),
    // Lights
    (
        "light 0",
        &[
            |s, r, x| {
                let to_light = DVec3::Y;
                s.lights = vec![light(LightKind::Directional { to_light })];
                s.lights[0].intensity[r.below(3)] += x as f32;
                Ok(())
            },
            |s, r, x| {
                set_light(
                    s,
                    LightKind::Directional {
                        to_light: add_to_one(DVec3::Y, r, x),
                    },
                )
            },
            |s, r, x| set_light(s, point(add_to_one(DVec3::ONE, r, x), 1.0)),
            |s, _, x| set_light(s, point(DVec3::ONE, 1.0 + x)),
            |s, r, x| {
                let [constant, linear, quadratic] = any([1.0; 3], r, x);
                let falloff = Falloff::Polynomial {
                    constant,
                    linear,
                    quadratic,
                };
                set_light(
                    s,
                    LightKind::Point {
                        position: DVec3::ONE,
                        falloff,
                    },
                )
            },
            |s, r, x| set_light(s, spot(add_to_one(DVec3::X, r, x), [0.9, 0.8])),
            |s, r, x| set_light(s, spot(DVec3::X, any([0.9, 0.8], r, x))),
            |s, r, x| set_light(s, area(r, x)),
        ],
    ),
    // Cameras
    (
        "camera 0",
        &[
            |s, r, x| camera(s, |c| c.world_from_camera = map(r, x)),
            |s, r, x| camera(s, |c| c.world_from_camera_end = Some(map(r, x))),
            |s, r, x| camera(s, |c| c.projection = projection(r, x)),
            |s, r, x| camera(s, |c| [c.z_near, c.z_far] = any([1.0, 2.0], r, x)),
            |s, r, x| {
                let [open, close] = any([0.25, 0.5], r, x);
                camera(s, |c| c.shutter = Shutter { open, close })
            },
        ],
    ),
    (
        "lens",
        &[|_, _, x| constructor_result(Lens::new(0.1 + x, 1.0, Aperture::Disk))],
    ),
    (
        "focus",
        &[|_, _, x| constructor_result(Lens::new(0.1, 1.0 + x, Aperture::Disk))],
    ),
    // Ambient light, background and volumes
    (
        "the ambient light",
        &[|s, r, x| {
            s.ambient[r.below(3)] += x as f32;
            Ok(())
        }],
    ),
    (
        "the background",
        &[|s, r, x| {
            let mut colors = [[0.5; 3]; 3];
            colors[r.below(3)][r.below(3)] += x as f32;
            let [horizon, up, down] = colors;
            s.background = Background::Gradient { horizon, up, down };
            Ok(())
        }],
    ),
    (
        "the environment map",
        &[|s, r, x| {
            let [rotation, scale, texel] = any([0.5; 3], r, x);
            change_texel(s, r.below(16), |color| color[r.below(3)] = texel as f32);
            let scale = scale as f32;
            s.background = Background::Environment {
                image: 0,
                rotation,
                scale,
                samples: 1,
            };
            Ok(())
        }],
    ),
    (
        "fog",
        &[|_, r, x| {
            let [extinction, red, green, blue, step, c, m, y] = any([0.5; 8], r, x);
            constructor_result(Fog::new(extinction, [red, green, blue], [c, m, y], step))
        }],
    ),
    (
        "grid",
        &[|_, r, x| {
            let mut samples = vec![0.5; 8];
            samples[r.below(8)] += x as f32;
            constructor_result(Grid::new([2; 3], GridSamples::Floats(samples)))
        }],
    ),
];

/// Returns the numbers with `x` added to a random one.
fn any<const N: usize>(mut values: [f64; N], random: &mut SplitMix64, x: f64) -> [f64; N] {
    values[random.below(N)] += x;
    values
}

fn add_to_one(v: DVec3, random: &mut SplitMix64, x: f64) -> DVec3 {
    any(v.to_array(), random, x).into()
}

/// Returns the identity transform with `x` added to a random number.
fn map(random: &mut SplitMix64, x: f64) -> DAffine3 {
    DAffine3::from_cols_array(&any(DAffine3::IDENTITY.to_cols_array(), random, x))
}

/// Returns vertex attributes with `x` added to a random number.
fn with<T: Pod>(values: &Buffer<T>, random: &mut SplitMix64, x: f64) -> Buffer<T> {
    let mut values = values.to_vec();
    let numbers: &mut [f32] = bytemuck::cast_slice_mut(&mut values);
    let number = random.below(numbers.len());
    numbers[number] += x as f32;
    values.into()
}

/// Converts the result of a constructor to its error message.
fn constructor_result<T, E: ToString>(result: Result<T, E>) -> Result<(), String> {
    result.map(|_| ()).map_err(|error| error.to_string())
}

fn mesh(scene: &mut Scene, change: impl FnOnce(&mut Mesh)) -> Result<(), String> {
    if let Geometry::Mesh(mesh) = &mut scene.geometries[0] {
        change(mesh);
    }
    Ok(())
}

fn sphere(scene: &mut Scene, center: DVec3, radius: f64) -> Result<(), String> {
    scene.geometries[1] = Geometry::Shape(Shape::Sphere(Sphere { center, radius }));
    Ok(())
}

fn material(scene: &mut Scene, change: impl FnOnce(&mut Material)) -> Result<(), String> {
    change(&mut scene.materials[0]);
    Ok(())
}

/// Sets a glTF metallic-roughness material after a change.
fn gltf(scene: &mut Scene, change: impl FnOnce(&mut MetallicRoughness)) -> Result<(), String> {
    let mut model = MetallicRoughness::DEFAULT;
    change(&mut model);
    material(scene, |m| m.model = Model::MetallicRoughness(model))
}

/// Sets a Phong and Whitted material after a change.
fn phong(scene: &mut Scene, change: impl FnOnce(&mut Phong)) -> Result<(), String> {
    let mut model = Phong::DEFAULT;
    change(&mut model);
    material(scene, |m| m.model = Model::Phong(model))
}

fn interior(scene: &mut Scene, change: impl FnOnce(&mut Medium)) -> Result<(), String> {
    let mut interior = Medium {
        ior: Dispersion::Constant(1.5),
        absorption: Absorption::NONE,
        priority: 0,
        kind: MediumKind::Solid,
    };
    change(&mut interior);
    material(scene, |m| m.interior = Some(interior))
}

fn scattering(scene: &mut Scene, change: impl FnOnce(&mut Scattering)) -> Result<(), String> {
    let mut medium = Scattering {
        sigma_s_reduced: [1.0; 3],
        sigma_a: [0.1; 3],
        eta: 1.5,
    };
    change(&mut medium);
    material(scene, |m| m.subsurface = Some(medium))
}

fn translucency(scene: &mut Scene, change: impl FnOnce(&mut Translucency)) -> Result<(), String> {
    let mut translucency = Translucency {
        factor: 0.5,
        color: [0.5; 3],
    };
    change(&mut translucency);
    material(scene, |m| m.translucency = Some(translucency))
}

/// Sets a texture on a material input after a change.
fn layer(
    scene: &mut Scene,
    parameter: MaterialInput,
    change: impl FnOnce(&mut TextureBinding),
) -> Result<(), String> {
    let mut layer = TextureBinding {
        parameter,
        texture: TextureUse::new(0),
        strength: 1.0,
    };
    change(&mut layer);
    material(scene, |m| m.layers = vec![layer])
}

/// Changes a texel of the scene's first image, if that has floats.
fn change_texel(scene: &mut Scene, index: usize, change: impl FnOnce(&mut [f32; 4])) {
    if let Texels::Floats(texels) = &mut scene.images[0].texels {
        let mut changed = texels.to_vec();
        change(&mut changed[index]);
        *texels = changed.into();
    }
}

/// Adds `x` to a channel of a random texel, and binds the texture to a material input.
fn texel(
    scene: &mut Scene,
    parameter: MaterialInput,
    channel: usize,
    (random, x): (&mut SplitMix64, f64),
) -> Result<(), String> {
    change_texel(scene, random.below(16), |color| color[channel] += x as f32);
    layer(scene, parameter, |_| ())
}

fn procedural(scene: &mut Scene, change: impl FnOnce(&mut Procedural)) -> Result<(), String> {
    let mut procedural = Procedural {
        pattern: Pattern::Checker,
        colors: [[0.5; 4]; 2],
        space: Space::Uv,
        scale: [1.0; 3],
    };
    change(&mut procedural);
    scene.textures[0] = Texture::Procedural(procedural);
    Ok(())
}

fn light(kind: LightKind) -> Light {
    Light {
        name: String::new(),
        intensity: [1.0; 3],
        kind,
    }
}

fn set_light(scene: &mut Scene, kind: LightKind) -> Result<(), String> {
    scene.lights = vec![light(kind)];
    Ok(())
}

fn point(position: DVec3, range: f64) -> LightKind {
    let falloff = Falloff::InverseSquare { range: Some(range) };
    LightKind::Point { position, falloff }
}

fn spot(direction: DVec3, [cos_inner, cos_outer]: [f64; 2]) -> LightKind {
    LightKind::Spot {
        position: DVec3::ONE,
        direction,
        cos_inner,
        cos_outer,
        falloff: Falloff::InverseSquare { range: None },
    }
}

fn area(random: &mut SplitMix64, x: f64) -> LightKind {
    let mut sides = [DVec3::Y, DVec3::X, DVec3::Z];
    let side = random.below(3);
    sides[side] = add_to_one(sides[side], random, x);
    let [center, half_u, half_v] = sides;
    let radius = side as f64 + 1.0;
    let shape = match random.below(3) {
        0 => AreaShape::Quad {
            center,
            half_u,
            half_v,
        },
        1 => AreaShape::Disk {
            center,
            half_u,
            half_v,
        },
        // Spheres have no sides, so that the poisoned vector is unused; poison their own numbers instead.
        _ => {
            let [cx, cy, cz, radius] = any([0.0, 1.0, 0.0, radius], random, x);
            let center = DVec3::new(cx, cy, cz);
            AreaShape::Sphere { center, radius }
        }
    };
    LightKind::Area { shape, samples: 1 }
}

fn camera(scene: &mut Scene, change: impl FnOnce(&mut Camera)) -> Result<(), String> {
    change(&mut scene.cameras[0]);
    Ok(())
}

fn projection(random: &mut SplitMix64, x: f64) -> Projection {
    let [a, b, c] = any([1.0; 3], random, x);
    match random.below(3) {
        // The sum contains whichever of the numbers is NaN.
        0 => Projection::Perspective {
            y_fov: a + b + c - 2.0,
            aspect: None,
        },
        1 => Projection::Window {
            half_width: a,
            half_height: b,
            distance: c,
        },
        _ => Projection::Orthographic {
            y_mag: a,
            x_mag: Some(b * c),
        },
    }
}

/// Largest number of scenes that are tested.
const MAX_RAYS: u64 = 1 << 16;

fn inject_nan(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let sound = sound_scene();
    let inputs: Vec<(&str, Add)> = INPUTS
        .iter()
        .flat_map(|&(place, adds)| adds.iter().map(move |&add| (place, add)))
        .collect();
    let mut tally = Counts::default();
    for number in 0..trial.rays.min(MAX_RAYS) {
        // Add 0 and NaN to each input in turn
        let (place, add) = inputs[number as usize / 2 % inputs.len()];
        let x = [0.0, f64::NAN][number as usize % 2];
        let mut scene = sound.clone();
        let constructor_result = add(&mut scene, &mut SplitMix64::new(0x9015, number / 2), x);
        // Collect the error of the constructor or of validation
        let said = match constructor_result {
            Err(fault) => Some((fault.contains(place), fault)),
            Ok(()) => (trial.subject.formulas.validate)(&scene)
                .err()
                .map(|error| (error.item.starts_with(place), error.to_string())),
        };
        // Require an error that names the item for NaN, and none for 0
        let is_right = match &said {
            Some((is_named, _)) => *is_named && x.is_nan(),
            None => !x.is_nan(),
        };
        tally.count(Correctness::wrong_if(!is_right), || {
            let said = said.map_or_else(|| "nothing".to_owned(), |(_, said)| said);
            format!("number {number}: {x} added to {place}: {said}")
        });
    }
    Ok(tally)
}
