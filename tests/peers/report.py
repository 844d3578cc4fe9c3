"""Writes the tables as Markdown and JSON, and the images side by side."""

import json
import statistics

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from peers import error

LABEL_HEIGHT = 36


def write(results, folder):
    """Writes `results.json` and `results.md`."""
    (folder / "results.json").write_text(json.dumps(results, indent=1))
    (folder / "results.md").write_text(markdown(results))


def side_by_side(images, path):
    """Writes reference images beside each other, each with its renderer's name above."""
    size = next(iter(images.values())).size
    sheet = Image.new("RGB", (size[0] * len(images), size[1] + LABEL_HEIGHT), "black")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(LABEL_HEIGHT * 2 // 3)
    for number, (name, image) in enumerate(images.items()):
        sheet.paste(image, (size[0] * number, LABEL_HEIGHT))
        draw.text((size[0] * number + 8, 4), name, fill="white", font=font)
    sheet.save(path)


def picture(image):
    """Returns an image as displayed."""
    return Image.fromarray((error.displayed(image) * 255 + 0.5).astype(np.uint8))


def markdown(results):
    """Returns all tables."""
    text = "# whit beside other renderers\n\n"
    text += "\n".join(f"- {key}: {value}" for key, value in {**results["machine"], **results["versions"]}.items())
    text += f"\n- turns: {results['turns']}; medians, with the smallest and the largest in brackets\n"
    for peer, why in results["skipped"].items():
        text += f"- skipped: {peer}: {why}\n"
    for name, scene in results["scenes"].items():
        text += f"\n## {name}\n\n{scene['about']}; {scene['size']}x{scene['size']}.\n"
        text += agreement(scene) + samples_table(scene) + error_table(scene)
    return text


def table(head, rows):
    """Returns a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n" + "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"


def seconds(values):
    """Returns median and range."""
    return f"{statistics.median(values):.3f} ({min(values):.3f} to {max(values):.3f})"


def ratio(values, base):
    """Returns how many times as long as the base, as the median over turns."""
    return f"{statistics.median(value / own for value, own in zip(values, base)):.2f}"


def agreement(scene):
    """Returns how far the references are apart, and the noise left in each."""
    text = "\n" + "; ".join(
        f"reference of {name}: {known['spp']} samples per pixel, noise {known['noise']:.5f}"
        for name, known in scene["references"].items()
    )
    pairs = "; ".join(f"{pair}: {value:.4f}" for pair, value in scene["agreement"].items())
    return text + (f".\nDisplayed RMSE between references: {pairs}.\n" if pairs else ".\n")


def samples_table(scene):
    """Returns the table at equal samples."""
    rows = []
    own = {row["amount"]: row for row in scene["equal_samples"] if row["renderer"] == "whit"}
    for row in sorted(scene["equal_samples"], key=lambda row: row["amount"]):
        base = own[row["amount"]]
        is_timed = None not in row["render"]
        rows.append(
            [
                row["amount"] if row["error"] is not None else "-",
                f"{row['renderer']} {row['sampler']}",
                seconds(row["whole"]),
                ratio(row["whole"], base["whole"]),
                seconds(row["processor"]),
                ratio(row["processor"], base["processor"]),
                seconds(row["render"]) if is_timed else "-",
                ratio(row["render"], base["render"]) if is_timed else "-",
                "-" if row["error"] is None else f"{row['error']:.4f}",
            ]
        )
    head = ["spp", "renderer", "whole process, s", "over whit's", "its processor time, s", "over whit's"]
    head += ["render phase, s", "over whit's", "error"]
    return "\nEqual samples:\n" + table(head, rows)


def error_table(scene):
    """Returns the table at equal error; in bold the best sampler of each renderer."""
    rows = []
    for target in sorted({row["target"] for row in scene["equal_error"]}, reverse=True):
        at_target = [row for row in scene["equal_error"] if row["target"] == target]
        own = next((row for row in at_target if row["renderer"] == "whit" and row.get("best")), None)
        for row in at_target:
            name = f"{row['renderer']} {row['sampler']}"
            amounts = " to ".join(f"{point['amount']:g}" for point in row["points"])
            cells = [target, f"**{name}**" if row.get("best") else name, amounts or "not reached"]
            for key in ["render", "whole", "processor"]:
                cells.append(f"{row[key]:.3f}" if row[key] else "-")
                cells.append(f"{row[key] / own[key]:.2f}" if row[key] and own else "-")
            rows.append(cells)
    if not rows:
        return ""
    head = ["error", "renderer", "between"]
    for kind in ["render phase", "whole process", "its processor time"]:
        head += [f"{kind}, s", "over whit's best"]
    return "\nEqual displayed error:\n" + table(head, rows)
