"""How slow the paper's other schemes are once they are as calm at rest as the extended one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fvs_ros.apps.experiments.beyond_terms import EXTENDED, LIMITS, trial_of
from fvs_ros.apps.experiments.context import Context
from fvs_ros.apps.experiments.search import Found, Limit, run_searches
from fvs_ros.apps.experiments.servo_terms import BASELINES, Regime, search_of
from fvs_ros.apps.experiments.trials import Case, Conditions, run_trial

#: Longest run, and rest at the end of a tuning run, s: calm is slow.
DURATION_S, _REST_S = 8.0, 2.0
#: True positions with the same noise, coarser physics: fast enough to search.
_TUNING = Conditions(rendered=False, physics_rate_hz=125.0)
_SEARCH_SEED = 8


def calm(context: Context, cases: Sequence[Case]) -> dict[str, Found]:
    """Find the fastest gains that are no more restless at rest than the extended scheme.

    Parameters
    ----------
    context : Context
        For its cores.
    cases : sequence of Case
        The tuning cases.

    Returns
    -------
    dict of str to Found
        By scheme.
    """
    yardsticks = context.map(
        run_trial, [trial_of(EXTENDED, case, _TUNING) for case in cases], "yardstick"
    )
    jitter_rad_s = float(np.median([one.jitter_rad_s for one in yardsticks]))
    limit = Limit("jitter_rad_s", jitter_rad_s)
    regime = Regime("calm", "", "", LIMITS, limit, DURATION_S, _REST_S)
    names = BASELINES[:1] if context.quick else BASELINES
    found = run_searches(
        context,
        [search_of(name, regime) for name in names],
        cases,
        _TUNING,
        generations=1 if context.quick else 6,
        population=4 if context.quick else 8,
        seed=_SEARCH_SEED,
    )
    return dict(zip(names, found, strict=True))
