//! Renders every scene of `scenes` small and lays the pictures out as one sheet, four in a row, by the names of the files.
//!
//! ```text
//! cargo run --release --example contact-sheet
//! ```

use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use image::RgbImage;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use whit::accel::{self, AccelOptions, Backend};
use whit::gltf::{self, LoadOptions};
use whit::image::ToneMap;
use whit::render::{self, Monitor, RenderSettings};
use whit::scene::Scene;
use whit::scene_file::{self, Output};

/// Pixels of a picture.
const PICTURE: [u32; 2] = [320, 240];
/// Pictures in a row.
const COLUMNS: u32 = 4;
/// Pixels between pictures.
const GAP: u32 = 4;
/// Samples a pixel: small pictures show their edges.
const SPP: u32 = 16;

fn main() -> ExitCode {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    match sheet(&folder) {
        Ok(()) => ExitCode::SUCCESS,
        Err(sentence) => {
            eprintln!("{sentence}");
            ExitCode::FAILURE
        }
    }
}

/// Renders the scenes of `folder`, prints their names in order, and writes the sheet beside them.
fn sheet(folder: &Path) -> Result<(), String> {
    let files = scene_files(folder)?;
    let [width, height] = PICTURE;
    let rows = (files.len() as u32).div_ceil(COLUMNS);
    let mut sheet = RgbImage::from_pixel(
        COLUMNS * (width + GAP) - GAP,
        rows * (height + GAP) - GAP,
        image::Rgb([255; 3]),
    );
    for (number, file) in (0..).zip(&files) {
        let picture = picture(file).map_err(|sentence| format!("{}: {sentence}", file.display()))?;
        let corner = [
            (number % COLUMNS) * (width + GAP),
            (number / COLUMNS) * (height + GAP),
        ];
        image::imageops::replace(&mut sheet, &picture, corner[0].into(), corner[1].into());
        println!("{}", name(file));
    }
    let target = folder.join("contact_sheet.png");
    let unwritable =
        |error: &dyn std::error::Error| format!("{} cannot be written ({error})", target.display());
    let out = std::fs::File::create(&target).map_err(|error| unwritable(&error))?;
    let encoder =
        PngEncoder::new_with_quality(BufWriter::new(out), CompressionType::Best, FilterType::Adaptive);
    sheet
        .write_with_encoder(encoder)
        .map_err(|error| unwritable(&error))
}

/// The scene files of `folder`, by name.
fn scene_files(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let unreadable = |error: std::io::Error| format!("{} cannot be read ({error})", folder.display());
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.extension().is_some_and(|e| e == "toml" || e == "gltf") {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

fn name(file: &Path) -> String {
    file.file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default()
}

/// The picture that `whit render` makes of a file at this size.
fn picture(file: &Path) -> Result<RgbImage, String> {
    let (scene, output) = load(file)?;
    let camera = scene.cameras.first().ok_or("it has no camera")?;
    let accel =
        accel::build(&scene, Backend::default(), &AccelOptions::default()).map_err(|e| e.to_string())?;
    let settings = RenderSettings {
        width: PICTURE[0],
        height: PICTURE[1],
        spp: SPP,
        depth: output.depth.unwrap_or(RenderSettings::default().depth),
        ..RenderSettings::default()
    };
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
    };
    let rendering = render::render(&scene, camera, &*accel, &settings, &monitor).ok_or("it was stopped")?;
    let tone = ToneMap {
        exposure_ev: output.exposure.unwrap_or(0.0),
    };
    RgbImage::from_raw(PICTURE[0], PICTURE[1], tone.srgb_bytes(&rendering.image))
        .ok_or("its size is wrong".into())
}

fn load(file: &Path) -> Result<(Scene, Output), String> {
    let options = LoadOptions::default();
    if file.extension().is_some_and(|e| e == "toml") {
        let loaded = scene_file::load(file, &options).map_err(|e| e.to_string())?;
        return Ok((loaded.scene, loaded.output));
    }
    let scene = gltf::load(file, &options).map_err(|e| e.to_string())?;
    Ok((scene, Output::default()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_readme_lists_every_scene_by_its_first_sentence() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let readme = std::fs::read_to_string(root.join("README.md")).unwrap();
        let files = scene_files(&root.join("scenes")).unwrap();
        assert!(files.len() > 16, "{files:?}");
        let mut last = 0;
        for file in &files {
            let row = format!("\n| [{0}](scenes/{0}) | ", name(file));
            let at = readme
                .find(&row)
                .unwrap_or_else(|| panic!("README.md lacks{row}"));
            assert!(at > last, "{} is out of order", name(file));
            last = at;
            if file.extension().is_some_and(|e| e == "toml") {
                let told = readme[at + row.len()..].split(" |").next().unwrap();
                assert_eq!(told, first_sentence(file));
            }
        }
    }

    /// What the file's opening comment says before it comes to the effects.
    fn first_sentence(file: &Path) -> String {
        let text = std::fs::read_to_string(file).unwrap();
        let lines = text.lines().skip_while(|line| line.starts_with("#:"));
        let comment: Vec<&str> = lines.map_while(|line| line.strip_prefix("# ")).collect();
        let whole = comment.join(" ");
        let (sentence, effects) = whole
            .split_once(" Effects: ")
            .expect("a comment that ends with effects");
        assert!(
            !sentence.is_empty() && effects.ends_with('.'),
            "{}: {whole}",
            file.display()
        );
        sentence.to_owned()
    }
}
