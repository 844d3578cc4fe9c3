//! Parameter sweeps: keys of a scene file with lists of values, expanded to all combinations.

use std::collections::BTreeMap;

use toml::Value;

use super::range::MAX_FRAMES;
use super::spec::{StepsSpec, SweepSpec};
use crate::scene_file::Edit;
use crate::scene_file::fault::Diagnostic;
use crate::scene_file::value::Located;

/// Fields of image names that every job has, beside those of its sweeps.
pub(super) const FIELDS: [&str; 5] = ["scene", "camera", "job", "frame", "time"];

/// Swept key with one of its values.
#[derive(Clone, Debug)]
pub(super) struct SweepValue {
    /// Name of the key in image names, as in `{field}`.
    pub(super) field: String,
    /// Spelling of the value in image names.
    pub(super) label: String,
    pub(super) edit: Edit,
}

/// Swept key with all its values.
struct SweepAxis<'f> {
    form: &'f Located<SweepSpec>,
    points: Vec<SweepValue>,
}

/// Returns the edits of each frame of a sweep: every combination of the values, or with `zip` the first value of each
/// key, the second of each, and so on. The last key in the file changes fastest. Without a sweep the result is one
/// empty list.
pub(super) fn combinations(
    sweep: &BTreeMap<String, Located<SweepSpec>>,
    zip: Option<&Located<bool>>,
) -> Result<Vec<Vec<SweepValue>>, Diagnostic> {
    let axes = axes(sweep)?;
    if let Some(zip) = zip.filter(|zip| ***zip) {
        return zipped(&axes, zip);
    }
    // Multiply the combinations so far by the values of each further key
    let mut all = vec![Vec::new()];
    for axis in &axes {
        if all.len().saturating_mul(axis.points.len()) > MAX_FRAMES {
            let sentence = format!("makes more than {MAX_FRAMES} frames: give fewer values");
            return Err(axis.form.fault(sentence));
        }
        let with =
            |before: &Vec<SweepValue>, point: &SweepValue| before.iter().chain([point]).cloned().collect();
        all = all
            .iter()
            .flat_map(|before| axis.points.iter().map(|point| with(before, point)))
            .collect();
    }
    Ok(all)
}

fn zipped(axes: &[SweepAxis], zip: &Located<bool>) -> Result<Vec<Vec<SweepValue>>, Diagnostic> {
    let Some(first) = axes.first() else {
        return Err(
            zip.fault("applies to a `sweep`, and there is no `sweep` in the job: add one, or remove `zip`")
        );
    };
    let count = first.points.len();
    if let Some(other) = axes.iter().find(|axis| axis.points.len() != count) {
        return Err(other.form.fault(format!(
            "has {} values, but the first key has {count}: with `zip`, give all keys the same number",
            other.points.len()
        )));
    }
    let row = |index: usize| axes.iter().map(|axis| axis.points[index].clone()).collect();
    Ok((0..count).map(row).collect())
}

/// Returns the swept keys in the order in which the file has them.
fn axes(sweep: &BTreeMap<String, Located<SweepSpec>>) -> Result<Vec<SweepAxis<'_>>, Diagnostic> {
    let mut written: Vec<(&String, &Located<SweepSpec>)> = sweep.iter().collect();
    written.sort_by_key(|(_, form)| form.span.start);
    let words = |(key, form): &(&String, &Located<SweepSpec>)| {
        Edit::words(key).map_err(|sentence| form.fault(sentence))
    };
    let keys: Vec<Vec<String>> = written.iter().map(words).collect::<Result<_, _>>()?;
    let mut axes = Vec::with_capacity(keys.len());
    for (index, (_, form)) in written.into_iter().enumerate() {
        let field = field(&keys, index).ok_or_else(|| form.fault("is swept twice: keep one of them"))?;
        let values = values(form)?;
        let point = |(number, value): (usize, Value)| SweepValue {
            field: field.clone(),
            label: label(&value, number),
            edit: Edit {
                key: keys[index].clone(),
                value,
            },
        };
        let points = values.into_iter().enumerate().map(point).collect();
        axes.push(SweepAxis { form, points });
    }
    Ok(axes)
}

/// Returns the name of a key in image names: its last part, or as many of its last parts as distinguish it from all
/// other keys; a key that coincides with a built-in field is called `sweep.KEY`. Returns `None` if a key is swept
/// twice.
fn field(keys: &[Vec<String>], index: usize) -> Option<String> {
    let key = &keys[index];
    let is_taken = |count: usize| {
        let last = &key[key.len() - count..];
        let is_field = matches!(last, [word] if FIELDS.contains(&word.as_str()));
        let is_other = |(i, other): (usize, &Vec<String>)| i != index && other.ends_with(last);
        is_field || keys.iter().enumerate().any(is_other)
    };
    match (1..=key.len()).find(|&count| !is_taken(count)) {
        Some(count) => Some(key[key.len() - count..].join(".")),
        None if keys.iter().filter(|other| *other == key).count() > 1 => None,
        None => Some(format!("sweep.{}", key.join("."))),
    }
}

/// Returns the spelling of a value in image names; a table has no short spelling and is represented by its position in
/// the list, from 1.
fn label(value: &Value, index: usize) -> String {
    match value {
        Value::Table(_) => (index + 1).to_string(),
        value => word(value),
    }
}

/// Returns a value in the spelling of the command line: strings without quotes, arrays joined by commas.
pub(super) fn word(value: &Value) -> String {
    match value {
        Value::String(word) => word.clone(),
        Value::Array(values) => values.iter().map(word).collect::<Vec<_>>().join(","),
        value => value.to_string(),
    }
}

fn values(form: &Located<SweepSpec>) -> Result<Vec<Value>, Diagnostic> {
    match &**form {
        SweepSpec::List(values) if values.is_empty() => Err(form.fault("has no values: give at least one")),
        SweepSpec::List(values) => Ok(values.clone()),
        SweepSpec::Steps(steps) => steps.values().ok_or_else(|| {
            form.fault(format!(
                "has no valid steps: give two numbers and 2 to {MAX_FRAMES} `steps`"
            ))
        }),
    }
}

impl StepsSpec {
    /// Returns the values including both ends, or `None` if the range is invalid. They are integers if the ends are and
    /// the step between them is an integer.
    fn values(&self) -> Option<Vec<Value>> {
        if !(2..=MAX_FRAMES as u32).contains(&self.steps) {
            return None;
        }
        let last = self.steps - 1;
        // Keep integers if the step is an integer
        if let (Value::Integer(from), Value::Integer(to)) = (&self.from, &self.to) {
            let way = to.checked_sub(*from)?;
            if way % i64::from(last) == 0 {
                let stride = way / i64::from(last);
                let value = |step: u32| Value::Integer(from + stride * i64::from(step));
                return Some((0..=last).map(value).collect());
            }
        }
        // Otherwise interpolate between the ends, which stay exact
        let [from, to] = [number(&self.from)?, number(&self.to)?];
        let value = |step: u32| {
            let part = f64::from(step) / f64::from(last);
            Value::Float(from * (1.0 - part) + to * part)
        };
        Some((0..=last).map(value).collect())
    }
}

fn number(value: &Value) -> Option<f64> {
    let number = value
        .as_float()
        .or_else(|| value.as_integer().map(|whole| whole as f64));
    number.filter(|number| number.is_finite())
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;
    use crate::scene_file::node::from_text;

    #[derive(Deserialize)]
    struct SweepForm {
        sweep: BTreeMap<String, Located<SweepSpec>>,
        zip: Option<Located<bool>>,
    }

    /// Returns fields and labels of all combinations.
    fn labels(text: &str) -> Result<Vec<String>, String> {
        let form: SweepForm = from_text(text).unwrap();
        let all =
            combinations(&form.sweep, form.zip.as_ref()).map_err(|fault| fault.sentence().to_owned())?;
        let words = |points: &Vec<SweepValue>| {
            let words = points
                .iter()
                .map(|point| format!("{}={}", point.field, point.label));
            words.collect::<Vec<_>>().join(" ")
        };
        Ok(all.iter().map(words).collect())
    }

    #[test]
    fn last_written_key_varies_fastest() {
        let text = "[sweep]\n\"material.b.ior\" = [1.5, 2]\n\"ambient\" = [0, 1]\n";
        let expected = [
            "ior=1.5 ambient=0",
            "ior=1.5 ambient=1",
            "ior=2 ambient=0",
            "ior=2 ambient=1",
        ];
        assert_eq!(labels(text).unwrap(), expected);
    }

    #[test]
    fn zipped_keys_vary_together() {
        let text = "zip = true\n[sweep]\na = [1, 2]\nb = { from = 5, to = 6, steps = 2 }\n";
        assert_eq!(labels(text).unwrap(), ["a=1 b=5", "a=2 b=6"]);
        let uneven = labels("zip = true\n[sweep]\na = [1, 2]\nb = [3]\n").unwrap_err();
        assert!(uneven.contains("1 values, but the first key has 2"), "{uneven}");
    }

    #[test]
    fn keys_with_equal_last_parts_get_longer_field_names() {
        let text =
            "[sweep]\n\"material.a.ior\" = [1]\n\"material.b.ior\" = [2]\ntime = [3]\n\"x.camera\" = [4]\n";
        assert_eq!(labels(text).unwrap(), ["a.ior=1 b.ior=2 sweep.time=3 x.camera=4"]);
        let twice = labels("[sweep]\n\"a.b\" = [1]\n'a.\"b\"' = [2]\n").unwrap_err();
        assert!(twice.contains("swept twice"), "{twice}");
    }

    #[test]
    fn steps_include_exact_ends_and_stay_integers() {
        let steps = |values: &str| labels(&format!("[sweep]\na = {{ {values} }}\n"));
        assert_eq!(
            steps("from = 1, to = 7, steps = 3").unwrap(),
            ["a=1", "a=4", "a=7"]
        );
        assert_eq!(
            steps("from = 0, to = 1, steps = 3").unwrap(),
            ["a=0.0", "a=0.5", "a=1.0"]
        );
        // The ends are 0.1 and 0.7 exactly, not 0.1 + (0.7 - 0.1).
        let ends = steps("from = 0.1, to = 0.7, steps = 4").unwrap();
        assert_eq!((ends[0].as_str(), ends[3].as_str()), ("a=0.1", "a=0.7"));
        for bad in [
            "from = 0, to = 1, steps = 1",
            "from = 'a', to = 1, steps = 2",
            "from = nan, to = 1, steps = 2",
        ] {
            assert!(steps(bad).unwrap_err().contains("has no valid steps"), "{bad}");
        }
    }

    #[test]
    fn tables_are_labelled_by_position() {
        let text = "[sweep]\nbackground = [{ up = 1 }, { up = 2 }]\nsky = [[1, 2]]\n";
        let expected = ["background=1 sky=1,2", "background=2 sky=1,2"];
        assert_eq!(labels(text).unwrap(), expected);
    }
}
