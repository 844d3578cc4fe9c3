//! Mutation of documents as trees of values, so that most mutations are syntactically valid.
//!
//! Half of the mutations are libFuzzer's own, of the bytes. The others change, remove, repeat or move a value of the
//! tree. TOML is mutated as the tree of JSON that it corresponds to; a document that has none is mutated as bytes.

use libfuzzer_sys::fuzzer_mutate;
use serde_json::{Map, Number, Value, json};
use whit::numeric::SplitMix64;

use crate::glb::Glb;

/// Largest number of changes of one mutation.
const MAX_CHANGES: usize = 4;
/// Numbers that are limits of types and ranges, or beyond them.
const LIMITS: [f64; 18] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    2.0,
    255.0,
    256.0,
    65_535.0,
    65_536.0,
    2_147_483_648.0,
    4_294_967_295.0,
    4_294_967_296.0,
    9_007_199_254_740_993.0,
    1.8e19,
    1e-320,
    3.5e38,
    1e308,
];

/// Text formats of documents that can be mutated as trees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Syntax {
    /// JSON, as in glTF.
    Json,
    /// TOML, as in scene files and job files.
    Toml,
}

impl Syntax {
    fn parse(self, bytes: &[u8]) -> Option<Value> {
        match self {
            Syntax::Json => serde_json::from_slice(bytes).ok(),
            Syntax::Toml => toml::from_str(std::str::from_utf8(bytes).ok()?).ok(),
        }
    }

    fn print(self, value: &Value) -> Option<Vec<u8>> {
        match self {
            Syntax::Json => serde_json::to_vec(value).ok(),
            Syntax::Toml => toml::to_string(value).ok().map(String::into_bytes),
        }
    }
}

/// Mutates a document in place and returns its new length, for `fuzz_mutator!`.
pub fn mutate_document(syntax: Syntax, data: &mut [u8], size: usize, max_size: usize, seed: u32) -> usize {
    let mut random = SplitMix64::new(0, seed.into());
    let changed = match random.below(2) {
        0 => None,
        _ => changed_document(syntax, &data[..size], &mut random),
    };
    replace(data, size, max_size, changed)
}

/// Mutates a binary glTF file in place and returns its new length: its document, its binary data, or its bytes.
pub fn mutate_glb(data: &mut [u8], size: usize, max_size: usize, seed: u32) -> usize {
    let mut random = SplitMix64::new(1, seed.into());
    let changed = Glb::parse(&data[..size]).and_then(|mut glb| {
        match random.below(5) {
            0..=2 => glb.json = changed_document(Syntax::Json, &glb.json, &mut random)?,
            3 => glb.binary = changed_bytes(&glb.binary),
            _ => return None,
        }
        Some(glb.bytes())
    });
    replace(data, size, max_size, changed)
}

/// Stores a changed file, or mutates the bytes if there is none or it is too long.
fn replace(data: &mut [u8], size: usize, max_size: usize, changed: Option<Vec<u8>>) -> usize {
    match changed.filter(|changed| changed.len() <= max_size) {
        Some(changed) => {
            data[..changed.len()].copy_from_slice(&changed);
            changed.len()
        }
        None => fuzzer_mutate(data, size, max_size),
    }
}

/// Returns bytes that libFuzzer mutated, somewhat longer at most.
fn changed_bytes(bytes: &[u8]) -> Vec<u8> {
    const GROWTH: usize = 64;
    let mut changed = bytes.to_vec();
    changed.resize(bytes.len() + GROWTH, 0);
    let max_size = changed.len();
    let size = fuzzer_mutate(&mut changed, bytes.len(), max_size);
    changed.truncate(size);
    changed
}

/// Returns a document with a few changes; `None` if it cannot be parsed or printed.
fn changed_document(syntax: Syntax, bytes: &[u8], random: &mut SplitMix64) -> Option<Vec<u8>> {
    let mut root = syntax.parse(bytes)?;
    for _ in 0..1 + random.below(MAX_CHANGES) {
        let original = root.clone();
        let target = random.below(count(&root));
        let donor = random.below(count(&original));
        if let (Some(target), Some(donor)) = (nth_mut(&mut root, target), nth(&original, donor)) {
            change(target, donor, random);
        }
    }
    syntax.print(&root)
}

/// Changes one value; `donor` is another value of the same document.
fn change(target: &mut Value, donor: &Value, random: &mut SplitMix64) {
    match target {
        _ if random.below(6) == 0 => *target = donor.clone(),
        Value::Number(number) => *target = changed_number(number, random),
        Value::Bool(flag) => *flag = !*flag,
        Value::Array(items) => change_array(items, donor, random),
        Value::Object(members) => change_object(members, donor, random),
        Value::String(_) | Value::Null => *target = donor.clone(),
    }
}

fn changed_number(number: &Number, random: &mut SplitMix64) -> Value {
    if let Some(integer) = number.as_i64() {
        return match random.below(5) {
            0 => json!(integer.wrapping_add(1)),
            1 => json!(integer.wrapping_sub(1)),
            2 => json!(random.below(1 + integer.unsigned_abs().min(1 << 16) as usize)),
            3 => json!(integer.wrapping_mul(2)),
            _ => json!(random.choose(&LIMITS) as i64),
        };
    }
    let float = number.as_f64().unwrap_or_default();
    match random.below(4) {
        0 => json!(-float),
        1 => json!(float * random.within(-4.0, 4.0)),
        2 => json!(float * 1e30),
        _ => json!(random.choose(&LIMITS)),
    }
}

fn change_array(items: &mut Vec<Value>, donor: &Value, random: &mut SplitMix64) {
    if items.is_empty() {
        return items.push(donor.clone());
    }
    let at = random.below(items.len());
    match random.below(4) {
        0 => drop(items.remove(at)),
        1 => items.insert(at, items[at].clone()),
        2 => items.swap(0, at),
        _ => items.push(donor.clone()),
    }
}

fn change_object(members: &mut Map<String, Value>, donor: &Value, random: &mut SplitMix64) {
    // Insert a member of another object
    let donated = donor.as_object().filter(|donor| !donor.is_empty());
    if let Some(donor) = donated.filter(|_| random.below(2) == 0) {
        if let Some((name, value)) = donor.iter().nth(random.below(donor.len())) {
            members.insert(name.clone(), value.clone());
        }
        return;
    }
    let keys: Vec<String> = members.keys().cloned().collect();
    if keys.is_empty() {
        return;
    }
    // Remove a member, or give it the value of another place
    let key = &keys[random.below(keys.len())];
    match random.below(2) {
        0 => drop(members.remove(key)),
        _ => drop(members.insert(key.clone(), donor.clone())),
    }
}

/// Returns the number of values of a tree, with the root.
fn count(value: &Value) -> usize {
    1 + match value {
        Value::Array(items) => items.iter().map(count).sum(),
        Value::Object(members) => members.values().map(count).sum(),
        _ => 0,
    }
}

/// Returns the value with this number in the order of a walk from the root, which has number 0.
fn nth(value: &Value, mut number: usize) -> Option<&Value> {
    if number == 0 {
        return Some(value);
    }
    number -= 1;
    let children: Vec<&Value> = match value {
        Value::Array(items) => items.iter().collect(),
        Value::Object(members) => members.values().collect(),
        _ => Vec::new(),
    };
    for child in children {
        let size = count(child);
        if number < size {
            return nth(child, number);
        }
        number -= size;
    }
    None
}

/// Returns what [`nth`] returns, to be changed.
fn nth_mut(value: &mut Value, mut number: usize) -> Option<&mut Value> {
    if number == 0 {
        return Some(value);
    }
    number -= 1;
    let children: Vec<&mut Value> = match value {
        Value::Array(items) => items.iter_mut().collect(),
        Value::Object(members) => members.values_mut().collect(),
        _ => Vec::new(),
    };
    for child in children {
        let size = count(child);
        if number < size {
            return nth_mut(child, number);
        }
        number -= size;
    }
    None
}
