"""What is generated from the declarations is up to date, complete and readable."""

import re

from fvs_controller_node.reasons import Reason, State
from fvs_ros import topics
from fvs_ros.kinds import KINDS
from fvs_tools import reference
from fvs_tools.scenario import NODE_TABLE


def test_the_committed_page_is_what_would_be_written_now():
    # No long comparison: the remedy is the same whatever differs.
    same = reference.PAGE.read_text(encoding="utf-8") == reference.page()
    assert same, f"run {reference.COMMAND}"


def test_the_page_names_everything_in_whole_tables():
    page = reference.page()
    for table in re.findall(r"(?:^\|.*\n)+", page, re.M):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}) == 1, table
    kinds = (topic for kind in KINDS.values() for topic in kind.topics)
    for topic in (*topics.COMMON, *kinds):
        assert f"`{topic.name}`" in page or topic.name.endswith("_node/status")
    assert all(f"`{service}`" in page for service in topics.SERVICES)
    for node in topics.NODES:
        assert f"\n### {node}\n" in page
        for parameter in NODE_TABLE[node].parameters():
            assert f"| `{parameter.name}` " in page
    for item in (*Reason, *State):
        assert f"`{item.name}`" in page


def test_parameters_have_si_units_and_no_negative_time_rate_or_size():
    for node, entry in NODE_TABLE.items():
        for one in entry.parameters():
            assert not one.name.endswith(("_ms", "_mm", "_cm", "_us", "_ns")), (node, one.name)
            signed = one.name == "stamp_delay_s"  # stamps may be early
            if one.name.endswith(("_s", "_hz", "radius_m", "error_m", "_rad_s2")) and not signed:
                assert one.minimum is not None, (node, one.name)
                assert one.minimum >= 0.0, (node, one.name)
