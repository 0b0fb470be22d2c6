"""``fvs_dashboard``: serves a page that shows and operates the loop."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from math import inf, nan
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String

from fvs_controller_node.references import References
from fvs_dashboard.board import OBJECT_PLACE, REFERENCE, Action, Board, Controller
from fvs_dashboard.clicks import shifted
from fvs_dashboard.config import PARAMETERS, VISER, DashboardConfig
from fvs_dashboard.picture import PANEL_PX, VIEW_PX, Picture
from fvs_estimator_node.files import TrainedModel, load_model
from fvs_ros import ros, topics
from fvs_ros.joints import JointMap, JointStateError
from fvs_ros.kinds.pose import Pose
from fvs_ros.paths import find_file
from fvs_ros.ros.images import from_color
from fvs_ros.ros.services import Services

_CAMERA_ROTATION = f"{topics.SIM}/camera_rotation_deg"
_JOINTS = "joint_names", "tf_prefix"
#: Parameters that the page shows.
_ASKED = {
    topics.CONTROLLER: (
        "law",
        "max_joint_velocity_rad_s",
        "reference",
        "references_path",
        *_JOINTS,
    ),
    topics.ESTIMATOR: ("method",),
    topics.SIM: ("depth_noise", "latency_s", "object_tag_id", *OBJECT_PLACE),
}
#: With these a person takes over from the tour.
_TAKES_OVER = ("target", "stop", "reset", "set_current_as_target", "go")
#: Services that do what a button for references says, in this order.
_VERBS = {"teach": ("teach",), "go": ("go_to_reference", "start")}


class DashboardNode(ros.FvsNode):
    """Updates the page at a steady rate while a browser shows it, and executes user actions."""

    def __init__(self) -> None:
        super().__init__("fvs_dashboard", PARAMETERS)
        v, self._config = self.values, DashboardConfig.from_values(self.values)
        self._kind = self._config.kind
        self._joint_map = JointMap(v["joint_names"], v["tf_prefix"])
        self._board = Board(v["joint_names"], self._kind)
        cameras = self._kind.cameras
        width_px = PANEL_PX if self._kind.rigid else VIEW_PX
        self._pictures = [Picture(width_px) for _ in cameras]
        self._actions: SimpleQueue[Action] = SimpleQueue()
        # Actions trigger a callback: polling at 30 Hz took 3 % of a core.
        self._wake = self.create_guard_condition(self._act)
        self._description = self._undrawn = ""
        self._references_read: tuple[Path, int] | None = None  # file, and when written
        self._calls = Services(self, self._answer)
        self._cameras: list[ros.Sampled] = []  # while a browser shows the page
        self._board.tour = self._config.tour
        #: Where ball or tag can be, camera frame, m, shape (n, m).
        self._trained: TrainedModel | None = None
        if self._config.model_path or self._config.tour:
            model = self._config.model_path or self._kind.model
            self._trained = load_model(find_file(model), expected=self._config)
        self._tour_due_s = -inf
        self._rng = np.random.default_rng()
        self._subscribe()
        try:
            from fvs_dashboard.page import Page
        except ImportError as error:
            words = f"the page needs {error.name}: pip install '{VISER}'"
            raise ValueError(f"{words} (extra dashboard of fvs_ros)") from error
        self._page = Page(self._config, self._put)
        self.create_timer(0.1, self._show, clock=self.steady_clock)
        self.create_timer(1.0, self._look_around, clock=self.steady_clock)
        print(f"page: {self._page.address}", flush=True)
        if self._page.open_to_others:
            self.tell(
                ros.WARN, "anybody who reaches this page can move the arm: it asks no password"
            )

    def _subscribe(self) -> None:
        kind = self._kind
        # Not latched: a controller that starts later must not move to an old target.
        self._targets = [
            self.create_publisher(ros.message_class(each.type), each.name, ros.QOS_EVENT)
            for each in (part.topics.target for part in kind.parts)
        ]
        self._truths: list[ros.Sampled] = []
        self._joint_states = ros.Sampled(
            self, JointState, topics.JOINT_STATES.name, self._on_joint_states
        )
        for camera, part in enumerate(kind.parts):
            on_feature = partial(self._on_feature, part.feature, "feature", camera)
            self.subscribe(part.feature, on_feature)
            truth, on_truth = part.truth, partial(self._on_feature, part.truth, "truth", camera)
            message = ros.message_class(truth.type)
            self._truths.append(ros.Sampled(self, message, truth.name, on_truth))
        self.subscribe(topics.CONTROLLER_STATUS, self._on_status)
        self.subscribe(topics.DETECTOR_STATUS, self._on_detector)
        if not kind.rigid:
            return
        self.subscribe(
            kind.topics.object, partial(self._on_feature, kind.topics.object, "object", 0)
        )
        self.subscribe(topics.ROBOT_DESCRIPTION, self._on_description)
        self.subscribe(topics.TRUE_CAMERA_POSE, self._on_camera_pose)
        with suppress(ImportError):  # without tf2_msgs
            self.subscribe(topics.TF_STATIC, self._on_transforms)

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
        self._board.add_joints(self.steady_s(), joints, velocity)
        if self._undrawn:
            self._draw_arm()

    def _on_feature(self, topic: topics.Topic, name: str, camera: int, message: Any) -> None:
        kind, frame = self._kind.parts[camera], self._config.feature_frame
        z = ros.from_feature(message, kind, frame, topic.name)
        self._board.note(name, self.steady_s(), z, camera)

    def _on_status(self, message: DiagnosticStatus) -> None:
        for truth in self._truths:  # of the same moment
            truth.look()
        controller = Controller(ros.from_status(message), message.message)
        self._board.add_status(self.steady_s(), controller)

    def _on_detector(self, message: DiagnosticStatus) -> None:
        self._board.note("detector", self.steady_s(), message.message)

    def _on_description(self, message: String) -> None:
        if message.data != self._description:  # it repeats when its publisher is rediscovered
            self._description = self._undrawn = message.data

    def _draw_arm(self) -> None:
        """Draw the arm, once its joints are known to be those of the joint states."""
        from fvs_dashboard.scene import Arm  # viser is installed, since the page is served

        text, self._undrawn = self._undrawn, ""
        try:
            arm = Arm(text, self._joint_map.names)
        except ValueError as error:
            text = f"the arm cannot be drawn: {error}"
        else:
            self._page.scene.set_arm(arm)
            text = arm.missing
        self._board.note("arm", self.steady_s(), text)
        if text:
            self.tell(ros.WARN, text)

    def _on_camera_pose(self, message: PoseStamped) -> None:
        frame = message.header.frame_id
        z = ros.from_feature(message, Pose(), frame, "the camera's pose")
        pose = np.eye(4)
        pose[:3, 3], pose[:3, :3] = z[:3], Pose().rotation(z)
        self._board.camera = frame, pose

    def _on_transforms(self, message: Any) -> None:
        for each in message.transforms:
            if each.child_frame_id == self._config.feature_frame:
                stamped = PoseStamped(header=each.header)
                at, shift = stamped.pose.position, each.transform.translation
                at.x, at.y, at.z = shift.x, shift.y, shift.z
                stamped.pose.orientation = each.transform.rotation
                self._on_camera_pose(stamped)

    def _on_image(self, camera: int, message: Image) -> None:
        stamp_s = ros.from_stamp(message.header.stamp)
        exposed_s = self.steady_s() - max(self.ros_s() - stamp_s, 0.0)
        self._pictures[camera].add_image(exposed_s, from_color(message))

    def _on_camera_info(self, message: CameraInfo) -> None:
        self._pictures[0].intrinsics = ros.from_camera_info(message).intrinsics

    # --- what is shown ---

    def _show(self) -> None:
        self._calls.repeat_stop()
        for topic in (self._joint_states, *self._cameras):
            topic.look()
        now_s = self.steady_s()
        self._send_tour(now_s)
        watched = self._page.watched
        # The first before a browser asks: a simulator takes seconds to begin to draw.
        wanted = watched or any(
            picture.published and not picture.size_px.any() for picture in self._pictures
        )
        if wanted != bool(self._cameras):
            self._look_at_images(wanted)
        if watched:
            self._page.update(self._board, self._pictures, now_s)

    def _look_at_images(self, wanted: bool) -> None:
        """Subscribe while they are wanted: the simulator draws images for subscribers only."""
        while self._cameras:
            self._cameras.pop().close()
        if not wanted:
            return
        inputs: list[tuple[type, str, Callable[[Any], None]]] = [
            (Image, name, partial(self._on_image, camera))
            for camera in range(len(self._pictures))
            for name in self._image_names(camera)
        ]
        if self._kind.rigid:
            infos = topics.camera_names(topics.CAMERA_INFO, self._config.camera_topics)
            inputs += [(CameraInfo, name, self._on_camera_info) for name in infos]
        self._cameras = [ros.Sampled(self, *each) for each in inputs]

    def _image_names(self, camera: int) -> list[str]:
        """Possible topics of a camera's images."""
        prefix, name = self._config.camera_topics, self._kind.cameras[camera]
        return topics.camera_names(topics.COLOR_IMAGE, prefix, name)

    def _look_around(self) -> None:
        """Query what has no topic: parameters of the other nodes, and publishers of images."""
        for camera, picture in enumerate(self._pictures):
            names = self._image_names(camera)
            published = [name for name in names if self.count_publishers(name)]
            picture.published = bool(published)
            picture.waits_for = (
                f"waiting for the first picture from {' or '.join(published)}"
                if published
                else f"no picture: no node publishes {' or '.join(names)}"
            )
        if not self._page.watched:
            return
        for node, parameters in _ASKED.items():
            self._calls.ask(node, parameters, partial(self._board.parameters.__setitem__, node))
        names, prefix = (self._board.parameter(topics.CONTROLLER, name) for name in _JOINTS)
        joints = self._joint_map if prefix is None else JointMap(names, prefix)
        if joints.names != self._joint_map.names:  # whatever this node's own parameters say
            self._joint_map, self._undrawn = joints, self._description
            self._board.name_joints(names)
        path = self._board.parameter(topics.CONTROLLER, "references_path")
        if isinstance(path, str):
            self._look_at_references(References(path, self._kind, self._joint_map.names))

    def _look_at_references(self, references: References) -> None:
        """Read them if their file changed, in a thread: a long file must not delay a stop."""
        board, path, written = self._board, references.path, 0
        with suppress(OSError, ValueError):  # no such file, or no name of one
            written = path.stat().st_mtime_ns

        def read() -> None:
            try:
                board.references = references.entries()
                board.references_problem = "" if written else f"nothing is taught in {path} yet"
            except ValueError as error:
                board.references, board.references_problem = {}, str(error)

        if (path, written) != self._references_read:
            self._references_read = path, written
            Thread(target=read, daemon=True).start()

    # --- what is done ---

    def _put(self, action: Action) -> None:
        """Have an action done, from any thread."""
        self._actions.put(action)
        self._wake.trigger()

    def _act(self) -> None:
        while not self._actions.empty():  # this is its only reader
            action = self._actions.get_nowait()
            self._board.note("answer", self.steady_s(), "")  # clears the previous answer
            self._do(action)

    def _do(self, action: Action) -> None:
        name = action.name
        if name in _TAKES_OVER:
            self._board.tour = False
        if name == "stop":
            self._calls.stop()
        elif name == "reset":
            self._calls.stop()
            if self._board.parameters.get(topics.SIM):
                self._calls.set(_CAMERA_ROTATION, (0.0, 0.0, 0.0))
                in_turn = [f"{topics.SIM}/reset"]
                if self._board.parameters.get(topics.CONTROLLER):
                    # In a session a position would lead the arm back.
                    in_turn.insert(0, f"{topics.CONTROLLER}/stop")
                self._calls.call(*in_turn)
            self._calls.call(f"{topics.ESTIMATOR}/reset")
        elif name == "bump":
            largest_deg = np.array([4.0, 4.0, 25.0])  # more about x and y would lose the ball
            rotation_deg = self._rng.uniform(-largest_deg, largest_deg)
            self._calls.set(_CAMERA_ROTATION, tuple(rotation_deg.tolist()))
        elif name == "tour":
            self._board.tour, self._tour_due_s = action.value, -inf
        elif "/" in name:
            self._calls.set(name, action.value)
        elif self._board.controller(self.steady_s()).silent:
            # Otherwise it would be executed when the controller returns, unexpectedly.
            self._answer(f"not done: the controller is silent; is {topics.CONTROLLER} running?")
        elif name in _VERBS:
            services = (f"{topics.CONTROLLER}/{verb}" for verb in _VERBS[name])
            self._calls.set(REFERENCE, action.value, *services)
        elif name == "target":
            self._aim(action.value)
        else:
            self._calls.call(f"{topics.CONTROLLER}/{name}")

    def _send_target(self, target: np.ndarray) -> None:
        parts, frame = self._kind.parts, self._config.feature_frame
        targets = np.split(target, len(parts))
        for publisher, part, z in zip(self._targets, parts, targets, strict=True):
            publisher.publish(ros.to_feature(self.ros_s(), frame, part, z))

    def _aim(self, numbers: Sequence[float]) -> None:
        """Send a user's target.

        Of image points, each camera's are shifted from where they are seen, so that the first is
        there.
        """
        target: np.ndarray | None
        if self._kind.rigid:
            rotation = Rotation.from_quat(np.roll(numbers[3:] or (1.0, 0.0, 0.0, 0.0), -1))
            target = self._kind.of_body(np.array(numbers[:3]), rotation.as_matrix())
        else:
            z = self._board.feature(self.steady_s())
            target = shifted(z, np.array(numbers), self._kind)
        if target is None:
            self._answer("not done: some points are not seen; where they shall be is unknown")
        else:
            self._send_target(target)

    def _answer(self, text: str) -> None:
        self._board.note("answer", self.steady_s(), text)
        self.tell(ros.OK, text)

    def _send_tour(self, now_s: float) -> None:
        """Send the next target when it is due."""
        if self._trained is None or not self._board.tour or now_s < self._tour_due_s:
            return
        z = self._board.feature(now_s)
        controller = self._board.controller(now_s)
        ready = controller.state == "SERVOING" or controller.reason == "NO_TARGET"
        if z is not None and ready:
            self._tour_due_s = now_s + 5.0
            self._send_target(self._trained.target(z, 0.3, self._rng))

    def finish(self) -> None:
        """Stop serving."""
        self._page.close()


def main() -> int:
    """Run ``fvs_dashboard``."""
    os.nice(5)  # behind the loop, but the buttons must work on a busy machine, too
    return ros.run(DashboardNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
