"""A process that fits chains beside the collector, and how the collector speaks to it.

A fit takes a second and would hold the 125 Hz commands up. The process reads pickled questions
from its standard input and writes pickled answers to its standard output. It ends with its input,
so it never outlives the collector for long; and it is killed, not asked, when the collector ends.
Whatever becomes of it, the collector goes on without it.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from typing import IO, BinaryIO

from fvs_estimator_node.knowledge import Answer, Findings, NothingYet, Question, Trouble
from fvs_ros.paths import program

_COMMAND = program("fvs_estimator_node.chain_worker")
#: A fit that takes more of the processor hangs; one that takes longer by the clock gets too little
#: of it, or waits for ever. The process is ended by its own timers, s.
_PROCESSOR_S, _LONGEST_S = 60.0, 600.0
_ENDS = {
    -signal.SIGPROF: f"the fit hangs: it took more than {_PROCESSOR_S:.0f} s of the processor",
    -signal.SIGALRM: "the fit got too little of the processor: "
    f"it was not done within {_LONGEST_S:.0f} s",
}
#: The commands come first where there are too few cores; but somebody waits for the fit.
_NICENESS = 10
#: How long a killed process is waited for, s.
_KILLED_S = 0.5
#: So much of what it wrote to its standard error last is read, bytes.
_LAST_BYTES = 2000


class ChainWorker:
    """Asks the process; no call waits for it. It is started by the first question.

    A plain child with pipes and no ``concurrent.futures`` pool: a pool's child imports the main
    module again and so ROS, outlives a killed parent, and is waited for at the parent's end.

    Parameters
    ----------
    command : sequence of str
        What to run.
    """

    def __init__(self, command: Sequence[str] = _COMMAND) -> None:
        self._command = tuple(command)
        self._process: subprocess.Popen[bytes] | None = None
        self._said: IO[bytes] | None = None
        self._answer: Answer | None = None

    def ask(self, question: Question) -> None:
        """Send a question."""
        self._answer = None
        words = pickle.dumps(question)
        try:
            threading.Thread(target=self._converse, args=(words,), daemon=True).start()
        except RuntimeError as error:
            self._answer = Trouble(f"{error}")

    def answer(self) -> Answer | None:
        """Answer the last question, or None for not yet."""
        return self._answer

    def close(self) -> None:
        """Kill the process, whatever it is doing."""
        process = self._process
        if process is not None:
            process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):  # nobody can do more
                process.wait(_KILLED_S)

    def _converse(self, words: bytes) -> None:
        try:
            answer = self._exchanged(words)
        except Exception as error:
            self.close()
            self._answer = Trouble(self._why(error))
        else:
            self._answer = answer

    def _why(self, error: Exception) -> str:
        if self._process is None:
            return f"the process that fits chains failed: {error!r}"
        code = self._process.returncode
        if code in _ENDS:
            return _ENDS[code]
        # A pipe's end says nothing; what the process said before it does.
        ended = isinstance(error, EOFError | BrokenPipeError)
        why = (ended and self._last_words()) or repr(error)
        return f"the process that fits chains failed (exit code {code}): {why}"

    def _last_words(self) -> str:
        """The last line that the process wrote to its standard error; empty if none."""
        if self._said is None:
            return ""
        self._said.seek(max(self._said.seek(0, os.SEEK_END) - _LAST_BYTES, 0))
        lines = self._said.read().decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")

    def _exchanged(self, words: bytes) -> Answer:
        if self._process is None:
            # A file and no pipe, which somebody would have to read before it is full.
            self._said = tempfile.TemporaryFile()  # noqa: SIM115
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._said,
                start_new_session=True,  # Ctrl-C is the collector's affair
                env={**os.environ, "OMP_NUM_THREADS": "1"},
            )
        questions, answers = self._process.stdin, self._process.stdout
        assert questions is not None
        assert answers is not None
        questions.write(words)
        questions.flush()
        answer = pickle.load(answers)
        if not isinstance(answer, (Findings, NothingYet, Trouble)):
            raise TypeError(f"{answer!r} is no answer")
        return answer


def serve(questions: BinaryIO, answers: BinaryIO) -> None:
    """Answer questions until there are no more."""
    examine = None
    while True:
        try:
            question = pickle.load(questions)
        except EOFError:
            return
        answer: Answer
        _set_timers(_PROCESSOR_S, _LONGEST_S)
        try:
            if examine is None:
                from fvs_estimator_node.excitation import ChainExaminer

                examine = ChainExaminer().findings
            answer = examine(question)
        except Exception as error:  # whatever it is, the collector shall hear of it
            answer = Trouble(f"fitting a chain failed: {error!r}")
        _set_timers(0.0, 0.0)
        pickle.dump(answer, answers)
        answers.flush()


def _set_timers(processor_s: float, longest_s: float) -> None:
    signal.setitimer(signal.ITIMER_PROF, processor_s)
    signal.setitimer(signal.ITIMER_REAL, longest_s)


def main() -> None:
    """Run the process."""
    os.nice(_NICENESS)
    # What is printed must not get between the answers.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    serve(sys.stdin.buffer, answers)


if __name__ == "__main__":
    main()
