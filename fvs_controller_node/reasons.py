"""Every state of the controller and every reason for one, in words for the person beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


class State(Enum):
    """What the supervisor is doing."""

    WAITING = "WAITING"  #: zeros; something that a start needs is missing
    READY = "READY"  #: zeros; a start would be accepted
    SERVOING = "SERVOING"  #: the law moves the arm
    HOLDING = "HOLDING"  #: started, but held still
    FAULT = "FAULT"  #: zeros at once: something was wrong that must never be


class Stop(Enum):
    """How the arm comes to rest."""

    NONE = "goes on"
    RAMP = "ramps to zero within the acceleration limit"
    AT_ONCE = "zeros at once"


class Reason(Enum):
    """Why the controller is in its state: state once started, stop, whether it needs a start.

    Before a start, a reason that is not READY shows as WAITING. ``needs_start`` ends the
    session: nothing moves again until ``~/start``.
    """

    SERVOING = (State.SERVOING, Stop.NONE, False, "servoing, {error_mm:.1f} mm to go")
    SETTLED = (State.SERVOING, Stop.NONE, False, "on target, {error_mm:.1f} mm off")
    READY = (State.READY, Stop.RAMP, False, "ready; call ~/start to move")

    MISSING = (
        State.HOLDING,
        Stop.RAMP,
        False,
        "no {name} yet ({count} of {wanted} messages); {hint}",
    )
    NO_TARGET = (
        State.HOLDING,
        Stop.RAMP,
        False,
        "no target_position yet; publish one, or call ~/set_current_as_target",
    )
    STALE = (
        State.HOLDING,
        Stop.RAMP,
        False,
        "{name} is {age_s:.2f} s old ({limit} is {limit_s:.2f} s); {hint}",
    )
    RETURNING = (
        State.HOLDING,
        Stop.RAMP,
        False,
        "{name} is coming back: {count} of {wanted} fresh messages",
    )
    BAD_INPUT = (
        State.FAULT,
        Stop.AT_ONCE,
        False,
        "{name} is not usable: {why}; {count} of {wanted} good ones since",
    )
    NO_POSITION = (
        State.HOLDING,
        Stop.RAMP,
        False,
        "the ball's position now is unknown: {why}",
    )
    NEAR_SINGULAR = (
        State.HOLDING,
        Stop.RAMP,
        False,
        "the Jacobian is near singular: smallest singular value {value:.4f} m/rad, below "
        "{limit:.4f}; call ~/start to leave slowly for another target, or the estimator's ~/reset",
    )
    PREDICTION_ERROR = (
        State.HOLDING,
        Stop.RAMP,
        True,
        "the Jacobian predicts motion badly: error ratio {value:.2f}, above {limit:.2f} for "
        "{way_mm:.0f} mm; check camera and model, call the estimator's ~/reset, then ~/start",
    )
    ERROR_GROWING = (
        State.HOLDING,
        Stop.RAMP,
        True,
        "the error grew from {best_mm:.0f} to {error_mm:.0f} mm and stayed up for "
        "{time_s:.1f} s: the Jacobian may be wrong (camera moved?) or the target out of reach; "
        "then call ~/start",
    )
    STALLED = (
        State.HOLDING,
        Stop.RAMP,
        True,
        "no progress for {time_s:.0f} s, {error_mm:.0f} mm from the target: it may be out of "
        "reach, a joint at the end of its range, or the Jacobian wrong there; choose another "
        "target, then call ~/start",
    )
    OSCILLATING = (
        State.HOLDING,
        Stop.RAMP,
        True,
        "the ball swings about its target, {way_m:.1f} m so far; check stamps (stamp_delay_s) and "
        "gains, then call ~/start",
    )
    NOT_FOLLOWING = (
        State.HOLDING,
        Stop.RAMP,
        True,
        "the arm does not follow: {joint} was to move {commanded_rad:.2f} rad and moved "
        "{moved_rad:.2f} rad; check that the velocity controller is active, the robot program runs "
        "and no protective stop is on, then call ~/start",
    )
    IMAGE_NOT_FOLLOWING = (
        State.HOLDING,
        Stop.RAMP,
        True,
        "the image does not follow the arm: {predicted_mm:.0f} mm predicted in {time_s:.1f} s, "
        "{seen_mm:.0f} mm seen; check camera, detector and stamp_delay_s, then call ~/start",
    )
    CONFLICT = (
        State.HOLDING,
        Stop.RAMP,
        True,
        "{name} commands the arm as well; stop it, then call ~/start",
    )
    HELD_LONG = (
        State.HOLDING,
        Stop.RAMP,
        True,
        "held for more than {limit_s:.0f} s; call ~/start to go on. What was said meanwhile: {why}",
    )
    PROGRAM_STOPPED = (
        State.HOLDING,
        Stop.AT_ONCE,
        True,
        "the robot program is not running; start it on the robot, then call ~/start",
    )
    SPEED_SCALING_ZERO = (
        State.HOLDING,
        Stop.AT_ONCE,
        True,
        "the robot's speed scaling is 0 %; raise the speed slider or end the protective stop, "
        "then call ~/start",
    )
    PAUSE_OVER = (
        State.HOLDING,
        Stop.AT_ONCE,
        True,
        "the robot was paused (program stopped, or speed scaling 0 %) and is back; "
        "call ~/start to go on",
    )
    LAW_FAULT = (
        State.FAULT,
        Stop.AT_ONCE,
        True,
        "the control law gave no usable command: {why}; check its gains, then call ~/start",
    )
    SHUT_DOWN = (State.HOLDING, Stop.AT_ONCE, True, "the controller is shutting down")

    def __init__(self, state: State, stop: Stop, needs_start: bool, text: str) -> None:
        self.state = state
        self.stop = stop
        self.needs_start = needs_start
        self.text = text

    def because(self, **numbers: object) -> Finding:
        """Give the numbers of the sentence."""
        return Finding(self, numbers)


@dataclass(frozen=True)
class Finding:
    """A reason and the numbers of its sentence.

    Parameters
    ----------
    reason : Reason
        Which row of the table.
    numbers : mapping
        What its sentence says, by name.
    """

    reason: Reason
    numbers: Mapping[str, object]

    @property
    def text(self) -> str:
        """The sentence, numbers filled in: only where somebody reads it, for ticks are many."""
        return self.reason.text.format(**self.numbers)
