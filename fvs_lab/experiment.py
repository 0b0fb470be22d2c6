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
from pathlib import Path
from typing import Any, TypeVar

from fvs_lab.figures import save
from fvs_lab.outcome import Outcome
from fvs_lab.report import Words
from fvs_lab.results import Interval, Results, table
from fvs_lab.trials import Conditions, Trial, run_trial
from fvs_ros.kinds.ball import Ball

PAPER, OURS = "the paper's", "ours"
_WORDS = {True: "holds", False: "does not hold", None: "undecided"}

#: Of a quick run: the longest trial, s, and conditions that compute faster.
_QUICK_S = 0.5
_QUICK: Mapping[str, Any] = {"rendered": False, "physics_rate_hz": 125.0}

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
    #: Number of processes.
    jobs: int = 1
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

    def conditions(self, **changes: Any) -> Conditions:
        """The laboratory's standard conditions, with changes."""
        return Conditions(**{**changes, **(_QUICK if self.quick else {})})

    def map(self, function: Callable[[T], R], items: Iterable[T], label: str) -> list[R]:
        """Apply a function to all items, on all cores, with a progress bar.

        The function must be importable by other processes; the results are in the items' order,
        whatever the number of processes.
        """
        from joblib import Parallel, delayed
        from tqdm import tqdm

        items = list(items)
        if not sys.stderr.isatty():
            print(f"   {label}: {len(items)} runs ...", flush=True)
        parallel = Parallel(n_jobs=self.jobs, return_as="generator")
        done = parallel(delayed(function)(item) for item in items)
        return list(tqdm(done, desc=label, total=len(items), leave=False, disable=None))

    def outcomes(self, trials: Iterable[Trial], label: str) -> list[Outcome]:
        """Run trials; those of a quick run are short."""
        if self.quick:
            trials = [
                replace(
                    one,
                    duration_s=min(one.duration_s, _QUICK_S),
                    conditions=replace(one.conditions, **_QUICK),
                )
                for one in trials
            ]
        return self.map(run_trial, trials, label)

    def run(
        self,
        trials: Iterable[Trial],
        label: str,
        measure: Callable[[Outcome], Mapping[str, Any]] = lambda _: {},
    ) -> Results:
        """Run trials: a row each, with further columns by ``measure``."""
        trials = list(trials)
        return Results(
            outcome.row(**one.labels) | dict(measure(outcome))
            for one, outcome in zip(trials, self.outcomes(trials, label), strict=True)
        )


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


def below(label: str, one: Interval, bound: float, factor: float = 1.0, unit: str = "") -> Part:
    """A number whose whole interval must be below a bound."""
    text = f"{one.text(2, factor)}{unit}, asked: below {factor * bound:.3g}{unit}"
    return Part(label, text, one.below(bound), one.high / bound)


def above(label: str, one: Interval, bound: float) -> Part:
    """A number whose whole interval must be above a bound."""
    text = f"{one.text()}, asked: above {bound:g}"
    return Part(label, text, one.above(bound), bound / max(one.low, 1e-12))


def share_above(label: str, one: Interval, bound: float) -> Part:
    """A share whose whole Wilson interval must be above a bound."""
    hits = round(one.value * one.count)
    text = f"{hits} of {one.count}, {one.text(1, 1e2)} %, asked: {100 * bound:g} %"
    return Part(label, text, one.above(bound), bound / max(one.low, 1e-12))


def kept(label: str, hits: Sequence[bool], least: float) -> Part:
    """A plain share (no interval) that must reach ``least``; undecided without runs."""
    share = sum(hits) / len(hits) if hits else 0.0
    text = f"{sum(hits)} of {len(hits)}, asked: {100 * least:.0f} %"
    return Part(label, text, share >= least if hits else None)


@dataclass(frozen=True)
class Claim:
    """A claim, its author, and the numbers that decide it."""

    #: The template's macro ``claim_NAME`` states it.
    name: str
    #: ``PAPER`` or ``OURS``.
    whose: str
    #: All must hold, or with ``any_of`` one of them.
    parts: Sequence[Part]
    any_of: bool = False
    #: Arguments of the macro.
    given: Mapping[str, Any] = field(default_factory=dict)

    @property
    def holds(self) -> bool | None:
        """Whether the claim holds; None if undecided."""
        found = [part.holds for part in self.parts]
        if self.any_of in found:
            return self.any_of
        return None if None in found else not self.any_of

    @property
    def decisive(self) -> Part:
        """The part that decides: of those with the claim's verdict, the closest to its bound."""
        alike = [part for part in self.parts if part.holds is self.holds]
        return (min if self.any_of else max)(alike, key=lambda part: part.margin)


def ours(name: str, *parts: Part, any_of: bool = False, **given: Any) -> Claim:
    """A claim of this project."""
    return Claim(name, OURS, parts, any_of, given)


def papers(name: str, *parts: Part, any_of: bool = False, **given: Any) -> Claim:
    """A claim of the paper."""
    return Claim(name, PAPER, parts, any_of, given)


# ---- what is found and shown ----------------------------------------------------------------


@dataclass(frozen=True)
class Found:
    """What an experiment measured."""

    #: The tidy table; goes to results.json without time series.
    runs: Results
    #: Further variables of the template.
    facts: Mapping[str, Any] = field(default_factory=dict)
    #: What else goes to results.json: seeds, cases, parameters.
    data: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class TableOf:
    """Declaration of a table: the columns that group its rows, and those to summarise.

    See :func:`table`.
    """

    #: Its caption is the template's macro ``table_NAME``.
    name: str
    by: Sequence[str]
    columns: Sequence[str]
    #: Rows of the tidy table with these values.
    where: Mapping[str, Any] = field(default_factory=dict)
    #: A column whose values stand side by side.
    across: str = ""

    def of(self, runs: Results) -> list[dict[str, str]]:
        """The table's rows of these runs."""
        return table(runs.where(**self.where), self.by, self.columns, self.across)


#: A figure by the name of its macro, with the macro's arguments.
Drawn = tuple[str, Any, Mapping[str, Any]]


@dataclass(frozen=True)
class Experiment:
    """An experiment: its measurement, claims, tables and figures."""

    #: Of its module, its template and its folder.
    name: str
    measure: Callable[[Context], Found]
    claims: Callable[[Found], Iterable[Claim]]
    tables: Sequence[TableOf]
    figures: Callable[[Found], Iterable[Drawn]]
    #: The module's names, which are variables of the template beside what was found.
    names: Mapping[str, Any]
    #: Name of the template; by default the experiment's.
    template: str = ""
    #: The shipped model that it uses; empty for none.
    model: str = Ball.model

    def run(self, context: Context) -> dict[str, Any]:
        """Measure, judge, tabulate and draw: a report for :func:`fvs_lab.report.write_report`."""
        found = self.measure(context)
        words = Words(self.template or self.name, {**self.names, **found.facts})
        figures = []
        for name, drawing, given in self.figures(found):
            file = re.sub(r"\W+", "_", "_".join([name, *map(str, given.values())])) + ".png"
            save(drawing, context.folder(self.name) / file)
            figures.append({"file": file, "caption": words(f"figure_{name}", **given)})
        tables = [
            {"caption": words(f"table_{one.name}"), "rows": one.of(found.runs)}
            for one in self.tables
        ]
        verdicts = [
            {
                "claim": words(f"claim_{claim.name}", **claim.given),
                "finding": f"{claim.decisive.label}: {claim.decisive.measured}",
                "word": _WORDS[claim.holds],
                "whose": claim.whose,
                "parts": claim.parts,
            }
            for claim in self.claims(found)
            if claim.parts
        ]
        runs = [
            {name: value for name, value in row.items() if name != "series"} for row in found.runs
        ]
        return {
            "name": self.name,
            "title": words("title"),
            "question": words("question"),
            "setup": words.paragraphs("setup"),
            "figures": figures,
            "tables": [table for table in tables if table["rows"]],
            "verdicts": verdicts,
            "data": {**found.data, "runs": runs},
        }
