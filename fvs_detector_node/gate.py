"""Whether a position is believed: the ball does not jump, unless it goes on being elsewhere."""

from __future__ import annotations

import numpy as np

#: On top of what the speed allows, for the noise of two positions, m.
_NOISE_M = 0.01
#: A jump is believed when it is seen this many times in a row, each near the one before.
REPEATS = 3


class Gate:
    """Refuses jumps that are seen only now and then.

    Attributes
    ----------
    max_speed_m_s : float
        Fastest ball, m/s.
    refused : int
        How many positions were refused.
    """

    def __init__(self, max_speed_m_s: float) -> None:
        self.max_speed_m_s = max_speed_m_s
        self.refused = 0
        self.reset()

    def reset(self) -> None:
        """Forget all positions: the next one is believed."""
        self._believed: tuple[float, np.ndarray] | None = None
        self._jumps: list[tuple[float, np.ndarray]] = []

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
        seen = (stamp_s, position_m)
        if self._believed is not None and not self._near(self._believed, seen):
            again = bool(self._jumps) and self._near(self._jumps[-1], seen)
            self._jumps = [*self._jumps, seen] if again else [seen]
            if len(self._jumps) < REPEATS:
                self.refused += 1
                last_s, last_m = self._believed
                return (
                    f"a jump of {np.linalg.norm(position_m - last_m):.2f} m in "
                    f"{stamp_s - last_s:.3f} s is not believed: seen {len(self._jumps)} of "
                    f"{REPEATS} times; raise max_ball_speed_m_s ({self.max_speed_m_s:g})?"
                )
        self._believed, self._jumps = seen, []
        return ""

    def _near(self, last: tuple[float, np.ndarray], seen: tuple[float, np.ndarray]) -> bool:
        allowed_m = self.max_speed_m_s * max(seen[0] - last[0], 0.0) + _NOISE_M
        return bool(np.linalg.norm(seen[1] - last[1]) <= allowed_m)
