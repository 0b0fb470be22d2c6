"""The page of a recording: what happened, targets, timing, predictions; words in replay.jinja."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_lab import figures
from fvs_lab.replay import drawings, story
from fvs_lab.replay.reading import Recording
from fvs_lab.replay.targets import BOUNDS_M, Target, judged_by, targets
from fvs_lab.report import Figure, Heading, Origin, Report, Table, Words, write_page, write_report
from fvs_lab.results import Results, table
from fvs_ros.paths import version
from fvs_ros.status import SILENT

_STOPPED = (State.HOLDING.name, State.FAULT.name, SILENT)


def write(recording: Recording, name: str, command: str, out: Path) -> tuple[list[Report], Path]:
    """Write the page of a recording into a folder; its sections, and the page's path."""
    page = _Page(recording, out)
    reports = [page.happened(), page.targets(), page.timing(), page.prediction()]
    for report in reports:
        write_report(report, out / report.name, Origin(command, version(), "", quick=False))
    heading = Heading(f"Recording {name}", page.words("lead"))
    return reports, write_page(out, [one.name for one in reports], heading)


def shortened(rows: Sequence[Sequence[str]], most: int, last: int, where: str) -> list[Any]:
    """At most this number of rows, with these of the end, and one that says what is left out."""
    left_out = len(rows) - most
    if left_out <= 0:
        return list(rows)
    note = ["…", f"{left_out} more {where}", *[""] * (len(rows[0]) - 2)]
    return [*rows[: most - last], note, *rows[-last:]]


class _Page:
    """The sections of one recording."""

    def __init__(self, recording: Recording, out: Path) -> None:
        self._recording, self._out = recording, out
        self._targets = targets(recording)
        self._states = story.states(recording)
        self._prediction = story.prediction(recording)
        self.words = Words("replay", self._facts())

    def _facts(self) -> dict[str, Any]:
        recording, found, series = self._recording, self._targets, self._recording.series
        times_s = [one.numbers["settling_5mm_s"] for one in found if not one.moving]
        stopped = [
            one for one in self._states if one.state in _STOPPED and one.reason != story.SHUT_DOWN
        ]
        latency_s = np.empty(0)
        if {"ball", "commands"} <= series.keys():
            latency_s = story.command_latencies(series["ball"], series["commands"])
        return {
            "recording": recording,
            "started": recording.started(),
            "count": sum(map(len, recording.topics.values())),
            "targets": found,
            "still": len(times_s),
            "settled_s": [one for one in times_s if one is not None and np.isfinite(one)],
            "unknown": sum("settling_5mm_s" in one.not_known for one in found),
            "bound_mm": 1e3 * BOUNDS_M[0],
            "held": story.totals(stopped, "state", "reason"),
            "ball": judged_by(recording),
            "latency_ms": np.percentile(1e3 * latency_s, [50, 99]) if latency_s.size else None,
            "prediction": self._prediction,
            "median": np.median,
        }

    def _report(
        self,
        name: str,
        tables: Mapping[str, Sequence[Mapping[str, Any]]],
        drawn: Mapping[str, Any],
        data: Mapping[str, Any],
    ) -> Report:
        """A section: its tables' rows and its figures by the names of their macros."""
        (self._out / name).mkdir(parents=True, exist_ok=True)
        for file, figure in drawn.items():
            figures.save(figure, self._out / name / f"{file}.png")
        found = []
        for caption, records in tables.items():
            rows = table(Results(records), list(records[0]), ()) if records else []
            cells = [list(row.values()) for row in rows]
            short = shortened(cells, 60, 20, "in results.json")
            if rows:
                found.append(Table(self.words(f"table_{caption}"), list(rows[0]), short))
        setup = self.words(f"{name}_setup", lines=True).splitlines()
        return Report(
            name=name,
            title=self.words(f"{name}_title"),
            question=self.words(f"{name}_question"),
            setup=[" ".join(line.split()) for line in setup if line.strip()],
            figures=[Figure(f"{file}.png", self.words(f"figure_{file}")) for file in drawn],
            tables=found,
            data=data,
        )

    # ---- sections ---------------------------------------------------------------------------

    def happened(self) -> Report:
        """States, limits, warnings."""
        events, limits = story.events(self._recording), story.limit_shares(self._recording)
        tables = {
            "states": _rows(
                self._states,
                {"from, s": "start_s", "for, s": "length_s"},
                {"state": "state", "reason": "reason", "status": "text"},
            ),
            "events": _rows(
                events, {"first at, s": "time_s"}, {"who": "who", "what": "text", "times": "times"}
            ),
            "limits": [
                {
                    "limit": one["limit"],
                    "for, s": round(one["time_s"], 2),
                    "of the time on the way, %": _rounded(100 * one["way"]),
                }
                for one in limits
            ],
        }
        data = {
            "cut_off": self._recording.cut_off,
            "scenario": self._recording.scenario,
            "states": [one._asdict() for one in self._states],
            "limits": limits,
            "events": [one._asdict() for one in events],
        }
        return self._report(
            "happened",
            tables,
            {"overview": drawings.overview(self._recording, self._targets)},
            data,
        )

    def targets(self) -> Report:
        """How each target went."""
        columns = {
            "start, mm": ("start_distance_m", 1e3, 0),
            **{
                f"to {1e3 * one:g} mm, s": (f"settling_{1e3 * one:g}mm_s", 1, 2) for one in BOUNDS_M
            },
            "final rms, mm": ("final_rms_m", 1e3, 2),
            "path, mm": ("path_m", 1e3, 0),
            "peak joint speed, rad/s": ("peak_joint_speed_rad_s", 1, 2),
            "jitter, mrad/s": ("jitter_rad_s", 1e3, 2),
        }
        rows = [
            {
                "target": f"{number}{', moving' * one.moving}",
                **{title: _cell(one, *column) for title, column in columns.items()},
            }
            for number, one in enumerate(self._targets, start=1)
        ]
        data = [
            {
                "target_m": one.target_m,
                "given_s": one.given_s - self._recording.start_s,
                "moving": one.moving,
                **one.numbers,
                "not_known": one.not_known,
            }
            for one in self._targets
        ]
        drawn = {"paths": drawings.paths(self._targets)} if self._targets else {}
        ball = judged_by(self._recording)
        judged = {"judged_by": None if ball is None else ball.topic, "targets": data}
        return self._report("targets", {"targets": rows}, drawn, judged)

    def timing(self) -> Report:
        """Rates, gaps and ages."""
        found = story.rhythms(self._recording)
        columns = {
            "topic": "topic",
            "messages": "count",
            "rate, Hz": "rate_hz",
            "jitter, ms": "jitter_ms",
            "longest gap, ms": "longest_gap_ms",
            "age, median, ms": "median_age_ms",
            "age, 99 %, ms": "p99_age_ms",
        }
        rows = [{title: _rounded(one[name]) for title, name in columns.items()} for one in found]
        return self._report("timing", {"timing": rows}, {}, {"topics": found})

    def prediction(self) -> Report:
        """T1 and T2 of the recorded Jacobian."""
        found = self._prediction
        if found is None:
            return self._report("prediction", {}, {}, {})
        return self._report("prediction", {}, {"predictions": drawings.steps(found)}, asdict(found))


def _cell(target: Target, name: str, factor: float, digits: int) -> Any:
    value = target.numbers[name]
    if name in target.not_known:
        return "not known"
    return "never" if value is None else f"{factor * value:.{digits}f}".replace("nan", "-")


def _rows(
    records: Sequence[Any], times: Mapping[str, str], words: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Rows of attributes by the columns' titles: first times, s, then anything."""
    return [
        {title: round(getattr(one, name), 2) for title, name in times.items()}
        | {title: getattr(one, name) for title, name in words.items()}
        for one in records
    ]


def _rounded(value: Any) -> Any:
    return float(f"{value:.3g}") if isinstance(value, float) else value
