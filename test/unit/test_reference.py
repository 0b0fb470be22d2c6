"""What is generated from the declarations is up to date, complete and readable."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from fvs_controller_node.reasons import Reason, State
from fvs_ros import topics
from fvs_ros.topics import INTERFACES, resolve
from fvs_tools import reference
from fvs_tools.reference import UNITS, readable, sentence, unit
from fvs_tools.scenario import NODE_TABLE
from fvs_tools.security_policy import OPERATOR, policy

ROOT = Path(__file__).resolve().parents[2]

PARAMETERS = {
    f"{node}:{parameter.name}": parameter
    for node, entry in NODE_TABLE.items()
    for parameter in entry.parameters()
}

#: Named after the paper's symbols, which have no room for a unit.
SYMBOLS = {"damping", "k4", "rbf.k3", "mfac_lambda", "mpc_rho", "mpc_q"}

#: How a description may write a unit, by what the name then ends in.
WRITTEN = {
    "m": "_m",
    "s": "_s",
    "rad": "_rad",
    "rad/s": "_rad_s",
    "rad/s^2": "_rad_s2",
    "m/rad": "_m_rad",
    "m/s": "_m_s",
    "1/s": "_1_s",
    "1/m^2": "_1_m2",
    "Hz": "_hz",
    "degrees": "_deg",
}


# --- the files ---


@pytest.mark.parametrize("name", reference.written())
def test_the_committed_file_is_what_would_be_written_now(name):
    committed = (ROOT / name).read_text(encoding="utf-8")
    # No long comparison: the remedy is the same whatever differs.
    assert committed == reference.written()[name], f"run {reference.COMMAND}"


def test_check_says_so_when_a_file_is_out_of_date(monkeypatch, capsys):
    assert reference.main(["--check"]) == 0
    monkeypatch.setattr(reference, "written", lambda: {reference.PAGE: "something else"})
    assert reference.main(["--check"]) == 1
    assert "docs/reference.md is out of date" in capsys.readouterr().err


def test_the_files_are_installed_or_linked_where_a_user_looks():
    assert reference.POLICY in (ROOT / "setup.py").read_text(encoding="utf-8")
    assert "reference.md" in (ROOT / "docs/architecture.md").read_text(encoding="utf-8")


# --- the page ---


@pytest.fixture(scope="module")
def page():
    return reference.page()


def test_every_link_of_the_page_leads_somewhere(page):
    anchors = {
        re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")
        for heading in re.findall(r"^#+ (.+)$", page, re.M)
    }
    links = re.findall(r"\]\(([^)]+)\)", page)
    assert links
    for link in links:
        if link.startswith("#"):
            assert link[1:] in anchors, link
        else:
            assert (ROOT / "docs" / link).is_file(), link


def test_every_table_row_has_a_cell_for_each_column(page):
    width = None
    for line in page.splitlines():
        columns = len(re.findall(r"(?<!\\)\|", line)) if line.startswith("|") else None
        if columns is not None and width is not None:
            assert columns == width, line
        width = columns


def test_the_page_names_everything(page):
    for node, interface in INTERFACES.items():
        assert f"\n## {node}\n" in page
        for end in (*interface.publishes, *interface.subscribes):
            assert f"`{end.topic.name}`" in page
        for service in interface.serves:
            assert f"`{service.name}`" in page
        for parameter in NODE_TABLE[node].parameters():
            assert f"| `{parameter.name}` |" in page
    for item in (*Reason, *State):
        assert f"`{item.name}`" in page


def test_the_page_has_no_placeholder_left(page):
    assert "{" not in page
    assert "None" not in page


def test_every_heard_topic_comes_from_somewhere():
    published = {
        resolve(end.topic.name, node)
        for node, interface in INTERFACES.items()
        for end in interface.publishes
    }
    for node, interface in INTERFACES.items():
        for end in interface.subscribes:
            known = resolve(end.topic.name, node) in published
            assert known or end.topic.also_from, f"nobody publishes {end.topic.name}"


def test_a_placeholder_becomes_a_word():
    assert readable("{name} is {age_s:.2f} s old") == "*name* is *age* s old"
    assert readable("{best_mm:.0f} to {error_mm:.0f} mm") == "*best* to *error* mm"


def test_a_description_becomes_a_sentence():
    assert sentence("joints after ~/reset") == "Joints after `~/reset`."
    assert sentence("false: images only") == "`false`: images only."
    assert sentence("s decays with k4 / k1 seconds.") == "s decays with k4 / k1 seconds."
    assert sentence("0 takes 3 / switch_error_m^2, 1/m^2") == (
        "0 takes 3 / `switch_error_m`^2, 1/m^2."
    )


# --- parameters ---


def offenders(rule):
    """Descriptions of the parameters that break a rule, by node and name."""
    return {name: p.description for name, p in PARAMETERS.items() if not rule(p)}


def test_every_description_is_more_than_a_word_and_tidy():
    assert not offenders(
        lambda p: (
            len(p.description) >= 12
            and p.description == " ".join(p.description.split())
            and p.description.count("(") == p.description.count(")")
        )
    )


def test_no_description_goes_on_in_another_parameters():
    assert not offenders(lambda p: not re.search(r"^\.\.\.|\.\.\.$", p.description))


def test_a_name_ends_in_the_unit_that_its_description_names():
    def agrees(parameter):
        written = re.search(r", (\S+?)(?=[.;,]?$|; )", parameter.description)
        if written is None or written[1] not in WRITTEN or parameter.name in SYMBOLS:
            return True
        return parameter.name.endswith(WRITTEN[written[1]])

    assert not offenders(agrees)


def test_only_numbers_have_a_unit_and_it_is_si():
    assert not offenders(lambda p: not unit(p.name) or p.kind in (int, float))
    assert not offenders(lambda p: not p.name.endswith(("_ms", "_mm", "_cm", "_us", "_ns")))


def test_the_longest_unit_wins():
    for end, words in UNITS.items():
        assert unit(f"some{end}") == words


def test_a_range_is_that_of_a_number_and_not_empty():
    def sensible(parameter):
        low, high = parameter.minimum, parameter.maximum
        if parameter.kind in (int, float):
            return low is None or high is None or low < high
        return low is None and high is None

    assert not offenders(sensible)


def test_choices_are_several_different_texts():
    assert not offenders(
        lambda p: not p.choices or (p.kind is str and len(set(p.choices)) == len(p.choices) > 1)
    )


def test_a_time_a_rate_and_a_size_cannot_be_negative():
    ends = ("_s", "_hz", "radius_m", "error_m", "_rad_s2")
    signed = "stamp_delay_s"  # stamps may be early
    assert not offenders(
        lambda p: (
            not p.name.endswith(ends)
            or p.name == signed
            or (p.minimum is not None and p.minimum >= 0.0)
        )
    )


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


#: Where a node finds a RealSense under its driver's own names.
REALSENSE = {
    "fvs_detector_node": (
        "camera/camera/color/image_raw",
        "camera/camera/color/image_raw/compressed",
        "camera/camera/aligned_depth_to_color/image_raw",
        "camera/camera/aligned_depth_to_color/image_raw/compressedDepth",
        "camera/camera/color/camera_info",
    ),
    "fvs_dashboard": ("camera/camera/color/image_raw", "camera/camera/color/camera_info"),
}


@pytest.mark.parametrize("namespace", ["", "left", "/cell/left/"])
def test_every_declared_name_is_allowed_under_its_verb(namespace):
    found = profiles(policy(namespace))
    assert len(found) == len(INTERFACES) + 1
    for node, interface in INTERFACES.items():
        profile = found[resolve("~", node, namespace)]
        assert profile.attrib == {"ns": "/" + namespace.strip("/"), "node": node}

        def full(names, node=node):
            return {resolve(name, node, namespace) for name in names}

        assert allowed(profile, "topic", "publish") == full(
            [*(end.topic.name for end in interface.publishes), *topics.EVERY_NODE_PUBLISHES]
        )
        assert allowed(profile, "topic", "subscribe") == full(
            [
                *(end.topic.name for end in interface.subscribes),
                *REALSENSE.get(node, ()),
                *(["/*"] if interface.hears_all else ()),
                *topics.EVERY_NODE_SUBSCRIBES,
            ]
        )
        assert allowed(profile, "service", "reply") == full(
            [*(service.name for service in interface.serves), *topics.EVERY_NODE_SERVES]
        )
        assert allowed(profile, "service", "request") == full(interface.calls)


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


def test_a_person_hears_all_and_calls_all_but_sends_targets_only():
    profile = profiles(policy())[f"/{OPERATOR}"]
    assert allowed(profile, "topic", "publish") == {
        "/target_position",
        *topics.EVERY_NODE_PUBLISHES,
    }
    for node, interface in INTERFACES.items():
        heard = {resolve(end.topic.name, node) for end in interface.publishes}
        called = {resolve(service.name, node) for service in interface.serves}
        assert heard <= allowed(profile, "topic", "subscribe")
        assert called <= allowed(profile, "service", "request")


def test_a_policy_for_a_namespace_is_written_anywhere(tmp_path):
    path = tmp_path / "policy.xml"
    assert reference.main(["--policy", str(path), "--namespace", "left"]) == 0
    assert path.read_text(encoding="utf-8") == policy("left")
    assert "/left/fvs_controller_node" in profiles(policy("left"))
