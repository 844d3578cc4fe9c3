//! Extension objects of materials and textures, read from raw JSON.
//!
//! An absent member has the extension's default. One of the wrong type or out of range is corrected with a warning: an
//! extension refines an image and is no reason to reject the file.

use std::ops::RangeInclusive;

use gltf::json;
use serde_json::{Map, Value};

/// Names of factors that had to be corrected, each once.
#[derive(Default)]
pub(super) struct Corrections {
    pub(super) names: Vec<&'static str>,
}

impl Corrections {
    /// Returns `x` clamped to its range, or `default` if it is not a number; records a correction.
    pub(super) fn within(
        &mut self,
        name: &'static str,
        x: f64,
        range: RangeInclusive<f64>,
        default: f64,
    ) -> f64 {
        if range.contains(&x) {
            return x;
        }
        self.note(name);
        if x.is_nan() {
            default
        } else {
            x.clamp(*range.start(), *range.end())
        }
    }

    /// Records that a factor was corrected.
    pub(super) fn note(&mut self, name: &'static str) {
        if !self.names.contains(&name) {
            self.names.push(name);
        }
    }
}

/// The members of an extension's object; empty if the extension is absent.
#[derive(Clone, Copy)]
pub(super) struct Extension<'a> {
    members: Option<&'a Map<String, Value>>,
}

impl<'a> Extension<'a> {
    /// Finds the extension of this name among `all`.
    pub(super) fn of(
        all: Option<&'a Map<String, Value>>,
        name: &'static str,
        corrections: &mut Corrections,
    ) -> Extension<'a> {
        let members = all.and_then(|all| all.get(name)).and_then(|value| {
            if !value.is_object() {
                corrections.note(name);
            }
            value.as_object()
        });
        Extension { members }
    }

    /// Returns the object that is a member of this one; empty if it is absent.
    pub(super) fn nested(&self, name: &'static str, corrections: &mut Corrections) -> Extension<'a> {
        Extension::of(self.members, name, corrections)
    }

    /// Returns a truth value.
    pub(super) fn flag(&self, name: &'static str, default: bool, corrections: &mut Corrections) -> bool {
        let Some(value) = self.member(name) else {
            return default;
        };
        if !value.is_boolean() {
            corrections.note(name);
        }
        value.as_bool().unwrap_or(default)
    }

    pub(super) fn is_present(&self) -> bool {
        self.members.is_some()
    }

    /// Returns a number within `range`.
    pub(super) fn number(
        &self,
        name: &'static str,
        default: f64,
        range: RangeInclusive<f64>,
        corrections: &mut Corrections,
    ) -> f64 {
        let x = self.member(name).map_or(default, number);
        corrections.within(name, x, range, default)
    }

    /// Returns as many numbers as `default` has, each within `range`.
    pub(super) fn vector<const N: usize>(
        &self,
        name: &'static str,
        default: [f64; N],
        range: RangeInclusive<f64>,
        corrections: &mut Corrections,
    ) -> [f64; N] {
        let Some(value) = self.member(name) else {
            return default;
        };
        let Some(values) = value.as_array().filter(|values| values.len() == N) else {
            corrections.note(name);
            return default;
        };
        std::array::from_fn(|i| corrections.within(name, number(&values[i]), range.clone(), default[i]))
    }

    /// Returns an index, if there is a valid one.
    pub(super) fn index(&self, name: &'static str, corrections: &mut Corrections) -> Option<u32> {
        let value = self.member(name)?;
        let index = value.as_u64().and_then(|index| u32::try_from(index).ok());
        if index.is_none() {
            corrections.note(name);
        }
        index
    }

    /// Returns an index by a name that the file chooses, if there is a valid one.
    pub(super) fn named_index(&self, name: &str) -> Option<u32> {
        u32::try_from(self.member(name)?.as_u64()?).ok()
    }

    /// Returns a reference to a texture, if there is a valid one.
    pub(super) fn texture(
        &self,
        name: &'static str,
        corrections: &mut Corrections,
    ) -> Option<json::texture::Info> {
        let info = json::deserialize::from_value(self.member(name)?.clone()).ok();
        if info.is_none() {
            corrections.note(name);
        }
        info
    }

    fn member(&self, name: &str) -> Option<&'a Value> {
        self.members?.get(name)
    }
}

/// Returns the number, or NaN for any other JSON value.
fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn invalid_members_get_defaults_and_numbers_are_clamped() {
        let all = json!({"X": {"a": "2", "b": 7, "c": [1, 2], "d": [1, "x", -1], "e": -1, "f": {"index": -1}}, "Y": 3});
        let mut corrections = Corrections::default();
        let x = Extension::of(all.as_object(), "X", &mut corrections);
        let (unit, fixes) = (0.0..=1.0, &mut corrections);
        assert_eq!(x.number("a", 0.5, unit.clone(), fixes), 0.5);
        assert_eq!(x.number("b", 0.5, unit.clone(), fixes), 1.0);
        assert_eq!(x.number("absent", 0.5, unit.clone(), fixes), 0.5);
        assert_eq!(x.vector("c", [0.5; 3], unit.clone(), fixes), [0.5; 3]);
        assert_eq!(x.vector("d", [0.5; 3], unit, fixes), [1.0, 0.5, 0.0]);
        assert_eq!(x.index("e", fixes), None);
        assert!(x.texture("f", fixes).is_none());
        assert!(!Extension::of(all.as_object(), "Y", fixes).is_present());
        assert!(!Extension::of(all.as_object(), "Z", fixes).is_present());
        assert_eq!(corrections.names, ["a", "b", "c", "d", "e", "f", "Y"]);
    }
}
