//! Flags of denoising.

use std::path::PathBuf;

use clap::Args as ArgGroup;

use whit::image::Denoiser;

use crate::cli::failure::Failure;

/// Flags of the denoising of images.
#[derive(Clone, Debug, Default, ArgGroup)]
pub(in crate::cli) struct DenoiseArgs {
    /// Denoise images by Open Image Denoise, guided by albedo and normals of first hits, if its library is installed
    #[arg(long)]
    pub(in crate::cli) denoise: bool,

    /// Open Image Denoise's library or its folder, as `pip install pyoidn` brings it [default: the system's]
    #[arg(long, value_name = "PATH")]
    pub(in crate::cli) oidn: Option<PathBuf>,
}

impl DenoiseArgs {
    /// Loads the denoiser if these flags or a settings file (`is_set`) request it.
    pub(in crate::cli) fn denoiser(&self, is_set: bool) -> Result<Option<Denoiser>, Failure> {
        if !self.denoise && !is_set {
            return match self.oidn {
                None => Ok(None),
                Some(_) => Err(Failure::Input(
                    "`--oidn` names a denoiser that nothing uses: give `--denoise`, too".into(),
                )),
            };
        }
        let loaded = Denoiser::load(self.oidn.as_deref());
        loaded
            .map(Some)
            .map_err(|error| Failure::Input(error.to_string()))
    }
}
