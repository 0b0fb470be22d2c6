"""Model of a UR's drives, from velocity command to joint motion: delay, ramps, lag, stops."""

from __future__ import annotations

from collections import deque

import numpy as np

from fvs_sim_node.config import SimConfig


class Actuator:
    """Velocity drives in discrete time; they hold the last command indefinitely.

    A drive samples its command once per joint-state period. Periods and dead time are rounded to
    whole physics steps. A later ``config`` applies at once, except for its rates. A joint stops
    instantly at its limits, shape (n,).
    """

    def __init__(
        self,
        config: SimConfig,
        lower_rad: np.ndarray,
        upper_rad: np.ndarray,
        max_speed_rad_s: np.ndarray,
    ) -> None:
        self._dt_s = 1.0 / config.physics_rate_hz
        self._lower_rad = np.array(lower_rad, dtype=float)
        self._upper_rad = np.array(upper_rad, dtype=float)
        self._max_speed_rad_s = np.array(max_speed_rad_s, dtype=float)
        self._period_steps = round(config.physics_rate_hz / config.joint_state_rate_hz)
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Standstill, with a zero command."""
        zeros = np.zeros(self._lower_rad.shape)
        self._step = 0
        self._pending: deque[tuple[int, np.ndarray]] = deque()
        self._command = self._in_effect = zeros
        self._ramped = self._lagged = self._velocity = zeros
        self.play_rad = zeros  #: of the motors ahead of their joints, (n,)

    def command(self, velocity_rad_s: np.ndarray) -> None:
        """Set the command that holds until the next one, rad/s, shape (n,)."""
        self._command = np.array(velocity_rad_s, dtype=float)

    def step(self, positions_rad: np.ndarray) -> np.ndarray:
        """Velocities to hold during the next step, rad/s, from joint angles now, rad; both (n,)."""
        config = self.config
        if self._step % self._period_steps == 0:
            dead_steps = round(config.dead_time_s / self._dt_s)
            self._pending.append((self._step + dead_steps, self._command))
        while self._pending and self._pending[0][0] <= self._step:
            self._in_effect = self._pending.popleft()[1]
        self._step += 1

        fastest = self._max_speed_rad_s
        scaling = config.speed_scaling_percent / 100.0
        limited = (self._in_effect * scaling).clip(-fastest, fastest)
        change, largest = limited - self._ramped, config.acceleration_limit_rad_s2 * self._dt_s
        self._ramped = self._ramped + change.clip(-largest, largest)
        self._lagged = self._lagged + self._share_of(config.lag_s) * (self._ramped - self._lagged)
        unstopped = self._lagged
        if config.joint_lag_s > 0.0:
            behind = self._lagged - self._velocity
            unstopped = self._velocity + self._share_of(config.joint_lag_s) * behind
        fastest_up = np.maximum(self._upper_rad - positions_rad, 0.0) / self._dt_s
        fastest_down = np.minimum(self._lower_rad - positions_rad, 0.0) / self._dt_s
        self._velocity = unstopped.clip(fastest_down, fastest_up)
        stopped = self._velocity != unstopped
        if stopped.any():
            self._ramped = np.where(stopped, self._velocity, self._ramped)
            self._lagged = np.where(stopped, self._velocity, self._lagged)
        half = 0.5 * config.backlash_rad
        before = self.play_rad
        self.play_rad = (before + self._dt_s * self._velocity).clip(-half, half)
        return self._velocity - (self.play_rad - before) / self._dt_s

    def _share_of(self, lag_s: float) -> float:
        """Share of a first-order step response that one step of the physics brings."""
        return float(1.0 - np.exp(-self._dt_s / lag_s)) if lag_s > 0.0 else 1.0
