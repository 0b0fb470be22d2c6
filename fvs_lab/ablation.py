"""Ablation: the effect of each part of the proposed scheme, one change at a time."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np

from fvs_controller_node.config import default_values
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab import trials
from fvs_lab.results import label_of

BASE = "as it comes"
LITERAL, LITERAL_SAME = "as printed, its own gains", "as printed, same gains"
CAPPED, UNCAPPED = "gain 100 times as high, capped", "gain 100 times as high, cap off"
FROZEN, ORACLE = "no online update", "true Jacobian"
#: Reaching gains of the law as printed: the fastest to 2 mm, on other cases, of 24 combinations of
#: k1 (0.3 to 3), k2 (0.01, 0.05) and k4 (0 to 0.008) below its stability limits.
_LITERAL = {"discretisation": "literal", "k1": 2.0, "k2": 0.01, "k4": 0.003}
#: Factor on alpha2 and alpha3 by latency, ms: of 0.5, 0.35, 0.25 and 0.15 the fastest to 5 mm
#: without prediction, on other cases.
_SOFTER = {40: 0.35, 80: 0.25, 120: 0.15}
_TURNS_DEG = (20, 45)
#: Ratios below this are not significant.
NOTABLE = 1.05
#: Length of a run, s.
DURATION_S = 3.4

_COLOURS = {"control law": "#0072B2", "Jacobian": "#D55E00", "images": "#009E73",
            "camera": "#CC79A7"}  # fmt: skip


def _sliding(gain: float) -> str:
    if gain == 0.0:
        return "no sliding term"
    return f"{'printed sign, ' if gain < 0.0 else ''}sliding term {abs(gain):g}"


def _latency(latency_ms: int) -> str:
    return BASE if latency_ms == next(iter(_SOFTER)) else f"{latency_ms} ms latency"


def variants() -> list[trials.Variant]:
    """All rows: what is changed, its group, and the row that it is compared with."""

    def one(name: str, group: str, against: str = BASE, **changes: Any) -> trials.Variant:
        labels = {"change": name, "group": group, "against": against}
        return trials.Variant(labels, **changes)

    law, update, images, camera = _COLOURS
    # No sliding term, and gains beside the default; negative for the printed sign.
    terms = (0.0, 0.03, 0.1, -0.005, -0.03, -0.1)
    high = {"rbf.n1": 30.0}
    found = [
        one(BASE, "", ""),
        one(LITERAL, law, controller_values=_LITERAL),
        one(LITERAL_SAME, law, controller_values={"discretisation": "literal"}),
        one(FROZEN, update, method="frozen"),
        one(ORACLE, update, method="oracle"),
        *(one(_sliding(gain), update, estimator_values={"rbf.alpha2": gain}) for gain in terms),
        one(CAPPED, update, estimator_values=high),
        one(UNCAPPED, update, CAPPED, estimator_values={**high, "rbf.mu": 1.9}),
    ]
    gains = default_values(law="ftsm")
    for latency_ms, factor in _SOFTER.items():
        name = _latency(latency_ms)
        late: dict[str, Any] = {"conditions": {"latency_s": 1e-3 * latency_ms}}
        if name != BASE:
            found.append(one(name, images, **late))
        softer = {gain: factor * gains[gain] for gain in ("alpha2", "alpha3")}
        for words, values in (("", {}), (", softer gains", softer)):
            row = f"{latency_ms} ms, no prediction{words}"
            found.append(one(row, images, name, controller_values=values, predicts=False, **late))
    for turn_deg in _TURNS_DEG:
        name = f"camera carried round by {turn_deg}°"
        turned: dict[str, Any] = {"conditions": {"camera_turn_deg": (0.0, float(turn_deg), 0.0)}}
        found.append(one(name, camera, **turned))
        found.append(one(f"{turn_deg}°, {FROZEN}", camera, name, method="frozen", **turned))
    return found


# ---- the experiment -------------------------------------------------------------------------


def measure(context: lab.Context) -> lab.Found:
    """Run every change."""
    cases = trials.make_cases("a", context.count(8), 303)
    changes = [
        variant.trial(case, trials.Conditions(), duration_s=DURATION_S)
        for variant, case in product(variants(), cases)
    ]
    runs = context.run(changes, "ablation")
    return lab.Found(runs, {"count": len(cases)}, {"cases": cases, "variants": variants()})


def claims(found: lab.Found) -> Iterator[lab.Claim]:
    """What each part is worth."""
    rows = found.runs.groups("change")

    def ratio(name: str, metric: str = "to_5mm_s", against: str = "", least: float = NOTABLE):
        other = against or rows[name].rows[0]["against"]
        words = name if other == BASE else f"{name} over {other}"
        label = f"{words}: {label_of(metric).partition(',')[0]}"
        return lab.above(label, rows[name].over(rows[other], metric), least)

    def slower(name: str) -> list[lab.Part]:
        return [ratio(name), ratio(name, "to_2mm_s")]

    blind = [f"{latency_ms} ms, no prediction, softer gains" for latency_ms in _SOFTER]
    oracle = rows[BASE].over(rows[ORACLE], "to_5mm_s")
    yield lab.ours("implicit", *slower(LITERAL), ratio(LITERAL, "jitter_rad_s"), any_of=True)
    same = [ratio(LITERAL_SAME, "to_2mm_s"), ratio(LITERAL_SAME, "jitter_rad_s", least=2.0)]
    yield lab.ours("same_gains", *same, any_of=True)
    yield lab.ours("prediction", *(ratio(name) for name in blind))
    yield lab.papers("update", *slower(FROZEN), any_of=True)
    for turn_deg in _TURNS_DEG:
        name = f"{turn_deg}°, {FROZEN}"
        yield lab.papers("turned", *slower(name), any_of=True, turn_deg=turn_deg)
    yield lab.ours("oracle", lab.below("settling time over that with it", oracle, 1.1))
    wrong = ratio(UNCAPPED, "jacobian_error", least=2.0)
    yield lab.ours("cap", ratio(UNCAPPED), wrong, any_of=True)
    yield lab.papers("sliding", ratio(_sliding(0.0)))
    signs = [
        ratio(_sliding(-gain), against=BASE if gain == 0.005 else _sliding(gain))
        for gain in (0.005, 0.03, 0.1)
    ]
    yield lab.ours("printed_sign", *signs)


TABLES = (
    lab.TableOf(
        "changes",
        ("change",),
        (
            "to_5mm_s",
            "to_2mm_s:half",
            "jitter_rad_s:half",
            "jacobian_error:half",
            "failure:causes",
        ),
    ),
)


def figures(found: lab.Found) -> Iterator[lab.Drawn]:
    """What each change does to settling time and jitter, as ratios."""
    rows = found.runs.groups("change")
    shown = {name: ones for name, ones in rows.items() if name != BASE}
    figure, (axes,) = draw.grid(1, 2, (12, 8.5), sharey=True)
    for axis, metric, ticks in zip(
        axes,
        ("to_5mm_s", "jitter_rad_s"),
        ((0.7, 1.0, 1.5, 2.0, 3.0, 4.0), (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)),
        strict=True,
    ):
        for place, ones in enumerate(shown.values()):
            first, most = ones.rows[0], 1.2 * ticks[-1]
            one = ones.over(rows[first["against"]], metric)
            value, low, high = np.minimum([one.value, one.low, one.high], most)
            look: dict[str, Any] = {"color": _COLOURS[first["group"]]}
            axis.plot([low, high], [place, place], alpha=0.7, **look)
            marker = "o" if one.value < most else ">"
            axis.plot(value, place, marker, label=first["group"], **look)
        axis.axvline(1.0, color="black", linewidth=0.8)
        draw.plain_ticks(axis, ticks)
        label = f"{label_of(metric).partition(',')[0]}, ratio"
        axis.set(xlabel=label, xlim=(0.9 * ticks[0], 1.25 * ticks[-1]))
    names = [
        name if (against := ones.rows[0]["against"]) == BASE else f"{name}  [over {against}]"
        for name, ones in shown.items()
    ]
    axes[0].set_yticks(range(len(names)), names)
    axes[0].invert_yaxis()
    draw.legend(figure)
    yield "ablation", figure, {}


EXPERIMENT = lab.Experiment("ablation", measure, claims, TABLES, figures, globals())
