"""The page of a recording, section by section: what happened, targets, timing, predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from fvs_lab.replay import estimates, figures, runs, timing
from fvs_lab.replay.data import Recording
from fvs_lab.replay.happened import HAPPENED, happened
from fvs_lab.replay.runs import Target
from fvs_lab.report import Figure, Report, Table

TARGETS, TIMING, PREDICTION = "targets", "timing", "prediction"
NAMES = (HAPPENED, TARGETS, TIMING, PREDICTION)
_FINE_M = 0.002


def sections(recording: Recording, out: Path) -> list[Report]:
    """Judge a recording, and draw it into folders below ``out``."""
    for name in NAMES:
        (out / name).mkdir(parents=True, exist_ok=True)
    targets = runs.targets(recording)
    return [
        happened(recording, targets, bounds_m(recording), out / HAPPENED),
        _targets(recording, targets, out / TARGETS),
        _timing(recording, out / TIMING),
        _prediction(recording, out / PREDICTION),
    ]


def bounds_m(recording: Recording) -> tuple[float, float]:
    """The two bounds of settling, m."""
    return runs.settle_error_m(recording), _FINE_M


# --- targets ---


def _targets(recording: Recording, targets: Sequence[Target], folder: Path) -> Report:
    ball = runs.judged_by(recording)
    bounds = bounds_m(recording)
    if ball is None:
        setup = "Neither the true nor the measured position of the ball is in the bag."
    elif not targets:
        setup = f"No target with a position of the ball after it ({ball.topic}) is in the bag."
    elif "true_ball" in recording.series:
        setup = f"Judged by the ball’s true position, {ball.topic}, as the demo judges."
    else:
        setup = (
            f"Judged by the measured position, {ball.topic}, with its noise, which makes the path "
            "longer: the true one is not in the bag."
        )
    return Report(
        name=TARGETS,
        title="Targets",
        question="How soon was the ball at each target, how near, and on which way?",
        setup=[setup, *_not_known(targets)],
        figures=[
            Figure(
                figures.errors(targets, bounds, folder),
                "Distance of the ball to each target since it was given.",
            ),
            Figure(
                figures.paths(targets, folder),
                "The ball’s way to each target, in the camera’s frame.",
            ),
        ]
        if targets
        else [],
        tables=[targets_table(targets, bounds)] if targets else [],
        data={
            "judged_by": None if ball is None else ball.topic,
            "targets": [
                {
                    "target_m": one.record.target_m,
                    "given_s": one.record.start_s - recording.start_s,
                    "moving": one.moving,
                    "begins_late": one.begins_late,
                    **asdict(one.score),
                    "path_m": one.path_m,
                    "jitter_rad_s": one.jitter_rad_s,
                    "rms_m": one.rms_m,
                    "not_known": one.not_known,
                }
                for one in targets
            ],
        },
    )


def _not_known(targets: Sequence[Target]) -> list[str]:
    """Why some numbers are not given, a paragraph for each target that ended too early."""
    return [
        f"Of target {one.number} not all is known: {cut} before the ball was below the bounds for "
        "a second."
        for one in targets
        for cut in dict.fromkeys(one.not_known.values())
    ]


def targets_table(targets: Sequence[Target], bounds: Sequence[float]) -> Table:
    """The targets as rows; of a target that moved, the error all along."""

    def settled(target: Target, name: str) -> str:
        if target.moving:
            return ""
        time_s = getattr(target.score, name)
        return known(target, name, "never" if time_s is None else f"{time_s:.2f} s")

    def known(target: Target, name: str, text: str) -> str:
        return "not known" if name in target.not_known else text

    return Table(
        "Jitter is the change of the command from tick to tick over the last second, rms, of the "
        "worst joint; the final error is over that second, rms. Of a target that moved, the error "
        "is that of all its time.",
        [
            "target",
            "start",
            *(f"to {1e3 * bound:g} mm" for bound in bounds),
            "final rms",
            "path",
            "peak joint speed",
            "jitter",
        ],
        [
            [
                f"{one.number}{', moving' if one.moving else ''}",
                "unknown" if one.begins_late else f"{1e3 * one.score.start_distance_m:.0f} mm",
                settled(one, "settling_5mm_s"),
                settled(one, "settling_2mm_s"),
                f"{1e3 * one.rms_m:.2f} mm"
                if one.moving
                else known(one, "final_rms_m", f"{1e3 * one.score.final_rms_m:.2f} mm"),
                f"{1e3 * one.path_m:.0f} mm",
                _unless_unknown(one.score.peak_joint_speed_rad_s, "{:.2f} rad/s"),
                known(
                    one, "jitter_rad_s", _unless_unknown(1e3 * one.jitter_rad_s, "{:.2f} mrad/s")
                ),
            ]
            for one in targets
        ],
    )


# --- timing ---


def _timing(recording: Recording, folder: Path) -> Report:
    found = timing.rhythms(recording)
    setup = []
    series = recording.series
    if {"ball", "commands"} <= series.keys():
        _, latency_s = timing.command_latencies_s(series["ball"], series["commands"])
        if latency_s.size:
            setup.append(
                "From an image’s exposure to the first command after its ball position came: "
                f"{_ms(np.median(latency_s))} (median), {_ms(np.percentile(latency_s, 99))} (99 %)."
            )
    return Report(
        name=TIMING,
        title="Timing",
        question="Did everything come in time, and how old was it?",
        setup=[
            *setup,
            *_clocks(recording),
            "Arrival is when the recorder received a message, age the time from its stamp to then.",
        ],
        figures=[
            Figure(
                figures.ages(recording, folder),
                "Above: how old images and joint states were when they came, and when the first "
                "command after them did. Below: time between messages of the controller’s inputs.",
            )
        ],
        tables=[
            Table(
                "Every topic. Jitter is the standard deviation of the intervals.",
                ["topic", "messages", "rate", "jitter", "longest gap", "age, median", "age, 99 %"],
                [
                    [
                        one.topic,
                        str(one.count),
                        f"{one.rate_hz:.1f} Hz",
                        _ms(one.jitter_s),
                        _ms(one.longest_s),
                        _ms(one.age_s),
                        _ms(one.worst_age_s),
                    ]
                    for one in found
                ],
            )
        ],
        data={"topics": [asdict(one) for one in found]},
    )


# --- predictions ---


def _prediction(recording: Recording, folder: Path) -> Report:
    found = estimates.prediction(recording)
    clocks = _clocks(recording)
    question = "How well did the Jacobian predict the ball? (Section 4.1 of the paper.)"
    if found is None:
        return Report(
            name=PREDICTION,
            title="Predictions",
            question=question,
            setup=["There is no Jacobian in the bag, or the arm did not move.", *clocks],
        )
    motion = "true motion" if found.true else "measured motion, with its noise"
    return Report(
        name=PREDICTION,
        title="Predictions",
        question=question,
        setup=[
            f"{found.time_s.size} steps between images, judged by the ball’s {motion}, each with "
            "the Jacobian that came before its end. T1 is the error of one prediction, T2 that of "
            "all of them summed up.",
            *clocks,
        ],
        figures=[
            Figure(
                figures.estimates(found, recording, folder),
                "Above: how far the ball moved in each step, and how far the prediction was off. "
                "Below: how far one would be off by predictions alone.",
            )
        ],
        tables=[
            Table(
                "The paper’s criteria.",
                ["T1, mean", "T1, share of the motion", "T2 at the end", "T2 at most"],
                [
                    [
                        f"{1e3 * found.t1_m.mean():.2f} mm",
                        f"{100 * found.share:.1f} %",
                        f"{1e3 * found.t2_m[-1]:.1f} mm",
                        f"{1e3 * found.t2_m.max():.1f} mm",
                    ]
                ],
            )
        ],
        data=asdict(found),
    )


def _clocks(recording: Recording) -> list[str]:
    """A paragraph where stamps and arrivals are of different clocks."""
    return list(filter(None, [timing.other_clocks(recording)]))


def _ms(value_s: float) -> str:
    return _unless_unknown(1e3 * value_s, "{:.3g} ms")


def _unless_unknown(value: float, words: str) -> str:
    return "" if np.isnan(value) else words.format(value)
