//! Identification of the machine that measurements ran on.

use std::fs;

/// Returns the processor's name from the operating system, or the instruction-set architecture where it is unknown.
pub(super) fn processor() -> String {
    let told = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    name_in(&told).unwrap_or_else(|| std::env::consts::ARCH.to_owned())
}

/// Returns the first processor's name in the text of `/proc/cpuinfo`.
fn name_in(told: &str) -> Option<String> {
    let line = told.lines().find(|line| line.starts_with("model name"))?;
    let (_, name) = line.split_once(':')?;
    let name = name.split_whitespace().collect::<Vec<_>>().join(" ");
    (!name.is_empty()).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_processor_is_named_as_linux_names_it() {
        let told = "processor\t: 0\nmodel name\t: Some  Processor @ 2 GHz\nmodel name\t: other\n";
        assert_eq!(name_in(told).as_deref(), Some("Some Processor @ 2 GHz"));
        assert_eq!(name_in("model name\t: \n"), None);
        assert_eq!(name_in(""), None);
        assert!(!processor().is_empty());
    }
}
