"""An experiment's results, as a file of numbers and as a part of the page."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

#: The experiments in the order of the page, and what they are about.
EXPERIMENTS = {
    "servo": "Figures 8, 9 and 10: four schemes drive the ball to its target, tuned alike.",
    "estimators": "Which estimator knows the Jacobian best along a smooth motion: section 4.1.",
    "exponents": "The exponent of the sliding surface: how fast, how calm; figures 2 and 3.",
    "settling": "Does the settling time keep its promise? Measured against (36)-(39).",
    "ablation": "One change at a time: what each part of the proposed scheme is worth.",
    "tuning": "The parameters that are tuned first, one at a time.",
    "beyond": "What the additions to the paper are worth: least time, moved cameras and targets.",
    "calibration": "The camera in the arm's frame, beside the classic hand-eye solvers.",
    "arms": "Arms by other authors: learned from a minute of motion and servoed.",
    "pose": "The pose of a tag: every scheme, images, and a calibrated camera.",
    "relative": "Teach and repeat relative to an object, beside calibrated cameras.",
    "hand": "The camera on the arm: learned before one tag, servoed to others.",
    "hobby": "A hobby arm: play is learned, and the arm rests without hunting.",
    "points": "Image points of webcams of unknown lenses: every scheme, noise, random arms.",
    "everyday": "500 everyday worlds: noise, latency, lost images, a camera moved before.",
    "tags": "The same for the pose of a tag.",
    "robustness": "500 harsh worlds: more of everything, and a camera bumped in motion.",
}
#: Those that are run by their own name only: they take longer than all others together.
LONG = ("everyday", "tags", "robustness")


class Words:
    """The sentences of an experiment: its module's template, whose variables are its names."""

    def __init__(self, names: Mapping[str, Any]) -> None:
        module = names["__name__"].rpartition(".")[2]
        self._macros = _template(f"{module}.jinja").make_module(dict(names))

    def __call__(self, macro: str, **arguments: Any) -> str:
        """The text of a macro; a paragraph is a line."""
        text = getattr(self._macros, macro)(**arguments).strip()
        return "\n\n".join(" ".join(part.split()) for part in re.split(r"\n\s*\n", text))


def _template(name: str):
    """A template of this package; a block's own line leaves none."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    return environment.from_string(files("fvs_lab").joinpath(name).read_text("utf-8"))


def write_report(report: Mapping[str, Any], folder: Path) -> None:
    """Write ``results.json`` into the experiment's folder; numbers that are not finite as null."""
    text = json.dumps(report, default=lambda array: array.tolist())
    text = json.dumps(json.loads(text, parse_constant=lambda _: None), separators=(",", ":"))
    (folder / "results.json").write_text(text + "\n", encoding="utf-8")


def write_page(out: Path) -> Path:
    """Write ``index.md`` from all results in a folder, which links to the pictures."""
    paths = [out / name / "results.json" for name in EXPERIMENTS]
    reports = [json.loads(path.read_text("utf-8")) for path in paths if path.is_file()]
    page = out / "index.md"
    page.write_text(_template("page.jinja").render(reports=reports), encoding="utf-8")
    return page
