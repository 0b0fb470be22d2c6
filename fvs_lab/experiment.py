"""An experiment as a declaration, and how it becomes a report.

The module of an experiment says what is run, shown and claimed; the template of the same name
beside it has the sentences, a macro each: ``title``, ``question``, ``setup``, ``figure_NAME``,
``table_NAME`` and ``claim_NAME``. A new experiment is these two files and a name in
:data:`fvs_lab.report.EXPERIMENTS`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

from fvs_lab.context import Context
from fvs_lab.report import Figure, Report, Table, Verdict
from fvs_lab.results import Results
from fvs_lab.statistics import Interval, all_hold, any_holds
from fvs_lab.style import save

PAPER, OURS = "the paper's", "ours"


@dataclass(frozen=True)
class Part:
    """One measured number that a claim stands on.

    Parameters
    ----------
    label : str
        What was measured.
    measured : str
        The number with its interval, and what is asked of it.
    holds : bool or None
        Whether it is so; None if undecided.
    margin : float
        Of two parts that agree, the one with the larger margin decides.
    """

    label: str
    measured: str
    holds: bool | None
    margin: float = 0.0


def below(
    label: str, one: Interval, bound: float, factor: float = 1.0, digits: int = 2, unit: str = ""
) -> Part:
    """A number whose whole interval must be below a bound."""
    text = f"{one.text(digits, factor)}{unit}, asked: below {factor * bound:g}{unit}"
    return Part(label, text, one.below(bound), one.high / bound)


def above(
    label: str, one: Interval, bound: float, factor: float = 1.0, digits: int = 2, unit: str = ""
) -> Part:
    """A number whose whole interval must be above a bound."""
    text = f"{one.text(digits, factor)}{unit}, asked: above {factor * bound:g}{unit}"
    return Part(label, text, one.above(bound), bound / max(one.low, 1e-12))


def share_above(label: str, one: Interval, bound: float) -> Part:
    """A share whose whole Wilson interval must be above a bound."""
    hits = round(one.value * one.count)
    low, high = (f"{100 * end:.1f}" for end in (one.low, one.high))
    text = f"{hits} of {one.count} (95 % interval {low} to {high} %), asked: {100 * bound:g} %"
    return Part(label, text, one.above(bound), bound / max(one.low, 1e-12))


def either(label: str, *parts: Part) -> Part:
    """One part of several of which one is enough."""
    holds = any_holds(part.holds for part in parts)
    best = min((part for part in parts if part.holds is holds), key=lambda part: part.margin)
    return Part(f"{label}, {best.label}", best.measured, holds, best.margin)


@dataclass(frozen=True)
class Claim:
    """What is claimed, by whom, and the numbers that decide.

    Parameters
    ----------
    name : str
        The template's macro ``claim_NAME`` states it.
    whose : str
        ``PAPER`` or ``OURS``.
    parts : sequence of Part
        All must hold, or one of them.
    any_of : bool
        Whether one is enough.
    given : mapping
        Arguments of the macro.
    """

    name: str
    whose: str
    parts: Sequence[Part]
    any_of: bool = False
    given: Mapping[str, Any] = field(default_factory=dict)

    @property
    def holds(self) -> bool | None:
        """Whether the claim holds; None if undecided."""
        return (any_holds if self.any_of else all_hold)(part.holds for part in self.parts)

    @property
    def decisive(self) -> Part:
        """The part that decides: of those with the claim's verdict, the closest to its bound."""
        alike = [part for part in self.parts if part.holds is self.holds]
        return (min if self.any_of else max)(alike, key=lambda part: part.margin)


@dataclass(frozen=True)
class Found:
    """What an experiment measured.

    Parameters
    ----------
    runs : Results
        The tidy table; goes to results.json without time series.
    facts : mapping
        Variables of the template.
    data : mapping
        What else goes to results.json: seeds, cases, parameters.
    extra : mapping
        Further results that figures, tables and claims need.
    """

    runs: Results
    facts: Mapping[str, Any] = field(default_factory=dict)
    data: Mapping[str, Any] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)


#: Something by the name of its macro, with the macro's arguments where it has some.
Named = tuple[str, Any] | tuple[str, Any, Mapping[str, Any]]


@dataclass(frozen=True)
class Experiment:
    """What is measured, and what is made of it.

    Parameters
    ----------
    name : str
        Of its module, its template and its folder.
    measure : callable
        Runs everything.
    claims : callable
        From what was found to claims.
    tables : callable
        From what was found to named tables, each a list of rows, mappings from header to cell.
    figures : callable
        From what was found to named matplotlib figures.
    template : str
        Name of the template; by default the experiment's.
    """

    name: str
    measure: Callable[[Context], Found]
    claims: Callable[[Found], Iterable[Claim]]
    tables: Callable[[Found], Iterable[Named]]
    figures: Callable[[Found], Iterable[Named]]
    template: str = ""

    def run(self, context: Context) -> Report:
        """Measure, judge, tabulate and draw."""
        found = self.measure(context)
        words = Words(self.template or self.name, found.facts)
        claims = [claim for claim in self.claims(found) if claim.parts]
        return Report(
            name=self.name,
            title=words("title"),
            question=words("question"),
            setup=[
                " ".join(paragraph.split())
                for paragraph in re.split(r"\n\s*\n", words("setup", lines=True))
            ],
            figures=self._figures(context, found, words),
            tables=[
                *(_table(words, *one) for one in self.tables(found)),
                *_evidence(words, claims),
            ],
            verdicts=[
                Verdict(
                    words(f"claim_{claim.name}", claim.given),
                    f"{claim.decisive.label}: {claim.decisive.measured}",
                    claim.holds,
                    claim.whose,
                )
                for claim in claims
            ],
            data={
                **found.data,
                "runs": [
                    {name: value for name, value in row.items() if name != "series"}
                    for row in found.runs
                ],
            },
        )

    def _figures(self, context: Context, found: Found, words: Words) -> list[Figure]:
        figures = []
        folder = context.folder(self.name)
        for name, drawing, *given in self.figures(found):
            values = given[0].values() if given else ()
            file = re.sub(r"\W+", "_", "_".join([name, *map(str, values)])) + ".png"
            save(drawing, folder / file)
            figures.append(Figure(file, words(f"figure_{name}", given[0] if given else None)))
        return figures


class Words:
    """The sentences of an experiment, from its template.

    Parameters
    ----------
    name : str
        Of the template.
    facts : mapping
        Variables of all macros.
    """

    def __init__(self, name: str, facts: Mapping[str, Any]) -> None:
        from jinja2 import Environment, StrictUndefined

        source = files("fvs_lab").joinpath(f"{name}.jinja").read_text("utf-8")
        environment = Environment(
            autoescape=False,  # the page escapes
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        self._macros = environment.from_string(source).make_module(dict(facts))

    def __call__(
        self, macro: str, given: Mapping[str, Any] | None = None, lines: bool = False
    ) -> str:
        """The text of a macro, as one line unless its lines are asked for."""
        text = getattr(self._macros, macro)(**(given or {})).strip()
        return text if lines else " ".join(text.split())


def _table(
    words: Words,
    name: str,
    rows: Sequence[Mapping[str, str]],
    given: Mapping[str, Any] | None = None,
) -> Table:
    header = list(rows[0]) if rows else []
    return Table(words(f"table_{name}", given), header, [list(row.values()) for row in rows])


def _evidence(words: Words, claims: Sequence[Claim]) -> list[Table]:
    """All parts of the claims that stand on more than one number."""
    word = {True: "yes", False: "no", None: "undecided"}
    rows = [
        [words(f"claim_{claim.name}", claim.given), part.label, part.measured, word[part.holds]]
        for claim in claims
        if len(claim.parts) > 1
        for part in claim.parts
    ]
    header = ["claim", "number", "measured", "so"]
    return [Table("What the claims with several numbers stand on.", header, rows)] if rows else []
