"""``fvs_collector_node``: moves the joints randomly and safely, records a training data set."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from datetime import datetime, timezone
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64
from tqdm import tqdm

from fvs_estimator_node.collecting import PARAMETERS, CollectionRun, CollectorConfig, State
from fvs_estimator_node.files import data_set_of, save_data_set
from fvs_ros import ros, topics
from fvs_ros.joints import ForeignJointsError, JointMap, JointStateError
from fvs_ros.paths import output_file

_MIN_SAMPLES = 30
_PUBLISHERS_PERIOD_S = 0.25


class CollectorNode(ros.FvsNode):
    """Ticks at every joint state, like the controller; ends by itself."""

    def __init__(self) -> None:
        super().__init__("fvs_collector_node", PARAMETERS)
        self._config = config = CollectorConfig.from_values(self.values)
        self._path = output_file(config.output_path)
        self._joint_map = JointMap(config.joint_names, config.tf_prefix)
        self._run = CollectionRun(config)
        self._bar = tqdm(
            total=config.duration_s,
            desc="collecting",
            bar_format="{desc} {percentage:3.0f}%|{bar:30}| {n:.0f} of {total:.0f} s{postfix}",
            mininterval=0.2 if sys.stderr.isatty() else 10.0,
        )
        self._commands = ros.CommandPublisher(self)
        self._joints: np.ndarray | None = None
        self.subscribe(topics.JOINT_STATES, self._on_joint_states)
        for camera, part in enumerate(config.kind.parts):
            take = partial(self._run.image, camera=camera)
            self.subscribe_feature(part.feature, part, take, self._run.fail)
        self.subscribe(topics.ROBOT_PROGRAM_RUNNING, self._on_program_running)
        self.subscribe(topics.SPEED_SCALING, self._on_speed_scaling)
        ros.LimitsReader(self, self._take_limits, self._run.fail)
        self._ticker = ros.Ticker(self, self._tick, config.joint_state_rate_hz)
        self.create_timer(ros.STATUS_PERIOD_S, self._publish_status, clock=self.steady_clock)
        self.create_timer(
            _PUBLISHERS_PERIOD_S, self._find_other_publishers, clock=self.steady_clock
        )

    # --- inputs ---

    def _on_joint_states(self, message: JointState) -> None:
        now_s, stamp_s = self.now_s(), ros.from_stamp(message.header.stamp)
        try:
            joints = self._joint_map.positions(message.name, message.position, stamp_s)
        except ForeignJointsError:
            return  # another device's joints; the run reports it if ours never arrive
        except JointStateError as error:
            self._run.fail(str(error))
            return
        self._joints = joints
        self._run.joint_states(now_s, stamp_s, joints)
        self._ticker.on_joint_state(now_s, stamp_s)

    def _on_program_running(self, message: Bool) -> None:
        if not message.data:
            self._run.fail("the robot program is not running; start it, then collect again")

    def _on_speed_scaling(self, message: Float64) -> None:
        if not message.data > 0.0:
            self._run.fail(f"the robot's speed scaling is {message.data:g} %, not above 0")
        else:
            self._run.speed_scaling(min(message.data, 100.0) / 100.0)

    def _take_limits(self, values: dict[str, Any]) -> None:
        self._run.configure(CollectorConfig.from_values(values))

    def _find_other_publishers(self) -> None:
        self._run.other_publishers(self.other_publishers(self._commands.topic.name))

    # --- the tick: the only place that sends commands ---

    def _tick(self, now_s: float, dt_s: float) -> np.ndarray:
        run = self._run
        velocity = run.tick(now_s, dt_s)
        self._commands.send(velocity, self._joints, dt_s, run.config, run.moves)
        if run.ended and self.exit_code is None:
            self._conclude()
        return velocity

    def _conclude(self) -> None:
        self._show_progress()
        self._bar.close()
        failed = self._run.state is State.FAILED
        if failed:
            print(f"collecting failed: {self._run.reason}", file=sys.stderr)
        self.exit_code = stop.EXIT_OK if self._write() and not failed else stop.EXIT_FAILURE

    def _write(self) -> bool:
        """Write what was recorded; False if it is too little."""
        samples = self._run.samples
        fewest = min(map(len, samples))
        if fewest < _MIN_SAMPLES:
            why = self._run.image_trouble
            print(f"{fewest} positions are too few to be written{why}", file=sys.stderr)
            return False
        data = data_set_of(
            *samples,
            joint_names=self._config.joint_names,
            feature_frame=self._config.feature_frame,
            feature=self._config.feature,
            camera_mount=self._config.camera_mount,
            cameras=self._config.kind.cameras,
            provenance={
                "collected": datetime.now(timezone.utc).isoformat(timespec="seconds"),
                "simulated_time": self.get_parameter("use_sim_time").value,
                "parameters": self.values,
                "ended": self._run.reason if self._run.ended else "interrupted",
            },
        )
        save_data_set(self._path, data)
        print(f"{len(data)} positions written to {self._path}", flush=True)
        return True

    # --- status ---

    def tell(self, level: bytes, text: str) -> None:
        """Log on a line of its own, beside the progress bar."""
        with tqdm.external_write_mode():
            super().tell(level, text)

    @property
    def _positions(self) -> int:
        return sum(map(len, self._run.samples))

    def _show_progress(self) -> None:
        self._bar.n = self._run.progress * self._config.duration_s
        words = f"{self._positions} positions, {self._run.reason}"
        self._bar.set_postfix_str(words, refresh=False)
        self._bar.update(0)

    def _publish_status(self) -> None:
        run = self._run
        level = {State.FAILED: ros.ERROR, State.MOVING: ros.OK, State.DONE: ros.OK}
        values = {"progress": run.progress, "positions": self._positions}
        self.publish_status(level.get(run.state, ros.WARN), run.state.value, run.reason, values)
        self._show_progress()

    def finish(self) -> None:
        """Come to rest and send zeros last; when interrupted, save the recording."""
        interrupted, self.exit_code = self.exit_code is None, self.exit_code or stop.EXIT_OK
        self._ticker.end(self._run.interrupt(), self._commands)
        if interrupted:
            self._bar.close()
            self._write()


def main() -> int:
    """Run ``fvs_collector_node``."""
    return ros.run(CollectorNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
