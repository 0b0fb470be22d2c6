"""``fvs_calibrate_node``: calibrates the camera while anything moves the arm; moves nothing."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import Any

from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String

from fvs_estimator_node.calibration import Calibration
from fvs_estimator_node.files import DataSet, data_set_of
from fvs_estimator_node.hand_eye import calibrate
from fvs_ros import ros, topics
from fvs_ros.camera import CameraModel
from fvs_ros.joints import ForeignJointsError, JointMap, JointStateError
from fvs_ros.kinds.pose import Pose
from fvs_ros.ros.images import from_color, sampled_camera
from fvs_ros.timeline import Sample, Timeline
from fvs_ros.urdf import Kinematics, kinematics, read_joints
from fvs_tools.calibrate import report, write
from fvs_tools.calibrating import PARAMETERS, CalibrateConfig
from fvs_tools.overlay import Photograph

_POLL_S = 0.5
#: First calibration after this time of motion, s, and least time to the next one.
_FIRST_S, _PERIOD_S = 15.0, 5.0
#: Most samples that are kept: an hour at 60 Hz.
_MOST = 216_000


class CalibrateNode(ros.FvsNode):
    """Collects joints and images, calibrates again and again, and ends when that is good enough."""

    def __init__(self) -> None:
        super().__init__("fvs_calibrate_node", PARAMETERS)
        self._config = config = CalibrateConfig.from_values(self.values)
        self._path = Path(config.output_path)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._kind = config.kind
        self._timeline, self._samples = Timeline(), list[Sample]()
        self._arm: Kinematics | None = None
        self._joint_map: JointMap | None = None
        self._worker = ThreadPoolExecutor(1)
        self._job: Future[Calibration] | None = None
        self._found: Calibration | None = None
        self._next_s, self._good = _FIRST_S, 0
        #: Whether the newest calibration had all the time that it may have.
        self._last = self._done = False
        #: Why joints and feature are not taken; empty while they are.
        self._no_joints = f"no {topics.JOINT_STATES.name} yet"
        self._no_feature = f"no {self._kind.topics.tool.name} yet"
        self._began_s = inf
        self._reason = "waiting for the robot's description"
        self._transforms: Any = None
        #: One image and its camera, for the picture; subscribed to only until they are there.
        self._images: list[ros.Sampled] = []
        self._camera: CameraModel | None = None
        self._photo: Photograph | None = None
        self._data: DataSet | None = None
        if config.urdf_path:
            self._describe(Path(config.urdf_path).read_bytes())
        else:
            self.subscribe(topics.ROBOT_DESCRIPTION, self._on_description)
        self.subscribe(topics.JOINT_STATES, self._on_joint_states)
        self.subscribe(self._kind.topics.tool, self._on_feature)
        self.create_timer(_POLL_S, self._poll, clock=self.steady_clock)
        self.create_timer(ros.STATUS_PERIOD_S, self._publish_status, clock=self.steady_clock)

    # --- inputs ---

    def _on_description(self, message: String) -> None:
        if self._arm is None:
            try:
                self._describe(message.data)
            except ValueError as error:
                self._reason = f"robot_description: {error}"

    def _describe(self, text: str | bytes) -> None:
        self._arm = kinematics(read_joints(text), self._config.tip_link)
        self._joint_map = JointMap(self._arm.names)
        self._reason = "collecting"

    def _on_joint_states(self, message: JointState) -> None:
        if self._joint_map is None:
            return
        stamp_s = ros.from_stamp(message.header.stamp)
        try:
            joints = self._joint_map.positions(message.name, message.position, stamp_s)
        except JointStateError as error:
            # Another device's say nothing, once the arm's are there.
            if self._no_joints or not isinstance(error, ForeignJointsError):
                self._no_joints = str(error)
            return
        self._no_joints = ""
        self._add(self._timeline.add_joints(stamp_s, joints))

    def _on_feature(self, message: Any) -> None:
        kind, frame = self._kind, self._config.feature_frame
        try:
            z = ros.from_feature(message, kind, frame, kind.topics.tool.name)
        except ros.MessageError as error:
            self._no_feature = str(error)
            raise
        self._no_feature = ""
        self._add(self._timeline.add_image(ros.from_stamp(message.header.stamp), z))

    def _look(self) -> None:
        prefix = self._config.camera_topics
        self._images = sampled_camera(self, prefix, self._on_image, self._on_camera_info)

    def _on_camera_info(self, message: CameraInfo) -> None:
        self._camera = ros.from_camera_info(message)

    def _on_image(self, message: Image) -> None:
        if self._camera is None or message.header.frame_id != self._config.feature_frame:
            return
        stamp_s = ros.from_stamp(message.header.stamp)
        self._photo = Photograph.of(from_color(message), self._camera, stamp_s)

    def _add(self, samples: list[Sample]) -> None:
        if samples:
            self._began_s = min(self._began_s, self.now_s())
        self._samples += samples[: _MOST - len(self._samples)]

    # --- calibrating ---

    @property
    def _time_s(self) -> float:
        """Time of the images so far, s."""
        some = self._samples
        return some[-1].stamp_s - some[0].stamp_s if some else 0.0

    def _poll(self) -> None:
        if self.exit_code is not None or self._done:
            return
        for one in self._images:
            with suppress(ValueError):  # the picture does without
                one.look()
        while self._images and self._photo is not None:
            self._images.pop().close()
        if self._job is not None and self._job.done():
            self._take(self._job)
            self._job = None
        if self._job is not None:
            return
        late = self.now_s() - self._began_s > self._config.duration_s
        if self._good >= 2 or self._last:
            self._conclude()
        elif self._arm is not None and (late or self._time_s >= self._next_s):
            if self._data is None:
                self._look()
            self._next_s, self._last = self._time_s + _PERIOD_S, late
            self._data = data = data_set_of(
                list(self._samples),
                joint_names=self._arm.names,
                feature_frame=self._config.feature_frame,
                feature=self._config.feature,
            )
            self._job = self._worker.submit(calibrate, data, self._arm, self._config.camera_on_arm)

    def _take(self, job: Future[Calibration]) -> None:
        try:
            self._found = found = job.result()
        except ValueError as error:
            # What was found before may be of a camera that has moved since.
            self._found, self._reason, self._good = None, str(error)[:400], 0
            return
        self._reason = found.verdict[1]
        limits = self._config.stop_at_m, self._config.stop_at_rad
        good = found.deviation_m < limits[0] and found.deviation_rad < limits[1]
        self._good = self._good + 1 if good else 0

    def _conclude(self) -> None:
        """Write and publish what was found."""
        found = self._found
        if found is None or self._data is None:
            print(f"no calibration: {self._waits_for}", file=sys.stderr, flush=True)
            self.exit_code = stop.EXIT_FAILURE
            return
        write(found, self._path, self._data, self._photo)
        print(f"{report(found, self._photo)}\nwritten to {self._path}", flush=True)
        unusable = found.verdict[0] == "unusable"
        if not unusable and self._config.stay and self._publish_transform(found):
            self._done, self._reason = True, "the transform is on /tf_static"
        else:
            self.exit_code = stop.EXIT_FAILURE if unusable else stop.EXIT_OK

    def _publish_transform(self, found: Calibration) -> bool:
        """Publish it for as long as the node runs; False if that is not possible."""
        z = Pose().of_body(found.translation_m, found.rotation)
        pose = ros.to_feature(self.ros_s(), found.arm.root, Pose(), z)
        if self.publish_transform(pose, found.camera):
            return True
        print("tf2_msgs is not installed: publish it by the command above", file=sys.stderr)
        return False

    @property
    def _waits_for(self) -> str:
        """The reason in words; first what keeps it from collecting."""
        waits = "" if self._arm is None or self._done else self._no_joints or self._no_feature
        return waits[:400] or self._reason

    def _publish_status(self) -> None:
        found = self._found
        values = {
            "images": len(self._samples),
            "motion_s": self._time_s,
            "deviation_m": None if found is None else found.deviation_m,
            "deviation_rad": None if found is None else found.deviation_rad,
        }
        level = ros.WARN if found is None or found.verdict[0] != "good" else ros.OK
        self.publish_status(level, "CALIBRATING", self._waits_for, values)

    def finish(self) -> None:
        """When interrupted, write what is known."""
        if self.exit_code is None and not self._done:
            self._conclude()
        self._worker.shutdown(wait=False, cancel_futures=True)


def main() -> int:
    """Run ``fvs_calibrate_node``."""
    return ros.run(CalibrateNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
