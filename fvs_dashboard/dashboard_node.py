"""``fvs_dashboard``: serves a page that shows the loop at work and does what is wished there."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from functools import partial
from math import nan
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String

from fvs_dashboard.actions import (
    BUMP,
    CONTROLLER,
    ESTIMATOR,
    RESET,
    SET_CURRENT,
    SIMULATOR,
    STOP,
    Action,
    Actions,
)
from fvs_dashboard.board import Board
from fvs_dashboard.config import PARAMETERS, VISER
from fvs_dashboard.markup import SHOWN_BY
from fvs_dashboard.placement import Pose
from fvs_dashboard.services_of_node import ANSWER_S, Services
from fvs_dashboard.tour import LOST, TargetTour
from fvs_estimator_node.model_file import load_model
from fvs_ros import ros, topics
from fvs_ros.background import step_back
from fvs_ros.joints import N_JOINTS, JointMap, JointStateError
from fvs_ros.paths import find_file
from fvs_ros.quaternions import rotation_of
from fvs_ros.ros.images import from_color
from fvs_ros.topics import CAMERA_PREFIXES

#: Behind the loop, but not far: its buttons must work on a busy machine, too.
_NICE = 5
#: A picture that comes so much too late shows how little time the page gets, nothing else, s.
_LATE_S = 0.7
#: And is said for so long, s.
_BEHIND_S = 5.0
_BEHIND = "this page gets too little of the processor: it is behind"
_LOOK_PERIOD_S = 1.0
#: So long after a reset the ball is seen where it has come to rest, s.
_AT_REST_S = 1.0
#: A bump turns the camera by this much about x, y and z, degrees: about x and y by little, or the
#: ball is out of view.
_LEAST_BUMP_DEG, _LARGEST_BUMP_DEG = (1.0, 1.0, 15.0), (4.0, 4.0, 25.0)
_ROTATION = "camera_rotation_deg"
_NO_TOUR = Action("tour", False)
_ASKED = {
    CONTROLLER: SHOWN_BY,
    ESTIMATOR: ("method",),
    SIMULATOR: ("depth_noise", "latency_s", _ROTATION),
}


class DashboardNode(ros.FvsNode):
    """Feeds the page at a steady rate while somebody looks; does what was said there."""

    def __init__(self) -> None:
        super().__init__("fvs_dashboard", PARAMETERS)
        v = self.values
        self._frame = v["feature_frame"]
        self._joint_map = JointMap(v["joint_names"], v["tf_prefix"])
        self._board = Board(v["ball_radius_m"])
        # Woken when something is said: to look for it thirty times a second took 3 % of a core.
        self._actions = Actions(self.create_guard_condition(self._act).trigger)
        self._arm: Any = None
        self._description = ""
        self._calls = Services(self, self._answer)
        # Intrinsics and image by prefix, while somebody looks.
        self._cameras: dict[str, tuple[ros.Sampled, ...]] = {}
        self._tour: TargetTour | None = self._make_tour() if v["tour"] else None
        # A wish of now: a controller that is started later must not go where one was sent before.
        self._target = self.create_publisher(
            PointStamped, topics.TARGET_POSITION.name, ros.QOS_EVENT
        )
        self._joint_states = ros.Sampled(
            self, JointState, topics.JOINT_STATES.name, self._on_joint_states
        )
        self.watch(PointStamped, topics.BALL_POSITION.name, self._on_ball, ros.QOS_NEWEST)
        self.watch(DiagnosticStatus, topics.CONTROLLER_STATUS.name, self._on_status, ros.QOS_NEWEST)
        self.watch(DiagnosticStatus, topics.DETECTOR_STATUS.name, self._on_detector, ros.QOS_NEWEST)
        self.watch(String, topics.ROBOT_DESCRIPTION.name, self._on_description, ros.QOS_LATCHED)
        self.watch(PoseStamped, topics.TRUE_CAMERA_POSE.name, self._on_camera_pose, ros.QOS_LATCHED)
        self._page = _make_page(v, self._actions)
        self._shown_s = self.steady_s()
        self._skipped = False
        self._begun: dict[str, Any] = {}  # the simulator's parameters as they were at first
        self._reset_s: float | None = None
        self._rng = np.random.default_rng()
        self.create_timer(1.0 / v["rate_hz"], self._show, clock=self.steady_clock)
        self.create_timer(_LOOK_PERIOD_S, self._look_around, clock=self.steady_clock)
        print(f"page: {self._page.address}", flush=True)
        if self._page.open_to_others:
            self.tell(ros.WARN, "whoever reaches this page can move the arm: it asks no password")
        step_back(_NICE)

    # --- inputs ---

    def _sample(self) -> None:
        """Take the newest of what comes more often than it can be shown."""
        self._joint_states.look()
        for camera in self._cameras.values():
            for topic in camera:
                topic.look()

    def _on_joint_states(self, message: JointState) -> None:
        try:
            joints = self._joint_map.positions(message.name, message.position)
        except JointStateError:
            return  # the controller says what is wrong with it
        try:
            velocity = self._joint_map.positions(message.name, message.velocity)
        except JointStateError:
            velocity = np.full(N_JOINTS, nan)
        stamp_s = ros.from_stamp(message.header.stamp)
        self._board.add_joints(self.steady_s(), stamp_s, joints, velocity)

    def _on_ball(self, message: PointStamped) -> None:
        position_m = ros.from_point(message, self._frame, topics.BALL_POSITION.name)
        stamp_s = ros.from_stamp(message.header.stamp)
        self._board.add_ball(self.steady_s(), stamp_s, position_m)

    def _on_status(self, message: DiagnosticStatus) -> None:
        self._board.add_status(self.steady_s(), ros.from_status(message), message.message)

    def _on_detector(self, message: DiagnosticStatus) -> None:
        self._board.add_detector(self.steady_s(), message.message)

    def _on_description(self, message: String) -> None:
        from fvs_dashboard.arm import Arm  # slow to import

        if message.data == self._description:
            return  # latched: it comes again whenever its publisher is found again
        self._description = message.data
        try:
            self._arm = Arm(message.data, self._joint_map.names, self.values["tf_prefix"])
        except ValueError as error:
            self.tell(ros.WARN, f"the arm cannot be drawn: {error}")
            self._board.note("arm", f"the arm cannot be drawn: {error}")
            return
        self._board.note("arm", "")
        self._page.set_arm(self._arm)
        if self._arm.missing:
            self.tell(ros.WARN, self._arm.missing)

    def _on_camera_pose(self, message: PoseStamped) -> None:
        position_m, quaternion = ros.from_pose(message, topics.TRUE_CAMERA_POSE.name)
        self._board.tell_camera(Pose(rotation_of(quaternion), position_m))

    def _on_image(self, message: Image) -> None:
        stamp_s = ros.from_stamp(message.header.stamp)
        exposed_s = self.steady_s() - max(self.ros_s() - stamp_s, 0.0)
        self._board.add_image(exposed_s, stamp_s, from_color(message))

    def _on_camera_info(self, message: CameraInfo) -> None:
        self._board.set_intrinsics(ros.from_camera_info(message).intrinsics)

    # --- what is shown ---

    def _show(self) -> None:
        self._calls.look_after()
        self._sample()
        now_s = self.steady_s()
        self._board.sample(now_s)
        if self._arm is not None:
            self._board.learn_camera(self._arm.flange)
        self._send_tour(now_s)
        if self._reset_s is not None and now_s - self._reset_s > _AT_REST_S:
            self._reset_s = now_s + ANSWER_S  # again, if no answer comes
            self._calls.call(f"{CONTROLLER}/{SET_CURRENT.name}", self._on_reset_done)
        watched = self._page.watched
        if self.values["image"] and watched != bool(self._cameras):
            self._look_at_images(watched)
        late = now_s - self._shown_s > _LATE_S + 1.0 / self.values["rate_hz"]
        self._shown_s = now_s
        if late:  # what came meanwhile is yet to be heard; but not every time
            self._board.note("behind", _BEHIND, now_s + _BEHIND_S)
        self._skipped = late and not self._skipped
        if watched and not self._skipped:
            self._board.tour = self._tour is not None
            self._page.update(self._board, now_s)

    def _look_at_images(self, wanted: bool) -> None:
        """Subscribe while somebody looks: the simulator draws full images for subscribers only."""
        given, declared = self.values["camera_topics"], CAMERA_PREFIXES[0]
        names = set()
        if wanted:
            names = {given or declared}
        if wanted and not given:  # drivers differ, and may start later
            names.update(
                prefix
                for prefix in CAMERA_PREFIXES[1:]
                if self.count_publishers(topics.COLOR_IMAGE.name.replace(declared, prefix, 1))
            )
        for prefix in set(self._cameras) - names:
            for topic in self._cameras.pop(prefix):
                topic.close()
        for prefix in names - set(self._cameras):
            self._cameras[prefix] = tuple(
                ros.Sampled(self, kind, name.replace(declared, prefix, 1), take)
                for kind, name, take in (
                    (CameraInfo, topics.CAMERA_INFO.name, self._on_camera_info),
                    (Image, topics.COLOR_IMAGE.name, self._on_image),
                )
            )

    def _why_no_picture(self) -> str:
        names = [topics.COLOR_IMAGE.name.replace(CAMERA_PREFIXES[0], p, 1) for p in self._cameras]
        if any(self.count_publishers(name) for name in names):
            return f"waiting for the first picture from {' or '.join(names)}"
        return f"no picture: no node publishes {' or '.join(names)}"

    def _look_around(self) -> None:
        """Ask for what is not on a topic: parameters of the others."""
        if not self._page.watched:
            return
        if self.values["image"]:
            self._look_at_images(True)
            self._board.waits_for = self._why_no_picture()
        for node, names in _ASKED.items():
            self._calls.ask(node, names, partial(self._on_values, node))

    def _on_values(self, node: str, values: dict[str, Any]) -> None:
        self._board.parameters[node] = values
        if node == SIMULATOR and values and not self._begun:
            self._begun = values

    # --- what is done ---

    def _act(self) -> None:
        for action in self._actions.drain():
            self._do(action)

    def _do(self, action: Action) -> None:
        self._board.answer(self.steady_s(), "")  # what was said of another one
        self._reset_s = None  # whoever wants something meanwhile means it
        if action in (STOP, RESET, SET_CURRENT, _NO_TOUR) or action.name == "target":
            self._tour = None  # a person takes over
        if action == STOP:
            self._calls.stop()
        elif action == RESET:
            self._reset()
        elif action == BUMP:
            turns_deg = self._rng.uniform(_LEAST_BUMP_DEG, _LARGEST_BUMP_DEG)
            turns_deg *= self._rng.choice((-1.0, 1.0), 3)
            turns_deg += self._begun.get(_ROTATION, np.zeros(3))
            self._calls.set(f"{SIMULATOR}/{_ROTATION}", tuple(turns_deg.tolist()))
        elif action.sets_parameter:
            self._calls.set(action.name, action.value)
        elif action == _NO_TOUR:
            pass
        elif self._board.controller(self.steady_s()).silent:
            # It would be done whenever the controller comes back, when nobody expects it.
            self._answer(f"not done: the controller is silent; is {CONTROLLER} running?")
        elif action.name == "target":
            self._send_target(np.array(action.value))
        elif action.name == "tour":
            self._switch_tour()
        else:
            self._calls.call(f"{CONTROLLER}/{action.name}")

    def _reset(self) -> None:
        """Stop, forget what was learned, and put the simulation back as it began."""
        self._calls.stop()
        if self._board.parameters.get(SIMULATOR):
            for name, value in self._begun.items():
                self._calls.set(f"{SIMULATOR}/{name}", value)
            self._calls.call(f"{SIMULATOR}/reset")
        self._calls.call(f"{ESTIMATOR}/reset")
        self._reset_s = self.steady_s()

    def _on_reset_done(self, answer: Any) -> None:
        """Say how it ended; no service clears a target, but at the ball it moves nothing."""
        if self._reset_s is None:
            return
        if answer.success:
            self._reset_s = None
            self._answer(f"everything reset; {answer.message}")
        else:
            self._reset_s = self.steady_s()  # again, until it is accepted
            self._board.answer(self._reset_s, f"not all is reset yet; {answer.message}")

    def _send_target(self, position_m: np.ndarray) -> None:
        self._target.publish(ros.to_point(self.ros_s(), self._frame, position_m))

    def _answer(self, text: str) -> None:
        self._board.answer(self.steady_s(), text)
        self.tell(ros.OK, text)

    # --- the tour ---

    def _make_tour(self) -> TargetTour:
        v = self.values
        if not v["model_path"]:
            raise ValueError("tour needs model_path: its targets are positions that a model saw")
        candidates_m = load_model(find_file(v["model_path"])).ball_samples_m
        return TargetTour(candidates_m, v["tour_period_s"])

    def _switch_tour(self) -> None:
        try:
            self._tour = self._make_tour()
        except (OSError, ValueError) as error:
            self._answer(f"no tour: {error}")

    def _send_tour(self, now_s: float) -> None:
        if self._tour is None:
            return
        ball_m = self._board.ball_m(now_s)
        if self._tour.lost(now_s, ball_m) and self.count_publishers(topics.TRUE_CAMERA_POSE.name):
            self._calls.call(
                f"{SIMULATOR}/reset", lambda answer: self._answer(f"{LOST}: {answer.message}")
            )
        ready = self._board.controller(now_s).goes_to_targets
        target_m = self._tour.next(now_s, ready, ball_m)
        if target_m is not None:
            self._send_target(target_m)

    def finish(self) -> None:
        """Stop serving."""
        self._page.close()


def _make_page(values: dict[str, Any], actions: Actions) -> Any:
    """Serve the page; a ``ValueError`` says why that cannot be."""
    try:
        from fvs_dashboard.page import Page
    except ImportError as error:
        raise ValueError(
            f"the page needs {error.name}: pip install '{VISER}' (extra dashboard of fvs_ros)"
        ) from error
    return Page(
        values["host"],
        values["port"],
        actions,
        ball_radius_m=values["ball_radius_m"],
        image=values["image"],
        tour=bool(values["model_path"]),
    )


def main() -> int:
    """Run ``fvs_dashboard``."""
    return ros.run(DashboardNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
