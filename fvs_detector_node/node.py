"""``fvs_detector_node``: images of cameras in, ball or tag out, and an object with tags."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import sys
from typing import Any

from fvs_detector_node.camera_node import FAULT, LOST, TRACKING, WAITING, CameraWatch
from fvs_detector_node.config import PARAMETERS, DetectorConfig
from fvs_ros import ros

#: The worst first.
_STATES = FAULT, WAITING, LOST, TRACKING
_LEVELS = {TRACKING: ros.OK, FAULT: ros.ERROR}


class DetectorNode(ros.FvsNode):
    """Publishes the ball's position, or the tag's pose, from every image with a good detection."""

    def __init__(self) -> None:
        super().__init__("fvs_detector_node", PARAMETERS)
        self._config = config = DetectorConfig.from_values(self.values)
        self._watches = {name: CameraWatch(self, part) for name, part in config.parts.items()}
        # Log delay: discovery of a camera takes a moment, and a barely visible ball flickers.
        self._logged, self._logged_s = "", self.now_s()
        for watch in self._watches.values():
            self.create_timer(1.0, watch.look_for_camera, clock=self.steady_clock)
        self.create_timer(ros.STATUS_PERIOD_S, self._publish_status, clock=self.steady_clock)

    def on_parameters(self, values: dict[str, Any], changed: set[str]) -> None:
        """Take changed parameters into use at once."""
        config = DetectorConfig.from_values(values)
        # Of several cameras only the one whose patches were set begins anew.
        anew = "track_px" in changed and config.track_px == self._config.track_px
        for name, part in config.parts.items():
            self._watches[name].configure(part, anew)
        self._config = config

    def _publish_status(self) -> None:
        """Publish the worst camera's status."""
        now_s = self.now_s()
        judged = [(*watch.judge(now_s), name) for name, watch in self._watches.items()]
        state, reason, name = min(judged, key=lambda each: _STATES.index(each[0]))
        watch, reason = self._watches[name], f"{name}: {reason}" if name else reason
        level = max(_LEVELS.get(state, ros.WARN), watch.level)
        # The status shows every change of state, the log only lasting ones.
        if state != self._logged and now_s - self._logged_s > 3.0:
            self._logged, self._logged_s = state, now_s
            self.tell(level, f"{state}: {reason}")
        self.publish_status(level, state, reason, watch.status_values(now_s, state))


def main() -> int:
    """Run ``fvs_detector_node``."""
    return ros.run(DetectorNode, __doc__, PARAMETERS)


if __name__ == "__main__":
    sys.exit(main())
