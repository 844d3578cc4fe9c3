//! Clear coats, sheen, anisotropic lobes and thin films in whole renders: furnaces, and what each layer adds.

use crate::support::images::{self, add, estimate, rendered};
use glam::{DAffine3, DMat3, DVec3};
use whit::render::RenderSettings;
use whit::scene::{
    Anisotropy, Background, Camera, Clearcoat, Geometry, Iridescence, Material, MetallicRoughness, Model,
    Projection, Scene, Sheen,
};
use whit::shape::Shape;

/// Returns a plane z = 0 of this material under white surroundings that rays and the ambient term see.
fn furnace(material: Material) -> Scene {
    let mut scene = Scene {
        background: Background::Uniform([1.0; 3]),
        ambient: [1.0; 3],
        ..Scene::default()
    };
    add(
        &mut scene,
        "object",
        Geometry::Shape(Shape::Plane),
        material,
        DAffine3::IDENTITY,
    );
    scene
}

/// Returns the mean radiance and its standard error, seen at this angle to the normal.
fn seen(material: Material, degrees: f64) -> (f64, f64) {
    let (sin, cos) = f64::to_radians(degrees).sin_cos();
    let wo = DVec3::new(sin, 0.0, cos);
    let (x, y) = wo.any_orthonormal_pair();
    let camera = Camera {
        world_from_camera: DAffine3::from_mat3_translation(DMat3::from_cols(x, y, wo), 2.0 * wo),
        projection: Projection::Orthographic {
            y_mag: 1e-6,
            x_mag: None,
        },
        ..Camera::default()
    };
    let settings = RenderSettings {
        weight_cutoff: 0.0,
        ..images::settings(16, 64)
    };
    estimate(&rendered(&furnace(material), &camera, &settings).image)
}

/// Returns a white material with a ray into each lobe.
fn white(metallic: f32, roughness: f32) -> Material {
    Material {
        model: Model::MetallicRoughness(MetallicRoughness {
            metallic,
            roughness,
            rough_rays: 1,
            ..MetallicRoughness::DEFAULT
        }),
        ..Material::default()
    }
}

const ANGLES: [f64; 4] = [0.0, 35.0, 60.0, 80.0];

/// Error of the fits of the lobe's albedo.
const FIT: f64 = 1.5e-3;

#[test]
fn coated_white_surface_reflects_all_light() {
    for (metallic, roughness) in [(0.0, 0.5), (1.0, 0.0), (1.0, 0.6)] {
        for coat_roughness in [0.0, 0.05, 0.3, 1.0] {
            let material = Material {
                clearcoat: Some(Clearcoat {
                    factor: 0.8,
                    roughness: coat_roughness,
                }),
                ..white(metallic, roughness)
            };
            for degrees in ANGLES {
                let (found, error) = seen(material.clone(), degrees);
                assert!(
                    (found - 1.0).abs() < 3.0 * error + FIT && error < 5e-3,
                    "{metallic} {roughness} {coat_roughness} {degrees}: {found} ± {error}"
                );
            }
        }
    }
}

#[test]
fn coat_over_black_reflects_its_fresnel_term() {
    for roughness in [0.0, 0.4] {
        let black = Material {
            base_color: [0.0, 0.0, 0.0, 1.0],
            clearcoat: Some(Clearcoat {
                factor: 0.5,
                roughness,
            }),
            ..white(1.0, 1.0)
        };
        for degrees in ANGLES {
            let cosine = f64::to_radians(degrees).cos();
            let fresnel = 0.04 + 0.96 * (1.0 - cosine).powi(5);
            // The base is a metal of black, whose microfacets reflect at grazing angles as any do
            let bare = Material {
                clearcoat: None,
                ..black.clone()
            };
            let (below, below_error) = seen(bare, degrees);
            let (found, error) = seen(black.clone(), degrees);
            let expected = 0.5 * fresnel + (1.0 - 0.5 * fresnel) * below;
            let bound = 3.0 * error.hypot(below_error) + FIT * expected + 1e-6;
            assert!(
                (found - expected).abs() < bound,
                "{roughness} {degrees}: {found} ± {error}, not {expected}"
            );
        }
    }
}

#[test]
fn white_sheen_over_white_surface_reflects_all_light() {
    for roughness in [0.1, 0.3, 0.6, 1.0] {
        let material = Material {
            sheen: Some(Sheen {
                color: [1.0; 3],
                roughness,
            }),
            ..white(0.0, 0.7)
        };
        for degrees in ANGLES {
            let (found, error) = seen(material.clone(), degrees);
            assert!(
                (found - 1.0).abs() < 3.0 * error + FIT,
                "{roughness} {degrees}: {found} ± {error}"
            );
        }
    }
}

#[test]
fn anisotropic_white_metal_reflects_all_light() {
    // Error of the quadrature of the lobe's albedo
    const QUADRATURE: f64 = 0.035;
    for (roughness, strength) in [(0.2, 0.5), (0.4, 1.0), (0.7, 0.8)] {
        for rotation in [0.0, 1.0] {
            let material = Material {
                anisotropy: Some(Anisotropy { strength, rotation }),
                ..white(1.0, roughness)
            };
            for degrees in ANGLES {
                let (found, error) = seen(material.clone(), degrees);
                assert!(
                    (found - 1.0).abs() < 3.0 * error + QUADRATURE,
                    "{roughness} {strength} {degrees}: {found} ± {error}"
                );
            }
        }
    }
}

#[test]
fn thin_film_on_dielectric_keeps_energy_and_on_metal_takes_some() {
    for (metallic, roughness) in [(0.0, 0.0), (0.0, 0.5), (1.0, 0.0), (1.0, 0.5)] {
        for thickness in [150.0, 400.0, 900.0] {
            let material = Material {
                iridescence: Some(Iridescence {
                    factor: 1.0,
                    ior: 1.4,
                    thickness: [thickness; 2],
                }),
                ..white(metallic, roughness)
            };
            for degrees in ANGLES {
                let (found, error) = seen(material.clone(), degrees);
                assert!(
                    found < 1.0 + 3.0 * error + FIT,
                    "{metallic} {roughness} {degrees}: {found} ± {error}"
                );
                assert!(found > 0.5, "{metallic} {roughness} {degrees}: {found}");
            }
        }
    }
}
