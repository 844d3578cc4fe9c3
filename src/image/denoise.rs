//! Denoising of finished images by Intel's Open Image Denoise (OIDN), where its library is installed.
//!
//! The library is opened at run time, so that neither the build nor the program depends on it. It is trained on path
//! tracers: it removes noise of few samples, and blurs detail that neither the image nor its guides hold. Pixels remain
//! linear radiance.

mod oidn;

use std::path::{Path, PathBuf};

use super::LinearImage;
use oidn::{OidnDevice, OidnLibrary};

/// Names under which the system's loader finds the library, by preference.
const NAMES: [&str; 2] = ["libOpenImageDenoise.so.2", "libOpenImageDenoise.so"];

/// Open Image Denoise's library, ready to denoise images.
#[derive(Clone, Debug)]
pub struct Denoiser {
    functions: OidnLibrary,
    version: [i32; 3],
}

/// Images of the first hits that guide a denoiser: they show edges and textures without noise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DenoiseGuides {
    /// Base colour from 0 to 1, black where nothing is hit; one value for each pixel.
    pub albedo: Vec<[f32; 3]>,
    /// Shading normals, zero where nothing is hit; one for each pixel.
    pub normal: Vec<[f32; 3]>,
}

/// Reasons for which an image cannot be denoised.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DenoiseError {
    /// Library that is not there, or is no version 2 of Open Image Denoise.
    #[error(
        "Open Image Denoise 2 cannot be loaded: {reason}: install it, for instance by `pip install pyoidn`, and give the \
         folder of libOpenImageDenoise.so.2 as `--oidn`"
    )]
    Library {
        /// Reason in the words of the loader.
        reason: String,
    },
    /// Failure of the library itself.
    #[error("Open Image Denoise failed: {0}")]
    Failed(String),
}

impl Denoiser {
    /// Loads the library from a file or a folder, or from where the system's loader finds it.
    ///
    /// # Errors
    ///
    /// If there is no library, it lacks a function, or it does not support this processor.
    pub fn load(path: Option<&Path>) -> Result<Denoiser, DenoiseError> {
        // List the files that may be the library
        let files: Vec<PathBuf> = match path {
            Some(path) if path.is_dir() => NAMES.iter().map(|name| path.join(name)).collect(),
            Some(path) => vec![path.to_owned()],
            None => NAMES.iter().map(PathBuf::from).collect(),
        };
        // Load the first that can be loaded; the first one's error is that of the preferred name
        let mut error = None;
        for file in &files {
            match OidnLibrary::load(file) {
                Ok(functions) => {
                    let version = OidnDevice::new(&functions, 1)?.version();
                    return Ok(Denoiser { functions, version });
                }
                Err(reason) => error = error.or(Some(reason)),
            }
        }
        Err(DenoiseError::Library {
            reason: error.unwrap_or_default(),
        })
    }

    /// Returns the name and the version of the library, for notes in images.
    pub fn name(&self) -> String {
        let [major, minor, patch] = self.version;
        format!("Open Image Denoise {major}.{minor}.{patch}")
    }

    /// Denoises `image` in place on the threads of the current pool; guides of another size are an error.
    ///
    /// # Errors
    ///
    /// If the library reports one, for instance that memory does not suffice. The image is then unchanged.
    pub fn denoise(
        &self,
        image: &mut LinearImage,
        guides: Option<&DenoiseGuides>,
    ) -> Result<(), DenoiseError> {
        let size = [image.width as usize, image.height as usize];
        let count = size[0] * size[1];
        if let Some(guides) = guides
            && (guides.albedo.len() != count || guides.normal.len() != count)
        {
            return Err(DenoiseError::Failed(
                "the guides have another size than the image".into(),
            ));
        }
        let device = OidnDevice::new(&self.functions, rayon::current_num_threads())?;
        let mut denoised = vec![[0.0f32; 3]; count];
        device.filter(size, &image.pixels, guides, &mut denoised)?;
        image.pixels = denoised;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_library_is_named_with_a_remedy() {
        for path in ["/no/such/folder/lib.so", "/"] {
            let error = Denoiser::load(Some(Path::new(path))).unwrap_err().to_string();
            assert!(
                error.contains("pip install pyoidn") && error.contains("OpenImageDenoise"),
                "{error}"
            );
        }
        // A file that is no library
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml");
        assert!(Denoiser::load(Some(&file)).is_err());
    }
}
