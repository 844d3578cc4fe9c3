//! Small random scenes: a few objects, materials, lights and textures of every kind; most scenes lack most effects.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use whit::mesh::Mesh;
use whit::optics::subsurface::SubsurfacePreset;
use whit::optics::{Absorption, Cauchy, Dispersion};
use whit::scene::{
    AlphaMode, Anisotropy, Aperture, AreaShape, Background, Camera, Caustics, Clearcoat, Falloff, Filter,
    Geometry, Image, Instance, Interreflection, Iridescence, Lens, Light, LightKind, Material, MaterialInput,
    Medium, MediumKind, MetallicRoughness, Model, Pattern, Phong, Procedural, Projection, Sampler, Scene,
    Sheen, Shutter, Space, Texels, Texture, TextureBinding, TextureUse, Translucency, Wrap,
};
use whit::volume::{Fog, Grid, GridSamples, Thickness, Transfer, TransferNode, Volume, VolumeDescription};

use super::meshes::{Shading, ball, textured_panel};
use super::scenes::{SplitMix64, all_shapes};

/// Returns the valid random scene of number `seed`.
pub fn scene(seed: u64) -> Scene {
    // Neighbouring seeds of such a generator give similar first numbers, which are discarded.
    let mut random = SplitMix64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    (0..4).for_each(|_| _ = random.next());
    let r = &mut random;
    let mut scene = Scene {
        images: vec![image(r)],
        ambient: sometimes(r, 0.4, [0.1, 0.2, 0.15]),
        background: match r.below(4) {
            0 => Background::Uniform([0.3, 0.2, 0.1]),
            1 => Background::Gradient {
                horizon: [0.6, 0.5, 0.4],
                up: [0.1, 0.2, 0.7],
                down: [0.05; 3],
            },
            _ => Background::default(),
        },
        textures: vec![
            pattern(Pattern::Checker, Space::Object),
            pattern(Pattern::Noise { octaves: 3 }, Space::Object),
            pattern(Pattern::Gradient, Space::Uv),
            image_texture(Filter::Linear),
            image_texture(Filter::Mipmap),
        ],
        cameras: vec![camera(r)],
        ..Scene::default()
    };
    // Draw from few kinds of material in most scenes, so that most effects are absent.
    let kinds: Vec<usize> = (0..1 + r.below(3)).map(|_| r.below(KINDS)).collect();
    for number in 0..1 + r.below(4) {
        let kind = kinds[r.below(kinds.len())];
        scene.materials.push(Material {
            name: format!("material {number}"),
            ..material(kind, r)
        });
    }
    for _ in 0..1 + r.below(4) {
        add_object(&mut scene, r);
    }
    for number in 0..r.below(3) {
        scene.lights.push(light(number, r));
    }
    if r.below(8) == 0 {
        scene.volumes = (0..1 + r.below(2)).map(|_| volume(r)).collect();
    }
    if r.below(16) == 0 {
        let extinction = [0.0, 0.2, 0.4][r.below(3)];
        let emission = if extinction > 0.0 {
            [0.0, 0.05, 0.1]
        } else {
            [0.0; 3]
        };
        scene.fog = Some(Fog::new(extinction, [0.9, 0.8, 0.7], emission, 0.5).unwrap());
    }
    if r.next() < 0.15 {
        let texels = (0..32).map(|_| {
            let bright = r.next() as f32;
            [bright * bright, bright, 0.5, 1.0]
        });
        scene.images.push(Image {
            name: "sky".into(),
            width: 8,
            height: 4,
            texels: Texels::Floats(texels.collect::<Vec<_>>().into()),
        });
        scene.background = Background::Environment {
            image: 1,
            rotation: r.next(),
            scale: 1.5,
            samples: 1 + r.below(2) as u32,
        };
    }
    if r.next() < 0.25 {
        scene.lights.push(soft_light(r));
    }
    if r.next() < 0.25 {
        let aperture = [
            Aperture::Disk,
            Aperture::Polygon {
                blades: 5,
                rotation: 0.3,
            },
        ][r.below(2)];
        scene.cameras[0].lens = Some(Lens::new(0.3, 4.0, aperture).unwrap());
    }
    scatter(&mut scene, r);
    add_layers(&mut scene, r);
    if r.next() < 0.35 {
        scene.set_rough_rays(1 + 2 * r.below(2) as u32);
    }
    let is_still = scene.materials[scene.instances[0].material as usize]
        .scatters()
        .is_some();
    if r.next() < 0.12 && !is_still {
        let moved = &mut scene.instances[0];
        let start = moved.world_from_object();
        let end = DAffine3::from_translation(0.7 * r.in_cube())
            * start
            * DAffine3::from_axis_angle(r.on_sphere(), 2.0 * r.next());
        *moved = Instance::moving("moved", moved.geometry, moved.material, [start, end]).unwrap();
    }
    if r.next() < 0.06 {
        let camera = &mut scene.cameras[0];
        let end = DAffine3::from_translation(0.3 * r.in_cube()) * camera.world_from_camera;
        camera.world_from_camera_end = Some(end * DAffine3::from_rotation_z(0.2));
        camera.shutter = Shutter {
            open: 0.1,
            close: 0.8,
        };
    }
    if r.next() < 0.75 {
        // Some instances cannot be area lights, and most have no emission.
        for instance in 0..scene.instances.len() as u32 {
            _ = scene.add_emissive_light(instance, 1 + r.below(2) as u32);
        }
    }
    if r.next() < 0.15 {
        scene.interreflection = Some(Interreflection { bounces: 3 });
    }
    if r.next() < 0.15 {
        scene.caustics = Some(Caustics {
            photons: 200,
            neighbours: 8,
        });
    }
    scene.validate().unwrap();
    scene
}

/// Adds subsurface scattering to the first material of some scenes, if it allows any.
fn scatter(scene: &mut Scene, r: &mut SplitMix64) {
    let chance = r.next();
    let has_plane = scene.instances.iter().any(|instance| {
        instance.material == 0 && scene.geometries[instance.geometry as usize].is_unbounded()
    });
    let material = &mut scene.materials[0];
    if material.transmits() || !matches!(material.model, Model::MetallicRoughness(_)) {
        return;
    }
    if chance < 0.1 && !has_plane {
        let presets = &SubsurfacePreset::ALL;
        let scattering = presets[r.below(presets.len())].scattering;
        material.subsurface = Some(scattering.scaled(0.2 + r.next()));
    } else if chance < 0.25 {
        material.translucency = Some(Translucency {
            factor: 0.3 + 0.5 * r.next() as f32,
            color: [0.5, 0.9, 0.2],
        });
    }
}

/// Adds layers and lobes of glTF's extensions to some materials of its model.
fn add_layers(scene: &mut Scene, r: &mut SplitMix64) {
    for material in &mut scene.materials {
        if !matches!(material.model, Model::MetallicRoughness(_)) {
            continue;
        }
        let factor = 0.5 + 0.5 * r.next() as f32;
        let roughness = [0.0, 0.05, 0.4][r.below(3)];
        material.clearcoat = sometimes(r, 0.1, Some(Clearcoat { factor, roughness }));
        let color = [0.9, 0.5, 0.7];
        let roughness = 0.2 + 0.7 * r.next() as f32;
        material.sheen = sometimes(r, 0.1, Some(Sheen { color, roughness }));
        let rotation = 3.0 * r.next() as f32;
        let strength = factor;
        material.anisotropy = sometimes(r, 0.1, Some(Anisotropy { strength, rotation }));
        let thickness = [100.0, 200.0 + 500.0 * r.next() as f32];
        let film = Iridescence {
            factor,
            ior: 1.3,
            thickness,
        };
        material.iridescence = sometimes(r, 0.1, Some(film));
    }
}

fn sometimes<T: Default>(r: &mut SplitMix64, probability: f64, value: T) -> T {
    if r.next() < probability {
        value
    } else {
        T::default()
    }
}

fn camera(r: &mut SplitMix64) -> Camera {
    let aside = 0.4 * r.in_cube();
    let z_near = [0.0, 0.5, 3.2][r.below(3)];
    Camera {
        name: "eye".into(),
        world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.0, 4.0) + aside),
        projection: if r.next() < 0.85 {
            Projection::Perspective {
                y_fov: 0.8,
                aspect: None,
            }
        } else {
            Projection::Orthographic {
                x_mag: None,
                y_mag: 1.8,
            }
        },
        z_near,
        ..Camera::default()
    }
}

fn image(r: &mut SplitMix64) -> Image {
    let mut byte = || (255.0 * r.next()) as u8;
    let texels: Vec<_> = (0..64).map(|_| [byte(), byte(), byte(), byte()]).collect();
    Image {
        name: "spots".into(),
        width: 8,
        height: 8,
        texels: Texels::Bytes(texels.into()),
    }
}

fn image_texture(filter: Filter) -> Texture {
    Texture::Image {
        image: 0,
        sampler: Sampler {
            wrap_u: Wrap::Repeat,
            wrap_v: Wrap::MirroredRepeat,
            filter,
        },
    }
}

fn pattern(pattern: Pattern, space: Space) -> Texture {
    Texture::Procedural(Procedural {
        pattern,
        colors: [[0.2, 0.9, 0.3, 0.1], [1.0, 0.6, 0.8, 1.0]],
        space,
        scale: [3.0, 2.0, 4.0],
    })
}

fn layer(parameter: MaterialInput, texture: u32, strength: f32) -> TextureBinding {
    TextureBinding {
        parameter,
        texture: TextureUse::new(texture),
        strength,
    }
}

/// Number of kinds of material.
const KINDS: usize = 22;

fn gltf(color: [f32; 3], model: MetallicRoughness) -> Material {
    Material {
        model: Model::MetallicRoughness(model),
        base_color: [color[0], color[1], color[2], 1.0],
        ..Material::default()
    }
}

fn body(ior: Dispersion, absorption: Absorption, priority: i32) -> Option<Medium> {
    Some(Medium {
        ior,
        absorption,
        priority,
        kind: MediumKind::Solid,
    })
}

fn material(kind: usize, r: &mut SplitMix64) -> Material {
    let color = [0.2 + 0.8 * r.next() as f32, 0.7, 0.2 + 0.8 * r.next() as f32];
    let chalk = MetallicRoughness {
        metallic: 0.0,
        roughness: 0.6,
        ..MetallicRoughness::DEFAULT
    };
    let glass = MetallicRoughness {
        roughness: [0.0, 0.5][r.below(2)],
        transmission: 0.9,
        ..chalk
    };
    let constant = Dispersion::Constant(1.3 + 0.4 * r.next());
    let matte = gltf(color, chalk);
    let texture = r.below(5) as u32;
    let with = |layer: TextureBinding| Material {
        layers: vec![layer],
        ..matte.clone()
    };
    let with_phong = |phong: Phong| Material {
        model: Model::Phong(phong),
        ..matte.clone()
    };
    match kind {
        0 => matte,
        1 => gltf(
            color,
            MetallicRoughness {
                roughness: 0.05,
                ..MetallicRoughness::DEFAULT
            },
        ),
        2 => Material {
            interior: body(constant, Absorption::NONE, r.below(3) as i32),
            ..gltf([1.0; 3], glass)
        },
        3 => Material {
            interior: body(constant, Absorption::from_color([0.3, 0.8, 0.5], 1.0), 0),
            ..gltf([1.0; 3], glass)
        },
        4 => Material {
            interior: body(
                Dispersion::Cauchy(Cauchy { a: 1.5, b: 20_000.0 }),
                Absorption::NONE,
                0,
            ),
            ..gltf([1.0; 3], glass)
        },
        5 => Material {
            interior: Some(Medium {
                ior: constant,
                absorption: Absorption::NONE,
                priority: 0,
                kind: MediumKind::ThinSlab,
            }),
            ..gltf(color, glass)
        },
        6 => with(layer(MaterialInput::BaseColor, texture, 1.0)),
        7 => with(layer(MaterialInput::Roughness, texture, 1.0)),
        8 => with(layer(MaterialInput::Normal, 3, 0.7)),
        9 => with(layer(MaterialInput::Bump, texture, 0.2)),
        10 => with(layer(MaterialInput::Occlusion, texture, 0.8)),
        11 => with(layer(MaterialInput::SpecularColor, texture, 1.0)),
        12 => Material {
            alpha: AlphaMode::Mask(0.5),
            ..with(layer(MaterialInput::BaseColor, texture, 1.0))
        },
        13 => Material {
            alpha: AlphaMode::Blend,
            base_color: [color[0], color[1], color[2], 0.4],
            ..matte
        },
        14 => Material {
            emission: [0.4, 0.1, 0.3],
            ..matte
        },
        15 => Material {
            model: Model::Unlit,
            ..matte
        },
        16 => with_phong(Phong {
            specular: [0.4; 3],
            exponent: 12.0,
            ..Phong::DEFAULT
        }),
        17 => with_phong(Phong {
            reflection: [0.5, 0.3, 0.4],
            ..Phong::DEFAULT
        }),
        18 => Material {
            interior: body(constant, Absorption::NONE, 0),
            ..with_phong(Phong {
                transmission: [0.8; 3],
                fresnel: r.next() < 0.5,
                ..Phong::DEFAULT
            })
        },
        19 => gltf(
            color,
            MetallicRoughness {
                specular: 0.4,
                ..chalk
            },
        ),
        20 => Material {
            interior: body(Dispersion::Constant(1.8), Absorption::NONE, 0),
            ..matte
        },
        _ => with(layer(MaterialInput::MetallicRoughness, texture, 1.0)),
    }
}

/// Returns the mesh with the first two coordinates of each vertex as its texture coordinates.
fn charted(mesh: Mesh) -> Mesh {
    let set: Vec<[f32; 2]> = mesh.positions.iter().map(|p| [p[0], p[1]]).collect();
    Mesh {
        tex_coords: vec![set.into()],
        ..mesh
    }
}

fn add_object(scene: &mut Scene, r: &mut SplitMix64) {
    let shapes = all_shapes();
    let geometry = match r.below(8) {
        0 => Geometry::Mesh(charted(ball(1, Shading::Smooth))),
        1 => Geometry::Mesh(charted(ball(1, Shading::Flat))),
        2 => Geometry::Mesh(textured_panel()),
        3 => Geometry::Mesh(Mesh {
            colors: None,
            ..textured_panel()
        }),
        _ => Geometry::Shape(shapes[r.below(shapes.len())].1.clone()),
    };
    scene.geometries.push(geometry);
    let size = DVec3::new(1.0, 0.5 + r.next(), [1.0, -1.0][r.below(2)]) * (0.4 + 0.6 * r.next());
    let place = DAffine3::from_translation(1.3 * r.in_cube())
        * DAffine3::from_axis_angle(r.on_sphere(), 6.0 * r.next())
        * DAffine3::from_scale(size);
    let material = r.below(scene.materials.len()) as u32;
    let geometry = scene.geometries.len() as u32 - 1;
    scene
        .instances
        .push(Instance::new("object", geometry, material, place).unwrap());
}

fn light(number: usize, r: &mut SplitMix64) -> Light {
    let position = DVec3::new(0.0, 2.5, 2.0) + 1.5 * r.in_cube();
    let falloff = [
        Falloff::PHYSICAL,
        Falloff::NONE,
        Falloff::InverseSquare { range: Some(1.5) },
    ][r.below(3)];
    let kind = match r.below(3) {
        0 => LightKind::Directional {
            to_light: r.on_sphere(),
        },
        1 => LightKind::Point { position, falloff },
        _ => LightKind::Spot {
            position,
            direction: -position.normalize(),
            cos_inner: 0.95,
            cos_outer: 0.8,
            falloff,
        },
    };
    Light {
        name: format!("light {number}"),
        intensity: [3.0, 2.5, 2.0],
        kind,
    }
}

/// Returns a volume of a few voxels, of which some or all may be empty.
fn volume(r: &mut SplitMix64) -> Volume {
    let fullness = [0.0, 0.3, 1.0][r.below(3)];
    let samples = (0..60).map(|_| if r.next() < fullness { r.next() as f32 } else { 0.0 });
    let grid = Grid::new([3, 4, 5], GridSamples::Floats(samples.collect())).unwrap();
    let emission = sometimes(r, 0.5, [0.5, 0.2, 0.0]);
    let node = |value: f64, emission: [f64; 3]| TransferNode {
        value,
        thickness: value,
        color: [0.9, 0.8, 0.7],
        emission,
    };
    let thickness = [Thickness::Extinction, Thickness::OpacityOver(0.7)][r.below(2)];
    let place = DAffine3::from_translation(r.in_cube())
        * DAffine3::from_axis_angle(r.on_sphere(), 6.0 * r.next())
        * DAffine3::from_scale(DVec3::new(1.0, 0.5 + r.next(), -0.8));
    Volume::new(VolumeDescription {
        density: Arc::new(grid),
        color: None,
        transfer: Transfer::new(&[node(0.0, [0.0; 3]), node(1.0, emission)], thickness).unwrap(),
        world_from_cube: place,
        step: Some(0.2),
    })
    .unwrap()
    .named("cloud")
}

fn soft_light(r: &mut SplitMix64) -> Light {
    let center = DVec3::new(0.0, 2.5, 2.0) + 1.5 * r.in_cube();
    let half_u = r.on_sphere();
    let half_v = half_u.any_orthonormal_vector();
    let shape = match r.below(3) {
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
        _ => AreaShape::Sphere { center, radius: 0.6 },
    };
    Light {
        name: "soft light".into(),
        intensity: [2.0, 1.5, 1.0],
        kind: LightKind::Area {
            shape,
            samples: 1 + r.below(2) as u32,
        },
    }
}
