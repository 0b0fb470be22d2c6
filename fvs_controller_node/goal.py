"""The target in force, where the ball is, and how the error between them goes."""

from __future__ import annotations

import numpy as np

from fvs_controller_node.progress import Progress
from fvs_controller_node.supervisor_config import SupervisorConfig
from fvs_ros.vectors import all_finite


class Goal:
    """Takes targets inside the workspace only, and follows the error to them.

    Parameters
    ----------
    config : SupervisorConfig
        Frame, workspace, and the limits of progress.

    Attributes
    ----------
    target_m : ndarray, shape (m,), or None
        Where the target is now, m.
    position_m : ndarray, shape (m,), or None
        Where the ball is now, m.
    progress : Progress
        How the error went since the start, or since another target.
    """

    def __init__(self, config: SupervisorConfig) -> None:
        self._config = config
        self.progress = Progress(config.progress)
        self.target_m: np.ndarray | None = None
        self._set_m: np.ndarray | None = None  # as it was set last
        self.position_m: np.ndarray | None = None

    def configure(self, config: SupervisorConfig) -> None:
        """Change the settings; a target that a new box leaves outside is dropped."""
        self._config = config
        self.progress.limits = config.progress
        if self.target_m is not None and self._outside(self.target_m):
            self.target_m = self._set_m = None

    def set(self, position_m: np.ndarray, frame: str, *, moving: bool = False) -> tuple[bool, str]:
        """Set the target; a refused one leaves the old in place.

        Parameters
        ----------
        position_m : ndarray, shape (m,)
            m.
        frame : str
            Its frame, to be checked.
        moving : bool
            Whether it goes on with the last one's motion.

        Returns
        -------
        bool
            Whether it was accepted.
        str
            What was done, or why not.
        """
        if frame != self._config.feature_frame:
            return False, "target refused: " + self._config.wrong_frame(frame)
        target = np.array(position_m, dtype=float)
        if target.shape != (self._config.features,) or not all_finite(target):
            return False, (
                f"target refused: expected {self._config.features} finite numbers, got {position_m}"
            )
        outside = self._outside(target)
        if outside:
            return False, (
                f"target refused: {', '.join(outside)} (workspace_min_m and workspace_max_m, "
                f"in {frame})"
            )
        if not moving:  # one on its way is no new task
            self.progress.take_target(target)
        self.target_m = self._set_m = target
        return True, "target set to ({:.3f}, {:.3f}, {:.3f}) m".format(*target.tolist())

    def was_set(self, position_m: np.ndarray) -> bool:
        """Whether a place, m, (m,), is the target that was set last."""
        return self._set_m is not None and np.array_equal(position_m, self._set_m)

    def track(self, position_m: np.ndarray) -> bool:
        """Take where the target is by now, m, (m,); False outside the workspace: it stays."""
        if self.target_m is None or self._outside(position_m):
            return False
        self.target_m = position_m
        return True

    def see(self, position_m: np.ndarray | None, dt_s: float, servoing: bool) -> None:
        """Take where the ball is after a tick, m, (m,); None where it is not known."""
        usable = position_m is not None and all_finite(position_m)
        self.position_m = position_m if usable else None
        error = self.error_m
        if error is not None:
            self.progress.add(error, dt_s, servoing, self.target_m)

    @property
    def error_m(self) -> np.ndarray | None:
        """Ball minus target, m, shape (m,), or None where one of them is unknown."""
        if self.position_m is None or self.target_m is None:
            return None
        return self.position_m - self.target_m

    @property
    def settled(self) -> bool:
        """Whether the ball has been on target for a while."""
        return self.error_m is not None and self.progress.settled

    def _outside(self, target: np.ndarray) -> list[str]:
        """Say which coordinates of a target are outside the workspace box."""
        low, high = self._config.workspace_min_m, self._config.workspace_max_m
        return [
            f"{axis} = {value:.3f} m is not in [{lo:g}, {hi:g}]"
            for axis, value, lo, hi in zip("xyz", target.tolist(), low, high, strict=True)
            if not lo <= value <= hi
        ]
