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
use super::lookup_plan::{Layout, LookupPlan, MAX_SIDE, Taps, UvPacket};
use super::mip_level::{LINEAR_FROM_SRGB, WHITE};
use super::mipmap::{LevelTexels, MipMap};
use super::procedural::{self, PatternPacket};
use super::{ImageLookup, Lookup, TextureSet};
use crate::numeric::{LANES, Lanes};
use crate::scene::{Encoding, Filter, Space, Texels, TextureUse};

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

/// Way in which a texture is looked up at sixteen points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum LookupMethod {
    /// Image or constant colour, by [`TextureSet::sample_packet`].
    Image,
    /// By [`TextureSet::sample_pattern`], with points in this space.
    Pattern(Space),
    /// Lane by lane: images whose texels f32 cannot number.
    ByLane,
}

impl TextureSet<'_> {
    /// Returns how the texture is looked up at sixteen points.
    #[inline(always)]
    pub(crate) fn lookup_method(&self, texture: u32) -> LookupMethod {
        match &self.lookups[texture as usize] {
            Lookup::Constant(_) => LookupMethod::Image,
            Lookup::Image(image) if image.image.width.max(image.image.height) <= MAX_SIDE => {
                LookupMethod::Image
            }
            Lookup::Image(_) => LookupMethod::ByLane,
            Lookup::Procedural(procedural) => LookupMethod::Pattern(procedural.space),
        }
    }

    /// Returns the linear RGBA of a procedural texture at the points of the lanes in `mask`, averaged over their
    /// footprints. Other lanes and all lanes of images have any values.
    pub(crate) fn sample_pattern<'l>(
        &self,
        texture: u32,
        points: &PatternPacket,
        mask: &Lanes<bool>,
        lookup: &'l mut PacketLookup,
    ) -> &'l Lanes<[f32; 4]> {
        if let Lookup::Procedural(procedural) = &self.lookups[texture as usize] {
            procedural::sample_packet(procedural, points, mask, lookup.texels_mut());
        }
        &lookup.texels
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
            let (plan, texels) = (&lookup.plan, &mut lookup.texels);
            match (&image.image.texels, encoding) {
                (Texels::Bytes(bytes), Encoding::Linear) => {
                    fetch(plan, &LinearTexels(bytes), mips, mask, texels);
                }
                (Texels::Bytes(bytes), Encoding::Srgb) => {
                    fetch(
                        plan,
                        &SrgbBytes {
                            bytes,
                            linear: &LINEAR_FROM_SRGB,
                        },
                        mips,
                        mask,
                        texels,
                    );
                }
                (Texels::Floats(floats), _) => fetch(plan, &LinearTexels(floats), mips, mask, texels),
                (Texels::Unread, _) => *texels = [WHITE; LANES],
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

/// Fetches the texels of the lanes in `mask` and blends them.
#[inline(always)]
fn fetch<F: FinestTexels>(
    plan: &LookupPlan,
    finest: &F,
    mips: Option<&MipMap>,
    mask: &Lanes<bool>,
    texels: &mut Lanes<[f32; 4]>,
) {
    for l in 0..LANES {
        if !mask[l] {
            continue;
        }
        // Find the texels of the two levels
        let (level, blend) = (plan.level[l] as usize, plan.blend[l]);
        let level_texels = |level: usize| F::coarser(mips.map(|mips| mips.level_texels(level)));
        let coarser = (blend > 0.0).then(|| (level_texels(level + 1), blend));
        // Average the probes
        let probes = &plan.taps[..plan.probe_count[l] as usize];
        let sum = match level {
            0 => sum_probes(probes, finest, coarser.as_ref(), l),
            _ => sum_probes(probes, &level_texels(level), coarser.as_ref(), l),
        };
        texels[l] = (sum * plan.share[l]).to_array();
    }
}

/// Returns the sum of the lookups of lane `l` on the finer of two levels, or blended with those on the coarser one by
/// its weight.
#[inline(always)]
fn sum_probes<C: TexelSource>(
    probes: &[[Taps; 2]],
    finer: &impl TexelSource,
    coarser: Option<&(C, f32)>,
    l: usize,
) -> Vec4 {
    let mut sum = Vec4::ZERO;
    let Some((coarser, blend)) = coarser else {
        for [taps, _] in probes {
            sum += blend_texels(taps, finer, l);
        }
        return sum;
    };
    for [taps, coarser_taps] in probes {
        let color = blend_texels(taps, finer, l);
        sum += color + (blend_texels(coarser_taps, coarser, l) - color) * *blend;
    }
    sum
}

/// Returns the bilinear blend of the four texels of lane `l`.
#[inline(always)]
fn blend_texels<T: TexelSource>(taps: &Taps, source: &T, l: usize) -> Vec4 {
    // Blend both columns at once, then the columns
    let step = taps.step[l];
    let top = texel_pair(source, taps.first[0][l], step);
    let bottom = texel_pair(source, taps.first[1][l], step);
    let down = taps.down[l];
    let mut columns = [0.0; 8];
    for i in 0..8 {
        columns[i] = top[i] + (bottom[i] - top[i]) * down;
    }
    let [a, b, c, d, e, f, g, h] = columns;
    let (left, right) = (Vec4::new(a, b, c, d), Vec4::new(e, f, g, h));
    (left + (right - left) * taps.across[l]) * T::SCALE
}

/// Returns the texel of index `first` and the one a wrapping `step` after it. No closure: one that is not inlined would
/// be compiled for the lowest instruction set.
#[inline(always)]
fn texel_pair<T: TexelSource>(source: &T, first: u32, step: u32) -> [f32; 8] {
    if step == 1 {
        return source.pair(first as usize);
    }
    let a = source.texel(first as usize);
    let b = source.texel(first.wrapping_add(step) as usize);
    [a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w]
}

/// Texels of one mip level as four values, which are linear RGBA after multiplication by `SCALE`.
trait TexelSource {
    const SCALE: f32;

    fn texel(&self, index: usize) -> Vec4;

    /// Returns a texel and the one after it.
    fn pair(&self, index: usize) -> [f32; 8];
}

/// Returns the eight values of two texels as floats.
#[inline(always)]
fn floats<T: Copy + Into<f32>>(texels: &[[T; 4]]) -> [f32; 8] {
    let mut out = [0.0; 8];
    // From a reference: of a copied array, the compiler would shift every value out of one register
    if let Some(values) = texels.as_flattened().first_chunk::<8>() {
        for i in 0..8 {
            out[i] = values[i].into();
        }
    }
    out
}

/// Texels of the finest level, beside those of the coarser levels of their mip map.
trait FinestTexels: TexelSource {
    type Coarser<'t>: TexelSource;

    /// Returns the texels of a coarser level; none if there is no mip map.
    fn coarser(level: Option<&LevelTexels>) -> Self::Coarser<'_>;
}

/// Channel of a texel that is linear after multiplication by `SCALE`.
trait LinearChannel: Copy + Into<f32> {
    const SCALE: f32;
}

impl LinearChannel for u8 {
    const SCALE: f32 = 1.0 / 255.0;
}

impl LinearChannel for u16 {
    const SCALE: f32 = 1.0 / 65535.0;
}

impl LinearChannel for f32 {
    const SCALE: f32 = 1.0;
}

/// Texels of linear channels.
struct LinearTexels<'a, T>(&'a [[T; 4]]);

struct SrgbBytes<'a> {
    bytes: &'a [[u8; 4]],
    linear: &'static [f32; 256],
}

impl<'a> LinearTexels<'a, u16> {
    #[inline(always)]
    fn of_level(level: Option<&'a LevelTexels>) -> LinearTexels<'a, u16> {
        match level {
            Some(LevelTexels::Words(texels)) => LinearTexels(texels),
            _ => LinearTexels(&[]),
        }
    }
}

impl FinestTexels for LinearTexels<'_, u8> {
    type Coarser<'t> = LinearTexels<'t, u16>;

    #[inline(always)]
    fn coarser(level: Option<&LevelTexels>) -> LinearTexels<'_, u16> {
        LinearTexels::of_level(level)
    }
}

impl FinestTexels for SrgbBytes<'_> {
    type Coarser<'t> = LinearTexels<'t, u16>;

    #[inline(always)]
    fn coarser(level: Option<&LevelTexels>) -> LinearTexels<'_, u16> {
        LinearTexels::of_level(level)
    }
}

impl FinestTexels for LinearTexels<'_, f32> {
    type Coarser<'t> = LinearTexels<'t, f32>;

    #[inline(always)]
    fn coarser(level: Option<&LevelTexels>) -> LinearTexels<'_, f32> {
        match level {
            Some(LevelTexels::Floats(texels)) => LinearTexels(texels),
            _ => LinearTexels(&[]),
        }
    }
}

impl<T: LinearChannel> TexelSource for LinearTexels<'_, T> {
    const SCALE: f32 = T::SCALE;

    #[inline(always)]
    fn texel(&self, index: usize) -> Vec4 {
        Vec4::from_array(self.0[index].map(Into::into))
    }

    #[inline(always)]
    fn pair(&self, index: usize) -> [f32; 8] {
        floats(&self.0[index..index + 2])
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

    #[inline(always)]
    fn pair(&self, index: usize) -> [f32; 8] {
        let [[r, g, b, a], [r2, g2, b2, a2]] = [self.bytes[index], self.bytes[index + 1]];
        let color = |code: u8| self.linear[usize::from(code)];
        let alpha = |code: u8| f32::from(code) * (1.0 / 255.0);
        [
            color(r),
            color(g),
            color(b),
            alpha(a),
            color(r2),
            color(g2),
            color(b2),
            alpha(a2),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;
    use crate::scene::{Image, Sampler, Scene, Texels, Texture, Wrap};
    use crate::shading::texture::MipLevel;
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
