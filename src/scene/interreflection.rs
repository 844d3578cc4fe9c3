//! Settings of interreflection, the diffuse light from surfaces to other surfaces.

/// Settings of a scene whose surfaces light each other diffusely.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interreflection {
    /// Largest number of diffuse surfaces that scatter the light of a path.
    pub bounces: u32,
}

impl Interreflection {
    /// Largest number of bounces that may be requested. Most paths in white rooms end long before.
    pub const MAX_BOUNCES: u32 = 256;
}

impl Default for Interreflection {
    /// Returns 16 bounces: of the light in a closed room whose surfaces reflect 80 %, 2 % are lost.
    fn default() -> Interreflection {
        Interreflection { bounces: 16 }
    }
}
