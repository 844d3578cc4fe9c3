//! Further channels of an image file, requested with `--aov`.

use std::borrow::Cow;

use whit::image::ChannelKind;
use whit::render::{AovKind, Category, Layer, Rendering};

use super::args::Aov;
use super::job::RenderJob;

impl Aov {
    /// Returns the first-hit layer that this group stands for, or `None` for other groups.
    pub(super) fn layers(self) -> Option<AovKind> {
        match self {
            Aov::Samples | Aov::Rays | Aov::Time | Aov::Lights | Aov::Effects => None,
            Aov::Depth => Some(AovKind::Depth),
            Aov::Normal => Some(AovKind::Normal),
            Aov::Albedo => Some(AovKind::Albedo),
            Aov::Position => Some(AovKind::Position),
            Aov::Uv => Some(AovKind::Uv),
            Aov::Ids => Some(AovKind::Ids),
            Aov::Motion => Some(AovKind::Motion),
            Aov::CryptoObject => Some(AovKind::CryptoObject),
            Aov::CryptoMaterial => Some(AovKind::CryptoMaterial),
        }
    }
}

/// Returns the requested channels besides the colours.
pub(super) fn channels<'r>(job: &RenderJob, rendering: &'r Rendering) -> Vec<Cow<'r, Layer>> {
    let mut channels = cost_channels(job, rendering);
    if let Some(aovs) = &rendering.aovs {
        channels.push(exact("samples", aovs.samples.clone()));
        channels.push(exact("variance", aovs.variance.clone()));
    }
    let made = channels.into_iter().map(Cow::Owned);
    made.chain(rendering.layers.iter().map(Cow::Borrowed)).collect()
}

/// Returns the requested channels of rays and nanoseconds: the total, and every category with values above zero.
fn cost_channels(job: &RenderJob, rendering: &Rendering) -> Vec<Layer> {
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
    if job.aovs.contains(&Aov::Rays) {
        add("rays", costs.all_rays(), &|account| costs.rays(account));
    }
    if job.aovs.contains(&Aov::Time) {
        add("time", costs.all_nanoseconds(), &|account| {
            costs.nanoseconds(account)
        });
    }
    channels
}

/// Returns a channel that must not be rounded.
fn exact(name: &str, values: Vec<f32>) -> Layer {
    Layer {
        name: name.into(),
        kind: ChannelKind::Exact,
        values,
    }
}
