"""``fvs_experiments replay BAG``: figures and numbers of a recording, without ROS."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path

from fvs_ros.arguments import Parser, how_to_install
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK

COMMAND = "fvs_experiments replay"
_NEEDS = ("rosbags", "jinja2", "matplotlib")


def _parser() -> argparse.ArgumentParser:
    parser = Parser(COMMAND, __doc__)
    parser.add_argument(
        "bag", type=Path, help="folder of a rosbag2 (MCAP or SQLite), or its one file"
    )
    parser.add_argument(
        "--out",
        "--output",
        type=Path,
        help="folder of the page (default: out/replay/ and the bag's name)",
    )
    parser.add_argument(
        "--namespace", help="of the nodes; needed where the bag holds several robots only"
    )
    return parser


def main(argv: list[str]) -> int:
    """Read a bag and write its page; the exit code says how it went."""
    arguments = _parser().parse_args(argv)
    missing = [name for name in _NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        return _refuse(f"it needs {', '.join(missing)}: {how_to_install('record,lab', missing)}")
    from fvs_lab.replay.page import write
    from fvs_lab.replay.reading import BagError, read

    bag: Path = arguments.bag
    name, stem = bag.resolve().name, bag.resolve().stem
    out: Path = arguments.out or Path("out/replay") / (name if bag.is_dir() else stem)
    try:
        recording = read(bag, arguments.namespace)
    except BagError as error:
        return _refuse(str(error))
    try:
        reports, page = write(recording, name, f"{COMMAND} {bag}", out)
    except OSError as error:
        return _refuse(f"cannot write to {out}: {error.strerror}; name another folder by --out")
    for report in reports[:2]:  # what happened, and the targets
        print("\n".join(report.setup))
        for table in report.tables:
            print(f"\n{_text([table.header, *table.rows])}\n")
    print(f"page: {page}")
    return EXIT_OK


def _refuse(why: str) -> int:
    print(f"{COMMAND}: {why}", file=sys.stderr)
    return EXIT_BAD_INPUT


def _text(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells in columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )
