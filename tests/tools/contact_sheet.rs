//! The subcommand `contact-sheet`: renders scenes at a small size and lays the images out on one sheet.
//!
//! Without arguments every scene of `scenes`, four in a row, in the order of the files' names; with `--out` the files
//! that are named, eight in a row, in the order given; with `--effects` a pair of images for each effect, with and
//! without it, by the table of `scenes/effects.md`.

use std::io::BufWriter;
use std::path::{Path, PathBuf};

use image::RgbImage;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use whit::accel::{self, AccelOptions, Backend};
use whit::gltf::{self, LoadOptions};
use whit::image::ToneMap;
use whit::render::{self, Monitor, RenderSettings};
use whit::scene::image_settings::{DEFAULT_DEPTH, DEFAULT_WAVELENGTHS};
use whit::scene::{EffectOverrides, Scene};
use whit::scene_file::{self, Output};

/// Arguments of `contact-sheet`.
#[derive(clap::Args)]
#[command(after_long_help = "\
Without arguments every scene of the folder scenes is rendered, and scenes/contact_sheet.png is written.

Examples:
  cargo run --release --example tools -- contact-sheet
  cargo run --release --example tools -- contact-sheet --effects
  cargo run --release --example tools -- contact-sheet --out sheet.png a.glb b.gltf c.toml")]
pub(crate) struct Arguments {
    /// Write the images of scenes/effects.md instead: each effect's scene with and without the effect
    #[arg(long, conflicts_with_all = ["out", "scenes"])]
    effects: bool,

    /// Write a sheet of the named scenes into this PNG file instead
    #[arg(long, value_name = "FILE", requires = "scenes")]
    out: Option<PathBuf>,

    /// The scenes on that sheet, in this order
    #[arg(value_name = "SCENE", requires = "out")]
    scenes: Vec<PathBuf>,
}

/// Size and arrangement of the images on a sheet.
struct Layout {
    /// Width and height of an image in pixels.
    image: [u32; 2],
    /// Images in a row.
    columns: u32,
}

/// Layout of the sheet of all scenes.
const ALL_SCENES: Layout = Layout {
    image: [320, 240],
    columns: 4,
};
/// Layout of a sheet of named scenes, which may be many: as wide as a screen.
const NAMED_SCENES: Layout = Layout {
    image: [240, 180],
    columns: 8,
};
/// Layout of an effect's scene with the effect and without it.
const EFFECT_PAIR: Layout = Layout {
    image: [104, 78],
    columns: 2,
};
/// Pixels between images.
const GAP: u32 = 4;
/// Samples per pixel: enough for smooth edges, which small images show. Scenes with interreflection take their own.
const SPP: u32 = 16;

/// Writes the sheet or the pairs that the arguments ask for.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    if let Some(target) = &arguments.out {
        return sheet(&arguments.scenes, &NAMED_SCENES, target);
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    if arguments.effects {
        return effect_pairs(&folder);
    }
    let target = folder.join("contact_sheet.png");
    sheet(&scene_files(&folder)?, &ALL_SCENES, &target)
}

/// Renders the scenes, prints their names in order, and writes the sheet.
fn sheet(files: &[PathBuf], layout: &Layout, target: &Path) -> Result<(), String> {
    let rendered = |file: &PathBuf| {
        let image = render_file(file, layout.image, EffectOverrides::default());
        println!("{}", name(file));
        image.map_err(|sentence| format!("{}: {sentence}", file.display()))
    };
    let images: Vec<RgbImage> = files.iter().map(rendered).collect::<Result<_, _>>()?;
    write_sheet(&images, layout, target)
}

/// Row of the table in `effects.md`: the effect's name, the path of its image and that of its scene.
struct EffectRow {
    name: String,
    image: PathBuf,
    scene: PathBuf,
}

/// Reads the table of `effects.md` in `folder`.
fn effect_rows(folder: &Path) -> Result<Vec<EffectRow>, String> {
    let path = folder.join("effects.md");
    let text =
        std::fs::read_to_string(&path).map_err(|e| format!("{} cannot be read ({e})", path.display()))?;
    let link = |cell: &str| Some(folder.join(cell.rsplit_once("](")?.1.trim_end_matches([')', ' '])));
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(" | ").collect();
        let [image, effect, _, _, scene] = cells[..] else {
            return None;
        };
        Some(EffectRow {
            name: effect.strip_prefix('`')?.strip_suffix('`')?.to_owned(),
            image: link(image)?,
            scene: link(scene.trim_end_matches(" |"))?,
        })
    };
    Ok(text.lines().filter_map(row).collect())
}

/// Writes a pair of images for each effect and prints the effect's name.
fn effect_pairs(folder: &Path) -> Result<(), String> {
    for row in effect_rows(folder)? {
        let without: EffectOverrides = format!("-{}", row.name).parse()?;
        let images: Vec<RgbImage> = [EffectOverrides::default(), without]
            .into_iter()
            .map(|effects| render_file(&row.scene, EFFECT_PAIR.image, effects))
            .collect::<Result<_, _>>()
            .map_err(|sentence| format!("{}: {sentence}", row.scene.display()))?;
        write_sheet(&images, &EFFECT_PAIR, &row.image)?;
        println!("{}", row.name);
    }
    Ok(())
}

/// Lays images out in rows and writes them as one PNG.
fn write_sheet(images: &[RgbImage], layout: &Layout, target: &Path) -> Result<(), String> {
    let ([width, height], columns) = (layout.image, layout.columns);
    let rows = (images.len() as u32).div_ceil(columns);
    let mut sheet = RgbImage::from_pixel(
        columns * (width + GAP) - GAP,
        rows * (height + GAP) - GAP,
        image::Rgb([255; 3]),
    );
    for (number, image) in (0..).zip(images) {
        let corner = [
            (number % columns) * (width + GAP),
            (number / columns) * (height + GAP),
        ];
        image::imageops::replace(&mut sheet, image, corner[0].into(), corner[1].into());
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

/// Returns the scene files of `folder`, sorted by name.
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

/// Returns the name of a file without its folder.
fn name(file: &Path) -> String {
    file.file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default()
}

/// Returns the image that `whit render` makes of a file at this size with these effect overrides.
fn render_file(file: &Path, [width, height]: [u32; 2], effects: EffectOverrides) -> Result<RgbImage, String> {
    let (scene, output) = load(file)?;
    let camera = scene.cameras.first().ok_or("it has no camera")?;
    let accel = accel::build(
        scene.validate().unwrap(),
        Backend::default(),
        &AccelOptions::default(),
    )
    .map_err(|e| e.to_string())?;
    let own_spp = output.spp.filter(|_| scene.interreflection.is_some());
    let settings = RenderSettings {
        width,
        height,
        spp: own_spp.unwrap_or(SPP),
        depth: output.depth.unwrap_or(DEFAULT_DEPTH),
        wavelengths: output.wavelengths.unwrap_or(DEFAULT_WAVELENGTHS),
        effects,
        ..RenderSettings::default()
    };
    let monitor = Monitor::default();
    let rendering = render::render(scene.validate().unwrap(), camera, &*accel, &settings, &monitor)
        .map_err(|e| e.to_string())?;
    let tone = ToneMap {
        exposure_ev: output.exposure.unwrap_or(0.0),
    };
    RgbImage::from_raw(width, height, tone.srgb_bytes(&rendering.image)).ok_or("its size is wrong".into())
}

/// Loads a scene file or a glTF file.
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
    fn the_readme_of_scenes_lists_each_by_its_first_sentence() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let readme = std::fs::read_to_string(root.join("scenes/README.md")).unwrap();
        let files = scene_files(&root.join("scenes")).unwrap();
        assert!(files.len() > 16, "{files:?}");
        let mut last = 0;
        for file in &files {
            let row = format!("\n| [{0}]({0}) | ", name(file));
            let at = readme
                .find(&row)
                .unwrap_or_else(|| panic!("scenes/README.md lacks the row{row}"));
            assert!(at > last, "{} is out of order", name(file));
            last = at;
            if file.extension().is_some_and(|e| e == "toml") {
                let description = readme[at + row.len()..].split(" |").next().unwrap();
                assert_eq!(description, first_sentence(file));
            }
        }
    }

    #[test]
    fn every_effect_has_a_row_with_a_small_image_and_a_scene_that_uses_it() {
        const MAX_BYTES: u64 = 600_000;
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
        let rows = effect_rows(&folder).unwrap();
        let names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
        assert_eq!(names, Effect::ALL.map(Effect::name));
        let mut bytes = 0;
        for (row, effect) in rows.iter().zip(Effect::ALL) {
            bytes += std::fs::metadata(&row.image).unwrap().len();
            let [width, height] = EFFECT_PAIR.image;
            let size = image::image_dimensions(&row.image).unwrap();
            assert_eq!(size, (2 * width + GAP, height), "{effect}");
            let (scene, _) = load(&row.scene).unwrap();
            let plan = Plan::new(&scene, &scene.cameras[0], &EffectOverrides::default());
            assert!(plan.effects().has(effect), "{effect}: {}", row.scene.display());
        }
        assert!(bytes < MAX_BYTES, "{bytes}");
    }

    /// Returns the opening comment of the file up to its list of effects.
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
