//! Identification of the machine that measurements ran on.

use std::fs;

/// Returns the processor's name from the operating system, or the instruction-set architecture where it is unknown.
pub(super) fn processor() -> String {
    let cpu_info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    parse_model_name(&cpu_info).unwrap_or_else(|| std::env::consts::ARCH.to_owned())
}

/// Returns the first processor's name in the text of `/proc/cpuinfo`.
fn parse_model_name(cpu_info: &str) -> Option<String> {
    let line = cpu_info.lines().find(|line| line.starts_with("model name"))?;
    let (_, name) = line.split_once(':')?;
    let name = name.split_whitespace().collect::<Vec<_>>().join(" ");
    (!name.is_empty()).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_name_is_read_from_cpuinfo() {
        let cpu_info = "processor\t: 0\nmodel name\t: Some  Processor @ 2 GHz\nmodel name\t: other\n";
        assert_eq!(
            parse_model_name(cpu_info).as_deref(),
            Some("Some Processor @ 2 GHz")
        );
        assert_eq!(parse_model_name("model name\t: \n"), None);
        assert_eq!(parse_model_name(""), None);
        assert!(!processor().is_empty());
    }
}
