"""What the paper claims of the estimators, and whether it holds: every verdict is computed."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

from fvs_estimator_node.rbf import RbfConfig
from fvs_lab.estimators_contestants import CONTESTANTS, FAST_N1
from fvs_lab.estimators_recordings import FIRST_S
from fvs_lab.estimators_study import CLEAN, NOISE, Study, World
from fvs_lab.report import Verdict
from fvs_lab.statistics import all_hold

#: Whom the paper compares the proposed one with, in all their starts.
_FILTERS = ("lkf_explored", "lkf_model", "lkf_zero", "ukf_explored", "ukf_model")
_RLS = ("rls_explored", "rls_model")
_RIVALS = (*_FILTERS, *_RLS)
#: Two filters that differ by less than this are one, m/rad.
_SAME_M_RAD = 1e-9


def verdicts(found: Study) -> list[Verdict]:
    """The paper's claims, and what was found of them."""
    return [
        _unmoved_verdict(found),
        _rotated_verdict(found, "t1_m", "T1"),
        _rotated_verdict(found, "t2_max_m", "the largest T2"),
        _rls_verdict(found),
        _ukf_verdict(found),
        _bound_verdict(found),
        _update_verdict(found),
        _cost_verdict(found),
        _proof_verdict(found),
    ]


def _against(found: Study, world: World, one: str, other: str, criterion: str) -> str:
    """``0.12 mm against 0.79 mm (LKF, explored), ratio 0.15 (0.14 to 0.16)``."""
    first, second = (found.text(world, name, criterion) for name in (one, other))
    ratio = found.ratio(world, one, other, criterion)
    return f"{first} against {second} ({CONTESTANTS[other].label}), ratio {ratio.text()}"


def _unmoved_verdict(found: Study) -> Verdict:
    parts, texts = [], []
    for criterion, title in (("t1_m", "T1"), ("t2_max_m", "largest T2")):
        rival = found.best(NOISE, criterion, _RIVALS)
        parts.append(found.ratio(NOISE, "rbf", rival, criterion).below(1.0))
        texts.append(f"{title} {_against(found, NOISE, 'rbf', rival, criterion)}")
    return Verdict(
        "The proposed estimator predicts better than LKF, UKF and RLS while the camera stays where "
        "it was in training: judged by T1 and by the largest T2.",
        f"With {NOISE.label}, against the best of them in each: {'; '.join(texts)}.",
        all_hold(parts),
    )


def _rotated_verdict(found: Study, criterion: str, title: str) -> Verdict:
    """One claim about all angles: the paths, with one T2 each, are too few to decide each angle."""
    parts, texts, fast = [], [], []
    for world in found.turned:
        rival = found.best(world, criterion, _RIVALS)
        ratio = found.ratio(world, "rbf", rival, criterion)
        smaller = ratio.below(1.0)
        parts.append(smaller)
        word = {True: "smaller", False: "larger", None: "not decided"}[smaller]
        texts.append(f"{world.turn_deg:g}° {ratio.text()}, {word} ({CONTESTANTS[rival].label})")
        fast.append(found.ratio(world, "rbf_fast", rival, criterion).text())
    return Verdict(
        "The proposed estimator predicts better than LKF, UKF and RLS also when the camera has "
        f"been rotated, by up to {found.turned[-1].turn_deg:g}°: judged by {title}.",
        f"Ratio to {title} of the best of them at each angle: {'; '.join(texts)}. With "
        f"n1 = {FAST_N1:g}: {', '.join(fast)}.",
        all_hold(parts),
    )


def _rls_verdict(found: Study) -> Verdict:
    parts, texts = [], []
    for world in (NOISE, *found.turned):
        rls, other = (found.best(world, "t1_m", names) for names in (_RLS, _FILTERS))
        worst = max((other, "rbf"), key=lambda name: found.middle(world, name, "t1_m"))
        ratio = found.ratio(world, worst, rls, "t1_m")
        parts.append(ratio.below(1.0))
        texts.append(f"{world.turn_deg:g}° {ratio.text()} ({CONTESTANTS[worst].label})")
    return Verdict(
        "RLS is the worst of the four: it cannot hold T1 down.",
        "T1 of the worst other one over that of RLS, each with its best start, with "
        f"{NOISE.label}, by the camera’s rotation: {'; '.join(texts)}.",
        all_hold(parts),
    )


def _ukf_verdict(found: Study) -> Verdict:
    difference = max(
        one.ukf_difference_m_rad for results in found.judged.values() for one in results
    )
    same = difference < _SAME_M_RAD
    zero, explored, model = (
        found.text(NOISE, f"lkf_{start}", "t1_first_m") for start in ("zero", "explored", "model")
    )
    return Verdict(
        "The UKF is a better estimator than the LKF, above all in the beginning.",
        f"{'They are the same filter' if same else 'They differ'}: dx = J dr is linear in J, and "
        "with the same start and settings the largest difference of any entry in all runs is "
        f"{difference:.1g} m/rad. What does make a difference is the start: an LKF’s T1 in the "
        f"first {FIRST_S:g} s ({NOISE.label}) is {zero} from zero, {explored} after wiggling each "
        f"joint, and {model} from the networks’ Jacobian.",
        False
        if same
        else all_hold(
            found.ratio(NOISE, f"ukf_{start}", f"lkf_{start}", "t1_m").below(1.0)
            for start in ("explored", "model")
        ),
    )


def _bound_verdict(found: Study) -> Verdict:
    rival = found.best(CLEAN, "t1_late_m", (*_RIVALS, "lkf_fast"))
    frozen, updated, fast = (
        found.text(CLEAN, name, "t1_late_m") for name in ("frozen", "rbf", "rbf_fast")
    )
    return Verdict(
        "The networks set a bound on the accuracy, which in the long run an online estimator "
        "gets below.",
        "Without noise, in the second half of the motion, the best online estimator against the "
        f"frozen networks: T1 {_against(found, CLEAN, rival, 'frozen', 't1_late_m')}. The proposed "
        f"update takes the networks from {frozen} to {updated}, and to {fast} with "
        f"n1 = {FAST_N1:g}.",
        found.ratio(CLEAN, rival, "frozen", "t1_late_m").below(1.0),
    )


def _update_verdict(found: Study) -> Verdict:
    parts, texts = [], []
    for world in found.turned:
        t1 = found.ratio(world, "rbf", "frozen", "t1_m")
        error = found.ratio(world, "rbf", "frozen", "jacobian_error")
        parts += [t1.below(1.0), error.below(1.0)]
        texts.append(f"{world.turn_deg:g}° T1 {t1.text()}, Jacobian error {error.text()}")
    return Verdict(
        "When the camera has been rotated, the online update beats the networks as trained.",
        f"Updated (n1 = {RbfConfig.n1:g}) over frozen, ratios: {'; '.join(texts)}.",
        all_hold(parts),
    )


def _cost_verdict(found: Study) -> Verdict:
    fast = found.ratio(NOISE, "rbf_fast", "frozen", "t1_m")
    return Verdict(
        "The online update does no harm where nothing has changed since training.",
        f"With {NOISE.label}, T1 {_against(found, NOISE, 'rbf', 'frozen', 't1_m')}; with n1 = "
        f"{FAST_N1:g} the ratio is {fast.text(1)}. The gain that learns also lets the noise in.",
        found.ratio(NOISE, "rbf", "frozen", "t1_m").below(1.0),
    )


def disagreements(first: Mapping[str, float], second: Mapping[str, float]) -> tuple[int, int]:
    """How often two criteria do not agree which of two contestants is better.

    Parameters
    ----------
    first, second : mapping of str to float
        The criteria, by contestant.

    Returns
    -------
    tuple of int
        Pairs on which they disagree, and all pairs.
    """
    pairs = list(combinations(first, 2))
    wrong = sum((first[a] - first[b]) * (second[a] - second[b]) < 0.0 for a, b in pairs)
    return wrong, len(pairs)


def _proof_verdict(found: Study) -> Verdict:
    worlds = (NOISE, *found.turned)
    # one of the two filters that are the same, and nobody who knows the truth
    names = [one.name for one in found.contestants if one.method not in ("ukf", "oracle")]
    counts = [
        disagreements(
            {name: found.middle(world, name, "t1_m") for name in names},
            {name: found.middle(world, name, "jacobian_error") for name in names},
        )
        for world in worlds
    ]
    wrong, total = (sum(count) for count in zip(*counts, strict=True))
    last = worlds[-1]
    shares = ", ".join(
        f"{CONTESTANTS[name].label} {100 * found.middle(last, name, 't1_share'):.0f} % and "
        f"{100 * found.middle(last, name, 'jacobian_error'):.0f} %"
        for name in ("rbf", "frozen", found.best(last, "t1_m", _RIVALS))
    )
    return Verdict(
        "T1 on a smooth path tells which Jacobian is the better one.",
        f"In {wrong} of {total} pairs of estimators the one with the smaller T1 has the worse "
        f"Jacobian. Error along the motion and of the whole Jacobian ({last.label}): {shares}.",
        wrong == 0,
    )
