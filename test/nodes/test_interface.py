"""The running nodes have on the wire what fvs_ros/topics.py declares, no more and no less."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from every_node import LoneNode, start_alone, wait_until_up
from geometry_msgs.msg import PointStamped
from harness import Harness
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.topics import INTERFACES
from fvs_tools.scenario import NODE_TABLE
from fvs_tools.security_policy import policy

RELIABILITY = {
    ReliabilityPolicy.RELIABLE: "reliable",
    ReliabilityPolicy.BEST_EFFORT: "best effort",
}
DURABILITY = {
    DurabilityPolicy.VOLATILE: "volatile",
    DurabilityPolicy.TRANSIENT_LOCAL: "transient local",
}
#: Time in which what nobody declared would show.
_SETTLE_S = 1.0


def variants():
    """Every node with its defaults, and with other values wherever its topics depend on them."""
    found = []
    for name, interface in INTERFACES.items():
        declared = NODE_TABLE[name].parameters()
        others = {}
        for end in (*interface.publishes, *interface.subscribes):
            if end.given is not None:
                parameter, value = declared[end.given[0]], end.given[1]
                if value == parameter.default:
                    values = parameter.choices or (False, True)
                    value = next(one for one in values if one != parameter.default)
                others[parameter.name] = value
        found += [(name, {})] + ([(name, others)] if others else [])
    return found


def label(variant):
    name, given = variant
    return "-".join([name, *(f"{key}={value}" for key, value in given.items())])


def namespace(index):
    return f"lone_{index}"


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """All variants at once, and the node that looks at them."""
    harness = Harness(tmp_path_factory.mktemp("interface"))
    try:
        nodes = []
        for index, (name, given) in enumerate(variants()):
            # Somebody who could command: a simulator in simulated time then does not race.
            if name == "fvs_sim_node":
                harness.node.create_publisher(
                    Float64MultiArray,
                    f"/{namespace(index)}/{topics.COMMANDS.name}",
                    ros.QOS_RELIABLE,
                )
            nodes.append(start_alone(harness, name, namespace(index), **given))
        wait_until_up(harness, nodes)
        harness.spin_for(_SETTLE_S)
        yield harness, nodes
    finally:
        harness.close()


def expected_ends(node, publishing, later=False):
    """Full name, type, reliability, durability of each end that a node must have, sorted."""
    interface = INTERFACES[node.name]
    values = node.values()
    return sorted(
        (node.resolve(end.topic.name), end.topic.type, qos.reliability, qos.durability)
        for end in (interface.publishes if publishing else interface.subscribes)
        if (later or not end.later) and (end.given is None or values[end.given[0]] == end.given[1])
        for qos in end.qos
    )


def actual_ends(harness, node, publishing):
    """The same, as the ROS graph has it, without what rclpy gives every node."""
    graph = harness.node
    if publishing:
        by_node, by_topic = (
            graph.get_publisher_names_and_types_by_node,
            graph.get_publishers_info_by_topic,
        )
        ignored = topics.EVERY_NODE_PUBLISHES
    else:
        by_node, by_topic = (
            graph.get_subscriber_names_and_types_by_node,
            graph.get_subscriptions_info_by_topic,
        )
        ignored = topics.EVERY_NODE_SUBSCRIBES
    found = []
    for name, _types in by_node(node.name, f"/{node.namespace}"):
        if name in ignored:
            continue
        for info in by_topic(name):
            if (info.node_name, info.node_namespace) == (node.name, f"/{node.namespace}"):
                qos = info.qos_profile
                found.append(
                    (
                        name,
                        info.topic_type,
                        RELIABILITY[qos.reliability],
                        DURABILITY[qos.durability],
                    )
                )
    return sorted(found)


def services(harness, node, clients=False):
    graph = harness.node
    by_node = (
        graph.get_client_names_and_types_by_node
        if clients
        else graph.get_service_names_and_types_by_node
    )
    return [
        (name, kind) for name, kinds in by_node(node.name, f"/{node.namespace}") for kind in kinds
    ]


def difference(expected, actual):
    """Both ways, in words; empty if there is none."""
    missing = [f"declared, not there: {end}" for end in expected if end not in actual]
    extra = [f"there, not declared: {end}" for end in actual if end not in expected]
    return "\n".join([*missing, *extra])


def test_every_node_that_can_be_started_is_declared():
    assert list(INTERFACES) == list(NODE_TABLE)


@pytest.mark.parametrize("publishing", [True, False], ids=["publishers", "subscriptions"])
@pytest.mark.parametrize("index", range(len(variants())), ids=map(label, variants()))
def test_a_node_has_exactly_the_declared(running, index, publishing):
    harness, nodes = running
    node = nodes[index]
    expected = expected_ends(node, publishing)
    harness.spin_until(
        lambda: not set(expected) - set(actual_ends(harness, node, publishing)),
        what=f"the declared topics of {node.full_name}",
    )
    if INTERFACES[node.name].hears_all and not publishing:
        return  # it goes on finding the topics of the others here
    assert not difference(expected, actual_ends(harness, node, publishing))


@pytest.mark.parametrize("index", range(len(variants())), ids=map(label, variants()))
def test_a_node_serves_and_calls_exactly_the_declared(running, index):
    harness, nodes = running
    node = nodes[index]
    standard = {node.resolve(name) for name in topics.EVERY_NODE_SERVES}
    expected = [(node.resolve(s.name), s.type) for s in INTERFACES[node.name].serves]

    def found():
        return [service for service in services(harness, node) if service[0] not in standard]

    harness.spin_until(
        lambda: not set(expected) - set(found()), what=f"the services of {node.full_name}"
    )
    assert sorted(found()) == sorted(expected)
    calls = {name for name, _ in services(harness, node, clients=True)}
    assert calls == {node.resolve(name) for name in INTERFACES[node.name].calls}


@pytest.mark.parametrize("index", range(len(variants())), ids=map(label, variants()))
def test_the_access_rules_allow_all_that_a_node_has(running, index):
    harness, nodes = running
    node = nodes[index]
    graph, where = harness.node, f"/{node.namespace}"
    root = ET.fromstring(policy(node.namespace).split("?>", 1)[1])
    profile = root.find(f"enclaves/enclave[@path='{node.full_name}']/profiles/profile")

    def allowed(kind, verb):
        rules = profile.findall(f"{kind}s[@{verb}='ALLOW']/{kind}")
        return {node.resolve(rule.text) for rule in rules}

    published = {n for n, _ in graph.get_publisher_names_and_types_by_node(node.name, where)}
    heard = {n for n, _ in graph.get_subscriber_names_and_types_by_node(node.name, where)}
    assert published <= allowed("topic", "publish")
    if INTERFACES[node.name].hears_all:
        assert "/*" in allowed("topic", "subscribe")
    else:
        assert heard <= allowed("topic", "subscribe")
    assert {name for name, _ in services(harness, node)} == allowed("service", "reply")


def test_the_demo_subscribes_to_images_after_its_last_target(ros_test):
    node = start_alone(ros_test, "fvs_demo_node", "lone", targets=1, target_s=1.0)
    wait_until_up(ros_test, [node])
    status, ball, joints = (
        ros_test.publisher(kind, node.resolve(topic), ros.QOS_RELIABLE)
        for kind, topic in (
            (DiagnosticStatus, topics.CONTROLLER_STATUS.name),
            (PointStamped, topics.TRUE_BALL_POSITION.name),
            (JointState, topics.JOINT_STATES.name),
        )
    )
    targets = ros_test.collect(
        PointStamped, node.resolve(topics.TARGET_POSITION.name), ros.QOS_LATCHED
    )

    def play(stamp_s):
        status.publish(ros.to_status(ros.WARN, "", "", {"state": "WAITING", "reason": "NO_TARGET"}))
        joints.publish(ros.to_joint_state(stamp_s, UR_JOINT_NAMES, np.zeros(6), np.zeros(6)))
        ball.publish(ros.to_point(stamp_s, CAMERA_FRAME, np.array([0.0, 0.1, 1.4])))

    def given_a_target():
        play(1.0)
        return bool(targets)

    def past_its_time():
        play(3.0)
        return actual_ends(ros_test, node, False) == expected_ends(node, False, later=True)

    ros_test.spin_until(given_a_target, what="the demo's target")
    assert not difference(expected_ends(node, False), actual_ends(ros_test, node, False))
    ros_test.spin_until(past_its_time, what="the demo's subscriptions of images")


def test_a_difference_is_seen_both_ways():
    node = LoneNode("fvs_controller_node", "")
    declared = expected_ends(node, publishing=True)
    assert not difference(declared, declared)
    assert "declared, not there: ('/sliding_variable'" in difference(
        declared, [end for end in declared if end[0] != "/sliding_variable"]
    )
    assert "there, not declared: ('/secret'" in difference(
        declared, [*declared, ("/secret", "std_msgs/msg/Bool", "reliable", "volatile")]
    )
