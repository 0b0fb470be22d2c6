"""A process that fits chains, and everything that may become of it."""

import io
import pickle
import signal
import subprocess
import sys
import time

import pytest
from recordings import Recording
from test_excitation import motion_of, samples_of

from fvs_estimator_node.chain_worker import ChainWorker, serve
from fvs_estimator_node.knowledge import Findings, NothingYet, Question, Trouble

#: A worker whose fits take their time.
SLOW = """
import time
import fvs_estimator_node.chain_worker as worker
from fvs_estimator_node.excitation import ChainExaminer
from fvs_estimator_node.knowledge import NothingYet
def compute():
    while True:
        pass
ChainExaminer.findings = lambda self, question: {what} or NothingYet()
worker._PROCESSOR_S, worker._LONGEST_S = {processor_s}, {longest_s}
worker.main()
"""
HANGING = SLOW.format(what="compute()", processor_s=0.5, longest_s=20.0)
STARVED = SLOW.format(what="time.sleep(100.0)", processor_s=20.0, longest_s=1.0)
WAITING = SLOW.format(what="time.sleep(2.5)", processor_s=2.0, longest_s=20.0)

#: One whose fits print, as libraries do.
PRINTING = """
import fvs_estimator_node.chain_worker as worker
from fvs_estimator_node.excitation import ChainExaminer
from fvs_estimator_node.knowledge import NothingYet
ChainExaminer.findings = lambda self, question: print("careful!", flush=True) or NothingYet()
worker.main()
"""
ANSWERING_3 = """
import pickle, sys
pickle.load(sys.stdin.buffer)
pickle.dump(3, sys.stdout.buffer)
"""


def question(**changes):
    samples = samples_of(Recording(seconds=14.0).data())
    return Question(**{"samples": samples, "motion": motion_of(0), "time_s": 14.0, **changes})


def answer_of(worker, seconds=30.0):
    deadline = time.monotonic() + seconds
    while worker.answer() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    return worker.answer()


@pytest.fixture
def make_worker():
    workers = []

    def make(*command):
        workers.append(ChainWorker(command) if command else ChainWorker())
        return workers[-1]

    yield make
    for worker in workers:
        worker.close()


def test_it_answers_and_no_call_waits(make_worker):
    worker = make_worker()
    asked = question()
    began = time.thread_time()  # of this thread, whatever else the machine does
    worker.ask(asked)
    assert worker.answer() is None
    assert time.thread_time() - began < 0.5
    first = answer_of(worker)
    assert isinstance(first, Findings), first
    worker.ask(question(samples=()))
    again = answer_of(worker)
    assert again.misfit == pytest.approx(first.misfit)  # it remembers the samples
    worker.close()
    worker.ask(asked)
    assert isinstance(answer_of(worker), Trouble)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("sh", "-c", "exit 3"), "exit code 3"),
        (
            (sys.executable, "-c", "import no_such_library"),
            "(exit code 1): ModuleNotFoundError: No module named 'no_such_library'",
        ),
        (("sh", "-c", "head -c 100 > /dev/null; kill -9 $$"), "exit code -9"),
        (("no such program",), "FileNotFoundError"),
        (("sh", "-c", "echo nonsense; cat > /dev/null"), "UnpicklingError"),
        ((sys.executable, "-c", ANSWERING_3), "3 is no answer"),
        ((sys.executable, "-c", HANGING), "the fit hangs"),
        ((sys.executable, "-c", STARVED), "the fit got too little of the processor"),
    ],
    ids=[
        "ends",
        "cannot import",
        "is killed",
        "is missing",
        "babbles",
        "gives no answer",
        "hangs in a fit",
        "starves",
    ],
)
def test_a_process_that_fails_is_a_trouble_told_in_words(make_worker, command, words):
    worker = make_worker(*command)
    worker.ask(question())
    answer = answer_of(worker)
    assert isinstance(answer, Trouble)
    assert words in answer.reason


def test_a_fit_that_waits_for_the_processor_may_take_its_time(make_worker):
    worker = make_worker(sys.executable, "-c", WAITING)
    worker.ask(question())
    assert answer_of(worker) == NothingYet()


def test_what_a_fit_prints_does_not_get_into_the_answers(make_worker):
    worker = make_worker(sys.executable, "-c", PRINTING)
    worker.ask(question())
    assert answer_of(worker) == NothingYet()


def test_a_process_that_never_answers_holds_nothing_up(make_worker):
    worker = make_worker("sleep", "100")
    worker.ask(question())
    while worker._process is None:
        time.sleep(0.01)
    assert worker.answer() is None
    worker.close()
    assert isinstance(answer_of(worker), Trouble)


def test_closing_one_that_was_never_asked_does_nothing(make_worker):
    make_worker().close()


def served(*questions):
    answers = io.BytesIO()
    serve(io.BytesIO(b"".join(pickle.dumps(q) for q in questions)), answers)
    answers.seek(0)
    return [pickle.load(answers) for _ in questions]


def test_an_error_of_the_fit_is_an_answer_and_the_end_of_the_input_ends_it():
    (answer,) = served(question(motion=None))
    assert isinstance(answer, Trouble)
    assert "AttributeError" in answer.reason
    for timer in (signal.ITIMER_PROF, signal.ITIMER_REAL):
        assert signal.getitimer(timer) == (0.0, 0.0)


def test_a_library_that_is_missing_is_named_in_an_answer(monkeypatch):
    monkeypatch.delitem(sys.modules, "fvs_estimator_node.excitation", raising=False)
    monkeypatch.delitem(sys.modules, "fvs_estimator_node.chain_fit", raising=False)
    monkeypatch.setitem(sys.modules, "threadpoolctl", None)
    (answer,) = served(question())
    assert isinstance(answer, Trouble)
    assert "threadpoolctl" in answer.reason


def test_there_is_no_ros_in_it():
    code = (
        "import sys, fvs_estimator_node.chain_worker, fvs_estimator_node.excitation; "
        "print([name for name in sys.modules if name.startswith('rclpy')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
