//! Image lookups of sixteen points at once: the coordinates and mip levels of all lanes are computed with SIMD, and the
//! texels are then blended lane by lane, four channels at a time.
//!
//! The coordinates of a lookup depend on the size of the image and on its sampler, but not on its texels. So the maps
//! of a material (colour, roughness, normals, occlusion), which usually have one size, share a [`LookupPlan`], and maps
//! that are packed into one image share its texels.
//!
//! The method is that of [`TextureSet::sample_footprint`], which is the scalar referee, in f32: coordinates lose no
//! more than half a unit in the last place of `uv`, and mip levels have an error of less than 1e-6.

use glam::Vec4;

use super::encoding_index;
use super::mip_level::{Decoder, MipLevel};
use super::mipmap::MipMap;
use super::{ImageLookup, Lookup, TextureSet};
use crate::numeric::{LANES, Lanes};
use crate::scene::{Encoding, Filter, Sampler, TextureUse, UvTransform, Wrap};

/// Largest number of lookups along the longer axis of a footprint.
const MAX_PROBES: usize = super::MAX_PROBES as usize;

/// Largest component of an axis of a footprint, in units of uv. Images are at their coarsest level long before, and its
/// square is finite.
const MAX_AXIS: f32 = (1u64 << 40) as f32;

/// Texture coordinates of sixteen points and the axes of the rays' footprints there, before the transform of a layer.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct UvPacket {
    /// Coordinates u and v.
    pub(crate) uv: [Lanes<f32>; 2],
    /// Axes as full lengths, the longer first; each by u and v.
    pub(crate) axes: [[Lanes<f32>; 2]; 2],
}

impl UvPacket {
    /// Points at the origin, without footprints.
    pub(crate) const ZERO: UvPacket = UvPacket {
        uv: [[0.0; LANES]; 2],
        axes: [[[0.0; LANES]; 2]; 2],
    };

    /// Returns the packet in the coordinates after `transform`. Values that are not finite count as 0.
    #[inline(always)]
    fn transformed(&self, transform: &UvTransform) -> UvPacket {
        let finite = |x: f32| if x.abs() < f32::INFINITY { x } else { 0.0 };
        let mut out = UvPacket::ZERO;
        for (row, [a, b]) in transform.matrix.into_iter().enumerate() {
            for l in 0..LANES {
                out.uv[row][l] = finite(a * self.uv[0][l] + b * self.uv[1][l] + transform.offset[row]);
            }
            for axis in 0..2 {
                let [u, v] = &self.axes[axis];
                for l in 0..LANES {
                    out.axes[axis][row][l] = finite(a * u[l] + b * v[l]).clamp(-MAX_AXIS, MAX_AXIS);
                }
            }
        }
        out
    }
}

/// Working memory of lookups. What one layer of a material computes is kept for the next ones.
#[derive(Debug)]
pub(crate) struct PacketLookup {
    plan: LookupPlan,
    /// Layout that `plan` was made for; `None` if the points have changed since.
    layout: Option<Layout>,
    /// Texture and encoding of `texels`; `None` if the plan has changed since.
    fetched: Option<(u32, Encoding)>,
    texels: Lanes<[f32; 4]>,
}

/// Inputs of a plan besides the points.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Layout {
    size: [u32; 2],
    sampler: Sampler,
    has_mips: bool,
    tex_coord: u32,
    transform: UvTransform,
}

impl PacketLookup {
    pub(crate) fn new() -> PacketLookup {
        PacketLookup {
            plan: LookupPlan::default(),
            layout: None,
            fetched: None,
            texels: [[0.0; 4]; LANES],
        }
    }

    /// Forgets what was computed for other points.
    #[inline(always)]
    pub(crate) fn begin(&mut self) {
        self.layout = None;
        self.fetched = None;
    }

    /// Returns the texels of the last lookup.
    #[inline(always)]
    pub(crate) fn texels(&self) -> &Lanes<[f32; 4]> {
        &self.texels
    }

    /// Returns the texels for being set by other lookups.
    pub(crate) fn texels_mut(&mut self) -> &mut Lanes<[f32; 4]> {
        self.fetched = None;
        &mut self.texels
    }
}

impl TextureSet<'_> {
    /// Returns whether [`TextureSet::sample_packet`] looks a texture up: images, but not procedural patterns.
    pub(crate) fn is_image(&self, texture: u32) -> bool {
        !matches!(self.lookups[texture as usize], Lookup::Procedural(_))
    }

    /// Returns the linear RGBA of a texture at the points of the lanes in `mask`, averaged over their footprints.
    /// Other lanes and all lanes of procedural textures have any values. `points` are those of the texture coordinates
    /// that `layer` uses, and must not have changed since [`PacketLookup::begin`].
    ///
    /// # Panics
    /// If the scene has no such texture.
    #[inline(always)]
    pub(crate) fn sample_packet<'l>(
        &self,
        layer: &TextureUse,
        encoding: Encoding,
        points: &UvPacket,
        mask: &Lanes<bool>,
        lookup: &'l mut PacketLookup,
    ) -> &'l Lanes<[f32; 4]> {
        let image = match &self.lookups[layer.texture as usize] {
            Lookup::Image(image) => image,
            Lookup::Constant(colors) => {
                lookup.fetched = None;
                lookup.texels = [colors[encoding_index(encoding)]; LANES];
                return &lookup.texels;
            }
            Lookup::Procedural(_) => return &lookup.texels,
        };
        // Plan the lookups, unless the layer before had the same coordinates
        let mips = image.mips(self, encoding);
        let layout = Layout {
            size: [image.image.width, image.image.height],
            sampler: image.sampler,
            has_mips: mips.is_some(),
            tex_coord: layer.tex_coord,
            transform: layer.transform,
        };
        if lookup.layout != Some(layout) {
            lookup.plan.fill(&layout, points, mask);
            lookup.layout = Some(layout);
            lookup.fetched = None;
        }
        // Fetch and blend the texels
        if lookup.fetched != Some((layer.texture, encoding)) {
            lookup.fetched = Some((layer.texture, encoding));
            let finest = MipLevel::of_image(image.image, encoding);
            let (plan, texels) = (&lookup.plan, &mut lookup.texels);
            match finest.texels {
                Decoder::Bytes(bytes) => plan.fetch(&LinearBytes(bytes), mips, mask, texels),
                Decoder::SrgbBytes(bytes, linear) => {
                    plan.fetch(&SrgbBytes { bytes, linear }, mips, mask, texels);
                }
                Decoder::Floats(floats) => plan.fetch(&Floats(floats), mips, mask, texels),
            }
        }
        &lookup.texels
    }
}

impl ImageLookup<'_> {
    /// Returns the mip map that lookups of this encoding use, if they use one.
    fn mips<'t>(&self, textures: &'t TextureSet, encoding: Encoding) -> Option<&'t MipMap> {
        let mips = textures.mip_maps[self.index][encoding_index(encoding)].as_ref();
        mips.filter(|_| self.sampler.filter == Filter::Mipmap)
    }
}

/// Texel indices and weights of the lookups of sixteen points.
#[derive(Debug)]
struct LookupPlan {
    /// Number of lookups along the footprint of each lane.
    probe_count: Lanes<u32>,
    /// Finer of the two mip levels of each lane; 0 is the image.
    level: Lanes<u32>,
    /// Weight of the coarser level.
    blend: Lanes<f32>,
    /// Texels of each probe on the finer and on the coarser level.
    taps: Box<[[Taps; 2]; MAX_PROBES]>,
}

/// The four texels of a bilinear lookup in each lane.
#[derive(Clone, Copy, Debug)]
struct Taps {
    columns: [Lanes<u32>; 2],
    /// First texel of each of the two rows.
    rows: [Lanes<u32>; 2],
    /// Weight of the second column.
    across: Lanes<f32>,
    /// Weight of the second row.
    down: Lanes<f32>,
}

impl Taps {
    const ZERO: Taps = Taps {
        columns: [[0; LANES]; 2],
        rows: [[0; LANES]; 2],
        across: [0.0; LANES],
        down: [0.0; LANES],
    };
}

impl Default for LookupPlan {
    fn default() -> LookupPlan {
        LookupPlan {
            probe_count: [1; LANES],
            level: [0; LANES],
            blend: [0.0; LANES],
            taps: Box::new([[Taps::ZERO; 2]; MAX_PROBES]),
        }
    }
}

impl LookupPlan {
    /// Plans the lookups at `points`, which are in the coordinates before the layer's transform.
    #[inline(always)]
    fn fill(&mut self, layout: &Layout, points: &UvPacket, mask: &Lanes<bool>) {
        let points = points.transformed(&layout.transform);
        let sampler = layout.sampler;
        // Choose the probes and the mip levels by the footprints
        if layout.has_mips {
            self.choose_levels(layout.size, &points.axes);
        } else {
            self.probe_count = [1; LANES];
            self.level = [0; LANES];
            self.blend = [0.0; LANES];
        }
        let mut most = 1;
        let mut blends = false;
        for l in 0..LANES {
            most = most.max(if mask[l] { self.probe_count[l] } else { 1 });
            blends |= mask[l] & (self.blend[l] > 0.0);
        }
        // Wrap the centres first, so that the offsets of the probes are not lost in large coordinates
        let centers = [
            wrapped_center(sampler.wrap_u, &points.uv[0]),
            wrapped_center(sampler.wrap_v, &points.uv[1]),
        ];
        // Find the texels of each probe on both levels
        let spacing = self.probe_count.map(|count| 1.0 / count as f32);
        for probe in 0..most as usize {
            let mut uv = centers;
            if most > 1 {
                for axis in 0..2 {
                    for l in 0..LANES {
                        let offset = (probe as f32 + 0.5) * spacing[l] - 0.5;
                        uv[axis][l] += points.axes[0][axis][l] * offset;
                    }
                }
            }
            let [finer, coarser] = &mut self.taps[probe];
            finer.fill(layout, &uv, &self.level);
            if blends {
                coarser.fill(layout, &uv, &self.level.map(|level| level + 1));
            }
        }
    }

    /// Chooses the number of probes and the mip levels for an image of this size.
    #[inline(always)]
    fn choose_levels(&mut self, size: [u32; 2], axes: &[[Lanes<f32>; 2]; 2]) {
        let coarsest = size[0].max(size[1]).max(1).ilog2() as f32;
        let size = size.map(|side| side as f32);
        for l in 0..LANES {
            // Measure the axes in texels
            let [longer, shorter] = [0, 1].map(|axis| {
                let [u, v] = [axes[axis][0][l] * size[0], axes[axis][1][l] * size[1]];
                (u * u + v * v).sqrt()
            });
            // The comparison is false for 0 / 0, without a footprint
            let ratio = longer / shorter;
            let count = if ratio > 1.0 {
                ratio.ceil().min(MAX_PROBES as f32)
            } else {
                1.0
            };
            let width = shorter.max(longer / count);
            // The level is the binary logarithm of the width
            let level = if width > 1.0 {
                log2(width).min(coarsest)
            } else {
                0.0
            };
            let finer = level.floor();
            self.probe_count[l] = count as i32 as u32;
            self.level[l] = finer as i32 as u32;
            self.blend[l] = level - finer;
        }
    }

    /// Fetches the texels of the lanes in `mask` and blends them.
    #[inline(always)]
    fn fetch(
        &self,
        finest: &impl TexelSource,
        mips: Option<&MipMap>,
        mask: &Lanes<bool>,
        texels: &mut Lanes<[f32; 4]>,
    ) {
        for l in 0..LANES {
            if !mask[l] {
                continue;
            }
            let (level, blend) = (self.level[l] as usize, self.blend[l]);
            let level_texels = |level: usize| Floats(mips.map_or(&[], |mips| mips.level_texels(level)));
            let mut sum = Vec4::ZERO;
            let count = self.probe_count[l];
            for [finer, coarser] in &self.taps[..count as usize] {
                let mut color = match level {
                    0 => finer.blend(finest, l),
                    _ => finer.blend(&level_texels(level), l),
                };
                if blend > 0.0 {
                    color += (coarser.blend(&level_texels(level + 1), l) - color) * blend;
                }
                sum += color;
            }
            texels[l] = (sum / count as f32).to_array();
        }
    }
}

impl Taps {
    /// Sets the texels around the coordinates `uv` on the mip level of each lane.
    #[inline(always)]
    fn fill(&mut self, layout: &Layout, uv: &[Lanes<f32>; 2], level: &Lanes<u32>) {
        let Sampler {
            wrap_u,
            wrap_v,
            filter,
        } = layout.sampler;
        let is_nearest = filter == Filter::Nearest;
        let side = |axis: usize| level.map(|level| (layout.size[axis] >> level).max(1));
        let (width, height) = (side(0), side(1));
        self.columns = neighbors(wrap_u, is_nearest, &uv[0], &width, &mut self.across);
        self.rows = neighbors(wrap_v, is_nearest, &uv[1], &height, &mut self.down);
        for row in &mut self.rows {
            for l in 0..LANES {
                row[l] = row[l].wrapping_mul(width[l]);
            }
        }
    }

    /// Returns the bilinear blend of the four texels of lane `l`.
    #[inline(always)]
    fn blend<T: TexelSource>(&self, source: &T, l: usize) -> Vec4 {
        let texel = |row: usize, column: usize| {
            source.texel(self.rows[row][l] as usize + self.columns[column][l] as usize)
        };
        let mix = |a: Vec4, b: Vec4, t: f32| a + (b - a) * t;
        let top = mix(texel(0, 0), texel(0, 1), self.across[l]);
        let bottom = mix(texel(1, 0), texel(1, 1), self.across[l]);
        mix(top, bottom, self.down[l]) * T::SCALE
    }
}

/// Returns coordinates in the same place of the repeated image that are near 0 where the image repeats.
#[inline(always)]
fn wrapped_center(wrap: Wrap, coordinate: &Lanes<f32>) -> Lanes<f32> {
    match wrap {
        Wrap::Repeat => coordinate.map(|x| x - x.floor()),
        Wrap::MirroredRepeat => coordinate.map(|x| x - 2.0 * (0.5 * x).floor()),
        Wrap::ClampToEdge => *coordinate,
    }
}

/// Returns the two texels between whose centres each coordinate lies, along one side of an image, and writes the weight
/// of the second one; for nearest lookups, the texel that contains the coordinate, twice.
#[inline(always)]
fn neighbors(
    wrap: Wrap,
    is_nearest: bool,
    coordinate: &Lanes<f32>,
    size: &Lanes<u32>,
    weight: &mut Lanes<f32>,
) -> [Lanes<u32>; 2] {
    // Wrap the coordinates to [0, 1], of a mirrored image to [0, 2]
    let inside = match wrap {
        Wrap::Repeat => coordinate.map(|x| x - x.floor()),
        Wrap::MirroredRepeat => coordinate.map(|x| x - 2.0 * (0.5 * x).floor()),
        Wrap::ClampToEdge => coordinate.map(|x| x.clamp(0.0, 1.0)),
    };
    let half = if is_nearest { 0.0 } else { 0.5 };
    let mut texels = [[0; LANES]; 2];
    for l in 0..LANES {
        // Find the texel centre to the left, and the one to its right
        let last = size[l] as i32 - 1;
        let x = inside[l] * size[l] as i32 as f32 - half;
        let left = x.floor();
        weight[l] = if is_nearest { 0.0 } else { x - left };
        let left = left as i32;
        let right = if is_nearest { left } else { left + 1 };
        // Wrap the texels beyond the edges
        let [left, right] = match wrap {
            Wrap::Repeat => [
                if left < 0 { last } else { left },
                if right > last { 0 } else { right },
            ],
            Wrap::MirroredRepeat => [left, right].map(|i| i.min(2 * last + 1 - i)),
            Wrap::ClampToEdge => [left, right],
        };
        texels[0][l] = left.clamp(0, last) as u32;
        texels[1][l] = right.clamp(0, last) as u32;
    }
    texels
}

/// Returns the binary logarithm of a normal `x` ≥ 1, with an error of less than 1e-6. Exact for powers of two, and
/// continuous there.
#[inline(always)]
fn log2(x: f32) -> f32 {
    /// Minimax polynomial of log2(1 + f) / f in [0, 1], whose coefficients add up to 1.
    const COEFFICIENTS: [f32; 7] = [
        0.015_209_038,
        -0.078_534_72,
        0.193_029_31,
        -0.325_139_95,
        0.473_324_1,
        -0.720_554_2,
        1.442_666_4,
    ];
    const FRACTION: u32 = (1 << 23) - 1;
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let f = f32::from_bits(bits & FRACTION | 1.0f32.to_bits()) - 1.0;
    let mut sum = 0.0;
    for coefficient in COEFFICIENTS {
        sum = sum * f + coefficient;
    }
    exponent as f32 + sum * f
}

/// Texels of one mip level as four values, which are linear RGBA after multiplication by `SCALE`.
trait TexelSource {
    const SCALE: f32;

    fn texel(&self, index: usize) -> Vec4;
}

struct LinearBytes<'a>(&'a [[u8; 4]]);

struct SrgbBytes<'a> {
    bytes: &'a [[u8; 4]],
    linear: &'static [f32; 256],
}

struct Floats<'a>(&'a [[f32; 4]]);

impl TexelSource for LinearBytes<'_> {
    const SCALE: f32 = 1.0 / 255.0;

    #[inline(always)]
    fn texel(&self, index: usize) -> Vec4 {
        Vec4::from_array(self.0[index].map(f32::from))
    }
}

impl TexelSource for SrgbBytes<'_> {
    const SCALE: f32 = 1.0;

    #[inline(always)]
    fn texel(&self, index: usize) -> Vec4 {
        let [r, g, b, a] = self.bytes[index];
        let [r, g, b] = [r, g, b].map(|code| self.linear[usize::from(code)]);
        Vec4::new(r, g, b, f32::from(a) * (1.0 / 255.0))
    }
}

impl TexelSource for Floats<'_> {
    const SCALE: f32 = 1.0;

    #[inline(always)]
    fn texel(&self, index: usize) -> Vec4 {
        Vec4::from_array(self.0[index])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;
    use crate::scene::{Image, Scene, Texels, Texture};
    use crate::shading::{Footprint, TexturePoint};
    use glam::DVec3;

    /// Returns an image of random texels.
    fn noise(random: &mut SplitMix64, [width, height]: [u32; 2], is_float: bool) -> Image {
        let count = (width * height) as usize;
        let mut byte = || (256.0 * random.unit()) as u8;
        Image {
            name: String::new(),
            width,
            height,
            texels: if is_float {
                let texels: Vec<_> = (0..count)
                    .map(|_| [0; 4].map(|_: i32| f32::from(byte()) / 64.0))
                    .collect();
                Texels::Floats(texels.into())
            } else {
                let texels: Vec<[u8; 4]> = (0..count).map(|_| [0; 4].map(|_: i32| byte())).collect();
                Texels::Bytes(texels.into())
            },
        }
    }

    #[test]
    fn lookups_of_sixteen_points_equal_those_of_each() {
        let mut random = SplitMix64::new(7, 0);
        for size in [[1, 2], [2, 2], [7, 5], [64, 64], [256, 32], [33, 100]] {
            for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
                for filter in [Filter::Nearest, Filter::Linear, Filter::Mipmap] {
                    for (is_float, encoding) in [
                        (false, Encoding::Srgb),
                        (false, Encoding::Linear),
                        (true, Encoding::Linear),
                    ] {
                        let image = noise(&mut random, size, is_float);
                        compare(
                            &mut random,
                            image,
                            Sampler {
                                wrap_u: wrap,
                                wrap_v: wrap,
                                filter,
                            },
                            encoding,
                        );
                    }
                }
            }
        }
    }

    fn compare(random: &mut SplitMix64, image: Image, sampler: Sampler, encoding: Encoding) {
        let size = [image.width as f32, image.height as f32];
        let scene = Scene {
            images: vec![image],
            textures: vec![Texture::Image { image: 0, sampler }],
            ..Scene::default()
        };
        let textures = TextureSet {
            lookups: vec![Lookup::Image(ImageLookup {
                image: &scene.images[0],
                index: 0,
                sampler,
            })],
            mip_maps: vec![[Encoding::Srgb, Encoding::Linear].map(|encoding| {
                Some(MipMap::new(
                    MipLevel::of_image(&scene.images[0], encoding),
                    encoding,
                ))
            })],
        };
        let mut lookup = PacketLookup::new();
        for _ in 0..40 {
            let mut points = UvPacket::ZERO;
            for l in 0..LANES {
                let reach = if random.unit() < 0.5 { 1.0 } else { 20.0 };
                for axis in 0..2 {
                    points.uv[axis][l] = (reach * (random.unit() - 0.5)) as f32;
                }
                let width = (random.unit() * 12.0 - 3.0).exp2();
                let angle = 6.3 * random.unit();
                let (sin, cos) = angle.sin_cos();
                // No ratio that rounding brings to an integer, where there is a probe more
                let stretch = 1.001 + 20.0 * random.unit().powi(3);
                let axes = [
                    [cos * width * stretch, sin * width * stretch],
                    [-sin * width, cos * width],
                ];
                for axis in 0..2 {
                    for c in 0..2 {
                        points.axes[axis][c][l] = axes[axis][c] as f32 / size[c];
                    }
                }
            }
            let mask = std::array::from_fn(|_| random.unit() < 0.8);
            lookup.begin();
            let layer = TextureUse::new(0);
            let texels = *textures.sample_packet(&layer, encoding, &points, &mask, &mut lookup);
            for l in (0..LANES).filter(|&l| mask[l]) {
                let at = TexturePoint::sharp([points.uv[0][l], points.uv[1][l]], DVec3::ZERO);
                let footprint = Footprint {
                    uv: [0, 1].map(|axis| [points.axes[axis][0][l], points.axes[axis][1][l]]),
                    ..Footprint::default()
                };
                let expected = textures.sample_footprint(0, encoding, &at, &footprint);
                for c in 0..4 {
                    let difference = (texels[l][c] - expected[c]).abs();
                    assert!(
                        difference <= 1e-4,
                        "{size:?} {sampler:?} {encoding:?} {at:?} {footprint:?}: {:?}, not {expected:?}",
                        texels[l]
                    );
                }
            }
        }
    }
}
