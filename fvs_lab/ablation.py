"""Ablation: the effect of each part of the proposed scheme, one change at a time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fvs_controller_node.config import default_values
from fvs_lab import experiment as lab
from fvs_lab import trials
from fvs_lab.results import Results, label_of

#: The scheme without a change, and rows that the claims name.
BASE = "as it comes"
PRINTED, PRINTED_SAME = "as printed, its own gains", "as printed, same gains"
FROZEN, ORACLE, CARRIED = "no online update", "true Jacobian", "camera carried round by 20°"
CAPPED, UNCAPPED = "gain 100 times as high, capped", "gain 100 times as high, cap off"
#: Latency, ms, and the factor on alpha2 and alpha3 without prediction: of 0.5, 0.35, 0.25 and 0.15
#: the fastest to 5 mm on other cases.
SOFTER = {40: 0.35, 120: 0.15}


def _sliding(gain: float) -> str:
    if gain == 0.0:
        return "no sliding term"
    return f"{'printed sign, ' if gain < 0.0 else ''}sliding term {abs(gain):g}"


def variants() -> Iterator[trials.Trial]:
    """All rows: what is changed, and the row that it is compared with."""

    def change(name: str, against: str = BASE, **changes: Any) -> trials.Trial:
        labels = {"change": name, "against": against}
        return trials.Trial(duration_s=3.4).changed(labels, **changes)

    literal, high = {"discretisation": "literal"}, {"rbf.n1": 30.0}
    yield change(BASE)
    # Its own gains: the fastest to 2 mm, on other cases, of 24 combinations of k1 (0.3 to 3), k2
    # (0.01, 0.05) and k4 (0 to 0.008) below its stability limits.
    yield change(PRINTED, controller={**literal, "k1": 2.0, "k2": 0.01, "k4": 0.003})
    yield change(PRINTED_SAME, controller=literal)
    yield change(FROZEN, method="frozen")
    yield change(ORACLE, method="oracle")
    # Beside the default of 0.005.
    for gain in (0.0, 0.1, -0.005, -0.1):
        yield change(_sliding(gain), estimator={"rbf.alpha2": gain})
    yield change(CAPPED, estimator=high)
    yield change(UNCAPPED, CAPPED, estimator={**high, "rbf.mu": 1.9})
    gains = default_values(law="ftsm")
    for latency_ms, factor in SOFTER.items():
        late = {"latency_s": 1e-3 * latency_ms}
        softer = {name: factor * gains[name] for name in ("alpha2", "alpha3")}
        name = BASE if latency_ms == 40 else f"{latency_ms} ms latency"
        if name != BASE:
            yield change(name, conditions=late)
        blind = f"{latency_ms} ms, no prediction"
        yield change(blind, name, conditions=late, predicts=False)
        yield change(f"{blind}, softer gains", name, conditions=late, predicts=False,
                  controller=softer)  # fmt: skip
    carried = {"camera_carried_deg": (0.0, 20.0, 0.0)}
    yield change(CARRIED, conditions=carried)
    yield change(f"20°, {FROZEN}", CARRIED, method="frozen", conditions=carried)


def measure(context: lab.Context) -> Results:
    """Run every change."""
    cases = trials.make_cases("a", context.count(16), 303)
    return context.run(trials.crossed(variants(), cases), "ablation")


def claims(runs: Results) -> Iterator[lab.Claim]:
    """What each part is worth; ratios below 1.05 are not notable."""
    rows = runs.groups("change")

    def ratio(name: str, metric: str = "to_5mm_s", against: str = "", least: float = 1.05):
        other = against or rows[name].rows[0]["against"]
        words = name if other == BASE else f"{name} over {other}"
        label = f"{words}: {label_of(metric).partition(',')[0]}"
        return lab.above(label, rows[name].over(rows[other], metric), least)

    def slower(name: str) -> list[lab.Part]:
        return [ratio(name), ratio(name, "to_2mm_s")]

    blind = [f"{latency_ms} ms, no prediction, softer gains" for latency_ms in SOFTER]
    oracle = rows[BASE].over(rows[ORACLE], "to_5mm_s")
    yield lab.ours("implicit", *slower(PRINTED), ratio(PRINTED, "jitter_rad_s"), any_of=True)
    same = [ratio(PRINTED_SAME, "to_2mm_s"), ratio(PRINTED_SAME, "jitter_rad_s", least=2.0)]
    yield lab.ours("same_gains", *same, any_of=True)
    yield lab.ours("prediction", *(ratio(name) for name in blind))
    yield lab.papers("update", *slower(FROZEN), any_of=True)
    yield lab.papers("carried", *slower(f"20°, {FROZEN}"), any_of=True)
    yield lab.ours("oracle", lab.below("settling time over that with it", oracle, 1.1))
    wrong = ratio(UNCAPPED, "jacobian_error", least=2.0)
    yield lab.ours("cap", ratio(UNCAPPED), wrong, any_of=True)
    yield lab.papers("sliding", ratio(_sliding(0.0)))
    signs = [
        ratio(_sliding(-gain), against=BASE if gain == 0.005 else _sliding(gain))
        for gain in (0.005, 0.1)
    ]
    yield lab.ours("printed_sign", *signs)


TABLES = (
    lab.Table("changes", ("change",), ("to_5mm_s:half", "jitter_rad_s:half", "failure:causes")),
)
EXPERIMENT = lab.Experiment("ablation", measure, claims, TABLES, globals())
