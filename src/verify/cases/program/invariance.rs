//! Metamorphic tests: scaling, rotating or translating a scene must not change the image.
//!
//! No oracle is needed. Powers of two and the rotations of a cube are exact, so hits stay bit-identical; other factors
//! and large translations round coordinates, so images may differ in one pixel of ten thousand.

use glam::{DAffine3, DMat3, DVec3, Vec3};

use crate::accel::{AccelError, Hit};
use crate::buffer::Buffer;
use crate::image::ToneMap;
use crate::numeric::{Ray, SplitMix64};
use crate::render::{Monitor, RenderSettings, render};
use crate::scene::{
    Background, Camera, Falloff, Geometry, Instance, Light, LightKind, Material, Model, Normalisation, Phong,
    Scene, ValidScene,
};
use crate::shape::{Shape, Sphere};
use crate::verify::cases::intersection::regressions::mixed_scene;
use crate::verify::harness::test_meshes::icosphere;
use crate::verify::harness::test_scenes::{self, test_scene};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, Engine, judge_against, order, towards};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H26",
        title: "powers of two",
        construction: "twelve scenes with all lengths times 2^-60 to 2^60, normalised, and the same rays in each",
        oracle: "the scene as it is",
        bound: "the same bits of hits, except for the power of two in t",
        run: powers_of_two,
        ..Case::TRIANGLES
    },
    Case {
        id: "H27",
        title: "cube rotations",
        construction: "meshes and shapes, instanced and not, turned by the 24 rotations of a cube together with the \
            rays",
        oracle: "the scene as it is; other bits within the f32 bounds are ties",
        bound: "the same hits",
        run: turned,
        ..Case::TRIANGLES
    },
    Case {
        id: "H28",
        title: "far from the origin",
        construction: "an image of mirrors and shadows, its scene moved 10^6 and 10^8 away",
        oracle: "the image of the scene at the origin",
        bound: IMAGE_BOUND,
        run: |trial| compare_images(trial, &[moved(1e6), moved(1e8)]),
        ..Case::TRIANGLES
    },
    Case {
        id: "H29",
        title: "tiny",
        construction: "the image of a scene scaled to a millionth and a billionth of its size; and of a millionth of \
            it in a room of 10^6",
        oracle: "the image of the scene as it is; the room shows the same colour as the background",
        bound: IMAGE_BOUND,
        run: |trial| compare_images(trial, &[scaled(1e-6), scaled(1e-9), IN_A_ROOM]),
        ..Case::TRIANGLES
    },
];

const IMAGE_BOUND: &str = "at most 1/255 off in 99.99 % of pixels, no NaN";

/// Binary exponents of the factors by which lengths are multiplied.
const EXPONENTS: [i32; 6] = [-60, -33, -7, 5, 31, 60];

/// Number of rays from which on every scene is tested at every factor; with fewer, each scene is tested at one.
const MIN_RAYS_FOR_ALL_EXPONENTS: u64 = 100_000;

fn powers_of_two(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let powers = if trial.rays < MIN_RAYS_FOR_ALL_EXPONENTS {
        1
    } else {
        EXPONENTS.len()
    };
    let count = test_scenes::COUNT * powers;
    let normalise = trial.subject.formulas.normalise;
    trial.over_parts(count, &|part, trial| {
        // Scale a test scene
        let mut plain = test_scene(part / powers);
        let mut large = plain.clone();
        // Start at a different exponent for each scene, so that all occur even if each scene uses one.
        let exponent = EXPONENTS[(part / powers + part % powers) % EXPONENTS.len()];
        large.apply_normalisation(Normalisation {
            center: DVec3::ZERO,
            scale: 2f64.powi(exponent),
        });
        // Remove the trace of the scaling, as if a file had that size
        let factor = large.normalisation.scale;
        large.normalisation = Normalisation::default();
        // Normalise both, and compute the factor that remains
        normalise(&mut plain);
        normalise(&mut large);
        let factor = factor * large.normalisation.scale / plain.normalisation.scale;
        scaled_hits(&trial, [&plain, &large], factor as f32)
    })
}

/// Compares the hits in a scene and in a copy with all lengths multiplied by `factor`, a power of two.
fn scaled_hits(trial: &CaseRunner, scenes: [&Scene; 2], factor: f32) -> Result<Counts, AccelError> {
    let [plain, large] = scenes;
    let [engine, other] = [trial.engine(plain)?, trial.engine(large)?];
    let ray = rays_about(plain);
    Ok(trial.trace_in_chunks(&other, &|random, count| {
        // Trace a ray and its scaled copy
        let rays: Vec<Ray> = (0..count).map(|_| ray(random)).collect();
        let mapped: Vec<Ray> = rays
            .iter()
            .map(|ray| Ray {
                origin: factor * ray.origin,
                ..*ray
            })
            .collect();
        let mut tally = Counts::default();
        let order = order(random);
        let [expected, found] = [engine.nearest(&rays, order), other.nearest(&mapped, order)];
        // Require identical bits, but for the factor in t
        for (i, ray) in mapped.iter().enumerate() {
            let bits = |hit: Option<Hit>, factor: f32| {
                let floats = |hit: &Hit| [factor * hit.t, hit.u, hit.v].map(f32::to_bits);
                hit.map(|hit| (hit.instance, hit.primitive, floats(&hit)))
            };
            let is_wrong = bits(expected[i], factor) != bits(found[i], 1.0);
            tally.count_ray(Correctness::wrong_if(is_wrong), ray, found[i]);
        }
        tally
    }))
}

/// Returns a generator of rays from around a scene towards its centre.
fn rays_about(scene: &Scene) -> impl Fn(&mut SplitMix64) -> Ray + Sync {
    let bounds = scene.bounds();
    let (center, reach) = (bounds.center(), 0.5 * bounds.extent().length());
    move |random| {
        let origin = center + 1.5 * reach * random.direction();
        let target = center + 0.6 * reach * random.in_cube();
        towards(origin, target)
    }
}

/// Returns the 24 rotations that map a cube onto itself.
fn rotations() -> impl Iterator<Item = DMat3> {
    let axes = [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z];
    let pairs = axes.into_iter().flat_map(move |x| axes.map(|y| (x, y)));
    pairs
        .filter(|(x, y)| x.dot(*y) == 0.0)
        .map(|(x, y)| DMat3::from_cols(x, y, x.cross(y)))
}

/// Returns the scene rotated about the origin without rounding.
fn turned_scene(scene: &Scene, turn: &DMat3) -> Scene {
    let mut turned = scene.clone();
    for instance in &mut turned.instances {
        let geometry = &mut turned.geometries[instance.geometry as usize];
        // Rotate the transform of an instance
        if !instance.is_identity() {
            let map = instance.world_from_object();
            let turned = DAffine3 {
                matrix3: *turn * map.matrix3,
                translation: *turn * map.translation,
            };
            // The transform had an inverse, so the rotated one has, too.
            let is_placed = instance.place(turned);
            debug_assert!(is_placed.is_ok());
            continue;
        }
        // Rotate untransformed geometry itself
        match geometry {
            Geometry::Mesh(mesh) => mesh.positions = turned_positions(&mesh.positions, turn),
            Geometry::Points(cloud) => cloud.positions = turned_positions(&cloud.positions, turn),
            Geometry::Shape(Shape::Sphere(sphere)) => sphere.center = *turn * sphere.center,
            Geometry::Shape(_) => (),
        }
    }
    turned
}

/// Returns positions rotated about the origin, each rounded once.
fn turned_positions(positions: &[[f32; 3]], turn: &DMat3) -> Buffer<[f32; 3]> {
    let turned = positions
        .iter()
        .map(|&p| (*turn * Vec3::from(p).as_dvec3()).as_vec3().to_array());
    turned.collect::<Vec<_>>().into()
}

/// Returns a scene of meshes and shapes in which no geometry has both transformed and untransformed instances.
fn rotatable_scene() -> Scene {
    let mut scene = mixed_scene();
    let unmoved = scene
        .instances
        .iter()
        .filter(|instance| instance.is_identity())
        .count() as u32;
    // Give the transformed instances geometries of their own
    let copies = scene.geometries.clone();
    let first = copies.len() as u32;
    scene.geometries.extend(copies);
    for instance in scene.instances.iter_mut().skip(unmoved as usize) {
        instance.geometry += first;
    }
    scene
}

fn turned(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let scene = rotatable_scene();
    let engine = trial.engine(&scene)?;
    let turns: Vec<DMat3> = rotations().collect();
    trial.over_parts(turns.len(), &|number, trial| {
        let turned = turned_scene(&scene, &turns[number]);
        let other = trial.engine(&turned)?;
        Ok(turned_hits(&trial, &scene, [&engine, &other], &turns[number]))
    })
}

fn turned_hits(trial: &CaseRunner, scene: &Scene, [engine, other]: [&Engine; 2], turn: &DMat3) -> Counts {
    let ray = rays_about(scene);
    let carry = |v: Vec3| (*turn * v.as_dvec3()).as_vec3();
    trial.trace_in_chunks(engine, &|random, count| {
        let rays: Vec<Ray> = (0..count).map(|_| ray(random)).collect();
        // Trace a ray and its rotated copy
        let mapped: Vec<Ray> = rays
            .iter()
            .map(|ray| Ray::new(carry(ray.origin), carry(ray.direction)))
            .collect();
        let mut tally = Counts::default();
        let order = order(random);
        let [expected, found] = [engine.nearest(&rays, order), other.nearest(&mapped, order)];
        // Count different hits within the rounding bounds as ties
        for (i, ray) in rays.iter().enumerate() {
            let key = |hit: Option<Hit>| hit.map(|hit| (hit.instance, hit.primitive, hit.t.to_bits()));
            let correctness = if key(expected[i]) == key(found[i]) {
                Correctness::Right
            } else {
                match judge_against(scene, ray, expected[i], found[i]) {
                    Correctness::Wrong => Correctness::Wrong,
                    _ => Correctness::Tie,
                }
            };
            tally.count_ray(correctness, ray, found[i]);
        }
        tally
    })
}

/// Affine map of a scene, which takes points p to `factor p + offset`, with an optional room around it.
#[derive(Clone, Copy)]
struct SceneMap {
    factor: f64,
    offset: DVec3,
    has_room: bool,
}

const fn moved(far: f64) -> SceneMap {
    SceneMap {
        factor: 1.0,
        offset: DVec3::new(far, -0.5 * far, 2.0 * far),
        has_room: false,
    }
}

const fn scaled(factor: f64) -> SceneMap {
    SceneMap {
        factor,
        offset: DVec3::ZERO,
        has_room: false,
    }
}

const IN_A_ROOM: SceneMap = SceneMap {
    factor: 1e-6,
    offset: DVec3::ZERO,
    has_room: true,
};
/// Half the width of the room.
const ROOM: f64 = 1e6;
/// Colour of the room, and of the background without a room.
const PAINT: [f32; 3] = [0.3, 0.5, 0.7];

/// Material that reflects half of the light as a mirror.
const MIRRORING: Model = Model::Phong(Phong {
    reflection: [0.5; 3],
    diffuse: [0.4; 3],
    ..Phong::DEFAULT
});

/// Returns a scene of a mesh, a sphere and a floor that mirror each other, with a point light and a camera.
fn image_scene() -> Scene {
    let light = |position: DVec3, intensity: [f32; 3]| Light {
        name: "light".into(),
        intensity,
        kind: LightKind::Point {
            position,
            falloff: Falloff::InverseSquare { range: None },
        },
    };
    // Place the mesh and the sphere above the floor
    let place = |number, map| Instance::new("", number, 0, map).ok();
    let on_the_left = DAffine3::from_translation(DVec3::new(-1.1, 0.0, 0.0));
    let on_the_right = DAffine3::from_translation(DVec3::new(1.1, 0.0, 0.3));
    let below =
        DAffine3::from_translation(DVec3::new(0.0, -5.0, 0.0)) * DAffine3::from_scale(DVec3::splat(4.0));
    // Look at them from the front
    let camera = Camera {
        world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.5, 6.0)),
        ..Camera::default()
    };
    Scene {
        geometries: vec![
            Geometry::Mesh(icosphere(3)),
            Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
            Geometry::Shape(Shape::Cube),
        ],
        instances: [place(0, on_the_left), place(1, on_the_right), place(2, below)]
            .into_iter()
            .flatten()
            .collect(),
        materials: vec![Material {
            model: MIRRORING,
            ..Material::default()
        }],
        lights: vec![light(DVec3::new(2.0, 4.0, 3.0), [30.0; 3])],
        cameras: vec![camera],
        background: Background::Uniform(PAINT),
        ambient: [0.1; 3],
        ..Scene::default()
    }
}

/// Returns the scene of the image as if a file had stored it with this offset and scale.
fn mapped(scene_map: &SceneMap) -> Scene {
    let mut scene = image_scene();
    let map =
        DAffine3::from_translation(scene_map.offset) * DAffine3::from_scale(DVec3::splat(scene_map.factor));
    // Map the instances and the camera
    for instance in &mut scene.instances {
        let is_placed = instance.place(map * instance.world_from_object());
        debug_assert!(is_placed.is_ok());
    }
    for camera in &mut scene.cameras {
        let place = &mut camera.world_from_camera.translation;
        *place = map.transform_point3(*place);
    }
    for light in &mut scene.lights {
        if let LightKind::Point { position, .. } = &mut light.kind {
            *position = map.transform_point3(*position);
        }
        // Inverse-square falloff: scale the intensity by the square of the distances' factor
        let factor = (scene_map.factor * scene_map.factor) as f32;
        light.intensity = light.intensity.map(|intensity| factor * intensity);
    }
    // Add a room of the background's colour
    if scene_map.has_room {
        let walls = DAffine3::from_scale(DVec3::splat(ROOM));
        scene.instances.extend(Instance::new("room", 2, 1, walls));
        scene.materials.push(Material {
            model: Model::Unlit,
            base_color: [PAINT[0], PAINT[1], PAINT[2], 1.0],
            ..Material::default()
        });
    }
    scene
}

/// Smallest size of the image in pixels, which lets one pixel of ten thousand differ, and the largest.
const SIZES: [u64; 2] = [104, 256];

/// Renders a scene and returns the sRGB bytes of all pixels, and the number of pixels that are not finite.
fn render_srgb(trial: &CaseRunner, scene: &Scene, size: u32) -> Result<Option<(Vec<u8>, usize)>, AccelError> {
    let accel = (trial.subject.build)(scene)?;
    let settings = RenderSettings {
        width: size,
        height: size,
        ..RenderSettings::default()
    };
    let monitor = Monitor::default();
    let rendering = render(
        ValidScene::assume(scene),
        &scene.cameras[0],
        &*accel,
        &settings,
        &monitor,
    );
    Ok(rendering.ok().map(|rendering| {
        let codes = ToneMap::default().srgb_bytes(&rendering.image);
        (codes, rendering.image.non_finite_count())
    }))
}

fn compare_images(trial: &CaseRunner, scene_maps: &[SceneMap]) -> Result<Counts, AccelError> {
    let size = (trial.rays / scene_maps.len() as u64).isqrt();
    let size = size.clamp(SIZES[0], SIZES[1]) as u32;
    let mut tally = Counts::default();
    // Render the original scene
    let Some((expected, _)) = render_srgb(trial, &image_scene(), size)? else {
        return Ok(tally);
    };
    for scene_map in scene_maps {
        // Render the mapped scene after normalisation
        let mut scene = mapped(scene_map);
        (trial.subject.formulas.normalise)(&mut scene);
        let Some((found, bad_count)) = render_srgb(trial, &scene, size)? else {
            continue;
        };
        // Count pixels that differ by more than 1/255
        let differs = |(a, b): (&[u8], &[u8])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 1);
        let pixels: Vec<bool> = expected.chunks(3).zip(found.chunks(3)).map(differs).collect();
        let differing = pixels.iter().filter(|&&differs| differs).count();
        // One pixel of ten thousand may differ, as rounding moves rays across edges.
        let is_alike = differing * 10_000 <= pixels.len() && bad_count == 0;
        for (pixel, differs) in pixels.into_iter().enumerate() {
            let correctness = match (differs, is_alike) {
                (false, _) => Correctness::Right,
                (true, true) => Correctness::Tie,
                (true, false) => Correctness::Wrong,
            };
            tally.count(correctness, || {
                let [factor, x] = [scene_map.factor, scene_map.offset.x];
                format!("{differing} pixels, first {pixel}, of the scene times {factor:e} at {x:e}; {bad_count} NaN")
            });
        }
    }
    if trial.draws_scenes() {
        tally.figure_data.draw(&image_scene());
    }
    Ok(tally)
}
