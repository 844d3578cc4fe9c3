//! Numbers of samples of an image, and sample statistics of its pixels.

use super::pixel_statistics::PixelStatistics;

/// Numbers of samples in an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct SampleCounts {
    /// Sum over all pixels.
    pub total: u64,
    /// Mean number per pixel.
    pub mean: f64,
    /// Largest number in a pixel.
    pub max: u32,
}

impl SampleCounts {
    pub(in crate::render) fn uniform(pixel_count: u64, spp: u32) -> SampleCounts {
        SampleCounts {
            total: pixel_count * u64::from(spp),
            mean: f64::from(spp),
            max: spp,
        }
    }

    /// Returns the numbers of samples in an image of which `edge_count` pixels have `spp` samples and all others one.
    pub(in crate::render) fn of_edges(pixel_count: u64, edge_count: u64, spp: u32) -> SampleCounts {
        let total = pixel_count - edge_count + edge_count * u64::from(spp);
        SampleCounts {
            total,
            mean: total as f64 / pixel_count as f64,
            max: if edge_count > 0 { spp } else { 1 },
        }
    }

    pub(in crate::render) fn of(estimates: &[PixelStatistics]) -> SampleCounts {
        let counts = || estimates.iter().map(|estimate| estimate.count);
        let total = counts().map(u64::from).sum();
        SampleCounts {
            total,
            mean: total as f64 / estimates.len() as f64,
            max: counts().max().unwrap_or(0),
        }
    }
}

/// Sample statistics of each pixel, row by row from the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SampleAovs {
    /// Number of samples; integers.
    pub samples: Vec<f32>,
    /// Variance of the samples' linear radiance about their mean, channels weighted by Rec. 709 luminance; 0 for a
    /// single sample. The variance of the pixel would be smaller by the number of samples if these were independent,
    /// and is smaller still because they are stratified.
    pub variance: Vec<f32>,
}

impl SampleAovs {
    pub(in crate::render) fn of(estimates: &[PixelStatistics]) -> SampleAovs {
        SampleAovs {
            samples: estimates.iter().map(|e| e.count as f32).collect(),
            variance: estimates.iter().map(|e| e.variance() as f32).collect(),
        }
    }
}
