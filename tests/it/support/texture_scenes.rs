//! Texture test scenes for the comparison of the renderer with the reference tracer: one for each textured parameter,
//! with every kind of texture on a mesh and on analytic shapes, over a mirror that reflects all of them.
//!
//! The renderer filters textures over a ray's footprint. The reference filters procedural textures too; images with
//! mipmaps are so coarse here that a texel is wider than any footprint, where filtering is bilinear interpolation at
//! several points.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use whit::mesh::Mesh;
use whit::scene::{
    AlphaMode, Background, Falloff, Filter, Geometry, LightKind, Material, MaterialInput, Model, Pattern,
    Procedural, Sampler, Scene, Space, Texture, TextureBinding, TextureUse, UvTransform, Wrap,
};
use whit::shape::{Cone, Cylinder, HalfSpace, Polyhedron, Shape, Sphere};

use super::meshes::{Shading, ball, rectangle};
use super::wave_scenes::{
    WaveScene, add_geometry, add_material, camera, light, lying, matte, metal, moved, noise, perspective,
    place, spot,
};

/// Parameters that the textures of a scene change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Role {
    BaseColor,
    /// Roughness, around a mirror's threshold, and metalness.
    Roughness,
    /// Roughness and metalness from one texture, in glTF's packing.
    Packed,
    Emission,
    /// Alpha mask: surfaces with holes.
    Mask,
    /// Alpha blending: surfaces that transmit a part of the background.
    Blend,
    Normal,
    Bump,
    /// Bump map on top of a normal map.
    NormalAndBump,
    /// Phong's model: kr, rsp and the base colour.
    Phong,
    /// Specular reflection of a dielectric, both strength and colour, and the ambient light.
    Specular,
}

/// Kind of texture: image or procedural pattern.
#[derive(Clone, Copy)]
enum Kind {
    Image(Filter, [Wrap; 2]),
    Pattern(Pattern),
}

const KINDS: [Kind; 8] = [
    Kind::Image(Filter::Nearest, [Wrap::Repeat, Wrap::MirroredRepeat]),
    Kind::Image(Filter::Linear, [Wrap::MirroredRepeat, Wrap::ClampToEdge]),
    Kind::Image(Filter::Mipmap, [Wrap::ClampToEdge, Wrap::Repeat]),
    Kind::Pattern(Pattern::Checker),
    Kind::Pattern(Pattern::Gradient),
    Kind::Pattern(Pattern::Noise { octaves: 3 }),
    Kind::Pattern(Pattern::Marble {
        octaves: 2,
        turbulence: 0.8,
    }),
    Kind::Pattern(Pattern::Wood { turbulence: 0.4 }),
];

/// Returns the test scene of a role.
pub fn gallery(role: Role) -> WaveScene {
    let mut scene = Scene {
        images: vec![noise(5, 3, 4), noise(4, 7, 5), noise(2, 3, 6)],
        ..Scene::default()
    };
    let shapes = shapes();
    // Add a panel and two objects for each kind of texture
    for (index, kind) in KINDS.into_iter().enumerate() {
        let (column, row) = (index % 4, index / 4);
        let at = moved(
            1.2 * (column as f64 - 1.5),
            0.55 + 0.95 * row as f64,
            -0.9 * row as f64,
        );
        let [on_uv, in_object] =
            [Space::Uv, Space::Object].map(|space| add_textured(&mut scene, role, kind, index, space));
        let panel = add_geometry(&mut scene, Geometry::Mesh(panel(index % 2 == 0)));
        let mirrored = DAffine3::from_scale(DVec3::new(if index % 3 == 0 { -1.0 } else { 1.0 }, 1.1, 0.9));
        let turn = DAffine3::from_rotation_y(0.3 - 0.15 * column as f64);
        place(
            &mut scene,
            panel,
            on_uv,
            at * moved(-0.28, 0.0, -0.1) * turn * mirrored,
        );
        let shape = add_geometry(&mut scene, Geometry::Shape(shapes[index].clone()));
        let turn = DAffine3::from_axis_angle(DVec3::new(1.0, 2.0, 0.7).normalize(), 0.6 + index as f64);
        let squeezed = DAffine3::from_scale(DVec3::new(0.21, 0.24, 0.19));
        place(
            &mut scene,
            shape,
            in_object,
            at * moved(0.3, 0.2, 0.1) * turn * squeezed,
        );
        let round = match kind {
            Kind::Image(..) => Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
            Kind::Pattern(_) => Geometry::Mesh(ball(1, Shading::Smooth)),
        };
        let round = add_geometry(&mut scene, round);
        place(
            &mut scene,
            round,
            in_object,
            at * moved(0.28, -0.27, 0.15) * turn * DAffine3::from_scale(DVec3::splat(0.18)),
        );
    }
    // Add the mirror, lights and camera
    add_background(&mut scene);
    WaveScene {
        name: "gallery",
        scene,
        depth: 2,
    }
}

/// Adds a mirror on the ground, lights, and a camera that sees all objects and their reflections.
fn add_background(scene: &mut Scene) {
    let silver = add_material(scene, metal([0.9, 0.88, 0.85], 0.0));
    let mirror = add_geometry(scene, Geometry::Shape(Shape::Quad));
    place(
        scene,
        mirror,
        silver,
        moved(0.0, -0.05, 0.3) * lying() * DAffine3::from_scale(DVec3::new(3.2, 2.4, 1.0)),
    );
    scene.lights = vec![
        light(
            [9.0, 8.5, 8.0],
            LightKind::Point {
                position: DVec3::new(-1.7, 2.9, 2.6),
                falloff: Falloff::PHYSICAL,
            },
        ),
        light([4.0, 5.0, 7.0], spot([2.3, 3.1, 2.2], [-0.5, -0.6, -0.6])),
        light(
            [0.5; 3],
            LightKind::Directional {
                to_light: DVec3::new(0.35, 0.55, 0.75).normalize(),
            },
        ),
    ];
    scene.ambient = [0.2, 0.18, 0.15];
    scene.background = Background::Uniform([0.25, 0.3, 0.4]);
    scene.cameras = vec![camera([0.31, 1.9, 5.2], [0.03, 0.62, 0.0], perspective(0.62))];
}

/// Adds texture, layers and material of one kind in one space; returns the material.
fn add_textured(scene: &mut Scene, role: Role, kind: Kind, index: usize, space: Space) -> u32 {
    // Each layer has a texture of its own
    let mut layer = |parameter: MaterialInput, strength: f32| {
        let colors = colors(parameter);
        scene.textures.push(texture(kind, index, space, colors));
        TextureBinding {
            parameter,
            texture: TextureUse {
                texture: scene.textures.len() as u32 - 1,
                tex_coord: u32::from(index % 2 == 1 && space == Space::Uv),
                transform: transform(kind, index),
            },
            strength,
        }
    };
    let plain = matte([0.8, 0.7, 0.9], 0.45);
    let with = |layers: Vec<TextureBinding>| Material {
        layers,
        ..plain.clone()
    };
    // Bind the textures that the role requires
    let material = match role {
        Role::BaseColor => with(vec![layer(MaterialInput::BaseColor, 1.0)]),
        Role::Mask | Role::Blend => Material {
            alpha: if role == Role::Mask {
                AlphaMode::Mask(0.45)
            } else {
                AlphaMode::Blend
            },
            ..with(vec![layer(MaterialInput::BaseColor, 1.0)])
        },
        Role::Roughness => Material {
            layers: vec![
                layer(MaterialInput::Roughness, 1.0),
                layer(MaterialInput::Metallic, 1.0),
            ],
            ..metal([0.9, 0.7, 0.5], 0.6)
        },
        Role::Packed => Material {
            layers: vec![layer(MaterialInput::MetallicRoughness, 1.0)],
            ..metal([0.9, 0.7, 0.5], 0.6)
        },
        Role::Emission => Material {
            emission: [0.9, 1.2, 0.7],
            ..with(vec![layer(MaterialInput::Emission, 1.0)])
        },
        Role::Normal => with(vec![layer(MaterialInput::Normal, 0.8)]),
        Role::Bump => with(vec![layer(MaterialInput::Bump, 0.02)]),
        Role::NormalAndBump => with(vec![
            layer(MaterialInput::Normal, 0.8),
            layer(MaterialInput::Bump, 0.02),
        ]),
        Role::Phong => Material {
            model: Model::Phong(whit::scene::Phong {
                specular: [0.7, 0.8, 0.6],
                exponent: 20.0,
                reflection: [0.5, 0.6, 0.7],
                ..whit::scene::Phong::DEFAULT
            }),
            ..with(vec![
                layer(MaterialInput::BaseColor, 1.0),
                layer(MaterialInput::SpecularColor, 1.0),
                layer(MaterialInput::Reflection, 1.0),
            ])
        },
        Role::Specular => with(vec![
            layer(MaterialInput::Specular, 1.0),
            layer(MaterialInput::SpecularColor, 1.0),
            layer(MaterialInput::Occlusion, 0.7),
        ]),
    };
    add_material(scene, material)
}

/// Returns the two colours of a pattern: for a normal map, two normals.
fn colors(parameter: MaterialInput) -> [[f32; 4]; 2] {
    match parameter {
        MaterialInput::Normal => [[0.35, 0.6, 0.93, 1.0], [0.66, 0.38, 0.9, 1.0]],
        MaterialInput::Roughness => [[0.06, 0.0, 0.0, 1.0], [1.0; 4]],
        MaterialInput::MetallicRoughness => [[0.0, 0.06, 1.0, 1.0], [1.0, 1.0, 0.2, 1.0]],
        _ => [[0.9, 0.3, 0.1, 0.15], [0.1, 0.6, 0.95, 0.9]],
    }
}

fn texture(kind: Kind, index: usize, space: Space, colors: [[f32; 4]; 2]) -> Texture {
    match kind {
        Kind::Image(filter, [wrap_u, wrap_v]) => Texture::Image {
            image: index as u32,
            sampler: Sampler {
                wrap_u,
                wrap_v,
                filter,
            },
        },
        Kind::Pattern(pattern) => Texture::Procedural(Procedural {
            pattern,
            colors,
            space,
            // Place the faces of a cube and the plane of a square between cells of the checkerboard.
            scale: match space {
                Space::Uv => [2.3, 1.9, 1.0],
                Space::Object => [2.0, 1.7, 2.0],
            },
        }),
    }
}

/// Returns a rotation, scale and offset; mipmapped images are magnified instead.
fn transform(kind: Kind, index: usize) -> UvTransform {
    let (sin, cos) = (0.4 + 0.3 * index as f32).sin_cos();
    let [x, y] = match kind {
        Kind::Image(Filter::Mipmap, _) => [0.5, 0.6],
        _ => [1.3, 0.8],
    };
    UvTransform {
        matrix: [[x * cos, y * sin], [-x * sin, y * cos]],
        offset: [0.17, -0.31],
    }
}

/// Returns a rectangle with two sets of coordinates, one of them skewed, with or without tangents.
fn panel(has_tangents: bool) -> Mesh {
    let tangents = vec![
        [1.0, 0.0, 0.0, 1.0],
        [0.96, 0.28, 0.0, 1.0],
        [0.8, 0.6, 0.0, 1.0],
        [0.96, -0.28, 0.0, 1.0],
    ];
    Mesh {
        tex_coords: vec![
            vec![[-0.31, 1.21], [1.23, 1.32], [1.14, -0.27], [-0.26, -0.33]].into(),
            vec![[0.06, 0.15], [1.31, -0.07], [1.24, 1.19], [-0.11, 1.08]].into(),
        ],
        tangents: has_tangents.then(|| tangents.into()),
        ..rectangle(0.5, 0.85)
    }
}

/// Returns a shape for each kind of texture.
fn shapes() -> [Shape; 8] {
    let corners = [
        DVec3::ONE,
        DVec3::new(-1.0, -1.0, 1.0),
        DVec3::new(-1.0, 1.0, -1.0),
        DVec3::new(1.0, -1.0, -1.0),
    ];
    let half_spaces = corners.map(|n| HalfSpace { n, h: 0.8 });
    let tetrahedron = Polyhedron::from_half_spaces(&half_spaces).unwrap();
    [
        Shape::Cylinder(Cylinder { capped: true }),
        Shape::Cube,
        Shape::Quad,
        Shape::Cube,
        Shape::Polyhedron(Arc::new(tetrahedron)),
        Shape::Cone(Cone { capped: true }),
        Shape::Disk,
        Shape::Cylinder(Cylinder { capped: false }),
    ]
}
