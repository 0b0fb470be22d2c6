"""What the laboratory stands on: statistics, claims, tables, reports."""

import numpy as np
import pytest
from cases import each
from scipy.stats import bootstrap

from fvs_lab.experiment import Claim, Part
from fvs_lab.results import Interval, Results, Table, median, ratio_of_medians

INF = float("inf")


# --- statistics ---


def test_the_interval_of_a_median_is_that_of_scipy():
    data = np.random.default_rng(1).lognormal(size=41)
    own = median(data)
    other = bootstrap((data,), np.median, method="percentile", n_resamples=4000, random_state=2)
    assert own.value == np.median(data)
    assert own.low == pytest.approx(other.confidence_interval.low, rel=0.1)
    assert own.high == pytest.approx(other.confidence_interval.high, rel=0.1)


def test_runs_that_never_settle_count_as_infinitely_slow():
    assert median([0.5, INF, 0.7]).value == 0.7
    assert median([0.5, INF, INF]).value == INF
    assert "never" in median([0.5, INF, INF]).text()
    assert ratio_of_medians([1.0, 1.0, 1.0], [2.0, INF, INF]).value == 0.0
    assert ratio_of_medians([INF] * 3, [INF] * 3).value == INF


def test_the_ratio_is_paired():
    slow = np.random.default_rng(3).uniform(1.0, 10.0, 30)
    ratio = ratio_of_medians(0.5 * slow, slow)
    assert ratio.value == ratio.low == ratio.high == 0.5
    with pytest.raises(ValueError, match="as many"):
        ratio_of_medians([1.0], [1.0, 2.0])


def test_an_interval_on_both_sides_of_a_bound_decides_nothing():
    for low, high, holds in ((1.06, 1.2, True), (0.9, 1.04, False), (0.9, 1.2, None)):
        interval = Interval(0.5 * (low + high), low, high)
        assert interval.above(1.05) is holds
        assert interval.below(1.05) is (None if holds is None else not holds)
    touching = Interval(1.1, 1.0, 1.2)
    assert touching.below(1.0) is touching.above(1.0) is None
    few, enough = (ratio_of_medians([1.0] * n, [2.0] * n) for n in (5, 6))
    assert (few.below(1.0), enough.below(1.0)) == (None, True)


# --- claims and tables ---


@each(
    ("parts", "all_of", "any_of"),
    [
        ([True, True], True, True),
        ([True, None], None, True),
        ([None, False], False, None),
        ([False, False], False, False),
    ],
)
def test_a_claim_of_several_parts_names_the_one_that_decides(parts, all_of, any_of):
    claimed = [Part(str(number), "", holds, number) for number, holds in enumerate(parts)]
    every, either = Claim("", claimed), Claim("", claimed, any_of=True)
    assert (every.holds, either.holds) == (all_of, any_of)
    assert (every.decisive.holds, either.decisive.holds) == (all_of, any_of)
    if parts == [True, True]:
        # The tighter, the clearer.
        assert (every.decisive, either.decisive) == (claimed[1], claimed[0])


def test_a_table_has_a_row_per_group_and_values_side_by_side():
    runs = Results(
        {"scheme": scheme, "world": world, "settled": time_s < INF, "to_5mm_s": time_s}
        for scheme, world, time_s in (("a", "x", 1.0), ("a", "y", 2.0), ("b", "x", INF))
    )
    assert Table("", ["scheme"], ["to_5mm_s:half"], across="world").rows(runs) == [
        {"scheme": "a", "x": "1.00", "y": "2.00"},
        {"scheme": "b", "x": "never", "y": "-"},
    ]
    first, _ = Table("", ["scheme"], ["to_5mm_s", "settled:of"]).rows(runs)
    assert first == {"scheme": "a", "to 5 mm, s": "1.50 [1.00, 2.00]", "settled": "2 of 2"}
