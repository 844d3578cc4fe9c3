//! Command `whit compare`: error metrics between an image and its reference.

use std::path::Path;

use crate::image::metrics::{self, Viewing};
use crate::image::{ImageFormat, LinearImage, LoadedImage, ToneMap, check_writable, read_picture, write};
use crate::report::compare::CompareReport;
use crate::report::{compare_page, difference};

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
    let reference = read_picture(&args.reference)?;
    let picture = read_picture(&args.picture)?;
    interrupt::check()?;
    // Compute the metrics at the requested exposure
    let tone = ToneMap {
        exposure_ev: args.exposure,
    };
    let viewing = Viewing {
        tone,
        pixels_per_degree: args.pixels_per_degree,
    };
    let compared = metrics::compare(&reference.image, &picture.image, &viewing)
        .map_err(|error| Failure::Input(error.to_string()))?;
    let report = CompareReport {
        reference: args.reference.clone(),
        picture: args.picture.clone(),
        width: reference.image.width,
        height: reference.image.height,
        is_radiance: reference.is_radiance && picture.is_radiance,
        exposure_ev: args.exposure,
        pixels_per_degree: args.pixels_per_degree,
        metrics: compared.metrics,
        ssim: compared.ssim,
        flip_hdr: flip_hdr([&reference, &picture], args.pixels_per_degree),
        non_finite: [&reference, &picture].map(|picture| picture.image.non_finite_count()),
    };
    // Print and write the report
    interrupt::check()?;
    output::print(&report.to_string())?;
    if let Some(path) = &args.json {
        interrupt::finish_first(|| output::write_json(path, &report))?;
    }
    // Write the difference images and the page, which are computed only on request
    let signed = || difference::signed(&reference.image, &picture.image, args.exposure);
    let heat = || difference::heat(&compared.flip_map, report.width);
    if let Some(path) = &args.difference {
        write_png(&signed(), path)?;
    }
    if let Some(path) = &args.heat {
        write_png(&heat(), path)?;
    }
    if let Some(path) = &args.html {
        let pictures = compare_page::Pictures {
            reference: &reference.image,
            picture: &picture.image,
            difference: &signed(),
            flip: &heat(),
        };
        let page = compare_page::page(&report, &pictures).map_err(|error| {
            Failure::Work(format!(
                "could not put the pictures into {}: {error}",
                path.display()
            ))
        })?;
        interrupt::finish_first(|| output::write_text(path, &page))?;
    }
    Ok(())
}

/// Returns the mean HDR-FLIP error, or `None` unless both images are radiance.
fn flip_hdr([reference, picture]: [&LoadedImage; 2], pixels_per_degree: f64) -> Option<f64> {
    if !(reference.is_radiance && picture.is_radiance) {
        return None;
    }
    let map = metrics::flip_hdr_map(&reference.image, &picture.image, pixels_per_degree).ok()?;
    Some(map.iter().copied().map(f64::from).sum::<f64>() / map.len().max(1) as f64)
}

fn write_png(image: &LinearImage, path: &Path) -> Result<(), Failure> {
    interrupt::finish_first(|| Ok(write(image, path, ImageFormat::Png, ToneMap::default())?))
}
