//! Textures, looked up at a point for a ray of some width: images through mip maps, procedural patterns through their
//! integrals.
//!
//! A [`TextureSet`] is prepared once per render. It replaces images of one colour by that colour, and builds mip maps
//! of the images that some sampler looks up by the ray's width.
//!
//! There are two kinds of footprint. [`TextureSet::sample`] takes one width for all directions, as a GPU without
//! anisotropic filtering does. [`TextureSet::sample_footprint`] takes the two axes of the ray's footprint on the
//! surface and places several narrower lookups along the longer one (McCormack et al., "Feline", SIGGRAPH 1999), so a
//! floor stays sharp across the view up to the horizon.

mod constant_fold;
mod lookup_plan;
mod mip_level;
mod mipmap;
mod packet_lookup;
mod procedural;

use std::collections::HashSet;

use glam::DVec3;

pub use self::constant_fold::fold_constant_textures;
pub(crate) use self::lookup_plan::UvPacket;
use self::mip_level::{MipLevel, WHITE};
use self::mipmap::MipMap;
pub(crate) use self::packet_lookup::{LookupMethod, PacketLookup};
pub(crate) use self::procedural::PatternPacket;
use crate::parallel;
use crate::scene::{
    Effect, EffectSet, Encoding, Filter, Image, Procedural, Sampler, Scene, Space, Texels, Texture,
    TextureUse,
};

/// Inputs of a texture lookup at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexturePoint {
    /// Texture coordinates after the layer's transform: u to the right, v downwards from the image's top left corner.
    pub uv: [f32; 2],
    /// Shaded point in object space.
    pub p_object: DVec3,
    /// Width of the ray's footprint in units of `uv`; 0 selects the finest level.
    pub uv_width: f32,
    /// Width of the ray's footprint in object space; 0 selects the unfiltered pattern.
    pub width: f32,
}

impl TexturePoint {
    /// Creates a lookup point for a ray without width.
    pub fn sharp(uv: [f32; 2], p_object: DVec3) -> TexturePoint {
        TexturePoint {
            uv,
            p_object,
            uv_width: 0.0,
            width: 0.0,
        }
    }
}

/// Axes of a ray's footprint on a surface, as full lengths, the longer first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Footprint {
    /// Axes in units of uv, after the layer's transform.
    pub uv: [[f32; 2]; 2],
    /// Axes of the footprint in object space.
    pub object: [DVec3; 2],
}

/// Textures of a scene, prepared for lookups.
#[derive(Debug)]
pub struct TextureSet<'s> {
    lookups: Vec<Lookup<'s>>,
    /// Mip maps by image and [`Encoding`]; `None` where no lookup needs them.
    mip_maps: Vec<[Option<MipMap>; 2]>,
}

#[derive(Debug)]
enum Lookup<'s> {
    /// Colour of an image whose texels are all equal, by [`Encoding`].
    Constant([[f32; 4]; 2]),
    Image(ImageLookup<'s>),
    Procedural(&'s Procedural),
}

#[derive(Debug)]
struct ImageLookup<'s> {
    image: &'s Image,
    index: usize,
    sampler: Sampler,
}

/// Largest number of lookups along the longer axis of a footprint, as on GPUs.
const MAX_PROBES: f64 = 16.0;

impl<'s> TextureSet<'s> {
    /// Prepares the textures of a validated scene.
    pub fn new(scene: &'s Scene) -> TextureSet<'s> {
        TextureSet::of_effects(scene, EffectSet::ALL)
    }

    /// Prepares the textures for lookups by `effects` only, and without mip maps if [`Effect::TextureFilter`] is not
    /// among them.
    pub fn of_effects(scene: &'s Scene, effects: EffectSet) -> TextureSet<'s> {
        // Detect images of one colour
        let constants = parallel::map(scene.images.len(), &|index| constant(&scene.images[index]));
        let lookups: Vec<Lookup> = scene
            .textures
            .iter()
            .map(|texture| match texture {
                Texture::Procedural(procedural) => Lookup::Procedural(procedural),
                Texture::Image { image, sampler } => match constants[*image as usize] {
                    Some(colors) => Lookup::Constant(colors),
                    None => Lookup::Image(ImageLookup {
                        image: &scene.images[*image as usize],
                        index: *image as usize,
                        sampler: *sampler,
                    }),
                },
            })
            .collect();
        // Build the mip maps that materials need
        let wanted = needed_mip_maps(scene, &lookups, effects);
        let mip_maps = parallel::map(scene.images.len(), &|index| {
            [Encoding::Srgb, Encoding::Linear].map(|encoding| {
                wanted
                    .contains(&(index, encoding_index(encoding)))
                    .then(|| MipMap::new(MipLevel::of_image(&scene.images[index], encoding), encoding))
            })
        });
        TextureSet { mip_maps, lookups }
    }

    /// Returns the linear RGBA of a texture at a point, averaged over the point's widths.
    ///
    /// `encoding` gives the meaning of bytes. A mip map exists for the encodings that the scene's materials use; others
    /// use the finest level. Coordinates that are not finite count as 0.
    ///
    /// # Panics
    /// If the scene has no such texture.
    pub fn sample(&self, texture: u32, encoding: Encoding, at: &TexturePoint) -> [f32; 4] {
        match &self.lookups[texture as usize] {
            Lookup::Constant(colors) => colors[encoding_index(encoding)],
            Lookup::Image(lookup) => {
                self.texels(lookup, encoding, finite(at.uv), lookup.texels_across(at.uv_width))
            }
            Lookup::Procedural(procedural) => {
                let (p, width) = pattern_point(procedural, at);
                procedural::sample(procedural, p, procedural::isotropic(procedural, p, width))
            }
        }
    }

    /// Returns the linear RGBA of a texture averaged over an anisotropic footprint; the widths of `at` are ignored.
    ///
    /// # Panics
    /// If the scene has no such texture.
    pub fn sample_footprint(
        &self,
        texture: u32,
        encoding: Encoding,
        at: &TexturePoint,
        footprint: &Footprint,
    ) -> [f32; 4] {
        match &self.lookups[texture as usize] {
            Lookup::Constant(colors) => colors[encoding_index(encoding)],
            // Without mip maps take one lookup of the finest level
            Lookup::Image(lookup) if lookup.sampler.filter != Filter::Mipmap => {
                self.texels(lookup, encoding, finite(at.uv), 0.0)
            }
            Lookup::Image(lookup) => {
                // Place trilinear lookups along the longer axis in texels
                let size = DVec3::new(lookup.image.width.into(), lookup.image.height.into(), 0.0);
                let axes = footprint.uv.map(|axis| plane(finite(axis)) * size);
                let probes = Probes::along(axes);
                let width = axes[1].length().max(axes[0].length() / probes.count);
                let uv = plane(finite(at.uv));
                probes.mean(|offset| {
                    let uv = uv + offset / size.with_z(1.0);
                    self.texels(lookup, encoding, [uv.x, uv.y], width)
                })
            }
            Lookup::Procedural(procedural) => {
                // Place box-filtered lookups along the longer axis in pattern space
                let (p, _) = pattern_point(procedural, at);
                let axes = match procedural.space {
                    Space::Uv => footprint.uv.map(|axis| plane(finite(axis))),
                    Space::Object => footprint.object,
                };
                let probes = Probes::along(axes);
                let width = axes[1].abs() + axes[0].abs() / probes.count;
                probes.mean(|offset| procedural::sample(procedural, p + offset, width))
            }
        }
    }

    /// Returns the slope of a height map, channel R: derivatives by the surface's own u and v, before the layer's
    /// transform.
    ///
    /// `derivatives` are those of the point in object space by these u and v; procedural patterns in object space need
    /// them. Images are filtered bilinearly regardless of their sampler, and their slope is taken over one texel, or
    /// over the width of the ray if that is more.
    ///
    /// # Panics
    /// If the scene has no such texture.
    pub fn height_gradient(
        &self,
        layer: &TextureUse,
        at: &TexturePoint,
        derivatives: [DVec3; 2],
    ) -> [f32; 2] {
        // Differentiate the height by the texture coordinates
        let by_uv = match &self.lookups[layer.texture as usize] {
            Lookup::Constant(_) => return [0.0; 2],
            Lookup::Image(lookup) => self.image_slope(lookup, at),
            Lookup::Procedural(procedural) => {
                let (p, width) = pattern_point(procedural, at);
                let width = procedural::isotropic(procedural, p, width);
                let gradient = procedural::gradient(procedural, p, width);
                if procedural.space == Space::Object {
                    return derivatives.map(|derivative| gradient.dot(derivative) as f32);
                }
                [gradient.x, gradient.y]
            }
        };
        // Apply the chain rule of the layer's transform
        let matrix = layer.transform.matrix;
        [0, 1].map(|i| (by_uv[0] * f64::from(matrix[0][i]) + by_uv[1] * f64::from(matrix[1][i])) as f32)
    }

    /// Returns the colour of a texture that has one colour only.
    pub fn constant(&self, texture: u32, encoding: Encoding) -> Option<[f32; 4]> {
        match &self.lookups[texture as usize] {
            Lookup::Constant(colors) => Some(colors[encoding_index(encoding)]),
            Lookup::Image(_) | Lookup::Procedural(_) => None,
        }
    }

    /// Returns the bytes of all mip maps.
    pub fn level_byte_count(&self) -> usize {
        self.mip_maps
            .iter()
            .flatten()
            .flatten()
            .map(MipMap::byte_count)
            .sum()
    }

    /// Looks up an image for a ray that is `width` texels wide.
    fn texels(&self, lookup: &ImageLookup, encoding: Encoding, uv: [f64; 2], width: f64) -> [f32; 4] {
        let finest = MipLevel::of_image(lookup.image, encoding);
        match (
            lookup.sampler.filter,
            &self.mip_maps[lookup.index][encoding_index(encoding)],
        ) {
            (Filter::Nearest, _) => finest.nearest(lookup.sampler, uv),
            (Filter::Mipmap, Some(mip_map)) => mip_map.trilinear(finest, lookup.sampler, uv, width),
            (Filter::Linear | Filter::Mipmap, _) => finest.bilinear(lookup.sampler, uv),
        }
    }

    /// Returns the slope of a height image by its texture coordinates, as central differences.
    fn image_slope(&self, lookup: &ImageLookup, at: &TexturePoint) -> [f64; 2] {
        // Replace nearest by bilinear filtering, whose slope is defined
        let filter = match lookup.sampler.filter {
            Filter::Nearest => Filter::Linear,
            smooth => smooth,
        };
        let smooth = ImageLookup {
            sampler: Sampler {
                filter,
                ..lookup.sampler
            },
            ..*lookup
        };
        let uv = finite(at.uv);
        let width = lookup.texels_across(at.uv_width);
        let mut slope = [0.0; 2];
        // Difference over one texel or the ray's width
        for (axis, side) in [lookup.image.width, lookup.image.height].into_iter().enumerate() {
            let step = (0.5 / f64::from(side)).max(0.5 * finite([at.uv_width; 2])[0]);
            let height = |step: f64| {
                let mut uv = uv;
                uv[axis] += step;
                f64::from(self.texels(&smooth, Encoding::Linear, uv, width)[0])
            };
            slope[axis] = (height(step) - height(-step)) / (2.0 * step);
        }
        slope
    }
}

impl ImageLookup<'_> {
    /// Converts a width in uv to texels. The geometric mean of both sides is taken as the size of the image: where uv
    /// is stretched so that texels are square on the surface, it gives their number along either side.
    fn texels_across(&self, uv_width: f32) -> f64 {
        f64::from(uv_width) * (f64::from(self.image.width) * f64::from(self.image.height)).sqrt()
    }
}

/// Lookup points spaced evenly along the longer axis of a footprint.
struct Probes {
    count: f64,
    axis: DVec3,
}

impl Probes {
    fn along([longer, shorter]: [DVec3; 2]) -> Probes {
        let ratio = (longer.length() / shorter.length()).ceil();
        Probes {
            // An axis of zero length gives an infinite ratio; NaN means that both are zero.
            count: if ratio > 1.0 { ratio.min(MAX_PROBES) } else { 1.0 },
            axis: longer,
        }
    }

    /// Returns the mean of `look` over the offsets of all probes from the centre.
    fn mean(&self, look: impl Fn(DVec3) -> [f32; 4]) -> [f32; 4] {
        let mut sum = [0.0; 4];
        for probe in 0..self.count as usize {
            let offset = self.axis * ((probe as f64 + 0.5) / self.count - 0.5);
            let color = look(offset);
            (0..4).for_each(|c| sum[c] += color[c]);
        }
        sum.map(|x| x / self.count as f32)
    }
}

/// Returns the point in the pattern's space and the width of the ray there.
fn pattern_point(procedural: &Procedural, at: &TexturePoint) -> (DVec3, f64) {
    match procedural.space {
        Space::Uv => (plane(finite(at.uv)), at.uv_width.into()),
        Space::Object => (at.p_object, at.width.into()),
    }
}

fn plane([u, v]: [f64; 2]) -> DVec3 {
    DVec3::new(u, v, 0.0)
}

fn finite(uv: [f32; 2]) -> [f64; 2] {
    uv.map(|x| if x.is_finite() { f64::from(x) } else { 0.0 })
}

fn encoding_index(encoding: Encoding) -> usize {
    match encoding {
        Encoding::Srgb => 0,
        Encoding::Linear => 1,
    }
}

/// Returns the colours, by encoding, of an image whose texels are all equal.
fn constant(image: &Image) -> Option<[[f32; 4]; 2]> {
    let same = match &image.texels {
        Texels::Bytes(texels) => all_same(texels),
        Texels::Floats(texels) => all_same(texels),
        Texels::Unread => return Some([WHITE; 2]),
    };
    same.then(|| {
        [Encoding::Srgb, Encoding::Linear].map(|encoding| MipLevel::of_image(image, encoding).texel(0, 0))
    })
}

fn all_same<T: PartialEq>(texels: &[T]) -> bool {
    texels.windows(2).all(|pair| pair[0] == pair[1]) && !texels.is_empty()
}

/// Returns the pairs of image and encoding that some material looks up by the width of the ray.
fn needed_mip_maps(scene: &Scene, lookups: &[Lookup], effects: EffectSet) -> HashSet<(usize, usize)> {
    let layers = scene.materials.iter().flat_map(|material| &material.layers);
    layers
        .filter(|layer| effects.has(Effect::TextureFilter) && effects.has(layer.effect()))
        .filter_map(|layer| match &lookups[layer.texture.texture as usize] {
            Lookup::Image(lookup) if lookup.sampler.filter == Filter::Mipmap => {
                Some((lookup.index, encoding_index(layer.parameter.encoding())))
            }
            _ => None,
        })
        .collect()
}

#[cfg(test)]
mod tests;
