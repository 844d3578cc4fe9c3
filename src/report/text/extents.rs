//! Text table of the benchmark of bounding volumes: `whit bench --extents`.

use std::fmt;

use crate::accel::extents::Tally;
use crate::bench::BoundingVolumeRow;

/// Rows of one scene as a text table.
pub struct BoundingVolumeTable<'r>(pub &'r [BoundingVolumeRow]);

impl fmt::Display for BoundingVolumeTable<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Some(first) = self.0.first() else {
            return Ok(());
        };
        // Print the scene and the chosen bounding volumes
        writeln!(f, "{}", first.scene.display())?;
        if let Some(counts) = self
            .0
            .iter()
            .find(|row| row.extent == "chosen")
            .and_then(|row| row.counts)
        {
            writeln!(
                f,
                "  chosen: {} boxes, {} centroid spheres, {} tight spheres, {} without",
                counts.boxes, counts.centroid_spheres, counts.tight_spheres, counts.none
            )?;
        }
        // Print a line for each row
        writeln!(
            f,
            "  {:<11}{:<6}{:<22}{:>12}{:>8}{:>12}{:>12}{:>8}  {:<15}{:>8}",
            "rays",
            "in a",
            "extent",
            "objects/ray",
            "saved",
            "extents/ray",
            "ns/ray",
            "time",
            "(min .. max)",
            "differ"
        )?;
        for row in self.0 {
            write_row(f, row)?;
        }
        // List rows that are slower than without bounding volumes
        let losers: Vec<String> = self
            .0
            .iter()
            .filter(|row| row.is_slower())
            .map(|row| {
                format!(
                    "{} in a {} for {} rays ({:.2})",
                    row.extent, row.structure, row.rays, row.time
                )
            })
            .collect();
        match losers.as_slice() {
            [] => writeln!(f, "  never slower than without bounding volumes"),
            _ => writeln!(f, "  slower than without bounding volumes: {}", losers.join(", ")),
        }
    }
}

fn write_row(f: &mut fmt::Formatter, row: &BoundingVolumeRow) -> fmt::Result {
    // Divide counts by the number of rays
    let per_ray = |count: fn(&Tally) -> u64| {
        row.tally.map_or(String::new(), |tally| {
            format!("{:.2}", count(&tally) as f64 / tally.rays.max(1) as f64)
        })
    };
    let saved = row
        .saved()
        .map_or(String::new(), |part| format!("{:.1} %", 100.0 * part));
    let extremes = format!("({:.2} .. {:.2})", row.time_min, row.time_max);
    writeln!(
        f,
        "  {:<11}{:<6}{:<22}{:>12}{saved:>8}{:>12}{:>12.1}{:>8.3}  {extremes:<15}{:>8}",
        row.rays,
        row.structure,
        row.extent,
        per_ray(|tally| tally.object_tests),
        per_ray(|tally| tally.extent_tests + tally.film_tests),
        row.ns_per_ray,
        row.time,
        row.differ
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::RayKind;

    fn row(time_min: f64, object_tests: u64) -> BoundingVolumeRow {
        BoundingVolumeRow {
            scene: "a.toml".into(),
            rays: RayKind::Camera,
            structure: "list",
            extent: "box".into(),
            tally: Some(Tally {
                rays: 10,
                objects: 200,
                object_tests,
                ..Tally::default()
            }),
            time: time_min,
            time_min,
            time_max: time_min,
            ns_per_ray: 1.0,
            ray_count: 10,
            differ: 0,
            counts: None,
        }
    }

    #[test]
    fn rows_slower_than_without_bounding_volumes_are_listed() {
        let text = BoundingVolumeTable(&[row(0.5, 50), row(1.25, 200)]).to_string();
        assert!(text.contains("75.0 %") && text.contains("0.0 %"), "{text}");
        assert!(
            text.contains("slower than without bounding volumes: box in a list for camera rays (1.25)"),
            "{text}"
        );
        let text = BoundingVolumeTable(&[row(0.5, 50)]).to_string();
        assert!(
            text.contains("never slower than without bounding volumes"),
            "{text}"
        );
    }
}
