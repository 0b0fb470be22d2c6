"""Everything that was measured beyond the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle

from fvs_lab.beyond_camera import IN_MOTION, UNDISTURBED, Arrival
from fvs_lab.beyond_minute import Learned, Told
from fvs_lab.beyond_terms import MINUTES, times_s
from fvs_lab.beyond_tracking import Pursuit, Tracked
from fvs_lab.floor import Floor
from fvs_lab.spot_check import SpotCheck
from fvs_lab.statistics import Interval, median, ratio_of_medians
from fvs_lab.trials import Outcome

#: A run after a blow to the camera keeps its pace if it takes no longer than this share.
KEPT = 1.2


@dataclass(frozen=True)
class Results:
    """What came of all parts.

    Parameters
    ----------
    minutes : sequence of Learned
        Of a minute of data each.
    told : sequence of Told
        The same from plants that err.
    floors : sequence of Floor
        How soon each case can be over.
    races : dict of str to list of Outcome
        The same cases, by contestant; one after another as often as its gains were searched.
    rendered : dict of str to list of Outcome
        The first of the cases with rendered images, by contestant; also with a minute's model.
    arrivals : dict of (str, str) to list of Arrival
        Journeys with a camera that is moved, by moment and contestant.
    worlds : dict of (int, str) to list of Outcome
        Other worlds, by their number and contestant.
    pursuits : list of (Pursuit, Tracked)
        Moving targets.
    checks : sequence of SpotCheck
        Through the real nodes.
    """

    minutes: Sequence[Learned]
    told: Sequence[Told]
    floors: Sequence[Floor]
    races: dict[str, list[Outcome]]
    rendered: dict[str, list[Outcome]]
    arrivals: dict[tuple[str, str], list[Arrival]]
    worlds: dict[tuple[int, str], list[Outcome]]
    pursuits: list[tuple[Pursuit, Tracked]]
    checks: Sequence[SpotCheck] = ()

    @property
    def shaken(self) -> list[str]:
        """Who met a camera that was moved."""
        return list(dict.fromkeys(name for _, name in self.arrivals))

    @property
    def world_numbers(self) -> list[int]:
        """The worlds that were visited."""
        return list(dict.fromkeys(number for number, _ in self.worlds))

    def over_floor(self, name: str, bound: str = "5 mm") -> list[float]:
        """Settling time over the least time, case by case."""
        return self.in_floors(times_s(self.races[name], bound), bound)

    def in_floors(self, times_s: Sequence[float], bound: str = "5 mm") -> list[float]:
        """Settling times of the cases, once or more, over the least time of each."""
        return [
            time_s / floor.least_s[bound]
            for time_s, floor in zip(times_s, cycle(self.floors), strict=False)
        ]

    def middle(self, name: str, bound: str = "5 mm") -> Interval:
        """Median of the settling times over the floor."""
        over = self.over_floor(name, bound)
        return median(over, len(over) // len(self.floors))

    def searched(self, name: str) -> list[float]:
        """The same to 5 mm, search by search."""
        over, count = self.over_floor(name), len(self.floors)
        return [median(over[at : at + count]).value for at in range(0, len(over), count)]

    def ratio(self, name: str, other: str) -> Interval:
        """Ratio of two contestants' medians; whose gains were not searched runs the same again."""
        ones, others = self.over_floor(name), self.over_floor(other)
        longer = max(len(ones), len(others))
        return ratio_of_medians(
            ones * (longer // len(ones)),
            others * (longer // len(others)),
            repeats=longer // len(self.floors),
        )

    def shift_ms(self, name: str) -> tuple[float, float]:
        """How much later than in the race a contestant settles to 5 mm: median and furthest, ms.

        With rendered images in place of the exact camera, and another model perhaps.
        """
        racer = name.removesuffix(MINUTES)
        pairs = zip(times_s(self.rendered[name]), times_s(self.races[racer]), strict=False)
        # Two that never settle are alike.
        late = [0.0 if one == other else 1e3 * (one - other) for one, other in pairs]
        return median(late).value, max(late, key=abs)

    def played_s(self, bound: str = "5 mm") -> list[float]:
        """Settling times of the clairvoyant open loop, s."""
        return [floor.clairvoyant_s[bound] for floor in self.floors]

    def slowdown(self, moment: str, name: str) -> list[float]:
        """Settling time with a blow to the camera over that without, case by case.

        From the last target on: at rest that is the second one, in mid-motion the second one given
        anew, which is compared with what was left of the undisturbed run. Not a number where
        nothing was left, or the undisturbed run never settled.
        """

        def left_s(one: Arrival) -> float:
            return one.after_s if moment == IN_MOTION else one.settled_s

        struck, calm = self.arrivals[moment, name], self.arrivals[UNDISTURBED, name]
        return [
            left_s(one) / left_s(other) if 0.0 < left_s(other) < float("inf") else float("nan")
            for one, other in zip(struck, calm, strict=True)
        ]

    def kept(self, moment: str, name: str) -> tuple[int, int]:
        """In how many cases of how many the pace was kept; where it cannot be told, it was not."""
        ratios = self.slowdown(moment, name)
        return sum(ratio <= KEPT for ratio in ratios), len(ratios)

    def tracking_m(self, kind: str, speed_m_s: float, name: str, feed_forward: bool) -> list[float]:
        """Errors on all paths of a kind, rms, m."""
        return [
            tracked.rms_m
            for pursuit, tracked in self.pursuits
            if (pursuit.path.kind, pursuit.speed_m_s, pursuit.name, pursuit.feed_forward)
            == (kind, speed_m_s, name, feed_forward)
        ]

    def speeds_m_s(self) -> list[float]:
        """Speeds of the moving targets, m/s."""
        return sorted({pursuit.speed_m_s for pursuit, _ in self.pursuits})
