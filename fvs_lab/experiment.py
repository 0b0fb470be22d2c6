"""An experiment as a declaration, and how it becomes a report.

The module of an experiment says what is run, shown and claimed; the template of the same name
beside it has the sentences, a macro each: ``title``, ``question``, ``setup``, ``figure_NAME``,
``table_NAME`` and ``claim_NAME``. A new experiment is these two files and a name in
:data:`fvs_lab.report.EXPERIMENTS`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from fvs_lab.figures import save
from fvs_lab.report import Words
from fvs_lab.results import Interval, Results, Table
from fvs_lab.trials import Trial, run_trial
from fvs_ros.kinds.ball import Ball
from fvs_tools.score import FINAL_S
from fvs_tools.workers import Workers

T = TypeVar("T")
R = TypeVar("R")


# ---- what is run ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Context:
    """Settings of one call of ``fvs_experiments``, and how an experiment uses all cores."""

    #: Folder of the page; each experiment has one of its own name in it.
    out: Path
    #: Number of seeded cases or worlds; each experiment has its own default.
    seeds: int | None = None
    #: What runs the trials.
    workers: Workers = field(default_factory=Workers)
    #: Whether to run a small part of everything, as a smoke test.
    quick: bool = False
    #: Schemes that run in random worlds; empty for all.
    schemes: tuple[str, ...] = ()

    def folder(self, name: str) -> Path:
        """The folder of an experiment, made if need be."""
        path = self.out / name
        path.mkdir(parents=True, exist_ok=True)
        return path

    def count(self, default: int) -> int:
        """Number of seeded cases; a quick run has one."""
        return self.seeds or (1 if self.quick else default)

    def first(self, items: Iterable[T], count: int) -> list[T]:
        """All items, or the first few in a quick run."""
        return list(items)[: count if self.quick else None]

    def map(self, function: Callable[..., R], items: Iterable[Any], label: str) -> list[R]:
        """Apply a function to all items, by the workers, with a progress bar.

        A tuple holds the function's arguments.
        """
        from tqdm import tqdm

        items = [item if isinstance(item, tuple) else (item,) for item in items]
        if not sys.stderr.isatty():
            print(f"   {label}: {len(items)} runs ...", flush=True)
        done = self.workers(partial(_apply, function), items)
        return list(tqdm(done, desc=label, total=len(items), leave=False, disable=None))

    def rows(
        self, function: Callable[..., Iterable[R]], items: Iterable[Any], label: str
    ) -> list[R]:
        """The same of a function that makes several rows of an item: all of them."""
        return [row for rows in self.map(function, items, label) for row in rows]

    def run(self, trials: Iterable[Trial], label: str, quick_s: float = 0.2) -> Results:
        """Run trials, a row each; those of a quick run end early, and compute faster."""
        if self.quick:
            faster = {"rendered": False, "physics_rate_hz": 125.0}
            trials = [
                trial.changed(
                    conditions=faster,
                    duration_s=min(trial.duration_s, quick_s),
                    stop_after_s=FINAL_S,
                )
                for trial in trials
            ]
        return Results(self.map(run_trial, trials, label))


def _apply(function: Callable[..., R], arguments: tuple[Any, ...]) -> R:
    return function(*arguments)


# ---- what is claimed ------------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """One measured number that a claim stands on."""

    #: What was measured.
    label: str
    #: The number with its interval, and what is asked of it.
    measured: str
    #: Whether the part holds; None if undecided.
    holds: bool | None
    #: Of two parts that agree, the one with the larger margin decides.
    margin: float = 0.0


def below(
    label: str, measured: Interval, bound: float, factor: float = 1.0, unit: str = ""
) -> Part:
    """A number whose whole interval must be below a bound."""
    text = f"{measured.text(2, factor)}{unit} (below {factor * bound:.3g}{unit})"
    return Part(label, text, measured.below(bound), measured.high / bound)


def above(label: str, measured: Interval, bound: float) -> Part:
    """A number whose whole interval must be above a bound."""
    text = f"{measured.text()} (above {bound:g})"
    return Part(label, text, measured.above(bound), bound / max(measured.low, 1e-12))


def share_above(label: str, measured: Interval, bound: float) -> Part:
    """A share whose whole Wilson interval must be above a bound."""
    hits = round(measured.value * measured.count)
    text = f"{hits} of {measured.count}, {measured.text(1, 1e2)} % ({100 * bound:g} %)"
    return replace(above(label, measured, bound), measured=text)


def kept(label: str, hits: Sequence[bool], least: float) -> Part:
    """A plain share (no interval) that must reach ``least``; undecided without runs."""
    text = f"{sum(hits)} of {len(hits)} ({100 * least:.0f} %)"
    return Part(label, text, sum(hits) >= least * len(hits) if hits else None)


@dataclass(frozen=True)
class Claim:
    """A claim, and the numbers that decide it: all, or one of them with ``any_of``.

    The template's macro ``claim_NAME`` states it, with some arguments.
    """

    name: str
    parts: Sequence[Part]
    whose: str = "ours"
    any_of: bool = False
    arguments: Mapping[str, Any] = field(default_factory=dict)

    @property
    def holds(self) -> bool | None:
        """Whether the claim holds; None if undecided."""
        verdicts = [part.holds for part in self.parts]
        if self.any_of in verdicts:
            return self.any_of
        return None if None in verdicts else not self.any_of

    @property
    def decisive(self) -> Part:
        """The part that decides: of those with the claim's verdict, the closest to its bound."""
        alike = [part for part in self.parts if part.holds is self.holds]
        return (min if self.any_of else max)(alike, key=lambda part: part.margin)

    def verdict(self, words: Words) -> dict[str, Any]:
        """Its row on the page."""
        return {
            "word": {True: "holds", False: "does not hold", None: "undecided"}[self.holds],
            "claim": words(f"claim_{self.name}", **self.arguments),
            "finding": f"{self.decisive.label}: {self.decisive.measured}",
            "whose": self.whose,
        }


def ours(name: str, *parts: Part, any_of: bool = False, **arguments: Any) -> Claim:
    """A claim of this project."""
    return Claim(name, parts, "ours", any_of, arguments)


def papers(name: str, *parts: Part, any_of: bool = False, **arguments: Any) -> Claim:
    """A claim of the paper."""
    return Claim(name, parts, "paper", any_of, arguments)


# ---- what is shown --------------------------------------------------------------------------


#: A figure by the name of its macro, with the macro's arguments.
Drawn = tuple[str, Any, Mapping[str, Any]]


@dataclass(frozen=True)
class Experiment:
    """An experiment: its tidy table, and what is claimed and shown of it."""

    #: Of its folder.
    name: str
    measure: Callable[[Context], Results]
    claims: Callable[[Results], Iterable[Claim]]
    tables: Sequence[Table]
    #: The module's names: that of the template, and its variables beside the ``runs``.
    names: Mapping[str, Any]
    figures: Callable[[Results], Iterable[Drawn]] = lambda _: ()
    #: The shipped model that it uses; empty for none.
    model: str = Ball().model

    def run(self, context: Context) -> dict[str, Any]:
        """Measure, judge, tabulate and draw: a report for :func:`fvs_lab.report.write_report`."""
        runs = self.measure(context)
        words = Words({**self.names, "runs": runs})
        figures = []
        for name, drawing, arguments in self.figures(runs):
            file = re.sub(r"\W+", "_", "_".join([name, *map(str, arguments.values())])) + ".png"
            save(drawing, context.folder(self.name) / file)
            figures.append({"file": file, "caption": words(f"figure_{name}", **arguments)})
        tables = [
            {"caption": words(f"table_{table.name}"), "rows": table.rows(runs)}
            for table in self.tables
        ]
        return {
            "name": self.name,
            "title": words("title"),
            "question": words("question"),
            "setup": words("setup"),
            "figures": figures,
            "tables": [table for table in tables if table["rows"]],
            "verdicts": [claim.verdict(words) for claim in self.claims(runs) if claim.parts],
            "runs": [{name: row[name] for name in row if name != "series"} for row in runs],
        }
