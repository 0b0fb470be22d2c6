"""``fvs_demo_node``: sends targets to the controller, and scores and plots the truth."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from collections.abc import Generator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fvs_estimator_node.files import load_model
from fvs_ros import ros, topics
from fvs_ros.joints import JointMap, JointStateError
from fvs_ros.paths import find_file, output_file
from fvs_ros.ros.services import Services
from fvs_ros.vectors import length
from fvs_tools import demo


class DemoNode(ros.FvsNode):
    """Runs the demo's targets one after another."""

    def __init__(self) -> None:
        super().__init__("fvs_demo_node", demo.PARAMETERS)
        self._config = config = demo.DemoConfig.from_values(self.values)
        self._kind = kind = config.kind
        self._figure = output_file(Path(config.output_dir) / "demo.png")
        self._trained = load_model(find_file(config.model_path or kind.model), expected=config)
        self._rng = np.random.default_rng(config.seed)
        self._joint_map = JointMap(self._trained.joint_names, config.tf_prefix)
        self._records: list[demo.TargetRecord] = []
        self._state = self._reason = ""
        self._wants_target = False
        self._began_s: float | np.ndarray = np.inf  # both clocks at the controller's first status
        print("waiting for the controller", flush=True)
        self._stop = self.create_client(Trigger, "fvs_controller_node/stop")
        self._targets = [self.publisher(part.topics.target) for part in kind.parts]
        self.subscribe(topics.CONTROLLER_STATUS, self._on_status)
        #: Each camera's newest truth, and its stamp.
        self._truths = [(np.nan, np.zeros(0)) for _ in kind.parts]
        for camera, truth in enumerate(part.truth for part in kind.parts):
            on_truth = partial(self._on_truth, camera)
            self.watch(ros.message_class(truth.type), truth.name, on_truth, ros.QOS_EVERY)
        self._task = self._run()
        next(self._task)
        if config.relative:
            self._operator = Services(self, partial(print, flush=True))
        if config.relative and not kind.on_arm:
            self._tool: tuple[float, np.ndarray] | None = None  # newest truth, and its stamp
            truth, on_object = kind.topics.object_truth, self._on_object_truth
            self.watch(ros.message_class(truth.type), truth.name, on_object, ros.QOS_EVERY)
        self.subscribe(topics.JOINT_STATES, self._on_joint_states)
        self.create_timer(0.1, self._poll, clock=self.steady_clock)

    # --- inputs ---

    def _on_status(self, message: DiagnosticStatus) -> None:
        values = ros.from_status(message)
        state, before = values.get("state", ""), self._state
        if not before:
            self._began_s = self._clocks_s()
        self._state, self._reason = state, message.message
        if self._records:
            record = self._records[-1]
            if state not in ("SERVOING", "READY", before) and not record.note:
                print(f"controller {state}: {message.message}", flush=True)
            if values.get("reason") in ("STALE", "RETURNING"):
                record.note = "slowed: inputs came late"
        self._wants_target = values.get("reason") == "NO_TARGET"

    def _on_joint_states(self, message: JointState) -> None:
        if self._records:
            try:
                velocity = self._joint_map.positions(message.name, message.velocity)
            except JointStateError:  # of another arm, or without velocities
                return
            record = self._records[-1]
            moment_s = ros.from_stamp(message.header.stamp) - record.start_s
            record.joints.append((moment_s, velocity))

    def _on_truth(self, camera: int, message: Any) -> None:
        self._truths[camera] = self._read(message, self._kind.parts[camera].truth)
        stamps_s, parts = zip(*self._truths, strict=True)
        stamp_s, z = stamps_s[camera], np.concatenate(parts)
        if any(other_s != stamp_s for other_s in stamps_s):
            return
        if self._config.relative and not self._kind.on_arm:
            self._tool = stamp_s, z
        else:
            self._take(stamp_s, self._kind.inverse(z) if self._config.relative else z)

    def _on_object_truth(self, message: Any) -> None:
        stamp_s, object_z = self._read(message, self._kind.topics.object_truth)
        if self._tool is not None and self._tool[0] == stamp_s:
            self._take(stamp_s, self._kind.relative(self._tool[1], object_z))

    def _read(self, message: Any, topic: topics.Topic) -> tuple[float, np.ndarray]:
        kind, frame = self._kind.parts[0], self._config.feature_frame
        z = ros.from_feature(message, kind, frame, topic.name)
        return ros.from_stamp(message.header.stamp), z

    def _take(self, stamp_s: float, z: np.ndarray) -> None:
        """Take the truth, in the camera's or the object's frame."""
        if self.exit_code is None:
            self._task.send((stamp_s, z))

    # --- the task ---

    def _run(self) -> Generator[None, tuple[float, np.ndarray], None]:
        """One target after another, each scored over its time, from stamps and truths."""
        config = self._config
        stamp_s, z = yield
        # The controller lacks only a target: the loop is ready for the first one.
        while not self._wants_target:
            stamp_s, z = yield
        taught, asked_s, home = z, -np.inf, dict[str, Any]()
        while config.relative and (self._wants_target or not home):
            if self._wants_target:
                taught, now_s = z, self.steady_s()
                if now_s - asked_s > 0.5:  # the images of a second come first
                    asked_s = now_s
                    self._operator.ask(topics.SIM, demo.OBJECT, home.update)
                    self._operator.call(
                        f"{topics.CONTROLLER}/teach", f"{topics.CONTROLLER}/go_to_reference"
                    )
            stamp_s, z = yield
        for number in range(1, config.targets + 1):
            if config.relative:
                jump = demo.jump_of_object(home, self._kind, self._rng)
                for name, value in jump.items():
                    self._operator.set(f"{topics.SIM}/{name}", value)
                while length(self._kind.minus(z, taught)) < 0.01:
                    stamp_s, z = yield
            target = taught if config.relative else self._send_target(stamp_s, z)
            record = demo.TargetRecord(self._kind, target, stamp_s, truths=[(0.0, z)])
            self._records.append(record)
            while record.truths[-1][0] < config.target_s:
                stamp_s, z = yield
                record.truths.append((stamp_s - record.start_s, z))
            self._report(number, record)
        self._conclude()
        yield

    def _send_target(self, stamp_s: float, z: np.ndarray) -> np.ndarray:
        target = self._trained.target(z, self._config.distance_m, self._rng)
        frame = self._config.feature_frame
        parts = np.split(target, len(self._targets))
        for publisher, part in zip(self._targets, parts, strict=True):
            publisher.publish(ros.to_feature(stamp_s, frame, self._kind, part))
        return target

    def _report(self, number: int, record: demo.TargetRecord) -> None:
        score = record.score()
        settled_s = score.settling_5mm_s
        text = "not settled" if settled_s is None else f"settled after {settled_s:.2f} s"
        print(
            f"target {number} of {self._config.targets}, "
            f"{self._kind.length_text(score.start_distance_m)} away: {text}, "
            f"final true error {score.final(self._kind)}",
            flush=True,
        )

    def _clocks_s(self) -> np.ndarray:
        """Both times, s: a busy machine slows the loop's, an idle simulator hurries it."""
        return np.array([self.steady_s(), self.now_s()])

    def _poll(self) -> None:
        waited_s = np.min(self._clocks_s() - self._began_s)
        if not self._records and waited_s > demo.START_TIMEOUT_S:
            print(f"the loop did not get ready: {self._state} {self._reason}", flush=True)
            self.exit_code = stop.EXIT_FAILURE
        late_s = self.monitor(self._kind.parts[0].truth.name).age_s(self.now_s())
        if self._records and late_s > 5.0:
            print(f"the simulator has been silent for {late_s:.0f} s", flush=True)
            self.exit_code = stop.EXIT_FAILURE

    # --- figure and table ---

    def _conclude(self) -> None:
        self._stop.call_async(Trigger.Request())
        demo.write_results(self._figure.parent, self._records)
        demo.draw(self._figure, self._records, self._joint_map.names)
        print(f"figure: {self._figure}\n\n{demo.table(self._records)}\n", flush=True)
        settled = all(each.score().settling_5mm_s is not None for each in self._records)
        self.exit_code = stop.EXIT_OK if settled else stop.EXIT_FAILURE


def main() -> int:
    """Run ``fvs_demo_node``."""
    return ros.run(DemoNode, __doc__, demo.PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
