//! Text table of a benchmark: `whit bench`.

use std::fmt;

use crate::accel::{Backend, Precision};
use crate::bench::{BenchRow, FrameTime, Mode, Scaled, ScaledBuild};
use crate::report::format::{busy_line, significant};
use crate::report::memory;

/// Benchmark rows of one scene as a text table.
pub struct BenchTable<'r>(pub &'r [BenchRow]);

impl fmt::Display for BenchTable<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Some(first) = self.0.first() else {
            return Ok(());
        };
        // Print scene and builds
        writeln!(f, "{}", first.scene.display())?;
        self.write_builds(f)?;
        // Print a line for each row
        let names = self.0.iter().map(|row| row.name().len() + 2);
        let width = names.fold("backend ".len(), usize::max);
        writeln!(
            f,
            "  {:<11}{:<width$}{:<11}{:>9}  {:<17}{:>10}{:>9}{:>7}",
            "rays", "backend", "mode", "Mrays/s", "(min .. max)", "of Embree", "differ", "ties"
        )?;
        for row in self.0 {
            let extremes = format!("({:.2} .. {:.2})", row.mrays_per_s_min, row.mrays_per_s_max);
            let ratio = self
                .over_embree(row)
                .map_or(String::new(), |ratio| format!("{ratio:.2}"));
            writeln!(
                f,
                "  {:<11}{:<width$}{:<11}{:>9.2}  {extremes:<17}{ratio:>10}{:>9}{:>7}",
                row.rays,
                row.name(),
                row.mode,
                row.mrays_per_s,
                row.mismatches,
                row.ties
            )?;
        }
        // Print frame times and scaling where they were measured
        if let Some(frame) = self.0.iter().find_map(|row| row.frame) {
            writeln!(
                f,
                "  frame: {:.3} s for {:.2} Mrays on one thread, {:.2} times the raw packets' time; {:.0} % of it tracing",
                frame.seconds,
                frame.rays as f64 * 1e-6,
                frame.over_raw,
                100.0 * frame.trace_share
            )?;
            self.write_rungs(f, frame)?;
        }
        self.write_scaling(f, width)?;
        busy_line(first.waiting).map_or(Ok(()), |line| writeln!(f, "  {line}"))
    }
}

impl BenchTable<'_> {
    /// Writes build times and speeds by number of threads, and the parallel efficiency of the largest number.
    fn write_scaling(&self, f: &mut fmt::Formatter, width: usize) -> fmt::Result {
        let Some(counts) = self.0.first().map(|row| &row.scaling).filter(|s| !s.is_empty()) else {
            return Ok(());
        };
        // Print the numbers of threads as a heading
        write!(f, "  {:<11}{:<width$}{:<11}", "threads", "backend", "mode")?;
        for scaled in counts {
            write!(f, "{:>9}", scaled.threads)?;
        }
        writeln!(f, "{:>12}", "efficiency")?;
        // Print build times of each structure
        let mut seen = Vec::new();
        for row in self
            .0
            .iter()
            .filter(|row| !seen_before(&mut seen, row.structure()))
        {
            write!(f, "  {:<11}{:<width$}{:<11}", "build, s", row.name(), "")?;
            for build in &row.build_scaling {
                write!(f, "{:>9}", significant(build.build_seconds, 3))?;
            }
            writeln!(f, "{:>12}", in_words(build_efficiency(&row.build_scaling)))?;
        }
        // Print speeds of each row
        for row in self.0 {
            write!(f, "  {:<11}{:<width$}{:<11}", row.rays, row.name(), row.mode)?;
            for scaled in &row.scaling {
                write!(f, "{:>9.2}", scaled.mrays_per_s)?;
            }
            writeln!(f, "{:>12}", in_words(efficiency(&row.scaling)))?;
        }
        Ok(())
    }

    /// Writes one line for each further precision of Embree: the frame time relative to the first one's.
    fn write_rungs(&self, f: &mut fmt::Formatter, first: FrameTime) -> fmt::Result {
        let mut seen: Vec<Precision> = self.0.iter().take(1).map(|row| row.precision).collect();
        for row in self.0.iter().filter(|row| row.backend == Backend::Embree) {
            if let Some(frame) = row.frame
                && !seen.contains(&row.precision)
            {
                seen.push(row.precision);
                let (precision, seconds) = (row.precision, frame.seconds);
                let ratio = seconds / first.seconds;
                writeln!(f, "  frame, {precision}: {seconds:.3} s, {ratio:.2} times that")?;
            }
        }
        Ok(())
    }

    /// Writes one line for each backend, precision and kind of instancing.
    fn write_builds(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let mut seen = Vec::new();
        for row in self.0 {
            if seen_before(&mut seen, row.structure()) {
                continue;
            }
            // Print the library's version, the options and the size
            let identity = row
                .embree
                .as_ref()
                .map_or(String::new(), |e| format!(" {} {}", e.version, e.isa));
            writeln!(
                f,
                "  {}{identity} ({}): built in {} s ({} .. {}) on {} threads, {}{}",
                row.backend,
                precision_and_instancing(row),
                significant(row.build_seconds, 3),
                significant(row.build_seconds_min, 3),
                significant(row.build_seconds_max, 3),
                row.threads,
                memory::in_words(row.bytes),
                row.bytes_per_triangle()
                    .map_or(String::new(), |bytes| format!(", {bytes:.1} bytes per triangle"))
            )?;
        }
        Ok(())
    }

    /// Returns the speed relative to Embree in the same mode, at the precision and kind of instancing that are listed
    /// first; batches are compared with packets.
    pub(in crate::report) fn over_embree(&self, row: &BenchRow) -> Option<f64> {
        // Embree has no batches, so that they are compared with packets.
        let mode = if row.mode == Mode::Batch {
            Mode::Packet
        } else {
            row.mode
        };
        self.0
            .iter()
            .find(|other| other.backend == Backend::Embree && other.rays == row.rays && other.mode == mode)
            .map(|other| row.mrays_per_s / other.mrays_per_s)
    }
}

fn precision_and_instancing(row: &BenchRow) -> String {
    match row.instancing {
        Some(instancing) => format!("{}, {instancing} instancing", row.precision),
        None => row.precision.to_string(),
    }
}

/// Returns whether `structure` is in the list already, and appends it if not.
pub(in crate::report) fn seen_before<T: PartialEq>(seen: &mut Vec<T>, structure: T) -> bool {
    let is_known = seen.contains(&structure);
    if !is_known {
        seen.push(structure);
    }
    is_known
}

/// Returns the parallel efficiency: the speedup from the fewest to the most threads over the ratio of their numbers.
pub(in crate::report) fn efficiency(scaling: &[Scaled]) -> Option<f64> {
    let (first, last) = (scaling.first()?, scaling.last()?);
    Some(last.mrays_per_s / first.mrays_per_s * first.threads as f64 / last.threads as f64)
}

/// Returns the parallel efficiency of builds, defined as in [`efficiency`].
pub(in crate::report) fn build_efficiency(scaling: &[ScaledBuild]) -> Option<f64> {
    let (first, last) = (scaling.first()?, scaling.last()?);
    Some(first.build_seconds / last.build_seconds * first.threads as f64 / last.threads as f64)
}

fn in_words(efficiency: Option<f64>) -> String {
    efficiency.map_or(String::new(), |part| format!("{part:.2}"))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::bench::RayKind;

    pub(in crate::report) fn row(backend: Backend, mode: Mode, mrays_per_s: f64) -> BenchRow {
        BenchRow {
            scene: "a.glb".into(),
            triangles: 20_000,
            backend,
            instancing: None,
            precision: Precision::Robust,
            rays: RayKind::Camera,
            mode,
            mrays_per_s,
            mrays_per_s_min: mrays_per_s,
            mrays_per_s_max: mrays_per_s,
            ray_count: 1,
            build_seconds: 0.5,
            build_seconds_min: 0.25,
            build_seconds_max: 1.0,
            bytes: 2_000_000,
            mismatches: 0,
            ties: 0,
            threads: 1,
            waiting: 0.0,
            embree: None,
            frame: None,
            scaling: Vec::new(),
            build_scaling: Vec::new(),
        }
    }

    #[test]
    fn modes_compare_with_the_same_embree_mode_batches_with_packets() {
        let rows = [
            row(Backend::Embree, Mode::Single, 4.0),
            row(Backend::Embree, Mode::Packet, 10.0),
            row(Backend::Bsp, Mode::Single, 3.0),
            row(Backend::Bsp, Mode::Batch, 15.0),
        ];
        let table = BenchTable(&rows);
        assert_eq!(
            rows.each_ref().map(|r| table.over_embree(r)),
            [1.0, 1.0, 0.75, 1.5].map(Some)
        );
        assert_eq!(BenchTable(&rows[2..]).over_embree(&rows[2]), None);
        let text = table.to_string();
        assert_eq!(
            text.matches("built in 0.500 s (0.250 .. 1.00) on 1 threads, 2.0 MB, 100.0 bytes per triangle")
                .count(),
            2,
            "{text}"
        );
    }

    #[test]
    fn efficiency_is_the_speed_over_ideal_scaling() {
        let scaled = |threads, mrays_per_s| Scaled {
            threads,
            mrays_per_s,
            mrays_per_s_min: mrays_per_s,
            mrays_per_s_max: mrays_per_s,
        };
        let build = |threads, build_seconds| ScaledBuild {
            threads,
            build_seconds,
            build_seconds_min: build_seconds,
            build_seconds_max: build_seconds,
        };
        // 4 threads are 3 times as fast as one; a build on 2 takes 2/3 of the time.
        let mut row = row(Backend::Bsp, Mode::Packet, 5.0);
        row.scaling = vec![scaled(1, 5.0), scaled(2, 9.0), scaled(4, 15.0)];
        row.build_scaling = vec![build(1, 3.0), build(2, 2.0)];
        assert_eq!(efficiency(&row.scaling), Some(0.75));
        assert_eq!(build_efficiency(&row.build_scaling), Some(0.75));
        assert_eq!(efficiency(&[]), None);
        let text = BenchTable(&[row]).to_string();
        assert_eq!(text.matches(" 0.75\n").count(), 2, "{text}");
    }
}
