"""``fvs_sim_node``: a simulated arm and its cameras with the topics of the real ones."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Float64, Float64MultiArray, String
from std_srvs.srv import Trigger

from fvs_ros import ros, topics
from fvs_ros.interface import VELOCITY
from fvs_ros.kinds.pose import Pose
from fvs_ros.rotations import vector_from_rotation_rad
from fvs_sim_node.config import PARAMETERS, SimNodeConfig
from fvs_sim_node.frame_worker import FrameWorker
from fvs_sim_node.robot import robot_description, robot_of
from fvs_sim_node.simulation import Observation, SimStep, Simulation

#: In simulated time, services and parameters are served this often.
_BURST_S = 0.005
#: Until its first command, a node gets joint states this far apart, s: it answers none before.
_FIRST_S = 0.1
#: Topics of the responses to joint states, and largest simulated time without a new one, s; that
#: of a detector's.
_ANSWERS = {
    topics.COMMANDS.name: 0.0,
    topics.POSITION_COMMANDS.name: 0.0,
    topics.JACOBIAN.name: 0.1,
}
_DETECTED_S = 0.15


@dataclass
class _Camera:
    """What is published of a camera, and what draws its full frames in real time."""

    truth: Publisher
    feature: Publisher | None  # a detector publishes it
    color: Publisher
    worker: FrameWorker | None = None
    watched: bool = False
    exposed_s: float = -np.inf  # stamp of the newest full frame


class SimNode(ros.FvsNode):
    """Publishes joint states and what is servoed, obeys joint velocity commands."""

    keeps_subscriptions = True

    def __init__(self) -> None:
        super().__init__("fvs_sim_node", PARAMETERS)
        config = self._config = SimNodeConfig.from_values(self.values)
        self._frame = config.feature_frame
        self._sim = Simulation(config.simulation)
        names = self._sim.world.joint_names
        self._order = np.argsort(names)  # as a UR's broadcaster sends them
        self._names = [config.tf_prefix + names[i] for i in self._order]
        self._refusal = ""
        self._late = 0
        self._announced: bool | None = None
        self._paused_active: bool | None = None  # was the controller, when the pause began?
        self._joint_states = self.publisher(topics.JOINT_STATES)
        self._kind = self._sim.kind
        images = [topics.of_camera(topics.COLOR_IMAGE, name) for name in self._kind.cameras]
        self._cameras = [
            _Camera(
                self.publisher(part.truth),
                self.publisher(part.feature) if config.publish_ball_position else None,
                self.create_publisher(Image, image.name, ros.QOS_LARGE),
            )
            for part, image in zip(self._kind.parts, images, strict=True)
        ]
        if config.simulation.object_tag is not None:
            self._object_truth = self.publisher(self._kind.topics.object_truth)
            if config.publish_ball_position:
                self._object = self.publisher(self._kind.topics.object)
        self._camera_pose = self.publisher(topics.TRUE_CAMERA_POSE)
        self._transforms = self.publisher(topics.TF_STATIC) if find_spec("tf2_msgs") else None
        self._depth = self.create_publisher(Image, topics.DEPTH_IMAGE.name, ros.QOS_LARGE)
        self._info = self.publisher(topics.CAMERA_INFO)
        self._program_running = self.publisher(topics.ROBOT_PROGRAM_RUNNING)
        self._scaling = self.publisher(topics.SPEED_SCALING)
        description = self.publisher(topics.ROBOT_DESCRIPTION)
        which = config.simulation
        robot = robot_of(which.robot, which.urdf_path, which.ball_link)
        text = robot_description(robot, config.tf_prefix, lambda words: self.tell(ros.WARN, words))
        description.publish(String(data=text))
        by_velocity = which.command_interface == VELOCITY
        self._command_topic = topics.COMMANDS if by_velocity else topics.POSITION_COMMANDS
        self.subscribe(self._command_topic, self._on_command)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.on_parameters(self.values, {p.name for p in self.parameter_set if p.live})
        if self._kind.on_arm:  # the parameters say where the object is by default
            pose = self._sim.world.object_pose
            rotation_deg = np.degrees(vector_from_rotation_rad(pose.rotation))
            where = {"object_position_m": pose.position_m, "object_rotation_deg": rotation_deg}
            self.set_parameters([rclpy.Parameter(n, value=v.tolist()) for n, v in where.items()])
        self._keep_time(config)
        self.create_timer(ros.STATUS_PERIOD_S, self._publish_status, clock=self.steady_clock)

    # --- time ---

    def _keep_time(self, config: SimNodeConfig) -> None:
        """Let simulated time pass."""
        self._period_s = 1.0 / config.simulation.joint_state_rate_hz
        self._stepped_s = self.steady_s()
        self._commanded = False  # has a command arrived, of the nodes that publish them?
        self._answered_s: dict[str, float] = {}  # simulated time of the last answer on each topic
        if config.simulated_time:
            self._base_s = 1.0  # zero means "no time" to ROS
            self._clock_topic = self.publisher(topics.CLOCK)
            answers = [topics.JACOBIAN]
            if not config.publish_ball_position:  # a detector does
                answers += [part.feature for part in self._kind.parts]
            for topic in answers:
                self.subscribe(topic, partial(self._answer, topic.name), ros.QOS_RELIABLE)
            self.create_timer(_BURST_S, self._step_as_fast_as_it_goes, clock=self.steady_clock)
        else:
            self._base_s = self.ros_s()
            self._ahead_s = self._base_s - self.steady_s()
            self.create_timer(self._period_s, self._step_in_real_time, clock=self.steady_clock)

    def _step_in_real_time(self) -> None:
        behind_s = self.steady_s() + self._ahead_s - self._base_s - self._sim.time_s
        if behind_s > 0.2:  # skip this time rather than catch up
            self._late += 1
            self._base_s += behind_s
            behind_s = 0.0
        while behind_s >= self._period_s:  # no stamp lies in the future
            self._step()
            behind_s -= self._period_s

    def _step_as_fast_as_it_goes(self) -> None:
        end_s = self.steady_s() + _BURST_S
        while self.steady_s() < end_s and not self._waits():
            self._step()

    def _waits(self) -> bool:
        """Whether a response to the joint states is pending, at any speed of the machine."""
        late = [
            topic
            for topic, answered_s in self._answered_s.items()
            if self._simulated_s() - answered_s > _ANSWERS.get(topic, _DETECTED_S)
        ]
        # A busy computer keeps a node from running for less than three seconds. A node without a
        # response for longer counts as ended, until it responds again. The first command of one
        # that publishes them is on its way.
        waited_s = self.steady_s() - self._stepped_s
        awaits_first = waited_s < _FIRST_S and not self._commanded and self._has_commander()
        if awaits_first or (late and waited_s < 3.0):
            return True
        for topic in late:
            del self._answered_s[topic]
            self._late += 1
        return False

    def _has_commander(self) -> bool:
        return self.count_publishers(self.resolve_topic_name(self._command_topic.name)) > 0

    def _answer(self, topic: str, _message: Any = None) -> None:
        if self._config.simulated_time:
            self._answered_s[topic] = self._simulated_s()
            self._step_as_fast_as_it_goes()

    def _simulated_s(self) -> float:
        return self._base_s + self._sim.time_s

    def _step(self) -> None:
        step = self._sim.advance()
        stamp_s = self._base_s + step.time_s
        if self._config.simulated_time:
            self._clock_topic.publish(Clock(clock=ros.to_stamp(stamp_s)))
        for observation in step.observations:
            self._publish_observation(observation)
        if any(camera.truth.get_subscription_count() for camera in self._cameras):
            parts = np.split(self._sim.true_feature(), len(self._cameras))
            for camera, z in zip(self._cameras, parts, strict=True):
                camera.truth.publish(self._message(stamp_s, z))
        true_object = self._sim.true_object()
        if true_object is not None and self._object_truth.get_subscription_count():
            self._object_truth.publish(self._message(stamp_s, true_object))
        self._publish_joints(stamp_s, step)
        self._stepped_s = self.steady_s()
        self._publish_drawn_frames()  # after the joint states, which other nodes wait for

    # --- outputs ---

    def _message(self, stamp_s: float, z: np.ndarray) -> Any:
        return ros.to_feature(stamp_s, self._frame, self._kind, z)

    def _publish_joints(self, stamp_s: float, step: SimStep) -> None:
        message = ros.to_joint_state(
            stamp_s,
            self._names,
            step.joints_rad[self._order],
            step.joint_velocities_rad_s[self._order],
        )
        # A UR reports motor currents in `effort`; this arm has no gravity load.
        message.effort = [0.0] * len(self._names)
        self._joint_states.publish(message)

    def _publish_observation(self, observation: Observation) -> None:
        stamp_s, camera = self._base_s + observation.stamp_s, self._cameras[observation.number]
        if self._kind.rigid and self._info.get_subscription_count():  # a webcam sends none
            self._info.publish(
                ros.to_camera_info(stamp_s, self._frame, self._sim.reported_intrinsics)
            )
        if observation.z is not None and camera.feature is not None:
            camera.feature.publish(self._message(stamp_s, observation.z))
        if observation.object_z is not None and self._config.publish_ball_position:
            self._object.publish(self._message(stamp_s, observation.object_z))
        if observation.frame is not None:
            self._publish_frame(camera, stamp_s, *observation.frame)
        elif (
            camera.worker is not None
            and camera.watched
            and self._frame_is_due(camera, stamp_s)
            and camera.worker.expose(observation, self._sim.config)
        ):
            camera.exposed_s = stamp_s

    def _frame_is_due(self, camera: _Camera, stamp_s: float) -> bool:
        # Half an image's period of slack: exposures come at the image rate, with some jitter.
        slack_s = 0.5 / self._config.simulation.image_rate_hz
        return stamp_s - camera.exposed_s >= 1.0 / self._config.full_frame_rate_hz - slack_s

    def _publish_drawn_frames(self) -> None:
        for camera in self._cameras:
            frame = camera.worker and camera.worker.finished()
            if frame:
                self._publish_frame(camera, camera.exposed_s, *frame)

    def _publish_frame(
        self, camera: _Camera, stamp_s: float, rgb: np.ndarray, depth_m: np.ndarray
    ) -> None:
        if camera.color.get_subscription_count():
            camera.color.publish(ros.to_image(stamp_s, self._frame, rgb, "rgb8"))
        if self._kind.rigid and self._depth.get_subscription_count():
            millimetres = np.round(depth_m * 1e3).clip(0, 65535).astype(np.uint16)
            self._depth.publish(ros.to_image(stamp_s, self._frame, millimetres, "16UC1"))

    def _look_for_subscribers(self) -> None:
        """Render full frames only while a node receives them."""
        for camera in self._cameras:
            camera.watched = any(
                publisher.get_subscription_count() for publisher in (camera.color, self._depth)
            )
            if camera.watched and camera.worker is None and not self._config.simulated_time:
                camera.worker = FrameWorker(self._sim.config)
        if self._config.simulated_time:
            self._sim.full_frames = any(camera.watched for camera in self._cameras)
            self._commanded = self._commanded and self._has_commander()

    # --- inputs ---

    def _on_command(self, message: Float64MultiArray) -> None:
        self._commanded = True
        # While the program is paused the velocity controller is inactive and ignores commands.
        if self._paused_active is None:
            self._refusal = self._sim.command(np.array(message.data, dtype=float)) or ""
        if self._refusal:
            self.get_logger().error(self._refusal, throttle_duration_sec=5.0)
        self._answer(self._command_topic.name)

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response):
        # The simulation begins at zero again; the stamps go on.
        self._base_s += self._sim.time_s
        self._sim.reset()
        self._refusal = ""
        if self._paused_active is not None:
            self._paused_active = True
            self._sim.deactivate()
        response.success, response.message = True, "the arm is back at initial_joints_rad"
        return response

    def on_parameters(self, values: dict[str, Any], changed: set[str]) -> None:
        """Take disturbances into use at once."""
        config = self._config = SimNodeConfig.from_values(values)
        self._sim.configure(config.simulation)
        if changed & {"object_position_m", "object_rotation_deg"}:
            self._sim.place_object()
        if "camera_rotation_deg" in changed:
            frame = config.tf_prefix + self._sim.world.camera_link
            camera = self._sim.views[0].mounted
            z = Pose().of_body(camera.position_m, camera.rotation)
            pose = ros.to_feature(self.ros_s(), frame, Pose(), z)
            self._camera_pose.publish(pose)
            self._publish_transform(pose)
        self._play_program(config.program_running)

    def _publish_transform(self, pose: PoseStamped) -> None:
        """Publish the camera's pose on ``/tf_static``, if ``tf2_msgs`` is installed."""
        if self._transforms is not None:
            transform = TransformStamped(header=pose.header, child_frame_id=self._frame)
            at, to = pose.pose.position, transform.transform.translation
            to.x, to.y, to.z = at.x, at.y, at.z
            transform.transform.rotation = pose.pose.orientation
            message = ros.message_class(topics.TF_STATIC.type)(transforms=[transform])
            self._transforms.publish(message)

    def _play_program(self, running: bool) -> None:
        """Mimic a UR driver when the robot program stops and when it resumes.

        The driver deactivates the velocity controller, whose command is lost, and later reactivates
        it, unless a bad command had deactivated it before.
        """
        if not running and self._paused_active is None:
            self._paused_active = self._sim.active
            self._sim.deactivate()
        elif running and self._paused_active is not None:
            self._sim.active, self._paused_active = self._paused_active, None
        if running != self._announced:
            self._announced = running
            self._program_running.publish(Bool(data=running))

    # --- status ---

    def _publish_status(self) -> None:
        self._look_for_subscribers()
        self._scaling.publish(Float64(data=self._config.simulation.speed_scaling_percent))
        level, state, reason = ros.OK, "RUNNING", "simulating"
        if self._refusal:
            level, state, reason = ros.ERROR, "REFUSED", self._refusal
        elif not self._config.program_running:
            level, state, reason = ros.WARN, "PAUSED", "program_running is false: the arm stands"
        self.publish_status(
            level,
            state,
            reason,
            {
                "simulated_s": self._sim.time_s,
                "late_ticks": self._late,
                "full_frames": any(camera.watched for camera in self._cameras),
            },
        )

    def finish(self) -> None:
        """Close PyBullet."""
        for camera in self._cameras:
            if camera.worker is not None:
                camera.worker.close()
        self._sim.close()


def main() -> int:
    """Run ``fvs_sim_node``."""
    return ros.run(SimNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
