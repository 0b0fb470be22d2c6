"""Tables that are too long to be shown whole."""

from __future__ import annotations

from collections.abc import Sequence


def shortened(
    rows: Sequence[Sequence[str]], most: int, of_the_end: int, where: str
) -> Sequence[Sequence[str]]:
    """Return at most so many rows, so many of them from the end.

    A row in between says how many more there are, and where.
    """
    more = len(rows) - most
    if more <= 0:
        return rows
    left_out = ["…", f"{more} more {where}", *[""] * (len(rows[0]) - 2)]
    return [*rows[: most - of_the_end], left_out, *rows[-of_the_end:]]
