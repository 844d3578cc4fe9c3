"""The flags of `tests/peers/run`."""

import argparse
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PEERS = ["mitsuba", "cycles", "povray", "f3d"]
SCENES = ["mesh", "damaged_helmet", "analytic", "flight_helmet", "cornell_box"]


def parse(arguments):
    """Returns the flags, with every path absolute."""
    parser = argparse.ArgumentParser(
        prog="tests/peers/run",
        description="Time whit against other renderers on the same scenes; writes tables, images, versions and machine.",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="folder to write into; made if absent")
    parser.add_argument("--quick", action="store_true", help="references of fewer samples, and one turn by default")
    parser.add_argument("--turns", type=int, metavar="N", help="how often each is timed [default: 5, with --quick 1]")
    parser.add_argument("--whit", type=Path, metavar="PROGRAM", help="whit to measure [default: built by cargo]")
    parser.add_argument("--mesh", type=Path, metavar="FILE.glb", help="mesh of 2 million triangles [default: made by cargo]")
    parser.add_argument(
        "--assets",
        type=Path,
        metavar="FOLDER",
        default=REPOSITORY.parent / "shared/assets/gltf",
        help="folder of DamagedHelmet.glb and FlightHelmet/FlightHelmet.gltf [default: %(default)s]",
    )
    parser.add_argument(
        "--environments",
        type=Path,
        metavar="FOLDER",
        help="folder of the Python environments, kept between runs [default: environments in --out]",
    )
    parser.add_argument("--peers", nargs="+", choices=PEERS, default=PEERS, help="renderers to hold whit against")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES, help="scenes to render")
    parser.add_argument(
        "--size",
        type=int,
        default=1024,
        metavar="PIXELS",
        help="width and height; the analytic scene has half of it, the Cornell box a quarter [default: %(default)s]",
    )
    chosen = parser.parse_args(arguments)
    chosen.turns = chosen.turns or (1 if chosen.quick else 5)
    chosen.environments = chosen.environments or chosen.out / "environments"
    for name in ["out", "whit", "mesh", "assets", "environments"]:
        path = getattr(chosen, name)
        setattr(chosen, name, path and path.resolve())
    return chosen
