"""Whether a position is believed: the ball does not jump, unless it goes on being elsewhere."""

from __future__ import annotations

import numpy as np

#: On top of what the speed allows, for the noise of two positions, m.
_NOISE_M = 0.01


class Gate:
    """Refuses jumps that are seen only now and then.

    Attributes
    ----------
    max_speed_m_s : float
        Fastest ball, m/s.
    repeats : int
        A jump is believed when it is seen this many times in a row, each near the one before.
    refused : int
        How many positions were refused.
    """

    def __init__(self, max_speed_m_s: float, repeats: int) -> None:
        self.max_speed_m_s = max_speed_m_s
        self.repeats = repeats
        self.refused = 0
        self.reset()

    def reset(self) -> None:
        """Forget all positions: the next one is believed."""
        self._accepted: tuple[float, np.ndarray] | None = None
        self._candidate: tuple[float, np.ndarray] | None = None
        self._seen = 0

    def check(self, stamp_s: float, position_m: np.ndarray) -> str:
        """Judge a position.

        Parameters
        ----------
        stamp_s : float
            Its exposure, s.
        position_m : ndarray, shape (3,)
            Camera frame, m.

        Returns
        -------
        str
            Empty if it is believed, else why not.
        """
        if self._accepted is None or self._near(self._accepted, stamp_s, position_m):
            self._accept(stamp_s, position_m)
            return ""
        again = self._candidate is not None and self._near(self._candidate, stamp_s, position_m)
        self._seen = self._seen + 1 if again else 1
        self._candidate = (stamp_s, position_m)
        if self._seen >= self.repeats:
            self._accept(stamp_s, position_m)
            return ""
        self.refused += 1
        last_s, last_m = self._accepted
        return (
            f"a jump of {np.linalg.norm(position_m - last_m):.2f} m in {stamp_s - last_s:.3f} s is "
            f"faster than max_ball_speed_m_s ({self.max_speed_m_s:g}): believed when seen "
            f"{self.repeats} times in a row, now {self._seen}"
        )

    def _near(self, last: tuple[float, np.ndarray], stamp_s: float, position_m: np.ndarray) -> bool:
        allowed_m = self.max_speed_m_s * max(stamp_s - last[0], 0.0) + _NOISE_M
        return bool(np.linalg.norm(position_m - last[1]) <= allowed_m)

    def _accept(self, stamp_s: float, position_m: np.ndarray) -> None:
        self._accepted, self._candidate, self._seen = (stamp_s, position_m), None, 0
