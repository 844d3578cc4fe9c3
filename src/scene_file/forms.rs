//! Values with several forms in a file, distinguished by their kind: a number, a text, a list or a table.
//!
//! serde's own `untagged` enums copy a value before they read it, and so lose its span in the file.

use std::marker::PhantomData;

/// Visitor of a value with several forms, for which [`forms!`](forms) implements the methods.
pub(crate) struct Forms<T>(pub(crate) PhantomData<T>);

/// Implements `Deserialize` for a type with several forms: its lifetime and generics, the type, what messages say that
/// may be given, and the result for each kind of value.
macro_rules! forms {
    ([$de:lifetime $($generics:tt)*] $type:ty, $expected:expr; $($kind:ident $value:ident => $result:expr;)+) => {
        impl<$de $($generics)*> serde::de::Visitor<$de> for $crate::scene_file::forms::Forms<$type> {
            type Value = $type;

            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                write!(f, "{}", $expected)
            }

            $($crate::scene_file::forms::form!($de $kind $value => $result);)+
        }

        impl<$de $($generics)*> serde::Deserialize<$de> for $type {
            fn deserialize<D: serde::Deserializer<$de>>(deserializer: D) -> Result<Self, D::Error> {
                deserializer.deserialize_any($crate::scene_file::forms::Forms::<$type>(std::marker::PhantomData))
            }
        }
    };
}

/// Expands to the methods of a visitor for one kind of value.
macro_rules! form {
    ($de:lifetime number $value:ident => $result:expr) => {
        fn visit_f64<E: serde::de::Error>(self, $value: f64) -> Result<Self::Value, E> {
            $result
        }

        fn visit_i64<E: serde::de::Error>(self, $value: i64) -> Result<Self::Value, E> {
            serde::de::Visitor::visit_f64(self, $value as f64)
        }
    };
    ($de:lifetime integer $value:ident => $result:expr) => {
        fn visit_i64<E: serde::de::Error>(self, $value: i64) -> Result<Self::Value, E> {
            $result
        }
    };
    ($de:lifetime boolean $value:ident => $result:expr) => {
        fn visit_bool<E: serde::de::Error>(self, $value: bool) -> Result<Self::Value, E> {
            $result
        }
    };
    ($de:lifetime text $value:ident => $result:expr) => {
        fn visit_str<E: serde::de::Error>(self, $value: &str) -> Result<Self::Value, E> {
            $result
        }
    };
    ($de:lifetime list $value:ident => $result:expr) => {
        fn visit_seq<A: serde::de::SeqAccess<$de>>(self, list: A) -> Result<Self::Value, A::Error> {
            let $value = serde::de::value::SeqAccessDeserializer::new(list);
            $result
        }
    };
    ($de:lifetime table $value:ident => $result:expr) => {
        fn visit_map<A: serde::de::MapAccess<$de>>(self, table: A) -> Result<Self::Value, A::Error> {
            let $value = serde::de::value::MapAccessDeserializer::new(table);
            $result
        }
    };
}

/// Implements `JsonSchema` for a type with several forms: its generics, the type, its name and its schema.
macro_rules! schema {
    ([$($generics:tt)*] $type:ty, $name:expr, $generator:ident => $schema:tt) => {
        impl<$($generics)*> schemars::JsonSchema for $type {
            fn schema_name() -> std::borrow::Cow<'static, str> {
                $name.into()
            }

            fn json_schema($generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
                schemars::json_schema!($schema)
            }
        }
    };
}

pub(crate) use {form, forms, schema};
