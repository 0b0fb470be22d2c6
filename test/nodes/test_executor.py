"""What a node spins on."""

import signal

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor

from fvs_ros import ros, stop


@pytest.fixture
def signals():
    """A program's own handlers of signals, as before the test afterwards."""
    rclpy.init(args=[])
    before = {number: signal.getsignal(number) for number in signal.valid_signals()}
    stop.listen()
    yield stop.RECEIVED
    for number, handler in before.items():
        if signal.getsignal(number) != handler:
            signal.signal(number, handler)
    stop.RECEIVED.clear()
    rclpy.try_shutdown()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_noted_and_leaves_the_context_to_the_last_zeros(signals, number):
    executor = ros._make_executor(events=True)
    try:
        assert not isinstance(executor, SingleThreadedExecutor)
        signal.raise_signal(number)
        executor.spin_once(timeout_sec=0.1)
        assert signals == [number]
        assert rclpy.ok()
    finally:
        executor.shutdown(timeout_sec=0.0)


@pytest.mark.usefixtures("signals")
def test_an_older_rclpy_spins_on_wait_sets(monkeypatch):
    monkeypatch.setattr(ros, "EventsExecutor", None)
    assert isinstance(ros._make_executor(events=True), SingleThreadedExecutor)


@pytest.mark.usefixtures("signals")
def test_a_node_that_destroys_subscriptions_spins_on_wait_sets():
    assert isinstance(ros._make_executor(events=False), SingleThreadedExecutor)
