"""An experiment's results, as a file of numbers and as a part of the page."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, is_dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

RESULTS = "results.json"
#: The experiments in the order of the page, and what they are about.
EXPERIMENTS = {
    "servo": "Figures 8, 9 and 10: four schemes drive the ball to its target, tuned alike.",
    "estimators": "Which estimator knows the Jacobian best along a smooth motion: section 4.1.",
    "exponents": "The exponent of the sliding surface: how fast, how calm; figures 2 and 3.",
    "settling": "Does the settling time keep its promise? Measured against (36)-(39).",
    "ablation": "One change at a time: what each part of the proposed scheme is worth.",
    "tuning": "What the parameters do that one tunes first, one at a time.",
    "beyond": "What the additions to the paper are worth: a minute of data, least time, moved "
    "cameras.",
    "calibration": "The camera in the arm's frame, beside the classic hand-eye solvers.",
    "arms": "Arms by other authors: learned from a minute of motion and servoed.",
    "pose": "The pose of a tag: every scheme, images, and a calibrated camera.",
    "everyday": "Hundreds of random worlds of the usual kind, in which no scheme worth using may "
    "fail.",
    "tags": "The same for the pose of a tag: position and angle.",
    "robustness": "Hundreds of random worlds, to see which scheme settles whatever goes wrong.",
}
#: Those that are run by their own name only: they take longer than all others together.
LONG = ("everyday", "tags", "robustness")
_WORDS = {True: "holds", False: "does not hold", None: "undecided"}


class Words:
    """The sentences of an experiment, from its template with the facts as variables."""

    def __init__(self, name: str, facts: Mapping[str, Any]) -> None:
        environment = _jinja(autoescape=False)  # the page escapes
        source = environment.from_string(_template_text(f"{name}.jinja"))
        self._macros = source.make_module(dict(facts))

    def __call__(
        self, macro: str, given: Mapping[str, Any] | None = None, lines: bool = False
    ) -> str:
        """The text of a macro, as one line unless its lines are asked for."""
        text = getattr(self._macros, macro)(**(given or {})).strip()
        return text if lines else " ".join(text.split())


def _template_text(name: str) -> str:
    """A template of this package."""
    return files("fvs_lab").joinpath(name).read_text("utf-8")


def _jinja(**options: Any):
    """Jinja's environment, in which a block's own line leaves none."""
    from jinja2 import Environment, StrictUndefined

    return Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, **options)


@dataclass(frozen=True)
class Figure:
    """A picture: a PNG in the experiment's folder, and what is to be seen."""

    file: str
    caption: str


@dataclass(frozen=True)
class Table:
    """Rows of text under a header."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Verdict:
    """A claim, the number that decides, whether it holds (None: undecided), and whose it is."""

    claim: str
    finding: str
    holds: bool | None
    whose: str = ""

    @property
    def word(self) -> str:
        """The verdict in a word or two."""
        return _WORDS[self.holds]


@dataclass(frozen=True)
class Report:
    """Everything that an experiment found: words, pictures, and in ``data`` every number."""

    name: str
    title: str
    question: str
    setup: Sequence[str]
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()
    verdicts: Sequence[Verdict] = ()
    data: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Origin:
    """Provenance of the results."""

    command: str
    #: Of this package; empty where it is not installed.
    version: str
    #: The trained model's file name and the first digits of its SHA-256.
    model: str
    quick: bool


def write_report(report: Report, folder: Path, origin: Origin) -> Path:
    """Write ``results.json`` into the experiment's folder, and return its path."""
    path = folder / RESULTS
    content = {"origin": _plain(origin), **_plain(report)}
    text = json.dumps(content, indent=None, separators=(",", ":"), allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")
    return path


def write_page(out: Path, names: Iterable[str]) -> Path:
    """Write ``index.html`` from all results in a folder, pictures included; return its path.

    The names are those of the experiments' folders, in the order of the page. The Markdown beside
    it has the same words and tables, and links to the pictures.
    """
    reports = []
    for name in names:
        path = out / name / RESULTS
        if path.is_file():
            report = json.loads(path.read_text(encoding="utf-8"))
            del report["data"]
            # The name that Markdown viewers give to a heading.
            report["slug"] = re.sub(r"[^\w\- ]", "", report["title"].lower()).replace(" ", "-")
            for verdict in report["verdicts"]:
                verdict["word"] = _WORDS[verdict["holds"]]
            for figure in report["figures"]:
                png = (path.parent / figure["file"]).read_bytes()
                figure["data"] = base64.b64encode(png).decode("ascii")
            reports.append(report)
    # Markdown has nothing to escape, HTML has.
    for template, escape in (("page.html.jinja", True), ("page.md.jinja", False)):
        environment = _jinja(autoescape=escape, keep_trailing_newline=True)
        page = environment.from_string(_template_text(template))
        text = page.render(reports=reports)
        (out / template.replace("page", "index").removesuffix(".jinja")).write_text(text, "utf-8")
    return out / "index.html"


def _plain(value: Any) -> Any:
    """JSON's types: arrays as lists, numbers rounded, what is not finite as null."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    elif isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return float(f"{value:.7g}") if np.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    raise TypeError(f"{type(value).__name__} cannot be written to {RESULTS}")
