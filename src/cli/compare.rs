//! Command `whit compare`: error metrics between an image and its reference.

use std::path::Path;

use whit::image::metrics::{self, Viewing};
use whit::image::{ImageFormat, LinearImage, LoadedImage, ToneMap, check_writable, load_image, write};
use whit::report::compare::CompareReport;
use whit::report::{compare_page, difference_image};

use super::args::CompareArgs;
use super::failure::Failure;
use super::interrupt;
use super::output;

/// Compares two images, prints the metrics, and writes the files that the arguments request.
pub(super) fn run(args: &CompareArgs) -> Result<(), Failure> {
    // Check the output files and read both images
    let outputs = [&args.json, &args.html, &args.difference, &args.heat];
    for path in outputs.into_iter().flatten() {
        check_writable(path)?;
    }
    let reference = load_image(&args.reference)?;
    let image = load_image(&args.image)?;
    interrupt::check()?;
    // Compute the metrics at the requested exposure
    let tone = ToneMap {
        exposure_ev: args.exposure,
    };
    let viewing = Viewing {
        tone,
        pixels_per_degree: args.pixels_per_degree,
    };
    let compared = metrics::compare(&reference.image, &image.image, &viewing)
        .map_err(|error| Failure::Input(error.to_string()))?;
    let report = CompareReport {
        reference: args.reference.clone(),
        picture: args.image.clone(),
        width: reference.image.width,
        height: reference.image.height,
        is_radiance: reference.is_radiance && image.is_radiance,
        exposure_ev: args.exposure,
        pixels_per_degree: args.pixels_per_degree,
        metrics: compared.metrics,
        ssim: compared.ssim,
        flip_hdr: flip_hdr([&reference, &image], args.pixels_per_degree),
        non_finite: [&reference, &image].map(|loaded| loaded.image.non_finite_count()),
    };
    // Print and write the report
    interrupt::check()?;
    output::print(&report.to_string())?;
    if let Some(path) = &args.json {
        interrupt::without_interruption(|| output::write_json(path, &report))?;
    }
    // Write the difference images and the page, which are computed only on request
    let signed = || difference_image::signed(&reference.image, &image.image, args.exposure);
    let heat = || difference_image::heat(&compared.flip_map, report.width);
    if let Some(path) = &args.difference {
        write_png(&signed(), path)?;
    }
    if let Some(path) = &args.heat {
        write_png(&heat(), path)?;
    }
    if let Some(path) = &args.html {
        let compared_images = compare_page::ComparedImages {
            reference: &reference.image,
            image: &image.image,
            difference: &signed(),
            flip: &heat(),
        };
        let page = compare_page::page(&report, &compared_images).map_err(|error| {
            Failure::Work(format!("cannot encode the images of {}: {error}", path.display()))
        })?;
        interrupt::without_interruption(|| output::write_text(path, &page))?;
    }
    Ok(())
}

/// Returns the mean HDR-FLIP error, or `None` unless both images are radiance.
fn flip_hdr([reference, image]: [&LoadedImage; 2], pixels_per_degree: f64) -> Option<f64> {
    if !(reference.is_radiance && image.is_radiance) {
        return None;
    }
    let map = metrics::flip_hdr_map(&reference.image, &image.image, pixels_per_degree).ok()?;
    Some(map.iter().copied().map(f64::from).sum::<f64>() / map.len().max(1) as f64)
}

fn write_png(image: &LinearImage, path: &Path) -> Result<(), Failure> {
    interrupt::without_interruption(|| Ok(write(image, path, ImageFormat::Png, ToneMap::default())?))
}
