//! Cost of averaging textures over the width of the ray, on a checkerboard up to the horizon, alone, in a mirroring
//! ball and through a glass ball.

use std::time::Instant;

use crate::checkerboards::{EMPTY, GLASS, MIPMAPPED, MIRROR, PROCEDURE, SHARP, bsp, render_image, scene};
use crate::limits::Limits;
use crate::quartiles::Quartiles;

const ROUNDS: usize = 5;
const WIDTH: u32 = 640;
const SPP: u32 = 4;

/// Times renders of the board not filtered, as an image with mipmaps, and as a procedure, by turns.
pub(crate) fn run(_: &mut Limits) {
    let kinds = [
        ("not filtered", SHARP),
        ("image, mipmaps", MIPMAPPED),
        ("procedure", PROCEDURE),
    ];
    for (name, ball) in [("empty", EMPTY), ("mirror", MIRROR), ("glass", GLASS)] {
        let scenes = kinds.map(|(_, texture)| scene(texture, ball));
        let accels = scenes.each_ref().map(bsp);
        let mut milliseconds = [const { Vec::new() }; 3];
        for _ in 0..ROUNDS {
            for (kind, milliseconds) in milliseconds.iter_mut().enumerate() {
                let start = Instant::now();
                render_image(&scenes[kind], &*accels[kind], WIDTH, SPP);
                milliseconds.push(1e3 * start.elapsed().as_secs_f64());
            }
        }
        for ((kind, _), milliseconds) in kinds.iter().zip(milliseconds) {
            println!("{name}, {kind}: {:.1} ms", Quartiles::compute(milliseconds));
        }
    }
}
