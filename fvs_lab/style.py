"""How the laboratory's figures look: one colour a scheme, everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Okabe and Ito's palette, told apart by all readers.
COLOURS = {
    "proposed": "#0072B2",
    "rbf+pid": "#D55E00",
    "ukf+mfac": "#009E73",
    "ukf+mpc": "#CC79A7",
    "rbf+mfac": "#009E73",
    "rbf+mpc": "#CC79A7",
    "extended": "#E69F00",
    "best": "#7A1FA2",
    "oracle": "#000000",
    "frozen": "#999999",
    "rbf": "#0072B2",
    "lkf": "#009E73",
    "ukf": "#56B4E9",
    "rls": "#E69F00",
    "broyden": "#CC79A7",
}


def pyplot():
    """Import pyplot, drawing to files."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    plt.rcParams.update(
        {
            "axes.grid": True,
            "grid.alpha": 0.3,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "font.size": 10,
            "legend.frameon": False,
            "legend.fontsize": 9,
        }
    )
    return plt


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG and forget it."""
    figure.savefig(path, dpi=120)
    pyplot().close(figure)
