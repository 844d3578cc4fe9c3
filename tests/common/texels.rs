//! What meshes and their textures bring to a material: vertex colours, coordinates, texels.

use std::f64::consts::{PI, TAU};

use whit::mesh::Mesh;
use whit::scene::{Filter, Image, Scene, Texels, Texture, TextureUse, Wrap};

use super::approx::{Approx, Approx3, ROUNDING};
use super::hits::{Decision, Doubt, Found};

/// The barycentric mean of what the triangle's corners have.
pub fn interpolate(mesh: &Mesh, found: &Found, corner: impl Fn(u32) -> Approx3) -> Approx3 {
    let [a, b, c] = mesh.triangles[found.primitive as usize].map(corner);
    // By differences, so that doubt about the weights counts only as far as the corners differ; and the roundings of
    // a weighted sum, which is what others may compute.
    let largest = a.value().abs().max(b.value().abs()).max(c.value().abs());
    (a + (b - a) * found.u + (c - a) * found.v).widened(4.0 * ROUNDING * largest)
}

/// What a mesh brings to the material.
pub struct Inputs<'a> {
    pub color: Approx3,
    pub alpha: Approx,
    tex_coord: Box<dyn Fn(u32) -> [Approx; 2] + 'a>,
}

impl<'a> Inputs<'a> {
    pub fn of_mesh(mesh: &'a Mesh, found: &'a Found) -> Inputs<'a> {
        let color = mesh.colors.as_ref().map_or(Approx3::ONE, |colors| {
            let rgb = |v: u32| {
                let [r, g, b, _] = colors[v as usize];
                Approx3::exact_f32([r, g, b])
            };
            interpolate(mesh, found, rgb)
        });
        let alpha = mesh.colors.as_ref().map_or(Approx::ONE, |colors| {
            let alpha = |v: u32| Approx3::exact_f32([colors[v as usize][3]; 3]);
            interpolate(mesh, found, alpha).x
        });
        let tex_coord = move |set: u32| {
            mesh.tex_coords
                .get(set as usize)
                .map_or([Approx::ZERO; 2], |coords| {
                    let uv = |v: u32| {
                        let [u, v] = coords[v as usize];
                        Approx3::exact_f32([u, v, 0.0])
                    };
                    let uv = interpolate(mesh, found, uv);
                    [uv.x, uv.y]
                })
        };
        Inputs {
            color,
            alpha,
            tex_coord: Box::new(tex_coord),
        }
    }

    /// Longitude from +x towards +y over the whole turn, latitude from the south pole over half of it.
    pub fn of_sphere(outward: Approx3) -> Inputs<'a> {
        let [x, y, z] = outward.to_array();
        let angle = y.atan2(x) / Approx::rounded(TAU);
        let longitude = if angle.value < 0.0 {
            angle + Approx::ONE
        } else {
            angle
        };
        let latitude = (x.squared() + y.squared()).sqrt().atan2(-z) / Approx::rounded(PI);
        Inputs {
            color: Approx3::ONE,
            alpha: Approx::ONE,
            tex_coord: Box::new(move |_| [longitude, latitude]),
        }
    }

    /// The value of the texture on a parameter, 1 where there is none; its channels as `decode` brings them.
    pub fn lookup(
        &self,
        scene: &Scene,
        texture: Option<TextureUse>,
        decode: fn([u8; 4]) -> [f64; 3],
        doubt: &mut Doubt,
    ) -> Approx3 {
        texture.map_or(Approx3::ONE, |used| {
            let Texture::Image { image, sampler } = scene.textures[used.texture as usize] else {
                unreachable!("the scenes' textures are images")
            };
            let image = &scene.images[image as usize];
            let [u, v] = (self.tex_coord)(used.tex_coord);
            let across = Axis {
                at: u * f64::from(image.width),
                count: i64::from(image.width),
                wrap: sampler.wrap_u,
            };
            let down = Axis {
                at: v * f64::from(image.height),
                count: i64::from(image.height),
                wrap: sampler.wrap_v,
            };
            let texel = |i: i64, j: i64| decoded(image, across.wrapped(i), down.wrapped(j), decode);
            match sampler.filter {
                Filter::Nearest => texel(across.cell(0.0, doubt).0, down.cell(0.0, doubt).0),
                Filter::Linear | Filter::Mipmap => {
                    let (i, x) = across.cell(0.5, doubt);
                    let (j, y) = down.cell(0.5, doubt);
                    let mix = |a: Approx3, b: Approx3, w: Approx| a * (1.0 - w) + b * w;
                    let top = mix(texel(i, j), texel(i + 1, j), x);
                    let bottom = mix(texel(i, j + 1), texel(i + 1, j + 1), x);
                    mix(top, bottom, y)
                }
            }
        })
    }
}

/// A coordinate of a texture, in texels.
struct Axis {
    at: Approx,
    count: i64,
    wrap: Wrap,
}

impl Axis {
    /// The cell of unit length that the coordinate lies in, the first of which starts at `offset`, and where in it.
    fn cell(&self, offset: f64, doubt: &mut Doubt) -> (i64, Approx) {
        let at = self.at - Approx::exact(offset);
        let index = at.value.floor();
        let within = at - Approx::exact(index);
        doubt.note(Decision::Texel, within.slack().min((1.0 - within).slack()));
        (index as i64, within)
    }

    fn wrapped(&self, index: i64) -> usize {
        let wrapped = match self.wrap {
            Wrap::Repeat => index.rem_euclid(self.count),
            Wrap::ClampToEdge => index.clamp(0, self.count - 1),
            Wrap::MirroredRepeat => {
                let period = index.rem_euclid(2 * self.count);
                if period < self.count {
                    period
                } else {
                    2 * self.count - 1 - period
                }
            }
        };
        wrapped as usize
    }
}

fn decoded(image: &Image, i: usize, j: usize, decode: fn([u8; 4]) -> [f64; 3]) -> Approx3 {
    let Texels::Bytes(texels) = &image.texels else {
        unreachable!("the scenes' images have 8 bits")
    };
    Approx3::rounded(decode(texels[j * image.width as usize + i]))
}

/// IEC 61966-2-1, its piecewise curve.
pub fn srgb(byte: u8) -> f64 {
    let v = f64::from(byte) / 255.0;
    if v <= 0.04045 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

fn linear(byte: u8) -> f64 {
    f64::from(byte) / 255.0
}

pub fn srgb_color([r, g, b, _]: [u8; 4]) -> [f64; 3] {
    [r, g, b].map(srgb)
}

pub fn linear_color([r, g, b, _]: [u8; 4]) -> [f64; 3] {
    [r, g, b].map(linear)
}

/// The fourth channel, thrice.
pub fn opacity([_, _, _, a]: [u8; 4]) -> [f64; 3] {
    [linear(a); 3]
}
