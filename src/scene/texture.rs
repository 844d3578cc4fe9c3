//! Textures: images and procedures, how they are looked up, and which parameter of a material they change.

use std::path::Path;
use std::sync::Arc;

use super::Effect;
use crate::image::{self, DecodedPixels, ImageError, TransferCurve};

/// A texture on a parameter of a material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureBinding {
    /// What is changed.
    pub parameter: MaterialInput,
    /// By which texture.
    pub texture: TextureUse,
    /// glTF's scale of a normal map, strength of an occlusion map; height in metres of white in a bump map; 1
    /// elsewhere.
    pub strength: f32,
}

impl TextureBinding {
    /// The effect that it is a part of.
    pub fn effect(&self) -> Effect {
        self.parameter.effect()
    }
}

/// What a texture may change. Colours are sRGB-encoded in 8-bit images, everything else is linear. Values multiply the
/// material's own, unless said otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MaterialInput {
    /// Base colour and coverage.
    BaseColor,
    /// Emission.
    Emission,
    /// glTF's packing: roughness in G, metalness in B.
    MetallicRoughness,
    /// Roughness by R.
    Roughness,
    /// Metalness by R.
    Metallic,
    /// Strength of a dielectric's reflection, in A.
    Specular,
    /// Its colour; the lecture's rsp.
    SpecularColor,
    /// The lecture's kr.
    Reflection,
    /// Transmission, in R; the lecture's kt in RGB.
    Transmission,
    /// How much of the ambient light arrives, in R.
    Occlusion,
    /// Replaces the normal: tangent space, (RGB * 2 - 1).
    Normal,
    /// Bends the normal by the slope of a height, in R.
    Bump,
}

impl MaterialInput {
    /// The effect that a texture on it belongs to.
    pub fn effect(self) -> Effect {
        match self {
            MaterialInput::Normal | MaterialInput::Bump => Effect::NormalMap,
            MaterialInput::Occlusion => Effect::Occlusion,
            _ => Effect::Texture,
        }
    }

    /// How 8-bit images of it are meant.
    pub fn encoding(self) -> Encoding {
        match self {
            MaterialInput::BaseColor | MaterialInput::Emission | MaterialInput::SpecularColor => {
                Encoding::Srgb
            }
            MaterialInput::Reflection | MaterialInput::Transmission => Encoding::Linear,
            MaterialInput::MetallicRoughness | MaterialInput::Roughness | MaterialInput::Metallic => {
                Encoding::Linear
            }
            MaterialInput::Specular | MaterialInput::Occlusion => Encoding::Linear,
            MaterialInput::Normal | MaterialInput::Bump => Encoding::Linear,
        }
    }
}

/// How the bytes of an image are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// RGB by the sRGB curve, alpha linear.
    Srgb,
    /// All channels linear.
    Linear,
}

/// A texture and where it is looked up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureUse {
    /// Index into [`crate::scene::Scene::textures`].
    pub texture: u32,
    /// Which set of texture coordinates of the mesh. Analytic shapes have one set.
    pub tex_coord: u32,
    /// What is done to the coordinates first.
    pub transform: UvTransform,
}

impl TextureUse {
    /// A texture by the first set of coordinates as they are.
    pub fn new(texture: u32) -> TextureUse {
        TextureUse {
            texture,
            tex_coord: 0,
            transform: UvTransform::IDENTITY,
        }
    }
}

/// An affine map of texture coordinates (`KHR_texture_transform`): `uv' = matrix uv + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UvTransform {
    /// Rows of the linear part.
    pub matrix: [[f32; 2]; 2],
    /// Added after it.
    pub offset: [f32; 2],
}

impl UvTransform {
    /// Changes nothing.
    pub const IDENTITY: UvTransform = UvTransform {
        matrix: [[1.0, 0.0], [0.0, 1.0]],
        offset: [0.0; 2],
    };

    /// The mapped coordinates.
    #[inline(always)]
    pub fn apply(&self, [u, v]: [f32; 2]) -> [f32; 2] {
        let row = |i: usize| self.matrix[i][0] * u + self.matrix[i][1] * v + self.offset[i];
        [row(0), row(1)]
    }
}

/// Something that gives a colour for every point.
#[derive(Clone, Debug, PartialEq)]
pub enum Texture {
    /// An image on texture coordinates.
    Image {
        /// Index into [`crate::scene::Scene::images`].
        image: u32,
        /// Wrapping and filtering.
        sampler: Sampler,
    },
    /// A rule.
    Procedural(Procedural),
}

/// A pattern without an image. Colours are linear RGBA.
#[derive(Clone, Debug, PartialEq)]
pub struct Procedural {
    /// Which rule.
    pub pattern: Pattern,
    /// Colours between which the pattern chooses or mixes.
    pub colors: [[f32; 4]; 2],
    /// Which point the rule is asked about.
    pub space: Space,
    /// What each coordinate of that point is multiplied by.
    pub scale: [f64; 3],
}

/// The rules of procedural textures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pattern {
    /// Squares, or cubes, of side 1 in alternation.
    Checker,
    /// From the first colour at 0 to the second at 1 along the first coordinate.
    Gradient,
    /// Perlin's improved noise, summed over octaves.
    Noise {
        /// Number of octaves, each of twice the frequency and half the height of the one before; 1 to 16.
        octaves: u32,
    },
    /// Veins: a sine along the first coordinate, shifted by turbulence.
    Marble {
        /// Octaves of the turbulence.
        octaves: u32,
        /// How far it shifts.
        turbulence: f64,
    },
    /// Rings around the third axis, shifted by noise.
    Wood {
        /// How far noise shifts the rings.
        turbulence: f64,
    },
}

/// Where a procedural texture lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Space {
    /// On the surface's texture coordinates.
    Uv,
    /// In object space, as if the object were carved from it.
    Object,
}

/// Wrapping and filtering of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampler {
    /// Along u.
    pub wrap_u: Wrap,
    /// Along v.
    pub wrap_v: Wrap,
    /// Between texels.
    pub filter: Filter,
}

/// What lies outside [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// The image again.
    Repeat,
    /// The image mirrored.
    MirroredRepeat,
    /// The edge texel.
    ClampToEdge,
}

/// What lies between texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// The nearest texel.
    Nearest,
    /// The bilinear mix of four.
    Linear,
    /// Trilinear: bilinear mixes of two of the halved images, by the width of the ray.
    Mipmap,
}

/// A decoded image, top row first.
#[derive(Clone, Debug)]
pub struct Image {
    /// What messages call it: its path or its number in the file.
    pub name: String,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Its pixels, row by row.
    pub texels: Texels,
}

impl Image {
    /// Reads the file at `path`: PNG, JPEG, Radiance HDR or EXR, of at most `max_texels` pixels of 8 bits a channel;
    /// those that become floats count four times.
    ///
    /// `encoding` says how images of 16 bits a channel are meant, which become floats; those of 8 bits keep their
    /// codes.
    pub fn read(path: &Path, encoding: Encoding, max_texels: u64) -> Result<Image, ImageError> {
        let curve = match encoding {
            Encoding::Srgb => TransferCurve::Srgb,
            Encoding::Linear => TransferCurve::Linear,
        };
        let read = image::read(path, curve, max_texels)?;
        Ok(Image {
            name: path.display().to_string(),
            width: read.width,
            height: read.height,
            texels: match read.pixels {
                DecodedPixels::Bytes(texels) => Texels::Bytes(texels.into()),
                DecodedPixels::Floats(texels) => Texels::Floats(texels.into()),
            },
        })
    }
}

impl Image {
    /// The image of the file at `path`, of which only the kind and the size are read: its pixels may be anything.
    pub fn unread(path: &Path) -> Result<Image, ImageError> {
        let [width, height] = image::read_size(path)?;
        Ok(Image {
            name: path.display().to_string(),
            width,
            height,
            texels: Texels::Unread,
        })
    }
}

/// The pixels of an image; copies share them.
#[derive(Clone, Debug, PartialEq)]
pub enum Texels {
    /// RGBA, 8 bits each, as stored.
    Bytes(Arc<Vec<[u8; 4]>>),
    /// Linear RGBA (EXR, Radiance HDR, 16 bits a channel).
    Floats(Arc<Vec<[f32; 4]>>),
    /// Left in the file, as nothing that is simulated looks at them; who does all the same sees white.
    Unread,
}

impl Texels {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Texels::Bytes(texels) => texels.len(),
            Texels::Floats(texels) => texels.len(),
            Texels::Unread => 0,
        }
    }

    /// Bytes in memory.
    pub fn byte_count(&self) -> u64 {
        match self {
            Texels::Bytes(texels) => size_of_val(&texels[..]) as u64,
            Texels::Floats(texels) => size_of_val(&texels[..]) as u64,
            Texels::Unread => 0,
        }
    }

    /// What they take of a budget of texels of 8 bits a channel.
    pub fn budget(&self) -> u64 {
        self.byte_count() / size_of::<[u8; 4]>() as u64
    }

    /// Whether anybody else holds them too.
    pub(super) fn is_shared(&self) -> bool {
        match self {
            Texels::Bytes(texels) => Arc::strong_count(texels) > 1,
            Texels::Floats(texels) => Arc::strong_count(texels) > 1,
            Texels::Unread => false,
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
