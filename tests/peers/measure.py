"""Measures by turns: in each turn every renderer is timed once, in a new random order."""

import random
import statistics
from dataclasses import dataclass, field

from peers import error
from peers.renderers import Setting

SPP = [1, 16]
# A reference that is only to be looked at, or quick, has this many times fewer samples.
QUICK_SHARE = 4


@dataclass
class Entry:
    """One renderer and setting: its timings of all turns, and the error of its image against its own reference."""

    renderer: str
    setting: Setting
    error: float | None
    timings: list = field(default_factory=list)


def by_turns(turns, entries, measure, seed):
    """Appends `measure(entry)` to each entry's timings, once a turn."""
    order = random.Random(seed)
    for turn in range(turns):
        print(f"  turn {turn + 1} of {turns}: {len(entries)} timings", flush=True)
        for entry in order.sample(entries, len(entries)):
            entry.timings.append(measure(entry))


def references(scene, renderers, quick):
    """Returns the reference image of each renderer that has one, and the noise left in it."""
    found = {}
    share = 1 if scene.targets and not quick else QUICK_SHARE
    for renderer in renderers:
        if hasattr(renderer, "reference_spp"):
            spp = renderer.reference_spp * scene.reference_factor // share
            found[renderer.name] = (*renderer.reference(scene, spp), spp)
            print(f"  reference of {renderer.name}: {spp} samples, noise {found[renderer.name][1]:.5f}", flush=True)
    return found


def equal_samples(scene, renderers, known, turns):
    """Returns an entry for each renderer and number of samples, timed as whole processes."""
    entries = []
    each = [(renderer, sampler) for renderer in renderers for sampler in renderer.equal_samplers]
    for renderer, sampler in each:
        for spp in SPP if renderer.name in known else SPP[:1]:
            setting = Setting(sampler, spp)
            reference = known.get(renderer.name)
            wrong = error.rmse(renderer.image(scene, setting), reference[0]) if reference else None
            entries.append(Entry(renderer.name, setting, wrong))
    named = {renderer.name: renderer for renderer in renderers}
    by_turns(turns, entries, lambda entry: named[entry.renderer].process(scene, entry.setting), scene.name)
    return entries


def climb(scene, renderer, sampler, reference):
    """Returns entries of growing effort until the smallest target is reached."""
    entries = []
    for amount in renderer.ladder(sampler):
        setting = Setting(sampler, amount)
        entries.append(Entry(renderer.name, setting, error.rmse(renderer.image(scene, setting), reference)))
        if entries[-1].error <= min(scene.targets):
            break
    errors = " ".join(f"{entry.setting.amount:g}:{entry.error:.4f}" for entry in entries)
    print(f"  {renderer.name} {sampler} {errors}", flush=True)
    return entries


def bracket(entries, target):
    """Returns the last entry above the target and the first below it; fewer where the ladder ends."""
    below = next((at for at, entry in enumerate(entries) if entry.error <= target), None)
    return [] if below is None else entries[max(0, below - 1) : below + 1]


def reached(entries, target, seconds):
    """Returns the seconds at which the target is reached, from the medians of `seconds(timing)`, or None."""
    points = [(entry.error, statistics.median(map(seconds, entry.timings))) for entry in bracket(entries, target)]
    return error.at_error(points, target) if points else None


def equal_error(scene, renderers, known, turns):
    """Returns for each target a row a sampler: seconds of the render phase, and of whole processes of the best."""
    if not scene.targets:
        return []
    renderers = [renderer for renderer in renderers if renderer.name in known]
    named = {renderer.name: renderer for renderer in renderers}
    ladders = {}
    for renderer in renderers:
        for sampler in renderer.samplers():
            ladders[renderer.name, sampler] = climb(scene, renderer, sampler, known[renderer.name][0])

    # Render phases of all samplers, around each target
    needed = {id(entry): entry for ladder in ladders.values() for target in scene.targets for entry in bracket(ladder, target)}
    phase = lambda entry: named[entry.renderer].render_seconds(scene, entry.setting)  # noqa: E731
    by_turns(turns, list(needed.values()), phase, scene.name + "phase")
    rows = []
    for target in scene.targets:
        for (name, sampler), ladder in ladders.items():
            rows.append({"target": target, "renderer": name, "sampler": sampler, "whole": None, "processor": None})
            rows[-1]["render"] = reached(ladder, target, float)
            rows[-1]["points"] = [
                {"amount": entry.setting.amount, "error": entry.error, "render": entry.timings}
                for entry in bracket(ladder, target)
            ]

    # Whole processes of the best sampler of each
    chosen = {}
    for row in rows:
        key = (row["target"], row["renderer"])
        if row["render"] is not None and (key not in chosen or row["render"] < chosen[key]["render"]):
            chosen[key] = row
    wholes = {}
    for (target, name), row in chosen.items():
        ladder = bracket(ladders[name, row["sampler"]], target)
        wholes[target, name] = [Entry(name, entry.setting, entry.error) for entry in ladder]
    entries = [entry for ladder in wholes.values() for entry in ladder]
    by_turns(turns, entries, lambda entry: named[entry.renderer].process(scene, entry.setting), scene.name + "whole")
    for key, row in chosen.items():
        row["best"] = True
        for kind in ["whole", "processor"]:
            row[kind] = reached(wholes[key], key[0], lambda timing: getattr(timing, kind))
        row["whole_points"] = [[vars(timing) for timing in entry.timings] for entry in wholes[key]]
    return rows
