"""The schemes that the paper compares: pairs of an estimator method and a control law."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Scheme:
    """One pair.

    Parameters
    ----------
    name : str
        The paper's name, in lower case.
    method : str
        The estimator's parameter ``method``.
    law : str
        The controller's parameter ``law``.
    description : str
        One sentence for a user.
    """

    name: str
    method: str
    law: str
    description: str


SCHEMES: dict[str, Scheme] = {
    one.name: one
    for one in (
        Scheme(
            "proposed",
            "rbf",
            "ftsm",
            "Networks that learn by (17), sliding mode law (16) with the adaptive exponent (29).",
        ),
        Scheme(
            "rbf+pid",
            "rbf",
            "proportional",
            "Networks that learn by (45), proportional law (46).",
        ),
        Scheme(
            "ukf+mfac",
            "ukf",
            "mfac",
            "Unscented Kalman filter, model free adaptive law (48).",
        ),
        Scheme(
            "ukf+mpc",
            "ukf",
            "mpc",
            "Unscented Kalman filter, model predictive law (49).",
        ),
    )
}


def scheme(name: str) -> Scheme:
    """The scheme of a name.

    Raises
    ------
    ValueError
        If there is none; the text lists those known.
    """
    if name not in SCHEMES:
        raise ValueError(f"unknown scheme '{name}'; known are {', '.join(SCHEMES)}")
    return SCHEMES[name]
