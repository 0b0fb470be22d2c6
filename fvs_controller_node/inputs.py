"""Watches one input: has it come, is it fresh, was it usable, has it recovered."""

from __future__ import annotations

from dataclasses import dataclass

from fvs_controller_node.reasons import Finding, Reason

#: Time for which a source's own words count, s.
_SAID_S = 2.0


@dataclass(frozen=True)
class InputSpec:
    """What is expected of an input.

    Parameters
    ----------
    name : str
        Topic name, as the user knows it.
    hint : str
        What to look at when it does not come.
    max_age_s : float, optional
        Older than this it is stale; None for an input that may come rarely or never.
    limit : str
        The parameter that says so.
    """

    name: str
    hint: str
    max_age_s: float | None
    limit: str = ""


class InputMonitor:
    """Arrival of one input on the steady clock.

    Any trouble (never came, stale, not usable) lasts until ``fresh_samples`` good messages in
    a row have come.

    Parameters
    ----------
    spec : InputSpec
        What is expected.
    fresh_samples : int
        Good messages in a row that end a trouble.
    """

    def __init__(self, spec: InputSpec, fresh_samples: int) -> None:
        self.spec = spec
        self._fresh_samples = fresh_samples
        self._last_s: float | None = None
        self._streak = 0
        self._trouble = None if spec.max_age_s is None else Reason.MISSING
        self._why = ""
        self._stuck_s = -float("inf")
        self._said, self._said_s = "", -float("inf")

    def configure(self, spec: InputSpec, fresh_samples: int) -> None:
        """Change what is expected and keep what was seen."""
        self.spec = spec
        self._fresh_samples = fresh_samples

    def good(self, now_s: float) -> None:
        """Tell that a usable message arrived."""
        self.find(now_s)  # a gap since the last one counts, even if no tick saw it
        self._last_s = now_s
        if self._trouble is not None:
            self._streak += 1
            if self._streak >= self._fresh_samples:
                self._trouble = None

    def stuck(self, now_s: float) -> None:
        """Tell that a message arrived whose stamp does not advance; it does not count."""
        self._stuck_s = now_s

    def source_says(self, now_s: float, why: str) -> None:
        """Tell why its source sends nothing, in the source's words; empty if it has no reason."""
        self._said, self._said_s = why, now_s

    def bad(self, now_s: float, why: str) -> None:
        """Tell that a message arrived that cannot be used."""
        self._streak = 0
        self._trouble = Reason.BAD_INPUT
        self._why = why

    def forget(self) -> None:
        """Hold nothing against an input that need not come, once it has ceased to."""
        if self.spec.max_age_s is None:
            self._trouble = None

    def age_s(self, now_s: float) -> float:
        """Time since the last usable message, s; infinite if there was none."""
        return float("inf") if self._last_s is None else max(0.0, now_s - self._last_s)

    def find(self, now_s: float) -> Finding | None:
        """Find what is wrong with this input now, if anything."""
        age_s, limit_s = self.age_s(now_s), self.spec.max_age_s
        stale = limit_s is not None and self._last_s is not None and age_s > limit_s
        if stale:
            self._streak = 0
            if self._trouble is None:
                self._trouble = Reason.STALE
        if self._trouble is None:
            return None
        name, hint, wanted = self.spec.name, self.spec.hint, self._fresh_samples
        if self._said and now_s - self._said_s <= _SAID_S:
            hint = self._said
        elif limit_s is not None and now_s - self._stuck_s <= limit_s:
            hint = "messages come, but their stamps do not advance: its source has frozen"
        if self._trouble is Reason.BAD_INPUT:
            return Reason.BAD_INPUT.because(
                name=name, why=self._why, count=self._streak, wanted=wanted
            )
        if self._trouble is Reason.MISSING and not stale:
            return Reason.MISSING.because(name=name, count=self._streak, wanted=wanted, hint=hint)
        if stale:
            assert limit_s is not None
            return Reason.STALE.because(
                name=name, age_s=age_s, limit=self.spec.limit, limit_s=limit_s, hint=hint
            )
        return Reason.RETURNING.because(name=name, count=self._streak, wanted=wanted)
