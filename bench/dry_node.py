"""The controller node without a middleware: its own callbacks, called by hand on real messages."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace

from rcl_interfaces.msg import SetParametersResult
from std_srvs.srv import Trigger

from fvs_controller_node.node import ControllerNode
from fvs_ros.params import ParameterError, ParameterSet
from fvs_ros.ros import FvsNode, to_status


def _nothing(*_arguments, **_options):
    """No timer, no subscription, no log: the caller is the time and calls the callbacks."""


class DryNode(FvsNode):
    """Stands between a node and rclpy: nothing is published or timed; ``hears`` has callbacks."""

    status_heard = True
    watch = tell = staticmethod(_nothing)

    def __init__(self, name, parameters, _namespace):  # rclpy's own is left out on purpose
        self._name = self._declared_name = name
        self.parameter_set = ParameterSet(parameters)
        self.values = self.parameter_set.values(self.overrides)
        self.steady_clock = None
        self.published = {}  # topic -> the newest messages
        self.hears = {}  # topic -> what gets its messages
        self.services_by_name = {}

    def set_parameters_atomically(self, parameter_list):
        """Check and set, as the node does, without rclpy's own checks in between."""
        try:
            return self._on_set([self._settable(parameter) for parameter in parameter_list])
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))

    def get_parameter(self, name):
        return SimpleNamespace(value=self.simulated_time if name == "use_sim_time" else None)

    def subscribe(self, topic, callback, _qos=None):
        self.hears[topic.name] = callback

    def create_timer(self, *_arguments, **_options):
        return SimpleNamespace(reset=_nothing)

    def create_publisher(self, _kind, topic, *_options, **_keywords):
        sent = self.published.setdefault(topic, deque(maxlen=9))
        return SimpleNamespace(publish=sent.append)

    def create_service(self, _kind, name, callback, **_options):
        self.services_by_name[name] = callback

    def get_logger(self):
        return SimpleNamespace(info=_nothing, warning=_nothing)

    def publish_status(self, level, state, reason, values):
        """Make the status message, as the node does, for what may go wrong in it."""
        to_status(level, self._name, reason, {"state": state, **values})

    def now_s(self):
        return self.clock_s()

    def call(self, service):
        """Call a service without arguments; its success and message."""
        answer = self.services_by_name[service](Trigger.Request(), Trigger.Response())
        return answer.success, answer.message


class DryController(ControllerNode, DryNode):
    """The controller node, dry, with some parameters, a steady clock and ``use_sim_time``."""

    def __init__(self, overrides, clock_s, simulated_time=False):
        self.overrides, self.clock_s, self.simulated_time = overrides, clock_s, simulated_time
        #: Called after every tick: its command, the steady clock and the time step, s.
        self.on_tick = _nothing
        super().__init__()

    def _tick(self, now_s, dt_s):
        velocity = super()._tick(now_s, dt_s)
        self.on_tick(self._command, now_s, dt_s)
        return velocity

    def __del__(self):
        """Nothing was opened."""
