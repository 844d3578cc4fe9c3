//! Test scenes for the comparison of the renderer with the reference tracer, each small enough for brute force in f64.
//!
//! Cameras and objects are slightly rotated on purpose, so that no ray through the exact middle of a pixel runs along
//! an edge.

use std::f64::consts::PI;

use glam::{DAffine3, DMat3, DVec3, Vec3};
use whit::mesh::Mesh;
use whit::scene::{
    Background, Camera, Falloff, Filter, Geometry, Image, Instance, Light, LightKind, Material,
    MaterialInput, Projection, Sampler, Scene, Texels, Texture, TextureBinding, TextureUse, Wrap,
};
use whit::shape::{Shape, Sphere};

use super::meshes::{Shading, ball, rectangle, textured_panel, wedge, with_normals};

/// Scene with the recursion depth that its mirrors need.
pub struct WaveScene {
    pub name: &'static str,
    pub scene: Scene,
    pub depth: u32,
}

/// Returns flat and smooth tessellated spheres over a ground, under every kind of light.
pub fn lights_of_all_kinds() -> WaveScene {
    let mut scene = Scene::default();
    // Define materials and geometry
    let clay = add_material(&mut scene, matte([0.7, 0.45, 0.3], 0.8));
    let gold = add_material(&mut scene, metal([1.0, 0.77, 0.34], 0.35));
    let plastic = add_material(&mut scene, matte([0.1, 0.35, 0.8], 0.3));
    let chalk = add_material(&mut scene, matte([0.8, 0.8, 0.75], 1.0));
    let smooth = ball(2, Shading::Smooth);
    let flat = ball(2, Shading::Flat);
    let ground = rectangle(9.0, 7.0);
    // Add objects
    bake(
        &mut scene,
        flat,
        clay,
        moved(-1.3, 0.9, 0.2) * DAffine3::from_scale(DVec3::splat(0.9)),
    );
    bake(&mut scene, smooth.clone(), gold, moved(0.85, 1.0, -0.35));
    bake(
        &mut scene,
        smooth,
        plastic,
        moved(0.1, 0.45, 1.35) * DAffine3::from_scale(DVec3::splat(0.45)),
    );
    bake(
        &mut scene,
        ground,
        chalk,
        DAffine3::from_rotation_y(0.31) * lying(),
    );
    // Add lights and the camera
    scene.lights = vec![
        light(
            [14.0, 12.0, 10.0],
            LightKind::Point {
                position: DVec3::new(-2.2, 3.1, 2.3),
                falloff: Falloff::InverseSquare { range: Some(6.5) },
            },
        ),
        light([5.0, 9.0, 30.0], spot([2.9, 3.7, 1.9], [-0.62, -0.71, -0.52])),
        light(
            [0.5, 0.45, 0.4],
            LightKind::Directional {
                to_light: DVec3::new(0.3, 0.8, 0.45).normalize(),
            },
        ),
    ];
    scene.ambient = [0.04, 0.05, 0.07];
    scene.background = Background::Uniform(scene.ambient);
    scene.cameras = vec![camera([0.37, 2.2, 5.1], [0.05, 0.66, 0.0], perspective(0.72))];
    WaveScene {
        name: "lamps",
        scene,
        depth: 2,
    }
}

/// Returns two mirrors that face each other, objects between them, and a sphere that reflects all of it.
pub fn facing_mirrors() -> WaveScene {
    let mut scene = Scene::default();
    // Define materials
    let silver = add_material(&mut scene, metal([0.95, 0.93, 0.88], 0.0));
    let glazed = add_material(&mut scene, matte([0.2, 0.5, 0.3], 0.1));
    // Roughness slightly above the mirror's threshold.
    let red = add_material(&mut scene, matte([0.75, 0.12, 0.1], 0.101));
    let emissive = add_material(
        &mut scene,
        Material {
            emission: [1.5, 1.2, 0.6],
            ..matte([0.0; 3], 1.0)
        },
    );
    // Add the two mirrors
    let glass = rectangle(3.0, 2.2);
    let flat = add_geometry(&mut scene, Geometry::Mesh(ball(1, Shading::Flat)));
    let sphere = add_geometry(&mut scene, Geometry::Shape(Shape::Sphere(Sphere::UNIT)));
    let floor = rectangle(7.0, 7.0);
    bake(
        &mut scene,
        glass.clone(),
        silver,
        moved(0.0, 1.0, -1.7) * DAffine3::from_rotation_y(0.06),
    );
    bake(
        &mut scene,
        glass.clone(),
        silver,
        moved(0.0, 1.0, 1.6) * DAffine3::from_rotation_y(PI - 0.05),
    );
    // Add objects between them
    place(
        &mut scene,
        flat,
        red,
        moved(-0.55, 0.5, 0.1) * DAffine3::from_scale(DVec3::splat(0.43)),
    );
    place(
        &mut scene,
        sphere,
        glazed,
        moved(0.62, 0.55, -0.3) * DAffine3::from_scale(DVec3::splat(0.5)),
    );
    place(
        &mut scene,
        flat,
        emissive,
        moved(0.12, 1.37, 0.4) * DAffine3::from_scale(DVec3::splat(0.17)),
    );
    bake(&mut scene, floor, red, DAffine3::from_rotation_y(0.4) * lying());
    // Add the light and the camera
    let position = DVec3::new(0.3, 2.6, 0.5);
    scene.lights = vec![light(
        [8.0; 3],
        LightKind::Point {
            position,
            falloff: Falloff::PHYSICAL,
        },
    )];
    scene.ambient = [0.1, 0.12, 0.2];
    scene.background = Background::Uniform(scene.ambient);
    scene.cameras = vec![camera([-0.83, 1.21, 1.27], [0.17, 0.74, -1.0], perspective(1.1))];
    WaveScene {
        name: "facing mirrors",
        scene,
        depth: 4,
    }
}

/// Returns mirrored, stretched and sheared instances, and spheres that became ellipsoids.
pub fn placements() -> WaveScene {
    let mut scene = Scene::default();
    // Define materials and geometry
    let blue = add_material(&mut scene, matte([0.15, 0.3, 0.7], 0.45));
    let brass = add_material(&mut scene, metal([0.9, 0.7, 0.35], 0.4));
    let steel = add_material(&mut scene, metal([0.6, 0.62, 0.65], 0.05));
    let chalk = add_material(&mut scene, matte([0.8, 0.78, 0.7], 0.9));
    let smooth = add_geometry(&mut scene, Geometry::Mesh(ball(1, Shading::Smooth)));
    let wedge = add_geometry(&mut scene, Geometry::Mesh(wedge()));
    let sphere = add_geometry(
        &mut scene,
        Geometry::Shape(Shape::Sphere(Sphere {
            center: DVec3::new(0.4, -0.2, 0.1),
            radius: 0.7,
        })),
    );
    let ground = add_geometry(&mut scene, Geometry::Mesh(rectangle(9.0, 9.0)));
    let shear = DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::new(0.5, 1.0, 0.2), DVec3::Z));
    let scaled = |x, y, z| DAffine3::from_scale(DVec3::new(x, y, z));
    // Add mirrored, stretched and sheared wedges
    place(&mut scene, wedge, blue, moved(-1.9, 0.1, 0.3));
    place(
        &mut scene,
        wedge,
        blue,
        moved(-0.5, 0.1, 0.9) * scaled(-1.0, 1.0, 1.0),
    );
    place(
        &mut scene,
        wedge,
        brass,
        moved(1.5, 0.75, -1.3) * DAffine3::from_rotation_z(0.7) * scaled(0.4, -1.1, 1.6),
    );
    // Add instances of the sphere mesh
    place(
        &mut scene,
        smooth,
        brass,
        moved(-1.2, 0.9, -1.4) * DAffine3::from_rotation_x(0.4) * scaled(1.1, 0.3, 0.6),
    );
    place(
        &mut scene,
        smooth,
        blue,
        moved(0.35, 0.8, -0.5) * shear * scaled(0.4, 0.7, -0.4),
    );
    // Add ellipsoids
    place(
        &mut scene,
        sphere,
        steel,
        moved(1.1, 0.9, 0.4) * DAffine3::from_rotation_y(0.5) * scaled(0.6, 1.0, 0.35),
    );
    place(
        &mut scene,
        sphere,
        chalk,
        moved(-0.2, 0.45, 1.6) * shear * scaled(0.8, 0.25, -0.4),
    );
    place(
        &mut scene,
        ground,
        chalk,
        DAffine3::from_rotation_y(0.23) * lying() * scaled(1.0, 0.8, 2.0),
    );
    // Add lights and the camera
    scene.lights = vec![
        light(
            [10.0, 9.0, 8.0],
            LightKind::Point {
                position: DVec3::new(2.1, 3.3, 2.9),
                falloff: Falloff::PHYSICAL,
            },
        ),
        light(
            [0.6, 0.7, 0.9],
            LightKind::Directional {
                to_light: DVec3::new(-0.5, 0.7, 0.3).normalize(),
            },
        ),
    ];
    let projection = Projection::Orthographic {
        y_mag: 1.9,
        x_mag: None,
    };
    scene.cameras = vec![camera([1.4, 3.1, 5.2], [-0.05, 0.55, 0.0], projection)];
    WaveScene {
        name: "placements",
        scene,
        depth: 3,
    }
}

/// Returns every wrap mode with both filters on every textured parameter, vertex colours, emission, absent coordinates.
pub fn textures() -> WaveScene {
    let mut scene = Scene {
        images: vec![noise(7, 5, 1), noise(8, 8, 2), noise(3, 4, 3)],
        ..Scene::default()
    };
    // Add a panel for each filter and wrap mode
    let panel = add_geometry(&mut scene, Geometry::Mesh(textured_panel()));
    let wraps = [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge];
    let filters = [Filter::Nearest, Filter::Linear];
    for (row, filter) in filters.into_iter().enumerate() {
        for column in 0..3 {
            let sampler = Sampler {
                wrap_u: wraps[column],
                wrap_v: wraps[(column + row + 1) % 3],
                filter,
            };
            let mut layer = |parameter, image: u32, tex_coord: u32| {
                scene.textures.push(Texture::Image { image, sampler });
                let texture = TextureUse {
                    tex_coord,
                    ..TextureUse::new(scene.textures.len() as u32 - 1)
                };
                TextureBinding {
                    parameter,
                    texture,
                    strength: 1.0,
                }
            };
            let material = Material {
                name: format!("panel {row} {column}"),
                emission: [0.2, 0.25, 0.1],
                layers: vec![
                    layer(MaterialInput::BaseColor, 0, 0),
                    layer(MaterialInput::MetallicRoughness, 1, 1),
                    layer(MaterialInput::Emission, 2, 0),
                ],
                ..Material::metallic_roughness([0.9, 0.8, 1.0], 0.8, 0.9)
            };
            let material = add_material(&mut scene, material);
            let at = moved(
                1.07 * (column as f64 - 1.0),
                0.55 + 1.03 * row as f64,
                0.11 * column as f64,
            );
            let at = at * DAffine3::from_rotation_y(0.12 * (1.0 - column as f64));
            // Bake one row of panels, instance the other
            match filter {
                Filter::Nearest => bake(&mut scene, textured_panel(), material, at),
                Filter::Linear | Filter::Mipmap => place(&mut scene, panel, material, at),
            }
        }
    }
    // A sphere has one set of coordinates, which is used for every set index.
    let sphere = add_geometry(&mut scene, Geometry::Shape(Shape::Sphere(Sphere::UNIT)));
    place(
        &mut scene,
        sphere,
        4,
        moved(0.95, 0.4, 0.8) * DAffine3::from_scale(DVec3::splat(0.21)),
    );
    // Add lights and the camera
    scene.lights = vec![
        light(
            [6.0, 5.5, 5.0],
            LightKind::Point {
                position: DVec3::new(-0.7, 1.9, 2.4),
                falloff: Falloff::PHYSICAL,
            },
        ),
        light(
            [0.8; 3],
            LightKind::Directional {
                to_light: DVec3::new(0.4, 0.5, 0.9).normalize(),
            },
        ),
    ];
    scene.ambient = [0.2, 0.15, 0.1];
    scene.background = Background::Uniform(scene.ambient);
    scene.cameras = vec![camera([0.23, 1.31, 3.6], [0.11, 1.02, 0.0], perspective(0.74))];
    WaveScene {
        name: "textures",
        scene,
        depth: 2,
    }
}

/// Returns a view from inside a sphere, through a near plane that clips a sphere, up to a far plane; normals that point
/// inward, and normals of length zero.
pub fn inside() -> WaveScene {
    let mut scene = Scene::default();
    // Define materials
    let shell = add_material(&mut scene, matte([0.6, 0.6, 0.65], 0.7));
    let polished = add_material(&mut scene, matte([0.8, 0.3, 0.2], 0.08));
    let green = add_material(&mut scene, matte([0.2, 0.6, 0.25], 0.5));
    let sphere = add_geometry(
        &mut scene,
        Geometry::Shape(Shape::Sphere(Sphere {
            center: DVec3::ZERO,
            radius: 4.0,
        })),
    );
    // Build meshes with inward normals and with normals of length zero
    let reversed = with_normals(ball(2, Shading::Smooth), |p| p.map(|axis| -axis));
    let placed_reversed = add_geometry(&mut scene, Geometry::Mesh(reversed.clone()));
    let unshaded = with_normals(ball(1, Shading::Smooth), |_| [0.0; 3]);
    let placed_unshaded = add_geometry(&mut scene, Geometry::Mesh(unshaded.clone()));
    // Add baked and instanced objects
    place(&mut scene, sphere, shell, DAffine3::IDENTITY);
    bake(
        &mut scene,
        reversed,
        green,
        moved(-0.35, 0.12, 1.6) * DAffine3::from_scale(DVec3::splat(0.5)),
    );
    place(
        &mut scene,
        placed_reversed,
        polished,
        moved(1.1, -0.4, -1.5) * DAffine3::from_scale(DVec3::splat(0.8)),
    );
    place(
        &mut scene,
        placed_unshaded,
        green,
        moved(-1.3, 0.5, -1.7) * DAffine3::from_scale(DVec3::splat(0.6)),
    );
    bake(&mut scene, unshaded, green, moved(-0.1, -1.5, -1.2));
    // Add lights, and a camera with near clipping
    scene.lights = vec![
        light(
            [9.0, 8.0, 6.0],
            LightKind::Point {
                position: DVec3::new(0.4, 2.9, -0.6),
                falloff: Falloff::InverseSquare { range: Some(12.0) },
            },
        ),
        light([7.0, 7.0, 9.0], spot([0.5, 0.9, 1.9], [0.2, -0.4, -0.9])),
    ];
    scene.ambient = [0.03, 0.04, 0.05];
    scene.background = Background::Uniform(scene.ambient);
    scene.cameras = vec![Camera {
        z_near: 0.85,
        z_far: 6.1,
        ..camera([0.2, 0.35, 2.6], [0.05, 0.0, -1.0], perspective(0.95))
    }];
    WaveScene {
        name: "inside",
        scene,
        depth: 3,
    }
}

pub fn add_material(scene: &mut Scene, material: Material) -> u32 {
    scene.materials.push(material);
    scene.materials.len() as u32 - 1
}

pub fn add_geometry(scene: &mut Scene, geometry: Geometry) -> u32 {
    scene.geometries.push(geometry);
    scene.geometries.len() as u32 - 1
}

pub fn place(scene: &mut Scene, geometry: u32, material: u32, world_from_object: DAffine3) {
    let name = format!("instance {}", scene.instances.len());
    let instance = Instance::new(name, geometry, material, world_from_object).unwrap();
    scene.instances.push(instance);
}

/// Places a mesh by transforming its vertices, as the loader does with every mesh that is used once.
pub fn bake(scene: &mut Scene, mesh: Mesh, material: u32, world_from_object: DAffine3) {
    let moved = |p: &[f32; 3]| world_from_object.transform_point3(Vec3::from(*p).as_dvec3());
    let normal_map = world_from_object.matrix3.inverse().transpose();
    let turned = |n: &[f32; 3]| (normal_map * Vec3::from(*n).as_dvec3()).normalize_or_zero();
    let rounded = |v: DVec3| v.as_vec3().to_array();
    let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| rounded(moved(p))).collect();
    let normals = mesh.normals.as_ref().map(|normals| {
        let normals: Vec<[f32; 3]> = normals.iter().map(|n| rounded(turned(n))).collect();
        normals.into()
    });
    let positions = positions.into();
    let mesh = Mesh {
        positions,
        normals,
        ..mesh
    };
    let geometry = add_geometry(scene, Geometry::Mesh(mesh));
    place(scene, geometry, material, DAffine3::IDENTITY);
}

/// Returns a dielectric material of this base colour and roughness.
pub fn matte(rgb: [f32; 3], roughness: f32) -> Material {
    Material::metallic_roughness(rgb, 0.0, roughness)
}

pub fn metal(rgb: [f32; 3], roughness: f32) -> Material {
    Material::metallic_roughness(rgb, 1.0, roughness)
}

pub fn light(intensity: [f32; 3], kind: LightKind) -> Light {
    Light {
        name: "lamp".into(),
        intensity,
        kind,
    }
}

pub fn spot(position: [f64; 3], direction: [f64; 3]) -> LightKind {
    LightKind::Spot {
        position: position.into(),
        direction: DVec3::from(direction).normalize(),
        cos_inner: 0.93,
        cos_outer: 0.81,
        falloff: Falloff::PHYSICAL,
    }
}

pub fn perspective(y_fov: f64) -> Projection {
    Projection::Perspective { y_fov, aspect: None }
}

pub fn camera(eye: [f64; 3], target: [f64; 3], projection: Projection) -> Camera {
    let eye = DVec3::from(eye);
    let back = (eye - DVec3::from(target)).normalize();
    // Roll slightly, so that no horizon runs along a row of pixels.
    let right = DVec3::new(0.013, 1.0, 0.0).cross(back).normalize();
    Camera {
        name: "eye".into(),
        world_from_camera: DAffine3::from_mat3_translation(
            DMat3::from_cols(right, back.cross(right), back),
            eye,
        ),
        projection,
        z_near: 0.01,
        ..Camera::default()
    }
}

pub fn moved(x: f64, y: f64, z: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(x, y, z))
}

/// Returns the rotation from an upright rectangle, facing +z, to a horizontal one, facing up.
pub fn lying() -> DAffine3 {
    DAffine3::from_rotation_x(-0.5 * PI)
}

/// Returns an image of pseudo-random bytes (the multiplier is Knuth's).
pub fn noise(width: u32, height: u32, seed: u32) -> Image {
    let byte =
        |index: u32| (seed.wrapping_mul(0x9e37_79b9) ^ index.wrapping_mul(2_654_435_761)).rotate_left(13);
    Image {
        name: format!("noise {seed}"),
        width,
        height,
        texels: Texels::Bytes(
            (0..width * height)
                .map(|texel| std::array::from_fn(|channel| (byte(4 * texel + channel as u32) >> 24) as u8))
                .collect::<Vec<_>>()
                .into(),
        ),
    }
}
