//! Renders scenes small and lays the pictures out as one sheet: every scene of `scenes`, four in a row, by the names of
//! the files; or the files that are named, three in a row, in the order given. Or a pair of pictures for each effect,
//! with and without it, by the lines of `scenes/effects.md`.
//!
//! ```text
//! cargo run --release --example contact-sheet
//! cargo run --release --example contact-sheet -- --effects
//! cargo run --release --example contact-sheet -- --out sheet.png a.glb b.gltf c.toml
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
use whit::scene::picture::{DEFAULT_DEPTH, DEFAULT_WAVELENGTHS};
use whit::scene::{EffectOverrides, Scene};
use whit::scene_file::{self, Output};

/// How pictures are laid out.
struct Layout {
    /// Pixels of a picture.
    picture: [u32; 2],
    /// Pictures in a row.
    columns: u32,
}

/// Many pictures.
const OVERVIEW: Layout = Layout {
    picture: [320, 240],
    columns: 4,
};
/// Few pictures, large enough to be looked at.
const CLOSE: Layout = Layout {
    picture: [400, 300],
    columns: 3,
};
/// An effect's scene with it, and without it.
const PAIR: Layout = Layout {
    picture: [104, 78],
    columns: 2,
};
/// Pixels between pictures.
const GAP: u32 = 4;
/// Samples a pixel: small pictures show their edges.
const SPP: u32 = 16;

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(sentence) => {
            eprintln!("{sentence}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), String> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    match &arguments[..] {
        [] => {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
            sheet(
                &scene_files(&folder)?,
                &OVERVIEW,
                &folder.join("contact_sheet.png"),
            )
        }
        [flag, target, files @ ..] if flag == Path::new("--out") && !files.is_empty() => {
            sheet(files, &CLOSE, target)
        }
        [flag] if flag == Path::new("--effects") => {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
            effect_pairs(&folder)
        }
        _ => Err("give nothing, `--effects`, or `--out FILE` and the scenes that are to be on it".into()),
    }
}

/// Renders the scenes, prints their names in order, and writes the sheet.
fn sheet(files: &[PathBuf], layout: &Layout, target: &Path) -> Result<(), String> {
    let rendered = |file: &PathBuf| {
        let picture = picture(file, layout.picture, EffectOverrides::default());
        println!("{}", name(file));
        picture.map_err(|sentence| format!("{}: {sentence}", file.display()))
    };
    let pictures: Vec<RgbImage> = files.iter().map(rendered).collect::<Result<_, _>>()?;
    write_sheet(&pictures, layout, target)
}

/// A line of `effects.md`: the effect's name, its picture and its scene.
struct EffectRow {
    name: String,
    picture: PathBuf,
    scene: PathBuf,
}

/// The lines of `effects.md` in `folder`.
fn effect_rows(folder: &Path) -> Result<Vec<EffectRow>, String> {
    let path = folder.join("effects.md");
    let text =
        std::fs::read_to_string(&path).map_err(|e| format!("{} cannot be read ({e})", path.display()))?;
    let link = |cell: &str| Some(folder.join(cell.rsplit_once("](")?.1.trim_end_matches([')', ' '])));
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(" | ").collect();
        let [picture, effect, _, _, scene] = cells[..] else {
            return None;
        };
        Some(EffectRow {
            name: effect.strip_prefix('`')?.strip_suffix('`')?.to_owned(),
            picture: link(picture)?,
            scene: link(scene.trim_end_matches(" |"))?,
        })
    };
    Ok(text.lines().filter_map(row).collect())
}

/// Writes a pair of pictures for each effect.
fn effect_pairs(folder: &Path) -> Result<(), String> {
    for row in effect_rows(folder)? {
        let without: EffectOverrides = format!("-{}", row.name).parse()?;
        let pictures: Vec<RgbImage> = [EffectOverrides::default(), without]
            .into_iter()
            .map(|effects| picture(&row.scene, PAIR.picture, effects))
            .collect::<Result<_, _>>()
            .map_err(|sentence| format!("{}: {sentence}", row.scene.display()))?;
        write_sheet(&pictures, &PAIR, &row.picture)?;
        println!("{}", row.name);
    }
    Ok(())
}

/// Lays pictures out in rows.
fn write_sheet(pictures: &[RgbImage], layout: &Layout, target: &Path) -> Result<(), String> {
    let ([width, height], columns) = (layout.picture, layout.columns);
    let rows = (pictures.len() as u32).div_ceil(columns);
    let mut sheet = RgbImage::from_pixel(
        columns * (width + GAP) - GAP,
        rows * (height + GAP) - GAP,
        image::Rgb([255; 3]),
    );
    for (number, picture) in (0..).zip(pictures) {
        let corner = [
            (number % columns) * (width + GAP),
            (number / columns) * (height + GAP),
        ];
        image::imageops::replace(&mut sheet, picture, corner[0].into(), corner[1].into());
    }
    let unwritable =
        |error: &dyn std::error::Error| format!("{} cannot be written ({error})", target.display());
    let out = std::fs::File::create(target).map_err(|error| unwritable(&error))?;
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
        let is_job_file = path.to_string_lossy().ends_with(".jobs.toml");
        if !is_job_file && path.extension().is_some_and(|e| e == "toml" || e == "gltf") {
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

/// The picture that `whit render` makes of a file at this size, with these effects other than it calls for.
fn picture(file: &Path, [width, height]: [u32; 2], effects: EffectOverrides) -> Result<RgbImage, String> {
    let (scene, output) = load(file)?;
    let camera = scene.cameras.first().ok_or("it has no camera")?;
    let accel =
        accel::build(&scene, Backend::default(), &AccelOptions::default()).map_err(|e| e.to_string())?;
    let settings = RenderSettings {
        width,
        height,
        spp: SPP,
        depth: output.depth.unwrap_or(DEFAULT_DEPTH),
        wavelengths: output.wavelengths.unwrap_or(DEFAULT_WAVELENGTHS),
        effects,
        ..RenderSettings::default()
    };
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
        tiles: None,
    };
    let rendering = render::render(&scene, camera, &*accel, &settings, &monitor).ok_or("it was stopped")?;
    let tone = ToneMap {
        exposure_ev: output.exposure.unwrap_or(0.0),
    };
    RgbImage::from_raw(width, height, tone.srgb_bytes(&rendering.image)).ok_or("its size is wrong".into())
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
    use whit::render::Plan;
    use whit::scene::Effect;

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

    #[test]
    fn every_effect_has_a_line_with_a_small_picture_and_a_scene_that_calls_for_it() {
        const MOST_BYTES: u64 = 600_000;
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
        let rows = effect_rows(&folder).unwrap();
        let names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
        assert_eq!(names, Effect::ALL.map(Effect::name));
        let mut bytes = 0;
        for (row, effect) in rows.iter().zip(Effect::ALL) {
            bytes += std::fs::metadata(&row.picture).unwrap().len();
            let [width, height] = PAIR.picture;
            let size = image::image_dimensions(&row.picture).unwrap();
            assert_eq!(size, (2 * width + GAP, height), "{effect}");
            let (scene, _) = load(&row.scene).unwrap();
            let plan = Plan::new(&scene, &scene.cameras[0], &EffectOverrides::default());
            assert!(plan.effects().has(effect), "{effect}: {}", row.scene.display());
        }
        assert!(bytes < MOST_BYTES, "{bytes}");
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
