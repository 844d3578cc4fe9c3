//! Tests of texture lookups through a prepared scene.

use super::procedural::tests::patterns;
use super::*;
use crate::numeric::{LANES, Lanes3, SplitMix64};
use crate::scene::{AlphaMode, Material, MaterialInput, Model, Pattern, TextureBinding, UvTransform, Wrap};

const MIPMAPPED: Sampler = Sampler {
    wrap_u: Wrap::Repeat,
    wrap_v: Wrap::Repeat,
    filter: Filter::Mipmap,
};

fn image(width: u32, height: u32, texels: Texels) -> Image {
    Image {
        name: String::new(),
        width,
        height,
        texels,
    }
}

/// Creates a scene with one texture, on `parameter` of its only material.
fn scene(texture: Texture, images: Vec<Image>, parameter: MaterialInput) -> Scene {
    Scene {
        materials: vec![Material {
            name: String::new(),
            model: Model::Unlit,
            base_color: [1.0; 4],
            emission: [0.0; 3],
            alpha: AlphaMode::Opaque,
            layers: vec![TextureBinding {
                parameter,
                texture: TextureUse::new(0),
                strength: 1.0,
            }],
            ..Material::default()
        }],
        textures: vec![texture],
        images,
        ..Scene::default()
    }
}

fn image_scene(image: Image, sampler: Sampler, parameter: MaterialInput) -> Scene {
    scene(Texture::Image { image: 0, sampler }, vec![image], parameter)
}

fn at(uv: [f32; 2], uv_width: f32) -> TexturePoint {
    TexturePoint {
        uv_width,
        ..TexturePoint::sharp(uv, DVec3::ZERO)
    }
}

fn stripes() -> Image {
    // Black and white columns alternate, 64 by 64.
    let texel = |i: u32| {
        if i.is_multiple_of(2) {
            [0, 0, 0, 255]
        } else {
            [255; 4]
        }
    };
    image(
        64,
        64,
        Texels::Bytes((0..64 * 64).map(texel).collect::<Vec<_>>().into()),
    )
}

#[test]
fn a_constant_image_returns_its_colour_for_every_lookup() {
    let scene = image_scene(
        image(3, 2, Texels::Bytes(vec![[188, 0, 255, 51]; 6].into())),
        MIPMAPPED,
        MaterialInput::BaseColor,
    );
    let set = TextureSet::new(&scene);
    let srgb = set.constant(0, Encoding::Srgb).unwrap();
    assert_eq!(srgb[1..], [0.0, 1.0, 0.2]);
    assert!((srgb[0] - 0.502_886_5).abs() < 1e-6);
    assert_eq!(set.sample(0, Encoding::Srgb, &at([f32::NAN, 7.0], 3.0)), srgb);
    assert_eq!(
        set.sample(0, Encoding::Linear, &at([0.0; 2], 0.0))[0],
        188.0 / 255.0
    );
}

#[test]
fn mip_levels_are_built_only_for_filtered_textures() {
    let built = |filter, parameter| {
        let scene = image_scene(stripes(), Sampler { filter, ..MIPMAPPED }, parameter);
        let set = TextureSet::new(&scene);
        set.mip_maps[0].each_ref().map(Option::is_some)
    };
    assert_eq!(built(Filter::Mipmap, MaterialInput::BaseColor), [true, false]);
    assert_eq!(built(Filter::Mipmap, MaterialInput::Normal), [false, true]);
    assert_eq!(built(Filter::Linear, MaterialInput::BaseColor), [false, false]);
}

#[test]
fn a_wide_ray_sees_the_mean_in_linear_light_and_a_narrow_one_the_texels() {
    let scene = image_scene(stripes(), MIPMAPPED, MaterialInput::BaseColor);
    let set = TextureSet::new(&scene);
    let red = |u: f32, width: f32| set.sample(0, Encoding::Srgb, &at([u, 0.5], width))[0];
    assert_eq!([red(0.5 / 64.0, 0.0), red(1.5 / 64.0, 0.0)], [0.0, 1.0]);
    // The mean is half of the linear light, not half of the sRGB code, rounded to a fraction of 65535.
    let half = 32768.0 / 65535.0;
    assert_eq!(red(0.5 / 64.0, 2.0 / 64.0), half);
    assert_eq!(red(0.5 / 64.0, 1e9), half);
}

#[test]
fn half_floats_of_any_size_pass_through_unclipped() {
    let texels: Vec<_> = (0..6).map(|i| [1000.0 * i as f32, -1.0, 0.0, 1.0]).collect();
    let scene = image_scene(
        image(3, 2, Texels::Floats(texels.into())),
        MIPMAPPED,
        MaterialInput::Emission,
    );
    let set = TextureSet::new(&scene);
    let narrow = set.sample(0, Encoding::Srgb, &at([0.5, 0.25], 0.0));
    assert_eq!(narrow, [1000.0, -1.0, 0.0, 1.0]);
    assert_eq!(set.sample(0, Encoding::Srgb, &at([0.5, 0.25], 1.0))[0], 2500.0);
}

#[test]
fn elongated_footprint_blurs_only_across_stripes() {
    let scene = image_scene(stripes(), MIPMAPPED, MaterialInput::BaseColor);
    let set = TextureSet::new(&scene);
    let red = |longer: [f32; 2], shorter: [f32; 2]| {
        let footprint = Footprint {
            uv: [longer, shorter],
            ..Footprint::default()
        };
        set.sample_footprint(0, Encoding::Srgb, &at([1.5 / 64.0, 0.5], 0.0), &footprint)[0]
    };
    assert_eq!(red([0.0, 8.0 / 64.0], [1.0 / 64.0, 0.0]), 1.0);
    assert!((red([8.0 / 64.0, 0.0], [0.0, 1.0 / 64.0]) - 0.5).abs() < 1e-6);
    assert_eq!(red([0.0; 2], [0.0; 2]), 1.0);
}

fn checker(space: Space) -> Scene {
    let procedural = Procedural {
        pattern: Pattern::Checker,
        colors: [[0.0; 4], [1.0; 4]],
        space,
        scale: [1.0; 3],
    };
    scene(
        Texture::Procedural(procedural),
        Vec::new(),
        MaterialInput::BaseColor,
    )
}

#[test]
fn a_footprint_along_the_axes_gives_the_checkers_exact_mean() {
    let scene = checker(Space::Object);
    let set = TextureSet::new(&scene);
    let footprint = Footprint {
        object: [DVec3::Y * 2.5, DVec3::X * 0.5],
        ..Footprint::default()
    };
    let point = TexturePoint::sharp([0.0; 2], DVec3::new(0.5, 0.75, 0.0));
    // Along y from -½ to 2: ½ of the second colour, 1 of the first, 1 of the second; x and z stay inside one cell.
    let mean = set.sample_footprint(0, Encoding::Linear, &point, &footprint)[0];
    assert!((mean - 0.6).abs() < 1e-6, "{mean}");
}

#[test]
fn filtered_checkered_floor_is_close_to_1024_samples() {
    // The camera is one unit above the floor y = 0 and looks to the horizon, turned by 0.3 from the squares' axes.
    const PIXELS: usize = 64;
    const SIDE: usize = 32;
    let scene = checker(Space::Object);
    let set = TextureSet::new(&scene);
    let (sin, cos) = 0.3f64.sin_cos();
    let floor = |x: f64, y: f64| {
        let depth = 1.0 / y;
        DVec3::new(cos * x * depth + sin * depth, cos * depth - sin * x * depth, 0.0)
    };
    let pixel = 1.0 / PIXELS as f64;
    let (mut squares, mut count) = (0.0, 0.0);
    for row in 0..PIXELS {
        for column in 0..PIXELS {
            let corner = |i: f64, j: f64| floor((column as f64 + i) * pixel - 0.5, (row as f64 + j) * pixel);
            let look = |p: DVec3, footprint: &Footprint| {
                let point = TexturePoint::sharp([0.0; 2], p);
                f64::from(set.sample_footprint(0, Encoding::Linear, &point, footprint)[0])
            };
            // Average the pixel by many point samples
            let mut mean = 0.0;
            for sample in 0..SIDE * SIDE {
                let within = |i: usize| (i as f64 + 0.5) / SIDE as f64;
                let p = corner(within(sample % SIDE), within(sample / SIDE));
                mean += look(p, &Footprint::default()) / (SIDE * SIDE) as f64;
            }
            let p = corner(0.5, 0.5);
            // Project a pixel of the window at depth 1 to the depth of the floor there.
            let width = pixel / ((row as f64 + 0.5) * pixel);
            // Filter the pixel with one footprint
            let d = DVec3::new(p.x, p.y, -1.0).normalize();
            let axes = crate::shading::ray_cone::axes_on_surface(width, d, DVec3::Z);
            let one = look(
                p,
                &Footprint {
                    object: axes,
                    ..Footprint::default()
                },
            );
            squares += (one - mean).powi(2);
            count += 1.0;
        }
    }
    let rmse = (squares / count).sqrt();
    assert!(rmse < 0.02, "{rmse}");
}

#[test]
fn patterns_at_sixteen_points_equal_those_of_each() {
    let mut random = SplitMix64::new(11, 0);
    let mut images = PacketLookup::new();
    for (pattern, round) in patterns()
        .into_iter()
        .flat_map(|pattern| (0..64).map(move |i| (pattern, i)))
    {
        let texture = Texture::Procedural(Procedural {
            pattern,
            colors: [[0.1, 0.2, 0.3, 1.0], [0.7, 0.8, 0.9, 0.5]],
            space: Space::Object,
            scale: [2.0, 1.0, 0.5],
        });
        let scene = scene(texture, Vec::new(), MaterialInput::BaseColor);
        let set = TextureSet::new(&scene);
        // Choose points and footprints of all sizes; some without width, some of a point that is not finite
        let mut packet = PatternPacket::ZERO;
        let size = 2f64.powi(round % 13 - 9);
        for l in 0..LANES {
            for axis in 0..3 {
                packet.p[axis][l] = 20.0 * random.unit() - 10.0;
                packet.axes[0][axis][l] = size * (random.unit() - 0.5);
                packet.axes[1][axis][l] = 0.1 * size * random.unit() * f64::from(l as u32 % 4);
            }
        }
        packet.p[1][3] = f64::NAN;
        packet.axes[0][2][5] = f64::INFINITY;
        packet.axes = if round % 8 == 0 {
            PatternPacket::ZERO.axes
        } else {
            packet.axes
        };
        let mut mask = [true; LANES];
        mask[7] = false;
        let together = *set.sample_pattern(0, &packet, &mask, &mut images);
        // Look each of them up
        for l in (0..LANES).filter(|&l| mask[l]) {
            let lane = |v: &Lanes3<f64>| DVec3::new(v[0][l], v[1][l], v[2][l]);
            let footprint = Footprint {
                uv: [[0.0; 2]; 2],
                object: packet.axes.each_ref().map(lane),
            };
            let point = TexturePoint::sharp([0.0; 2], lane(&packet.p));
            let alone = set.sample_footprint(0, Encoding::Linear, &point, &footprint);
            assert_eq!(
                together[l].map(f32::to_bits),
                alone.map(f32::to_bits),
                "{pattern:?} {l}"
            );
        }
    }
}

#[test]
fn gradient_of_ramp_follows_the_uv_transform() {
    // R rises by 1/32 per texel along u and by twice that along v.
    let rise = |i: u32| (i % 32 + 2 * (i / 32)) as f32 / 32.0;
    let texels: Vec<_> = (0..32 * 32).map(|i| [rise(i), 0.0, 0.0, 1.0]).collect();
    let scene = image_scene(
        image(32, 32, Texels::Floats(texels.into())),
        MIPMAPPED,
        MaterialInput::Bump,
    );
    let set = TextureSet::new(&scene);
    let slope = |transform| {
        let layer = TextureUse {
            transform,
            ..TextureUse::new(0)
        };
        set.height_gradient(&layer, &at([0.4, 0.6], 0.0), [DVec3::X, DVec3::Y])
    };
    let is_near = |a: [f32; 2], b: [f32; 2]| (0..2).all(|i| (a[i] - b[i]).abs() < 1e-4);
    assert!(is_near(slope(UvTransform::IDENTITY), [1.0, 2.0]));
    // u' = 3 v, v' = -u: a rise by v becomes a fall by u, and a rise by u becomes a rise by v, three times as steep.
    let turned = UvTransform {
        matrix: [[0.0, 3.0], [-1.0, 0.0]],
        offset: [0.0; 2],
    };
    assert!(is_near(slope(turned), [-2.0, 3.0]));
}

#[test]
fn gradient_of_solid_texture_is_taken_along_the_surface() {
    let procedural = Procedural {
        pattern: Pattern::Gradient,
        colors: [[0.0; 4], [2.0; 4]],
        space: Space::Object,
        scale: [0.5, 1.0, 1.0],
    };
    let scene = scene(Texture::Procedural(procedural), Vec::new(), MaterialInput::Bump);
    let point = TexturePoint::sharp([0.0; 2], DVec3::new(0.5, 9.0, 9.0));
    let derivatives = [DVec3::new(3.0, 1.0, 0.0), DVec3::Z];
    let slope = TextureSet::new(&scene).height_gradient(&TextureUse::new(0), &point, derivatives);
    // The red channel rises by 2 over 2 units of x; u moves 3 units of x.
    assert!((slope[0] - 3.0).abs() < 1e-6 && slope[1] == 0.0, "{slope:?}");
}

#[test]
fn extreme_coordinates_find_a_texel() {
    let absurd = [f32::NAN, f32::INFINITY, f32::MAX, -f32::MAX, -1e-45, 0.0];
    for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
        for filter in [Filter::Nearest, Filter::Linear, Filter::Mipmap] {
            let sampler = Sampler {
                wrap_u: wrap,
                wrap_v: wrap,
                filter,
            };
            let scene = image_scene(stripes(), sampler, MaterialInput::Bump);
            let set = TextureSet::new(&scene);
            for u in absurd {
                for width in absurd {
                    let point = at([u, u], width);
                    let footprint = Footprint {
                        uv: [[width, u], [u, width]],
                        ..Footprint::default()
                    };
                    let colors = [
                        set.sample(0, Encoding::Linear, &point),
                        set.sample_footprint(0, Encoding::Linear, &point, &footprint),
                    ];
                    assert!(colors.as_flattened().iter().all(|c| (0.0..=1.0).contains(c)));
                    let slope = set.height_gradient(&TextureUse::new(0), &point, [DVec3::X, DVec3::Y]);
                    assert!(slope.iter().all(|c| c.is_finite()));
                }
            }
        }
    }
}
