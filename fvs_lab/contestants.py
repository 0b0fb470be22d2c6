"""The schemes that are compared beyond the paper, and the worlds that they meet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from fvs_lab.search import CLIPPED, ORACLE, ORACLES, PROPOSED, Regime
from fvs_lab.trials import Conditions, Variant
from fvs_tools.schemes import BEYOND, SCHEMES, Scheme

EXTENDED, BEST = "extended", "best"
#: Plays the fastest motion blindly; races, too.
CLAIRVOYANT = "clairvoyant open loop"
FROZEN, BEST_ORACLE = "frozen", "oracle, law of best"

#: White noise on each coordinate of the sensor, m.
SIGMA_M = Conditions.position_noise_m
#: Speed and acceleration limit of every joint, rad/s and rad/s^2.
SPEED_RAD_S, ACCELERATION_RAD_S2 = CLIPPED.values()

#: All of them, with the defaults of the nodes except for what is named here.
CONTESTANTS: dict[str, Scheme] = {
    one.name: one
    for one in (
        *SCHEMES.values(),
        *BEYOND.values(),
        ORACLES[ORACLE],
        replace(SCHEMES[PROPOSED], name=FROZEN, method="frozen"),
        replace(BEYOND[BEST], name=BEST_ORACLE, method="oracle", estimator_values={}),
    )
}
#: Schemes that meet a camera that was moved; other worlds and moving targets.
SHAKEN = (BEST, EXTENDED, BEST_ORACLE, PROPOSED, FROZEN)
FOLLOWERS = (PROPOSED, EXTENDED, BEST)
#: Racing against the floor with the nodes' defaults: the paper's schemes and the oracle have
#: neither addition nor searched gains.
PUBLISHED = (*SCHEMES, ORACLE)
RACERS = (BEST, BEST_ORACLE, EXTENDED, *PUBLISHED)

#: Laws that command a ball velocity and leave the joints to the redundancy resolution; the other
#: two solve their own least-squares problem of joint speeds.
RESOLVING = ("ftsm", "proportional")


def _equipped(scheme: Scheme, how: str = "tuned") -> Scheme:
    """A scheme with all additions that its parts can take, for a search of its gains.

    The camera's rotation is for the networks; a straight path is a matter of the sliding mode law.
    """
    redundancy = {"redundancy_resolution": "least_speed"} if scheme.law in RESOLVING else {}
    return replace(
        scheme,
        name=f"{scheme.name}, {how}",
        method={"rbf": "rbf_left"}.get(scheme.method, scheme.method),
        controller_values={**scheme.controller_values, **redundancy},
    )


#: The paper's laws that have the filter there, with the networks.
_ON_NETWORKS = [Scheme(f"rbf+{law}", "rbf", law, "") for law in ("mfac", "mpc")]
_LAWS = (BEYOND[EXTENDED], SCHEMES["rbf+pid"], *_ON_NETWORKS)
#: Races with all additions and searched gains: for speed alone, and for speed with a jitter limit,
#: rad/s, of about extended's jitter with its defaults. Jitter is measured in the second after two
#: seconds within 5 mm.
TUNED = {
    one.name: one
    for one in map(_equipped, (BEYOND[EXTENDED], *SCHEMES.values(), *_ON_NETWORKS, ORACLES[ORACLE]))
}
CALM = {one.name: one for one in (_equipped(law, "calm") for law in _LAWS)}
CALM_RAD_S = 0.0002
CALM_REGIME = Regime("calm", "", CLIPPED, 5.0, ("jitter_rad_s", CALM_RAD_S), 3.0)
#: Gains of the proportional law between the two, 1/s: its trade of jitter for speed.
TURNED_1_S = (10.0, 14.0, 20.0)
#: The sliding mode law in each search, and the other laws with the same searches.
SLIDING, SLIDING_CALM = next(iter(TUNED)), next(iter(CALM))
OTHERS = tuple(
    one.name
    for one in (*TUNED.values(), *CALM.values())
    if one.law != BEYOND[EXTENDED].law and one.method != "oracle"
)
#: Racing with rendered images, too.
SEEN = (BEST, EXTENDED, PROPOSED, "rbf+pid")


@dataclass(frozen=True)
class Deviation:
    """Conditions with one deviation: its name, its size, and the fields that differ."""

    kind: str
    label: str
    changes: Mapping[str, Any]


USUAL = Deviation("as usual", f"{1e3 * Conditions.latency_s:g} ms, 1 mm", {})
WORLDS = (
    USUAL,
    Deviation("latency", "0 ms", {"latency_s": 0.0}),
    Deviation("latency", "50 ms", {"latency_s": 0.05}),
    Deviation("latency", "100 ms", {"latency_s": 0.1}),
    Deviation("latency", "200 ms", {"latency_s": 0.2}),
    # Further lag of the drives, and their dead time.
    Deviation("drives", "50+8 ms", {"joint_lag_s": 0.05, "dead_time_s": 0.008}),
    Deviation("drives", "50+40 ms", {"joint_lag_s": 0.05, "dead_time_s": 0.04}),
    Deviation("drives", "100+60 ms", {"joint_lag_s": 0.1, "dead_time_s": 0.06}),
    Deviation("encoders", "0.2 mrad", {"encoder_noise_rad": 0.0002}),
    Deviation("encoders", "1 mrad", {"encoder_noise_rad": 0.001}),
    Deviation("images", "8 Hz", {"image_rate_hz": 8.0}),
    Deviation("noise", "0.2 mm", {"position_noise_m": 0.0002}),
    Deviation("noise", "4 mm", {"position_noise_m": 0.004}),
)


def variant(name: str, **controller_values: Any) -> Variant:
    """A contestant with the limits that all have, and further parameters of its controller."""
    return Variant.of(CONTESTANTS[name], **CLIPPED, **controller_values)
