"""What the page shows: frozen pictures of one moment, made from plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite, isnan, nan
from typing import Any

import numpy as np

from fvs_ros.apps.dashboard.placement import Pose
from fvs_ros.core.status import SILENT, number, vector

#: What each state is called, and its colour (Okabe and Ito's, which everybody can tell apart).
_TITLES = {
    "SERVOING": ("Moving to target", "#009E73"),
    "READY": ("Ready", "#0072B2"),
    "WAITING": ("Waiting", "#6B7280"),
    "HOLDING": ("Held", "#B87A00"),
    "FAULT": ("Fault", "#D55E00"),
    SILENT: ("No controller", "#6B7280"),
}
_YES_NO = {"true": True, "false": False}
_ON_TARGET = ("On target", "#009E73")


@dataclass(frozen=True)
class ControllerView:
    """The controller's last word.

    Parameters
    ----------
    state, reason : str
        Names; the state is ``SILENT`` while there is no word.
    sentence : str
        The reason in words.
    settled : bool
        Whether the ball stays at the target.
    error_m : float
        Distance to the target, m, NaN while unknown.
    target_m, position_m : ndarray, shape (3,), or None
        Target and predicted ball, camera frame, m.
    exponents : ndarray, shape (3,), or None
        The law's exponents.
    prediction_error_ratio : float
        One-step prediction error, over that of predicting rest.
    ages_s : mapping of str to float
        Ages of the inputs, s, NaN while unknown.
    active_limit : str
        The limit that holds the command back, or empty.
    program_running : bool or None
        Whether the robot obeys; None while unknown.
    speed_scaling_percent : float
        The robot's speed slider.
    image_latency_s, drive_lag_s : float
        From exposure to use, and of the arm behind its commands, as measured, s; NaN while unknown.
    """

    state: str = SILENT
    reason: str = ""
    sentence: str = "no word from the controller; is fvs_controller_node running?"
    settled: bool = False
    error_m: float = nan
    target_m: np.ndarray | None = None
    position_m: np.ndarray | None = None
    exponents: np.ndarray | None = None
    prediction_error_ratio: float = nan
    ages_s: Mapping[str, float] = field(default_factory=dict)
    active_limit: str = ""
    program_running: bool | None = None
    speed_scaling_percent: float = nan
    image_latency_s: float = nan
    drive_lag_s: float = nan

    @staticmethod
    def of(values: Mapping[str, str], sentence: str) -> ControllerView:
        """Read the key numbers of a status."""
        ages = {name: number(values, f"{name}_age_s") for name in _INPUTS}
        return ControllerView(
            state=values.get("state", SILENT),
            reason=values.get("reason", ""),
            sentence=sentence,
            settled=values.get("settled") == "true",
            error_m=number(values, "error_m"),
            target_m=vector(values, "target_{}_m"),
            position_m=vector(values, "position_{}_m"),
            exponents=vector(values, "exponent_{}"),
            prediction_error_ratio=number(values, "prediction_error_ratio"),
            ages_s=ages,
            active_limit=values.get("active_limit", ""),
            program_running=_YES_NO.get(values.get("robot_program_running", "")),
            speed_scaling_percent=number(values, "speed_scaling_percent"),
            image_latency_s=number(values, "image_latency_s"),
            drive_lag_s=number(values, "drive_lag_s"),
        )

    @property
    def silent(self) -> bool:
        """Whether there is no word from it."""
        return self.state == SILENT

    @property
    def error_xyz_m(self) -> np.ndarray | None:
        """Target minus ball, m, camera frame, shape (3,)."""
        if self.target_m is None or self.position_m is None:
            return None
        return self.target_m - self.position_m

    @property
    def goes_to_targets(self) -> bool:
        """Whether a target sent now would be gone to."""
        return self.state == "SERVOING" or self.reason == "NO_TARGET"


@dataclass(frozen=True)
class Banner:
    """The state at a glance: title, colour, sentence, and how far it is, in words."""

    title: str
    colour: str
    state: str
    sentence: str
    error: str


def banner_of(controller: ControllerView) -> Banner:
    """The banner of a controller."""
    title, colour = _TITLES.get(controller.state, (controller.state.capitalize(), "#6B7280"))
    if controller.state == "SERVOING" and controller.settled:
        title, colour = _ON_TARGET
    return Banner(
        title, colour, controller.state, controller.sentence, distance(controller.error_m)
    )


def distance(error_m: float) -> str:
    """A distance as text in mm, two figures below 10 mm."""
    if isnan(error_m):
        return "–"
    error_mm = 1e3 * error_m
    return f"{error_mm:.2f} mm" if error_mm < 10.0 else f"{error_mm:.0f} mm"


@dataclass(frozen=True)
class Lamp:
    """One thing that is well or not.

    Parameters
    ----------
    name : str
        What.
    good : bool or None
        Whether it is well; None while unknown.
    text : str
        How it is.
    """

    name: str
    good: bool | None
    text: str


#: Inputs of the controller, and what a person calls them.
_INPUTS = {
    "ball_position": "Ball seen",
    "joint_states": "Joint states",
    "jacobian": "Jacobian",
}


def lamps_of(
    controller: ControllerView, heard_s: Mapping[str, float], max_ages_s: Mapping[str, float]
) -> tuple[Lamp, ...]:
    """The lamps: the controller's inputs and the robot's program.

    Parameters
    ----------
    controller : ControllerView
        Its last word.
    heard_s : mapping of str to float
        Ages of what was heard here, s, for what the controller does not tell.
    max_ages_s : mapping of str to float
        Ages at which the controller calls its inputs stale, s, as far as they are known.
    """
    lamps = []
    for name, label in _INPUTS.items():
        age_s = controller.ages_s.get(name, nan)
        if not isfinite(age_s):
            age_s = heard_s.get(name, nan)
        if isfinite(age_s):
            text = f"{1e3 * age_s:.0f} ms ago" if age_s < 1.0 else f"{age_s:.0f} s ago"
        else:
            text = "unknown" if controller.silent else "never"
        limit_s = max_ages_s.get(name, nan)
        known = isfinite(limit_s) and not controller.silent
        lamps.append(Lamp(label, age_s <= limit_s if known else None, text))
    running, percent = controller.program_running, controller.speed_scaling_percent
    if running is None:
        lamps.append(Lamp("Robot program", None, "unknown"))
    elif not running:
        lamps.append(Lamp("Robot program", False, "stopped"))
    else:
        text = "runs" if isnan(percent) else f"runs, {percent:.0f} %"
        lamps.append(Lamp("Robot program", percent != 0.0, text))
    return tuple(lamps)


@dataclass(frozen=True)
class Detail:
    """One thing to look up when it does not go as it should: its name, and how it is."""

    name: str
    text: str


def details_of(controller: ControllerView, detector: str) -> tuple[Detail, ...]:
    """What the troubleshooting asks for; what is unknown is left out.

    Parameters
    ----------
    controller : ControllerView
        Its last word.
    detector : str
        The detector's sentence; empty where none runs.
    """
    times_s = {"Image latency": controller.image_latency_s, "Drive lag": controller.drive_lag_s}
    details = [
        Detail(name, f"{1e3 * time_s:.0f} ms")
        for name, time_s in times_s.items()
        if isfinite(time_s)
    ]
    if not controller.silent:  # stands there while there is none, too: it comes and goes often
        details.append(Detail("Active limit", controller.active_limit or "none"))
    if detector:
        details.append(Detail("Detector", detector))
    return tuple(details)


@dataclass(frozen=True)
class Curves:
    """Everything that is drawn over time, newest last.

    Parameters
    ----------
    error_mm : ndarray, shape (n, 5)
        Time (s, 0 is now), norm, and |x|, |y|, |z|, mm.
    speed_rad_s : ndarray, shape (n, 7)
        Time and six joint speeds, rad/s.
    ratio : ndarray, shape (n, 2)
        Time and one-step prediction error ratio.
    exponent : ndarray, shape (n, 4)
        Time and three exponents.
    """

    error_mm: np.ndarray
    speed_rad_s: np.ndarray
    ratio: np.ndarray
    exponent: np.ndarray


@dataclass(frozen=True)
class Snapshot:
    """One moment, complete.

    Parameters
    ----------
    banner : Banner
        The state at a glance.
    controller : ControllerView
        The controller's last word.
    lamps : tuple of Lamp
        What is well or not.
    details : tuple of Detail
        What the troubleshooting asks for.
    joints_rad : ndarray, shape (6,), or None
        Joint positions.
    camera : Pose or None
        The camera in the robot's base frame.
    table : bool
        Whether the simulator's table stands there.
    notes : tuple of str
        Sentences about the page itself: what it does not know, or waits for.
    ball_m : ndarray, shape (3,), or None
        The ball as last seen, camera frame, m; None if that is long ago.
    trail_m : ndarray, shape (n, 3)
        Where it was, oldest first.
    curves : Curves
        What is drawn over time.
    limit_rad_s : float
        The controller's joint speed limit; NaN while unknown.
    picture : ndarray, shape (height, width, 3), or None
        A new camera image with what was found drawn in, uint8; None if there is no new one.
    picture_old_s : int
        Its age where it is not of now, s; else 0.
    field_of_view : tuple of float
        The camera's vertical field of view, rad, and its image's width over height.
    answer : str
        What was last answered to a person's wish.
    tour : bool
        Whether the tour goes on.
    simulator : mapping of str to value, or None
        The simulator's disturbances by parameter; None without one.
    """

    banner: Banner
    controller: ControllerView
    lamps: tuple[Lamp, ...]
    details: tuple[Detail, ...]
    joints_rad: np.ndarray | None
    camera: Pose | None
    table: bool
    notes: tuple[str, ...]
    ball_m: np.ndarray | None
    trail_m: np.ndarray
    curves: Curves
    limit_rad_s: float
    picture: np.ndarray | None
    picture_old_s: int
    field_of_view: tuple[float, float]
    answer: str
    tour: bool
    simulator: Mapping[str, Any] | None
