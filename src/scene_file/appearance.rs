//! Loading of the textures and materials of a scene file.
//!
//! An image file does not state whether its values are colours or data; the material input that uses it does. So the
//! uses of each texture are collected from the materials first, and images are then decoded as colours, as data, or as
//! both.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use super::SceneFileError;
use super::assembly::{Resolver, find};
use super::document::Document;
use super::fault::{Diagnostic, Source};
use super::texture::{TextureForm, TextureKind};
use super::value::Located;
use crate::image::ImageError;
use crate::scene::{Effect, Encoding, Image, ImageCache, Texels, Texture, TextureBinding, TextureUse};

impl Resolver {
    /// Loads textures and materials into the scene; returns the indices of the materials by name.
    pub(super) fn materials(
        &mut self,
        source: &Source,
        path: &Path,
        document: &Document,
    ) -> Result<HashMap<String, u32>, SceneFileError> {
        // Load the textures, decoded for their uses
        let uses = self.uses(document);
        let mut textures = HashMap::new();
        for (name, form) in &document.texture {
            let uses = uses.get(name.as_str()).copied().unwrap_or_default();
            let made = self.texture(path, form, uses).map_err(|f| source.error(f))?;
            textures.insert(name.clone(), made);
        }
        // Make the materials and check their keys
        let mut materials = HashMap::new();
        for (name, form) in &document.material {
            let refuse = |sentence: String| source.error(form.fault(sentence));
            let mut material = form.material(name).map_err(refuse)?;
            form.scatter(&mut material).map_err(|fault| source.error(fault))?;
            // Bind textures to the inputs that they can affect
            for layer in form.layers() {
                if !material.is_affected_by(layer.parameter, layer.strength) {
                    continue;
                }
                let made = find("texture", layer.texture, &textures).map_err(|f| source.error(f))?;
                let texture = made.of(layer.parameter.encoding());
                material.layers.push(TextureBinding {
                    parameter: layer.parameter,
                    texture: TextureUse {
                        texture,
                        tex_coord: layer.tex_coord,
                        transform: layer.transform,
                    },
                    strength: layer.strength,
                });
            }
            // Check the material with its textures
            self.scene.check_material(&material).map_err(refuse)?;
            let index = self.scene.materials.len() as u32;
            materials.insert(name.clone(), index);
            if form.rough_rays.is_some() {
                self.exact_rough_rays.insert(index);
            }
            self.scene.materials.push(material);
        }
        Ok(materials)
    }

    /// Collects the uses of each texture by materials that some object names, on inputs that it affects and that are
    /// simulated.
    fn uses<'d>(&self, document: &'d Document) -> HashMap<&'d str, Uses> {
        // Collect the names of materials that objects use
        let groups = document.group.values().flat_map(|group| &group.object);
        let named = document.object.iter().chain(groups);
        let named: HashSet<&str> = named
            .filter_map(|object| object.material.as_ref().map(|name| name.as_str()))
            .collect();
        let mut uses: HashMap<&str, Uses> = HashMap::new();
        for (name, form) in &document.material {
            // An invalid material is reported where it is made.
            let Ok(material) = form.material(name) else {
                continue;
            };
            for layer in form.layers() {
                // Ignore textures that cannot change the image
                let is_used = named.contains(name.as_str())
                    && material.is_affected_by(layer.parameter, layer.strength)
                    && !self.without.has(layer.parameter.effect());
                if is_used {
                    uses.entry(layer.texture)
                        .or_default()
                        .add(layer.parameter.encoding());
                }
            }
        }
        uses
    }

    /// Adds a texture of the file at `path` to the scene; an image is decoded once per use, or not at all if unused.
    fn texture(
        &mut self,
        path: &Path,
        form: &Located<TextureForm>,
        uses: Uses,
    ) -> Result<MadeTexture, Diagnostic> {
        // A pattern needs no image
        let (file, sampler) = match form.kind().map_err(|s| form.fault(s))? {
            TextureKind::Procedural(procedural) => {
                return Ok(MadeTexture::one(
                    self.add_texture(Texture::Procedural(procedural)),
                ));
            }
            TextureKind::Image { file, sampler } => (file, sampler),
        };
        let full = path.with_file_name(&**file);
        let (first, data) = read_images(&full, uses, (&self.image_cache, self.texels_left))
            .map_err(|error| file.fault(format!("the image {error}")))?;
        // Charge each image to the budget and add it with a texture of its own
        let mut add = |image: Image| {
            self.texels_left -= image.texels.budget().min(self.texels_left);
            self.scene.images.push(image);
            let image = self.scene.images.len() as u32 - 1;
            self.add_texture(Texture::Image { image, sampler })
        };
        let made = MadeTexture::one(add(first));
        Ok(match data {
            Some(data) => MadeTexture {
                data: add(data),
                ..made
            },
            None => made,
        })
    }

    /// Loads the environment map of the file at `path`, if it has one; returns the image's index.
    pub(super) fn environment_map(
        &mut self,
        source: &Source,
        path: &Path,
        document: &Document,
    ) -> Result<u32, SceneFileError> {
        let index = self.scene.images.len() as u32;
        if let Some(file) = document.background.as_ref().and_then(|form| form.file()) {
            let full = path.with_file_name(&**file);
            // Read only the size of a map that no effect uses
            let is_used = [Effect::Background, Effect::Environment]
                .into_iter()
                .any(|effect| !self.without.has(effect));
            let read = match is_used {
                true => self.image_cache.read(&full, Encoding::Linear, self.texels_left),
                false => Image::unread(&full),
            };
            let image = read.map_err(|error| source.error(file.fault(format!("the image {error}"))))?;
            self.texels_left -= image.texels.budget().min(self.texels_left);
            self.scene.images.push(image);
        }
        Ok(index)
    }

    fn add_texture(&mut self, texture: Texture) -> u32 {
        self.scene.textures.push(texture);
        self.scene.textures.len() as u32 - 1
    }
}

/// Indices of a texture's two versions, for inputs that are colours and for inputs that are data.
#[derive(Clone, Copy)]
struct MadeTexture {
    color: u32,
    data: u32,
}

impl MadeTexture {
    fn one(index: u32) -> MadeTexture {
        MadeTexture {
            color: index,
            data: index,
        }
    }

    fn of(self, encoding: Encoding) -> u32 {
        match encoding {
            Encoding::Srgb => self.color,
            Encoding::Linear => self.data,
        }
    }
}

/// Interpretations of an image by the material inputs that use it.
#[derive(Clone, Copy, Debug, Default)]
struct Uses {
    color: bool,
    data: bool,
}

impl Uses {
    /// Adds a use by an input of this encoding.
    fn add(&mut self, encoding: Encoding) {
        match encoding {
            Encoding::Srgb => self.color = true,
            Encoding::Linear => self.data = true,
        }
    }
}

/// Reads the image at `path` within a budget, for colours and for data: one image if both give equal texels; only its
/// size if there is no use.
///
/// Only 16-bit images give different texels, as 8-bit values are decoded at lookup.
fn read_images(
    path: &Path,
    uses: Uses,
    (image_cache, max_texels): (&ImageCache, u64),
) -> Result<(Image, Option<Image>), ImageError> {
    if !(uses.data || uses.color) {
        return Ok((Image::unread(path)?, None));
    }
    if uses.data && !uses.color {
        return Ok((image_cache.read(path, Encoding::Linear, max_texels)?, None));
    }
    let color = image_cache.read(path, Encoding::Srgb, max_texels)?;
    if !(uses.data && matches!(color.texels, Texels::Floats(_))) {
        return Ok((color, None));
    }
    // The second image gets the rest of the budget
    let left = max_texels - color.texels.budget().min(max_texels);
    let data = image_cache.read(path, Encoding::Linear, left)?;
    // Equal texels, as of HDR and EXR files, are stored once
    let differs = data.texels != color.texels;
    Ok((color, differs.then_some(data)))
}
