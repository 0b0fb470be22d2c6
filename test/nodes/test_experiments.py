"""The laboratory's spot check: the real nodes settle as its lock step says."""

import pytest

pytest.importorskip("joblib")

from fvs_lab.experiment import Context
from fvs_lab.search import PROPOSED, REGIMES, Search
from fvs_lab.spot_check import spot_checks
from fvs_lab.trials import Conditions, make_cases
from fvs_tools.schemes import SCHEMES


def test_the_nodes_settle_as_soon_as_the_lock_step_says(tmp_path):
    (case,) = cases = make_cases("EXP", 1, 901)
    trial = Search.of(SCHEMES[PROPOSED], REGIMES[-1]).trial({}, case, Conditions())
    context = Context(tmp_path, jobs=1, quick=True, nodes=True)
    check = spot_checks(context, {PROPOSED: trial}, cases, "servo")[0]
    assert check.problem == ""
    assert len(check.nodes_s) == 1
    assert [len(times) for times in check.lock_step_s] == [1, 1]
    assert None not in check.nodes_s
    assert abs(check.worst_s()) < 0.1
