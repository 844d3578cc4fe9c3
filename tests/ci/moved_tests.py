#!/usr/bin/env python3
"""Prints where each test of an earlier commit is now: old file and name, new file, tier.

    tests/ci/moved_tests.py 9663971

Tests are told apart by their names; of tests that share a name, those in files with the most similar paths belong
together. The tiers: `all` (cargo test --workspace), `slow` (tests/ci/slow), `bench` (what times something, under
tests/benches), `ci` (a check of sources, under tests/ci). RENAMED lists what goes by another name now. Tests that are
nowhere are listed as `gone`, and fail the script.
"""

import difflib
import re
import subprocess
import sys
from collections import defaultdict

# An attribute, then further attributes and comments, then the function.
TEST = re.compile(r"#\[test\]((?:\s*(?://[^\n]*|#\[[^\n]*\]))*)\s*(?:pub(?:\([a-z]+\))? )?fn (\w+)")
FUNCTION = re.compile(r"^\s*(?:pub(?:\([a-z]+\))? )?fn (\w+)", re.M)

# Old name: where it is now.
RENAMED = {
    "a_hundred_thousand_spheres_are_found_at_half_the_rate_of_embrees_own_or_more": ("tests/benches/timing/spheres.rs", "bench"),
    "a_tenth_more_of_real_work_is_measured_as_a_tenth": ("tests/benches/timing/timing_protocol.rs", "bench"),
    "every_effect_has_a_line_with_a_small_picture_and_a_scene_that_calls_for_it": ("tests/tools/contact_sheet.rs", "all"),
    "every_small_number_is_known_to_be_no_tolerance": ("tests/ci/small_numbers.py", "ci"),
    "seconds_of_work_add_up_to_the_phase_on_one_thread": ("tests/benches/timing/profile_seconds.rs", "bench"),
    "shares_of_time_are_forecast_to_within_ten_points": ("tests/benches/timing/forecast_shares.rs", "bench"),
    "single_incoherent_rays_overtake_packets_as_the_spheres_get_more": ("tests/benches/timing/packet_width.rs", "bench"),
    "small_numbers_are_found_however_they_are_written": ("tests/ci/small_numbers.py", "ci"),
    "the_contract_costs_at_most_a_tenth_over_the_bare_loop": ("tests/benches/timing/embree_contract.rs", "bench"),
    "the_hierarchy_takes_a_tenth_of_the_time_of_brute_force_at_most": ("tests/benches/timing/irradiance_tree.rs", "bench"),
    "two_million_boxes_take_less_than_a_second": ("tests/benches/timing/clusters.rs", "bench"),
    "what_filtering_costs": ("tests/benches/timing/texture_filtering.rs", "bench"),
    "what_is_chosen_reaches_its_error_in_at_most_half_again_the_least_time": ("tests/benches/timing/render_to_error.rs", "bench"),
}


def git(*arguments):
    return subprocess.run(["git", *arguments], check=True, capture_output=True, text=True).stdout


def sources(commit):
    """Paths and texts of the Rust files of a commit."""
    for path in git("ls-tree", "-r", "--name-only", commit).splitlines():
        if path.endswith(".rs"):
            yield path, git("show", f"{commit}:{path}")


def tests(commit):
    """Tests by name, as lists of (path, tier), and functions of benchmarks likewise."""
    by_name = defaultdict(list)
    for path, text in sources(commit):
        for attributes, name in TEST.findall(text):
            by_name[name].append((path, "slow" if "#[ignore" in attributes else "all"))
        if path.startswith("tests/benches/"):
            for name in FUNCTION.findall(text):
                by_name[name].append((path, "bench"))
    return by_name


def similarity(old, new):
    return difflib.SequenceMatcher(None, old, new).ratio()


def main():
    if len(sys.argv) not in (2, 3):
        sys.exit("usage: tests/ci/moved_tests.py OLD_COMMIT [NEW_COMMIT]")
    old = {name: [place for place in places if place[1] != "bench"] for name, places in tests(sys.argv[1]).items()}
    new = tests(sys.argv[2] if len(sys.argv) == 3 else "HEAD")
    rows, gone = [], 0
    for name, places in old.items():
        left = list(new.get(name, []))
        pairs = sorted(((similarity(o[0], n[0]), o, n) for o in places for n in left), reverse=True)
        found = {}
        for _, one, other in pairs:
            if one not in found and other in left:
                found[one] = other
                left.remove(other)
        for place in places:
            path, tier = found.get(place) or RENAMED.get(name, ("", "gone"))
            gone += tier == "gone"
            rows.append((place[0], name, path, tier, place[1]))
    print("old file | test | old tier | new file | new tier")
    for old_path, name, path, tier, old_tier in sorted(rows):
        print(f"{old_path} | {name} | {old_tier} | {'same' if path == old_path else path} | {tier}")
    count = defaultdict(int)
    for row in rows:
        count[row[3]] += 1
    print(f"{len(rows)} tests: " + ", ".join(f"{number} {tier}" for tier, number in sorted(count.items())), file=sys.stderr)
    sys.exit(1 if gone else 0)


main()
