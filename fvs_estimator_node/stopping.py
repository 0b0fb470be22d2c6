"""Ends a collection early, once a fitted chain determines the Jacobian well enough. No ROS.

A fit takes a second and would delay the 125 Hz commands. So each one runs in its own process (this
module as a program): arrays in on standard input, a line of JSON out. If it fails, the collection
continues.
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from typing import Any

import numpy as np

from fvs_ros.kinds import KindConfig
from fvs_ros.paths import program
from fvs_ros.timeline import Sample

#: Time of the first fit, and least time to the next one, s of motion.
_FIRST_S, _PERIOD_S = 12.0, 4.0
_COMMAND = program("fvs_estimator_node.stopping")


class StopCriterion:
    """Fits chains to what was collected so far, one after the other, without waiting for them.

    ``stop_at_error`` is the relative standard deviation of the Jacobian that is good enough; 0 fits
    nothing. ``feature`` is the kind of what is measured. ``enough`` is whether two consecutive fits
    reached it, ``trouble`` explains why fitting has ended, and ``found`` holds the newest fit's
    figures.
    """

    def __init__(
        self,
        stop_at_error: float,
        feature: str = KindConfig.feature,
        command: Sequence[str] = _COMMAND,
    ) -> None:
        self._stop_at_error, self._command = stop_at_error, tuple(command)
        self._feature = feature
        self._next_s, self._good = _FIRST_S, 0
        self._fit: subprocess.Popen[bytes] | None = None
        self.enough, self.trouble = False, ""
        self.found: dict[str, Any] = {}

    def look(self, time_s: float, samples: Sequence[Sample], box_rad: np.ndarray) -> None:
        """Start a fit, or take its answer, if it is due; never waits.

        Takes the time of the motion, s, all samples so far, and the motion box, rad, (2, n).
        """
        if self.enough or self.trouble or self._stop_at_error <= 0.0:
            return
        try:
            if self._fit is None and time_s >= self._next_s and samples:
                self._next_s = time_s + _PERIOD_S
                with tempfile.TemporaryFile() as content:
                    columns = map(np.array, zip(*samples, strict=True))
                    np.savez(content, box_rad, *columns, feature=self._feature)
                    content.seek(0)
                    self._fit = subprocess.Popen(
                        self._command,
                        stdin=content,
                        stdout=subprocess.PIPE,
                        stderr=subprocess.PIPE,
                        start_new_session=True,  # Ctrl-C is the collector's affair
                    )
            elif self._fit is not None and self._fit.poll() is not None:
                ended, self._fit = self._fit, None
                self._take(*ended.communicate(), ended.returncode)
        except Exception as error:  # the collector reports any failure and continues
            self.trouble = f"the chain fit failed: {error}"

    def _take(self, out: bytes, complaint: bytes, exit_code: int) -> None:
        if exit_code != 0:
            raise RuntimeError(f"exit code {exit_code} {complaint[-200:].decode(errors='replace')}")
        answer = dict(json.loads(out.splitlines()[-1]))
        self.found = answer or self.found
        good = answer.get("is_chain") and answer["jacobian_deviation"] < self._stop_at_error
        self._good = self._good + 1 if good else 0
        self.enough = self._good >= 2

    def words(self) -> str:
        """What is known; empty if nothing is."""
        percent = 100.0 * self.found.get("jacobian_deviation", 0.0)
        return f"Jacobian known to {percent:.2g} %" if self.found else ""


def _examine(feature: np.ndarray, box_rad: np.ndarray, *columns: Any) -> dict[str, Any]:
    """Fit a chain to the columns of samples; its accuracy in a box, empty if not known yet."""
    from fvs_estimator_node.chain_fit import fit_chain
    from fvs_estimator_node.files import DataSet

    places = np.random.default_rng(0).uniform(box_rad[0], box_rad[1], (100, box_rad.shape[1]))
    try:
        fit = fit_chain(DataSet(*columns, feature=str(feature)))
        deviation = float(np.median(fit.jacobian_deviation(places)))
    except ValueError:  # no chain yet, or numbers too bad for linear algebra
        return {}
    found = {"jacobian_deviation": deviation, "misfit": fit.misfit, "is_chain": fit.is_chain}
    return {**found, "image_offset_s": fit.time_offset_s}


if __name__ == "__main__":
    os.nice(10)  # the commands come first where there are too few cores
    signal.alarm(120)  # a longer fit hangs, and ends itself
    arrays = np.load(io.BytesIO(sys.stdin.buffer.read()))
    feature, *columns = (arrays[name] for name in arrays.files)
    print(json.dumps(_examine(feature, *columns)))
