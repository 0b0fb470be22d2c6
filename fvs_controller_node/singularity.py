"""Holds the arm near a singularity of the Jacobian, and lets it leave on request."""

from __future__ import annotations

#: A held Jacobian is released when its smallest singular value is this far into the slow band.
_RELEASE_SHARE = 0.3

#: A held arm may leave slowly while the value stays above this share of what it was at the request;
#: and not at all where it was below that share of the hold limit.
_LEAVE_SHARE, _HOPELESS_SHARE = 0.7, 0.2


class SingularityWatch:
    """Hold with hysteresis on the smallest singular value, m/rad."""

    def __init__(self) -> None:
        self._held = False
        self._floor: float | None = None  # the value must stay above it while the arm leaves
        self._leaving = False

    @property
    def leaving(self) -> bool:
        """Whether the arm is on its way out, on request."""
        return self._leaving

    def stay(self) -> None:
        """End the permission to leave; the floor stays until the arm is out."""
        self._leaving = False

    def leave(self, value: float, hold: float) -> bool:
        """Let a held arm leave, unless the value says nothing at all; returns whether it may."""
        if self._floor is None:
            self._floor = max(_LEAVE_SHARE * value, _HOPELESS_SHARE * hold)
        self._leaving = value >= self._floor
        return self._leaving

    def held_below(self, value: float, hold: float, slow: float) -> float | None:
        """Judge the value of now.

        Parameters
        ----------
        value : float
            Smallest singular value of the Jacobian, m/rad.
        hold, slow : float
            Below ``hold`` the arm is held, below ``slow`` it slows down, m/rad.

        Returns
        -------
        float or None
            The limit below which the value is, m/rad; None if the arm may move.
        """
        limit = hold + (_RELEASE_SHARE * (slow - hold) if self._held else 0.0)
        self._held = value < limit
        if not self._held:
            self._leaving, self._floor = False, None
        elif value < (self._floor or 0.0):
            self._leaving = False
        return limit if self._held and not self._leaving else None
