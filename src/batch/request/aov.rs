//! Further channels of an image file, requested with `--aov`.

use std::borrow::Cow;

use crate::image::ChannelKind;
use crate::render::{AovKind, Category, Layer, Rendering, SampleAovs};

/// Name of the channel of the coverage of pixels.
pub(in crate::batch) const ALPHA: &str = "A";

/// Groups of channels that an EXR image may hold besides its colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum AovGroup {
    /// `samples` and `variance`, the number of samples of a pixel and their variance
    Samples,
    /// `rays`, `rays.camera` and so on
    Rays,
    /// `time`, `time.camera` and so on, in nanoseconds
    Time,
    /// `Z`, the distance along the ray in the file's unit; infinite where nothing is hit
    Depth,
    /// `normal.X`, `.Y` and `.Z`, the shading normal in world space on the viewer's side
    Normal,
    /// `albedo.R`, `.G` and `.B`, the base colour with its textures, linear
    Albedo,
    /// `position.X`, `.Y` and `.Z`, in the file's coordinates
    Position,
    /// `uv.U` and `.V`, the first set of texture coordinates
    Uv,
    /// `id.object`, `id.material` and `id.primitive` of the first sample that hits anything; -1 where none does
    Ids,
    /// `motion.X` and `.Y`, the motion of surfaces to the right and down, in pixels, while the shutter is open
    Motion,
    /// `CryptoObject00.R` and so on: Cryptomatte of the names of objects, six ranks of id and coverage
    CryptoObject,
    /// `CryptoMaterial00.R` and so on: Cryptomatte of the names of materials
    CryptoMaterial,
    /// `light.NAME.R`, `.G` and `.B`, the contribution of each light; `light.emission.R` and so on, emission seen
    /// without one
    Lights,
    /// `effect.direct.R`, `effect.reflection.R` and so on, the radiance by the first step of the path from the camera
    Effects,
}

impl AovGroup {
    /// Returns the first-hit layer that this group stands for, or `None` for other groups.
    pub fn layers(self) -> Option<AovKind> {
        match self {
            AovGroup::Samples | AovGroup::Rays | AovGroup::Time | AovGroup::Lights | AovGroup::Effects => {
                None
            }
            AovGroup::Depth => Some(AovKind::Depth),
            AovGroup::Normal => Some(AovKind::Normal),
            AovGroup::Albedo => Some(AovKind::Albedo),
            AovGroup::Position => Some(AovKind::Position),
            AovGroup::Uv => Some(AovKind::Uv),
            AovGroup::Ids => Some(AovKind::Ids),
            AovGroup::Motion => Some(AovKind::Motion),
            AovGroup::CryptoObject => Some(AovKind::CryptoObject),
            AovGroup::CryptoMaterial => Some(AovKind::CryptoMaterial),
        }
    }
}

/// Returns the channels of an image besides its colours: its coverage, if it has one, and those that are requested.
pub fn channels<'r>(requested: &[AovGroup], rendering: &'r Rendering) -> Vec<Cow<'r, Layer>> {
    let mut channels: Vec<Layer> = rendering.alpha.iter().map(|alpha| alpha_layer(alpha)).collect();
    channels.extend(cost_channels(requested, rendering));
    channels.extend(rendering.aovs.clone().into_iter().flat_map(sample_layers));
    let made = channels.into_iter().map(Cow::Owned);
    made.chain(rendering.layers.iter().map(Cow::Borrowed)).collect()
}

/// Returns the channel of the coverage of pixels, which may be rounded like the colours that are premultiplied by it.
fn alpha_layer(alpha: &[f32]) -> Layer {
    Layer {
        name: ALPHA.into(),
        kind: ChannelKind::Color,
        values: alpha.to_vec(),
    }
}

/// Returns the requested channels of rays and nanoseconds: the total, and every category with values above zero.
fn cost_channels(requested: &[AovGroup], rendering: &Rendering) -> Vec<Layer> {
    let Some(costs) = &rendering.costs else {
        return Vec::new();
    };
    let mut channels = Vec::new();
    // Add the total, then every category that occurs
    let mut add = |name: &str, all: Vec<f32>, of: &dyn Fn(Category) -> Vec<f32>| {
        channels.push(exact(name, all));
        for account in Category::ALL {
            let values = of(account);
            if values.iter().any(|&value| value > 0.0) {
                channels.push(exact(&format!("{name}.{}", account.name()), values));
            }
        }
    };
    if requested.contains(&AovGroup::Rays) {
        add("rays", costs.all_rays(), &|account| costs.rays(account));
    }
    if requested.contains(&AovGroup::Time) {
        add("time", costs.all_nanoseconds(), &|account| {
            costs.nanoseconds(account)
        });
    }
    channels
}

/// Returns the channels of the number of samples and of their variance.
pub(in crate::batch) fn sample_layers(aovs: SampleAovs) -> [Layer; 2] {
    [exact("samples", aovs.samples), exact("variance", aovs.variance)]
}

/// Returns a channel that must not be rounded.
fn exact(name: &str, values: Vec<f32>) -> Layer {
    Layer {
        name: name.into(),
        kind: ChannelKind::Exact,
        values,
    }
}
