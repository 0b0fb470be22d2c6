"""Every node alone in its namespace: on the wire as declared, its parameters kept or refused."""

import json
import re
from functools import partial

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from harness import ros_arguments
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter as RosParameter
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray

from fvs_ros import contract, ros, topics
from fvs_ros.topics import NODES
from fvs_tools.scenario import NODE_TABLE

#: What a node needs that runs beside others and has no node to talk to.
ALONE = {
    "fvs_dashboard": {"port": 0},
    "fvs_recorder_node": {"images": False},
    "fvs_sim_node": {"joint_state_rate_hz": 10, "image_rate_hz": 1.0},
}
#: What rclpy gives every node.
BUILT_IN = {"use_sim_time", "start_type_description_service"}
#: Time in which what is not declared would show.
SETTLE_S = 1.0


def variants(name):
    """Parameters of a node: its defaults, and other values wherever its topics depend on them."""
    declared, others = NODE_TABLE[name].parameters(), {}
    for end in (*contract.publishers(name).values(), *contract.subscribers(name).values()):
        for given, value in end.given.items():
            parameter = declared[given]
            values = (value, *(parameter.choices or (False, True)))
            others[given] = next(one for one in values if one != parameter.default)
    return [{}, *({given: value} for given, value in others.items())]


class LoneNode:
    """One running node: its ends in the ROS graph, and its parameter services."""

    def __init__(self, harness, name, namespace, given):
        self.harness, self.name, self.where = harness, name, f"/{namespace}"
        parameters = NODE_TABLE[name].parameters()
        given = {**ALONE.get(name, {}), **given}
        self.declared, self.values = {p.name: p for p in parameters}, parameters.values(given)
        self.arguments = ros_arguments({"__ns": self.where}, **given)

    def resolve(self, name):
        return topics.resolve(name, self.name, self.where[1:])

    def _of_graph(self, what):
        """Names and types that the graph has of this node."""
        by_node = getattr(self.harness.node, f"get_{what}_names_and_types_by_node")
        return {name: kinds for name, kinds in by_node(self.name, self.where)}

    def publishes(self):
        return self._of_graph("publisher")

    def hears(self):
        return self._of_graph("subscriber")

    def serves(self):
        return {(name, kind) for name, kinds in self._of_graph("service").items() for kind in kinds}

    def calls(self):
        return set(self._of_graph("client"))

    def expected_ends(self, publishing):
        """Full name, type, reliability, durability of each end that it must have, sorted."""
        ends = (contract.publishers if publishing else contract.subscribers)(self.name)
        return sorted(
            (self.resolve(topic.name), topic.type, profile.reliability, profile.durability)
            for topic, end in ends.items()
            if not end.later and all(self.values[n] == value for n, value in end.given.items())
            for profile in (ros.PROFILES[qos] for qos in end.qos)
        )

    def actual_ends(self, publishing):
        """The same, as the graph has it, without what rclpy gives every node."""
        graph = self.harness.node
        if publishing:
            names, by_topic = self.publishes(), graph.get_publishers_info_by_topic
            ignored = topics.EVERY_NODE_PUBLISHES
        else:
            names, by_topic = self.hears(), graph.get_subscriptions_info_by_topic
            ignored = topics.EVERY_NODE_SUBSCRIBES
        return sorted(
            (
                name,
                info.topic_type,
                ReliabilityPolicy(info.qos_profile.reliability),
                DurabilityPolicy(info.qos_profile.durability),
            )
            for name in names
            if name not in ignored
            for info in by_topic(name)
            if (info.node_name, info.node_namespace) == (self.name, self.where)
        )

    def _call(self, kind, name, **request):
        return self.harness.call(kind, self.resolve(f"~/{name}"), kind.Request(**request))

    def listed(self):
        names = set(self._call(ListParameters, "list_parameters").result.names)
        return names - BUILT_IN

    def describe(self, names):
        answer = self._call(DescribeParameters, "describe_parameters", names=list(names))
        return {descriptor.name: descriptor for descriptor in answer.descriptors}

    def get(self, names):
        answer = self._call(GetParameters, "get_parameters", names=list(names))
        return dict(zip(names, map(parameter_value_to_python, answer.values), strict=True))

    def set(self, values):
        """Each value by itself, as ``ros2 param set`` sends it; results by name."""
        messages = [RosParameter(name, value=v).to_parameter_msg() for name, v in values.items()]
        return dict(zip(values, self.ask(*messages), strict=True))

    def ask(self, *messages):
        """What it answers to messages as they are, one by one and, last, all at once."""
        one_by_one = self._call(SetParameters, "set_parameters", parameters=list(messages))
        return one_by_one.results

    def ask_at_once(self, *messages):
        return self._call(
            SetParametersAtomically, "set_parameters_atomically", parameters=list(messages)
        ).result


@pytest.fixture(params=NODES)
def nodes(ros_test, request):
    """A node with its defaults, and its other variants, in one process."""
    name = request.param
    own = [
        LoneNode(ros_test, name, f"lone_{number}", given)
        for number, given in enumerate(variants(name))
    ]
    for node in own:
        if node.values.get("simulated_time"):  # waits for who answers, and does not race
            commander = ros_test.node.create_publisher(
                Float64MultiArray, node.resolve(topics.COMMANDS.name), ros.QOS_RELIABLE
            )
            rest = partial(commander.publish, ros.to_command(np.zeros(6)))
            ros_test.node.create_timer(0.5, rest)
    arguments = json.dumps([node.arguments for node in own])
    process = ros_test.start("patient_node", NODE_TABLE[name].module, arguments)
    # A node that has spoken has made all that it makes at its start.
    heard = ros_test.collect(DiagnosticArray, topics.DIAGNOSTICS.name, 10)
    wanted = {node.resolve("~") for node in own}
    ros_test.spin_until(
        lambda: wanted <= {status.name for message in heard for status in message.status},
        30.0,
        f"diagnostics of {sorted(wanted)}",
    )
    ros_test.spin_for(SETTLE_S)
    yield own
    assert process.poll() is None
    assert "Traceback" not in ros_test.output(process)


# ---- topics and services ----------------------------------------------------------------------


def assert_has_exactly_the_declared_topics(variant, publishing):
    expected = variant.expected_ends(publishing)
    variant.harness.spin_until(
        lambda: not set(expected) - set(variant.actual_ends(publishing)), what="declared topics"
    )
    if (
        publishing or not NODES[variant.name].subscribes_to_all
    ):  # that goes on finding those of the others
        assert variant.actual_ends(publishing) == expected


def assert_serves_and_calls_exactly_the_declared(variant):
    declared = NODES[variant.name]
    standard = {variant.resolve(name) for name in topics.EVERY_NODE_SERVES}
    expected = {(variant.resolve(one), kind) for one, (kind, _) in declared.serves.items()}

    def found():
        return {service for service in variant.serves() if service[0] not in standard}

    variant.harness.spin_until(lambda: expected <= found(), what="the declared services")
    assert found() == expected
    assert variant.calls() == {variant.resolve(name) for name in declared.calls}


# ---- parameters -------------------------------------------------------------------------------


def other(parameter):
    """Another allowed value of a parameter, near its default."""

    def one(value):
        if parameter.choices:
            return next(choice for choice in parameter.choices if choice != value)
        if parameter.kind is bool:
            return not value
        if parameter.kind is str:
            return f"{value}x"
        step = abs(value) / 100 or (1e-2 if (parameter.maximum or 0.0) < 1e4 else 1e3)
        step = max(1, round(step)) if parameter.kind is int else step
        above = parameter.maximum is None or value + step <= parameter.maximum
        return value + step if above else value - step

    default = parameter.default
    return [one(value) for value in default] if parameter.is_list else one(default)


def wrong(parameter):
    """Values that are not allowed: of another type, size, or out of range."""
    found = []
    if parameter.minimum is not None:
        found.append(parameter.kind(parameter.minimum - 1))
    if parameter.maximum is not None:
        found.append(parameter.kind(parameter.maximum + 1))
    if parameter.kind is float:
        found.append(float("nan"))
    if parameter.is_list:
        found = [[value] * max(1, len(parameter.default)) for value in found]
        if parameter.size is not None:
            found.append(parameter.default[:-1])
    if parameter.choices:
        found.append("nonsense")
    return [*found, 1 if parameter.kind in (str, bool) else "one"]


def different(one, two):
    """Names under which two mappings hold different values."""
    return [name for name in two if not np.array_equal(one[name], two[name])]


def assert_refused(result, *words):
    assert not result.successful
    assert re.fullmatch(r"[\w'].{15,}", result.reason, re.S), f"no sentence: {result.reason!r}"
    for word in words:
        assert word in result.reason, f"{word!r} is not in {result.reason!r}"


def assert_lists_and_describes_parameters(node):
    assert node.listed() == set(node.declared)
    assert different(node.get(node.declared), node.values) == []
    descriptors = node.describe(node.declared)
    for name, parameter in node.declared.items():
        descriptor = descriptors[name]
        kind = RosParameter.Type.from_parameter_value(parameter.default)
        assert descriptor.type == kind.value, name
        assert descriptor.description == parameter.description
        assert descriptor.additional_constraints == parameter.expected()
        assert descriptor.read_only is not parameter.live, name
        if parameter.is_list or parameter.kind not in (int, float):
            continue
        ranges = descriptor.integer_range or descriptor.floating_point_range
        ends = [end for one in ranges for end in (one.from_value, one.to_value)]
        declared = [parameter.minimum, parameter.maximum]
        assert bool(ends) is (declared != [None, None]), name
        assert all(d is None or e == d for e, d in zip(ends, declared, strict=False)), name


def assert_live_parameters_change(node):
    changed = {name: other(p) for name, p in node.declared.items() if p.live}
    before = node.get(changed)
    for values in (changed, before):
        assert [r.reason for r in node.set(values).values() if not r.successful] == []
        assert different(node.get(values), values) == []


def assert_refuses_wrong_values(node):
    before = node.get(node.declared)
    cases = {name: wrong(p) if p.live else [other(p)] for name, p in node.declared.items()}
    for round_ in range(max(map(len, cases.values()), default=0)):
        values = {name: values[round_] for name, values in cases.items() if len(values) > round_}
        for name, result in node.set(values).items():
            live = node.declared[name].live
            assert_refused(result, name, node.declared[name].expected() if live else "at start")
    assert_refused(node.set({"no_such_parameter": 1.0})["no_such_parameter"], *node.declared)
    assert node.listed() == set(node.declared)
    assert different(node.get(before), before) == []


def assert_refuses_malformed_requests(node):
    for name in (next(iter(node.declared)), "no_such_parameter", "use_sim_time", "qos_overrides.x",
                 "", "\x1b"):  # fmt: skip
        odd = [  # the types of lists, none, and unknown ones
            ParameterMessage(name=name, value=ParameterValue(type=number))
            for number in (0, *range(5, 12), 77, 255)
        ]
        assert [number for number, one in enumerate(node.ask(*odd, *odd)) if one.successful] == []
        assert not any(node.ask_at_once(one).successful for one in (odd[0], odd[1], odd[-1]))
    assert node.listed() == set(node.declared)


def assert_refuses_large_requests(node):
    first = next(iter(node.declared))
    value = RosParameter(first, value=node.values[first]).get_parameter_value()
    for names in ([first] * 1000, ["x" * 10**6]):
        many = [ParameterMessage(name=one, value=value) for one in names]
        for result in (*node.ask(*many), node.ask_at_once(*many)):
            assert_refused(result, "too large")
            assert len(result.reason) < 200
    assert node.get(node.declared)


# ---- promises ---------------------------------------------------------------------------------


def test_every_node_that_can_be_started_is_declared():
    assert list(NODES) == list(NODE_TABLE)


def test_a_node_is_on_the_wire_as_declared_and_keeps_or_refuses_parameters(nodes):
    for node in nodes:
        for publishing in (True, False):
            assert_has_exactly_the_declared_topics(node, publishing)
        assert_serves_and_calls_exactly_the_declared(node)
    for check in (
        assert_lists_and_describes_parameters,
        assert_live_parameters_change,
        assert_refuses_wrong_values,
        assert_refuses_malformed_requests,
        assert_refuses_large_requests,
    ):
        check(nodes[0])
