//! Tests of regions and sample shares: regions have the bits of the whole image, and shares of samples add up to the
//! same bits regardless of where they are rendered.

use crate::support::images;
use crate::support::scene_folder;
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::render::{
    FilterKind, Monitor, PartSums, Parts, Pattern, PixelFilter, Region, RenderSettings, Rendering, Share,
    render_pixels,
};
use whit::scene::Scene;

fn tree(scene: &Scene) -> Box<dyn Accel + '_> {
    accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap()
}

/// Returns settings in which neither side is a multiple of a tile's.
fn settings(spp: u32, filter: FilterKind) -> RenderSettings {
    RenderSettings {
        width: 75,
        height: 101,
        spp,
        pattern: Pattern::Sobol,
        filter: PixelFilter::of_kind(filter),
        sample_aovs: true,
        depth: 4,
        ..RenderSettings::default()
    }
}

fn cut<T: Copy>(values: &[T], width: u32, region: &Region) -> Vec<T> {
    let rows = values.chunks(width as usize).skip(region.y as usize);
    rows.take(region.height as usize)
        .flat_map(|row| &row[region.x as usize..(region.x + region.width) as usize])
        .copied()
        .collect()
}

fn assert_shows(part: &Rendering, whole: &Rendering, region: &Region) {
    let width = whole.image.width;
    assert_eq!(
        [part.image.width, part.image.height],
        [region.width, region.height]
    );
    assert_eq!(
        part.image.pixels,
        cut(&whole.image.pixels, width, region),
        "{region:?}"
    );
    let (aovs, all) = (part.aovs.as_ref().unwrap(), whole.aovs.as_ref().unwrap());
    assert_eq!(aovs.variance, cut(&all.variance, width, region), "{region:?}");
    assert_eq!(
        part.samples.total,
        region.pixel_count() * u64::from(whole.samples.max)
    );
}

#[test]
fn chosen_pixels_have_the_bits_of_the_full_image() {
    // Packets of one, four and sixteen samples a pixel; every seventh pixel, but none of the bottom rows
    for spp in [1, 4, 20] {
        let scene = scene_folder::named("mirror_room.toml").scene;
        let accel = tree(&scene);
        let settings = settings(spp, FilterKind::Box);
        let whole = images::rendered_with(&scene, &*accel, &settings).image;
        let is_chosen: Vec<bool> = (0..75 * 101)
            .map(|pixel| pixel % 7 == 0 && pixel < 75 * 60)
            .collect();
        let view = (scene.validate().unwrap(), &scene.cameras[0]);
        let image = render_pixels(view, &*accel, &settings, &is_chosen, &Monitor::default()).unwrap();
        let expected = whole
            .pixels
            .iter()
            .zip(&is_chosen)
            .map(|(&pixel, &is_chosen)| match is_chosen {
                true => pixel,
                false => [0.0; 3],
            });
        assert_eq!(image.pixels, expected.collect::<Vec<_>>(), "{spp} samples");
        assert!(image.pixels.iter().any(|pixel| pixel[0] > 0.0));
    }
}

#[test]
fn region_has_the_bits_of_the_full_image() {
    let regions = [
        [0, 0, 75, 101],
        [0, 32, 75, 32],
        [0, 40, 75, 7],
        [74, 100, 1, 1],
        [30, 63, 5, 3],
    ];
    for (name, spp, filter) in [
        ("mirror_room.toml", 3, FilterKind::Box),
        ("whitted_1980.toml", 16, FilterKind::Mitchell),
        ("soft_shadows.toml", 20, FilterKind::Tent),
    ] {
        let scene = scene_folder::named(name).scene;
        let accel = tree(&scene);
        let settings = settings(spp, filter);
        let whole = images::rendered_with(&scene, &*accel, &settings);
        let mut parts = Parts::new(
            (scene.validate().unwrap(), &scene.cameras[0]),
            &*accel,
            &settings,
            &Monitor::default(),
        )
        .unwrap();
        for [x, y, width, height] in regions {
            let region = Region { x, y, width, height };
            let part = parts.region(&region, &Monitor::default()).unwrap();
            assert_shows(&part, &whole, &region);
        }
    }
}

/// Renders the shares of an image's rows in this order, and adds them in the order of their numbers.
fn added(parts: &mut Parts, rows: &Region, count: u32) -> PartSums {
    let mut made: Vec<(u32, PartSums)> = (0..count)
        .rev()
        .map(|index| {
            let share = Share { index, count };
            (index, parts.sums(rows, share, &Monitor::default()).unwrap().0)
        })
        .collect();
    made.sort_by_key(|(index, _)| *index);
    let mut sums = made.remove(0).1;
    made.iter().for_each(|(_, next)| sums.add(next));
    sums
}

#[test]
fn sample_shares_sum_to_the_image() {
    for filter in [FilterKind::Box, FilterKind::Mitchell] {
        let scene = scene_folder::named("soft_shadows.toml").scene;
        let accel = tree(&scene);
        // Use four packets, the last of which is not full.
        let settings = settings(60, filter);
        let whole = images::rendered_with(&scene, &*accel, &settings);
        let mut parts = Parts::new(
            (scene.validate().unwrap(), &scene.cameras[0]),
            &*accel,
            &settings,
            &Monitor::default(),
        )
        .unwrap();
        let all = Region::whole(&settings);
        let one = added(&mut parts, &all, 1);
        assert_eq!((one.samples, one.pixels()), (60, whole.image.pixels.clone()));
        assert_eq!(one.aovs(), whole.aovs);
        let three = added(&mut parts, &all, 3);
        assert_eq!(three.samples, 60);
        // Sums in another order: f64 has an error of some 2^-53 of the largest term each, f32 of one rounding.
        for (made, whole) in three.pixels().iter().zip(&whole.image.pixels) {
            for channel in 0..3 {
                let off = (made[channel] - whole[channel]).abs();
                assert!(
                    off <= whole[channel].abs() * f32::EPSILON,
                    "{made:?} for {whole:?}"
                );
            }
        }
        // Check that rows alone have the bits of the whole.
        let rows = Region::of_rows(&settings, 32..64);
        let band = added(&mut parts, &rows, 3);
        assert_eq!(band.pixels(), cut(&three.pixels(), settings.width, &rows));
    }
}

#[test]
fn share_count_may_equal_packet_count() {
    assert_eq!([1, 3, 4, 15, 16, 17, 64].map(Share::most), [1, 3, 1, 4, 1, 2, 4]);
}
