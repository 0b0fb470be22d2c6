"""What is generated from the declarations is up to date; parameters have SI units."""

from fvs_ros.params import parameters_of
from fvs_ros.topics import NODES
from fvs_tools import reference


def test_the_committed_page_is_what_would_be_written_now():
    # No long comparison: the remedy is the same whatever differs.
    same = reference.PAGE.read_text(encoding="utf-8") == reference.page()
    assert same, f"run {reference.COMMAND}"


def test_parameters_have_si_units_and_no_negative_time_rate_or_size():
    for node in NODES:
        for parameter in parameters_of(node):
            where, name = f"{node}: {parameter.name}", parameter.name
            assert not name.endswith(("_ms", "_mm", "_cm", "_us", "_ns")), where
            if name.endswith(("_s", "_hz", "radius_m", "error_m", "_rad_s2")):
                # Stamps may be early.
                assert (parameter.minimum or 0.0) >= 0.0 or name == "stamp_delay_s", where
