"""Compares whit's image of a twin with those of the plain model and of the decoded twin."""

from dataclasses import dataclass
from pathlib import Path

from compressed_twins import models
from compressed_twins.kinds import Kind
from compressed_twins.models import Model
from compressed_twins.twins import Absent, Maker
from compressed_twins.whit import Render, Whit


@dataclass
class Row:
    """All that is known of one twin; a field is None if it could not be found out."""

    model: str
    kind: str
    plain_bytes: int
    twin_bytes: int
    said: str = ""
    is_rendered: bool = False
    plain_rmse: float | None = None
    plain_tolerance: float = 0
    decoded_rmse: float | None = None
    decoded_tolerance: float = 0
    # Between the plain model and the decoded twin: what the encoder alone has lost
    loss_rmse: float | None = None
    plain_load: float | None = None
    twin_load: float | None = None

    def verdict(self) -> str:
        """Returns `ok`, or what is wrong."""
        if not self.is_rendered:
            return "refused"
        if self.plain_rmse is not None and self.plain_rmse > self.plain_tolerance:
            return "differs from the plain model"
        if self.decoded_rmse is not None and self.decoded_rmse > self.decoded_tolerance:
            return "differs from the decoded twin"
        return "ok"


@dataclass(frozen=True)
class Comparison:
    """Whit, the encoders, and the folder of images."""

    whit: Whit
    maker: Maker

    def row(self, model: Model, plain: Render, kind: Kind) -> Row:
        """Returns the row of a twin that can be made."""
        twin = self.maker.twin(model, kind)
        image = self.image(kind.name, model)
        made = self.whit.render(twin, image)
        row = Row(model.name, kind.name, models.bytes_of(model.path), models.bytes_of(twin))
        row.said, row.is_rendered = made.said, made.is_done
        row.plain_load, row.twin_load = plain.load_seconds, made.load_seconds
        row.plain_tolerance, row.decoded_tolerance = kind.loss.plain_tolerance(), kind.loss.decoded_tolerance()
        decoded = self.decoded(twin, kind, model)
        if decoded:
            row.loss_rmse = self.whit.rmse(self.image("plain", model), decoded)
        if made.is_done and decoded:
            row.decoded_rmse = self.whit.rmse(decoded, image)
        # Last, so that the difference that remains beside the image is the one from the plain model
        if made.is_done:
            row.plain_rmse = self.whit.rmse(self.image("plain", model), image)
        return row

    def plain(self, model: Model) -> Render:
        """Renders the plain model."""
        return self.whit.render(model.path, self.image("plain", model))

    def decoded(self, twin: Path, kind: Kind, model: Model) -> Path | None:
        """Returns the image of the decoded twin, or None if it can't be decoded or rendered."""
        image = self.image(f"decoded-{kind.name}", model)
        try:
            render = self.whit.render(self.maker.decoded(twin), image)
        except Absent as why:
            print(f"  not decoded: {why}", flush=True)
            return None
        if not render.is_done:
            print(f"  decoded, but refused: {render.said}", flush=True)
        return image if render.is_done else None

    def image(self, kind: str, model: Model) -> Path:
        """Returns the path of an image."""
        return self.maker.out / "images" / kind / f"{model.name}.png"
