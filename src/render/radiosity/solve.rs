//! Steps of a radiosity solution: rays, visible parts, and three solutions.

use super::super::context::RenderContext;
use super::super::monitor::{Cancelled, Monitor};
use super::super::settings::RenderSettings;
use super::bake::white;
use super::elements::ElementScene;
use super::gather;
use super::result::{RadiosityReport, RadiositySolution, SideLight};
use super::settings::RadiositySettings;
use super::transport::{RaySet, Transport};
use crate::accel::Accel;
use crate::scene::{Camera, Effect, EffectOverrides, EffectSet, ValidScene};

/// Tolerance of the solution that finds sides without light: they lack nearly all of it.
const ROUGH_TOLERANCE: f64 = 0.05;

/// Solves for the diffuse light on all elements, in the current rayon pool. `scene` is that of `elements`, and `accel` must
/// have been built from it.
pub fn solve(
    elements: &ElementScene,
    scene: ValidScene,
    accel: &dyn Accel,
    settings: &RadiositySettings,
    monitor: &Monitor,
) -> Result<RadiositySolution, Cancelled> {
    // Prepare lights and materials, for flat elements
    let without = [
        Effect::NormalMap,
        Effect::SmoothNormals,
        Effect::Caustics,
        Effect::DepthOfField,
        Effect::MotionBlur,
    ];
    let render_settings = RenderSettings {
        effects: EffectOverrides {
            added: EffectSet::NONE.with(Effect::Interreflection),
            removed: without.into_iter().fold(EffectSet::NONE, EffectSet::with),
        },
        ..RenderSettings::default()
    };
    let frame = RenderContext::new(scene.get(), &Camera::default(), accel, &render_settings);
    // Trace all rays, and leave out those inside of solids
    let gathered = gather::gather(&frame, elements, settings.ray_count(), monitor)?;
    let mut transport = Transport::new(elements, gathered);
    let rough = RadiositySettings {
        tolerance: settings.tolerance.max(ROUGH_TOLERANCE),
        ..*settings
    };
    let first = transport.solve(RaySet::All, &rough, monitor)?;
    transport.find_unlit(&first);
    // Solve with all rays and with each half
    let solved = transport.solve(RaySet::All, settings, monitor)?;
    let one = transport.solve(RaySet::Half(0), settings, monitor)?;
    let other = transport.solve(RaySet::Half(1), settings, monitor)?;
    // Add the emission that lights represent
    let side_light = |side: usize| {
        let source = transport.source(side);
        let own = if source.is_sampled {
            source.emission
        } else {
            [0.0; 3]
        };
        SideLight {
            radiance: [0, 1, 2].map(|c| solved.radiance[side][c] + own[c]),
            gathered: solved.gathered[side],
            albedo: source.albedo,
            is_emissive: source.emission != [0.0; 3],
            visible: transport.visible_fraction(side, RaySet::All) as f32,
        }
    };
    let sides: Vec<SideLight> = (0..solved.radiance.len()).map(side_light).collect();
    let white = white(elements, &sides);
    Ok(RadiositySolution {
        sides,
        report: RadiosityReport {
            elements: elements.elements().len(),
            rays: settings.ray_count(),
            sweeps: solved.sweeps,
            remaining: solved.remaining,
            has_converged: solved.remaining <= settings.tolerance,
            sampling_error: transport.sampling_error([&one, &other], white),
            energy: transport.energy_balance(&solved),
        },
    })
}
