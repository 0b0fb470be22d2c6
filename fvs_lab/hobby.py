"""An arm of hobby servos with its camera on the wrist: play that is learned, and calm at rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.hand import MOTION_S, Arm, learn, second_object
from fvs_lab.results import Results
from fvs_lab.trials import drive
from fvs_ros.interface import POSITION
from fvs_ros.kinds.ball import Ball

ROBOT, PLAY_DEG = "so101", 1.0
#: Servos that stop half as far short as their play is wide.
SHORT: dict[str, Any] = {
    "command_interface": POSITION,
    "stops_short_rad": float(np.radians(0.5 * PLAY_DEG)),
    "encoder_steps": 4096,
}
PLAYFUL = {**SHORT, "backlash_rad": float(np.radians(PLAY_DEG))}
#: The arm is to rest within this of its target, m; what the controller is asked for.
WITHIN_M, ASKED_M = 0.002, 0.0015
#: Time of a run, and of the rest that ends it, s.
RUN_S, REST_S = 10.0, 5.0
LEARNED, TOLD, UNKNOWN = "play learned", "play told exactly", "play unknown"
RESTING, PLAIN = "no play, rest_when_settled", "no play"


def to_rest(
    arm: Arm, setting: str, servos: Mapping[str, Any], values: Mapping[str, Any], number: int
) -> dict[str, Any]:
    """Servo to a ball elsewhere and stay there: the row."""
    simulation, case = second_object(arm, number)
    simulation.configure(replace(simulation.config, **servos))
    trial = arm.trial(case, setting=setting, learned=arm.error)
    trial = trial.changed(controller={"settled_error_m": ASKED_M, **values}, duration_s=RUN_S)
    row = drive(trial, simulation)
    series = row["series"]
    rests = series["time_s"] > RUN_S - REST_S
    command, error_m = series["command_rad_s"][rests], series["error_m"][rests]
    path_rad = np.cumsum(command, axis=0) / simulation.config.joint_state_rate_hz
    turns = [np.count_nonzero(np.diff(np.sign(joint[joint != 0.0]))) for joint in command.T]
    seen = {"time_s": series["time_s"][rests], "error_m": error_m, "path_rad": path_rad}
    return {
        **row,
        "held": not np.isfinite(row["jitter_rad_s"]),
        "most_m": float(error_m.max()),
        "swing_deg": float(np.degrees(np.ptp(path_rad, axis=0).max())),
        "turns_1_s": float(sum(turns)) / REST_S,
        "series": seen,
    }


# ---- the experiment -------------------------------------------------------------------------


def measure(context: lab.Context) -> Results:
    """Learn with and without play, and servo with play known, told and unknown."""
    duration_s = 15.0 if context.quick else MOTION_S
    minutes = [(ROBOT, Ball.name, duration_s, servos) for servos in (PLAYFUL, SHORT)]
    playful, firm = context.map(learn, minutes, "one ball")
    play_rad = np.full(len(firm.chain.axes), PLAYFUL["backlash_rad"])
    told = replace(firm, chain=replace(firm.chain, play_rad=play_rad))
    settings = [
        (playful, LEARNED, PLAYFUL, {}),
        (told, TOLD, PLAYFUL, {}),
        (firm, UNKNOWN, PLAYFUL, {}),
        (firm, RESTING, SHORT, {"rest_when_settled": True}),
        (firm, PLAIN, SHORT, {}),
    ]
    numbers = range(1, 1 + context.count(50))
    tasks = [(*setting, number) for setting in settings for number in numbers]
    return Results(context.map(to_rest, tasks, "another ball"))


def claims(runs: Results) -> Iterator[lab.Claim]:
    """Judge what is learned, where it rests, and how calmly."""
    ours = runs.where(setting=LEARNED)
    within = [most_m < WITHIN_M for most_m in ours.values("most_m")]
    yield lab.ours("within", lab.kept("runs", within, 1.0))
    calm = [turns_1_s == 0.0 for turns_1_s in ours.values("turns_1_s")]
    yield lab.ours("calm", lab.kept("runs", calm, 1.0))
    error = ours.values("learned")[0]
    yield lab.ours("learned", lab.Part("error", f"{1e2 * error:.2f} % (below 1 %)", error < 0.01))


_COLUMNS = ("learned:half", "settled:of", "to_5mm_s:half", "most_m:half", "most_m:largest")
TABLES = (
    lab.Table("rest", ("setting",), (*_COLUMNS, "swing_deg:largest", "turns_1_s", "held:of")),
)


def figures(runs: Results) -> Iterator[lab.Drawn]:
    """Distance and commands at rest, a line per run."""
    figure, axes = draw.grid(2, 4, (14.0, 5.0), sharex=True, sharey="row")
    for (above, below), setting in zip(axes.T, (UNKNOWN, LEARNED, PLAIN, RESTING), strict=True):
        for row in runs.where(setting=setting):
            series = row["series"]
            path_deg = np.degrees(series["path_rad"])
            widest = np.ptp(path_deg, axis=0).argmax()
            above.plot(series["time_s"], 1e3 * series["error_m"], linewidth=0.7)
            below.plot(series["time_s"], path_deg[:, widest], linewidth=0.7)
        above.set_title(setting)
        below.set_xlabel("time since the target, s")
    axes[0, 0].set_ylabel("distance, mm")
    axes[1, 0].set_ylabel("command, °")
    yield "rest", figure, {}


EXPERIMENT = lab.Experiment("hobby", measure, claims, TABLES, globals(), figures, model="")
