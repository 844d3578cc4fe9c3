//! Test scenes of Phong materials and transmissive objects, for the comparison of the renderer with the reference
//! tracer.

use glam::{DAffine3, DVec3};
use whit::optics::{Absorption, Cauchy, Dispersion, Sellmeier};
use whit::scene::{
    AlphaMode, Background, Camera, Falloff, Filter, Geometry, LightKind, Material, MaterialInput, Medium,
    MediumKind, MetallicRoughness, Model, Phong, Projection, Sampler, Scene, Texture, TextureBinding,
    TextureUse, Wrap,
};
use whit::shape::{Shape, Sphere};

use super::meshes::{Shading, ball, cube, inverted, prism, rectangle, textured_panel};
use super::wave_scenes::{
    WaveScene, add_geometry, add_material, bake, camera, light, lying, matte, metal, moved, noise,
    perspective, place, spot,
};

fn phong(base: [f32; 3], model: Phong) -> Material {
    Material {
        model: Model::Phong(model),
        base_color: [base[0], base[1], base[2], 1.0],
        ..Material::default()
    }
}

/// Returns an interior of constant index; `color` is the transmittance of one metre.
fn inside(ior: f64, color: [f64; 3], priority: i32) -> Option<Medium> {
    Some(Medium {
        ior: Dispersion::Constant(ior),
        absorption: Absorption::from_color(color, 1.0),
        priority,
        kind: MediumKind::Solid,
    })
}

/// Returns a transmissive material with Whitted's kr and kt, or with Fresnel's equations.
fn clear(division: Division, interior: Option<Medium>) -> Material {
    let (reflection, transmission) = match division {
        Division::Fresnel => ([1.0, 0.9, 0.95], [0.95, 1.0, 0.9]),
        Division::Constant => ([0.2, 0.15, 0.1], [0.7, 0.75, 0.8]),
    };
    let model = Phong {
        ambient: [0.02; 3],
        diffuse: [0.03, 0.02, 0.04],
        specular: [0.4, 0.5, 0.45],
        exponent: 30.0,
        reflection,
        transmission,
        fresnel: matches!(division, Division::Fresnel),
    };
    Material {
        interior,
        ..phong([1.0; 3], model)
    }
}

/// Rule that divides light at the boundary of a transmissive object.
#[derive(Clone, Copy)]
pub enum Division {
    Fresnel,
    /// Constant kr and kt at all angles.
    Constant,
}

const SKY: Background = Background::Gradient {
    horizon: [0.7, 0.6, 0.45],
    up: [0.15, 0.3, 0.8],
    down: [0.2, 0.15, 0.1],
};

fn point(position: [f64; 3], falloff: Falloff) -> LightKind {
    LightKind::Point {
        position: position.into(),
        falloff,
    }
}

fn sun(to_light: [f64; 3]) -> LightKind {
    LightKind::Directional {
        to_light: DVec3::from(to_light).normalize(),
    }
}

fn scaled(x: f64, y: f64, z: f64) -> DAffine3 {
    DAffine3::from_scale(DVec3::new(x, y, z))
}

fn add_ball(scene: &mut Scene) -> u32 {
    add_geometry(scene, Geometry::Shape(Shape::Sphere(Sphere::UNIT)))
}

fn add_floor(scene: &mut Scene, material: u32, height: f64) {
    let at = moved(0.1, height, -0.2) * DAffine3::from_rotation_y(0.37) * lying();
    bake(scene, rectangle(11.0, 9.0), material, at);
}

/// Returns a scene of Phong materials under every kind of light: coloured coefficients, highlights, mirrors, falloff
/// polynomials; an unlit sphere, and a glTF sphere with rarely used parameters.
pub fn blackboard() -> WaveScene {
    let mut scene = Scene::default();
    // Define materials: diffuse, mirrors, unlit, and glTF with specular parameters
    let clay = phong(
        [0.9, 0.5, 0.3],
        Phong {
            ambient: [0.6, 0.8, 1.0],
            diffuse: [0.8, 0.7, 0.9],
            specular: [0.3, 0.5, 0.2],
            exponent: 17.5,
            ..Phong::DEFAULT
        },
    );
    let steel = phong(
        [0.3, 0.35, 0.4],
        Phong {
            specular: [0.9, 0.8, 0.6],
            exponent: 60.0,
            reflection: [0.7, 0.5, 0.6],
            ..Phong::DEFAULT
        },
    );
    let chalk = phong(
        [0.8, 0.75, 0.7],
        Phong {
            specular: [0.1; 3],
            exponent: 0.5,
            reflection: [0.05, 0.08, 0.1],
            ..Phong::DEFAULT
        },
    );
    let sign = Material {
        model: Model::Unlit,
        ..matte([0.9, 0.2, 0.5], 1.0)
    };
    let lacquer = Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.2,
            roughness: 0.3,
            specular: 0.8,
            specular_color: [1.0, 0.6, 0.3],
            transmission: 0.0,
            rough_rays: 0,
        }),
        interior: inside(1.7, [1.0; 3], 0),
        ..matte([0.2, 0.4, 0.6], 0.3)
    };
    let [clay, steel, chalk, sign, lacquer] =
        [clay, steel, chalk, sign, lacquer].map(|material| add_material(&mut scene, material));
    // Add objects
    let ball_shape = add_ball(&mut scene);
    bake(
        &mut scene,
        ball(2, Shading::Smooth),
        clay,
        moved(-1.1, 0.8, 0.3) * scaled(0.8, 0.8, 0.8),
    );
    place(
        &mut scene,
        ball_shape,
        steel,
        moved(0.75, 0.9, -0.4) * scaled(0.9, 0.9, 0.9),
    );
    place(
        &mut scene,
        ball_shape,
        sign,
        moved(-0.1, 0.4, 1.2) * scaled(0.3, 0.4, 0.3),
    );
    place(
        &mut scene,
        ball_shape,
        lacquer,
        moved(0.7, 0.35, 1.1) * scaled(0.35, 0.35, 0.35),
    );
    add_floor(&mut scene, chalk, 0.0);
    // Add lights, including one with a falloff polynomial
    let polynomial = Falloff::Polynomial {
        constant: 0.7,
        linear: 0.2,
        quadratic: 0.05,
    };
    scene.lights = vec![
        light([0.7, 0.6, 0.5], point([-2.2, 3.1, 2.3], polynomial)),
        light([5.0, 9.0, 30.0], spot([2.9, 3.7, 1.9], [-0.62, -0.71, -0.52])),
        light([0.3, 0.25, 0.2], sun([0.3, 0.8, 0.45])),
        light([0.1, 0.15, 0.1], point([1.2, 2.5, 3.1], Falloff::NONE)),
    ];
    scene.ambient = [0.1, 0.12, 0.15];
    scene.background = SKY;
    // Add the camera
    scene.cameras = vec![camera([0.37, 2.2, 5.1], [0.05, 0.66, 0.0], perspective(0.72))];
    WaveScene {
        name: "blackboard",
        scene,
        depth: 3,
    }
}

/// Returns a scene of a sphere, a cube and a mirrored wedge of coloured glass over a floor that they tint.
pub fn paperweights(division: Division) -> WaveScene {
    let mut scene = Scene::default();
    // Define materials
    let chalk = add_material(&mut scene, matte([0.8, 0.78, 0.7], 0.9));
    let green = add_material(&mut scene, clear(division, inside(1.5, [0.35, 0.9, 0.5], 0)));
    let amber = add_material(&mut scene, clear(division, inside(1.62, [0.9, 0.6, 0.15], 0)));
    let violet = add_material(&mut scene, clear(division, inside(1.45, [0.5, 0.2, 0.8], 0)));
    // Add transmissive objects
    let ball_shape = add_ball(&mut scene);
    let wedge = add_geometry(&mut scene, Geometry::Mesh(super::meshes::wedge()));
    place(
        &mut scene,
        ball_shape,
        green,
        moved(-0.9, 0.85, 0.1) * scaled(0.8, 0.8, 0.8),
    );
    bake(
        &mut scene,
        cube(),
        amber,
        moved(0.9, 0.62, -0.1) * DAffine3::from_rotation_y(0.5) * scaled(0.6, 0.6, 0.6),
    );
    place(
        &mut scene,
        wedge,
        violet,
        moved(0.3, 0.05, 1.1) * scaled(-0.8, 0.9, 0.8),
    );
    add_floor(&mut scene, chalk, 0.0);
    // Add lights and the camera
    scene.lights = vec![
        light([14.0, 12.0, 10.0], point([-2.4, 3.6, 1.1], Falloff::PHYSICAL)),
        light([0.9, 1.0, 0.8], sun([0.5, 0.9, 0.3])),
    ];
    scene.ambient = [0.1, 0.12, 0.15];
    scene.background = SKY;
    scene.cameras = vec![camera([0.37, 2.4, 4.6], [0.05, 0.5, 0.0], perspective(0.72))];
    WaveScene {
        name: match division {
            Division::Fresnel => "paperweights",
            Division::Constant => "paperweights without Fresnel",
        },
        scene,
        depth: 4,
    }
}

/// Returns a scene of ice in water in a hollow glass sphere. Water and ice overlap the wall of the glass, the ice rises
/// above the water, and an opaque stone, which has an index, lies in it.
pub fn tumbler() -> WaveScene {
    let mut scene = Scene::default();
    // Define materials of different priorities
    let chalk = add_material(&mut scene, matte([0.8, 0.78, 0.7], 0.9));
    let of = |interior| clear(Division::Fresnel, interior);
    // The order of priorities differs from that of the list.
    let water = add_material(&mut scene, of(inside(1.333, [0.4, 0.7, 0.9], -2)));
    let ice = add_material(&mut scene, of(inside(1.31, [0.8, 0.9, 0.95], 5)));
    let glass = add_material(&mut scene, of(inside(1.52, [0.6, 0.8, 0.7], 9)));
    let stone = Material {
        interior: inside(1.6, [1.0; 3], 7),
        ..matte([0.7, 0.3, 0.2], 0.8)
    };
    let stone = add_material(&mut scene, stone);
    // Add the hollow glass, water, ice and stone
    let ball_shape = add_ball(&mut scene);
    let at = |y: f64| moved(0.0, 1.3 + y, 0.0);
    place(&mut scene, ball_shape, glass, at(0.0) * scaled(1.25, 1.25, 1.25));
    bake(
        &mut scene,
        inverted(ball(1, Shading::Flat)),
        glass,
        at(0.0) * scaled(1.05, 1.05, 1.05),
    );
    place(&mut scene, ball_shape, water, at(-0.25) * scaled(1.08, 0.8, 1.08));
    bake(
        &mut scene,
        cube(),
        ice,
        at(0.35) * DAffine3::from_rotation_y(0.4) * DAffine3::from_rotation_z(0.3) * scaled(0.55, 0.45, 0.5),
    );
    place(
        &mut scene,
        ball_shape,
        stone,
        at(-0.55) * moved(0.3, 0.0, 0.3) * scaled(0.25, 0.2, 0.22),
    );
    // Add the floor, lights and camera
    add_floor(&mut scene, chalk, 0.0);
    scene.lights = vec![
        light([14.0, 12.0, 10.0], point([-2.4, 4.6, 2.1], Falloff::PHYSICAL)),
        light([0.6, 0.7, 0.9], sun([0.6, 0.8, 0.5])),
    ];
    scene.ambient = [0.1, 0.12, 0.15];
    scene.background = SKY;
    scene.cameras = vec![camera([0.5, 2.3, 5.0], [0.03, 1.1, 0.0], perspective(0.68))];
    WaveScene {
        name: "tumbler",
        scene,
        depth: 5,
    }
}

/// Returns a scene seen from under water, up to a surface that reflects all light outside of a circle; a sphere of ice
/// extends out of the water, with a bubble in the water and a pier in both media.
pub fn pool() -> WaveScene {
    let mut scene = Scene::default();
    // Define materials of different priorities
    let chalk = add_material(&mut scene, matte([0.8, 0.78, 0.7], 0.9));
    let of = |interior| clear(Division::Fresnel, interior);
    let water = add_material(&mut scene, of(inside(1.333, [0.75, 0.9, 0.95], 1)));
    let ice = add_material(&mut scene, of(inside(1.31, [0.8, 0.9, 0.95], 2)));
    let air = add_material(&mut scene, of(inside(1.0, [1.0; 3], 3)));
    let wood = add_material(&mut scene, matte([0.6, 0.35, 0.2], 0.7));
    // Add water, ice, a bubble and the pier
    let ball_shape = add_ball(&mut scene);
    bake(
        &mut scene,
        cube(),
        water,
        moved(0.03, -1.0, 0.02) * scaled(5.0, 2.0, 5.0),
    );
    place(
        &mut scene,
        ball_shape,
        ice,
        moved(0.9, 0.9, -1.2) * scaled(0.5, 0.5, 0.5),
    );
    place(
        &mut scene,
        ball_shape,
        air,
        moved(-0.8, 0.1, -0.9) * scaled(0.4, 0.4, 0.4),
    );
    let pier = DAffine3::from_rotation_y(0.3) * scaled(0.12, 1.6, 0.12);
    bake(&mut scene, cube(), wood, moved(-0.1, 0.6, -1.9) * pier);
    // Add the floor, lights and camera
    add_floor(&mut scene, chalk, -1.1);
    scene.lights = vec![
        light([24.0, 22.0, 18.0], point([-1.4, 3.6, -0.7], Falloff::PHYSICAL)),
        light([0.6, 0.7, 0.9], sun([0.3, 0.9, 0.2])),
    ];
    scene.ambient = [0.1, 0.12, 0.15];
    scene.background = SKY;
    scene.cameras = vec![camera([0.2, -0.5, 1.6], [0.05, 0.55, -1.0], perspective(1.2))];
    WaveScene {
        name: "pool",
        scene,
        depth: 4,
    }
}

/// Returns a scene of panels one behind the other, with alpha masks or partial coverage by their texture; their
/// shadows, and a mirror that reflects them.
pub fn veils() -> WaveScene {
    let mut scene = Scene {
        images: vec![noise(7, 5, 1), noise(8, 8, 2)],
        ..Scene::default()
    };
    let chalk = add_material(&mut scene, matte([0.8, 0.78, 0.7], 0.9));
    let silver = add_material(&mut scene, metal([0.9, 0.92, 0.88], 0.05));
    let wraps = [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge];
    // Add panels with masked and blended alpha
    let modes = [
        AlphaMode::Mask(0.4),
        AlphaMode::Blend,
        AlphaMode::Mask(0.55),
        AlphaMode::Blend,
    ];
    for (index, alpha) in modes.into_iter().enumerate() {
        let wrap = wraps[index % 3];
        scene.textures.push(Texture::Image {
            image: index as u32 % 2,
            sampler: Sampler {
                wrap_u: wrap,
                wrap_v: wrap,
                filter: if index == 2 {
                    Filter::Linear
                } else {
                    Filter::Nearest
                },
            },
        });
        let layer = TextureBinding {
            parameter: MaterialInput::BaseColor,
            texture: TextureUse::new(index as u32),
            strength: 1.0,
        };
        let material = Material {
            alpha,
            layers: vec![layer],
            base_color: [0.9, 0.8, 1.0, 0.85],
            ..matte([0.0; 3], 0.5)
        };
        let material = add_material(&mut scene, material);
        let depth = 0.35 * index as f64;
        let at = moved(-0.6 + 0.4 * depth, 0.75, 0.9 - depth) * DAffine3::from_rotation_y(0.2 - 0.15 * depth);
        bake(&mut scene, textured_panel(), material, at * scaled(1.5, 1.3, 1.0));
    }
    // Half coverage, without any texture.
    let haze = Material {
        alpha: AlphaMode::Blend,
        base_color: [0.3, 0.6, 0.9, 0.5],
        ..matte([0.0; 3], 0.4)
    };
    let haze = add_material(&mut scene, haze);
    let ball_shape = add_ball(&mut scene);
    place(
        &mut scene,
        ball_shape,
        haze,
        moved(1.0, 0.6, 0.6) * scaled(0.5, 0.5, 0.5),
    );
    // Add a mirror, the floor, lights and camera
    bake(
        &mut scene,
        rectangle(3.5, 2.0),
        silver,
        moved(0.3, 1.0, -1.3) * DAffine3::from_rotation_y(-0.2),
    );
    add_floor(&mut scene, chalk, 0.0);
    scene.lights = vec![
        light([14.0, 12.0, 10.0], point([0.6, 2.6, 2.9], Falloff::PHYSICAL)),
        light([0.6, 0.7, 0.9], sun([-0.4, 0.9, 0.7])),
    ];
    scene.ambient = [0.1, 0.12, 0.15];
    scene.background = SKY;
    scene.cameras = vec![camera([0.27, 1.9, 4.4], [0.05, 0.66, 0.0], perspective(0.72))];
    WaveScene {
        name: "veils",
        scene,
        depth: 2,
    }
}

/// Returns a scene of prisms with dispersion: one by Sellmeier's equation, and a red one by Cauchy's, in which light of
/// one wavelength has no positive weight left.
pub fn prisms() -> WaveScene {
    let mut scene = Scene::default();
    let chalk = add_material(&mut scene, matte([0.8, 0.78, 0.7], 0.9));
    let flint = Medium {
        ior: Dispersion::Sellmeier(Sellmeier::N_SF11),
        absorption: Absorption::from_color([0.9, 0.95, 0.8], 1.0),
        priority: 0,
        kind: MediumKind::Solid,
    };
    let ruby = Medium {
        ior: Dispersion::Cauchy(Cauchy::from_abbe(1.6, 22.0)),
        ..flint
    };
    let flint = add_material(&mut scene, clear(Division::Fresnel, Some(flint)));
    let red = Phong {
        reflection: [0.1, 0.0, 0.0],
        transmission: [0.9, 0.0, 0.0],
        ..Phong::DEFAULT
    };
    let ruby = Material {
        interior: Some(ruby),
        ..phong([0.02; 3], red)
    };
    let ruby = add_material(&mut scene, ruby);
    let emissive = Material {
        emission: [3.0, 2.5, 2.0],
        ..matte([0.0; 3], 1.0)
    };
    let emissive = add_material(&mut scene, emissive);
    let wedge = add_geometry(&mut scene, Geometry::Mesh(prism()));
    let ball_shape = add_ball(&mut scene);
    let turn = DAffine3::from_rotation_y(1.2) * DAffine3::from_rotation_z(0.15);
    place(
        &mut scene,
        wedge,
        flint,
        moved(-0.8, 0.6, 0.2) * turn * scaled(0.7, 0.7, 0.9),
    );
    place(
        &mut scene,
        wedge,
        ruby,
        moved(1.0, 0.55, 0.0) * DAffine3::from_rotation_y(0.6) * scaled(0.6, 0.6, 0.8),
    );
    place(
        &mut scene,
        ball_shape,
        flint,
        moved(0.25, 0.35, 1.3) * scaled(0.3, 0.3, 0.3),
    );
    for step in 0..4 {
        let x = -2.3 + 1.3 * f64::from(step);
        bake(
            &mut scene,
            cube(),
            emissive,
            moved(x, 1.0, -2.1) * scaled(0.09, 1.4, 0.09),
        );
    }
    add_floor(&mut scene, chalk, 0.0);
    scene.lights = vec![
        light([14.0, 12.0, 10.0], point([-2.4, 3.6, 1.1], Falloff::PHYSICAL)),
        light([0.5, 0.6, 0.7], sun([0.5, 0.9, 0.3])),
    ];
    scene.ambient = [0.1, 0.12, 0.15];
    scene.background = SKY;
    scene.cameras = vec![camera([0.37, 1.6, 4.6], [0.05, 0.5, 0.0], perspective(0.76))];
    WaveScene {
        name: "prisms",
        scene,
        depth: 4,
    }
}

/// Returns a scene through an off-centre view window, with a near plane that clips objects: a thin pane, a pane without
/// any index, glTF's transmission in a smooth mesh and in a frosted sphere, and a glass sphere of half coverage.
pub fn window() -> WaveScene {
    let mut scene = Scene::default();
    let chalk = add_material(&mut scene, matte([0.8, 0.78, 0.7], 0.9));
    let gltf = |transmission: f32, roughness: f32, interior: Option<Medium>| Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic: 0.1,
            roughness,
            specular: 0.9,
            specular_color: [0.9, 1.0, 0.8],
            transmission,
            rough_rays: 0,
        }),
        interior,
        ..matte([0.7, 0.9, 0.8], 0.0)
    };
    let thin = inside(1.5, [1.0; 3], 0).map(|interior| Medium {
        kind: MediumKind::ThinSlab,
        ..interior
    });
    let half = Material {
        alpha: AlphaMode::Blend,
        base_color: [1.0, 1.0, 1.0, 0.5],
        ..clear(Division::Fresnel, inside(1.4, [0.3, 0.5, 0.9], 1))
    };
    let pane = add_material(&mut scene, gltf(0.9, 0.0, thin));
    let foil = add_material(&mut scene, clear(Division::Constant, None));
    let crystal = add_material(&mut scene, gltf(0.8, 0.05, inside(1.5, [0.5, 0.7, 0.6], 0)));
    let frosted = add_material(&mut scene, gltf(0.6, 0.5, inside(1.4, [0.9, 0.7, 0.6], 0)));
    let half = add_material(&mut scene, half);
    let ball_shape = add_ball(&mut scene);
    bake(
        &mut scene,
        rectangle(1.0, 1.6),
        pane,
        moved(-1.3, 0.9, 1.0) * DAffine3::from_rotation_y(0.5),
    );
    bake(
        &mut scene,
        rectangle(0.9, 1.2),
        foil,
        moved(1.4, 0.7, 1.1) * DAffine3::from_rotation_y(-0.6),
    );
    bake(
        &mut scene,
        ball(2, Shading::Smooth),
        crystal,
        moved(-0.6, 0.7, 0.0) * scaled(0.65, 0.65, 0.65),
    );
    place(
        &mut scene,
        ball_shape,
        frosted,
        moved(0.9, 0.6, 0.2) * scaled(0.55, 0.55, 0.55),
    );
    place(
        &mut scene,
        ball_shape,
        half,
        moved(0.1, 0.5, 1.5) * scaled(0.4, 0.4, 0.4),
    );
    // Half of the object is in front of the view window.
    bake(
        &mut scene,
        cube(),
        chalk,
        moved(0.6, 0.9, 2.7) * scaled(0.15, 0.15, 0.4),
    );
    add_floor(&mut scene, chalk, 0.0);
    scene.lights = vec![
        light([14.0, 12.0, 10.0], point([-2.4, 3.6, 2.1], Falloff::PHYSICAL)),
        light([0.9, 1.0, 0.8], sun([0.5, 0.9, 0.3])),
    ];
    scene.ambient = [0.1, 0.12, 0.15];
    scene.background = SKY;
    let projection = Projection::Window {
        half_width: 1.1,
        half_height: 0.6,
        distance: 1.9,
    };
    scene.cameras = vec![Camera {
        z_near: 1.9,
        ..camera([0.37, 1.7, 4.6], [0.05, 0.6, 0.0], projection)
    }];
    WaveScene {
        name: "window",
        scene,
        depth: 4,
    }
}
