//! Materials and textures: glTF's metallic-roughness parameters, as they were read.

/// A surface description. Texture values multiply the factors.
#[derive(Clone, Debug)]
pub struct Material {
    /// What messages call it.
    pub name: String,
    /// Linear RGBA.
    pub base_color: [f32; 4],
    /// sRGB-encoded RGBA image for the base colour.
    pub base_color_texture: Option<TextureUse>,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 a mirror, 1 chalk.
    pub roughness: f32,
    /// Linear image: roughness in G, metalness in B.
    pub metallic_roughness_texture: Option<TextureUse>,
    /// Emitted radiance, linear RGB.
    pub emission: [f32; 3],
    /// sRGB-encoded image for the emission.
    pub emission_texture: Option<TextureUse>,
}

impl Default for Material {
    /// glTF's default material: white, metallic 1, roughness 1.
    fn default() -> Material {
        Material {
            name: "default".into(),
            base_color: [1.0; 4],
            base_color_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            emission: [0.0; 3],
            emission_texture: None,
        }
    }
}

impl Material {
    /// Whether it differs from point to point.
    pub fn is_textured(&self) -> bool {
        self.base_color_texture.is_some()
            || self.metallic_roughness_texture.is_some()
            || self.emission_texture.is_some()
    }
}

/// A texture on a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TextureUse {
    /// Index into [`crate::scene::Scene::textures`].
    pub texture: u32,
    /// Which set of texture coordinates of the mesh.
    pub tex_coord: u32,
}

/// An image and how it is looked up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Texture {
    /// Index into [`crate::scene::Scene::images`].
    pub image: u32,
    /// Wrapping and filtering.
    pub sampler: Sampler,
}

/// Wrapping and filtering of a texture.
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
    /// RGBA, 8 bits each, as stored.
    pub texels: Vec<[u8; 4]>,
}
