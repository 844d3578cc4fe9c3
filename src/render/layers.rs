//! Layers: planes of what camera rays met first, beside a picture's colours.
//!
//! Every sample of a pixel asks one camera ray what surface it meets first; see-through and partly absent surfaces
//! count, volumes and fog do not. A pixel's values are means over those of its samples that met one, each weighed alike
//! whatever the picture's filter is; those of Cryptomatte are parts of all samples. Lengths and places are in the file's
//! coordinates.

use super::mattes::RANKS;
use super::region::Region;
use crate::image::ChannelKind;

/// A group of layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LayerKind {
    /// `Z`: the distance along the ray from where it starts; infinite where no sample met anything.
    Depth,
    /// `normal.X`, `normal.Y`, `normal.Z`: the unit shading normal in world space on the viewer's side. The mean of
    /// several is shorter than 1. 0 where no sample met anything.
    Normal,
    /// `albedo.R`, `albedo.G`, `albedo.B`: the base colour with its textures and vertex colours, linear RGB; of the
    /// lecture's materials, the diffuse part of it. 0 where no sample met anything.
    Albedo,
    /// `position.X`, `position.Y`, `position.Z`; 0 where no sample met anything.
    Position,
    /// `uv.U`, `uv.V`: the first set of texture coordinates; 0 without one, or where no sample met anything.
    Uv,
    /// `id.object`, `id.material`, `id.primitive`: of the first sample that met anything, the index of the instance, of
    /// its material, and of the mesh's triangle or the shape's part, from 0; -1 where none did. Whole numbers, exact up
    /// to 2^24.
    Ids,
    /// `motion.X`, `motion.Y`: by how many pixels, to the right and down, points of surfaces move in the picture from
    /// when the shutter opens to when it closes, as the camera moves too; 0 where no sample met anything. Points that are
    /// behind the camera before or after count as if they stood still.
    Motion,
    /// `CryptoObject00.R` to `CryptoObject02.A`: in turn the id of a name of instances, by Cryptomatte, and which part of
    /// the pixel's samples met those first; six names, the largest part first. 0 where there are no more. Samples that
    /// met nothing are in no part.
    CryptoObject,
    /// `CryptoMaterial00.R` to `CryptoMaterial02.A`: the same of the names of materials.
    CryptoMaterial,
}

impl LayerKind {
    /// All, in the order in which their layers come.
    pub const ALL: [LayerKind; 9] = [
        LayerKind::Depth,
        LayerKind::Normal,
        LayerKind::Albedo,
        LayerKind::Position,
        LayerKind::Uv,
        LayerKind::Ids,
        LayerKind::Motion,
        LayerKind::CryptoObject,
        LayerKind::CryptoMaterial,
    ];

    /// The names of its layers.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            LayerKind::Depth => &["Z"],
            LayerKind::Normal => &["normal.X", "normal.Y", "normal.Z"],
            LayerKind::Albedo => &["albedo.R", "albedo.G", "albedo.B"],
            LayerKind::Position => &["position.X", "position.Y", "position.Z"],
            LayerKind::Uv => &["uv.U", "uv.V"],
            LayerKind::Ids => &["id.object", "id.material", "id.primitive"],
            LayerKind::Motion => &["motion.X", "motion.Y"],
            LayerKind::CryptoObject => &CRYPTO_OBJECT,
            LayerKind::CryptoMaterial => &CRYPTO_MATERIAL,
        }
    }

    /// What Cryptomatte calls it, if it is one of its layers.
    pub fn cryptomatte(self) -> Option<&'static str> {
        match self {
            LayerKind::CryptoObject => Some("CryptoObject"),
            LayerKind::CryptoMaterial => Some("CryptoMaterial"),
            _ => None,
        }
    }

    /// Whether its layers are means over the samples that met anything.
    pub(super) fn is_sum(self) -> bool {
        self != LayerKind::Ids && self.cryptomatte().is_none()
    }

    /// Whether a file of halves may round them.
    fn rounding(self) -> ChannelKind {
        match self {
            LayerKind::Albedo => ChannelKind::Color,
            _ => ChannelKind::Exact,
        }
    }
}

/// Ids and coverages of two names to four channels.
const CRYPTO_OBJECT: [&str; 2 * RANKS] = [
    "CryptoObject00.R",
    "CryptoObject00.G",
    "CryptoObject00.B",
    "CryptoObject00.A",
    "CryptoObject01.R",
    "CryptoObject01.G",
    "CryptoObject01.B",
    "CryptoObject01.A",
    "CryptoObject02.R",
    "CryptoObject02.G",
    "CryptoObject02.B",
    "CryptoObject02.A",
];

/// As above.
const CRYPTO_MATERIAL: [&str; 2 * RANKS] = [
    "CryptoMaterial00.R",
    "CryptoMaterial00.G",
    "CryptoMaterial00.B",
    "CryptoMaterial00.A",
    "CryptoMaterial01.R",
    "CryptoMaterial01.G",
    "CryptoMaterial01.B",
    "CryptoMaterial01.A",
    "CryptoMaterial02.R",
    "CryptoMaterial02.G",
    "CryptoMaterial02.B",
    "CryptoMaterial02.A",
];

/// Some groups of layers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LayerSet(u16);

impl LayerSet {
    /// None.
    pub const NONE: LayerSet = LayerSet(0);

    /// The same and one more.
    #[must_use]
    pub fn with(self, kind: LayerKind) -> LayerSet {
        LayerSet(self.0 | (1 << kind as u16))
    }

    /// Whether it is one of them.
    #[inline(always)]
    pub fn has(self, kind: LayerKind) -> bool {
        self.0 & (1 << kind as u16) != 0
    }

    /// Whether there is none.
    pub fn is_empty(self) -> bool {
        self == LayerSet::NONE
    }

    /// They, in their order.
    pub fn kinds(self) -> impl Iterator<Item = LayerKind> {
        LayerKind::ALL.into_iter().filter(move |&kind| self.has(kind))
    }

    /// How many layers they are.
    pub fn layer_count(self) -> usize {
        self.kinds().map(|kind| kind.names().len()).sum()
    }
}

impl FromIterator<LayerKind> for LayerSet {
    fn from_iter<I: IntoIterator<Item = LayerKind>>(kinds: I) -> LayerSet {
        kinds.into_iter().fold(LayerSet::NONE, LayerSet::with)
    }
}

/// One value a pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// What a file calls it, as [`LayerKind`] lists.
    pub name: String,
    /// Whether a file of halves may round it.
    pub kind: ChannelKind,
    /// Row by row, the top row first.
    pub values: Vec<f32>,
}

impl Layer {
    /// One of all pixels of `region`, to be filled.
    pub(super) fn blank(name: String, kind: ChannelKind, region: &Region) -> Layer {
        Layer {
            name,
            kind,
            values: vec![0.0; region.width as usize * region.height as usize],
        }
    }
}

/// The layers of `region` that are wanted, to be filled.
pub(super) fn blank(wanted: LayerSet, region: &Region) -> Vec<Layer> {
    let layers = wanted
        .kinds()
        .flat_map(|kind| kind.names().iter().map(move |&name| (kind, name)));
    layers
        .map(|(kind, name)| Layer::blank(name.into(), kind.rounding(), region))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_has_what_was_put_into_it_in_one_order() {
        let set: LayerSet = [LayerKind::Ids, LayerKind::Depth].into_iter().collect();
        assert!(set.has(LayerKind::Ids) && set.has(LayerKind::Depth) && !set.has(LayerKind::Uv));
        assert_eq!(
            set.kinds().collect::<Vec<_>>(),
            [LayerKind::Depth, LayerKind::Ids]
        );
        // `Z` and three numbers.
        assert_eq!(set.layer_count(), 4);
        assert!(LayerSet::NONE.is_empty() && !set.is_empty());
        let all: LayerSet = LayerKind::ALL.into_iter().collect();
        assert_eq!(all.layer_count(), 41);
    }

    #[test]
    fn names_of_cryptomattes_begin_with_what_they_are_called() {
        for kind in LayerKind::ALL {
            let Some(called) = kind.cryptomatte() else {
                continue;
            };
            for (index, name) in kind.names().iter().enumerate() {
                // Four channels to a layer.
                let channel = ["R", "G", "B", "A"][index % 4];
                assert_eq!(*name, format!("{called}0{}.{channel}", index / 4));
            }
        }
    }
}
