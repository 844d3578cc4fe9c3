//! Channels of a picture file beside its colours: what was asked for with `--aov`, by name.

use crate::render::{Account, Rendering};

use super::args::Aov;
use super::job::RenderJob;

/// The channels that were asked for beside the colours.
pub(super) fn channels(job: &RenderJob, rendering: &Rendering) -> Vec<(String, Vec<f32>)> {
    let mut channels = cost_channels(job, rendering);
    if let Some(aovs) = &rendering.aovs {
        channels.push(("samples".into(), aovs.samples.clone()));
        channels.push(("variance".into(), aovs.variance.clone()));
    }
    channels
}

/// The channels of rays and of nanoseconds that were asked for: all together, and each account that has any.
fn cost_channels(job: &RenderJob, rendering: &Rendering) -> Vec<(String, Vec<f32>)> {
    let Some(costs) = &rendering.costs else {
        return Vec::new();
    };
    let mut channels = Vec::new();
    let mut add = |name: &str, all: Vec<f32>, of: &dyn Fn(Account) -> Vec<f32>| {
        channels.push((name.to_owned(), all));
        for account in Account::ALL {
            let values = of(account);
            if values.iter().any(|&value| value > 0.0) {
                channels.push((format!("{name}.{}", account.name()), values));
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
