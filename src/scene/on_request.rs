//! Settings of the effects that are simulated only on request: interreflection and caustics.

/// Settings of a scene whose surfaces light each other diffusely.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interreflection {
    /// Largest number of diffuse surfaces that scatter the light of a path.
    pub bounces: u32,
}

impl Interreflection {
    /// Largest number of bounces that may be requested. Most paths in white rooms end long before.
    pub const MAX_BOUNCES: u32 = 256;

    /// Checks the number of bounces; the error is the end of a sentence.
    pub(super) fn check(&self) -> Result<(), String> {
        check_count("has", "bounces", self.bounces, Interreflection::MAX_BOUNCES)
    }
}

impl Default for Interreflection {
    /// Returns 16 bounces: of the light in a closed room whose surfaces reflect 80 %, 2 % are lost.
    fn default() -> Interreflection {
        Interreflection { bounces: 16 }
    }
}

/// Settings of caustics, the light that mirrors and refracting bodies throw onto diffuse surfaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Caustics {
    /// Number of photons that all lights emit together.
    pub photons: u32,
    /// Number of neighbours that the disc of a photon reaches: more blur caustics, and lower their noise.
    pub neighbours: u32,
}

impl Caustics {
    /// Largest number of photons that may be requested; they take about 110 bytes each.
    pub const MAX_PHOTONS: u32 = 1 << 24;
    /// Largest number of neighbours that may be requested.
    pub const MAX_NEIGHBOURS: u32 = 4096;

    /// Checks the numbers of photons and neighbours; the error is the end of a sentence.
    pub(super) fn check(&self) -> Result<(), String> {
        check_count("have", "photons", self.photons, Caustics::MAX_PHOTONS)?;
        check_count("have", "neighbours", self.neighbours, Caustics::MAX_NEIGHBOURS)
    }
}

impl Default for Caustics {
    /// Returns 2^18 photons, whose discs reach 32 neighbours.
    fn default() -> Caustics {
        Caustics {
            photons: 1 << 18,
            neighbours: 32,
        }
    }
}

fn check_count(verb: &str, what: &str, count: u32, allowed: u32) -> Result<(), String> {
    if (1..=allowed).contains(&count) {
        return Ok(());
    }
    Err(format!("{verb} {count} {what}: give 1 to {allowed}"))
}
