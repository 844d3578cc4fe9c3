"""The flags of `tests/tools/compressed_twins/run`."""

import argparse
from pathlib import Path

from compressed_twins.kinds import KINDS

REPOSITORY = Path(__file__).resolve().parents[3]

EXAMPLES = """
Examples:
  tests/tools/compressed_twins/run --whit target/release/whit --environment /tmp/npm --out /tmp/twins
  tests/tools/compressed_twins/run --whit target/release/whit --environment /tmp/npm --out /tmp/twins \\
      --kinds draco meshopt-khr --models Duck.glb Fox.glb
  tests/tools/compressed_twins/run --environment /tmp/npm --out /tmp/twins     (makes the twins only)

Exit codes: 0 success; 1 whit refused a file, an image is beyond its tolerance, or no twin could be made; 2 bad usage, or
no encoders.
"""


def parse(arguments: list[str]) -> argparse.Namespace:
    """Returns the flags, with every path absolute."""
    parser = argparse.ArgumentParser(
        prog="tests/tools/compressed_twins/run",
        description="Compress models by the usual encoders, and compare whit's images of both.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="folder to write into; made if absent")
    parser.add_argument(
        "--environment",
        type=Path,
        required=True,
        metavar="FOLDER",
        help="folder of the encoders from npm, kept between runs",
    )
    parser.add_argument("--whit", type=Path, metavar="PROGRAM", help="whit to render with [default: only make the twins]")
    parser.add_argument(
        "--models",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="models to compress [default: those of --assets that whit loads]",
    )
    parser.add_argument(
        "--assets",
        type=Path,
        metavar="FOLDER",
        default=REPOSITORY.parent / "shared/assets",
        help="folder of the default models in gltf and fidelity/models [default: %(default)s]",
    )
    names = [kind.name for kind in KINDS]
    parser.add_argument("--kinds", nargs="+", choices=names, metavar="KIND", help=f"{', '.join(names)} [default: all]")
    chosen = parser.parse_args(arguments)
    for name in ["out", "environment", "whit", "assets"]:
        path = getattr(chosen, name)
        setattr(chosen, name, path and path.resolve())
    chosen.models = [path.resolve() for path in chosen.models or []]
    for path in chosen.models:
        if not path.is_file():
            parser.error(f"there is no file {path}")
    chosen.kinds = [kind for kind in KINDS if chosen.kinds is None or kind.name in chosen.kinds]
    return chosen
