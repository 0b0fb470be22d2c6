"""The running nodes have on the wire what fvs_ros/topics.py declares, no more and no less."""

import xml.etree.ElementTree as ET

import pytest
from every_node import start_alone, wait_until_up
from harness import Harness
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics
from fvs_ros.topics import NODES
from fvs_tools.reference import policy
from fvs_tools.scenario import NODE_TABLE

#: Time in which what is not declared would show.
_SETTLE_S = 1.0


def variants():
    """Every node with its defaults, and with other values wherever its topics depend on them."""
    found = []
    for name in NODES:
        declared, others = NODE_TABLE[name].parameters(), {}
        for end in (*topics.publishers(name).values(), *topics.subscribers(name).values()):
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


every_node = pytest.mark.parametrize("index", range(len(variants())), ids=map(label, variants()))


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """All variants at once, and the node that looks at them."""
    harness = Harness(tmp_path_factory.mktemp("interface"))
    try:
        nodes = []
        for index, (name, given) in enumerate(variants()):
            namespace = f"lone_{index}"
            # A commander, so that a simulator in simulated time does not race.
            if name == topics.SIM:
                commands = f"/{namespace}/{topics.COMMANDS.name}"
                harness.node.create_publisher(Float64MultiArray, commands, ros.QOS_RELIABLE)
            nodes.append(start_alone(harness, name, namespace, **given))
        wait_until_up(harness, nodes)
        harness.spin_for(_SETTLE_S)
        yield harness, nodes
    finally:
        harness.close()


def expected_ends(node, publishing, later=False):
    """Full name, type, reliability, durability of each end that a node must have, sorted."""
    values = node.values()
    ends = topics.publishers(node.name) if publishing else topics.subscribers(node.name)
    return sorted(
        (
            node.resolve(topic.name),
            topic.type,
            ros.PROFILES[qos].reliability,
            ros.PROFILES[qos].durability,
        )
        for topic, end in ends.items()
        if (later or not end.later) and (end.given is None or values[end.given[0]] == end.given[1])
        for qos in end.qos
    )


def actual_ends(harness, node, publishing):
    """The same, as the ROS graph has it, without what rclpy gives every node."""
    graph = harness.node
    if publishing:
        by_topic, ignored = graph.get_publishers_info_by_topic, topics.EVERY_NODE_PUBLISHES
    else:
        by_topic, ignored = graph.get_subscriptions_info_by_topic, topics.EVERY_NODE_SUBSCRIBES
    return sorted(
        (
            name,
            info.topic_type,
            ReliabilityPolicy(info.qos_profile.reliability),
            DurabilityPolicy(info.qos_profile.durability),
        )
        for name, _types in of_node(harness, node, "publisher" if publishing else "subscriber")
        if name not in ignored
        for info in by_topic(name)
        if (info.node_name, info.node_namespace) == (node.name, f"/{node.namespace}")
    )


def of_node(harness, node, kind):
    """Names and types of a node's publishers, subscribers, services or clients."""
    found = getattr(harness.node, f"get_{kind}_names_and_types_by_node")
    return {(name, one) for name, types in found(node.name, f"/{node.namespace}") for one in types}


def test_every_node_that_can_be_started_is_declared():
    assert list(NODES) == list(NODE_TABLE)


@pytest.mark.parametrize("publishing", [True, False], ids=["publishers", "subscriptions"])
@every_node
def test_a_node_has_exactly_the_declared(running, index, publishing):
    harness, nodes = running
    node = nodes[index]
    expected = expected_ends(node, publishing)
    harness.spin_until(
        lambda: not set(expected) - set(actual_ends(harness, node, publishing)),
        what=f"the declared topics of {node.full_name}",
    )
    if (
        publishing or not NODES[node.name].subscribes_to_all
    ):  # that goes on finding those of the others
        assert actual_ends(harness, node, publishing) == expected


@every_node
def test_a_node_serves_and_calls_exactly_the_declared(running, index):
    harness, nodes = running
    node = nodes[index]
    standard = {node.resolve(name) for name in topics.EVERY_NODE_SERVES}
    expected = {(node.resolve(one), kind) for one, (kind, _) in NODES[node.name].serves.items()}

    def found():
        return {one for one in of_node(harness, node, "service") if one[0] not in standard}

    harness.spin_until(lambda: expected <= found(), what=f"the services of {node.full_name}")
    assert found() == expected
    calls = {name for name, _ in of_node(harness, node, "client")}
    assert calls == {node.resolve(name) for name in NODES[node.name].calls}


@every_node
def test_the_access_rules_allow_all_that_a_node_has(running, index):
    harness, nodes = running
    node = nodes[index]
    root = ET.fromstring(policy(node.namespace).split("?>", 1)[1])
    profile = root.find(f"enclaves/enclave[@path='{node.full_name}']/profiles/profile")

    def allowed(kind, verb):
        rules = profile.findall(f"{kind}s[@{verb}='ALLOW']/{kind}")
        return {node.resolve(rule.text) for rule in rules}

    published, heard, served = (
        {name for name, _ in of_node(harness, node, kind)}
        for kind in ("publisher", "subscriber", "service")
    )
    assert published <= allowed("topic", "publish")
    assert served == allowed("service", "reply")
    if NODES[node.name].subscribes_to_all:
        assert "/*" in allowed("topic", "subscribe")
    else:
        assert heard <= allowed("topic", "subscribe")
