"""``fvs_servo``: teach references, and go to them.

    fvs_servo teach grasp        keep where the tool is, seen from the object
    fvs_servo go grasp retreat   one after the other, each until it is reached; then it stays there
    fvs_servo follow grasp       go there, and stay with the object
    fvs_servo stop

A signal (Ctrl-C) stops the arm, and so does what ``go`` or ``follow`` cannot reach.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from math import inf, nan
from typing import Any, NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from fvs_ros import ros, stop, topics
from fvs_ros.arguments import Parser

#: A service answers within this time, s, or nobody is there.
_ANSWER_S = 10.0
#: Time between sentences on the way, unless the state changes, s.
_FEEDBACK_S = 1.0
#: Verb -> fewest and most names.
_VERBS: dict[str, tuple[float, float]] = {
    "teach": (1, 1),
    "go": (1, inf),
    "follow": (1, 1),
    "stop": (0, 0),
}


class ServoError(RuntimeError):
    """The controller refused, or did not answer; the text says why."""


class Result(NamedTuple):
    """How a motion to a reference ended."""

    reached: bool
    error_m: float  #: at the end
    time_s: float  #: from the call
    reason: str  #: the controller's last sentence


class ServoClient:
    """Talks to one controller from a script, or from within any node.

    It has a node and an executor of its own, so that its methods may block anywhere. As a context
    manager it stops the arm in the end, after SIGTERM and a closed terminal, too.

    Parameters
    ----------
    node : Node, optional
        Its context and namespace are used; without one, those of ``rclpy.init``, which is called if
        need be. Its methods work after Ctrl-C, too; where you call ``rclpy.init``, only with
        ``signal_handler_options=SignalHandlerOptions.NO``.
    namespace : str, optional
        The controller's, where the node has another.

    Raises
    ------
    ServoError
        By every method but ``go_to``: the controller refuses, or does not answer.
    """

    def __init__(self, node: Node | None = None, namespace: str | None = None) -> None:
        context = None if node is None else node.context
        self._owns_context = node is None and not rclpy.ok()
        if self._owns_context:
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        if namespace is None:
            namespace = "" if node is None else node.get_namespace()
        name = f"fvs_servo_client_{time.time_ns() % 10**9}"
        self._node = rclpy.create_node(
            name, context=context, namespace=namespace, start_parameter_services=False
        )
        self._executor = SingleThreadedExecutor(context=self._node.context)
        self._executor.add_node(self._node)
        self._status: DiagnosticStatus | None = None
        self._node.create_subscription(
            DiagnosticStatus, topics.CONTROLLER + "/status", self._on_status, ros.QOS_NEWEST
        )
        self._clients: dict[str, Any] = {}

    def __enter__(self) -> ServoClient:
        """Let signals that would end the program raise ``KeyboardInterrupt``, as Ctrl-C does."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGTERM, signal.SIGHUP):
                if signal.getsignal(number) == signal.SIG_DFL:
                    signal.signal(number, signal.default_int_handler)
        return self

    def __exit__(self, *exception: object) -> None:
        """Bring the arm to rest, however the block ended, and end the client."""
        with closing(self):
            self.stop()

    def close(self) -> None:
        """End the client; the arm goes on with what it does."""
        self._executor.shutdown()
        self._node.destroy_node()
        if self._owns_context:
            rclpy.try_shutdown()

    # ---- the verbs ----------------------------------------------------------------------------

    def teach(self, name: str) -> str:
        """Keep where the tool is, at rest, under a name; returns what was written."""
        self._choose(name)
        return self._call("teach")

    def follow(self, name: str, timeout_s: float = _ANSWER_S) -> str:
        """Go to a reference and stay with its object; returns once the arm may start."""
        self._choose(name)
        answer, end_s = self._call("go_to_reference"), time.monotonic() + timeout_s
        if not answer.startswith(f"{name}: "):
            raise ServoError(f"another client chose at the same time: {answer}")
        while True:
            response = self._ask(Trigger, "start", Trigger.Request())
            if response.success:
                return answer
            if time.monotonic() > end_s:
                raise ServoError(response.message)
            self._next_status()  # what is missing may be on its way

    def go_to(
        self, name: str, timeout_s: float = inf, feedback: Callable[[str], None] | None = None
    ) -> Result:
        """Go to a reference, and wait until it is reached, given up or out of time.

        Once it is reached, the session ends: the arm rests there, also if the object moves on.

        Parameters
        ----------
        name : str
            The reference.
        timeout_s : float
            Longest time, s; the arm goes on after it.
        feedback : callable, optional
            Gets the controller's sentences on the way: at changes of its state, else one a second.
        """
        begin_s = time.monotonic()
        try:
            self.follow(name, min(timeout_s, _ANSWER_S))
        except ServoError as error:
            return Result(False, nan, time.monotonic() - begin_s, str(error))
        said = self._next_status()  # the one after the present one is of this reference
        said_s, state = 0.0, ""
        while True:
            status = self._next_status(begin_s + timeout_s)
            values, passed_s = ros.from_status(status), time.monotonic() - begin_s
            is_news = values.get("state") != state or passed_s > said_s + _FEEDBACK_S
            if feedback is not None and is_news and status.message != said.message:
                feedback(status.message)
                said, said_s, state = status, passed_s, values.get("state", "")
            settled = values.get("settled") == "true" and values.get("state") == "SERVOING"
            if values.get("reference") != name:
                return Result(False, nan, passed_s, "another target was set meanwhile")
            reached = settled and passed_s <= timeout_s
            if reached:
                self.stop()
            if reached or passed_s > timeout_s or values.get("started") == "false":
                error_m = nan
                with suppress(ValueError):  # it may be unknown
                    error_m = float(values.get("error_m", ""))
                return Result(reached, error_m, passed_s, status.message)

    def stop(self) -> str:
        """Bring the arm to rest."""
        return self._call("stop")

    # ---- how ----------------------------------------------------------------------------------

    def _on_status(self, message: DiagnosticStatus) -> None:
        self._status = message

    def _next_status(self, end_s: float = inf) -> DiagnosticStatus:
        """The next status; from a time on, s, the last one."""
        before = self._status
        self._spin(
            lambda: self._status is not before or time.monotonic() > end_s,
            "the controller's status",
        )
        assert self._status is not None
        return self._status

    def _choose(self, name: str) -> None:
        parameter = Parameter("reference", value=name).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        (result,) = self._ask(SetParameters, "set_parameters", request).results
        if not result.successful:
            raise ServoError(result.reason)

    def _call(self, service: str) -> str:
        response = self._ask(Trigger, service, Trigger.Request())
        if not response.success:
            raise ServoError(response.message)
        return response.message

    def _ask(self, kind: Any, service: str, request: Any) -> Any:
        name = f"{topics.CONTROLLER}/{service}"
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
        client = self._clients[name]
        self._spin(client.service_is_ready, f"service {client.srv_name}")
        future = client.call_async(request)
        self._spin(future.done, f"an answer of {client.srv_name}")
        return future.result()

    def _spin(self, condition: Callable[[], bool], what: str) -> None:
        end_s = time.monotonic() + _ANSWER_S
        while not condition():
            if stop.RECEIVED:
                raise KeyboardInterrupt
            if time.monotonic() > end_s:
                raise ServoError(f"waited {_ANSWER_S:g} s for {what}: does the controller run?")
            self._executor.spin_once(timeout_sec=0.05)


def main() -> int:
    """Run ``fvs_servo``."""
    parser = _parser()
    given = parser.parse_args()
    fewest, most = _VERBS[given.verb]
    if not fewest <= len(given.names) <= most:
        parser.error(f"{given.verb} takes {fewest} to {most} names, got {len(given.names)}")
    stop.listen()
    try:
        with closing(ServoClient(namespace=given.namespace)) as client:
            return _do(client, given)
    except ServoError as error:
        print(error, file=sys.stderr)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
    return stop.EXIT_FAILURE


def _do(client: ServoClient, given: argparse.Namespace) -> int:
    if given.verb == "stop":
        print(client.stop())
    elif given.verb == "teach":
        print(client.teach(*given.names))
    else:
        done = False
        try:
            done = _move(client, given)
        finally:
            if not done or stop.RECEIVED:
                stop.RECEIVED.clear()  # the next signal ends the wait for the answer, too
                print(client.stop())
        return stop.EXIT_OK if done else stop.EXIT_FAILURE
    return stop.EXIT_OK


def _move(client: ServoClient, given: argparse.Namespace) -> bool:
    if given.verb == "follow":
        print(client.follow(*given.names))
        return True
    for name in given.names:
        result = client.go_to(name, given.timeout_s, print)
        how = "reached" if result.reached else "not reached"
        print(f"{name}: {how} in {result.time_s:.1f} s; {result.reason}")
        if not result.reached:
            return False
    return True


def _parser() -> argparse.ArgumentParser:
    parser = Parser("fvs_servo", __doc__)
    parser.add_argument("verb", metavar="VERB", choices=_VERBS, help=", ".join(_VERBS))
    parser.add_argument("names", nargs="*", metavar="NAME", help="of references")
    parser.add_argument("--timeout-s", type=float, default=inf, help="for each reference, s")
    parser.add_argument("--namespace", default="", help="the controller's")
    return parser


if __name__ == "__main__":
    sys.exit(main())
