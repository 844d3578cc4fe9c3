//! Accessors: typed views of a buffer (glTF 2.0, section 3.6.2), with strides, normalised integers and sparse values.
//!
//! Every offset and length is checked against the available bytes before anything is allocated or read. Floats and
//! 32-bit indices that lie packed and aligned in the bytes of a file are not copied.

use gltf::json::accessor::{ComponentType, Type};
use gltf::json::validation::Checked;

use crate::buffer::Buffer;
use crate::gltf::GltfError;
use crate::gltf::buffer::BufferWindow;
use crate::gltf::document::GltfDocument;
use crate::gltf::error::EXPORT_AGAIN;
use crate::parallel;

/// Largest number of elements of an accessor without a buffer view, as no bytes of the file back their number.
const MAX_UNBACKED: usize = 1 << 22;
/// Number of elements per parallel task.
const CHUNK: usize = 1 << 14;

/// An accessor whose offsets and lengths are checked.
pub(in crate::gltf) struct Accessor<'a> {
    document: &'a GltfDocument,
    number: usize,
    count: usize,
    component: ComponentType,
    type_: Type,
    normalized: bool,
    base: Option<BufferWindow<'a>>,
    stride: usize,
    sparse: Option<Sparse<'a>>,
}

/// Elements that replace those of the base, by index, with their packed values.
struct Sparse<'a> {
    indices: Vec<usize>,
    values: &'a [u8],
}

impl GltfDocument {
    /// Opens accessor `number` and checks it against the bytes of its buffer views.
    pub(in crate::gltf) fn accessor(&self, number: usize) -> Result<Accessor<'_>, GltfError> {
        let accessors = &self.root.accessors;
        let Some(accessor) = accessors.get(number) else {
            return Err(self.missing("accessor", number, accessors.len()));
        };
        if let Some(decoded) = self.decoded_accessors.get(&number) {
            return Ok(Accessor {
                count: decoded.count,
                component: decoded.component,
                type_: decoded.type_,
                base: Some(BufferWindow {
                    bytes: &decoded.bytes,
                    stride: None,
                    file: None,
                }),
                stride: width(decoded.type_) * component_size(decoded.component),
                document: self,
                number,
                normalized: accessor.normalized,
                sparse: None,
            });
        }
        let fault = |fault: String| self.fault(format!("accessor {number}"), fault, EXPORT_AGAIN);
        let (Checked::Valid(component), Checked::Valid(type_)) = (accessor.component_type, accessor.type_)
        else {
            return Err(fault("has a type that glTF does not define".into()));
        };
        // Compute the size of an element
        let component = component.0;
        let too_many = || {
            fault(format!(
                "states {} elements, which its bytes cannot hold",
                accessor.count.0
            ))
        };
        let count = usize::try_from(accessor.count.0).map_err(|_| too_many())?;
        let size = width(type_) * component_size(component);
        // Find the start of the elements
        let base = match accessor.buffer_view {
            None if count > MAX_UNBACKED => return Err(too_many()),
            None => None,
            Some(view) => {
                let window = self.view(view.value())?;
                let offset = usize::try_from(accessor.byte_offset.map_or(0, |o| o.0)).ok();
                let length = window.bytes.len();
                let Some(window) = offset.and_then(|offset| window.skip(offset)) else {
                    let sentence = format!("starts past the end of its buffer view ({length} bytes)");
                    return Err(fault(sentence));
                };
                Some(window)
            }
        };
        // Check the stride and the end of the last element
        let stride = base.as_ref().and_then(|window| window.stride).unwrap_or(size);
        if let Some(window) = &base {
            if stride < size {
                return Err(fault(format!(
                    "has a stride of {stride} bytes for elements of {size}"
                )));
            }
            // The last element needs no padding behind it
            let end = count
                .checked_sub(1)
                .map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
            if end.is_none_or(|end| end > window.bytes.len()) {
                return Err(fault(format!(
                    "states {count} elements, more than its buffer view holds ({} bytes from its start on)",
                    window.bytes.len()
                )));
            }
        }
        let mut opened = Accessor {
            document: self,
            number,
            count,
            component,
            type_,
            normalized: accessor.normalized,
            base,
            stride,
            sparse: None,
        };
        // Read the sparse indices and values
        if let Some(sparse) = &accessor.sparse {
            opened.sparse = Some(opened.open_sparse(sparse)?);
        }
        Ok(opened)
    }
}

impl<'a> Accessor<'a> {
    /// Returns the number of elements.
    pub(in crate::gltf) fn count(&self) -> usize {
        self.count
    }

    /// Returns whether elements are vectors of three components.
    pub(in crate::gltf) fn is_triple(&self) -> bool {
        self.type_ == Type::Vec3
    }

    /// Returns all elements as scalars, vectors or 4 by 4 matrices (by columns) of `N` floats: normalised integers as
    /// fractions, other integers as they are.
    pub(in crate::gltf) fn vectors<const N: usize>(&self) -> Result<Buffer<[f32; N]>, GltfError>
    where
        [f32; N]: bytemuck::Pod,
    {
        // glTF pads the columns of Mat2 and Mat3, so these cannot be read as vectors.
        if width(self.type_) != N || matches!(self.type_, Type::Mat2 | Type::Mat3) {
            let wanted = match N {
                1 => "SCALAR".into(),
                16 => "MAT4".into(),
                _ => format!("VEC{N}"),
            };
            let fault = format!("is {} where {wanted} is needed", type_name(self.type_));
            return Err(self.fault(fault));
        }
        // Share the bytes if they are packed floats
        let is_float = self.component == ComponentType::F32;
        if let Some(shared) = self
            .packed(size_of::<[f32; N]>(), self.count)
            .filter(|_| is_float)
        {
            return Ok(shared);
        }
        // Decode the base, which is zero without a buffer view
        let mut values = vec![[0f32; N]; self.count];
        if let Some(window) = &self.base {
            parallel::for_each_chunk_mut(&mut values, CHUNK, &|chunk, values| {
                for (i, value) in values.iter_mut().enumerate() {
                    *value = self.decode(&window.bytes[(chunk * CHUNK + i) * self.stride..]);
                }
            });
        }
        // Replace the sparse elements
        if let Some(sparse) = &self.sparse {
            let size = N * component_size(self.component);
            for (&index, bytes) in sparse.indices.iter().zip(sparse.values.chunks_exact(size)) {
                values[index] = self.decode(bytes);
            }
        }
        Ok(Buffer::from(values))
    }

    /// Returns triples of 32-bit indices that share the bytes of the file; `None` where its layout does not allow that.
    pub(in crate::gltf) fn shared_triangles(&self) -> Option<Buffer<[u32; 3]>> {
        let is_index = self.type_ == Type::Scalar && self.component == ComponentType::U32;
        if !is_index {
            return None;
        }
        self.packed(size_of::<u32>(), self.count / 3)
    }

    /// Returns all elements as indices.
    pub(in crate::gltf) fn indices(&self) -> Result<Vec<u32>, GltfError> {
        let is_unsigned = matches!(
            self.component,
            ComponentType::U8 | ComponentType::U16 | ComponentType::U32
        );
        if self.type_ != Type::Scalar || !is_unsigned {
            return Err(self.fault("is not made of unsigned integers, as indices are".into()));
        }
        // Decode the base, then replace the sparse elements
        let mut values = vec![0u32; self.count];
        if let Some(window) = &self.base {
            parallel::for_each_chunk_mut(&mut values, CHUNK, &|chunk, values| {
                for (i, value) in values.iter_mut().enumerate() {
                    *value = unsigned(self.component, &window.bytes[(chunk * CHUNK + i) * self.stride..]);
                }
            });
        }
        if let Some(sparse) = &self.sparse {
            let size = component_size(self.component);
            for (&index, bytes) in sparse.indices.iter().zip(sparse.values.chunks_exact(size)) {
                values[index] = unsigned(self.component, bytes);
            }
        }
        Ok(values)
    }

    /// Returns the largest value of the accessor's type of indices.
    pub(in crate::gltf) fn largest_index(&self) -> u32 {
        match component_size(self.component) {
            1 => u32::from(u8::MAX),
            2 => u32::from(u16::MAX),
            _ => u32::MAX,
        }
    }

    fn fault(&self, fault: String) -> GltfError {
        self.document
            .fault(format!("accessor {}", self.number), fault, EXPORT_AGAIN)
    }

    /// Returns `count` values that share the bytes of the file, if elements of `size` bytes follow each other without gaps.
    fn packed<T: bytemuck::Pod>(&self, size: usize, count: usize) -> Option<Buffer<T>> {
        // Values are little-endian in the file and must be so in memory
        let is_as_in_memory = cfg!(target_endian = "little") && self.stride == size && self.sparse.is_none();
        let (map, offset) = self.base.as_ref()?.file?;
        if is_as_in_memory {
            Buffer::from_map(map, offset, count)
        } else {
            None
        }
    }

    fn open_sparse(&self, sparse: &gltf::json::accessor::sparse::Sparse) -> Result<Sparse<'a>, GltfError> {
        let Checked::Valid(component) = sparse.indices.component_type else {
            return Err(self.fault("has sparse indices of a type that glTF does not define".into()));
        };
        let document = self.document;
        let count = sparse.count.0;
        // Slices of a buffer view that are known to hold `count` entries
        let window = |view: usize, offset: u64, size: usize, what: &str| -> Result<&'a [u8], GltfError> {
            let bytes = document.view(view)?.bytes;
            let length = usize::try_from(count)
                .ok()
                .and_then(|count| count.checked_mul(size));
            let start = usize::try_from(offset).ok();
            start
                .zip(length)
                .and_then(|(start, length)| bytes.get(start..start.checked_add(length)?))
                .ok_or_else(|| {
                    self.fault(format!(
                        "states {count} sparse {what}, more than their bytes hold"
                    ))
                })
        };
        // Locate the bytes of the indices and of the values
        let indices = &sparse.indices;
        let size = component_size(component.0);
        let indices = window(
            indices.buffer_view.value(),
            indices.byte_offset.0,
            size,
            "indices",
        )?;
        let values = &sparse.values;
        let element = width(self.type_) * component_size(self.component);
        let values = window(
            values.buffer_view.value(),
            values.byte_offset.0,
            element,
            "values",
        )?;
        // Decode and check the indices
        let indices: Vec<usize> = indices
            .chunks_exact(size)
            .map(|bytes| unsigned(component.0, bytes) as usize)
            .collect();
        if let Some(&outside) = indices.iter().find(|&&i| i >= self.count) {
            let fault = format!("has the sparse index {outside}, but {} elements", self.count);
            return Err(self.fault(fault));
        }
        Ok(Sparse { indices, values })
    }

    /// Decodes the vector at the start of `bytes`.
    #[inline(always)]
    fn decode<const N: usize>(&self, bytes: &[u8]) -> [f32; N] {
        let at = |i: usize| &bytes[i * component_size(self.component)..];
        let i8 = |i| f32::from(at(i)[0] as i8);
        let i16 = |i| f32::from(i16::from_le_bytes([at(i)[0], at(i)[1]]));
        // The factors are those of glTF 2.0, section 3.6.2.2 (and of its equation for the signed minimum).
        match (self.component, self.normalized) {
            (ComponentType::F32, _) => {
                std::array::from_fn(|i| f32::from_le_bytes([at(i)[0], at(i)[1], at(i)[2], at(i)[3]]))
            }
            (ComponentType::I8, true) => std::array::from_fn(|i| (i8(i) / 127.0).max(-1.0)),
            (ComponentType::I8, false) => std::array::from_fn(i8),
            (ComponentType::I16, true) => std::array::from_fn(|i| (i16(i) / 32767.0).max(-1.0)),
            (ComponentType::I16, false) => std::array::from_fn(i16),
            (ComponentType::U8, true) => std::array::from_fn(|i| f32::from(at(i)[0]) / 255.0),
            (ComponentType::U16, true) => {
                std::array::from_fn(|i| unsigned(ComponentType::U16, at(i)) as f32 / 65535.0)
            }
            (ComponentType::U32, true) => std::array::from_fn(|i| {
                (f64::from(unsigned(ComponentType::U32, at(i))) / f64::from(u32::MAX)) as f32
            }),
            (unsigned_integer, false) => std::array::from_fn(|i| unsigned(unsigned_integer, at(i)) as f32),
        }
    }
}

/// Decodes the unsigned integer at the start of `bytes`.
#[inline(always)]
fn unsigned(component: ComponentType, bytes: &[u8]) -> u32 {
    match component {
        ComponentType::U8 | ComponentType::I8 => u32::from(bytes[0]),
        ComponentType::U16 | ComponentType::I16 => u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
        ComponentType::U32 | ComponentType::F32 => {
            u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
        }
    }
}

/// Returns the number of components of an element.
fn width(type_: Type) -> usize {
    match type_ {
        Type::Scalar => 1,
        Type::Vec2 => 2,
        Type::Vec3 => 3,
        Type::Vec4 | Type::Mat2 => 4,
        Type::Mat3 => 9,
        Type::Mat4 => 16,
    }
}

fn type_name(type_: Type) -> &'static str {
    match type_ {
        Type::Scalar => "SCALAR",
        Type::Vec2 => "VEC2",
        Type::Vec3 => "VEC3",
        Type::Vec4 => "VEC4",
        Type::Mat2 => "MAT2",
        Type::Mat3 => "MAT3",
        Type::Mat4 => "MAT4",
    }
}

fn component_size(component: ComponentType) -> usize {
    match component {
        ComponentType::I8 | ComponentType::U8 => 1,
        ComponentType::I16 | ComponentType::U16 => 2,
        ComponentType::U32 | ComponentType::F32 => 4,
    }
}

#[cfg(test)]
mod tests {
    use base64::Engine;
    use serde_json::{Value, json};

    use super::*;
    use crate::gltf::document::of_json;

    /// Returns a document with one buffer of these bytes, one view of all of it, and these accessors.
    fn document(bytes: &[u8], stride: Option<usize>, accessors: Value) -> GltfDocument {
        let data = base64::engine::general_purpose::STANDARD.encode(bytes);
        let mut view = json!({"buffer": 0, "byteLength": bytes.len()});
        if let Some(stride) = stride {
            view["byteStride"] = json!(stride);
        }
        of_json(&json!({
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": bytes.len(), "uri": format!("data:;base64,{data}")}],
            "bufferViews": [view],
            "accessors": accessors
        }))
    }

    fn vec2(component: u32, normalized: bool) -> Value {
        json!([{"bufferView": 0, "componentType": component, "normalized": normalized, "count": 1, "type": "VEC2"}])
    }

    #[test]
    fn component_types_decode_as_specified() {
        let bytes = [0x80, 0x7f, 0xff, 0xff, 0x00, 0x00, 0x80, 0x3f];
        // i8: -128, 127; u8: 128, 127; i16: 0x7f80 = 32640, -1; u16: 32640, 65535; u32: 0xffff7f80 = 4294934400,
        // 0x3f800000 = 1065353216; f32: NaN, 1.
        for (component, plain, fractions) in [
            (5120, [-128.0, 127.0], [-1.0, 1.0]),
            (5121, [128.0, 127.0], [128.0 / 255.0, 127.0 / 255.0]),
            (5122, [32640.0, -1.0], [32640.0 / 32767.0, -1.0 / 32767.0]),
            (5123, [32640.0, 65535.0], [32640.0 / 65535.0, 1.0]),
            (
                5125,
                [4294934400.0, 1065353216.0],
                [4294934400.0 / 4294967295.0, 1065353216.0 / 4294967295.0],
            ),
        ] {
            for (normalized, expected) in [(false, plain), (true, fractions)] {
                let document = document(&bytes, None, vec2(component, normalized));
                let values = document.accessor(0).unwrap().vectors::<2>().unwrap();
                assert_eq!(
                    values[0],
                    expected.map(|x: f64| x as f32),
                    "{component} {normalized}"
                );
            }
        }
        let values = document(&bytes, None, vec2(5126, false))
            .accessor(0)
            .unwrap()
            .vectors::<2>()
            .unwrap();
        assert!(values[0][0].is_nan() && values[0][1] == 1.0);
    }

    #[test]
    fn accessor_types_must_match_scalars_and_matrices() {
        let bytes: Vec<u8> = (1..=16u8).flat_map(|i| f32::from(i).to_le_bytes()).collect();
        let of = |type_: &str, count: u32| {
            let accessor = json!([{"bufferView": 0, "componentType": 5126, "count": count, "type": type_}]);
            document(&bytes, None, accessor)
        };
        let scalars = of("SCALAR", 2);
        let values = scalars.accessor(0).unwrap().vectors::<1>().unwrap();
        assert_eq!(values[..], [[1.0], [2.0]]);
        let matrix = of("MAT4", 1);
        let values = matrix.accessor(0).unwrap().vectors::<16>().unwrap();
        assert_eq!(values[0], std::array::from_fn(|i| i as f32 + 1.0));
        // As many components as a vector of four.
        let small = of("MAT2", 4);
        let fault = small.accessor(0).unwrap().vectors::<4>().unwrap_err();
        assert!(
            fault.to_string().contains("is MAT2 where VEC4 is needed"),
            "{fault}"
        );
        let fault = scalars.accessor(0).unwrap().vectors::<16>().unwrap_err();
        assert!(
            fault.to_string().contains("is SCALAR where MAT4 is needed"),
            "{fault}"
        );
    }

    #[test]
    fn stride_skips_padding_except_after_the_last_element() {
        // Elements of 2 bytes every 4 bytes, from offset 1 on.
        let bytes = [9, 1, 2, 9, 9, 3, 4];
        let accessor =
            json!([{"bufferView": 0, "byteOffset": 1, "componentType": 5121, "count": 2, "type": "VEC2"}]);
        let values = document(&bytes, Some(4), accessor)
            .accessor(0)
            .unwrap()
            .vectors::<2>()
            .unwrap();
        assert_eq!(values[..], [[1.0, 2.0], [3.0, 4.0]]);
    }

    #[test]
    fn indices_of_8_16_and_32_bits_are_read_alike() {
        let bytes = [1, 0, 0, 0, 2, 0, 0, 0];
        for (component, expected) in [
            (5121, vec![1, 0, 0, 0, 2, 0, 0, 0]),
            (5123, vec![1, 0, 2, 0]),
            (5125, vec![1, 2]),
        ] {
            let accessor = json!([{"bufferView": 0, "componentType": component, "count": expected.len(), "type": "SCALAR"}]);
            assert_eq!(
                document(&bytes, None, accessor)
                    .accessor(0)
                    .unwrap()
                    .indices()
                    .unwrap(),
                expected
            );
        }
        let floats = json!([{"bufferView": 0, "componentType": 5126, "count": 2, "type": "SCALAR"}]);
        assert!(
            document(&bytes, None, floats)
                .accessor(0)
                .unwrap()
                .indices()
                .is_err()
        );
    }

    #[test]
    fn sparse_values_replace_base_values_or_zeros() {
        // Base: four u8 pairs; then the sparse index 2; then its value (7, 8).
        let bytes = [1, 1, 2, 2, 3, 3, 4, 4, 2, 7, 8];
        let sparse = json!({"count": 1,
            "indices": {"bufferView": 0, "byteOffset": 8, "componentType": 5121},
            "values": {"bufferView": 0, "byteOffset": 9}});
        let with_base =
            json!([{"bufferView": 0, "componentType": 5121, "count": 4, "type": "VEC2", "sparse": sparse}]);
        let values = document(&bytes, None, with_base)
            .accessor(0)
            .unwrap()
            .vectors::<2>()
            .unwrap();
        assert_eq!(values[..], [[1.0, 1.0], [2.0, 2.0], [7.0, 8.0], [4.0, 4.0]]);
        let without = json!([{"componentType": 5121, "count": 3, "type": "VEC2", "sparse": sparse}]);
        let values = document(&bytes, None, without)
            .accessor(0)
            .unwrap()
            .vectors::<2>()
            .unwrap();
        assert_eq!(values[..], [[0.0, 0.0], [0.0, 0.0], [7.0, 8.0]]);
        let outside = json!([{"componentType": 5121, "count": 2, "type": "VEC2", "sparse": sparse}]);
        assert!(document(&bytes, None, outside).accessor(0).is_err());
    }

    #[test]
    fn counts_offsets_and_strides_beyond_the_buffer_are_rejected() {
        let bytes = [0; 24];
        let base = json!({"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3"});
        let with = |key: &str, value: Value| {
            let mut accessor = base.clone();
            accessor[key] = value;
            document(&bytes, None, json!([accessor]))
                .accessor(0)
                .map(|a| a.count())
        };
        assert_eq!(with("count", json!(2)).ok(), Some(2));
        for (key, value) in [
            ("count", json!(3)),
            ("count", json!(1u64 << 60)),
            ("count", json!(u64::MAX)),
            ("byteOffset", json!(1)),
            ("byteOffset", json!(25)),
            ("byteOffset", json!(u64::MAX)),
            ("bufferView", json!(1)),
            ("componentType", json!(5127)),
            ("type", json!("VEC5")),
        ] {
            assert!(with(key, value.clone()).is_err(), "{key} {value}");
        }
        let unbacked = json!([{"componentType": 5126, "count": 1u64 << 40, "type": "VEC3"}]);
        assert!(document(&bytes, None, unbacked).accessor(0).is_err());
        assert!(document(&bytes, Some(8), json!([base])).accessor(0).is_err());
    }
}
