"""Writes the table as Markdown and JSON, and a page with the images side by side."""

import html
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

from compressed_twins.comparison import Row


@dataclass
class Report:
    """All rows, and what was left out."""

    versions: dict[str, str]
    rows: list[Row] = field(default_factory=list)
    # Reasons by kind and model
    left_out: dict[str, dict[str, str]] = field(default_factory=dict)

    def leave_out(self, kind: str, model: str, why: str) -> None:
        """Notes a twin that could not be made."""
        self.left_out.setdefault(kind, {})[model] = why

    def failures(self) -> list[Row]:
        """Returns the rows that are not as they should be."""
        return [row for row in self.rows if row.verdict() != "ok"]

    def write(self, folder: Path) -> None:
        """Writes `results.json`, `results.md` and `images.html`."""
        rows = [{**asdict(row), "verdict": row.verdict()} for row in self.rows]
        results = {"versions": self.versions, "rows": rows, "left_out": self.left_out}
        (folder / "results.json").write_text(json.dumps(results, indent=1))
        (folder / "results.md").write_text(self.markdown())
        (folder / "images.html").write_text(side_by_side(self.rows))

    def markdown(self) -> str:
        """Returns the tables."""
        text = "# Models beside their compressed twins\n\n"
        text += "".join(f"- {name}: {version}\n" for name, version in self.versions.items())
        text += f"- {len(self.rows)} twins, {len(self.failures())} failures\n\n"
        head = ["model", "twin", "bytes", "twin's bytes", "verdict", "RMSE to plain", "at most"]
        head += ["RMSE to decoded", "at most", "lost by the encoder", "load, s", "twin's load, s", "what whit says"]
        text += table(head, [cells(row) for row in self.rows])
        text += "\n## Left out\n\n"
        for kind, models in self.left_out.items():
            for why in sorted(set(models.values())):
                names = [model for model, reason in models.items() if reason == why]
                text += f"- {kind}: {why}: {', '.join(names)}\n"
        return text


def cells(row: Row) -> list[str]:
    """Returns a row of the table."""
    return [
        row.model,
        row.kind,
        str(row.plain_bytes),
        str(row.twin_bytes),
        row.verdict(),
        number(row.plain_rmse),
        number(row.plain_tolerance),
        number(row.decoded_rmse),
        number(row.decoded_tolerance),
        number(row.loss_rmse),
        number(row.plain_load),
        number(row.twin_load),
        row.said.replace("|", "\\|"),
    ]


def number(value: float | None) -> str:
    """Returns a number of four decimals, or a dash."""
    return "-" if value is None else f"{value:.4f}"


def table(head: list[str], rows: list[list[str]]) -> str:
    """Returns a Markdown table."""
    return "".join("| " + " | ".join(line) + " |\n" for line in [head, ["---"] * len(head), *rows])


def side_by_side(rows: list[Row]) -> str:
    """Returns a page with the images of plain model and twin, and their difference, ten times as strong."""
    text = "<!doctype html><meta charset=utf-8><title>Compressed twins</title>\n"
    text += "<table><tr><th>twin<th>plain<th>twin<th>difference<th>decoded\n"
    for row in rows:
        images = [f"plain/{row.model}.png", f"{row.kind}/{row.model}.png", f"{row.kind}/{row.model}.difference.png"]
        if not row.is_rendered:
            images[1:] = ["", ""]
        images.append(f"decoded-{row.kind}/{row.model}.png")
        shown = "".join(f"<td><img loading=lazy src='images/{html.escape(image)}'>" if image else "<td>" for image in images)
        name = f"{row.model}<br>{row.kind}<br>{row.verdict()}<br>{number(row.plain_rmse)}"
        text += f"<tr><td>{name}{shown}\n"
    return text + "</table>\n"
