//! Phong lighting: `Il (rd (s.m) + rsp (r.v)^f)`, clamped, for packets of sixteen points.
//!
//! `s` points to the light, `m` is the normal, `v` points to the viewer and `r` is `s` mirrored at the normal. Both
//! products are clamped at zero, and the highlight is zero unless the light is above the surface.

use super::material::MaterialPacket;
use crate::numeric::{LANES, Lanes3};

/// Returns the reflected radiance per unit of incident intensity; zero in lanes of other models.
#[inline(always)]
pub fn phong_direct(
    material: &MaterialPacket,
    ns: &Lanes3<f32>,
    wo: &Lanes3<f32>,
    wi: &Lanes3<f32>,
) -> Lanes3<f32> {
    let extended = &material.extended;
    let mut reflected = [[0.0; LANES]; 3];
    for l in 0..LANES {
        let dot =
            |a: &Lanes3<f32>, b: &Lanes3<f32>| a[0][l] * b[0][l] + a[1][l] * b[1][l] + a[2][l] * b[2][l];
        let s_dot_m = dot(wi, ns);
        let r_dot_v = 2.0 * s_dot_m * dot(ns, wo) - dot(wi, wo);
        let lit = extended.is_phong[l] & (s_dot_m > 0.0);
        let is_specular =
            extended.specular_color[0][l] + extended.specular_color[1][l] + extended.specular_color[2][l]
                > 0.0;
        // `powf` is a function call: skip it where the specular colour is black.
        let highlight = if lit & is_specular & (r_dot_v > 0.0) {
            r_dot_v.min(1.0).powf(extended.exponent[l])
        } else {
            0.0
        };
        for channel in 0..3 {
            let diffuse = extended.diffuse[channel][l] * material.base_color[channel][l] * s_dot_m;
            let value = diffuse + extended.specular_color[channel][l] * highlight;
            reflected[channel][l] = if lit { value } else { 0.0 };
        }
    }
    reflected
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{EffectSet, Material, Model, Phong};

    fn lanes3(v: [f32; 3]) -> Lanes3<f32> {
        v.map(|axis| [axis; LANES])
    }

    fn specular_packet(exponent: f32) -> MaterialPacket {
        let mut packet = MaterialPacket::BLACK;
        packet.effects = EffectSet::ALL;
        let material = Material {
            model: Model::Phong(Phong {
                diffuse: [0.5; 3],
                specular: [0.25, 0.5, 1.0],
                exponent,
                ..Phong::DEFAULT
            }),
            base_color: [1.0, 0.5, 0.25, 1.0],
            ..Material::default()
        };
        packet.fill(&material);
        packet
    }

    #[test]
    fn diffuse_and_highlight_match_the_phong_formula() {
        let up = lanes3([0.0, 0.0, 1.0]);
        // Light and viewer on opposite sides at cosine 0.8: r = v, so r.v = 1.
        let out = phong_direct(
            &specular_packet(10.0),
            &up,
            &lanes3([0.6, 0.0, 0.8]),
            &lanes3([-0.6, 0.0, 0.8]),
        );
        // rd base (s.m) + rsp = 0.5 * {1, 0.5, 0.25} * 0.8 + {0.25, 0.5, 1}.
        for (channel, expected) in [0.65f32, 0.7, 1.1].into_iter().enumerate() {
            assert!((out[channel][3] - expected).abs() < 1e-6);
        }
        // Viewer along the normal: r.v = 0.8, squared 0.64.
        let out = phong_direct(&specular_packet(2.0), &up, &up, &lanes3([-0.6, 0.0, 0.8]));
        assert!((out[2][0] - (0.1 + 0.64)).abs() < 1e-6);
    }

    #[test]
    fn a_light_behind_the_surface_gives_neither() {
        let up = lanes3([0.0, 0.0, 1.0]);
        let behind = lanes3([0.0, 0.0, -1.0]);
        assert_eq!(
            phong_direct(&specular_packet(1.0), &up, &up, &behind),
            [[0.0; LANES]; 3]
        );
    }
}
