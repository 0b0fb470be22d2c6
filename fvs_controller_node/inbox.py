"""What came in: each message is checked once, each input watched for its age."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite

import numpy as np

from fvs_controller_node.inputs import InputMonitor, InputSpec
from fvs_controller_node.pseudo_inverse import Conditioning, conditioning
from fvs_controller_node.reasons import Finding, Reason
from fvs_controller_node.supervisor_config import SupervisorConfig

#: Inputs by topic name.
JOINT_STATES, BALL, JACOBIAN = "joint_states", "ball_position", "jacobian"
KINEMATIC_CHAIN, SPEED_SCALING = "kinematic_chain", "speed_scaling"

#: No joint position (rad), ball position (m) or Jacobian (m/rad) is larger than this.
_LARGEST = 100.0

#: Another node's command forbids motion for this time, s.
_CONFLICT_S = 1.0

#: Speed scaling from which the robot is at full speed, %: the driver multiplies doubles.
_FULL_PERCENT = 99.5


def _specs(config: SupervisorConfig) -> tuple[InputSpec, ...]:
    ages = (
        (JOINT_STATES, "joint_states_max_age_s", "is the robot driver (or simulator) running?"),
        (BALL, "ball_max_age_s", "is the ball in view, and the detector running?"),
        (JACOBIAN, "jacobian_max_age_s", "is the estimator running?"),
    )
    needed = (InputSpec(name, hint, getattr(config, age), age) for name, age, hint in ages)
    return (*needed, InputSpec(KINEMATIC_CHAIN, "", None), InputSpec(SPEED_SCALING, "", None))


class Inbox:
    """All inputs of the supervisor.

    Parameters
    ----------
    config : SupervisorConfig
        Ages, frame and sizes that are expected.
    end_session : callable
        Told why a session must end now: a pause of the robot, another node's command.

    Attributes
    ----------
    jacobian : ndarray, shape (m, n), or None
        The newest one, m/rad.
    conditioning : Conditioning or None
        Its singular values.
    """

    def __init__(self, config: SupervisorConfig, end_session: Callable[[Finding], None]) -> None:
        self._config, self._end_session = config, end_session
        self._monitors = {
            spec.name: InputMonitor(spec, config.fresh_samples) for spec in _specs(config)
        }
        self.jacobian: np.ndarray | None = None
        self.conditioning: Conditioning | None = None
        self._conflict: Finding | None = None  # with another node, and when it commanded last
        self._conflict_s = -inf
        self._program_running: bool | None = None  # never reported
        self._speed_scaling = 100.0

    def configure(self, config: SupervisorConfig) -> None:
        """Change what is expected while running."""
        self._config = config
        for spec in _specs(config):
            self._monitors[spec.name].configure(spec, config.fresh_samples)

    # ---- messages ---------------------------------------------------------------------------

    def add_joint_states(self, now_s: float, joints_rad: np.ndarray) -> bool:
        """Take joint positions in kinematic order; False if they cannot be used."""
        return self._check(now_s, JOINT_STATES, joints_rad, (len(self._config.joint_names),))

    def add_ball(self, now_s: float, position_m: np.ndarray, frame: str | None = None) -> bool:
        """Take a ball position (and its frame, to be checked); False if it cannot be used."""
        if frame is not None and frame != self._config.feature_frame:
            self.bad_input(now_s, BALL, self._config.wrong_frame(frame))
            return False
        return self._check(now_s, BALL, position_m, (self._config.features,))

    def add_jacobian(self, now_s: float, jacobian: np.ndarray) -> bool:
        """Take the estimated Jacobian, m/rad; False if it cannot be used."""
        shape = self._config.features, len(self._config.joint_names)
        if not self._check(now_s, JACOBIAN, jacobian, shape):
            return False
        self.jacobian = np.array(jacobian, dtype=float)
        self.conditioning = conditioning(self.jacobian)
        return True

    def add_chain(self, now_s: float) -> None:
        """Take note of a usable forward model."""
        self._monitors[KINEMATIC_CHAIN].good(now_s)

    def no_chain(self) -> None:
        """Take note that no forward model comes any more: no node misses it."""
        self._monitors[KINEMATIC_CHAIN].forget()

    def stuck(self, now_s: float, name: str) -> None:
        """Take note of a message on topic ``name`` whose stamp does not advance."""
        self._monitors[name].stuck(now_s)

    def bad_input(self, now_s: float, name: str, why: str) -> None:
        """Take note of a message on topic ``name`` that cannot be used, and why."""
        if name not in self._monitors:
            raise ValueError(f"unknown input {name!r}; known are {', '.join(self._monitors)}")
        self._monitors[name].bad(now_s, why)

    def estimator_says(self, now_s: float, why: str) -> None:
        """Take the estimator's words why it may publish no Jacobian; empty if all is well."""
        said = f"the estimator says: {why}" if why else ""
        self._monitors[JACOBIAN].source_says(now_s, said)

    def add_program_running(self, running: bool) -> None:
        """Take whether the robot's program runs."""
        self._program_running = bool(running)
        self._pause()

    def add_speed_scaling(self, now_s: float, percent: float) -> None:
        """Take the robot's speed scaling, 0 to 100 %."""
        if not isfinite(percent):
            self.bad_input(now_s, SPEED_SCALING, f"expected 0 to 100, got {percent}")
            return
        self._monitors[SPEED_SCALING].good(now_s)
        self._speed_scaling = float(percent)
        self._pause()

    def conflicting_command(self, now_s: float, name: str) -> None:
        """Take note that another node has just commanded the arm, too."""
        self._conflict, self._conflict_s = Reason.CONFLICT.because(name=name), now_s
        self._end_session(self._conflict)

    def _pause(self) -> None:
        for pause in self.pauses():
            self._end_session(pause)

    def _check(self, now_s: float, name: str, values: np.ndarray, shape: tuple[int, ...]) -> bool:
        values = np.asarray(values, dtype=float)
        wanted = " x ".join(str(n) for n in shape)
        if values.shape != shape:
            self.bad_input(now_s, name, f"expected {wanted} numbers, got shape {values.shape}")
            return False
        if not all(-_LARGEST <= value <= _LARGEST for value in values.ravel().tolist()):
            self.bad_input(
                now_s,
                name,
                f"expected {wanted} finite numbers up to {_LARGEST:g} in metres and radians, "
                f"got {values.tolist()}",
            )
            return False
        self._monitors[name].good(now_s)
        return True

    # ---- what they say ------------------------------------------------------------------------

    def find(self, now_s: float) -> Finding | None:
        """What is wrong with the inputs now, worst first."""
        findings = [monitor.find(now_s) for monitor in self._monitors.values()]
        troubles = [finding for finding in findings if finding is not None]
        bad = [finding for finding in troubles if finding.reason is Reason.BAD_INPUT]
        if self._conflict is not None and now_s - self._conflict_s < _CONFLICT_S:
            bad.append(self._conflict)
        return next(iter(bad + self.pauses() + troubles), None)

    def late(self, now_s: float) -> str | None:
        """What is wrong with a message's age or content now, in words; None when all are fresh."""
        findings = (monitor.find(now_s) for monitor in self._monitors.values())
        return next((finding.text for finding in findings if finding is not None), None)

    def pauses(self) -> list[Finding]:
        """What pauses the robot now."""
        stopped, slow = self._program_running is False, self._speed_scaling <= 0.0
        pauses = (Reason.PROGRAM_STOPPED, stopped), (Reason.SPEED_SCALING_ZERO, slow)
        return [pause.because() for pause, holds in pauses if holds]

    @property
    def full_speed(self) -> bool:
        """Whether the robot does what it is told at its full speed."""
        return self._program_running is not False and self._speed_scaling >= _FULL_PERCENT

    @property
    def speed_scaling(self) -> float:
        """Speed of the robot over what it is told, 0 to 1."""
        return min(self._speed_scaling, 100.0) / 100.0

    def status_values(self, now_s: float) -> dict[str, float | str]:
        """Ages and what the robot says, always the same keys in the same order."""
        ages = {
            f"{n}_age_s": self._monitors[n].age_s(now_s) for n in (JOINT_STATES, BALL, JACOBIAN)
        }
        running = {None: "unknown", False: "false", True: "true"}[self._program_running]
        return {
            **ages,
            "robot_program_running": running,
            "speed_scaling_percent": self._speed_scaling,
        }
