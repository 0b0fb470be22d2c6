"""``fvs_estimator_node``: joint states and ball positions in, Jacobian and chain out."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool, Trigger

from fvs_estimator_node.files import TrainedModel
from fvs_estimator_node.loop import FRESH_S, EstimationLoop
from fvs_estimator_node.registry import (
    PARAMETERS,
    EstimatorConfig,
    create_estimator,
    trained_model,
)
from fvs_ros import ros, topics
from fvs_ros.joints import ForeignJointsError, JointMap, JointStateError
from fvs_ros.status import ESTIMATOR_FAULT, ESTIMATOR_WAITING
from fvs_ros.vectors import all_finite

#: Shortest time between two Jacobians, s: every second joint state at 125 Hz (16 ms), less a fifth
#: for jitter.
_JACOBIAN_GAP_S = 0.8 * 0.016


class EstimatorNode(ros.FvsNode):
    """Publishes the Jacobian at the newest joints, and learns from every step."""

    keeps_subscriptions = True

    def __init__(self, namespace: str = "") -> None:
        super().__init__("fvs_estimator_node", PARAMETERS, namespace)
        v = self.values
        self._joint_map = JointMap(v["joint_names"], v["tf_prefix"])
        self._kind = EstimatorConfig.from_values(v).kind
        self._frozen = False
        self._program_running, self._speed_scaling = True, 100.0
        self._joints_s = -np.inf
        self._stamp_s: float | None = None  # of the newest joint state
        self._problem = ""
        self._problem_s = -np.inf
        self._published_stamp_s: float | None = None

        self._jacobian = self.publisher(topics.JACOBIAN)
        self._chain = self.publisher(topics.KINEMATIC_CHAIN)
        self.subscribe(topics.JOINT_STATES, self._on_joint_states)
        for camera, part in enumerate(self._kind.parts):
            take = partial(self._on_feature, camera)
            self.subscribe_feature(part.feature, part, take, self._complain)
        self.subscribe(self._kind.topics.sliding, self._on_sliding)
        self.subscribe(topics.SPEED_SCALING, self._on_speed_scaling)
        self.subscribe(topics.ROBOT_PROGRAM_RUNNING, self._on_program_running)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/freeze", self._on_freeze)
        self._use(v)
        self.create_timer(ros.STATUS_PERIOD_S, self._publish_status, clock=self.steady_clock)

    def _use(self, v: dict[str, Any]) -> None:
        """Start the method that the values name, from the trained model alone."""
        config = EstimatorConfig.from_values(v)
        load = partial(self._load_model, config, v["joint_names"])
        self._loop = EstimationLoop(create_estimator(config.method, v, load, self._kind))
        self._config = config

    def on_parameters(self, values: dict[str, Any], changed: set[str]) -> None:
        """Switch the method, but not while the controller servoes."""
        if values["method"] == self._config.method:
            return
        # The controller publishes the sliding variable only while it servoes, after every image.
        if self.monitor(self._kind.topics.sliding.name).age_s(self.now_s()) < FRESH_S:
            raise ValueError(
                "the method changes only while the controller does not servo; call its ~/stop first"
            )
        self._use(values)

    def _load_model(self, config: EstimatorConfig, joint_names: list[str]) -> TrainedModel:
        trained = trained_model(config, joint_names)
        self._joint_map.middle_rad = trained.joint_box_rad.mean(axis=0)
        for note in trained.notes:
            self.tell(ros.WARN, f"{config.model_path or self._kind.model}: {note}")
        return trained

    # --- inputs ---

    def _on_joint_states(self, message: JointState) -> None:
        try:
            stamp_s = ros.from_stamp(message.header.stamp)
            joints = self._joint_map.positions(message.name, message.position, stamp_s)
        except JointStateError as error:
            # Joint states of another device are an error only while ours have never arrived.
            if not isinstance(error, ForeignJointsError) or np.isinf(self._joints_s):
                self._loop.lose_joints()
                self._complain(str(error))
            return
        self._joints_s, self._stamp_s = self.now_s(), stamp_s
        self._loop.learns = self._learns
        self._loop.add_joints(stamp_s, joints)
        self._publish_estimate(stamp_s, joints)

    def _on_feature(self, camera: int, _now_s: float, stamp_s: float, z: np.ndarray) -> None:
        self._loop.learns = self._learns
        self._loop.add_image(stamp_s, z, camera)

    def _on_sliding(self, message: Any) -> None:
        header = getattr(message, "header", None)  # not every kind's has one
        stamp_s = ros.from_stamp(header.stamp) if header else self._stamp_s
        try:
            sliding_m = self._kind.read_sliding(message)
        except ValueError as error:
            self._complain(f"{self._kind.topics.sliding.name} {error}")
            return
        if stamp_s is not None:
            self._loop.add_sliding_variable(stamp_s, sliding_m)

    def _on_speed_scaling(self, message: Float64) -> None:
        self._speed_scaling = message.data

    def _on_program_running(self, message: Bool) -> None:
        self._program_running = message.data

    @property
    def _paused(self) -> bool:
        """Whether the robot is paused, so that it does not follow the commands."""
        return not self._program_running or not self._speed_scaling > 0.0

    @property
    def _learns(self) -> bool:
        return not (self._frozen or self._paused)

    # --- output ---

    def _publish_estimate(self, stamp_s: float, joints: np.ndarray) -> None:
        last = self._published_stamp_s
        if last is not None and 0.0 <= stamp_s - last < _JACOBIAN_GAP_S:
            return
        if self._loop.problem:
            return
        jacobian = self._loop.jacobian(joints)
        if not all_finite(jacobian):
            self._complain("the estimate is not finite and was not published; call ~/reset")
            return
        self._published_stamp_s = stamp_s
        chain = self._loop.estimator.chain
        if chain is not None:
            self._chain.publish(ros.to_chain(chain))
        self._jacobian.publish(ros.to_jacobian(jacobian, self._kind))

    # --- services ---

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response):
        self._loop.reset()
        response.success, response.message = True, "what was learned online is forgotten"
        return response

    def _on_freeze(self, request: SetBool.Request, response: SetBool.Response):
        self._frozen = request.data
        response.success = True
        response.message = "learning is frozen" if self._frozen else "learning goes on"
        return response

    # --- status ---

    def _complain(self, problem: str) -> None:
        self._problem, self._problem_s = problem, self.now_s()
        self.log_refusal(problem)

    def _state(self) -> tuple[bytes, str, str]:
        """Level, state and reason in words."""
        now_s = self.now_s()
        if now_s - self._problem_s < 1.0:
            return ros.ERROR, ESTIMATOR_FAULT, self._problem
        waiting = self._loop.problem or self._late_input(now_s)
        if waiting:
            return ros.WARN, ESTIMATOR_WAITING, waiting
        if self._frozen:
            return ros.OK, "FROZEN", "learning is frozen by ~/freeze"
        if self._paused:
            return ros.OK, "FROZEN", "the robot is paused: learning stops until it resumes"
        learns = self._loop.estimator.learns
        usual = "and learning from every motion" if learns else "this method does not learn online"
        state = "LEARNING" if learns else "FROZEN"
        return ros.OK, state, f"estimating; {usual}"

    def _ages_s(self, now_s: float) -> dict[str, float]:
        """Ages of the inputs, s, by topic."""
        names = [part.feature.name for part in self._kind.parts]
        ages_s = {name: self.monitor(name).age_s(now_s) for name in names}
        return {topics.JOINT_STATES.name: now_s - self._joints_s, **ages_s}

    def _late_input(self, now_s: float) -> str:
        """Which input is late, in words; empty if none."""
        for topic, age_s in self._ages_s(now_s).items():
            if age_s > FRESH_S:
                heard = "none heard yet" if np.isinf(age_s) else f"the last is {age_s:.1f} s old"
                return f"waiting for {topic}: {heard}"
        return ""

    def _publish_status(self) -> None:
        now_s = self.now_s()
        level, state, reason = self._state()
        self.publish_status(
            level,
            state,
            reason,
            {
                "method": self._config.method,
                **{f"{name}_age_s": age_s for name, age_s in self._ages_s(now_s).items()},
                **self._loop.status_values(),
            },
        )


def main() -> int:
    """Run ``fvs_estimator_node``."""
    return ros.run(EstimatorNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
