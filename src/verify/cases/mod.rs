//! Test cases, grouped by what they test.

mod intersection;
mod light;
mod program;
mod shapes;

use super::harness::Case;
use intersection::{
    backend_comparison, box_slabs, coincident, degenerate, false_hits, instance_seams, invalid_rays, leaks,
    ray_continuation, regressions, self_intersection, self_intersection_instanced, slivers, split_planes,
    watertight,
};
use light::{fresnel, furnace, nested_dielectrics, ray_marching, summation, terminator};
use program::{determinism, invariance, nan_injection};
use shapes::{solids, spheres, thin_ellipsoids, transforms};

/// Returns all cases, sorted by identifier.
pub fn cases() -> Vec<&'static Case> {
    // Collect the cases of all modules
    let rooms = [
        spheres::CASES,
        solids::CASES,
        box_slabs::CASES,
        watertight::CASES,
        invalid_rays::CASES,
        slivers::CASES,
        self_intersection::CASES,
        self_intersection_instanced::CASES,
        transforms::CASES,
        coincident::CASES,
        split_planes::CASES,
        fresnel::CASES,
        summation::CASES,
        ray_marching::CASES,
        determinism::CASES,
        thin_ellipsoids::CASES,
        regressions::CASES,
        leaks::CASES,
        false_hits::CASES,
        ray_continuation::CASES,
        degenerate::CASES,
        nan_injection::CASES,
        backend_comparison::CASES,
        invariance::CASES,
        nested_dielectrics::CASES,
        furnace::CASES,
        terminator::CASES,
        instance_seams::CASES,
    ];
    // Sort them by identifier
    let mut all: Vec<&Case> = rooms.into_iter().flatten().collect();
    all.sort_by_key(|case| case.id);
    all
}

#[cfg(test)]
mod tests {
    use super::super::harness::VARIANTS;
    use super::*;

    #[test]
    fn every_case_has_unique_id_and_descriptions() {
        let all = cases();
        for pair in all.windows(2) {
            assert!(pair[0].id < pair[1].id, "{}", pair[1].id);
        }
        for case in all {
            for text in [case.title, case.construction, case.oracle, case.bound] {
                assert!(!text.is_empty() && !text.ends_with('.'), "{}: {text}", case.id);
            }
            assert!(
                VARIANTS
                    .iter()
                    .any(|path| case.applies_to(path) && case.requires(path))
            );
        }
    }
}
