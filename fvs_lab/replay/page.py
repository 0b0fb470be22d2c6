"""The page of a recording: what happened, targets, timing, predictions; words in replay.jinja."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_lab import figures
from fvs_lab.replay import drawings, story
from fvs_lab.replay.reading import Recording
from fvs_lab.replay.targets import BOUNDS_M, Target, judged_by, targets
from fvs_lab.report import Figure, Heading, Origin, Report, Table, Words, write_page, write_report
from fvs_lab.results import METRICS, Metric, number_text
from fvs_ros.paths import version
from fvs_ros.status import SILENT

#: How columns are shown: the experiments', and others.
_METRICS = {
    **METRICS,
    "start_s": Metric("from, s"),
    "length_s": Metric("for, s"),
    "text": Metric("words"),
    "time_s": Metric("first at, s"),
    "way": Metric("of the time on the way, %", 1e2, 1),
    "start_distance_m": Metric("start, mm", 1e3, 0),
    **{name: Metric(f"to {1e3 * bound:g} mm, s") for name, bound in BOUNDS_M.items()},
    "path_m": Metric("path, mm", 1e3, 0),
    "final_rms_deg": Metric("final turn, ° rms", 1.0, 3),
    "rate_hz": Metric("rate, Hz"),
    "jitter_ms": Metric("jitter, ms"),
    "longest_gap_ms": Metric("longest gap, ms"),
    "median_age_ms": Metric("age, median, ms"),
    "p99_age_ms": Metric("age, 99 %, ms"),
}
#: Rows of a longer table, and how many of them are its last.
_ROWS, _LAST = 40, 10

#: Rows, and names of the columns.
Records = tuple[Sequence[Mapping[str, Any]], Sequence[str]]


@dataclass(frozen=True)
class _Section:
    """A part of the page; the names are those of the template's macros."""

    name: str
    data: Mapping[str, Any]
    tables: Mapping[str, Records] = field(default_factory=dict)
    figures: Mapping[str, Any] = field(default_factory=dict)

    def report(self, words: Words, out: Path) -> Report:
        """The section with its words; its figures are written."""
        (out / self.name).mkdir(parents=True, exist_ok=True)
        for file, figure in self.figures.items():
            figures.save(figure, out / self.name / f"{file}.png")
        setup = words(f"{self.name}_setup", lines=True).splitlines()
        return Report(
            name=self.name,
            title=words(f"{self.name}_title"),
            question=words(f"{self.name}_question"),
            setup=[" ".join(line.split()) for line in setup if line.strip()],
            figures=[Figure(f"{file}.png", words(f"figure_{file}")) for file in self.figures],
            tables=[
                _table(words(f"table_{name}"), *some)
                for name, some in self.tables.items()
                if some[0]
            ],
            data=self.data,
        )


def _table(caption: str, records: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> Table:
    """A table of some columns; the middle of a long one is left out."""
    shown = [_METRICS.get(name, Metric(name)) for name in columns]
    rows = [
        [_cell(record.get(name, np.nan), one) for name, one in zip(columns, shown, strict=True)]
        for record in records
    ]
    if len(rows) > _ROWS:
        note = ["…", f"{len(rows) - _ROWS} more in results.json", *[""] * (len(columns) - 2)]
        rows[_ROWS - _LAST : -_LAST] = [note]
    return Table(caption, [one.label for one in shown], rows)


def _cell(value: Any, metric: Metric) -> str:
    number = isinstance(value, float)
    return number_text(metric.factor * value, metric.digits) if number else str(value)


def write(recording: Recording, name: str, command: str, out: Path) -> tuple[list[Report], Path]:
    """Write the page of a recording into a folder; its sections, and the page's path."""
    found, predicted = targets(recording), story.prediction(recording)
    words = Words("replay", _facts(recording, found, predicted))
    sections = (
        _happened(recording, found),
        _targets(recording, found),
        _timing(recording),
        _Section(
            "prediction",
            asdict(predicted) if predicted else {},
            figures={"predictions": drawings.steps(predicted)} if predicted else {},
        ),
    )
    reports = [one.report(words, out) for one in sections]
    for report in reports:
        write_report(report, out / report.name, Origin(command, version(), "", quick=False))
    heading = Heading(f"Recording {name}", words("lead"))
    return reports, write_page(out, [one.name for one in reports], heading)


def _facts(
    recording: Recording, found: Sequence[Target], predicted: story.Prediction | None
) -> dict[str, Any]:
    """Variables of the template."""
    series = recording.series
    times_s = [one.numbers["settling_5mm_s"] for one in found if not one.moving]
    stopped = [
        one
        for one in story.states(recording)
        if one.state in (State.HOLDING.name, State.FAULT.name, SILENT)
        and one.reason != story.SHUT_DOWN
    ]
    latency_s = np.empty(0)
    if {"ball", "commands"} <= series.keys():
        latency_s = story.command_latencies(series["ball"], series["commands"])
    return {
        "recording": recording,
        "count": sum(map(len, recording.topics.values())),
        "targets": found,
        "still": len(times_s),
        "settled_s": [one for one in times_s if np.isfinite(one)],
        "unknown": int(np.isnan(times_s).sum()),
        "what": recording.feature.what,
        "bound_mm": 1e3 * BOUNDS_M["settling_5mm_s"],
        "held": story.totals(stopped, "state", "reason"),
        "ball": judged_by(recording),
        "latency_ms": np.percentile(1e3 * latency_s, [50, 99]) if latency_s.size else None,
        "prediction": predicted,
        "median": np.median,
        "isnan": np.isnan,
    }


# ---- sections -------------------------------------------------------------------------------


def _happened(recording: Recording, found: Sequence[Target]) -> _Section:
    """States, events and limits."""
    states = [one._asdict() for one in story.states(recording)]
    events = [one._asdict() for one in story.events(recording)]
    limits = story.limits(recording)
    tables: dict[str, Records] = {
        "states": (states, ("start_s", "length_s", "state", "reason", "text")),
        "events": (events, ("time_s", "who", "text", "times")),
        "limits": (limits, ("limit", "length_s", "way")),
    }
    data = {"cut_off": recording.cut_off, "scenario": recording.scenario}
    data |= {name: records for name, (records, _) in tables.items()}
    return _Section("happened", data, tables, {"overview": drawings.overview(recording, found)})


def _targets(recording: Recording, found: Sequence[Target]) -> _Section:
    """How each target went."""
    records = [
        {
            "target": f"{number}{', moving' * one.moving}",
            "target_m": one.target_m[:3],
            "given_s": one.given_s - recording.start_s,
            **one.numbers,
            "not_known": [name for name, value in one.numbers.items() if np.isnan(value)],
        }
        for number, one in enumerate(found, start=1)
    ]
    final = ("final_rms_m", *["final_rms_deg"] * recording.feature.curved)
    columns = ("target", "start_distance_m", *BOUNDS_M, *final, "path_m")
    columns += ("peak_joint_speed_rad_s", "jitter_rad_s")
    ball = judged_by(recording)
    return _Section(
        "targets",
        {"judged_by": ball and ball.topic, "targets": records},
        {"targets": (records, columns)},
        {"paths": drawings.paths(found)} if found else {},
    )


def _timing(recording: Recording) -> _Section:
    """Rates, gaps and ages."""
    found = story.rhythms(recording)
    return _Section(
        "timing", {"topics": found}, {"timing": (found, list(found[0]) if found else ())}
    )
