//! Objects of a scene file after name resolution: trees whose leaves are geometries of the scene.

use std::ops::Range;
use std::rc::Rc;
use std::sync::Arc;

use glam::DAffine3;

use super::fault::Source;
use super::light::EmissiveForm;
use super::placement::Copies;
use super::value::Located;
use super::volume::MadeVolume;
use crate::scene::{Camera, Light};

/// Objects that are placed together: those of a group or of a file.
#[derive(Debug, Default)]
pub(super) struct ObjectTree {
    pub(super) nodes: Vec<Node>,
    pub(super) lights: Vec<Light>,
    pub(super) cameras: Vec<Camera>,
    pub(super) volumes: Vec<PlacedVolume>,
    /// Number of instances and volumes in all, after flattening.
    pub(super) count: u64,
}

/// A volume with its source location for messages.
#[derive(Debug)]
pub(super) struct PlacedVolume {
    pub(super) made: MadeVolume,
    pub(super) source: Rc<Source>,
    pub(super) span: Range<usize>,
}

/// An object whose references are resolved.
#[derive(Debug)]
pub(super) struct Node {
    pub(super) name: Arc<str>,
    /// The object's own transforms at the start and at the end of motions.
    pub(super) maps: [DAffine3; 2],
    pub(super) copies: Option<Copies>,
    pub(super) what: ObjectKind,
    pub(super) material: Option<u32>,
    pub(super) lights: bool,
    pub(super) cameras: bool,
    /// Settings of the lights on its emissive surfaces, if they are to light the scene.
    pub(super) emissive: Option<EmissiveSettings>,
    /// Source file for messages about the object.
    pub(super) source: Rc<Source>,
    pub(super) span: Range<usize>,
}

/// Settings of an object whose emission lights the scene.
#[derive(Debug)]
pub(super) struct EmissiveSettings {
    /// Samples of each light per shading point.
    pub(super) samples: u32,
    /// Span of the `lamp` key, for messages.
    pub(super) span: Range<usize>,
}

impl EmissiveSettings {
    pub(super) fn of(form: &Located<EmissiveForm>) -> Option<EmissiveSettings> {
        form.0.map(|samples| EmissiveSettings {
            samples,
            span: form.span.clone(),
        })
    }
}

/// Content of an object after name resolution.
#[derive(Debug)]
pub(super) enum ObjectKind {
    /// A geometry, by its index in the scene.
    Geometry(u32),
    ObjectTree(Rc<ObjectTree>),
    /// Meshes of a glTF file, which have materials of their own.
    Import(Rc<ObjectTree>),
}
