"""Every state of the controller and every reason for one, with its text for the operator."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple


class State(Enum):
    """What the supervisor is doing."""

    WAITING = "WAITING"  #: zeros; something that a start needs is missing
    READY = "READY"  #: zeros; a start would be accepted
    SERVOING = "SERVOING"  #: the law moves the arm
    HOLDING = "HOLDING"  #: started, but held still
    FAULT = "FAULT"  #: zeros at once: an input or the law's command is invalid


class Stop(Enum):
    """How the arm comes to rest."""

    NONE = "continues"
    RAMP = "ramps to zero within the acceleration limit"
    AT_ONCE = "zeros at once"


def _holds(text: str, hint: str = "") -> tuple:
    """A reason that passes by itself."""
    return State.HOLDING, Stop.RAMP, False, text, hint


def _ends(text: str, hint: str = "", stop: Stop = Stop.RAMP) -> tuple:
    """A reason after which the arm needs a new start."""
    return State.HOLDING, stop, True, text, hint


class Reason(Enum):
    """Why the controller is in its state: state once started, stop, whether it needs a start.

    Before a start, a reason that is not READY shows as WAITING. ``needs_start`` ends the
    session: nothing moves again until ``~/start``.
    """

    SERVOING = (State.SERVOING, Stop.NONE, False, "servoing, {error} to go{remark}")
    SETTLED = (State.SERVOING, Stop.NONE, False, "on target, {error} off")
    READY = (State.READY, Stop.RAMP, False, "ready", "call ~/start to move")

    MISSING = _holds("no {name} yet ({count} of {wanted} messages)", "{hint}")
    NO_TARGET = _holds("no {name} yet", "call fvs_target, or ~/set_current_as_target")
    STALE = _holds("{name} is {age_s:.2f} s old ({limit} is {limit_s:.2f} s)", "{hint}")
    RETURNING = _holds("{name} resumes: {count} of {wanted} fresh messages")
    BAD_INPUT = (
        State.FAULT,
        Stop.AT_ONCE,
        False,
        "{name} is not usable: {why}; {count} of {wanted} good messages since",
    )
    NO_POSITION = _holds("the {what}'s position is unknown: {why}")
    NEAR_SINGULAR = _holds(
        "the Jacobian is near singular ({value:.4f} m/rad, limit {limit:.4f})",
        "call ~/start to move slowly to another target, or call the estimator's ~/reset",
    )
    PREDICTION_ERROR = _ends(
        "the Jacobian{of} predicts badly: error ratio {value:.2f} over {distance}",
        "check camera and model, call the estimator's ~/reset",
    )
    ERROR_GROWING = _ends(
        "the error has grown for {time_s:.1f} s: {best} to {error}{remark}",
        "check camera and model, or choose a reachable target",
    )
    STALLED = _ends(
        "no progress in {during}, {error} from the target{remark}",
        "choose a reachable target, or check joint limits and model",
    )
    OSCILLATING = _ends(
        "the {what} oscillates about its target: {distance} so far",
        "check stamp_delay_s and gains",
    )
    NOT_FOLLOWING = _ends(
        "{joint} does not follow: commanded {commanded:.2g} rad (m), moved {moved:.2g}",
        "check that its controller is active, the robot program runs and no protective stop is on",
    )
    IMAGE_NOT_FOLLOWING = _ends(
        "the image{of} does not follow the arm: {predicted} predicted in {time_s:.1f} s, "
        "{seen} measured",
        "check camera, detector and stamp_delay_s",
    )
    OBJECT_MOVED = _ends("the object moved by {moved} while it was hidden")
    OBJECT_RIDES = _ends(
        "the object moves with the tool, still {left} to go", "carry it to an absolute target"
    )
    CONFLICT = _ends("{name} commands the arm as well", "stop it")
    HELD_LONG = _ends("held for more than {limit_s:.0f} s: {why}")
    PROGRAM_STOPPED = _ends("the robot program stopped", "start it on the robot", Stop.AT_ONCE)
    SPEED_SCALING_ZERO = _ends(
        "the robot's speed scaling went to 0 %",
        "raise the speed slider or end the protective stop",
        Stop.AT_ONCE,
    )
    LAW_FAULT = (
        State.FAULT,
        Stop.AT_ONCE,
        True,
        "the control law gave an invalid command: {why}",
        "check its gains",
    )
    SHUT_DOWN = (State.HOLDING, Stop.AT_ONCE, False, "the controller is shutting down")

    def __init__(
        self, state: State, stop: Stop, needs_start: bool, text: str, hint: str = ""
    ) -> None:
        self.state = state
        self.stop = stop
        self.needs_start = needs_start
        start = "call ~/start to continue" if needs_start else ""
        self.text = f"{text}; {', then '.join(filter(None, (hint, start)))}".removesuffix("; ")

    def because(self, **numbers: object) -> Finding:
        """Give the numbers of the sentence."""
        return Finding(self, numbers)


class Finding(NamedTuple):
    """A reason and, by name, the numbers of its sentence."""

    reason: Reason
    numbers: Mapping[str, object]

    @property
    def text(self) -> str:
        """The sentence, formatted only when it is read, not at every tick."""
        return self.reason.text.format(**self.numbers)
