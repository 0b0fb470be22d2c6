"""``fvs_dashboard``: serves a page that shows and operates the loop."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import os
import sys
from collections.abc import Sequence
from functools import partial
from math import inf, nan
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String

from fvs_dashboard import board
from fvs_dashboard.board import Action, Actions, Board, Controller
from fvs_dashboard.config import PARAMETERS, VISER, DashboardConfig
from fvs_dashboard.markup import SHOWN_BY
from fvs_dashboard.picture import Picture
from fvs_dashboard.services_of_node import ANSWER_S, Services
from fvs_estimator_node.files import load_model
from fvs_ros import ros, topics
from fvs_ros.joints import JointMap, JointStateError
from fvs_ros.kinds.pose import Pose
from fvs_ros.paths import find_file
from fvs_ros.ros.images import from_color, sampled_camera
from fvs_tools.demo import choose_target

_PERIOD_S, _LOOK_PERIOD_S = 0.1, 1.0
#: Time after a reset until the ball rests and is seen there, s.
_AT_REST_S = 1.0
#: Largest rotation of a bump about x, y and z, degrees; larger ones about x and y lose the ball.
_BUMP_DEG = (4.0, 4.0, 25.0)
_ROTATION = "camera_rotation_deg"
#: Time for each target of the tour, s, and distance between targets, m.
_TARGET_S, _TOUR_M = 5.0, 0.3
_ASKED = {
    topics.CONTROLLER: SHOWN_BY,
    topics.ESTIMATOR: ("method",),
    topics.SIM: ("depth_noise", "latency_s", _ROTATION),
}
_TOUR_OFF = Action("tour", False)


class DashboardNode(ros.FvsNode):
    """Updates the page at a steady rate while a browser shows it, and executes user actions."""

    def __init__(self) -> None:
        super().__init__("fvs_dashboard", PARAMETERS)
        v, self._config = self.values, DashboardConfig.from_values(self.values)
        self._kind = self._config.kind
        self._target_m: np.ndarray | None = None  # sent from here last, (m,)
        self._joint_map = JointMap(v["joint_names"], v["tf_prefix"])
        self._board = Board(len(self._joint_map.names))
        self._picture = Picture(self._config.ball_radius_m)
        # Actions trigger a callback: polling at 30 Hz took 3 % of a core.
        self._actions = Actions(self.create_guard_condition(self._act).trigger)
        self._arm: Any = None
        self._description = ""
        self._calls = Services(self, self._answer)
        self._cameras: list[ros.Sampled] = []  # while a browser shows the page
        self._board.tour = self._config.tour
        #: Where ball or tag can be, camera frame, m, shape (n, m).
        self._candidates_m: np.ndarray | None = None
        if self._config.model_path or self._config.tour:
            model = self._config.model_path or self._kind.model
            trained = load_model(find_file(model), expected=self._config)
            self._candidates_m = trained.ball_samples_m
        self._tour_due_s = -inf
        self._begun: dict[str, Any] = {}  # the simulator's parameters as they were at first
        self._at_rest_s = inf  # when the ball has come to rest after a reset
        self._rng = np.random.default_rng()
        self._subscribe()
        self._page = _make_page(self._config, v["joint_names"], self._actions)
        self.create_timer(_PERIOD_S, self._show, clock=self.steady_clock)
        self.create_timer(_LOOK_PERIOD_S, self._look_around, clock=self.steady_clock)
        print(f"page: {self._page.address}", flush=True)
        if self._page.open_to_others:
            self.tell(
                ros.WARN, "anybody who reaches this page can move the arm: it asks no password"
            )

    def _subscribe(self) -> None:
        # Not latched: a controller that starts later must not move to an old target.
        target = self._kind.topics.target
        self._target = self.create_publisher(
            ros.message_class(target.type), target.name, ros.QOS_EVENT
        )
        self._joint_states = ros.Sampled(
            self, JointState, topics.JOINT_STATES.name, self._on_joint_states
        )
        self.subscribe(self._kind.topics.tool, self._on_feature)
        self.subscribe(topics.CONTROLLER_STATUS, self._on_status)
        self.subscribe(topics.DETECTOR_STATUS, self._on_detector)
        self.subscribe(topics.ROBOT_DESCRIPTION, self._on_description)
        self.subscribe(topics.TRUE_CAMERA_POSE, self._on_camera_pose)

    # --- inputs ---

    def _on_joint_states(self, message: JointState) -> None:
        try:
            joints = self._joint_map.positions(message.name, message.position)
        except JointStateError:
            return  # the controller reports the problem
        try:
            velocity = self._joint_map.positions(message.name, message.velocity)
        except JointStateError:
            velocity = np.full_like(joints, nan)
        stamp_s = ros.from_stamp(message.header.stamp)
        self._board.add_joints(self.steady_s(), stamp_s, joints, velocity)

    def _on_feature(self, message: Any) -> None:
        kind, frame = self._kind, self._config.feature_frame
        z = ros.from_feature(message, kind, frame, kind.topics.tool.name)
        stamp_s = ros.from_stamp(message.header.stamp)
        self._board.add_ball(self.steady_s(), stamp_s, z)
        self._picture.add_ball(stamp_s, z[:3])

    def _on_status(self, message: DiagnosticStatus) -> None:
        controller = Controller(ros.from_status(message), message.message)
        self._board.add_status(self.steady_s(), controller)

    def _on_detector(self, message: DiagnosticStatus) -> None:
        self._board.note("detector", self.steady_s(), message.message)

    def _on_description(self, message: String) -> None:
        from fvs_dashboard.scene import Arm  # viser is installed, since the page is served

        if message.data == self._description:
            return  # a latched message repeats whenever its publisher is rediscovered
        self._description = message.data
        try:
            self._arm = Arm(message.data, self._joint_map.names, self.values["tf_prefix"])
        except ValueError as error:
            text = f"the arm cannot be drawn: {error}"
        else:
            self._page.scene.set_arm(self._arm)
            text = self._arm.missing
        self._board.note("arm", self.steady_s(), text)
        if text:
            self.tell(ros.WARN, text)

    def _on_camera_pose(self, message: PoseStamped) -> None:
        pose = np.eye(4)
        frame, name = message.header.frame_id, topics.TRUE_CAMERA_POSE.name
        z = ros.from_feature(message, Pose(), frame, name)
        pose[:3, 3], pose[:3, :3] = z[:3], Pose().rotation(z)
        self._board.place_camera(pose)

    def _on_image(self, message: Image) -> None:
        stamp_s = ros.from_stamp(message.header.stamp)
        exposed_s = self.steady_s() - max(self.ros_s() - stamp_s, 0.0)
        self._picture.add_image(exposed_s, stamp_s, from_color(message))

    def _on_camera_info(self, message: CameraInfo) -> None:
        self._picture.intrinsics = ros.from_camera_info(message).intrinsics

    # --- what is shown ---

    def _show(self) -> None:
        self._calls.look_after()
        for topic in (self._joint_states, *self._cameras):
            topic.look()
        now_s = self.steady_s()
        if self._arm is not None:
            self._board.learn_camera(self._arm.flange)
        self._send_tour(now_s)
        if now_s > self._at_rest_s:  # no service clears a target; one at the ball moves nothing
            self._at_rest_s = now_s + ANSWER_S  # again, if no answer comes
            self._calls.call(f"{topics.CONTROLLER}/{board.SET_CURRENT.name}", self._on_reset)
        watched = self._page.watched
        if watched != bool(self._cameras):
            self._look_at_images(watched)
        if watched:
            self._page.update(self._board, self._picture, now_s)

    def _look_at_images(self, wanted: bool) -> None:
        """Subscribe while a browser shows them: the simulator draws images for subscribers only."""
        while self._cameras:
            self._cameras.pop().close()
        if wanted:
            prefix = self._config.camera_topics
            self._cameras = sampled_camera(self, prefix, self._on_image, self._on_camera_info)

    def _look_around(self) -> None:
        """Query what has no topic: parameters of the other nodes, and publishers of images."""
        if not self._page.watched:
            return
        names = topics.camera_names(topics.COLOR_IMAGE, self._config.camera_topics)
        found = [name for name in names if self.count_publishers(name)]
        self._picture.waits_for = (
            f"waiting for the first picture from {' or '.join(found)}"
            if found
            else f"no picture: no node publishes {' or '.join(names)}"
        )
        for node, parameters in _ASKED.items():
            self._calls.ask(node, parameters, partial(self._on_values, node))

    def _on_values(self, node: str, values: dict[str, Any]) -> None:
        self._board.parameters[node] = values
        if node == topics.SIM and not self._begun:
            self._begun = values

    # --- what is done ---

    def _act(self) -> None:
        for action in self._actions.drain():
            self._board.note("answer", self.steady_s(), "")  # clears the previous answer
            self._at_rest_s = inf  # a new action cancels the pending part of a reset
            self._do(action)

    def _do(self, action: Action) -> None:
        if action.name == "target" or action in (
            board.STOP,
            board.RESET,
            board.SET_CURRENT,
            _TOUR_OFF,
        ):
            self._board.tour = False  # a person takes over
        if action == board.STOP:
            self._calls.stop()
        elif action == board.RESET:
            self._reset()
        elif action == board.BUMP:
            turns_deg = np.multiply(_BUMP_DEG, self._rng.uniform(-1.0, 1.0, 3))
            turns_deg += self._begun.get(_ROTATION, np.zeros(3))
            self._calls.set(f"{topics.SIM}/{_ROTATION}", tuple(turns_deg.tolist()))
        elif "/" in action.name:
            self._calls.set(action.name, action.value)
        elif action == _TOUR_OFF:
            pass
        elif self._board.controller(self.steady_s()).silent:
            # Otherwise it would be executed when the controller returns, unexpectedly.
            self._answer(f"not done: the controller is silent; is {topics.CONTROLLER} running?")
        elif action.name == "target":
            target_m = self._wanted(action.value)
            if target_m is None:
                self._answer(f"not done: no {self._kind.what} yet, so its rotation is unknown")
            else:
                self._send_target(target_m)
        elif action.name == "tour":
            self._board.tour, self._tour_due_s = True, -inf
        else:
            self._calls.call(f"{topics.CONTROLLER}/{action.name}")

    def _reset(self) -> None:
        """Stop, reset the estimator, and restore the initial simulation."""
        self._calls.stop()
        if self._board.parameters.get(topics.SIM):
            for name, value in self._begun.items():
                self._calls.set(f"{topics.SIM}/{name}", value)
            self._calls.call(f"{topics.SIM}/reset")
        self._calls.call(f"{topics.ESTIMATOR}/reset")
        self._at_rest_s = self.steady_s() + _AT_REST_S

    def _on_reset(self, answer: Any) -> None:
        if self._at_rest_s < inf:
            self._answer(
                f"{'every' if answer.success else 'not every'}thing reset; {answer.message}"
            )
        if answer.success:
            self._at_rest_s = inf

    def _send_target(self, target_m: np.ndarray) -> None:
        kind, frame = self._kind, self._config.feature_frame
        self._target_m = target_m
        self._board.note("target", self.steady_s(), target_m)
        self._target.publish(ros.to_feature(self.ros_s(), frame, kind, target_m))

    def _wanted(self, numbers: Sequence[float]) -> np.ndarray | None:
        """The target, (m,), of a user's: a place without a rotation keeps that of the last one."""
        position_m, wxyz = np.array(numbers[:3]), np.array(numbers[3:])
        if len(wxyz):
            turn = Rotation.from_quat(np.roll(wxyz, -1)).as_matrix()
            return self._kind.of_body(position_m, turn)
        last = self._target_m
        if last is None:
            last = self._board.newest("ball_position", self.steady_s())
        if last is None and self._kind.flat:
            last = position_m
        return None if last is None else np.append(position_m, last[3:])

    def _answer(self, text: str) -> None:
        self._board.note("answer", self.steady_s(), text)
        self.tell(ros.OK, text)

    def _send_tour(self, now_s: float) -> None:
        """Send the next target when it is due."""
        if self._candidates_m is None or not self._board.tour or now_s < self._tour_due_s:
            return
        seen_m = self._board.newest("ball_position", now_s)
        controller = self._board.controller(now_s)
        ready = controller.state == "SERVOING" or controller.reason == "NO_TARGET"
        if seen_m is not None and ready:
            self._tour_due_s = now_s + _TARGET_S
            candidates = self._candidates_m
            self._send_target(choose_target(self._kind, candidates, seen_m, _TOUR_M, self._rng))

    def finish(self) -> None:
        """Stop serving."""
        self._page.close()


def _make_page(config: DashboardConfig, joint_names: Sequence[str], actions: Actions) -> Any:
    """Serve the page; a ``ValueError`` explains why it cannot be served."""
    try:
        from fvs_dashboard.page import Page
    except ImportError as error:
        raise ValueError(
            f"the page needs {error.name}: pip install '{VISER}' (extra dashboard of fvs_ros)"
        ) from error
    return Page(config, joint_names, actions)


def main() -> int:
    """Run ``fvs_dashboard``."""
    os.nice(5)  # behind the loop, but the buttons must work on a busy machine, too
    return ros.run(DashboardNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
