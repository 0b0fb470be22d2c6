"""What is claimed beyond the paper."""

from __future__ import annotations

from collections.abc import Iterator

from fvs_lab import beyond_contestants as who
from fvs_lab.beyond_camera import MOMENTS
from fvs_lab.experiment import OURS, PAPER, Claim, Found, Part, below, share_above
from fvs_lab.results import Results
from fvs_lab.spot_check import claims as spot_check_claims
from fvs_lab.statistics import DECISIVE, wilson
from fvs_tools.schemes import SCHEMES

#: What a minute of data must be good for: claim, column, its largest value, factor and unit.
_MINUTE = (
    ("chain", "chain_box", 0.005, 100, " %"),
    ("chain", "chain_workspace", 0.015, 100, " %"),
    ("late", "late_error_s", 0.003, 1e3, " ms"),
    ("fit", "fit_s", 5.0, 1, " s"),
    ("distilled", "distilled_box", 0.02, 100, " %"),
)
#: What the fit says of its error may be larger or smaller by this factor.
HONEST = 2.0
#: Settling time over the physical floor.
OVER_FLOOR = 1.15
#: Share of the cases in which a camera that was moved must not cost the pace.
KEPT_SHARE = 0.95
#: True error at rest over the sensor's noise, and settling time over that without latency.
REST_SIGMA, SLOWED = 0.4, 1.1
#: Noise of a real robot's encoders and the jitter that it may make, rad and rad/s; and the
#: settling time over that without it.
ENCODER_RAD, CALM_ENOUGH_RAD_S, AS_SOON = 0.0002, 0.002, 1.05
#: Share of the cases that must settle in each of the other worlds, and of honest fits.
MOST = 0.9
#: Speed at which tracking is judged, m/s, and what feed-forward must leave of the error.
TRACKING_M_S, LEFT = 0.1, 1.0 / 3.0


def claims(found: Found) -> Iterator[Claim]:
    """All claims, in the order of the page."""
    parts = found.runs.groups("part")
    races, worlds = parts["race"].groups("scheme"), parts["world"]
    yield from _minute(parts["minute"])
    honesty = parts["assessment"].values("honesty")
    honest = sum(1.0 / HONEST <= ratio <= HONEST for ratio in honesty)
    label = f"recordings within a factor of {HONEST:g}"
    yield Claim("honest", OURS, [share_above(label, wilson(honest, len(honesty)), MOST)])
    over = races[who.BEST].median("over_5mm")
    yield Claim("best", OURS, [below("settling to 5 mm over the floor", over, OVER_FLOOR)])
    faster = [_faster(races, who.EXTENDED, name) for name in SCHEMES]
    yield Claim("extended", OURS, faster)
    for sliding, terms in (
        (who.SLIDING, "for speed alone"),
        (who.SLIDING_CALM, f"for at most {1e3 * who.CALM_RAD_S:g} mrad/s of jitter"),
    ):
        yield Claim("law", PAPER, _law(races, sliding), given={"terms": terms})
    tuned = [f"{name}, tuned" for name in SCHEMES]
    means = [_faster(races, one, one.removesuffix(", tuned")) for one in tuned if one in races]
    yield Claim("means", OURS, means)
    yield from _camera(parts["camera"])
    rest = [
        below(
            f"{name}: rms over σ",
            parts["rendered"].where(scheme=name).median("rms_sigma"),
            REST_SIGMA,
        )
        for name in (who.EXTENDED, who.BEST)
    ]
    yield Claim("rest", OURS, rest)
    for name in (who.EXTENDED, who.BEST):
        yield Claim("latency", OURS, _latency(worlds.where(scheme=name)), given={"scheme": name})
    shares = [
        share_above(f"{scheme}, {kind} {label}: runs that settle", runs.share(), MOST)
        for (kind, label, scheme), runs in worlds.groups("kind", "label", "scheme").items()
    ]
    yield Claim("worlds", OURS, shares)
    yield Claim("encoders", OURS, _encoders(worlds.where(scheme=who.BEST)))
    yield Claim("tracking", OURS, _tracking(parts["tracking"]))
    yield from spot_check_claims(found.extra["checks"])


def _minute(runs: Results) -> Iterator[Claim]:
    """The largest value of all recordings must be small enough."""
    parts: dict[str, list[Part]] = {}
    for name, column, bound, factor, unit in _MINUTE:
        largest = max(runs.values(column))
        enough = True if len(runs) >= DECISIVE else None
        text = (
            f"at most {factor * largest:.2g}{unit} in {len(runs)} recordings, "
            f"asked: {factor * bound:g}{unit}"
        )
        label = column.removesuffix("_s").replace("_", " ")
        holds = enough if largest <= bound else False
        parts.setdefault(name, []).append(Part(label, text, holds, largest / bound))
    for name, some in parts.items():
        yield Claim(name, OURS, some)


def _faster(races: dict[str, Results], one: str, other: str) -> Part:
    ratio = races[one].over(races[other], "over_5mm")
    return below(f"settling time of {one} over that of {other}", ratio, 1.0)


def _law(races: dict[str, Results], sliding: str) -> list[Part]:
    """The sliding mode law among equals; none in a quick run that has too few of them."""
    how = sliding.rpartition(", ")[2]
    others = [name for name in who.OTHERS if name in races and name.endswith(how)]
    if sliding not in races or not others:
        return []
    best = min(others, key=lambda name: races[name].median("over_5mm").value)
    return [_faster(races, sliding, best)]


def _camera(runs: Results) -> Iterator[Claim]:
    for moment in MOMENTS[1:]:
        for name in (who.BEST, who.EXTENDED):
            share = runs.where(moment=moment, scheme=name).share("kept")
            part = share_above("cases that keep the pace", share, KEPT_SHARE)
            yield Claim("camera", OURS, [part], given={"scheme": name, "moment": moment})


def _latency(runs: Results) -> list[Part]:
    """None where a quick run has been to no such world."""
    ones = runs.where(kind="latency").groups("label")
    without = ones.pop("0 ms", None)
    if without is None:
        return []
    return [
        below(f"settling time at {label} over that without", one.over(without, "to_5mm_s"), SLOWED)
        for label, one in ones.items()
    ]


def _encoders(runs: Results) -> list[Part]:
    """None where a quick run has been to no such world."""
    shaken = runs.where(kind="encoders", label=f"{1e3 * ENCODER_RAD:g} mrad")
    if not len(shaken):
        return []
    usual = runs.where(kind=who.USUAL.kind)
    return [
        below("jitter", shaken.median("jitter_rad_s"), CALM_ENOUGH_RAD_S, 1e3, unit=" mrad/s"),
        below("settling time over that without", shaken.over(usual, "to_5mm_s"), AS_SOON),
    ]


def _tracking(runs: Results) -> list[Part]:
    found = []
    for name in who.FOLLOWERS:
        ones = [
            runs.where(scheme=name, speed_m_s=TRACKING_M_S, feed_forward=feed_forward)
            for feed_forward in (True, False)
        ]
        found.append(below(f"{name}: error over that alone", ones[0].over(ones[1], "rms_m"), LEFT))
    return found
