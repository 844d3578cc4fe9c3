//! Codec of triangle lists: one code byte per triangle, which refers to recent edges and vertices.
//!
//! Triangles of an optimised list mostly share an edge with a recent triangle, and their third vertex is recent or has
//! the next index that no triangle used yet. What a code cannot say stands behind the codes as numbers of variable
//! length.

use std::hint::select_unpredictable;

use super::varint::{self, VarintFault};
use super::{MeshoptFault, StreamLayout, low_bytes};

/// First byte of a stream of version 1, the only one of the specification.
const HEADER: u8 = 0xe1;

/// Size of the table at the end of a stream, which codes from [`TABLE_CODE`] on refer to.
const TABLE_SIZE: usize = 16;

/// Number of entries of the table that a code can refer to; the others are zero.
const TABLE_USED: usize = 14;

/// First code whose triangle shares no edge and refers to the table.
const TABLE_CODE: u8 = 0xf0;

/// First of the two codes whose references stand in the data.
const EXPLICIT_CODE: u8 = 0xfe;

/// First value of a code's lower half that stands for no recent vertex.
const NEAR_LAST: u8 = 0xd;

/// What is subtracted from twice [`NEAR_LAST`] or twice the value behind it, which stand for -1 and 1.
const NEAR_OFFSET: u32 = 2 * NEAR_LAST as u32 + 1;

/// Half of a byte that stands for an index in the data.
const IN_DATA: u8 = 0xf;

/// Number of edges or vertices that a code can refer to.
const FIFO_SIZE: usize = 16;

/// Returns the length of the shortest stream of so many indices: one byte per triangle.
pub(super) fn min_length(index_count: usize) -> usize {
    1 + index_count / 3 + TABLE_SIZE
}

/// Returns the indices of a stream that has at least [`min_length`] bytes.
pub(super) fn decode(layout: &StreamLayout, bytes: &[u8]) -> Result<Vec<u8>, MeshoptFault> {
    layout.check_header(bytes, HEADER)?;
    // Split the stream into codes, data and table
    let (_, body) = bytes.split_at(1);
    let (codes, rest) = body.split_at(layout.count / 3);
    let Some((data, table)) = rest.split_last_chunk() else {
        return Ok(Vec::new());
    };
    check_table(table)?;
    // Decode each triangle
    match layout.stride {
        2 => decode_triangles::<2>(codes, data, table),
        _ => decode_triangles::<4>(codes, data, table),
    }
}

/// Decodes one triangle per code into three indices of `SIZE` bytes.
fn decode_triangles<const SIZE: usize>(
    codes: &[u8],
    data: &[u8],
    table: &[u8; TABLE_SIZE],
) -> Result<Vec<u8>, MeshoptFault> {
    let mut decoder = TriangleDecoder::new(data);
    let mut recent = Recent::default();
    // A copy needs no register for its place
    let table = *table;
    let mut first_fault = None;
    // Triangles behind a fault are decoded to anything: an iterator of known length fills memory without checks
    let triangles: Vec<[[u8; SIZE]; 3]> = codes
        .iter()
        .enumerate()
        .map(|(number, &code)| {
            let indices = match code {
                0..TABLE_CODE => decoder.edge_triangle(code, &mut recent),
                TABLE_CODE..EXPLICIT_CODE => {
                    decoder.table_triangle(table[usize::from(code & 0xf)], &mut recent)
                }
                EXPLICIT_CODE.. => decoder.explicit_triangle(code, &mut recent),
            };
            let [a, b, c] = indices.unwrap_or_else(|fault| {
                first_fault.get_or_insert(fault.of_triangle(number));
                [0; 3]
            });
            [low_bytes(a), low_bytes(b), low_bytes(c)]
        })
        .collect();
    match (first_fault, decoder.data.len()) {
        (Some(fault), _) => Err(fault),
        (None, 0) => Ok(triangles.into_flattened().into_flattened()),
        (None, length) => Err(MeshoptFault::Surplus { length }),
    }
}

/// Checks that no entry of the table refers to data and that the unused ones are zero.
fn check_table(table: &[u8; TABLE_SIZE]) -> Result<(), MeshoptFault> {
    for (place, &entry) in table.iter().enumerate() {
        let is_unused = place >= TABLE_USED;
        let refers_to_data = entry >> 4 == IN_DATA || entry & 0xf == IN_DATA;
        if refers_to_data || is_unused && entry != 0 {
            return Err(MeshoptFault::CodeTable { place, entry });
        }
    }
    Ok(())
}

/// Reason why a triangle cannot be decoded.
enum TriangleFault {
    /// A reference to an edge or a vertex before the first.
    Unwritten,
    /// A number that cannot be read.
    Varint(VarintFault),
}

impl From<VarintFault> for TriangleFault {
    fn from(fault: VarintFault) -> TriangleFault {
        TriangleFault::Varint(fault)
    }
}

impl TriangleFault {
    /// Returns the fault of the whole stream.
    #[cold]
    fn of_triangle(self, number: usize) -> MeshoptFault {
        let item = "triangle";
        match self {
            TriangleFault::Unwritten => MeshoptFault::UnwrittenEntry { triangle: number },
            TriangleFault::Varint(VarintFault::Truncated) => MeshoptFault::Truncated { item, number },
            TriangleFault::Varint(VarintFault::Long) => MeshoptFault::LongNumber { item, number },
        }
    }
}

/// The last [`FIFO_SIZE`] edges and vertices. The place of an entry is its number, from 1 on.
///
/// This is apart from the decoder, so that the decoder's members can stay in registers.
#[derive(Default)]
struct Recent {
    /// First vertex of each edge. The second ones are apart, lest the compiler reads both at once: a processor waits
    /// long for a word that it has just written the halves of.
    edge_starts: [u32; FIFO_SIZE],
    /// Second vertex of each edge.
    edge_ends: [u32; FIFO_SIZE],
    vertices: [u32; FIFO_SIZE],
}

/// State of the codec between two triangles.
struct TriangleDecoder<'a> {
    /// Bytes behind the codes that were not read yet.
    data: &'a [u8],
    /// Lowest index that no triangle used yet, in a list whose vertices are in order of use.
    next: u32,
    /// Last index that was read from the data.
    last: u32,
    /// Number of edges that were pushed.
    edge_count: usize,
    /// Number of vertices that were pushed.
    vertex_count: usize,
}

impl<'a> TriangleDecoder<'a> {
    /// Returns the state in front of the first triangle.
    fn new(data: &'a [u8]) -> TriangleDecoder<'a> {
        TriangleDecoder {
            data,
            next: 0,
            last: 0,
            edge_count: 0,
            vertex_count: 0,
        }
    }

    /// Decodes a triangle that shares a recent edge.
    #[inline(always)]
    fn edge_triangle(&mut self, code: u8, recent: &mut Recent) -> Result<[u32; 3], TriangleFault> {
        let edge = place_of_age(self.edge_count, code >> 4)?;
        let (a, b) = (recent.edge_starts[edge], recent.edge_ends[edge]);
        let low = code & 0xf;
        let c = if low < NEAR_LAST {
            // No branch for what the processor could not predict
            let known = self.recent_vertex(low, recent)?;
            let is_new = low == 0;
            let c = select_unpredictable(is_new, self.next, known);
            self.next = self.next.wrapping_add(u32::from(is_new));
            self.push_vertex_if(is_new, c, recent);
            c
        } else {
            let c = match low {
                IN_DATA => self.read_index()?,
                _ => self
                    .last
                    .wrapping_add(2 * u32::from(low))
                    .wrapping_sub(NEAR_OFFSET),
            };
            self.last = c;
            self.push_vertex_if(true, c, recent);
            c
        };
        self.push_edge(c, b, recent);
        self.push_edge(a, c, recent);
        Ok([a, b, c])
    }

    /// Decodes a triangle whose first vertex is new and whose others stand in the table.
    #[inline(always)]
    fn table_triangle(&mut self, entry: u8, recent: &mut Recent) -> Result<[u32; 3], TriangleFault> {
        let (b_code, c_code) = (entry >> 4, entry & 0xf);
        let a = self.new_index();
        let b = self.new_or_recent(b_code, recent)?;
        let c = self.new_or_recent(c_code, recent)?;
        self.push_vertex_if(true, a, recent);
        self.push_vertex_if(b_code == 0, b, recent);
        self.push_vertex_if(c_code == 0, c, recent);
        self.push_edges(a, b, c, recent);
        Ok([a, b, c])
    }

    /// Decodes a triangle each of whose vertices may stand in the data.
    #[inline(always)]
    fn explicit_triangle(&mut self, code: u8, recent: &mut Recent) -> Result<[u32; 3], TriangleFault> {
        let Some((&entry, rest)) = self.data.split_first() else {
            return Err(VarintFault::Truncated.into());
        };
        self.data = rest;
        // Begin a new mesh
        if entry == 0 {
            self.next = 0;
        }
        // Find the vertices: those in the data stand behind all others
        let a_code = if code == EXPLICIT_CODE { 0 } else { IN_DATA };
        let codes = [a_code, entry >> 4, entry & 0xf];
        let mut indices = [0; 3];
        for (index, code) in indices.iter_mut().zip(codes) {
            *index = match code {
                IN_DATA => self.read_index()?,
                code => self.new_or_recent(code, recent)?,
            };
        }
        // Remember vertices that were not recent
        for (index, code) in indices.into_iter().zip(codes) {
            self.push_vertex_if(code == 0 || code == IN_DATA, index, recent);
        }
        let [a, b, c] = indices;
        self.push_edges(a, b, c, recent);
        Ok(indices)
    }

    /// Pushes the edges of a triangle, each as its neighbour has it.
    #[inline(always)]
    fn push_edges(&mut self, a: u32, b: u32, c: u32, recent: &mut Recent) {
        self.push_edge(b, a, recent);
        self.push_edge(c, b, recent);
        self.push_edge(a, c, recent);
    }

    #[inline(always)]
    fn push_edge(&mut self, a: u32, b: u32, recent: &mut Recent) {
        self.edge_count += 1;
        let place = self.edge_count % FIFO_SIZE;
        (recent.edge_starts[place], recent.edge_ends[place]) = (a, b);
    }

    /// Pushes a vertex on a condition, without a branch.
    #[inline(always)]
    fn push_vertex_if(&mut self, condition: bool, vertex: u32, recent: &mut Recent) {
        // The place holds the oldest entry, which no code refers to by the time that it matters
        recent.vertices[(self.vertex_count + 1) % FIFO_SIZE] = vertex;
        self.vertex_count += usize::from(condition);
    }

    /// Returns the vertex of the given age; the last that was pushed has age 0.
    #[inline(always)]
    fn recent_vertex(&self, age: u8, recent: &Recent) -> Result<u32, TriangleFault> {
        Ok(recent.vertices[place_of_age(self.vertex_count, age)?])
    }

    /// Returns the lowest index that no triangle used yet.
    #[inline(always)]
    fn new_index(&mut self) -> u32 {
        let index = self.next;
        self.next = index.wrapping_add(1);
        index
    }

    /// Returns a new index for code 0, or else that of a recent vertex.
    #[inline(always)]
    fn new_or_recent(&mut self, code: u8, recent: &Recent) -> Result<u32, TriangleFault> {
        match code {
            0 => Ok(self.new_index()),
            _ => self.recent_vertex(code - 1, recent),
        }
    }

    /// Returns an index from the data, which holds its difference from the last.
    #[inline(always)]
    fn read_index(&mut self) -> Result<u32, TriangleFault> {
        let difference = varint::unzigzag(varint::read(&mut self.data)?);
        self.last = self.last.wrapping_add(difference);
        Ok(self.last)
    }
}

/// Returns the place of the entry of an age among those pushed; the last has age 0.
#[inline(always)]
fn place_of_age(pushed_count: usize, age: u8) -> Result<usize, TriangleFault> {
    let age = usize::from(age);
    if age >= pushed_count {
        return Err(TriangleFault::Unwritten);
    }
    Ok((pushed_count - age) % FIFO_SIZE)
}

#[cfg(test)]
mod tests {
    use super::super::{ElementFilter, StreamMode, decode};
    use super::*;

    /// Table whose first entry stands for two new vertices and whose second for two recent ones, of ages 0 and 1.
    const TABLE: [u8; TABLE_SIZE] = [0x00, 0x12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];

    /// Returns the triangles of a stream with these codes and data.
    fn decoded(codes: &[u8], data: &[u8]) -> Result<Vec<[u32; 3]>, MeshoptFault> {
        let layout = StreamLayout {
            mode: StreamMode::Triangles,
            filter: ElementFilter::None,
            count: 3 * codes.len(),
            stride: 4,
        };
        let bytes = decode(&layout, &[&[HEADER], codes, data, &TABLE].concat())?;
        let indices: Vec<u32> = bytes
            .as_chunks()
            .0
            .iter()
            .map(|&b| u32::from_le_bytes(b))
            .collect();
        Ok(indices.as_chunks().0.to_vec())
    }

    #[test]
    fn codes_refer_to_recent_edges_and_vertices() {
        // New vertices 0 1 2, edges 10 21 02; on edge 02 (age 0) a new vertex 3, edges 32 03;
        // on edge 03 (age 0) the vertex of age 2, which is 1, edges 13 01;
        // a new vertex 4 with those of ages 0 and 1, which are 3 and 2
        let triangles = decoded(&[0xf0, 0x00, 0x02, 0xf1], &[]);
        assert_eq!(triangles, Ok(vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [4, 3, 2]]));
    }

    #[test]
    fn indices_in_the_data_are_differences_from_the_last() {
        // On edge 02 vertex 0 + 7 (code 14), edges 72 07; on 07 vertex 7 - 1, edges 67 06; on 06 vertex 6 + 1
        let triangles = decoded(&[0xf0, 0x0f, 0x0d, 0x0e], &[14]);
        assert_eq!(triangles, Ok(vec![[0, 1, 2], [0, 2, 7], [0, 7, 6], [0, 6, 7]]));
    }

    #[test]
    fn explicit_triangles_begin_meshes_anew() {
        // 0xfe with 0: the next new index is 0 again; 0xff with 0xf0: 0 + 9 (code 18), 9 - 2 (code 3), new 3
        let triangles = decoded(&[0xf0, 0xfe, 0xff], &[0x00, 0xf0, 18, 3]);
        assert_eq!(triangles, Ok(vec![[0, 1, 2], [0, 1, 2], [9, 7, 3]]));
    }

    #[test]
    fn the_first_triangle_has_no_recent_edges_or_vertices() {
        for code in [0x00, 0xf1] {
            assert_eq!(
                decoded(&[code], &[]),
                Err(MeshoptFault::UnwrittenEntry { triangle: 0 })
            );
        }
        // Three edges are known; the first fault is that of the second triangle
        let third = decoded(&[0xf0, 0x30, 0x30], &[]);
        assert_eq!(third, Err(MeshoptFault::UnwrittenEntry { triangle: 1 }));
    }

    #[test]
    fn data_is_used_up_exactly() {
        let truncated = MeshoptFault::Truncated {
            item: "triangle",
            number: 1,
        };
        assert_eq!(decoded(&[0xf0, 0x0f], &[0x80]), Err(truncated));
        assert_eq!(
            decoded(&[0xf0], &[1, 2]),
            Err(MeshoptFault::Surplus { length: 2 })
        );
    }

    #[test]
    fn tables_do_not_refer_to_data() {
        for (place, entry) in [(3, 0xf0), (3, 0x0f), (14, 1)] {
            let mut table = TABLE;
            table[place] = entry;
            assert_eq!(check_table(&table), Err(MeshoptFault::CodeTable { place, entry }));
        }
    }
}
