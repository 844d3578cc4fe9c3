"""Measures all scenes: run by `run`, in the environment that has NumPy."""

import sys
import time

from PIL import Image

from peers import error, install, machine, measure, options, report, scenes
from peers.renderers.cycles import Cycles
from peers.renderers.f3d import F3d
from peers.renderers.mitsuba import Mitsuba
from peers.renderers.povray import Povray
from peers.renderers.whit import Whit
from peers.session import Failed

CLASSES = {"mitsuba": Mitsuba, "cycles": Cycles, "povray": Povray, "f3d": F3d}


def main():
    chosen = options.parse(sys.argv[1:])
    folder = chosen.out / "scenes"
    folder.mkdir(parents=True, exist_ok=True)
    results = {
        "machine": machine.describe(),
        "versions": {},
        "turns": chosen.turns,
        "skipped": {},
        "scenes": {},
    }
    whit = Whit(chosen)
    results["versions"].update(whit.versions())
    peers = installed(chosen, results)
    for name in chosen.scenes:
        try:
            scene = scenes.prepare(name, chosen, folder)
        except scenes.Missing as why:
            skip(results, f"scene {name}", why)
            continue
        print(f"{name}: {scene.about}", flush=True)
        renderers = opened(scene, folder, [whit, *(peers[peer] for peer in scene.peers if peer in peers)], results)
        try:
            results["scenes"][name] = measured(scene, renderers, results["turns"], chosen)
            for renderer in renderers:
                results["versions"].update(renderer.versions())
        finally:
            for renderer in renderers:
                renderer.close()
        report.write(results, chosen.out)
    print(f"{chosen.out}/results.md")


def installed(chosen, results):
    """Returns the peers that can be installed."""
    peers = {}
    for name in chosen.peers:
        print(f"installing {name}", flush=True)
        try:
            peers[name] = CLASSES[name](chosen)
        except install.Absent as why:
            skip(results, name, why)
    return peers


def opened(scene, folder, renderers, results):
    """Returns the renderers that open the scene."""
    able = []
    for renderer in renderers:
        try:
            renderer.open(scene, folder)
            able.append(renderer)
        except Failed as why:
            skip(results, f"{renderer.name} on {scene.name}", why)
    return able


def skip(results, what, why):
    """Notes what is left out, and says so."""
    print(f"skipped: {what}: {why}", flush=True)
    results["skipped"][what] = str(why)


def measured(scene, renderers, turns, chosen):
    """Returns all that is measured of one scene, and writes its images."""
    started = time.perf_counter()
    known = measure.references(scene, renderers, chosen.quick)
    samples = measure.equal_samples(scene, renderers, known, turns)
    pictures = {name: report.picture(reference) for name, (reference, _, _) in known.items()}
    for renderer in renderers:
        if renderer.name not in known:
            pictures[renderer.name] = Image.open(renderer.folder / f"{scene.name}.png").convert("RGB")
    report.side_by_side(pictures, chosen.out / f"{scene.name}.png")
    names = list(known)
    return {
        "about": scene.about,
        "size": scene.size,
        "references": {name: {"noise": noise, "spp": spp} for name, (_, noise, spp) in known.items()},
        "agreement": {
            f"{one} and {other}": error.rmse(known[one][0], known[other][0])
            for at, one in enumerate(names)
            for other in names[at + 1 :]
        },
        "equal_samples": [
            {
                "renderer": entry.renderer,
                "sampler": entry.setting.sampler,
                "amount": entry.setting.amount,
                "error": entry.error,
                "whole": [timing.whole for timing in entry.timings],
                "processor": [timing.processor for timing in entry.timings],
                "render": [timing.render for timing in entry.timings],
            }
            for entry in samples
        ],
        "equal_error": measure.equal_error(scene, renderers, known, turns),
        "seconds": time.perf_counter() - started,
    }


main()
