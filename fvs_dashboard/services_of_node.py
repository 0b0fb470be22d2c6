"""Service calls of the page's node to the other nodes, all with a timeout."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import Trigger

from fvs_ros import topics

if TYPE_CHECKING:
    from fvs_ros.ros import FvsNode

#: Timeout of a service call, s.
ANSWER_S = 3.0
#: Period of repeated stop requests until an answer, and time until the user is warned, s.
_STOP_AGAIN_S, _STOP_LATE_S = 0.3, 0.5


class _Request(NamedTuple):
    """A pending request; a quiet one does not come from the user."""

    name: str
    asked_s: float
    client: Any
    future: Any
    quiet: bool


class Services:
    """The services of controller, estimator and simulator.

    ``show`` displays a text to the user.
    """

    def __init__(self, node: FvsNode, show: Callable[[str], None]) -> None:
        self._node, self._show = node, show
        kinds = {"get_parameters": GetParameters, "set_parameters": SetParameters}
        self._clients = {
            name: node.create_client(kinds.get(name.rpartition("/")[2], Trigger), name)
            for name in topics.NODES[topics.DASHBOARD].calls
        }
        self._open: list[_Request] = []
        self._stopping = False
        self._stop_sent_s = self._stop_late_s = 0.0

    def call(self, name: str, on_answer: Callable[[Trigger.Response], None] | None = None) -> None:
        """Call a service by node and name; its answer is shown, or given to ``on_answer``."""
        if name == f"{topics.CONTROLLER}/start":  # a start cancels a pending stop
            self._stopping = False
        words = name.rpartition("/")[2].replace("_", " ")
        shown = on_answer or (lambda answer: self._show(f"{words}: {answer.message}"))
        self._request(name, Trigger.Request(), shown)

    def stop(self) -> None:
        """Ask the controller to stop, again and again until it answers."""
        self._stopping, self._stop_late_s = True, self._node.steady_s() + _STOP_LATE_S
        self._send_stop()

    def ask(
        self, node: str, names: tuple[str, ...], on_values: Callable[[dict[str, Any]], None]
    ) -> None:
        """Get parameters: plain values of those that the node has, none if it does not run."""

        def on_answer(answer: GetParameters.Response) -> None:
            values = [parameter_value_to_python(value) for value in answer.values]
            on_values({n: v for n, v in zip(names, values, strict=False) if v is not None})

        request = GetParameters.Request(names=list(names))
        if not self._request(f"{node}/get_parameters", request, on_answer, quiet=True):
            on_values({})

    def set(self, parameter: str, value: Any) -> None:
        """Set a parameter, named by node and name; a refusal is shown."""

        def on_answer(answer: SetParameters.Response) -> None:
            for result in answer.results:
                if not result.successful:
                    self._show(f"refused: {result.reason}")

        node, _, name = parameter.partition("/")
        plain = value if isinstance(value, (float, str)) else list(value)
        wanted = Parameter(name, value=plain).to_parameter_msg()
        request = SetParameters.Request(parameters=[wanted])
        self._request(f"{node}/set_parameters", request, on_answer)

    def look_after(self) -> None:
        """Repeat an unanswered stop, and drop requests after the timeout."""
        now_s = self._node.steady_s()
        if self._stopping and now_s - self._stop_sent_s > _STOP_AGAIN_S:
            if now_s > self._stop_late_s:
                self._stop_late_s = inf  # shown once
                self._show("stop: the controller does not answer yet; use the robot's own stop")
            self._send_stop()
        waiting = [one for one in self._open if not one.future.done()]
        self._open = [one for one in waiting if now_s - one.asked_s <= ANSWER_S]
        for one in waiting:
            if one not in self._open:
                one.client.remove_pending_request(one.future)
                if not one.quiet:
                    self._show(f"{one.name} does not answer; it may still be done, later")

    def _send_stop(self) -> None:
        self._stop_sent_s = self._node.steady_s()

        def on_answer(answer: Trigger.Response) -> None:
            if self._stopping:
                self._stopping = False
                self._show(f"stop: {answer.message}")

        self._request(f"{topics.CONTROLLER}/stop", Trigger.Request(), on_answer, quiet=True)

    def _request(
        self, name: str, request: Any, on_answer: Callable[[Any], None], quiet: bool = False
    ) -> bool:
        """Send a request; returns whether a node provides the service."""
        client = self._clients[name]
        if not client.service_is_ready():
            if not quiet:
                self._show(f"{name} does not answer; is {name.partition('/')[0]} running?")
            return False
        future = client.call_async(request)
        future.add_done_callback(lambda done: on_answer(done.result()))
        self._open.append(_Request(name, self._node.steady_s(), client, future, quiet))
        return True
