"""What is generated from the declarations is up to date; parameters have SI units."""

from fvs_tools import reference
from fvs_tools.scenario import NODE_TABLE


def test_the_committed_page_is_what_would_be_written_now():
    # No long comparison: the remedy is the same whatever differs.
    same = reference.PAGE.read_text(encoding="utf-8") == reference.page()
    assert same, f"run {reference.COMMAND}"


def test_parameters_have_si_units_and_no_negative_time_rate_or_size():
    for node, entry in NODE_TABLE.items():
        for parameter in entry.parameters():
            where, name = f"{node}: {parameter.name}", parameter.name
            assert not name.endswith(("_ms", "_mm", "_cm", "_us", "_ns")), where
            if name.endswith(("_s", "_hz", "radius_m", "error_m", "_rad_s2")):
                # Stamps may be early.
                assert (parameter.minimum or 0.0) >= 0.0 or name == "stamp_delay_s", where
