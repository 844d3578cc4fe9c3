//! Extensions that a glTF file states, and how far images honour them.

use std::fmt;

use serde::Serialize;

/// Extension that a glTF file states.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ExtensionUse {
    /// Name of the extension, for example `KHR_materials_ior`.
    pub name: String,
    /// True if the file cannot be rendered without the extension, as it says itself.
    pub is_required: bool,
    /// Degree to which images honour the extension.
    pub support: ExtensionSupport,
}

/// Degree to which images honour an extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "kind", content = "note", rename_all = "snake_case")]
pub enum ExtensionSupport {
    /// Implemented as its specification says.
    Honoured,
    /// Implemented in part; the note says how images differ.
    Approximated(&'static str),
    /// Without effect on images, such as metadata.
    WithoutEffect,
    /// Not implemented; the note says what images lack.
    Ignored(&'static str),
}

impl ExtensionSupport {
    /// Returns whether images are as the extension specifies.
    pub fn is_exact(self) -> bool {
        matches!(self, ExtensionSupport::Honoured | ExtensionSupport::WithoutEffect)
    }
}

impl fmt::Display for ExtensionUse {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let ExtensionUse { name, support, .. } = self;
        match support {
            ExtensionSupport::Honoured => write!(f, "{name} (honoured)"),
            ExtensionSupport::Approximated(note) => write!(f, "{name} (approximated: {note})"),
            ExtensionSupport::WithoutEffect => write!(f, "{name} (without effect on images)"),
            ExtensionSupport::Ignored(note) => write!(f, "{name} (ignored: {note})"),
        }
    }
}
