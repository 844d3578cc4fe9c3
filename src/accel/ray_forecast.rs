//! Expected rays of a render, on which the choice of a backend depends.

/// Expected numbers of a render's rays, by what a backend can make of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayForecast {
    /// Camera rays from one point.
    pub from_point: f64,
    /// Shadow rays to one point or in one direction, from neighbouring points of the first surface.
    pub to_end: f64,
    /// Other rays with coherent neighbours: camera rays through a lens, and shadow rays from the first surface to an
    /// area.
    pub coherent: f64,
    /// Rays after a bounce, with their shadow rays, and shadow rays to an environment.
    pub incoherent: f64,
}

impl Default for RayForecast {
    /// Returns the rays of an image of a million pixels with a sample and a light each.
    fn default() -> RayForecast {
        RayForecast {
            from_point: 1e6,
            to_end: 1e6,
            coherent: 0.0,
            incoherent: 0.0,
        }
    }
}
