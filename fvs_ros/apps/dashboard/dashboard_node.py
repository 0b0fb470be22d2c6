"""``fvs_dashboard``: serves a page that shows the loop at work and does what is wished there."""

from __future__ import annotations

from fvs_ros.core import stop

stop.listen()

import sys
from collections.abc import Callable
from math import isfinite, nan
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from fvs_estimator_node.model_file import load_model
from fvs_ros.apps.dashboard.actions import STOP, Action, Actions, Call, Disturb, Target, Tour
from fvs_ros.apps.dashboard.board import Board
from fvs_ros.apps.dashboard.config import PARAMETERS
from fvs_ros.apps.dashboard.placement import Pose, rotation_of
from fvs_ros.apps.dashboard.tour import TargetTour
from fvs_ros.core import ros
from fvs_ros.core.background import step_back
from fvs_ros.core.joints import N_JOINTS, JointMap, JointStateError
from fvs_ros.core.paths import find_file
from fvs_ros.core.topics import CAMERA_PREFIXES

_ACTIONS_PERIOD_S = 0.03
_LOOK_PERIOD_S = 1.0
_CONTROLLER, _SIMULATOR = "fvs_controller_node", "fvs_sim_node"
_LIMIT = "max_joint_velocity_rad_s"
_CALLS: dict[str, type] = {
    **{f"{_CONTROLLER}/{name}": Trigger for name in ("start", "stop", "set_current_as_target")},
    f"{_CONTROLLER}/get_parameters": GetParameters,
    f"{_SIMULATOR}/get_parameters": GetParameters,
    f"{_SIMULATOR}/set_parameters": SetParameters,
}
_DISTURBANCES = ("depth_noise", "latency_s", "camera_rotation_deg")


class DashboardNode(ros.FvsNode):
    """Feeds the page at a steady rate while somebody looks; does what was said there."""

    def __init__(self) -> None:
        super().__init__("fvs_dashboard", PARAMETERS)
        v = self.values
        self._frame = v["feature_frame"]
        self._joint_map = JointMap(v["joint_names"], v["tf_prefix"])
        self._board = Board(v["history_s"], v["trail_s"], v["ball_radius_m"])
        self._actions = Actions()
        self._arm: Any = None
        self._description = ""
        self._callers = {name: self.create_client(kind, name) for name, kind in _CALLS.items()}
        self._images: list[ros.Sampled] = []  # while somebody looks
        self._infos: list[ros.Sampled] = []
        self._tour: TargetTour | None = self._make_tour() if v["tour"] else None
        self._target = self.create_publisher(PointStamped, ros.TARGET_POSITION, ros.QOS_LATCHED)
        self._joint_states = ros.Sampled(self, JointState, ros.JOINT_STATES)
        self.watch(PointStamped, ros.BALL_POSITION, self._on_ball, ros.QOS_NEWEST)
        self.watch(DiagnosticStatus, ros.CONTROLLER_STATUS, self._on_status, ros.QOS_NEWEST)
        self.watch(String, ros.ROBOT_DESCRIPTION, self._on_description, ros.QOS_LATCHED)
        self.watch(PoseStamped, ros.TRUE_CAMERA_POSE, self._on_camera_pose, ros.QOS_LATCHED)
        self._page = _make_page(v, self._actions)
        self.create_timer(_ACTIONS_PERIOD_S, self._act, clock=self.steady_clock)
        self.create_timer(1.0 / v["rate_hz"], self._show, clock=self.steady_clock)
        self.create_timer(_LOOK_PERIOD_S, self._look_around, clock=self.steady_clock)
        print(f"page: {self._page.address}", flush=True)
        step_back()

    # --- inputs ---

    def _sample(self) -> None:
        """Take the newest of what comes more often than it can be shown."""
        joint_state = self._joint_states.newest()
        if joint_state is not None:
            self._on_joint_states(joint_state)
        for heard, take in ((self._infos, self._on_camera_info), (self._images, self._on_image)):
            for topic in heard:
                message = topic.newest()
                if message is not None:
                    take(message)

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
        try:
            position_m = ros.from_point(message, self._frame, ros.BALL_POSITION)
        except ros.MessageError:
            return  # the controller says what is wrong with it
        stamp_s = ros.from_stamp(message.header.stamp)
        self._board.add_ball(self.steady_s(), stamp_s, position_m)

    def _on_status(self, message: DiagnosticStatus) -> None:
        self._board.add_status(self.steady_s(), ros.from_status(message), message.message)

    def _on_description(self, message: String) -> None:
        from fvs_ros.apps.dashboard.arm import Arm  # slow to import

        if message.data == self._description:
            return  # latched: it comes again whenever its publisher is found again
        self._description = message.data
        try:
            self._arm = Arm(message.data, self._joint_map.names, self.values["tf_prefix"])
        except ValueError as error:
            self.tell(ros.WARN, f"the arm cannot be drawn: {error}")
            self._board.answer(self.steady_s(), f"the arm cannot be drawn: {error}")
            return
        self._page.set_arm(self._arm)

    def _on_camera_pose(self, message: PoseStamped) -> None:
        position_m, quaternion = ros.from_pose(message, ros.TRUE_CAMERA_POSE)
        self._board.tell_camera(Pose(rotation_of(quaternion), position_m))

    def _on_image(self, message: Image) -> None:
        try:
            stamp_s = ros.from_stamp(message.header.stamp)
            self._board.add_image(stamp_s, ros.from_color(message))
        except ros.MessageError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)

    def _on_camera_info(self, message: CameraInfo) -> None:
        try:
            self._board.set_intrinsics(ros.from_camera_info(message).intrinsics)
        except ros.MessageError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)

    # --- what is shown ---

    def _show(self) -> None:
        self._sample()
        now_s = self.steady_s()
        self._board.sample(now_s)
        if self._arm is not None:
            self._board.learn_camera(self._arm.flange)
        self._send_tour(now_s)
        watched = self._page.watched
        if self.values["image"] and watched != bool(self._images):
            self._look_at_images(watched)
        if watched:
            self._page.update(self._board.snapshot(now_s, self._tour is not None))

    def _look_at_images(self, wanted: bool) -> None:
        """Subscribe while somebody looks: the simulator draws full images for subscribers only."""
        for topic in (*self._images, *self._infos):
            topic.close()
        self._images, self._infos = [], []
        declared = CAMERA_PREFIXES[0]
        for prefix in CAMERA_PREFIXES if wanted else ():
            color = ros.COLOR_IMAGE.replace(declared, prefix, 1)
            if prefix == declared or self.count_publishers(color):
                info = ros.CAMERA_INFO.replace(declared, prefix, 1)
                self._images.append(ros.Sampled(self, Image, color))
                self._infos.append(ros.Sampled(self, CameraInfo, info))

    def _look_around(self) -> None:
        """Ask for what is not on a topic: the speed limit, and the simulator's disturbances."""
        if not self._page.watched:
            return
        self._ask(_CONTROLLER, (_LIMIT,), self._on_limit)
        if self.count_publishers(ros.TRUE_CAMERA_POSE):
            self._ask(_SIMULATOR, _DISTURBANCES, self._on_simulator)
        else:
            self._board.simulator = None

    def _on_limit(self, values: dict[str, Any]) -> None:
        limit = values.get(_LIMIT)
        self._board.limit_rad_s = limit if isinstance(limit, float) and isfinite(limit) else nan

    def _on_simulator(self, values: dict[str, Any]) -> None:
        self._board.simulator = values

    # --- what is done ---

    def _act(self) -> None:
        for action in self._actions.drain():
            self._do(action)

    def _do(self, action: Action) -> None:
        if isinstance(action, Call):
            if action == STOP:
                self._tour = None
            self._call(action.service)
        elif isinstance(action, Target):
            self._tour = None
            self._send_target(np.array(action.position_m))
        elif isinstance(action, Tour):
            self._switch_tour(action.on)
        elif isinstance(action, Disturb):
            self._disturb(action)

    def _send_target(self, position_m: np.ndarray) -> None:
        self._target.publish(ros.to_point(self.ros_s(), self._frame, position_m))

    def _call(self, service: str) -> None:
        def on_answer(answer: Trigger.Response) -> None:
            self._answer(f"{service.replace('_', ' ')}: {answer.message}")

        self._request(f"{_CONTROLLER}/{service}", Trigger.Request(), on_answer)

    def _disturb(self, action: Disturb) -> None:
        def on_answer(answer: SetParameters.Response) -> None:
            for result in answer.results:
                if not result.successful:
                    self._answer(f"the simulator refuses: {result.reason}")

        value = list(action.value) if isinstance(action.value, tuple) else action.value
        request = SetParameters.Request(
            parameters=[Parameter(action.name, value=value).to_parameter_msg()]
        )
        self._request(f"{_SIMULATOR}/set_parameters", request, on_answer)

    def _ask(
        self, node: str, names: tuple[str, ...], on_values: Callable[[dict[str, Any]], None]
    ) -> None:
        def on_answer(answer: GetParameters.Response) -> None:
            values = [parameter_value_to_python(value) for value in answer.values]
            on_values({n: v for n, v in zip(names, values, strict=False) if v is not None})

        request = GetParameters.Request(names=list(names))
        self._request(f"{node}/get_parameters", request, on_answer, quiet=True)

    def _request(
        self, name: str, request: Any, on_answer: Callable[[Any], None], quiet: bool = False
    ) -> None:
        client = self._callers[name]
        if client.service_is_ready():
            client.call_async(request).add_done_callback(lambda done: on_answer(done.result()))
        elif not quiet:
            self._answer(f"{name} does not answer; is {name.partition('/')[0]} running?")

    def _answer(self, text: str) -> None:
        self._board.answer(self.steady_s(), text)
        self.tell(ros.OK, text)

    # --- the tour ---

    def _make_tour(self) -> TargetTour:
        v = self.values
        candidates_m = load_model(find_file(v["model_path"])).ball_samples_m
        return TargetTour(candidates_m, v["tour_period_s"], v["tour_distance_m"], v["seed"])

    def _switch_tour(self, on: bool) -> None:
        try:
            self._tour = self._make_tour() if on else None
        except (OSError, ValueError) as error:
            self._answer(f"no tour: {error}")

    def _send_tour(self, now_s: float) -> None:
        if self._tour is None:
            return
        ready = self._board.controller(now_s).goes_to_targets
        target_m = self._tour.next(now_s, ready, self._board.ball_m(now_s))
        if target_m is not None:
            self._send_target(target_m)

    def finish(self) -> None:
        """Stop serving."""
        self._page.close()


def _make_page(values: dict[str, Any], actions: Actions) -> Any:
    """Serve the page; a ``ValueError`` says why that cannot be."""
    try:
        from fvs_ros.apps.dashboard.page import Page
    except ImportError as error:
        raise ValueError(
            f"the page needs {error.name}: pip install 'viser[urdf]' (extra dashboard of fvs_ros)"
        ) from error
    return Page(
        values["host"],
        values["port"],
        actions,
        history_s=values["history_s"],
        ball_radius_m=values["ball_radius_m"],
        image=values["image"],
    )


def main() -> int:
    """Run ``fvs_dashboard``."""
    return ros.run(DashboardNode)


if __name__ == "__main__":
    sys.exit(main())
