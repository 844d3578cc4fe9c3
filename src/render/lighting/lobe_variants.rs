//! Materials without the lobes that secondary rays sample.

use std::cell::OnceCell;

use crate::numeric::{LANES, Lanes};
use crate::scene::MIRROR_ROUGHNESS;
use crate::shading::MaterialPacket;

/// Materials of sixteen surfaces for lights that rays can hit; each is computed on its first use.
#[derive(Default)]
pub(in crate::render) struct LobeVariants {
    pub(super) without: OnceCell<MaterialPacket>,
    pub(super) shared: OnceCell<SharedLobes>,
}

/// Materials whose lobes light samples share with lobe rays.
pub(super) struct SharedLobes {
    /// Materials without the lobes that secondary rays sample alone.
    pub(super) materials: MaterialPacket,
    /// Numbers of rays into the lobes; 0 where a surface sends none.
    pub(super) counts: Lanes<f32>,
}

/// Returns the materials for lights that rays can hit: without a specular lobe where a mirror ray or lobe rays sample
/// it, and without the highlight where the Phong model has a reflected ray.
pub(super) fn without_sampled_lobes(materials: &MaterialPacket) -> MaterialPacket {
    let mut without = materials.clone();
    for l in 0..LANES {
        // Mirror rays or lobe rays sample this lobe
        if materials.roughness[l] <= MIRROR_ROUGHNESS || materials.has_lobe(l) {
            without.roughness[l] = 0.0;
        }
        let extended = &mut without.extended;
        // The reflected ray of the Phong model samples its highlight
        if extended.is_phong[l] && (0..3).any(|c| extended.reflection[c][l] != 0.0) {
            (0..3).for_each(|c| extended.specular_color[c][l] = 0.0);
        }
    }
    without
}
