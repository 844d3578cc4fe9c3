//! Caustics: light that mirrors and refracting bodies throw onto diffuse surfaces, by a photon map.
//!
//! Before the first wave, lights emit photons towards the objects that reflect or refract sharply ([`emission`]). Photons
//! follow reflection and refraction as rays do, and are stored where they reach a diffuse surface ([`tracing`]). Each
//! spreads its power over a disc as wide as photons are sparse ([`photon_map`]), or an ellipse that is stretched as the
//! light is ([`photon_kernel`]), and every diffuse surface adds the light of
//! the discs that cover it ([`gather`]; H. W. Jensen, "Realistic Image Synthesis Using Photon Mapping", 2001). The discs
//! blur the image of the light a little, and less the more photons there are.
//!
//! No light counts twice. Photons bring the light of a light whose path was turned aside at least once on its way to a
//! diffuse surface. Shadow rays to that light then end at bodies that refract, where they pass straight without caustics,
//! and rays from diffuse surfaces that find it by a mirror add nothing. Light that passes thin walls and gaps straight
//! stays with shadow rays, and light of rough mirrors and rough glass with the rays into their lobes.
//!
//! Each process emits the same photons, numbered and with numbers of Owen-scrambled Sobol sequences, so images have the
//! same bits for any number of threads and any division into parts.

mod emission;
mod gather;
mod photon_kernel;
mod photon_map;
mod photon_tree;
mod source;
mod tracing;

pub(in crate::render) use photon_map::PhotonMap;
pub(in crate::render) use source::emits_photons;
