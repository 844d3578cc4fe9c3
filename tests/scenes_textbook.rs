//! Scenes of the folder `scenes` are as the textbook has them, by every backend.

#[path = "common"]
mod common {
    #![allow(dead_code, unreachable_pub, reason = "this program uses a part of it")]

    pub mod approx;
    pub mod bodies;
    pub mod cones;
    pub mod hits;
    pub mod normals;
    pub mod patterns;
    pub mod scene_folder;
    pub mod shapes;
    pub mod surface;
    pub mod texels;
    pub mod textbook;
    pub mod verdict;
}

use common::scene_folder::{files, load};
use common::textbook::{Request, picture};
use common::verdict::{assert_agree, backends, relative_bound};

/// Pixels a row.
const WIDTH: u32 = 48;

#[test]
#[ignore]
fn survey() {
    for file in files() {
        let filed = load(&file);
        if let Ok(only) = std::env::var("ONLY") {
            if !only.split(',').any(|o| o == filed.name) {
                continue;
            }
        }
        let prims: usize = filed
            .scene
            .instances
            .iter()
            .map(|i| match &filed.scene.geometries[i.geometry as usize] {
                whit::scene::Geometry::Mesh(m) => m.triangles.len(),
                _ => 1,
            })
            .sum();
        let torus = filed
            .scene
            .geometries
            .iter()
            .any(|g| matches!(g, whit::scene::Geometry::Shape(whit::shape::Shape::Torus(_))));
        let start = std::time::Instant::now();
        println!(
            "{}: {prims} primitives, torus {torus}, lights {}",
            filed.name,
            filed.scene.lights.len()
        );
        if torus || prims > 60000 {
            continue;
        }
        let settings = filed.settings(WIDTH, 1);
        let request = Request {
            width: settings.width,
            height: settings.height,
            spp: 1,
            depth: settings.depth,
            weight_cutoff: settings.weight_cutoff,
            wavelengths: settings.wavelengths,
        };
        let referee = picture(&filed.scene, &filed.scene.cameras[0], request);
        for share in [0.4, 0.5, 0.65, 0.8, 0.95] {
            print!("{share}: {:.1e}  ", relative_bound(&referee, share));
        }
        println!(" {:.1} s", start.elapsed().as_secs_f64());
        for backend in backends() {
            let image = filed.picture(backend, &settings);
            if backend == whit::accel::Backend::Bsp {
                for (i, (g, p)) in image.pixels.iter().zip(&referee).enumerate() {
                    let e = p.radiance.value();
                    let g = glam::DVec3::from(g.map(f64::from));
                    if (g - e).abs().max_element() > 1e-4 * e.max_element() {
                        println!(
                            "   {} {}: {:.5} vs {:.5} err {:.1e} {:?}",
                            i as u32 % settings.width,
                            i as u32 / settings.width,
                            g,
                            e,
                            p.radiance.error().max_element(),
                            p.doubt
                        );
                    }
                }
            }
            let r = std::panic::catch_unwind(|| {
                assert_agree(&format!("{} {backend}", filed.name), &image, &referee)
            });
            if r.is_err() {
                println!("FAILED {}", filed.name);
            }
        }
    }
}
