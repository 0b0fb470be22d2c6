"""Ends a collection early, once a chain fitted to it knows the Jacobian well enough. No ROS.

A fit takes a second and would hold the 125 Hz commands up, so each runs in a process of its own
(this module as a program): a data set in on its standard input, a line of JSON out. Whatever
becomes of it, the collection goes on.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from math import isnan
from typing import Any

import numpy as np

from fvs_estimator_node.dataset import data_set_of
from fvs_ros.paths import program
from fvs_ros.timeline import Sample

#: When a chain is fitted first, and how much later the next time at the earliest, s of motion.
_FIRST_S, _PERIOD_S = 12.0, 4.0
#: This many fits in a row have to agree that it is enough.
_AGREEING = 2
#: Joints in the box at which the Jacobian's deviation is evaluated.
_PLACES = 100
#: A longer fit hangs; its own timer ends it, s.
_LONGEST_S = 120
#: What of a data set is given to it.
_FIELDS = ("stamps_s", "joints_rad", "ball_m", "segment")
_COMMAND = program("fvs_estimator_node.stopping")


class StopCriterion:
    """Fits chains to what was collected so far, one after the other, without waiting for them.

    Parameters
    ----------
    stop_at_error : float
        Relative standard deviation of the Jacobian that is good enough.
    command : sequence of str
        The program that fits.

    Attributes
    ----------
    enough : bool
        Whether the chain is known well enough.
    trouble : str
        Why there will be no more fits; empty if all is well.
    found : dict
        The newest fit's ``jacobian_deviation``, ``misfit``, ``image_offset_s``, ``is_chain``;
        empty before.
    """

    def __init__(self, stop_at_error: float, command: Sequence[str] = _COMMAND) -> None:
        self._stop_at_error = stop_at_error
        self._command = tuple(command)
        self._next_s, self._good = _FIRST_S, 0
        self._thread: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._answer: dict[str, Any] = {}
        self.enough, self.trouble = False, ""
        self.found: dict[str, Any] = {}

    def look(self, time_s: float, samples: Sequence[Sample], box_rad: np.ndarray) -> None:
        """Start a fit, or take its answer, if it is time; never waits.

        Parameters
        ----------
        time_s : float
            Time of the motion, s.
        samples : sequence of Sample
            All that was recorded.
        box_rad : ndarray, shape (2, n)
            Least and greatest joints of the motion, rad.
        """
        if self.enough or self.trouble:
            return
        if self._thread is None:
            if time_s >= self._next_s and samples:
                self._next_s = time_s + _PERIOD_S
                given = list(samples), box_rad
                self._thread = threading.Thread(target=self._fit, args=given, daemon=True)
                self._thread.start()
        elif not self._thread.is_alive():
            self._thread = None
            self._take(self._answer)

    def _take(self, answer: dict[str, Any]) -> None:
        self.trouble = answer.pop("trouble", "")
        self.found = answer or self.found
        good = answer.get("is_chain") and answer["jacobian_deviation"] < self._stop_at_error
        self._good = self._good + 1 if good else 0
        self.enough = self._good >= _AGREEING

    def _fit(self, samples: list[Sample], box_rad: np.ndarray) -> None:
        """Run the program; in a thread."""
        try:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is the collector's affair
                env={**os.environ, "OMP_NUM_THREADS": "1"},
            )
            data = data_set_of(samples)
            arrays = {name: getattr(data, name) for name in _FIELDS}
            content = io.BytesIO()
            np.savez(content, box_rad=box_rad, **arrays)
            said, complaint = self._process.communicate(content.getvalue())
            if self._process.returncode != 0:
                last = complaint.decode(errors="replace").strip().rpartition("\n")[2]
                raise RuntimeError(f"exit code {self._process.returncode} {last}".strip())
            self._answer = dict(json.loads(said.splitlines()[-1]))
        except Exception as error:  # whatever it is, the collector says it and goes on
            self._answer = {"trouble": f"the chain fit failed: {error}"}

    def close(self) -> None:
        """Kill a fit that is running."""
        if self._process is not None:
            with contextlib.suppress(OSError):
                self._process.kill()

    def words(self) -> str:
        """What is known; empty if nothing is."""
        if not self.found:
            return ""
        words = f"Jacobian known to {100.0 * self.found['jacobian_deviation']:.2g} %"
        if isnan(self.found["misfit"]) and not self.found["is_chain"]:
            words += " if this is a serial chain: too few images a second to tell"
        return words


def examine(content: dict[str, Any]) -> dict[str, Any]:
    """Fit a chain to a data set's arrays and say how well it is known in ``box_rad``.

    Empty where no chain can be fitted yet.
    """
    from fvs_estimator_node.chain_fit import fit_chain
    from fvs_estimator_node.dataset import DataSet

    low, high = content["box_rad"]
    places = np.random.default_rng(0).uniform(low, high, (_PLACES, len(low)))
    try:
        fit = fit_chain(DataSet(**{name: content[name] for name in _FIELDS}))
        deviation = float(np.median(fit.jacobian_deviation(places)))
    except ValueError:  # no chain yet, or numbers too bad for linear algebra
        return {}
    return {
        "jacobian_deviation": deviation,
        "misfit": fit.misfit,
        "image_offset_s": fit.time_offset_s,
        "is_chain": bool(fit.is_chain),
    }


def main() -> None:
    """Fit a chain to the data set on standard input; the last line of output is the answer."""
    signal.alarm(_LONGEST_S)
    os.nice(10)  # the commands come first where there are too few cores
    print(json.dumps(examine(dict(np.load(io.BytesIO(sys.stdin.buffer.read()))))))


if __name__ == "__main__":
    main()
