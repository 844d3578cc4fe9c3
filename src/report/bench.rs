//! Rows of a benchmark: `whit bench`.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use crate::accel::{Backend, EmbreeIdentity, Instancing, Precision};

use super::memory;

/// What a set of rays is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RayKind {
    /// From the frame's camera.
    Camera,
    /// From the frame's surfaces to its lights.
    Shadow,
    /// From the frame's mirrors.
    Reflection,
    /// Uniformly random, within the scene's bounds.
    Random,
}

impl fmt::Display for RayKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(match self {
            RayKind::Camera => "camera",
            RayKind::Shadow => "shadow",
            RayKind::Reflection => "reflection",
            RayKind::Random => "random",
        })
    }
}

/// How the rays are handed over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The bare library calls, 16 rays each.
    Raw,
    /// One ray at a time.
    Single,
    /// 16 rays at a time.
    Packet,
    /// Many packets at once, for a backend that interleaves them.
    Batch,
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(match self {
            Mode::Raw => "raw",
            Mode::Single => "single",
            Mode::Packet => "packet",
            Mode::Batch => "batch",
        })
    }
}

/// Median and extremes of repeated measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The middle one; the mean of the middle two of an even number.
    pub median: f64,
    /// The least.
    pub min: f64,
    /// The greatest.
    pub max: f64,
}

impl Spread {
    /// The spread of `values`; zeros if there are none.
    pub fn of(values: &[f64]) -> Spread {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (Some(&min), Some(&max)) = (sorted.first(), sorted.last()) else {
            return Spread {
                median: 0.0,
                min: 0.0,
                max: 0.0,
            };
        };
        let middle = sorted.len() / 2;
        let median = match sorted.len() % 2 {
            1 => sorted[middle],
            _ => 0.5 * (sorted[middle - 1] + sorted[middle]),
        };
        Spread { median, min, max }
    }
}

/// One way of tracing one kind of ray in one scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchRow {
    /// As it was named on the command line.
    pub scene: PathBuf,
    /// What found the hits.
    pub backend: Backend,
    /// How Embree was given placed meshes, where it is the backend and the scene has some.
    pub instancing: Option<Instancing>,
    /// How far triangle hits may be trusted.
    pub precision: Precision,
    /// Which rays.
    pub rays: RayKind,
    /// How they were handed over.
    pub mode: Mode,
    /// Million rays a second on one thread: the median over the repetitions.
    pub mrays_per_s: f64,
    /// The slowest repetition's.
    pub mrays_per_s_min: f64,
    /// The fastest repetition's.
    pub mrays_per_s_max: f64,
    /// Rays replayed in each repetition.
    pub ray_count: u64,
    /// Seconds of the build, on `threads` threads: the median over the repetitions.
    pub build_seconds: f64,
    /// The fastest one's.
    pub build_seconds_min: f64,
    /// The slowest one's.
    pub build_seconds_max: f64,
    /// Bytes of the structure.
    pub bytes: u64,
    /// Answers that differ from the first backend's packets by more than rounding; of raw calls, from their own
    /// packets'.
    pub mismatches: u64,
    /// Answers that differ within the documented rounding.
    pub ties: u64,
    /// Threads of the build.
    pub threads: usize,
    /// Which Embree, where it is the backend.
    pub embree: Option<EmbreeIdentity>,
    /// The whole frame on one thread, where raw packets were timed: with Embree at this precision, else with the first
    /// backend.
    pub frame: Option<FrameTime>,
}

/// The render loop against the bare traces of the same rays.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameTime {
    /// Wall-clock seconds of the render phase on one thread, the median.
    pub seconds: f64,
    /// Rays of the frame.
    pub rays: u64,
    /// `seconds` over the time that the first backend's raw packets take for the same rays.
    pub over_raw: f64,
    /// Part of `seconds` that is spent within the backend.
    pub trace_share: f64,
}

impl BenchRow {
    /// The backend, how far its triangles may be trusted where that may be chosen, and how it was given placed meshes.
    fn name(&self) -> String {
        let precision = match self.backend {
            Backend::Embree => format!(" {}", self.precision),
            Backend::Bsp | Backend::Brute => String::new(),
        };
        let instancing = self.instancing.map_or(String::new(), |kind| format!(" {kind}"));
        format!("{}{precision}{instancing}", self.backend)
    }

    fn precision_and_instancing(&self) -> String {
        match self.instancing {
            Some(instancing) => format!("{}, {instancing} instancing", self.precision),
            None => self.precision.to_string(),
        }
    }
}

/// The rows of one scene, for a person.
pub struct BenchTable<'r>(pub &'r [BenchRow]);

impl fmt::Display for BenchTable<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Some(first) = self.0.first() else {
            return Ok(());
        };
        writeln!(f, "{}", first.scene.display())?;
        self.write_builds(f)?;
        let names = self.0.iter().map(|row| row.name().len() + 2);
        let width = names.fold("backend ".len(), usize::max);
        writeln!(
            f,
            "  {:<11}{:<width$}{:<8}{:>9}  {:<17}{:>10}{:>9}{:>7}",
            "rays", "backend", "mode", "Mrays/s", "(min .. max)", "of Embree", "differ", "ties"
        )?;
        for row in self.0 {
            let extremes = format!("({:.2} .. {:.2})", row.mrays_per_s_min, row.mrays_per_s_max);
            let ratio = self
                .over_embree(row)
                .map_or(String::new(), |ratio| format!("{ratio:.2}"));
            writeln!(
                f,
                "  {:<11}{:<width$}{:<8}{:>9.2}  {extremes:<17}{ratio:>10}{:>9}{:>7}",
                row.rays,
                row.name(),
                row.mode,
                row.mrays_per_s,
                row.mismatches,
                row.ties
            )?;
        }
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
        Ok(())
    }
}

impl BenchTable<'_> {
    /// One line a precision of Embree but the first: the whole frame against the first's.
    fn write_rungs(&self, f: &mut fmt::Formatter, first: FrameTime) -> fmt::Result {
        let mut told: Vec<Precision> = self.0.iter().take(1).map(|row| row.precision).collect();
        for row in self.0.iter().filter(|row| row.backend == Backend::Embree) {
            if let Some(frame) = row.frame
                && !told.contains(&row.precision)
            {
                told.push(row.precision);
                let (precision, seconds) = (row.precision, frame.seconds);
                let ratio = seconds / first.seconds;
                writeln!(f, "  frame, {precision}: {seconds:.3} s, {ratio:.2} times that")?;
            }
        }
        Ok(())
    }

    /// One line a backend, precision and kind of instancing.
    fn write_builds(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let mut told = Vec::new();
        for row in self.0 {
            let built = (row.backend, row.precision, row.instancing);
            if told.contains(&built) {
                continue;
            }
            told.push(built);
            let identity = row
                .embree
                .as_ref()
                .map_or(String::new(), |e| format!(" {} {}", e.version, e.isa));
            writeln!(
                f,
                "  {}{identity} ({}): built in {:.3} s ({:.3} .. {:.3}) on {} threads, {}",
                row.backend,
                row.precision_and_instancing(),
                row.build_seconds,
                row.build_seconds_min,
                row.build_seconds_max,
                row.threads,
                memory::in_words(row.bytes)
            )?;
        }
        Ok(())
    }

    /// Speed over that of Embree in the same mode, with the precision and the kind of instancing that are listed first;
    /// a batch is measured against packets.
    fn over_embree(&self, row: &BenchRow) -> Option<f64> {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn row(backend: Backend, mode: Mode, mrays_per_s: f64) -> BenchRow {
        BenchRow {
            scene: "a.glb".into(),
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
            embree: None,
            frame: None,
        }
    }

    #[test]
    fn the_median_is_the_middle_one_or_the_mean_of_the_middle_two() {
        let spread = |median, min, max| Spread { median, min, max };
        assert_eq!(Spread::of(&[3.0, 1.0, 9.0]), spread(3.0, 1.0, 9.0));
        assert_eq!(Spread::of(&[4.0, 1.0, 2.0, 9.0]), spread(3.0, 1.0, 9.0));
        assert_eq!(Spread::of(&[]), spread(0.0, 0.0, 0.0));
    }

    #[test]
    fn each_mode_is_measured_against_embrees_same_mode_and_batches_against_packets() {
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
            text.matches("built in 0.500 s (0.250 .. 1.000) on 1 threads, 2.0 MB")
                .count(),
            2,
            "{text}"
        );
    }
}
