"""What to say where a package of an extra is missing."""

from __future__ import annotations

from collections.abc import Iterable


def how_to_install(extras: str, packages: Iterable[str]) -> str:
    """The commands that bring missing packages, by where one stands.

    Parameters
    ----------
    extras : str
        The extras of this package that hold them, separated by commas.
    packages : iterable of str
        Those that are missing.
    """
    return (
        f"in a checkout with .venv, .venv/bin/pip install -c constraints.txt -e '.[{extras}]'; "
        f"elsewhere, pip install {' '.join(packages)}"
    )
