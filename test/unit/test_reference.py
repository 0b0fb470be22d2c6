"""What is generated from the declarations is up to date, complete and readable."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from fvs_controller_node.reasons import Reason, State
from fvs_ros import contract, topics
from fvs_ros.topics import NODES, resolve
from fvs_tools import reference
from fvs_tools.reference import OPERATOR, policy
from fvs_tools.scenario import NODE_TABLE

ROOT = Path(__file__).resolve().parents[2]

# --- the files ---


@pytest.mark.parametrize("name", reference.written())
def test_the_committed_file_is_what_would_be_written_now(name):
    committed = (ROOT / name).read_text(encoding="utf-8")
    # No long comparison: the remedy is the same whatever differs.
    assert committed == reference.written()[name], f"run {reference.COMMAND}"


# --- the page ---


def test_the_page_names_everything_in_whole_tables():
    page = reference.page()
    for table in re.findall(r"(?:^\|.*\n)+", page, re.M):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}) == 1, table
    for node, on_the_wire in NODES.items():
        assert f"\n### {node}\n" in page
        for topic in (*contract.publishers(node), *contract.subscribers(node)):
            assert f"`{topic.name}`" in page or topic.name.endswith("_node/status")
        for service in on_the_wire.serves:
            assert f"`{service.replace('~', node)}`" in page
        for parameter in NODE_TABLE[node].parameters():
            assert f"| `{parameter.name}` |" in page
    for item in (*Reason, *State):
        assert f"`{item.name}`" in page
    assert "{" not in page
    assert "None" not in page


def test_parameters_have_si_units_and_no_negative_time_rate_or_size():
    for node, entry in NODE_TABLE.items():
        for one in entry.parameters():
            assert not one.name.endswith(("_ms", "_mm", "_cm", "_us", "_ns")), (node, one.name)
            signed = one.name == "stamp_delay_s"  # stamps may be early
            if one.name.endswith(("_s", "_hz", "radius_m", "error_m", "_rad_s2")) and not signed:
                assert one.minimum is not None, (node, one.name)
                assert one.minimum >= 0.0, (node, one.name)


# --- access rules ---


def profiles(text):
    root = ET.fromstring(text.split("?>", 1)[1])
    assert (root.tag, root.attrib) == ("policy", {"version": "0.2.0"})
    return {
        enclave.attrib["path"]: enclave.find("profiles/profile")
        for enclave in root.findall("enclaves/enclave")
    }


def allowed(profile, kind, verb):
    """Full names that a profile allows, as SROS2 resolves them."""
    namespace, node = profile.attrib["ns"], profile.attrib["node"]
    rules = profile.findall(f"{kind}s[@{verb}='ALLOW']/{kind}")
    return {resolve(rule.text, node, namespace) for rule in rules}


def test_joint_commands_come_from_the_controller_and_the_collector_alone():
    text = (ROOT / reference.POLICY).read_text(encoding="utf-8")
    command = resolve(topics.COMMANDS.name, "")
    senders = {
        path
        for path, profile in profiles(text).items()
        if command in allowed(profile, "topic", "publish")
    }
    assert senders == {"/fvs_controller_node", "/fvs_collector_node"}
    for profile in profiles(text).values():
        assert not any("*" in name for name in allowed(profile, "topic", "publish"))


def test_a_person_sends_targets_only():
    profile = profiles(policy())[f"/{OPERATOR}"]
    wanted = {"/target_position", "/target_pose", *topics.EVERY_NODE_PUBLISHES}
    assert allowed(profile, "topic", "publish") == wanted


def test_a_policy_for_a_namespace_is_written_anywhere(tmp_path):
    path = tmp_path / "policy.xml"
    assert reference.main(["--policy", str(path), "--namespace", "left"]) == 0
    assert "/left/fvs_controller_node" in profiles(path.read_text(encoding="utf-8"))


def test_a_node_may_use_all_that_it_declares():
    rules = profiles(policy())
    for node in NODES:
        for verb, ends in (("publish", contract.publishers), ("subscribe", contract.subscribers)):
            may = allowed(rules[f"/{node}"], "topic", verb)
            assert "/*" in may or {resolve(topic.name, node) for topic in ends(node)} <= may
