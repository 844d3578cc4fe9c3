//! Compares the scenes of the folder `scenes` with the recursive reference tracer, for every backend, in small images
//! of one sample per pixel.
//!
//! All scenes are compared except those in [`BEYOND`]. The reference tracer has no mipmaps, which are off here, and
//! no adaptive sampling or pixel filters, which do not apply to one sample.
//!
//! Run the large scenes with `tests/ci/slow textbook`.

use whit::scene::{Filter, Texture};

use crate::support::scene_folder::{FiledScene, files, load};
use crate::support::textbook::{Request, reference_image};
use crate::support::verdict::{EXPLAINED_SHARE, assert_agree_but_for, backends};

/// Number of pixels per row.
const WIDTH: u32 = 48;

/// Parameters of the comparison of one scene.
struct Entry {
    name: &'static str,
    /// Share of the pixels that may differ visibly, each within its bound or with a doubtful decision.
    share: f64,
    cost: Cost,
}

/// Cost of the reference render, which tests every primitive for each ray.
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

/// All scenes that are compared.
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
    // Nested glass, water, ice and air leave a third of the image without a useful bound; most of it is equal anyway.
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
    // The prisms touch their plinths without a gap: rounding decides which of the two a ray hits.
    Entry {
        share: 0.02,
        ..small("prism")
    },
    // 7382 spheres. Rays bounce between small mirrors, and few of the last bounces have a useful bound.
    Entry {
        share: 0.01,
        ..large("sphereflake")
    },
    // A pattern is evaluated a few roundings below the surface. The table is flat, so these roundings are large in its
    // object space, and its grain is fine.
    Entry {
        share: 0.06,
        ..small("table_of_shapes")
    },
    small("textured"),
    small("under_water"),
    small("whitted_1980"),
];

/// Scenes that the reference tracer cannot render, with the reason.
const BEYOND: [(&str, &str); 18] = [
    (
        "caustics",
        "tests/it/lighting/caustics.rs compares photons with closed forms",
    ),
    (
        "cornell_box",
        "tests/it/lighting/interreflection.rs compares interreflection with closed forms",
    ),
    (
        "door",
        "tests/it/lighting/interreflection.rs compares interreflection with closed forms",
    ),
    ("depth_of_field", "rays start at random points of the lens"),
    (
        "fire",
        "tests/it/lighting/volumes.rs compares volumes with closed forms",
    ),
    (
        "fog_beam",
        "tests/it/lighting/volumes.rs compares fog with closed forms",
    ),
    (
        "leaf",
        "tests/it/lighting/subsurface_render.rs compares thin surfaces with closed forms",
    ),
    (
        "milk_and_paint",
        "tests/it/lighting/subsurface_render.rs compares subsurface scattering with closed forms",
    ),
    (
        "pool",
        "tests/it/lighting/caustics.rs compares photons with closed forms",
    ),
    ("rough", "glossy lobes are sampled in random directions"),
    ("motion", "rays have random times"),
    ("glow", "emissive objects are sampled at random points"),
    (
        "scan",
        "tests/it/lighting/volumes.rs compares volumes with closed forms",
    ),
    (
        "smoke",
        "tests/it/lighting/volumes.rs compares volumes with closed forms",
    ),
    (
        "spectrum",
        "tests/it/lighting/caustics.rs compares photons with closed forms",
    ),
    ("soft_shadows", "area lights are sampled at random points"),
    (
        "sun_and_sky",
        "the environment map is sampled in random directions",
    ),
    (
        "wax",
        "tests/it/lighting/subsurface_render.rs compares subsurface scattering with closed forms",
    ),
];

/// Returns the scene with bilinear filtering in place of mipmaps, which the reference tracer does not have.
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

/// Compares all scenes of this cost.
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
        let referee = reference_image(&filed.scene, &filed.scene.cameras[0], request);
        for backend in backends() {
            let image = filed.rendered(backend, &settings);
            let what = format!("{} {backend}", filed.name);
            assert_agree_but_for(entry.share, &what, &image, &referee);
        }
    }
}

#[test]
fn scenes_match_the_reference() {
    compare(Cost::Small);
}

#[test]
#[ignore = "slow: brute force over large scenes"]
fn large_scenes_match_the_reference() {
    compare(Cost::Large);
}
