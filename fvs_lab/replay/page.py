"""The page of a recording: what happened, targets, timing, predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_lab.replay import figures, story
from fvs_lab.replay.predictions import prediction
from fvs_lab.replay.recording import Recording
from fvs_lab.replay.targets import BOUNDS_M, Target, judged_by, targets
from fvs_lab.report import Figure, Heading, Origin, Report, Table, write_page, write_report
from fvs_ros.status import SILENT
from fvs_ros.version import version

#: A table has at most this number of rows: most from its beginning, some of its end.
_ROWS, _LAST_ROWS = 60, 20
_STOPPED = (State.HOLDING.name, State.FAULT.name, SILENT)
_LEAD = "A recorded run of visual servoing, in simulation or on a robot."


def write(recording: Recording, name: str, command: str, out: Path) -> tuple[list[Report], Path]:
    """Write the page of a recording into a folder; its sections, and the page's path."""
    found = targets(recording)
    makers = {"happened": _happened, "targets": _targets, "timing": _timing, "prediction": _steps}
    reports = []
    for section, make in makers.items():
        folder = out / section
        folder.mkdir(parents=True, exist_ok=True)
        reports.append(make(recording, found, folder))
        write_report(reports[-1], folder, Origin(command, version(), "", quick=False))
    return reports, write_page(out, tuple(makers), Heading(f"Recording {name}", _LEAD))


def shortened(rows: Sequence[Sequence[str]], most: int, last: int, where: str) -> list[Any]:
    """At most this number of rows, with these of the end, and one that says what is left out."""
    left_out = len(rows) - most
    if left_out <= 0:
        return list(rows)
    note = ["…", f"{left_out} more {where}", *[""] * (len(rows[0]) - 2)]
    return [*rows[: most - last], note, *rows[-last:]]


def _table(
    caption: str, columns: Mapping[str, str], records: Sequence[Mapping[str, Any]]
) -> list[Table]:
    """A table of records, with the format of each column; none without records."""
    rows = [[text.format_map(one) for text in columns.values()] for one in records]
    known = [["" if cell.startswith("nan") else cell for cell in row] for row in rows]
    short = shortened(known, _ROWS, _LAST_ROWS, "in results.json")
    return [Table(caption, list(columns), short)] if rows else []


# --- what happened ---


def _happened(recording: Recording, found: Sequence[Target], folder: Path) -> Report:
    states = [one._asdict() for one in story.states(recording)]
    events = [one._asdict() for one in story.events(recording)]
    limits = story.limit_shares(recording)
    figures.overview(recording, found, BOUNDS_M, folder / "overview.png")
    times = {"from, s": "{start_s:.2f}", "for, s": "{length_s:.2f}"}
    tables = _table(
        "The controller’s states and reasons.",
        {**times, "state": "{state}", "reason": "{reason}", "status": "{text}"},
        states,
    )
    tables += _table(
        "Warnings, changed parameters, and silences of the controller and its inputs.",
        {"first at, s": "{time_s:.2f}", "who": "{who}", "what": "{text}", "times": "{times}"},
        events,
    )
    tables += _table(
        "Limits that shaped the command; on the way is SERVOING before it is SETTLED.",
        {"limit": "{limit}", "for, s": "{time_s:.2f}", "of the time on the way": "{way:.0%}"},
        limits,
    )
    return Report(
        name="happened",
        title="What happened",
        question="What did the controller do, when, and why?",
        setup=[
            _what_ran(recording),
            _how_targets_went(recording, found),
            _why_stopped(recording),
            *_what_is_missing(recording, found),
        ],
        figures=[
            Figure(
                "overview.png",
                "From above: the controller’s state, and when a limit shaped its command; the "
                "ball’s distance to each target; the joints’ velocities, measured and commanded.",
            )
        ],
        tables=tables,
        data={
            "cut_off": recording.cut_off,
            "scenario": recording.scenario,
            "states": states,
            "limits": limits,
            "events": events,
        },
    )


def _what_ran(recording: Recording) -> str:
    ran = "The bag does not say how the nodes were started, limits and bounds are the defaults"
    if recording.scenario:
        method = recording.scenario.get("fvs_estimator_node", {}).get("method", "unknown")
        ran = f"fvs_ros {recording.version}, law {recording.started()['law']}, method {method}"
    count = sum(map(len, recording.topics.values()))
    length_s = recording.end_s - recording.start_s
    return f"{ran}: {length_s:.1f} s, {count} messages of {len(recording.topics)} topics."


def _how_targets_went(recording: Recording, found: Sequence[Target]) -> str:
    """How many targets settled, and how fast."""
    if not found:
        return "There is no target with a ball position after it in the bag."
    times_s = [one.numbers["settling_5mm_s"] for one in found if not one.moving]
    settled_s = [one for one in times_s if one is not None and np.isfinite(one)]
    bound_mm = 1e3 * BOUNDS_M[0]
    words = f"{len(settled_s)} of {len(times_s)} targets settled within {bound_mm:g} mm"
    if settled_s:
        words += f", after {np.median(settled_s):.2f} s (median), {max(settled_s):.2f} s (longest)"
    unknown = sum("settling_5mm_s" in one.not_known for one in found)
    words += f"; {unknown} not known" if unknown else ""
    moving = len(found) - len(times_s)
    return words + (f"; {moving} moved." if moving else ".")


def _why_stopped(recording: Recording) -> str:
    """How often, for how long and why the controller held the arm."""
    if not recording.statuses:
        return "The controller’s status is not in the bag."
    states = [one for one in story.states(recording) if one.reason != story.SHUT_DOWN]
    stopped = [one for one in states if one.state in _STOPPED]
    reasons = [
        f"{' '.join(which).strip()} {count}×, {total_s:.1f} s"
        for which, count, total_s in story.totals(stopped, "state", "reason")
    ]
    return f"Held: {'; '.join(reasons)}." if reasons else "The controller never held the arm."


def _what_is_missing(recording: Recording, found: Sequence[Target]) -> list[str]:
    """What the bag lacks at its ends, a paragraph each."""
    words = []
    if recording.cut_off:
        words.append(
            "The bag was cut off: its recorder was killed, or it was not copied completely. The "
            "end of the run is missing, with the arm’s coming to rest."
        )
    commands = recording.series.get("commands")
    if commands is not None and commands.values[0].any():
        words.append("The beginning is missing: the first command in the bag moves the arm.")
    if found and "start_distance_m" in found[0].not_known:
        words.append(
            f"The first ball position came {found[0].time_s[0]:.2f} s after the first target, "
            "whose start distance is therefore not known."
        )
    return words


# --- targets ---


def _targets(recording: Recording, found: Sequence[Target], folder: Path) -> Report:
    ball = judged_by(recording)
    if ball is None:
        setup = ["Neither the true nor the measured position of the ball is in the bag."]
    elif "true_ball" in recording.series:
        setup = [f"Judged by the ball’s true position, {ball.topic}, as the demo judges."]
    else:
        setup = [f"Judged by the measured position, {ball.topic}, whose noise lengthens the path."]
    drawn = []
    if found:
        panel = figures.errors(found, [0.0] * len(found), BOUNDS_M)
        figures.panels(folder / "errors.png", [panel], "time since the target was given, s")
        figures.paths(found, folder / "paths.png")
        drawn = [
            Figure("errors.png", "Distance of the ball to each target since it was given."),
            Figure("paths.png", "The ball’s paths from their starts (dots) to the targets (+)."),
        ]
    coarse, fine = (f"to {1e3 * one:g} mm" for one in BOUNDS_M)
    columns = {
        "start": ("start_distance_m", 1e3, "{:.0f} mm"),
        coarse: ("settling_5mm_s", 1.0, "{:.2f} s"),
        fine: ("settling_2mm_s", 1.0, "{:.2f} s"),
        "final rms": ("final_rms_m", 1e3, "{:.2f} mm"),
        "path": ("path_m", 1e3, "{:.0f} mm"),
        "peak joint speed": ("peak_joint_speed_rad_s", 1.0, "{:.2f} rad/s"),
        "jitter": ("jitter_rad_s", 1e3, "{:.2f} mrad/s"),
    }
    records = [
        {
            "target": f"{number}, moving" if one.moving else str(number),
            **{title: _cell(one, *column) for title, column in columns.items()},
        }
        for number, one in enumerate(found, start=1)
    ]
    data = [
        {
            "target_m": one.target_m,
            "given_s": one.given_s - recording.start_s,
            "moving": one.moving,
            **one.numbers,
            "not_known": one.not_known,
        }
        for one in found
    ]
    return Report(
        name="targets",
        title="Targets",
        question="How soon was the ball at each target, how near, and on which path?",
        setup=setup,
        figures=drawn,
        tables=_table(
            "Final error and jitter of the command are rms over the last second; of a moving "
            "target, the error of all its time. Not known is what the record is too short for.",
            {title: f"{{{title}}}" for title in ("target", *columns)},
            records,
        ),
        data={"judged_by": None if ball is None else ball.topic, "targets": data},
    )


def _cell(target: Target, name: str, factor: float, words: str) -> str:
    value = target.numbers[name]
    if name in target.not_known:
        return "not known"
    return "never" if value is None else words.format(factor * value)


# --- timing and predictions ---


def _timing(recording: Recording, _: Sequence[Target], folder: Path) -> Report:
    series, found, setup = recording.series, story.rhythms(recording), []
    if {"ball", "commands"} <= series.keys():
        latency_s = story.command_latencies(series["ball"], series["commands"])[1]
        if latency_s.size:
            median_ms, late_ms = np.percentile(1e3 * latency_s, [50, 99])
            setup.append(
                "From an image’s exposure to the first command after its ball position: "
                f"{median_ms:.0f} ms (median), {late_ms:.0f} ms (99 %)."
            )
    figures.ages(recording, folder / "ages.png")
    return Report(
        name="timing",
        title="Timing",
        question="Did everything come in time, and how old was it?",
        setup=setup,
        figures=[
            Figure(
                "ages.png",
                "Above: age of images and joint states at their arrival, and at the first command "
                "after an image. Below: time between messages of the controller’s inputs.",
            )
        ],
        tables=_table(
            "Every topic. Jitter is the standard deviation of the intervals; age is the time from "
            "a message’s stamp to its arrival at the recorder.",
            {
                "topic": "{topic}",
                "messages": "{count}",
                "rate, Hz": "{rate_hz:.1f}",
                "jitter, ms": "{jitter_ms:.3g}",
                "longest gap, ms": "{longest_gap_ms:.3g}",
                "age, median, ms": "{median_age_ms:.3g}",
                "age, 99 %, ms": "{p99_age_ms:.3g}",
            },
            found,
        ),
        data={"topics": found},
    )


def _steps(recording: Recording, _: Sequence[Target], folder: Path) -> Report:
    found = prediction(recording)
    setup, drawn = ["There is no Jacobian in the bag, or the arm did not move."], []
    if found is not None:
        motion = "true motion" if found.true else "measured motion, with its noise"
        setup = [
            f"{len(found.time_s)} steps between images, judged by the ball’s {motion}, each with "
            "the Jacobian from before its end. T1 is the error of one prediction, T2 that of their "
            "sum."
        ]
        figures.predictions(found, folder / "predictions.png")
        drawn = [Figure("predictions.png", "Motion of the ball, T1 and T2 in each step.")]
        t1_mm, t2_mm = 1e3 * found.t1_m, 1e3 * found.t2_m
        setup.append(
            f"T1 is {t1_mm.mean():.2f} mm on average, {found.share:.1%} of the motion. "
            f"T2 is {t2_mm[-1]:.1f} mm at the end, {t2_mm.max():.1f} mm at most."
        )
    return Report(
        name="prediction",
        title="Predictions",
        question="How well did the Jacobian predict the ball? (Section 4.1 of the paper.)",
        setup=setup,
        figures=drawn,
        data=asdict(found) if found else {},
    )
