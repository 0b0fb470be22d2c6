"""Which estimator knows the Jacobian best along a smooth motion: section 4.1 of the paper.

Here is the page's section. What it tells is measured in ``estimators_study``, with those in
``estimators_contestants`` on the motions in ``estimators_recordings``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fvs_estimator_node.rbf import RbfConfig
from fvs_lab import estimators_figures
from fvs_lab.context import Context
from fvs_lab.estimators_contestants import (
    CONTESTANTS,
    FAST_N1,
    FAST_PROCESS_NOISE,
    GRIDS,
    IGNORANCE_M_RAD,
)
from fvs_lab.estimators_recordings import FIRST_S, SPEED_RAD_S, WIGGLE_S
from fvs_lab.estimators_study import (
    BIN_S,
    CLEAN,
    DRAWN,
    DRAWN_TURN,
    NOISE,
    TUNING_SEEDS,
    Study,
    World,
    millimetres,
    study,
)
from fvs_lab.estimators_verdicts import verdicts
from fvs_lab.report import Figure, Report, Table
from fvs_lab.statistics import median

NAME = "estimators"


def run(context: Context) -> Report:
    """Compare the estimators along smooth motion, and report."""
    return report_of(context, study(context))


def report_of(context: Context, found: Study) -> Report:
    """Draw, tabulate and judge what was measured."""
    return Report(
        name=NAME,
        title="Who knows the Jacobian?",
        question="A control law is only as good as the 3x6 Jacobian it is given. Along a smooth "
        "motion that nobody controls, which estimator predicts the ball best: without noise, with "
        "noise, and when the camera has been moved since the networks were trained? (Section 4.1 "
        "of the paper, its figures 6 and 7.)",
        setup=_setup(context, found),
        figures=_figures(found, context.folder(NAME)),
        tables=[*(_world_table(found, world) for world in found.worlds), *_tuning_tables(found)],
        verdicts=verdicts(found),
        data=_data(found),
    )


# ---- words and pictures ---------------------------------------------------------------------


def _setup(context: Context, found: Study) -> list[str]:
    noise, clean = found.judged[NOISE.name], found.judged[CLEAN.name]
    paths = f"{len(found.seeds)} random path{'s' if len(found.seeds) > 1 else ''}"
    eyes = "rendered depth images" if context.rendered else "the simulator (exact camera)"
    depth = ", and the depth camera’s own" if context.rendered else ""
    noisy, exact = (
        millimetres(float(np.median([one.position_error_rms_m for one in each])))
        for each in (noise, clean)
    )
    step = millimetres(float(np.median([one.median_step_m for one in noise])))
    visible = min(one.visible_share for results in found.judged.values() for one in results)
    return [
        f"The simulated arm moves for {found.duration_s:g} s inside the box that the networks were "
        f"trained in, its fastest joint at about {SPEED_RAD_S:g} rad/s, on {paths}. Each path is "
        "recorded once in each condition, and all estimators hear that same recording. Ball "
        f"positions come from {eyes}; their error is {noisy} rms with noise (1 mm on each "
        f"coordinate{depth}) and {exact} without. The ball was seen in at least "
        f"{100 * visible:.0f} % of the images.",
        f"At each step between two images (the ball moves by {step}, median) an estimator is asked "
        "for its Jacobian J and judged, and only then told what happened. T1 is the length of "
        "dx - J dr with the true ball motion dx: the error of one prediction. T2 is the length of "
        "the sum of these errors since the motion began: how far one would be off by dead "
        "reckoning. It can shrink by luck on a winding path, so verdicts take its largest value. "
        "(The paper prints s for the feature x in (40) to (42), and does not say whether J has "
        "seen the step already; if it had, any estimator could score zero.)",
        "Compared are the proposed networks, which go on learning with the gain n1; the same "
        "networks frozen; the linear and the unscented Kalman filter (LKF, UKF), recursive least "
        "squares (RLS) and Broyden’s rule. The paper sets n1 to zero here, as there is no target. "
        "With s = 0 that leaves (17) no learning term, and so the frozen networks; what has to "
        "vanish without a target is the term with s, and n1 stays.",
        f"Starts. “Explored”: before the scored motion each joint is wiggled in turn for "
        f"{WIGGLE_S:g} s, and the estimator hears it, from a zero Jacobian that knows it is "
        f"ignorant (standard deviation {IGNORANCE_M_RAD:g} m/rad); the learning networks hear it, "
        "too. “Networks’ start”: the trained networks’ Jacobian at the first joints, no wiggling. "
        "“From zero”: neither.",
        "The camera is rotated by carrying it round the scene, about a random axis for each path: "
        "it still sees the ball, but all that it reports is turned. (Merely shifting it would not "
        "change the Jacobian.)",
        f"Every method’s one free number is the best of {len(GRIDS['rbf'].values)} values by the "
        f"median of T1 over {len(TUNING_SEEDS)} other paths, with 1 mm noise and an exact camera "
        "that was not rotated. Not tuned are the networks with n1 = "
        f"{RbfConfig.n1:g} (the default) and {FAST_N1:g}, and the LKF with a process noise of "
        f"{FAST_PROCESS_NOISE:g}, which is there for the condition without noise only."
        if found.tuning
        else "Nothing was tuned in this quick run: all parameters are the nodes’ own.",
    ]


def _figures(found: Study, folder: Path) -> list[Figure]:
    at = found.text
    points = f"each point a mean over {BIN_S:g} s, median of all paths; lower is better"
    return [
        Figure(
            estimators_figures.against_time(found, "t1_m", folder),
            f"Answers figure 6: T1 against time ({points}). With noise (middle), the networks err "
            f"by {at(NOISE, 'frozen', 't1_m')} a step when frozen and by "
            f"{at(NOISE, 'rbf', 't1_m')} when they go on learning, the LKF by "
            f"{at(NOISE, 'lkf_explored', 't1_m')}. After a rotation of the camera (right) they err "
            f"by {at(DRAWN_TURN, 'frozen', 't1_m')} frozen and by {at(DRAWN_TURN, 'rbf', 't1_m')} "
            "learning. The LKF lies on the broad line of the UKF. The true Jacobian would score "
            f"{at(NOISE, 'oracle', 't1_m')}.",
        ),
        Figure(
            estimators_figures.against_time(found, "t2_m", folder),
            f"Answers figure 7: T2 against time ({points}). Random errors cancel in this sum; "
            "those of a Jacobian that is always a little behind the arm add up. With noise, T2 is "
            f"at most {at(NOISE, 'lkf_explored', 't2_max_m')} for the LKF and "
            f"{at(NOISE, 'rbf', 't2_max_m')} for the proposed estimator; with the camera rotated, "
            f"{at(DRAWN_TURN, 'lkf_explored', 't2_max_m')} and "
            f"{at(DRAWN_TURN, 'rbf', 't2_max_m')} ({at(DRAWN_TURN, 'rbf_fast', 't2_max_m')} with "
            f"n1 = {FAST_N1:g}).",
        ),
        Figure(
            estimators_figures.against_angle(found, folder),
            "Not in the paper: T1 (left) and the error of the whole Jacobian (right) against the "
            "angle by which the camera was rotated after training; 1 mm noise, median and 95 % "
            "interval over the paths. An estimator can have a small T1 and a bad Jacobian, if it "
            "knows the direction of the present motion only; a control law that wants to go "
            "elsewhere needs all of it.",
        ),
    ]


# ---- tables ---------------------------------------------------------------------------------

#: Header, criterion, factor and digits.
_COLUMNS = (
    ("T1, mm", "t1_m", 1e3, 3),
    ("T1, % of motion", "t1_share", 1e2, 1),
    (f"T1 in the first {FIRST_S:g} s, mm", "t1_first_m", 1e3, 2),
    ("T2 at the end, mm", "t2_final_m", 1e3, 1),
    ("T2 at most, mm", "t2_max_m", 1e3, 1),
    ("Jacobian error, %", "jacobian_error", 1e2, 1),
)


def _world_table(found: Study, world: World) -> Table:
    return Table(
        f"{world.label[0].upper()}{world.label[1:]}: median over {len(found.seeds)} paths "
        "(95 % interval), best T1 first. Jacobian error: Frobenius norm, relative.",
        ["estimator", *(title for title, *_ in _COLUMNS)],
        [
            [
                one.label,
                *(
                    median(
                        [factor * value for value in found.values(world, one.name, criterion)]
                    ).text(digits)
                    for _, criterion, factor, digits in _COLUMNS
                ),
            ]
            for one in found.ranking(world, "t1_m")
        ],
    )


def _tuning_tables(found: Study) -> list[Table]:
    if not found.tuning:
        return []
    caption = (
        "Tuning: each value tried, with its T1 in mm (median over the tuning paths). A UKF takes "
        "the LKF’s value, the LKF from zero that of the explored one."
    )
    if found.tuning["rbf_tuned"]["chosen"] == GRIDS["rbf"].values[0]:
        caption += (
            " For the networks the slowest update on offer is the best one in the world they were "
            "trained in; it leaves them nearly frozen when the camera is rotated."
        )
    rows = []
    for name, one in found.tuning.items():
        tried = (
            f"{value:g}: {1e3 * t1_m:.3g}"
            for value, t1_m in zip(one["values"], one["t1_m"], strict=True)
        )
        label = CONTESTANTS[name].label
        rows.append([label, one["parameter"], f"{one['chosen']:g}", ", ".join(tried)])
    return [Table(caption, ["estimator", "parameter", "chosen", "tried"], rows)]


# ---- data -----------------------------------------------------------------------------------


def _data(found: Study) -> dict[str, Any]:
    return {
        "seeds": found.seeds,
        "tuning_seeds": TUNING_SEEDS if found.tuning else (),
        "duration_s": found.duration_s,
        "speed_rad_s": SPEED_RAD_S,
        "tuning": found.tuning,
        "contestants": {
            one.name: {
                name: getattr(one, name) for name in ("label", "method", "values", "hears_prelude")
            }
            for one in found.contestants
        },
        "worlds": {
            world.name: {
                "label": world.label,
                "turn_deg": world.turn_deg,
                "recordings": [
                    {
                        name: getattr(one, name)
                        for name in (
                            "steps",
                            "median_step_m",
                            "visible_share",
                            "position_error_rms_m",
                            "ukf_difference_m_rad",
                        )
                    }
                    for one in found.judged[world.name]
                ],
                "results": {
                    one.name: [each.summaries[one.name] for each in found.judged[world.name]]
                    for one in found.contestants
                },
            }
            for world in found.worlds
        },
        "curves": {
            "time_s": found.curve_time_s,
            **{
                world.name: {
                    name: {
                        criterion: found.curve(world, name, criterion)
                        for criterion in ("t1_m", "t2_m")
                    }
                    for name in estimators_figures.LINES
                }
                for world in DRAWN
            },
        },
    }
