"""Every node alone in its namespace: on the wire as declared, its parameters kept or refused."""

import json
import re
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from harness import ros_arguments
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rclpy.parameter import Parameter as RosParameter
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.kinds import KINDS
from fvs_ros.topics import NODES, SERVICES
from fvs_tools.scenario import NODE_TABLE, parameters_of

#: What a node needs that runs beside others and has no node to talk to.
ALONE = {
    "fvs_detector_node": {"object_tag_id": 10},
    "fvs_dashboard": {"port": 0},
    "fvs_recorder_node": {"images": False},
    "fvs_sim_node": {  # as beside a detector
        "joint_state_rate_hz": 10,
        "image_rate_hz": 1.0,
        "simulated_time": True,
        "publish_ball_position": False,
        "object_tag_id": 10,
    },
}
#: With these, a node has other topics, and needs no model.
OTHERS = {
    "method": "lkf",
    "online.initial": "zero",
    "command_interface": "position",
}
#: What rclpy gives every node.
BUILT_IN = {"use_sim_time", "start_type_description_service"}
#: Topics that a node has for some time only, with ``tf2_msgs``, or with one alone of OTHERS; beside
#: a detector the simulator publishes no images of tool and object.
AT_TIMES = {
    topics.COLOR_IMAGE,
    topics.CAMERA_INFO,
    topics.COMMANDS,
    topics.POSITION_COMMANDS,
    topics.TF_STATIC,
    *(
        topic
        for kind in KINDS.values()
        for topic in (kind.topics.tool, kind.topics.object, kind.topics.object_truth)
    ),
}
TOPICS = (*topics.COMMON, *(topic for kind in KINDS.values() for topic in kind.topics))
#: Those that each camera has.
OF_CAMERAS = {topic for kind in KINDS.values() if not kind.rigid for topic in kind.topics}
#: Time in which what is not declared would show.
SETTLE_S = 1.0


class LoneNode:
    """One running node: its ends in the ROS graph, and its parameter services."""

    def __init__(self, harness, name, namespace, overrides):
        self.harness, self.name, self.namespace = harness, name, f"/{namespace}"
        parameters = parameters_of(name)
        overrides = {**ALONE.get(name, {}), **overrides}
        if overrides.get("feature") == "points":
            overrides.pop("object_tag_id", None)  # which are not relative to an object
            if name == topics.DEMO:
                overrides["cameras"] = ["front", "side"]  # of the model in the package
        self.declared, self.values = {p.name: p for p in parameters}, parameters.values(overrides)
        self.client = AsyncParameterClient(harness.node, self.resolve("~"))
        self.arguments = ros_arguments({"__ns": self.namespace}, **overrides)

    def resolve(self, name):
        """The full name of a topic or service that it uses, where nothing is remapped."""
        own = f"{self.namespace.rstrip('/')}/{name.replace('~', self.name, 1)}"
        return name if name.startswith("/") else own

    def ends(self, publishing):
        """Full name, type and quality of service of each of its ends in the graph."""
        graph, what = self.harness.node, "publisher" if publishing else "subscriber"
        by_node = getattr(graph, f"get_{what}_names_and_types_by_node")
        by_topic = getattr(graph, f"get_{what}s_info_by_topic".replace("scribers", "scriptions"))
        ignored = {"/rosout", "/parameter_events"} if publishing else {"/clock"}
        return {
            (name, info.topic_type, info.qos_profile.reliability, info.qos_profile.durability)
            for name, _ in by_node(self.name, self.namespace)
            if name not in ignored
            for info in by_topic(name)
            if (info.node_name, info.node_namespace) == (self.name, self.namespace)
        }

    def serves(self):
        """Name and type of each of its services that not every node has."""
        services = self.harness.node.get_service_names_and_types_by_node(self.name, self.namespace)
        every = ("rcl_interfaces/", "type_description_interfaces/")
        return {(name, kind) for name, (kind,) in services if not kind.startswith(every)}

    def answer(self, future):
        """What it answers to a request."""
        self.harness.spin_until(future.done, what=f"an answer of {self.name}")
        return future.result()

    def listed(self):
        return set(self.answer(self.client.list_parameters()).result.names) - BUILT_IN

    def get(self, names):
        values = self.answer(self.client.get_parameters(list(names))).values
        return dict(zip(names, map(parameter_value_to_python, values), strict=True))

    def set(self, values):
        """What it answers to all values, by name."""
        parameters = [RosParameter(name, value=value) for name, value in values.items()]
        return dict(zip(values, self.ask(*parameters), strict=True))

    def ask(self, *parameters):
        return self.answer(self.client.set_parameters(parameters)).results

    def ask_at_once(self, *parameters):
        return self.answer(self.client.set_parameters_atomically(parameters)).result


@pytest.fixture(params=list(NODES))
def nodes(ros_test, request):
    """A node with its defaults, and with its other topics, in one process."""
    name = request.param
    parameters = parameters_of(name)
    others = {key: value for key, value in OTHERS.items() if key in parameters}
    kinds = parameters["feature"].choices if "feature" in parameters else ()
    own = [LoneNode(ros_test, name, "lone", {})]
    for kind in kinds:
        if kind != parameters["feature"].default:
            own.append(LoneNode(ros_test, name, f"other_{kind}", {**others, "feature": kind}))
    if others and not kinds:
        own.append(LoneNode(ros_test, name, "other", others))
    for node in own:
        if "simulated_time" in node.values:  # waits for who answers, and does not race
            topic = f"forward_{node.values['command_interface']}_controller/commands"
            commander = ros_test.node.create_publisher(
                Float64MultiArray, node.resolve(topic), ros.QOS_RELIABLE
            )
            rest = partial(commander.publish, ros.to_command(np.zeros(6)))
            ros_test.node.create_timer(0.5, rest)
    arguments = json.dumps([node.arguments for node in own])
    process = ros_test.start("patient_node", NODE_TABLE[name].module, arguments)
    # A node that has spoken has made all that it makes at its start.
    diagnostics = ros_test.collect(DiagnosticArray, topics.DIAGNOSTICS.name, 10)
    names = {node.resolve("~") for node in own}
    ros_test.spin_until(
        lambda: names <= {status.name for message in diagnostics for status in message.status},
        30.0,
        f"diagnostics of {sorted(names)}",
    )
    ros_test.spin_for(SETTLE_S)
    yield own
    assert process.poll() is None
    assert "Traceback" not in ros_test.output(process)


# ---- topics and services ----------------------------------------------------------------------


def declared_ends(node, publishing):
    """Topic of each full name, type and quality of service that a node may use."""
    ends = {}
    for topic in TOPICS:
        cameras = node.values.get("cameras", [""]) if topic in OF_CAMERAS else [""]
        if node.name in (topic.publishers if publishing else topic.subscribers):
            qualities = [topic.offers] if publishing else [*topic.asks, topics.Qos.RELIABLE]
            for qos, camera in product(qualities, cameras):
                profile = ros.PROFILES[qos]
                name = node.resolve(topics.of_camera(topic, camera).name)
                ends[name, topic.type, profile.reliability, profile.durability] = topic
    return ends


def assert_has_the_declared_topics(nodes, publishing):
    """Each node has declared ends alone, and together they have all."""
    used = set()

    def look():
        for node in nodes:
            declared = declared_ends(node, publishing)
            ends = node.ends(publishing)
            if publishing or node.name != topics.RECORDER:  # that finds those of the others
                assert ends <= set(declared)
            used.update(declared[end] for end in ends if end in declared)
        return set(declared_ends(nodes[0], publishing).values()) - used <= AT_TIMES

    nodes[0].harness.spin_until(look, what="declared topics")


def assert_serves_exactly_the_declared(node):
    expected = {
        (node.resolve(name), kind)
        for name, (kind, _) in SERVICES.items()
        if name.startswith(f"{node.name}/")
    }
    node.harness.spin_until(lambda: expected <= node.serves(), what="the declared services")
    assert node.serves() == expected


# ---- parameters -------------------------------------------------------------------------------


def changed(value, parameter):
    """Another allowed value of a live parameter, near the given one."""
    if parameter.is_list:
        return [changed(each, replace(parameter, default=each)) for each in value]
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


def assert_has(node, values):
    actual = node.get(values)
    assert [name for name in values if not np.array_equal(actual[name], values[name])] == []


def assert_refused(result, *words):
    assert not result.successful
    assert re.fullmatch(r"[\w'].{15,}", result.reason, re.S), f"no sentence: {result.reason!r}"
    for word in words:
        assert word in result.reason, f"{word!r} is not in {result.reason!r}"


def assert_lists_and_describes_parameters(node):
    assert node.listed() == set(node.declared)
    assert_has(node, node.values)
    descriptors = node.answer(node.client.describe_parameters(list(node.declared))).descriptors
    for descriptor in descriptors:
        name, parameter = descriptor.name, node.declared[descriptor.name]
        kind = RosParameter.Type.from_parameter_value(parameter.default)
        assert descriptor.type == kind.value, name
        assert descriptor.description == parameter.description
        assert descriptor.additional_constraints == parameter.expected()
        assert descriptor.read_only is not parameter.live, name


def assert_live_parameters_change(node):
    live = {name: p for name, p in node.declared.items() if p.live}
    before = node.get(live)
    for values in ({name: changed(p.default, p) for name, p in live.items()}, before):
        assert [r.reason for r in node.set(values).values() if not r.successful] == []
        assert_has(node, values)


#: Values that the controller refuses, and words of each refusal.
REFUSED = {
    "max_joint_velocity_rad_s": (-1.0, "number from"),
    "alpha1": (float("nan"), "number from"),
    "workspace_min_m": ([0.0, 0.0], "a list of numbers"),
    "target_feed_forward": ("yes", "true or false"),
    "law": ("nonsense", "one of"),
    "joint_state_rate_hz": (100.0, "at start"),
    "no_such_parameter": (1.0, "known are"),
}


def assert_refuses_wrong_values(node):
    results = node.set({name: value for name, (value, _) in REFUSED.items()})
    for name, (_, words) in REFUSED.items():
        assert_refused(results[name], name, words)


def assert_refuses_malformed_requests(node):
    for name in ("law", "no_such_parameter", "use_sim_time", "qos_overrides.x", "", "\x1b"):
        odd = [  # the types of lists, none, and unknown ones
            ParameterMessage(name=name, value=ParameterValue(type=number))
            for number in (0, *range(5, 12), 77, 255)
        ]
        assert not any(result.successful for result in node.ask(*odd, *odd))
        assert not any(node.ask_at_once(message).successful for message in odd)


def assert_refuses_large_requests(node):
    value = RosParameter("law", value="ftsm").get_parameter_value()
    for names in (["law"] * 1000, ["x" * 10**6]):
        many = [ParameterMessage(name=name, value=value) for name in names]
        for result in (*node.ask(*many), node.ask_at_once(*many)):
            assert_refused(result, "too large")
            assert len(result.reason) < 200


# ---- promises ---------------------------------------------------------------------------------


def test_every_node_that_can_be_started_is_declared():
    assert list(NODES) == list(NODE_TABLE)


def test_a_node_is_on_the_wire_as_declared_and_keeps_or_refuses_parameters(nodes):
    for publishing in (True, False):
        assert_has_the_declared_topics(nodes, publishing)
    assert_serves_exactly_the_declared(nodes[0])
    assert_lists_and_describes_parameters(nodes[0])
    assert_live_parameters_change(nodes[0])
    if nodes[0].name == topics.CONTROLLER:  # the base of all nodes refuses
        assert_refuses_wrong_values(nodes[0])
        assert_refuses_malformed_requests(nodes[0])
        assert_refuses_large_requests(nodes[0])
        assert nodes[0].listed() == set(nodes[0].declared)
        assert_has(nodes[0], nodes[0].values)
