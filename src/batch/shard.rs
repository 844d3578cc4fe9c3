//! Shards of a batch: the part of the frames that one of several processes renders.

use std::env;
use std::ops::Range;
use std::str::FromStr;

/// Environment variables in which schedulers pass the index of a task, with the index of the first task: Slurm's job
/// arrays, whose first task is 1 in our scripts, and Kubernetes' indexed jobs.
const TASK_NUMBERS: [(&str, u32); 2] = [("SLURM_ARRAY_TASK_ID", 1), ("JOB_COMPLETION_INDEX", 0)];

/// One of several contiguous parts of about equal size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of the shard, from 1 to `count`.
    pub number: u32,
    /// Number of shards in total.
    pub count: u32,
}

impl Shard {
    /// Single shard that has everything.
    pub const ALL: Shard = Shard { number: 1, count: 1 };

    /// Returns the indices out of `count` items that this shard has: neighbours, which share the most data.
    pub fn of(&self, count: usize) -> Range<usize> {
        let start = |number: u32| (count as u128 * u128::from(number) / u128::from(self.count)) as usize;
        start(self.number - 1)..start(self.number)
    }

    fn parse(text: &str, variable: impl Fn(&str) -> Option<String>) -> Result<Shard, String> {
        let form =
            || "give a shard and the number of shards, as in 3/24, or auto/24 within a job array".to_owned();
        // Parse the number, or take it from the scheduler's environment variable
        let (number, count) = text.split_once('/').ok_or_else(form)?;
        let count: u32 = count.parse().map_err(|_| form())?;
        let number = match number {
            "auto" => task_number(variable)?,
            number => number.parse().map_err(|_| form())?,
        };
        if !(1..=count).contains(&number) {
            return Err(format!("there is no shard {number} of {count}: count from 1"));
        }
        Ok(Shard { number, count })
    }
}

impl Default for Shard {
    fn default() -> Shard {
        Shard::ALL
    }
}

impl FromStr for Shard {
    type Err = String;

    /// Parses `3/24`, or `auto/24` where a scheduler's environment variable gives the number.
    fn from_str(text: &str) -> Result<Shard, String> {
        Shard::parse(text, |name| env::var(name).ok())
    }
}

/// Returns the number of this task in its array, from 1.
fn task_number(variable: impl Fn(&str) -> Option<String>) -> Result<u32, String> {
    // Use the first scheduler variable that is set, and count from 1
    for (name, first) in TASK_NUMBERS {
        if let Some(text) = variable(name) {
            let number = text
                .parse()
                .ok()
                .and_then(|number: u32| number.checked_add(1)?.checked_sub(first));
            return number.ok_or_else(|| {
                format!("{name} is `{text}`, which is not a task number: give the shard's number, as in 3/24")
            });
        }
    }
    Err(
        "neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX is set: give the shard's number, as in 3/24"
            .into(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str, (name, value): (&str, &str)) -> Result<Shard, String> {
        Shard::parse(text, |requested| (requested == name).then(|| value.to_owned()))
    }

    #[test]
    fn shard_number_is_parsed_or_read_from_the_scheduler() {
        let shard = |number, count| Ok(Shard { number, count });
        assert_eq!(parse("3/24", ("", "")), shard(3, 24));
        assert_eq!(parse("auto/24", ("SLURM_ARRAY_TASK_ID", "24")), shard(24, 24));
        assert_eq!(parse("auto/24", ("JOB_COMPLETION_INDEX", "0")), shard(1, 24));
        for (text, variable) in [
            ("0/4", ("", "")),
            ("5/4", ("", "")),
            ("1/0", ("", "")),
            ("4", ("", "")),
            ("a/b", ("", "")),
            ("auto/4", ("", "")),
            ("auto/4", ("JOB_COMPLETION_INDEX", "4")),
            ("auto/4", ("SLURM_ARRAY_TASK_ID", "0")),
            ("auto/4", ("SLURM_ARRAY_TASK_ID", "x")),
            ("auto/4", ("SLURM_ARRAY_TASK_ID", "4294967295")),
        ] {
            assert!(parse(text, variable).is_err(), "{text} {variable:?}");
        }
    }

    #[test]
    fn shards_cover_all_items_once_in_equal_parts() {
        for (things, count) in [(24, 3), (5, 8), (100, 7), (0, 2)] {
            let mut next = 0;
            for number in 1..=count {
                let range = Shard { number, count }.of(things);
                assert_eq!(range.start, next);
                assert!(range.len().abs_diff(things / count as usize) <= 1);
                next = range.end;
            }
            assert_eq!(next, things);
        }
    }
}
