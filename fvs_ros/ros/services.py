"""A person's service calls to the other nodes; none is waited for."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Any

from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import Trigger

from fvs_ros import topics
from fvs_ros.ros.node import FvsNode


class Services:
    """The services of controller, estimator and simulator, and their and the detector's parameters.

    ``show`` displays a text to the user.
    """

    def __init__(self, node: FvsNode, show: Callable[[str], None]) -> None:
        self._node, self._show = node, show
        nodes = topics.CONTROLLER, topics.ESTIMATOR, topics.SIM, topics.DETECTOR
        services: dict[str, Any] = {
            **{name: Trigger for name, (kind, _) in topics.SERVICES.items() if "Trigger" in kind},
            **{f"{each}/get_parameters": GetParameters for each in nodes},
            **{f"{each}/set_parameters": SetParameters for each in nodes},
        }
        self._clients = {name: node.create_client(kind, name) for name, kind in services.items()}
        self._stopping, self._stops = False, 0
        self._stop_sent_s = self._stop_late_s = 0.0

    def call(self, name: str, *then: str) -> None:
        """Call services by node and name, one after another; their answers are shown.

        A refusal or a stop ends it.
        """
        if name == f"{topics.CONTROLLER}/start":  # a start cancels a pending stop
            self._stopping = False
        words = name.rpartition("/")[2].replace("_", " ")
        stops = self._stops

        def on_answer(answer: Trigger.Response) -> None:
            self._show(f"{words}: {answer.message}")
            if answer.success and then and stops == self._stops:
                self.call(*then)

        if not self._send(name, Trigger.Request(), on_answer):
            self._show(f"{name} does not answer; is {name.partition('/')[0]} running?")

    def stop(self) -> None:
        """Ask the controller to stop, again and again until it answers; say if that takes long."""
        self._stopping, self._stop_late_s = True, self._node.steady_s() + 0.5
        self._stops += 1
        self._stop_sent_s = -inf
        self.repeat_stop()

    def repeat_stop(self) -> None:
        """Repeat an unanswered stop."""
        now_s = self._node.steady_s()
        if not self._stopping or now_s - self._stop_sent_s <= 0.3:
            return
        self._stop_sent_s = now_s
        if now_s > self._stop_late_s:
            self._stop_late_s = inf  # shown once
            self._show("stop: the controller does not answer yet; use the robot's own stop")

        def on_answer(answer: Trigger.Response) -> None:
            if self._stopping:
                self._stopping = False
                self._show(f"stop: {answer.message}")

        self._send(f"{topics.CONTROLLER}/stop", Trigger.Request(), on_answer)

    def ask(
        self, node: str, names: tuple[str, ...], on_values: Callable[[dict[str, Any]], None]
    ) -> None:
        """Get parameters: plain values of those that the node has, none if it does not run."""

        def on_answer(answer: GetParameters.Response) -> None:
            values = [parameter_value_to_python(value) for value in answer.values]
            on_values({n: v for n, v in zip(names, values, strict=False) if v is not None})

        request = GetParameters.Request(names=list(names))
        if not self._send(f"{node}/get_parameters", request, on_answer):
            on_values({})

    def set(self, parameter: str, value: Any, *then: str) -> None:
        """Set a parameter, named by node and name, then call services; a refusal is shown."""
        stops = self._stops

        def on_answer(answer: SetParameters.Response) -> None:
            (result,) = answer.results
            if not result.successful:
                self._show(f"refused: {result.reason}")
            elif then and stops == self._stops:
                self.call(*then)

        node, _, name = parameter.partition("/")
        plain = value if isinstance(value, (float, str)) else list(value)
        wanted = Parameter(name, value=plain).to_parameter_msg()
        request = SetParameters.Request(parameters=[wanted])
        if not self._send(f"{node}/set_parameters", request, on_answer):
            self._show(f"{parameter} was not set; is {node} running?")

    def _send(self, name: str, request: Any, on_answer: Callable[[Any], None]) -> bool:
        """Send a request; returns whether a node provides the service."""
        client = self._clients[name]
        if client.service_is_ready():
            client.call_async(request).add_done_callback(lambda done: on_answer(done.result()))
            return True
        return False
