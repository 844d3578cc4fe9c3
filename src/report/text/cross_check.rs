//! Cross-check report: a scene's own rays through pairs of backends, and the defects of its meshes (`whit verify SCENE`).

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

use serde::Serialize;

use super::table::group_thousands;
use crate::accel::EmbreeIdentity;
use crate::verify::{BackendComparison, Difference, MeshDiagnostics, MeshFeature, RayKind, RaysOfPair};

/// Cross-check results of one scene.
#[derive(Clone, Debug, Serialize)]
pub struct CrossCheckReport {
    /// Path of the scene as given on the command line.
    pub scene: PathBuf,
    /// Comparisons of the first backend with each of the others.
    pub pairs: Vec<PairReport>,
    /// Identity of the Embree library, where one of the backends is Embree.
    pub embree: Option<EmbreeIdentity>,
    /// Defects of all meshes together.
    pub meshes: MeshDiagnostics,
    /// Objects that loading removed, as one sentence each.
    pub warnings: Vec<String>,
}

/// Cross-check results of two backends.
#[derive(Clone, Debug, Serialize)]
pub struct PairReport {
    /// Names of the two compared backends.
    pub backends: [String; 2],
    /// Comparison results by kind of ray.
    pub rays: BTreeMap<&'static str, BackendComparison>,
}

impl PairReport {
    /// Returns each kind of ray with its comparison.
    pub fn comparisons(&self) -> impl Iterator<Item = (RayKind, &BackendComparison)> {
        RayKind::ALL
            .into_iter()
            .filter_map(|kind| Some((kind, self.rays.get(kind.word())?)))
    }

    /// Returns the recorded differences in the order of the rays: camera rays, shadow rays, reflection rays.
    pub fn differences(&self) -> impl Iterator<Item = &Difference> {
        self.comparisons().flat_map(|(_, rays)| &rays.differences)
    }

    /// Returns the recorded differences as a part of a file of rays.
    pub fn rays_file_part(&self) -> RaysOfPair {
        RaysOfPair {
            backends: self.backends.clone(),
            rays: self.differences().copied().collect(),
        }
    }

    /// Appends the results of each kind of ray, as one line each.
    fn append_text(&self, text: &mut String) {
        for (kind, rays) in self.comparisons() {
            // Writing to a string cannot fail.
            if rays.rays == 0 {
                let _ = writeln!(text, "    {:11} {:>13} rays", kind.word(), "no");
                continue;
            }
            let _ = writeln!(
                text,
                "    {:11} {:>13} rays: {} wrong{}, {} ties{}",
                kind.word(),
                group_thousands(rays.rays),
                rays.wrong_count(),
                format_counts(&rays.wrong),
                rays.tie_count(),
                format_counts(&rays.ties),
            );
            if let Some(example) = &rays.example {
                let _ = writeln!(text, "        first wrong result: {example}");
            }
        }
    }
}

impl CrossCheckReport {
    /// Returns whether any result is wrong.
    pub fn is_wrong(&self) -> bool {
        self.all_rays().any(|rays| rays.wrong_count() > 0)
    }

    /// Returns the comparisons of all pairs and kinds of rays.
    pub fn all_rays(&self) -> impl Iterator<Item = &BackendComparison> {
        self.pairs.iter().flat_map(|pair| pair.rays.values())
    }

    /// Returns the recorded differences of all pairs.
    pub fn differences(&self) -> impl Iterator<Item = &Difference> {
        self.pairs.iter().flat_map(PairReport::differences)
    }

    /// Returns the counts of wrong results and of ties, as one line each.
    pub fn legend(&self) -> [String; 2] {
        // Sum the counts over all kinds of rays
        let sum = |of: fn(&BackendComparison) -> &BTreeMap<MeshFeature, u64>| {
            let mut sums: BTreeMap<MeshFeature, u64> = BTreeMap::new();
            for (place, count) in self.all_rays().flat_map(of) {
                *sums.entry(*place).or_default() += count;
            }
            (sums.values().sum::<u64>(), format_counts(&sums))
        };
        let (wrong, wrong_places) = sum(|rays| &rays.wrong);
        let (ties, tie_places) = sum(|rays| &rays.ties);
        [
            format!("wrong {wrong}{wrong_places}"),
            format!("ties {ties}{tie_places}"),
        ]
    }

    /// Returns the report as text for the terminal.
    pub fn text(&self) -> String {
        let mut text = format!("{}\n", self.scene.display());
        // Print the results of each pair; writing to a string cannot fail
        for pair in &self.pairs {
            let [first, second] = &pair.backends;
            let _ = writeln!(text, "    {first}\n    against {second}");
            pair.append_text(&mut text);
        }
        // Print the state of the meshes with remedies for defects
        let advice = self.meshes.advice();
        let state = match (self.meshes.triangles, advice.is_empty()) {
            (0, _) => "",
            (_, true) => ": closed and clean",
            (_, false) => ":",
        };
        let triangles = group_thousands(self.meshes.triangles);
        let _ = writeln!(text, "    {:11} {triangles:>13} triangles{state}", "meshes");
        for (count, what, remedy) in advice {
            let _ = writeln!(text, "        {} {what}: {remedy}", group_thousands(count));
        }
        for warning in &self.warnings {
            let _ = writeln!(text, "    loading: {warning}");
        }
        text
    }
}

/// Formats counts with the features at which they occurred, in brackets and in descending order; empty without counts.
pub(in crate::report) fn format_counts(counts: &BTreeMap<MeshFeature, u64>) -> String {
    if counts.is_empty() {
        return String::new();
    }
    let mut sorted: Vec<(&MeshFeature, &u64)> = counts.iter().collect();
    sorted.sort_by(|a, b| b.1.cmp(a.1));
    let all: Vec<String> = sorted
        .into_iter()
        .map(|(place, count)| format!("{count} {}", place.name()))
        .collect();
    format!(" ({})", all.join(", "))
}
