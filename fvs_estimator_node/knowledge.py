"""What is known of the chain while it is being collected: when to ask, and what follows. No ROS.

Every few seconds of motion somebody else (a process of its own, see ``chain_worker.py``) is asked
to fit a chain to all that was recorded. From what it finds follow the next course of the motion,
which excites what is known worst, and the end, once all is known well enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from typing import Protocol

from fvs_estimator_node.motion import Course, RandomMotion
from fvs_estimator_node.pairing import BallSample

#: When a chain is fitted first, and how much later the next time at the earliest, s of motion.
FIRST_S, PERIOD_S = 12.0, 4.0
#: So many fits in a row have to say that it is enough.
_AGREEING = 2


@dataclass(frozen=True)
class Question:
    """What was recorded since the last question, and the motion as it is now.

    Parameters
    ----------
    samples : tuple of BallSample
        Those not told before.
    motion : RandomMotion
        The motion.
    time_s : float
        Its time, s.
    """

    samples: tuple[BallSample, ...]
    motion: RandomMotion
    time_s: float


@dataclass(frozen=True)
class Findings:
    """What a fit says.

    Parameters
    ----------
    jacobian_deviation : float
        Relative standard deviation of the Jacobian in the motion's box, the median over the box.
    misfit : float
        Residual over noise: 1 for a serial chain; NaN if the images are too far apart to tell.
    image_offset_s : float
        How late the images are stamped, s.
    is_chain : bool
        Whether the ball moves as on a chain of six revolute joints, as far as can be told.
    course : Course
        Where the motion learns most.
    """

    jacobian_deviation: float
    misfit: float
    image_offset_s: float
    is_chain: bool
    course: Course


@dataclass(frozen=True)
class NothingYet:
    """No chain can be fitted so far; ask again later."""


@dataclass(frozen=True)
class Trouble:
    """No answer will come any more; why, in words."""

    reason: str


Answer = Findings | NothingYet | Trouble


class Examiner(Protocol):
    """Who is asked. Neither call waits for anything."""

    def ask(self, question: Question) -> None:
        """Take a question; the one before has been answered."""

    def answer(self) -> Answer | None:
        """Answer the question, or None for not yet."""


class Knowledge:
    """Decides when to ask, and what follows from the answer.

    Parameters
    ----------
    stop_at_error : float
        Relative standard deviation of the Jacobian that is good enough.
    examiner : Examiner
        Who is asked.

    Attributes
    ----------
    findings : Findings or None
        The newest.
    trouble : str
        Why nothing more will be found, empty if all is well.
    enough : bool
        Whether the chain is known well enough.
    """

    def __init__(self, stop_at_error: float, examiner: Examiner) -> None:
        self._stop_at_error = stop_at_error
        self._examiner = examiner
        self._next_s = FIRST_S
        self._told = 0
        self._waiting = False
        self._good = 0
        self.findings: Findings | None = None
        self.trouble = ""
        self.enough = False

    def look(self, time_s: float, samples: Sequence[BallSample], motion: RandomMotion) -> None:
        """Ask or hear, if it is time; the motion is changed over or ended early.

        Parameters
        ----------
        time_s : float
            The motion's time, s.
        samples : sequence of BallSample
            All that was recorded.
        motion : RandomMotion
            The motion that goes on.
        """
        if self.enough or self.trouble:
            return
        if self._waiting:
            answer = self._examiner.answer()
            if answer is not None:
                self._waiting = False
                self._hear(answer, time_s, motion)
        elif time_s >= self._next_s and len(samples) > self._told:
            self._next_s = time_s + PERIOD_S
            self._examiner.ask(Question(tuple(samples[self._told :]), motion, time_s))
            self._told, self._waiting = len(samples), True

    def _hear(self, answer: Answer, time_s: float, motion: RandomMotion) -> None:
        if isinstance(answer, Trouble):
            self.trouble = answer.reason
        elif isinstance(answer, Findings):
            self.findings = answer
            good = answer.is_chain and answer.jacobian_deviation < self._stop_at_error
            self._good = self._good + 1 if good else 0
            self.enough = self._good >= _AGREEING
            if self.enough:
                motion.end_early(time_s)
            else:
                motion.change_over(answer.course, time_s)
        else:
            self._good = 0

    def words(self) -> str:
        """What is known, for a user; empty if nothing is."""
        if self.findings is None:
            return ""
        words = f"Jacobian known to {100.0 * self.findings.jacobian_deviation:.2g} %"
        if isnan(self.findings.misfit) and not self.findings.is_chain:
            words += " if this is a serial chain, which so few images a second do not tell"
        return words
