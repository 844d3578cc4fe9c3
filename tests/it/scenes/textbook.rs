//! The scenes of the folder `scenes` are as the textbook has them, by every backend, in small pictures of one sample a
//! pixel.
//!
//! All of them are compared but a few ([`BEYOND`]). Of what a scene shows, the textbook says nothing of mipmaps, which
//! are off here, and of adaptive sampling and the filters of pixels, which one sample has no use for.
//!
//! The large scenes: `tests/ci/slow textbook`.

use whit::scene::{Filter, Texture};

use crate::support::scene_folder::{FiledScene, files, load};
use crate::support::textbook::{Request, picture};
use crate::support::verdict::{EXPLAINED_SHARE, assert_agree_but_for, backends};

/// Pixels a row.
const WIDTH: u32 = 48;

/// How a scene is compared.
struct Entry {
    name: &'static str,
    /// Share of the pixels that may differ visibly, each by no more than its bound or with a decision in doubt.
    share: f64,
    cost: Cost,
}

/// Whether the textbook, which asks every primitive, is done in a moment.
#[derive(Clone, Copy, PartialEq)]
enum Cost {
    Small,
    Large,
}

const fn small(name: &'static str) -> Entry {
    Entry {
        name,
        share: EXPLAINED_SHARE,
        cost: Cost::Small,
    }
}

const fn large(name: &'static str) -> Entry {
    Entry {
        cost: Cost::Large,
        ..small(name)
    }
}

/// All scenes.
const ENTRIES: [Entry; 20] = [
    small("adaptive_stress"),
    small("checkerboard_horizon"),
    small("coloured_shadows"),
    small("ellipsoids"),
    // 66 478 triangles.
    large("first_light"),
    small("foliage"),
    // 102 384 triangles.
    large("forest"),
    // Eight wavelengths through ten boundaries.
    large("gems"),
    // Behind glass, water, ice and air within each other, nothing is promised of a third of the picture, and most of it
    // is equal all the same.
    Entry {
        share: 0.05,
        ..small("glass_of_water")
    },
    small("lecture_lighting"),
    small("metals_and_gloss"),
    small("mirror_room"),
    // 66 482 primitives.
    large("model_among_shapes"),
    small("polyhedra"),
    // The prisms stand on their plinths without a gap: rounding decides which a ray meets.
    Entry {
        share: 0.02,
        ..small("prism")
    },
    // 7382 spheres. Between them rays go from one small mirror to the next, and few of the last are promised anything.
    Entry {
        share: 0.01,
        ..large("sphereflake")
    },
    // A pattern's point lies a few roundings under the surface. The table is flat, so that in its space they are many,
    // and its grain is fine.
    Entry {
        share: 0.06,
        ..small("table_of_shapes")
    },
    small("textured"),
    small("under_water"),
    small("whitted_1980"),
];

/// Scenes that the textbook cannot tell, with the reason.
const BEYOND: [(&str, &str); 13] = [
    ("depth_of_field", "rays leave from random points of the lens"),
    (
        "fire",
        "volumes are held to closed forms by tests/it/lighting/volumes.rs",
    ),
    (
        "fog_beam",
        "fog is held to closed forms by tests/it/lighting/volumes.rs",
    ),
    (
        "leaf",
        "thin sheets are held to closed forms by tests/it/lighting/subsurface_render.rs",
    ),
    (
        "milk_and_paint",
        "light within bodies is held to closed forms by tests/it/lighting/subsurface_render.rs",
    ),
    ("rough", "lobes are looked into in random directions"),
    ("motion", "rays are sent at random times"),
    ("glow", "lamps are asked at random points"),
    (
        "scan",
        "volumes are held to closed forms by tests/it/lighting/volumes.rs",
    ),
    (
        "smoke",
        "volumes are held to closed forms by tests/it/lighting/volumes.rs",
    ),
    ("soft_shadows", "lights are asked at random points"),
    ("sun_and_sky", "the environment map is asked in random directions"),
    (
        "wax",
        "light within bodies is held to closed forms by tests/it/lighting/subsurface_render.rs",
    ),
];

/// The scene with its images mixed bilinearly at a point: of mipmaps the textbook says nothing.
fn without_mipmaps(mut filed: FiledScene) -> FiledScene {
    for texture in &mut filed.scene.textures {
        if let Texture::Image { sampler, .. } = texture
            && sampler.filter == Filter::Mipmap
        {
            sampler.filter = Filter::Linear;
        }
    }
    filed
}

/// Compares the scenes of this cost.
fn compare(cost: Cost) {
    for file in files() {
        let filed = without_mipmaps(load(&file));
        if BEYOND.iter().any(|(name, _)| *name == filed.name) {
            continue;
        }
        let entry = ENTRIES.iter().find(|entry| entry.name == filed.name);
        let entry = entry.unwrap_or_else(|| panic!("{} is new: add it to the list", filed.name));
        if entry.cost != cost {
            continue;
        }
        let settings = filed.settings(WIDTH, 1);
        let request = Request {
            width: settings.width,
            height: settings.height,
            spp: settings.spp,
            depth: settings.depth,
            weight_cutoff: settings.weight_cutoff,
            wavelengths: settings.wavelengths,
        };
        let referee = picture(&filed.scene, &filed.scene.cameras[0], request);
        for backend in backends() {
            let image = filed.picture(backend, &settings);
            let what = format!("{} {backend}", filed.name);
            assert_agree_but_for(entry.share, &what, &image, &referee);
        }
    }
}

#[test]
fn scenes_are_as_the_textbook_has_them() {
    compare(Cost::Small);
}

#[test]
#[ignore = "slow: brute force over large scenes"]
fn large_scenes_are_as_the_textbook_has_them() {
    compare(Cost::Large);
}
