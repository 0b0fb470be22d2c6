"""The laboratory's experiments on the control law: runs, verdicts, reports."""

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest

pytest.importorskip("joblib")
pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from fvs_controller_node.reaching import ReachingLaw
from fvs_controller_node.settling import settling_times
from fvs_controller_node.surface import SlidingSurface
from fvs_lab import (
    ablation,
    ablation_changes,
    ablation_rests,
    ablation_verdicts,
    exponents,
    exponents_variants,
    exponents_verdicts,
    settling,
    settling_bounds,
    settling_runs,
    settling_verdicts,
)
from fvs_lab.context import Context
from fvs_lab.report import Origin, write_page, write_report
from fvs_lab.trials import BOUNDS_M, Conditions, Trial, make_cases, run_trial

EXACT = Conditions(rendered=False)


def verdict(verdicts, words):
    """The one verdict whose claim has these words in it."""
    found = [one for one in verdicts if words in one.claim]
    assert len(found) == 1, [one.claim for one in verdicts]
    return found[0]


# ---- runs ---------------------------------------------------------------------------------


def tiny_trials():
    return [
        Trial(case, "rbf", "ftsm", conditions=EXACT, duration_s=0.6, record=True)
        for case in make_cases("t", 2, 1)
    ]


def flat(outcomes):
    return [
        (repr(one.summary()), {k: v.tobytes() for k, v in one.series.items()}) for one in outcomes
    ]


def test_the_same_runs_come_from_one_process_and_from_two():
    here = [run_trial(trial) for trial in tiny_trials()]
    two = Context(Path(mkdtemp()), jobs=2).map(run_trial, tiny_trials(), "test")
    assert flat(here) == flat(two)


def test_a_rest_is_the_same_when_repeated():
    rest = ablation_rests.Rest(make_cases("t", 1, 1)[0], "r", {"rbf.k3": 0.01}, True, 0.3)
    first, again = (ablation_rests.run_rest(rest) for _ in range(2))
    assert first == again
    assert 0.0 < first.error_before < 0.2


# ---- the paper's formula --------------------------------------------------------------------


@pytest.mark.parametrize("y0", [0.3, 0.003, -0.3])
def test_the_printed_sliding_time_is_negative_for_alpha2_below_alpha3(y0):
    surface = SlidingSurface(alpha2=0.3, alpha3=0.45, lambda1=0.344, lambda2=0.154)
    assert settling_bounds.printed_sliding_time_s(y0, surface) < 0.0


def test_the_printed_sliding_time_is_the_formula_of_the_paper():
    surface = SlidingSurface.fixed(0.5, alpha1=1.0, alpha2=1.0, alpha3=0.5)
    # Far and near exponent are the same here, so that each part can be said by hand.
    far, near = (
        np.log(y**-0.5 / (y**-0.5 + 2.0)) / (-0.5 * 0.5) for y in (0.2, surface.switch_error_m)
    )
    assert settling_bounds.printed_sliding_time_s(0.2, surface) == pytest.approx(far + near)


def test_equal_alphas_make_the_printed_time_infinite():
    surface = SlidingSurface.fixed(0.5, alpha2=1.0, alpha3=1.0)
    assert settling_bounds.printed_sliding_time_s(0.2, surface) == np.inf


# ---- the sharper bound and the theory's motion ------------------------------------------------

SURFACE = SlidingSurface(alpha2=1.0, alpha3=0.6)
REACHING = ReachingLaw(k1=1.5, k2=0.1, k4=0.2, sigma=0.75)
ERRORS = np.array([[0.3, -0.1, 0.02], [0.05, 0.2, -0.2], [0.004, 0.001, 0.0]])


@pytest.mark.parametrize("error", ERRORS)
def test_motion_band_bound_and_bound_to_zero_are_in_order(error):
    to_zero = max(
        one.total_s for one in settling_times(error.tolist(), [0.0] * 3, SURFACE, REACHING)
    )
    predicted = settling_bounds.predicted_times_s(error[None, :], SURFACE, REACHING)
    for band in settling_bounds.BANDS:
        to_band = settling_bounds.bound_to_band_s(error, BOUNDS_M[band], SURFACE, REACHING)
        assert predicted[band][0] <= to_band + 0.002
        assert to_band <= to_zero


def test_inside_the_band_the_bound_is_zero():
    assert (
        settling_bounds.bound_to_band_s(np.array([0.001, 0.0, 0.0]), 0.005, SURFACE, REACHING)
        == 0.0
    )


# ---- verdicts on made-up numbers --------------------------------------------------------------


def settling_run(measured_s=1.0, bound_s=2.0, **changes):
    both = dict.fromkeys(settling_bounds.BANDS)
    run = settling_runs.Run(
        gains=settling_runs.FREE_GAINS[0],
        world=settling_runs.SILENT,
        case="c1",
        excluded="",
        measured_s={band: measured_s for band in both},
        bound_s=bound_s,
        band_bound_s={band: 1.2 for band in both},
        predicted_s={band: 1.0 for band in both},
        printed_s=-0.5,
        printed_sliding_s=-0.7,
        sliding_s=1.5,
    )
    return replace(run, **changes)


def test_settling_verdicts_follow_the_shares():
    good = settling_verdicts.verdicts([settling_run() for _ in range(20)])
    assert verdict(good, "corrected bound").holds is True
    assert verdict(good, "sharper bound").holds is True
    assert verdict(good, "predicts the motion").holds is True
    assert verdict(good, "as printed").holds is False

    late = settling_verdicts.verdicts(
        [settling_run() for _ in range(18)] + [settling_run(np.inf)] * 2
    )
    assert verdict(late, "corrected bound").holds is False
    assert "90.0 % of 20 runs" in verdict(late, "corrected bound").finding


def test_runs_outside_the_assumptions_do_not_count():
    excluded = [settling_run(np.inf, excluded="a limit shaped the command")] * 20
    assert (
        "100.0 % of 5 runs"
        in settling_verdicts.verdicts([settling_run()] * 5 + excluded)[0].finding
    )
    assert settling_verdicts.verdicts(excluded)[0].holds is None


def test_a_printed_time_that_is_kept_is_admitted():
    kept = settling_run(printed_s=5.0, printed_sliding_s=4.0)
    assert verdict(settling_verdicts.verdicts([kept] * 20), "as printed").holds is True


def exponent_results(jitter_of, time_of):
    """Results of all variants, three equal cases each."""
    results = {}
    for world in (exponents_variants.SILENT, exponents_variants.NOISY):
        for variant in exponents_variants.variants_of(world):
            key = (world, variant.form, variant.exponent)
            time = time_of(*key)
            results[key] = exponents_variants.Results(
                settling_s={name: [time] * 6 for name in BOUNDS_M},
                jitter_rad_s=[jitter_of(*key)] * 6,
                final_rms_m=[0.0] * 6,
                peak_rad_s=[1.0] * 6,
                limited_share=[0.0] * 6,
                pace=[time] * 6,
                path_ratio=[1.0] * 6,
            )
    return results


def first_number(exponent):
    return float(exponent.split()[0].strip(","))


def test_exponent_verdicts_follow_the_numbers():
    def time(_, __, exponent):
        return first_number(exponent)

    def calm(_, __, exponent):
        return 0.001 if exponent in (exponents_variants.ADAPTIVE, "0.5") else 0.1

    found = exponents_verdicts.verdicts(exponent_results(calm, time))
    assert verdict(found, "the sooner the ball").holds is True
    assert verdict(found, "chatter").holds is True
    assert verdict(found, "adaptive exponent").holds is True
    assert verdict(found, "ends near 1").holds is False

    def reverse(_, __, exponent):
        return 2.0 - first_number(exponent)

    found = exponents_verdicts.verdicts(exponent_results(lambda *_: 0.1, reverse))
    assert verdict(found, "the sooner the ball").holds is False
    assert verdict(found, "chatter").holds is False


def ablation_rows(**settling_s):
    """Every row alike, but for the settling times of those that are named."""
    rows = {
        change.name: ablation_changes.Row(
            change.against,
            {name: [1.0] * 6 for name in BOUNDS_M},
            [0.001] * 6,
            [0.0] * 6,
            [0.01] * 6,
        )
        for change in ablation_changes.all_changes()
    }
    for name, time in settling_s.items():
        rows[name] = replace(rows[name], settling_s={bound: [time] * 6 for bound in BOUNDS_M})
    return rows


def made_up_rests(after_zero=0.4, after_offline=0.01):
    after = {ablation_rests.ZERO_AT_REST: after_zero, ablation_rests.OFFLINE_AT_REST: after_offline}
    return {
        name: [ablation_rests.Rested(name, 0.01, after.get(name, 0.01), {"5 mm": 1.0, "2 mm": 1.0})]
        * 6
        for name in {rest.name for rest in ablation_rests.all_rests(make_cases("t", 1, 1), 1.0)}
    }


def test_changes_that_change_nothing_are_worth_nothing():
    found = ablation_verdicts.verdicts(ablation_rows(), made_up_rests(0.01, 0.3))
    for words in ("Solved implicitly", "breaks down", "Predicting", "cap on"):
        assert verdict(found, words).holds is False, words
    for words in ("online update pays where", "carried round", "printed sign", "toward zero"):
        assert verdict(found, words).holds is False, words
    assert verdict(found, "toward the trained").holds is False
    assert verdict(found, "true Jacobian").holds is True


def test_changes_that_slow_down_are_found():
    slow = {name: 2.0 for name in ablation_rows() if "no prediction" in name}
    slow |= {
        ablation_changes.LITERAL_SAME: np.inf,
        ablation_changes.FROZEN: 2.0,
        ablation_changes.UNCAPPED: 2.0,
    }
    found = ablation_verdicts.verdicts(ablation_rows(**slow), made_up_rests())
    for words in ("breaks down", "Predicting", "online update pays where", "cap on", "toward zero"):
        assert verdict(found, words).holds is True, words
    assert verdict(found, "toward the trained").holds is True


# ---- whole experiments ----------------------------------------------------------------------


@lru_cache(maxsize=1)
def laboratory():
    """One folder for all three, as the page is made of it."""
    return Path(mkdtemp())


@pytest.mark.parametrize(
    ("experiment", "figures"), [(exponents, 3), (settling, 1), (ablation, 1)], ids=lambda one: ""
)
def test_a_quick_run_makes_a_complete_report(experiment, figures):
    out = laboratory()
    context = Context(out, seeds=1, jobs=2, quick=True, rendered=False)
    report = experiment.run(context)
    folder = context.folder(report.name)
    path = write_report(report, folder, Origin("", "", "", True))
    written = json.loads(path.read_text(encoding="utf-8"))
    assert written["data"]["seed"] == experiment.SEED
    assert len(report.figures) == figures
    for figure in report.figures:
        assert (folder / figure.file).stat().st_size > 10_000
    for table in report.tables:
        assert table.rows
        assert {len(row) for row in table.rows} == {len(table.header)}
    assert len({one.claim for one in report.verdicts}) == len(report.verdicts) > 3
    page = write_page(out).read_text(encoding="utf-8")
    assert f'id="{report.name}"' in page
