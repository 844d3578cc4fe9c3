"""Makes the twins, each once: one that is there is used again."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from compressed_twins import models
from compressed_twins.install import Failed, run
from compressed_twins.kinds import Kind
from compressed_twins.models import Model


class Absent(Exception):
    """A twin that can't be made, with the reason."""


@dataclass(frozen=True)
class Maker:
    """The encoders, and the folder that twins and what is decoded from them are written into."""

    environment: Path
    out: Path

    def twin(self, model: Model, kind: Kind) -> Path:
        """Returns the file of the twin."""
        if kind.is_for_textures and not models.document(model.path).get("images"):
            raise Absent("the model has no textures")
        twin = self.out / "twins" / kind.name / f"{model.name}.glb"
        if not twin.exists():
            encode(lambda output: kind.commands(self.environment, model.path, output), twin)
        if kind.extension and kind.extension not in models.extensions(twin):
            twin.unlink()
            raise Absent("there is nothing to encode")
        return twin

    def decoded(self, twin: Path) -> Path:
        """Returns the file that the reference decoders make of a twin."""
        decoded = self.out / "decoded" / twin.relative_to(self.out / "twins")
        if not decoded.exists():
            encode(lambda output: [["node", str(self.environment / "decode.mjs"), str(twin), str(output)]], decoded)
        return decoded


def encode(commands: Callable[[Path], list[list[str]]], output: Path) -> None:
    """Runs the commands that write an output; the file is there only once it is whole."""
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=output.parent) as folder:
        whole = Path(folder) / output.name
        try:
            for command in commands(whole):
                run(command)
        except Failed as why:
            raise Absent(str(why)) from why
        if not whole.exists():
            raise Absent("the encoder wrote no file")
        whole.replace(output)
