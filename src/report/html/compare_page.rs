//! HTML page of an image comparison: `whit compare --html`.

use super::page::{self, Cell, Column, PageElement, Table, View};
use crate::image::metrics::Deviation;
use crate::image::{LinearImage, ToneMap};
use crate::report::format::percent;
use crate::report::image::difference_image::FULL_DIFFERENCE;
use crate::report::text::compare::CompareReport;

/// Images of a comparison page, all of equal size.
#[derive(Clone, Copy, Debug)]
pub struct ComparedImages<'a> {
    /// Reference image, which counts as correct.
    pub reference: &'a LinearImage,
    /// Image that is compared with the reference.
    pub image: &'a LinearImage,
    /// Signed difference of the two images.
    pub difference: &'a LinearImage,
    /// FLIP error of each pixel as a colour.
    pub flip: &'a LinearImage,
}

/// Returns the HTML page of a comparison.
///
/// # Errors
///
/// Returns an error if an image has more pixels than a PNG can store.
pub fn page(report: &CompareReport, images: &ComparedImages) -> std::io::Result<String> {
    // List the metrics as tiles
    let metrics = &report.metrics;
    let mut tiles = vec![
        (format!("{:.4}", metrics.flip), "FLIP", ""),
        (format!("{:.2} dB", metrics.psnr), "PSNR", ""),
        (
            percent(metrics.changed_share),
            "of pixels differ by more than 1/255",
            "",
        ),
    ];
    if let Some(hdr) = report.flip_hdr {
        tiles.insert(1, (format!("{hdr:.4}"), "HDR-FLIP", ""));
    }
    if let Some(ssim) = report.ssim {
        tiles.push((format!("{ssim:.4}"), "SSIM", ""));
    }
    // Warn about non-finite pixels
    let not_numbers: usize = report.non_finite.iter().sum();
    if not_numbers > 0 {
        tiles.push((not_numbers.to_string(), "pixels are not finite", "fails"));
    }
    // Assemble the page from facts, viewer and error table
    let facts = page::facts(&[
        ("reference", report.reference.display().to_string()),
        ("image", report.picture.display().to_string()),
        ("size", format!("{}x{} pixels", report.width, report.height)),
    ]);
    let tone = ToneMap {
        exposure_ev: report.exposure_ev,
    };
    let elements = [
        facts,
        page::numbers(&tiles),
        viewer(images, tone)?,
        PageElement::heading("Errors"),
        errors(report),
    ];
    Ok(page::page("whit compare", "Image comparison", &elements))
}

/// Returns the viewer of the images; `tone` applies to the compared ones.
///
/// # Errors
///
/// Returns an error if an image has more pixels than a PNG can store.
pub(super) fn viewer(images: &ComparedImages, tone: ToneMap) -> std::io::Result<PageElement> {
    let plain = ToneMap::default();
    // Explain how to read the difference image
    let difference = format!(
        "The image minus the reference as displayed: grey where they are equal, black or white where a channel differs \
         by {} of its range or more",
        percent(FULL_DIFFERENCE)
    );
    let view = |name, words, image, tone| View {
        name,
        words,
        image,
        tone,
    };
    let views = [
        view("reference", "The reference", images.reference, tone),
        view("image", "The image", images.image, tone),
        view("difference", &difference, images.difference, plain),
        view(
            "FLIP",
            "Visible difference on flipping between the images (LDR-FLIP): none dark violet, the maximum light yellow",
            images.flip,
            plain,
        ),
    ];
    let views = views.map(|view| Ok((view.name.to_owned(), view.image(1)?)));
    Ok(PageElement::Viewer {
        views: views.into_iter().collect::<std::io::Result<_>>()?,
    })
}

fn errors(report: &CompareReport) -> PageElement {
    let mut table = Table::new(
        "",
        &[
            Column::Words("of"),
            Column::Numbers("RMSE"),
            Column::Numbers("MAE"),
            Column::Numbers("largest"),
            Column::Numbers("relMSE"),
        ],
    );
    let metrics = &report.metrics;
    let relative = format!("{:.4e}", metrics.rel_mse);
    // Relative errors exist for radiance only
    for (what, Deviation { rmse, mae, max }, relative) in [
        ("radiance", metrics.radiance, relative.as_str()),
        ("values as displayed, 0 to 1", metrics.displayed, ""),
    ] {
        let cells = [rmse, mae, max].map(|x| Cell::text(&format!("{x:.4e}")));
        let mut row = vec![Cell::text(what)];
        row.extend(cells);
        row.push(Cell::text(relative));
        table.row(("", what), &row);
    }
    PageElement::Table(table)
}
