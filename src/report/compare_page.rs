//! Two pictures held against each other as one page: `whit compare --html`.

use super::compare::CompareReport;
use super::difference::FULL_DIFFERENCE;
use super::page::{self, Cell, Column, Table, View, escape};
use super::words::percent;
use crate::image::metrics::Deviation;
use crate::image::{LinearImage, ToneMap};

/// The pictures of a page, all of one size.
#[derive(Clone, Copy, Debug)]
pub struct Pictures<'a> {
    /// What is held to be right.
    pub reference: &'a LinearImage,
    /// What is held against it.
    pub picture: &'a LinearImage,
    /// Their signed difference.
    pub difference: &'a LinearImage,
    /// The FLIP error of each pixel as a colour.
    pub flip: &'a LinearImage,
}

/// The page of a comparison.
///
/// # Errors
///
/// Where a picture has more pixels than a PNG.
pub fn page(report: &CompareReport, pictures: &Pictures) -> std::io::Result<String> {
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
    let not_numbers: usize = report.non_finite.iter().sum();
    if not_numbers > 0 {
        tiles.push((not_numbers.to_string(), "pixels are no numbers", "fails"));
    }
    let mut body = "<h1>Two pictures</h1>\n".to_owned();
    body += &page::facts(&[
        ("reference", escape(&report.reference.display().to_string())),
        ("picture", escape(&report.picture.display().to_string())),
        ("size", format!("{}x{} pixels", report.width, report.height)),
    ]);
    body += &page::numbers(&tiles);
    let tone = ToneMap {
        exposure_ev: report.exposure_ev,
    };
    body += &viewer(pictures, tone)?;
    body += "<h2>Errors</h2>\n";
    body += &errors(report);
    Ok(page::page("whit compare", &body))
}

/// A viewer of the pictures; `tone` is of the two that are held against each other.
///
/// # Errors
///
/// Where a picture has more pixels than a PNG.
pub(super) fn viewer(pictures: &Pictures, tone: ToneMap) -> std::io::Result<String> {
    let plain = ToneMap::default();
    let difference = format!(
        "The picture less the reference as displayed: grey where they are alike, black or white where a channel differs by \
         {} of its range or more",
        percent(FULL_DIFFERENCE)
    );
    let view = |name, words, image, tone| View {
        name,
        words,
        image,
        tone,
    };
    page::viewer(&[
        view("reference", "The reference", pictures.reference, tone),
        view("picture", "The picture", pictures.picture, tone),
        view("difference", &difference, pictures.difference, plain),
        view(
            "FLIP",
            "What an observer notices who flips between them (LDR-FLIP): from nothing, dark violet, to all there is, light yellow",
            pictures.flip,
            plain,
        ),
    ])
}

fn errors(report: &CompareReport) -> String {
    let mut table = Table::new(&[
        Column::Words("of"),
        Column::Numbers("RMSE"),
        Column::Numbers("MAE"),
        Column::Numbers("largest"),
        Column::Numbers("relMSE"),
    ]);
    let metrics = &report.metrics;
    let relative = format!("{:.4e}", metrics.rel_mse);
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
    table.html("")
}
