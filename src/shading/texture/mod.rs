//! Textures, looked up at a point for a ray of some width: images through mip pyramids, procedures through their
//! integrals.
//!
//! A [`TextureSet`] is prepared once a render. It folds images of one colour into that colour, and halves the images
//! that some sampler looks up by the ray's width.
//!
//! Two kinds of footprint are known. [`TextureSet::sample`] takes one width for all directions, as a GPU without
//! anisotropic filtering does. [`TextureSet::sample_footprint`] takes the two axes of the ray's footprint on the
//! surface and follows the longer one with several narrower look-ups (McCormack et al., "Feline", SIGGRAPH 1999), so a
//! floor stays sharp across the view up to the horizon.

mod constant_fold;
mod mip_level;
mod mipmap;
mod procedural;

use std::collections::HashSet;

use glam::DVec3;

pub use self::constant_fold::fold_constant_textures;
use self::mip_level::Grid;
use self::mipmap::MipMap;
use crate::parallel;
use crate::scene::{
    Effect, EffectSet, Encoding, Filter, Image, Procedural, Sampler, Scene, Space, Texels, Texture,
    TextureUse,
};

/// Everything a texture is asked about at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexturePoint {
    /// Texture coordinates, after the layer's transform: u to the right, v downwards from the image's top left corner.
    pub uv: [f32; 2],
    /// The point in object space.
    pub p_object: DVec3,
    /// Width of the ray's footprint in units of `uv`; 0 takes the finest level.
    pub uv_width: f32,
    /// The same in object space; 0 takes the sharp pattern.
    pub width: f32,
}

impl TexturePoint {
    /// A point seen by a ray without width.
    pub fn sharp(uv: [f32; 2], p_object: DVec3) -> TexturePoint {
        TexturePoint {
            uv,
            p_object,
            uv_width: 0.0,
            width: 0.0,
        }
    }
}

/// The axes of a ray's footprint on a surface, full lengths, the longer first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Footprint {
    /// In units of uv, after the layer's transform.
    pub uv: [[f32; 2]; 2],
    /// In object space.
    pub object: [DVec3; 2],
}

/// The scene's textures, made ready for look-ups.
#[derive(Debug)]
pub struct TextureSet<'s> {
    lookups: Vec<Lookup<'s>>,
    /// Pyramids by image and [`Encoding`]; none where nothing asks for them.
    pyramids: Vec<[Option<MipMap>; 2]>,
}

#[derive(Debug)]
enum Lookup<'s> {
    /// An image of one colour, by [`Encoding`].
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

/// Look-ups along the longer axis of a footprint, at most: as many as GPUs take.
const MAX_PROBES: f64 = 16.0;

impl<'s> TextureSet<'s> {
    /// Prepares the textures of a scene that has been validated.
    pub fn new(scene: &'s Scene) -> TextureSet<'s> {
        TextureSet::of_effects(scene, EffectSet::ALL)
    }

    /// Prepares them for look-ups by these effects only, and without halved images where [`Effect::TextureFilter`] is
    /// not among them.
    pub fn of_effects(scene: &'s Scene, effects: EffectSet) -> TextureSet<'s> {
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
        let wanted = wanted_pyramids(scene, &lookups, effects);
        let pyramids = parallel::map(scene.images.len(), &|index| {
            [Encoding::Srgb, Encoding::Linear].map(|encoding| {
                wanted
                    .contains(&(index, slot(encoding)))
                    .then(|| MipMap::new(Grid::of_image(&scene.images[index], encoding), encoding))
            })
        });
        TextureSet { pyramids, lookups }
    }

    /// The linear RGBA of a texture at a point, averaged over the point's widths.
    ///
    /// `encoding` says how bytes are meant. A pyramid exists for the encodings that the scene's materials ask for;
    /// others take the finest level. Coordinates that are not finite count as 0.
    ///
    /// # Panics
    /// If the scene has no such texture.
    pub fn sample(&self, texture: u32, encoding: Encoding, at: &TexturePoint) -> [f32; 4] {
        match &self.lookups[texture as usize] {
            Lookup::Constant(colors) => colors[slot(encoding)],
            Lookup::Image(lookup) => {
                self.texels(lookup, encoding, finite(at.uv), lookup.texels_across(at.uv_width))
            }
            Lookup::Procedural(procedural) => {
                let (p, width) = place(procedural, at);
                procedural::sample(procedural, p, procedural::isotropic(procedural, p, width))
            }
        }
    }

    /// The same, averaged over a footprint that may be longer than wide; the widths of `at` do not count.
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
            Lookup::Constant(colors) => colors[slot(encoding)],
            Lookup::Image(lookup) if lookup.sampler.filter != Filter::Mipmap => {
                self.texels(lookup, encoding, finite(at.uv), 0.0)
            }
            Lookup::Image(lookup) => {
                let size = DVec3::new(lookup.image.width.into(), lookup.image.height.into(), 0.0);
                let axes = footprint.uv.map(|axis| plane(finite(axis)) * size);
                let probes = Probes::along(axes);
                let width = axes[1].length().max(axes[0].length() / probes.count);
                let uv = plane(finite(at.uv));
                probes.mean(|aside| {
                    let uv = uv + aside / size.with_z(1.0);
                    self.texels(lookup, encoding, [uv.x, uv.y], width)
                })
            }
            Lookup::Procedural(procedural) => {
                let (p, _) = place(procedural, at);
                let axes = match procedural.space {
                    Space::Uv => footprint.uv.map(|axis| plane(finite(axis))),
                    Space::Object => footprint.object,
                };
                let probes = Probes::along(axes);
                let width = axes[1].abs() + axes[0].abs() / probes.count;
                probes.mean(|aside| procedural::sample(procedural, p + aside, width))
            }
        }
    }

    /// The slope of a height map, R: derivatives by the surface's own u and v, before the layer's transform.
    ///
    /// `derivatives` are those of the point in object space by these u and v; procedures in object space need them.
    /// Images are mixed bilinearly whatever their sampler says, and their slope is taken over one texel, or over the
    /// width of the ray where that is more.
    ///
    /// # Panics
    /// If the scene has no such texture.
    pub fn height_gradient(
        &self,
        layer: &TextureUse,
        at: &TexturePoint,
        derivatives: [DVec3; 2],
    ) -> [f32; 2] {
        let by_uv = match &self.lookups[layer.texture as usize] {
            Lookup::Constant(_) => return [0.0; 2],
            Lookup::Image(lookup) => self.image_slope(lookup, at),
            Lookup::Procedural(procedural) => {
                let (p, width) = place(procedural, at);
                let width = procedural::isotropic(procedural, p, width);
                let gradient = procedural::gradient(procedural, p, width);
                if procedural.space == Space::Object {
                    return derivatives.map(|derivative| gradient.dot(derivative) as f32);
                }
                [gradient.x, gradient.y]
            }
        };
        let matrix = layer.transform.matrix;
        [0, 1].map(|i| (by_uv[0] * f64::from(matrix[0][i]) + by_uv[1] * f64::from(matrix[1][i])) as f32)
    }

    /// The colour of a texture that has one colour only.
    pub fn constant(&self, texture: u32, encoding: Encoding) -> Option<[f32; 4]> {
        match &self.lookups[texture as usize] {
            Lookup::Constant(colors) => Some(colors[slot(encoding)]),
            Lookup::Image(_) | Lookup::Procedural(_) => None,
        }
    }

    /// Bytes of the halved images.
    pub fn level_byte_count(&self) -> usize {
        self.pyramids
            .iter()
            .flatten()
            .flatten()
            .map(MipMap::byte_count)
            .sum()
    }

    /// An image where the ray is `width` texels wide.
    fn texels(&self, lookup: &ImageLookup, encoding: Encoding, uv: [f64; 2], width: f64) -> [f32; 4] {
        let finest = Grid::of_image(lookup.image, encoding);
        match (
            lookup.sampler.filter,
            &self.pyramids[lookup.index][slot(encoding)],
        ) {
            (Filter::Nearest, _) => finest.nearest(lookup.sampler, uv),
            (Filter::Mipmap, Some(pyramid)) => pyramid.trilinear(finest, lookup.sampler, uv, width),
            (Filter::Linear | Filter::Mipmap, _) => finest.bilinear(lookup.sampler, uv),
        }
    }

    fn image_slope(&self, lookup: &ImageLookup, at: &TexturePoint) -> [f64; 2] {
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
    /// A width in uv, in texels. The geometric mean of both sides counts as the size of the image: where uv is
    /// stretched so that texels are square on the surface, that is their number along either side.
    fn texels_across(&self, uv_width: f32) -> f64 {
        f64::from(uv_width) * (f64::from(self.image.width) * f64::from(self.image.height)).sqrt()
    }
}

/// Points along the longer axis of a footprint that share it evenly.
struct Probes {
    count: f64,
    axis: DVec3,
}

impl Probes {
    fn along([longer, shorter]: [DVec3; 2]) -> Probes {
        let ratio = (longer.length() / shorter.length()).ceil();
        Probes {
            // An axis of no length leaves no ratio; NaN means neither has any.
            count: if ratio > 1.0 { ratio.min(MAX_PROBES) } else { 1.0 },
            axis: longer,
        }
    }

    /// The mean of `look` at every offset from the middle.
    fn mean(&self, look: impl Fn(DVec3) -> [f32; 4]) -> [f32; 4] {
        let mut sum = [0.0; 4];
        for probe in 0..self.count as usize {
            let aside = self.axis * ((probe as f64 + 0.5) / self.count - 0.5);
            let color = look(aside);
            (0..4).for_each(|c| sum[c] += color[c]);
        }
        sum.map(|x| x / self.count as f32)
    }
}

/// Where a procedure is asked, and the width of the ray there.
fn place(procedural: &Procedural, at: &TexturePoint) -> (DVec3, f64) {
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

fn slot(encoding: Encoding) -> usize {
    match encoding {
        Encoding::Srgb => 0,
        Encoding::Linear => 1,
    }
}

/// What is seen of images that were not read.
const WHITE: [f32; 4] = [1.0; 4];

/// The colours, by encoding, of an image whose texels are all the same.
fn constant(image: &Image) -> Option<[[f32; 4]; 2]> {
    let same = match &image.texels {
        Texels::Bytes(texels) => all_same(texels),
        Texels::Floats(texels) => all_same(texels),
        Texels::Unread => return Some([WHITE; 2]),
    };
    same.then(|| {
        [Encoding::Srgb, Encoding::Linear].map(|encoding| Grid::of_image(image, encoding).texel(0, 0))
    })
}

fn all_same<T: PartialEq>(texels: &[T]) -> bool {
    texels.windows(2).all(|pair| pair[0] == pair[1]) && !texels.is_empty()
}

/// Images and encodings of which the materials look up some by the width of the ray.
fn wanted_pyramids(scene: &Scene, lookups: &[Lookup], effects: EffectSet) -> HashSet<(usize, usize)> {
    let layers = scene.materials.iter().flat_map(|material| &material.layers);
    layers
        .filter(|layer| effects.has(Effect::TextureFilter) && effects.has(layer.effect()))
        .filter_map(|layer| match &lookups[layer.texture.texture as usize] {
            Lookup::Image(lookup) if lookup.sampler.filter == Filter::Mipmap => {
                Some((lookup.index, slot(layer.parameter.encoding())))
            }
            _ => None,
        })
        .collect()
}

#[cfg(test)]
mod tests;
