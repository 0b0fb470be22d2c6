"""The controller node without a middleware: its own callbacks, called by hand on real messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy import Parameter
from std_srvs.srv import Trigger

from fvs_controller_node.node import ControllerNode
from fvs_controller_node.supervisor import Command
from fvs_ros.params import ParameterError, ParameterSet
from fvs_ros.ros import FvsNode, to_status


class DryPublisher:
    """Hands every message's data, or the message where it has none, to who listens."""

    def __init__(self) -> None:
        self.heard: Callable[[Any], None] = lambda data: None

    def publish(self, message: Any) -> None:
        """Take a message."""
        self.heard(getattr(message, "data", message))

    def wait_for_all_acked(self, _timeout: Any = None) -> bool:
        """All that was sent has arrived."""
        return True


class DryNode(FvsNode):
    """Stands between a node and rclpy: nothing is subscribed, published or timed."""

    given: Mapping[str, Any]
    clock_s: Callable[[], float]
    simulated_time: bool

    def __init__(self, name: str, parameters: Any) -> None:  # rclpy's own is left out on purpose
        self._name = self._declared_name = name
        self.parameter_set = ParameterSet(parameters)
        self.values = self.parameter_set.values(self.given)
        self.steady_clock = None
        self.publishers_by_topic: dict[str, DryPublisher] = {}
        self.services_by_name: dict[str, Callable] = {}

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Check and set, as the node does, without rclpy's own checks in between."""
        try:
            return self._on_set([self._settable(given) for given in parameter_list])
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self.simulated_time if name == "use_sim_time" else None)

    def create_publisher(self, _kind: Any, topic: str, *_options: Any) -> DryPublisher:
        return self.publishers_by_topic.setdefault(topic, DryPublisher())

    def create_service(self, _kind: Any, name: str, callback: Callable, **_options: Any) -> None:
        self.services_by_name[name] = callback

    def create_timer(self, *_arguments: Any, **_options: Any) -> None:
        """No timer: the caller is the time."""

    def watch(self, *_arguments: Any) -> None:
        """No subscription: the caller calls the callbacks."""

    def get_logger(self) -> Any:
        return SimpleNamespace(info=lambda text: None, warning=lambda text: None)

    def tell(self, level: bytes, text: str) -> None:
        """Say nothing."""

    def publish_status(
        self, level: bytes, state: str, reason: str, values: Mapping[str, Any]
    ) -> None:
        """Make the status message, as the node does, for what may go wrong in it."""
        to_status(level, self._name, reason, {"state": state, **values})

    def now_s(self) -> float:
        return self.clock_s()

    def call(self, service: str) -> tuple[bool, str]:
        """Call a service without arguments."""
        answer = self.services_by_name[service](Trigger.Request(), Trigger.Response())
        return answer.success, answer.message


class DryController(ControllerNode, DryNode):
    """The controller node, dry.

    Parameters
    ----------
    given : mapping
        Parameters that are not at their defaults.
    clock_s : callable
        The steady clock, s.
    simulated_time : bool
        The parameter ``use_sim_time``.
    """

    def __init__(
        self, given: Mapping[str, Any], clock_s: Callable[[], float], simulated_time: bool = False
    ) -> None:
        self.given, self.clock_s, self.simulated_time = given, clock_s, simulated_time
        #: Called after every tick: its command, the steady clock and the time step, s.
        self.on_tick: Callable[[Command, float, float], None] = lambda *_: None
        super().__init__()

    def _tick(self, now_s: float, dt_s: float) -> None:
        super()._tick(now_s, dt_s)
        assert self._command is not None
        self.on_tick(self._command, now_s, dt_s)

    def __del__(self) -> None:
        """Nothing was opened."""
