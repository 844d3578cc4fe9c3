//! A scene's own rays through two backends, and what is wrong with its meshes: `whit verify SCENE`.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

use serde::Serialize;

use crate::accel::EmbreeIdentity;
use crate::verify::{Comparison, Hygiene, Place};

/// What was found in a scene.
#[derive(Clone, Debug, Serialize)]
pub struct OwnReport {
    /// As it was named on the command line.
    pub scene: PathBuf,
    /// What was compared, by name.
    pub backends: [String; 2],
    /// Which Embree, where it is one of them.
    pub embree: Option<EmbreeIdentity>,
    /// By kind of ray.
    pub rays: BTreeMap<&'static str, Comparison>,
    /// Of all meshes together.
    pub meshes: Hygiene,
    /// What loading left out, one sentence each.
    pub warnings: Vec<String>,
}

impl OwnReport {
    /// Whether any answer is wrong.
    pub fn is_wrong(&self) -> bool {
        self.rays.values().any(|rays| rays.wrong_count() > 0)
    }

    /// The report for a person.
    pub fn text(&self) -> String {
        let [first, second] = &self.backends;
        let mut text = format!("{}: {first} against {second}\n", self.scene.display());
        for (kind, rays) in &self.rays {
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "    {kind:11} {:>10} rays, {} differ within rounding{}, {} wrong{}",
                rays.rays,
                rays.tie_count(),
                by_place(&rays.ties),
                rays.wrong_count(),
                by_place(&rays.wrong),
            );
            if let Some(example) = &rays.example {
                let _ = writeln!(text, "        {example}");
            }
        }
        let advice = self.meshes.advice();
        let state = if advice.is_empty() {
            "closed and clean"
        } else {
            "with"
        };
        let _ = writeln!(
            text,
            "    meshes      {:>10} triangles, {state}",
            self.meshes.triangles
        );
        for (count, what, remedy) in advice {
            let _ = writeln!(text, "        {count} {what}: {remedy}");
        }
        text
    }
}

fn by_place(counts: &BTreeMap<Place, u64>) -> String {
    if counts.is_empty() {
        return String::new();
    }
    let all: Vec<String> = counts
        .iter()
        .map(|(place, count)| format!("{count} {}", place.name()))
        .collect();
    format!(" ({})", all.join(", "))
}
