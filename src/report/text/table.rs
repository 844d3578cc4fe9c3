//! Text table of rays, seconds and bytes by effect: `whit render --stats -`.

use std::fmt::Write;

use super::stats::{AccountStats, RenderStats};
use crate::render::Category;
use crate::report::memory::in_words;

/// Returns the render profile of an image with one line per account, and the overhead of the measurement.
pub fn ledger(stats: &RenderStats) -> String {
    let mut text = row(["", "rays", "seconds", "share", "bytes", "reason"]);
    let whole = stats.ledger.thread_seconds;
    let is_account = |name: &str| Category::ALL.iter().any(|account| account.name() == name);
    // List accounts that took rays, time or memory
    for account in Category::ALL {
        let name = account.name();
        let Some(spent) = stats.ledger.accounts.get(name) else {
            continue;
        };
        if spent.rays == 0 && spent.seconds == 0.0 && spent.bytes == 0 {
            continue;
        }
        let reason = stats
            .effects
            .get(name)
            .map_or("", |effect| effect.reason.as_str());
        text += &spent_row(name, *spent, whole, reason);
    }
    // List effects that have no account of their own
    for (name, effect) in &stats.effects {
        if (effect.on || effect.bytes > 0) && !is_account(name) {
            text += &row([name, "", "", "", &bytes_in_words(effect.bytes), &effect.reason]);
        }
    }
    // List memory of the acceleration structure
    for (name, bytes) in structures(stats) {
        text += &row([name, "", "", "", &bytes_in_words(bytes), ""]);
    }
    // Append totals and the overhead of reading the clock
    text += &spent_row("total", total(stats), whole, "");
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "peak memory of the render phase: {}",
        in_words(stats.ledger.bytes_at_once)
    );
    let _ = writeln!(
        text,
        "{} threads, {:.3} s each; {} readings of the clock at {:.0} ns took {:.2} % of that",
        stats.threads,
        whole / stats.threads as f64,
        group_thousands(stats.ledger.clock_reads),
        stats.ledger.clock_read_seconds * 1e9,
        percent(stats.ledger.seconds_of_measuring, whole),
    );
    text
}

/// Returns the bytes held for intersection, which belong to neither an effect nor an account.
fn structures(stats: &RenderStats) -> Vec<(&'static str, u64)> {
    let mut sums: Vec<(&str, u64)> = Vec::new();
    for holding in &stats.ledger.holdings {
        let name = holding.holder;
        if stats.ledger.accounts.contains_key(name) || stats.effects.contains_key(name) {
            continue;
        }
        match sums.iter_mut().find(|(known, _)| *known == name) {
            Some((_, sum)) => *sum += holding.bytes,
            None => sums.push((name, holding.bytes)),
        }
    }
    sums
}

fn total(stats: &RenderStats) -> AccountStats {
    let accounts = || stats.ledger.accounts.values();
    AccountStats {
        rays: accounts().map(|spent| spent.rays).sum(),
        seconds: accounts().map(|spent| spent.seconds).sum(),
        trace_seconds: accounts().map(|spent| spent.trace_seconds).sum(),
        bytes: stats.ledger.bytes,
    }
}

fn spent_row(name: &str, spent: AccountStats, whole: f64, reason: &str) -> String {
    let rays = match spent.rays {
        0 => String::new(),
        rays => group_thousands(rays),
    };
    let seconds = format!("{:.3}", spent.seconds);
    let share = format!("{:.1} %", percent(spent.seconds, whole));
    row([
        name,
        &rays,
        &seconds,
        &share,
        &bytes_in_words(spent.bytes),
        reason,
    ])
}

fn row([name, rays, seconds, share, bytes, reason]: [&str; 6]) -> String {
    let line = format!("{name:<18} {rays:>15} {seconds:>9} {share:>8} {bytes:>9}  {reason}");
    format!("{}\n", line.trim_end())
}

fn bytes_in_words(bytes: u64) -> String {
    match bytes {
        0 => String::new(),
        bytes => in_words(bytes),
    }
}

fn percent(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { 100.0 * part / whole } else { 0.0 }
}

/// Formats a number with a space between thousands.
pub fn group_thousands(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_separated_by_spaces() {
        assert_eq!(group_thousands(0), "0");
        assert_eq!(group_thousands(999), "999");
        assert_eq!(group_thousands(1_000), "1 000");
        assert_eq!(group_thousands(12_345_678), "12 345 678");
    }

    #[test]
    fn row_shows_the_share_and_omits_zero_rays() {
        let spent = AccountStats {
            rays: 0,
            seconds: 0.25,
            trace_seconds: 0.0,
            bytes: 12_345,
        };
        let line = spent_row("film", spent, 2.0, "");
        assert_eq!(
            line.split_whitespace().collect::<Vec<_>>(),
            ["film", "0.250", "12.5", "%", "12.3", "kB"]
        );
    }
}
