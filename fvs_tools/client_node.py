"""``fvs_servo``: go to targets; teach references, and go to them.

    fvs_servo target 0.05 0.15 1.5   of a ball, m; also fvs_target 0.05 0.15 1.5
    fvs_servo target 0 0.1 1.2 0 0 90   of a tag, with a rotation vector, degrees, or a quaternion
    fvs_servo target 320 240 300 250    of image points, px, camera by camera
    fvs_servo teach grasp        keep where the tool is, seen from the object
    fvs_servo go grasp retreat   one after the other, each until it is reached; then it stays there
    fvs_servo follow grasp       go there, and stay with the object
    fvs_servo stop

The arm starts, and once it is there it rests. A signal (Ctrl-C) stops it, and so does what it
cannot reach.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from math import inf, nan
from typing import Any, NamedTuple

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from fvs_ros import ros, stop, topics
from fvs_ros.arguments import Parser
from fvs_ros.kinds import KindConfig
from fvs_ros.status import number

#: A service answers within this time, s, or nobody is there.
_ANSWER_S = 10.0
#: Time between sentences on the way, unless the state changes, s.
_FEEDBACK_S = 1.0
#: Successive statuses, of 0.1 s, that say it is settled: steps too short to unsettle it are made.
_SETTLED = 5
#: What takes the controller's sentences on the way.
Feedback = Callable[[str], None]
#: Verb -> fewest and most names.
_VERBS: dict[str, tuple[float, float]] = {
    "teach": (1, 1),
    "go": (1, inf),
    "follow": (1, 1),
    "target": (2, inf),
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
        By every method but ``go_to`` and ``move_to``: the controller refuses, or does not answer.
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

    def follow(
        self, name: str, timeout_s: float = _ANSWER_S, feedback: Feedback | None = None
    ) -> str:
        """Go to a reference and stay with its object; returns once the arm may start."""
        self._choose(name)
        answer = self._call("go_to_reference")
        if not answer.startswith(f"{name}: "):
            raise ServoError(f"another client chose at the same time: {answer}")
        self._start(timeout_s, feedback)
        return answer

    def go_to(self, name: str, timeout_s: float = inf, feedback: Feedback | None = None) -> Result:
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
        return self._until_reached(partial(self.follow, name), timeout_s, feedback)

    def move_to(
        self,
        numbers: Sequence[float],
        frame: str = "",
        timeout_s: float = inf,
        feedback: Feedback | None = None,
    ) -> Result:
        """Go to a target, and wait as ``go_to`` does.

        Parameters
        ----------
        numbers : sequence of float
            Of a ball x, y, z, m; of a tag those and a quaternion x, y, z, w, or a rotation vector,
            degrees; of image points u, v of one after the other, camera by camera, px.
        frame : str
            ``object`` for a target relative to it; by default the camera's.
        timeout_s, feedback
            As of ``go_to``.
        """
        return self._until_reached(partial(self._send_target, numbers, frame), timeout_s, feedback)

    def stop(self) -> str:
        """Bring the arm to rest."""
        return self._call("stop")

    # ---- how ----------------------------------------------------------------------------------

    def read_target(self, numbers: Sequence[float]) -> tuple[KindConfig, np.ndarray]:
        """What the controller servos, and the target, (m,), in these numbers; sends nothing."""
        names = [parameter.name for parameter in KindConfig.declared()]
        answer = self._ask(GetParameters, "get_parameters", GetParameters.Request(names=names))
        values = map(parameter_value_to_python, answer.values)
        config = KindConfig.from_values(dict(zip(names, values, strict=True)))
        try:
            return config, config.kind.parse(np.array(numbers, dtype=float))
        except ValueError as error:
            raise ServoError(f"the target of a {config.kind.what} {error}") from None

    def _send_target(self, numbers: Sequence[float], frame: str, *start: Any) -> None:
        """Send a target, and start once the controller has accepted it."""
        config, z = self.read_target(numbers)
        frame = frame or config.feature_frame
        stamp_s = self._node.get_clock().now().nanoseconds * 1e-9
        for part, rows in zip(config.kind.parts, config.kind.rows, strict=True):
            message = ros.to_feature(stamp_s, frame, part, z[rows])
            self._publish_target(part.topics.target, message)
        self._start(*start)

    def _publish_target(self, topic: topics.Topic, message: Any) -> None:
        """Publish a target, and wait until the controller has taken or refused it."""
        before = ros.from_status(self._next_status()).get("targets")
        publisher = self._node.create_publisher(
            type(message), topic.name, ros.PROFILES[topic.offers]
        )
        self._spin(publisher.get_subscription_count, f"a subscriber of {topic.name}")
        publisher.publish(message)
        self._spin(
            lambda: ros.from_status(self._status).get("targets") != before,
            f"an answer to {topic.name}",
        )
        refusal = ros.from_status(self._next_status()).get("refused_target")
        if refusal:
            raise ServoError(refusal)

    def _start(self, timeout_s: float, feedback: Feedback | None) -> None:
        """Start once nothing is missing; what is still missing after a second is said once."""
        begin_s = time.monotonic()
        while not (response := self._ask(Trigger, "start", Trigger.Request())).success:
            passed_s = time.monotonic() - begin_s
            if passed_s > timeout_s:
                raise ServoError(response.message)
            if feedback and passed_s > _FEEDBACK_S:
                feedback(response.message)
                feedback = None
            self._next_status()  # what is missing may be on its way

    def _until_reached(
        self,
        begin: Callable[[float, Feedback | None], Any],
        timeout_s: float,
        feedback: Feedback | None,
    ) -> Result:
        """Begin a motion, and wait until it ends."""
        begin_s = time.monotonic()
        try:
            begin(min(timeout_s, _ANSWER_S), feedback)
        except ServoError as error:
            return Result(False, nan, time.monotonic() - begin_s, str(error))
        said = self._next_status()  # the one after the present one is of this target
        task: tuple[str | None, ...] | None = None
        said_s, state, settled = 0.0, "", 0
        while True:
            status = self._next_status(begin_s + timeout_s)
            values, passed_s = ros.from_status(status), time.monotonic() - begin_s
            is_news = values.get("state") != state or passed_s > said_s + _FEEDBACK_S
            if feedback is not None and is_news and status.message != said.message:
                feedback(status.message)
                said, said_s, state = status, passed_s, values.get("state", "")
            task, before = (values.get("reference"), values.get("targets")), task
            if before not in (None, task):
                return Result(False, nan, passed_s, "another target was set meanwhile")
            now = values.get("settled") == "true" and values.get("state") == "SERVOING"
            settled = settled + 1 if now else 0
            late, why = passed_s > timeout_s, status.message
            reached = settled >= _SETTLED and not late
            if reached:
                self.stop()
            if reached or late or values.get("started") == "false":
                why = f"{timeout_s:g} s are over: {why}" if late else why
                return Result(reached, number(values, "error_m"), passed_s, why)

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

    def _spin(self, condition: Callable[[], Any], what: str) -> None:
        end_s = time.monotonic() + _ANSWER_S
        while not condition():
            if stop.RECEIVED:
                raise KeyboardInterrupt
            if time.monotonic() > end_s:
                heard = self._status is not None
                why = "is this computer too busy?" if heard else "does the controller run?"
                raise ServoError(f"waited {_ANSWER_S:g} s for {what}: {why}")
            self._executor.spin_once(timeout_sec=0.05)


def target() -> int:
    """Run ``fvs_target``."""
    return main("target")


def main(verb: str = "") -> int:
    """Run ``fvs_servo``, or ``fvs_target`` with its verb."""
    parser = _parser(verb)
    given = parser.parse_args()
    fewest, most = _VERBS[given.verb]
    if not fewest <= len(given.words) <= most:
        count = f"{fewest} or more" if most > fewest else fewest
        parser.error(f"{given.verb} takes {count} words, got {len(given.words)}")
    if given.verb == "target":
        try:
            given.words = [float(word) for word in given.words]
        except ValueError as error:
            parser.error(f"a target has numbers: {error}")
    if not given.timeout_s > 0.0:
        parser.error(f"--timeout-s must be above 0, got {given.timeout_s:g}")
    stop.listen()
    done = False
    try:
        with closing(ServoClient(namespace=given.namespace)) as client:
            done = _do(client, given)
    except ServoError as error:
        print(error, file=sys.stderr)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
    return stop.EXIT_OK if done else stop.EXIT_FAILURE


def _do(client: ServoClient, given: argparse.Namespace) -> bool:
    if given.verb in ("stop", "teach"):
        print(getattr(client, given.verb)(*given.words))
        return True
    if given.verb == "target":
        client.read_target(given.words)  # what is none ends here: nothing to stop
    done = False
    try:
        done = _move(client, given)
    finally:
        if not done or stop.RECEIVED:
            stop.RECEIVED.clear()  # the next signal ends the wait for the answer, too
            print(client.stop())
    return done


def _move(client: ServoClient, given: argparse.Namespace) -> bool:
    if given.verb == "follow":
        print(client.follow(given.words[0], feedback=print))
        return True
    limits = {"timeout_s": given.timeout_s, "feedback": print}
    if given.verb == "target":
        return _told(client.move_to(given.words, given.frame, **limits))
    return all(_told(client.go_to(name, **limits), f"{name}: ") for name in given.words)


def _told(result: Result, what: str = "") -> bool:
    """Print how a motion ended; returns whether it was reached."""
    how = f"reached, {result.reason.removeprefix('on target, ')}"
    how = f"{how}, in {result.time_s:.1f} s" if result.reached else f"not reached: {result.reason}"
    print(f"{what}{how}")
    return result.reached


def _parser(verb: str) -> argparse.ArgumentParser:
    parser = Parser(f"fvs_{verb or 'servo'}", __doc__)
    parser.set_defaults(verb=verb)
    if not verb:
        parser.add_argument("verb", metavar="VERB", choices=_VERBS, help=", ".join(_VERBS))
    parser.add_argument("words", nargs="*", metavar="NAME", help="of references, or numbers")
    parser.add_argument("--frame", default="", help="of a target: object (default: the camera's)")
    parser.add_argument("--timeout-s", type=float, default=inf, help="for each target, s")
    parser.add_argument("--namespace", default="", help="the controller's")
    return parser


if __name__ == "__main__":
    sys.exit(main())
