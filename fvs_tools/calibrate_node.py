"""``fvs_calibrate_node``: calibrates the camera while anything moves the arm; moves nothing."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from fvs_estimator_node.files import data_set_of
from fvs_ros import ros, topics
from fvs_ros.joints import ForeignJointsError, JointMap, JointStateError
from fvs_ros.paths import output_file
from fvs_ros.timeline import Sample, Timeline
from fvs_ros.urdf import read_joints
from fvs_tools.calibration import PARAMETERS, CalibrateConfig, calibrate, report, verdict, write
from fvs_tools.hand_eye import Estimate
from fvs_tools.kinematics import Kinematics, kinematics

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
        self._path, self._kind = output_file(config.output_path), config.kind
        self._timeline, self._samples = Timeline(), list[Sample]()
        self._arm: Kinematics | None = None
        self._joint_map: JointMap | None = None
        self._worker = ThreadPoolExecutor(1)
        self._estimate: Estimate | None = None
        self._reason = "waiting for the robot's description"
        #: Why joints and feature are not taken; empty while they are.
        self._no_joints = f"no {topics.JOINT_STATES.name} yet"
        self._no_feature = f"no {self._kind.feature.name} yet"
        if config.urdf_path:
            self._describe(Path(config.urdf_path).read_bytes())
        else:
            self.subscribe(topics.ROBOT_DESCRIPTION, self._on_description)
        self.subscribe(topics.JOINT_STATES, self._on_joint_states)
        self.subscribe(self._kind.feature, self._on_feature)
        self._phases = self._run()
        self.create_timer(_POLL_S, lambda: next(self._phases, None), clock=self.steady_clock)
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
            z = ros.from_feature(message, kind, frame, kind.feature.name)
        except ros.MessageError as error:
            self._no_feature = str(error)
            raise
        self._no_feature = ""
        self._add(self._timeline.add_image(ros.from_stamp(message.header.stamp), z))

    def _add(self, samples: list[Sample]) -> None:
        self._samples += samples[: _MOST - len(self._samples)]

    # --- phases ---

    @property
    def _motion_s(self) -> float:
        """Time of the images so far, s."""
        return self._samples[-1].stamp_s - self._samples[0].stamp_s if self._samples else 0.0

    def _run(self) -> Iterator[None]:
        """Collect and calibrate until that is good enough, or took too long; then conclude."""
        while self._arm is None or not self._samples:
            yield
        ends_s = self.now_s() + self._config.duration_s
        good, next_s = 0, _FIRST_S
        while good < 2:
            while (late := self.now_s() > ends_s) is False and self._motion_s < next_s:
                yield
            next_s = self._motion_s + _PERIOD_S
            data = data_set_of(
                list(self._samples),
                joint_names=self._arm.names,
                feature_frame=self._config.feature_frame,
                feature=self._config.feature,
            )
            job = self._worker.submit(calibrate, data, self._arm, self._kind.on_arm)
            while not job.done():
                yield
            try:
                estimate = job.result()
            except ValueError as error:
                # What was found before may be of a camera that has moved since.
                self._estimate, self._reason, good = None, str(error)[:400], 0
            else:
                self._estimate, self._reason = estimate, verdict(estimate)[1]
                limits = self._config.stop_at_m, self._config.stop_at_rad
                enough = np.less((estimate.deviation_m, estimate.deviation_rad), limits).all()
                good = good + 1 if enough else 0
            if late:
                break
        self._conclude()

    def _conclude(self) -> None:
        """Write the estimate."""
        estimate = self._estimate
        if estimate is None:
            print(f"no calibration: {self._waits_for}", file=sys.stderr, flush=True)
            self.exit_code = stop.EXIT_FAILURE
            return
        write(estimate, self._path)
        print(f"{report(estimate)}\nwritten to {self._path}", flush=True)
        unusable = verdict(estimate)[0] == "unusable"
        self.exit_code = stop.EXIT_FAILURE if unusable else stop.EXIT_OK

    @property
    def _waits_for(self) -> str:
        """The reason in words; first what keeps it from collecting."""
        waits = "" if self._arm is None else self._no_joints or self._no_feature
        return waits[:400] or self._reason

    def _publish_status(self) -> None:
        estimate = self._estimate
        values = {
            "images": len(self._samples),
            "motion_s": self._motion_s,
            "deviation_m": None if estimate is None else estimate.deviation_m,
            "deviation_rad": None if estimate is None else estimate.deviation_rad,
        }
        level = ros.OK if estimate and verdict(estimate)[0] == "good" else ros.WARN
        self.publish_status(level, "CALIBRATING", self._waits_for, values)

    def finish(self) -> None:
        """When interrupted, write what is known."""
        if next(self._phases, True) is None and self.exit_code is None:
            self._conclude()
        self._worker.shutdown(wait=False, cancel_futures=True)


def main() -> int:
    """Run ``fvs_calibrate_node``."""
    return ros.run(CalibrateNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
