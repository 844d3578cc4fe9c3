//! Textures: images and procedural patterns, their lookup, and the material inputs that they modify.

use std::path::Path;

use super::Effect;
use crate::buffer::Buffer;
use crate::image::{self, DecodedPixels, ImageError, TransferCurve};

/// A texture bound to a material input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureBinding {
    /// Material input that the texture modifies.
    pub parameter: MaterialInput,
    /// Texture with its coordinates.
    pub texture: TextureUse,
    /// Scale of a normal map or strength of an occlusion map, as in glTF; height in metres of white in a bump map; 1
    /// elsewhere.
    pub strength: f32,
}

impl TextureBinding {
    /// Returns the effect that this texture belongs to.
    pub fn effect(&self) -> Effect {
        self.parameter.effect()
    }
}

/// Material input that a texture can modify. Colours are sRGB-encoded in 8-bit images, everything else is linear.
/// Texture values multiply the material's own, unless said otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MaterialInput {
    /// Base colour in RGB, coverage in A.
    BaseColor,
    /// Emitted radiance in RGB.
    Emission,
    /// Packing of glTF: roughness in G, metalness in B.
    MetallicRoughness,
    /// Roughness in the R channel.
    Roughness,
    /// Metalness in the R channel.
    Metallic,
    /// Strength of a dielectric's reflection, in A.
    Specular,
    /// Colour of a dielectric's reflection; rsp of Phong and Whitted's model.
    SpecularColor,
    /// Coefficient kr of Phong and Whitted's model.
    Reflection,
    /// Transmission, in R; kt of Phong and Whitted's model in RGB.
    Transmission,
    /// Fraction of the ambient light that arrives, in R.
    Occlusion,
    /// Tangent-space normal (RGB * 2 - 1), which replaces the interpolated one.
    Normal,
    /// Height in R, whose slope tilts the normal.
    Bump,
    /// Diffuse transmission of a thin surface, in A.
    Translucency,
    /// Colour of the diffusely transmitted light.
    TranslucencyColor,
    /// Coated fraction of the surface, in R.
    Clearcoat,
    /// Roughness of the coat, in G.
    ClearcoatRoughness,
    /// Tangent-space normal of the coat.
    ClearcoatNormal,
    /// Colour of the sheen.
    SheenColor,
    /// Roughness of the sheen, in A.
    SheenRoughness,
    /// Direction of anisotropy in RG (times 2 - 1), by tangent and bitangent, and its strength in B.
    Anisotropy,
    /// Weight of the thin film, in R.
    Iridescence,
    /// Thickness of the thin film, in G, from its smallest to its largest.
    IridescenceThickness,
}

impl MaterialInput {
    /// Returns the effect that a texture on this input belongs to.
    pub fn effect(self) -> Effect {
        match self {
            MaterialInput::Normal | MaterialInput::Bump => Effect::NormalMap,
            MaterialInput::Occlusion => Effect::Occlusion,
            MaterialInput::Translucency | MaterialInput::TranslucencyColor => Effect::Translucency,
            MaterialInput::Clearcoat | MaterialInput::ClearcoatRoughness | MaterialInput::ClearcoatNormal => {
                Effect::Clearcoat
            }
            MaterialInput::SheenColor | MaterialInput::SheenRoughness => Effect::Sheen,
            MaterialInput::Anisotropy => Effect::Anisotropy,
            MaterialInput::Iridescence | MaterialInput::IridescenceThickness => Effect::Iridescence,
            _ => Effect::Texture,
        }
    }

    /// Returns the encoding of 8-bit images on this input.
    pub fn encoding(self) -> Encoding {
        match self {
            MaterialInput::BaseColor
            | MaterialInput::Emission
            | MaterialInput::SpecularColor
            | MaterialInput::TranslucencyColor
            | MaterialInput::SheenColor => Encoding::Srgb,
            MaterialInput::Reflection | MaterialInput::Transmission => Encoding::Linear,
            MaterialInput::MetallicRoughness | MaterialInput::Roughness | MaterialInput::Metallic => {
                Encoding::Linear
            }
            MaterialInput::Specular | MaterialInput::Occlusion => Encoding::Linear,
            MaterialInput::Normal | MaterialInput::Bump => Encoding::Linear,
            MaterialInput::Translucency
            | MaterialInput::Clearcoat
            | MaterialInput::ClearcoatRoughness
            | MaterialInput::ClearcoatNormal
            | MaterialInput::SheenRoughness
            | MaterialInput::Anisotropy
            | MaterialInput::Iridescence
            | MaterialInput::IridescenceThickness => Encoding::Linear,
        }
    }
}

/// Encoding of the channels of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// RGB by the sRGB curve, alpha linear.
    Srgb,
    /// Linear values in all channels.
    Linear,
}

/// A texture and the coordinates of its lookup.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureUse {
    /// Index of the texture in [`crate::scene::Scene::textures`].
    pub texture: u32,
    /// Number of the mesh's texture coordinate set. Analytic shapes have one set.
    pub tex_coord: u32,
    /// Transform of the coordinates before the lookup.
    pub transform: UvTransform,
}

impl TextureUse {
    /// Returns a use of the texture with the first coordinate set and no transform.
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
    /// Translation, added after the linear part.
    pub offset: [f32; 2],
}

impl UvTransform {
    /// The map that leaves coordinates unchanged.
    pub const IDENTITY: UvTransform = UvTransform {
        matrix: [[1.0, 0.0], [0.0, 1.0]],
        offset: [0.0; 2],
    };

    /// Returns the transformed texture coordinates.
    #[inline(always)]
    pub fn apply(&self, [u, v]: [f32; 2]) -> [f32; 2] {
        let row = |i: usize| self.matrix[i][0] * u + self.matrix[i][1] * v + self.offset[i];
        [row(0), row(1)]
    }
}

/// A function from points to colours.
#[derive(Clone, Debug, PartialEq)]
pub enum Texture {
    /// An image on texture coordinates.
    Image {
        /// Index of the image in [`crate::scene::Scene::images`].
        image: u32,
        /// Wrap modes and texel filter.
        sampler: Sampler,
    },
    /// A procedural pattern without an image.
    Procedural(Procedural),
}

/// A procedural texture. Colours are linear RGBA.
#[derive(Clone, Debug, PartialEq)]
pub struct Procedural {
    /// Pattern that is evaluated.
    pub pattern: Pattern,
    /// Colours that the pattern chooses from or mixes.
    pub colors: [[f32; 4]; 2],
    /// Space of the points at which the pattern is evaluated.
    pub space: Space,
    /// Factor on each coordinate of the point.
    pub scale: [f64; 3],
}

/// Patterns of procedural textures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pattern {
    /// Squares, or cubes, of side 1 in alternating colours.
    Checker,
    /// A ramp from the first colour at 0 to the second at 1 along the first coordinate.
    Gradient,
    /// Perlin's improved noise, summed over octaves.
    Noise {
        /// Number of octaves, each of twice the frequency and half the height of the one before; 1 to 16.
        octaves: u32,
    },
    /// Veins: a sine along the first coordinate, shifted by turbulence.
    Marble {
        /// Number of octaves of the turbulence.
        octaves: u32,
        /// Amplitude of the shift by turbulence.
        turbulence: f64,
    },
    /// Rings around the third axis, shifted by noise.
    Wood {
        /// Amplitude of the shift of the rings by noise.
        turbulence: f64,
    },
}

/// Space in which a procedural texture is evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Space {
    /// Texture coordinates of the surface.
    Uv,
    /// Object space, as if the object were carved from the pattern.
    Object,
}

/// Wrap modes and texel filter of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampler {
    /// Wrap mode along u.
    pub wrap_u: Wrap,
    /// Wrap mode along v.
    pub wrap_v: Wrap,
    /// Interpolation mode between texels.
    pub filter: Filter,
}

/// Lookup of texture coordinates outside [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// Repetition of the image.
    Repeat,
    /// Repetition, mirrored in every second copy.
    MirroredRepeat,
    /// Texel at the nearest edge.
    ClampToEdge,
}

/// Interpolation between texels of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// Nearest texel, without interpolation.
    Nearest,
    /// Bilinear interpolation of four texels.
    Linear,
    /// Trilinear interpolation: bilinear lookups in two mip levels, chosen by the width of the ray.
    Mipmap,
}

/// A decoded image, top row first.
#[derive(Clone, Debug)]
pub struct Image {
    /// Name in messages: the image's path or its number in the file.
    pub name: String,
    /// Number of pixels per row.
    pub width: u32,
    /// Number of pixel rows, from the top.
    pub height: u32,
    /// Pixels of the image, row by row.
    pub texels: Texels,
}

impl Image {
    /// Reads the file at `path`: PNG, JPEG, Radiance HDR or EXR, of at most `max_texels` pixels of 8 bits a channel;
    /// pixels that become floats count four times.
    ///
    /// `encoding` is the interpretation of images of 16 bits a channel, which become floats; those of 8 bits keep their
    /// stored values.
    pub fn read(path: &Path, encoding: Encoding, max_texels: u64) -> Result<Image, ImageError> {
        let curve = match encoding {
            Encoding::Srgb => TransferCurve::Srgb,
            Encoding::Linear => TransferCurve::Linear,
        };
        // The curve only applies to images that are decoded to floats
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
    /// Returns the image of the file at `path` without its pixels: only the kind and the size are read.
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

/// The pixels of an image; clones share them.
#[derive(Clone, Debug, PartialEq)]
pub enum Texels {
    /// RGBA, 8 bits per channel, as stored.
    Bytes(Buffer<[u8; 4]>),
    /// Linear RGBA floats (EXR, Radiance HDR, 16 bits a channel).
    Floats(Buffer<[f32; 4]>),
    /// Pixels left in the file, as no simulated effect uses them; a lookup returns white.
    Unread,
}

impl Texels {
    /// Returns the number of texels in memory.
    pub fn len(&self) -> usize {
        match self {
            Texels::Bytes(texels) => texels.len(),
            Texels::Floats(texels) => texels.len(),
            Texels::Unread => 0,
        }
    }

    /// Returns the size in memory in bytes.
    pub fn byte_count(&self) -> u64 {
        match self {
            Texels::Bytes(texels) => size_of_val(&texels[..]) as u64,
            Texels::Floats(texels) => size_of_val(&texels[..]) as u64,
            Texels::Unread => 0,
        }
    }

    /// Returns the size as a number of texels of 8 bits a channel, for comparison with a limit.
    pub fn budget(&self) -> u64 {
        self.byte_count() / size_of::<[u8; 4]>() as u64
    }

    /// Returns whether another image shares these texels.
    pub(super) fn is_shared(&self) -> bool {
        match self {
            Texels::Bytes(texels) => texels.is_shared(),
            Texels::Floats(texels) => texels.is_shared(),
            Texels::Unread => false,
        }
    }

    /// Returns whether no texels are in memory.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
