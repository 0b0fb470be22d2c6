"""The control laws by name. A new law is one file in this folder and one line here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fvs_controller_node.base import ControlLaw
from fvs_controller_node.ftsm import FtsmLaw
from fvs_controller_node.mfac import MfacLaw
from fvs_controller_node.minimum_time import MinimumTimeLaw
from fvs_controller_node.mpc import MpcLaw
from fvs_controller_node.proportional import ProportionalLaw

LAWS: dict[str, type[ControlLaw]] = {
    "ftsm": FtsmLaw,
    "proportional": ProportionalLaw,
    "mfac": MfacLaw,
    "mpc": MpcLaw,
    "minimum_time": MinimumTimeLaw,
}


def make_law(name: str, values: Mapping[str, Any]) -> ControlLaw:
    """Build the law called ``name``, with the gains in ``values`` (by parameter name).

    Raises
    ------
    ValueError
        If the name is unknown (the text lists those known) or a gain is out of range.
    """
    if name not in LAWS:
        raise ValueError(f"unknown law {name!r}; known are {', '.join(sorted(LAWS))}")
    return LAWS[name].from_values(values)
