"""``fvs_experiments replay BAG``: the laboratory's figures and numbers of a recording."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from fvs_lab.replay.tables import shortened
from fvs_ros.arguments import Parser
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK
from fvs_ros.version import version
from fvs_tools.installing import how_to_install

if TYPE_CHECKING:
    from fvs_lab.replay.data import Recording
    from fvs_lab.report import Report, Table

COMMAND = "fvs_experiments replay"
_NEEDS = ("rosbags", "jinja2", "matplotlib")
#: No more rows of a table than this go to the terminal: most from its beginning, and its end.
_PRINTED, _OF_THE_END = 25, 8
_LEAD = (
    "A recorded run of visual servoing, in simulation or on a robot: what the controller did, how "
    "the ball came to its targets, and whether everything came in time."
)


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
        print(
            f"{COMMAND} needs {', '.join(missing)}: {how_to_install('record,lab', missing)}",
            file=sys.stderr,
        )
        return EXIT_BAD_INPUT
    from fvs_lab.replay.files import BagError
    from fvs_lab.replay.reading import read
    from fvs_lab.replay.sections import NAMES, sections
    from fvs_lab.report import Heading, Origin, write_page, write_report

    bag: Path = arguments.bag
    whole = bag.resolve()
    out = arguments.out or Path("out/replay") / (whole.name if whole.is_dir() else whole.stem)
    try:
        recording = read(bag, arguments.namespace)
    except BagError as error:
        return _refuse(str(error))
    except OSError as error:
        return _refuse(f"cannot read {bag}: {error.strerror}")
    try:
        out.mkdir(parents=True, exist_ok=True)
        reports = sections(recording, out)
        origin = Origin(f"{COMMAND} {bag}", version(), _model(recording), quick=False)
        for report in reports:
            write_report(report, out / report.name, origin)
        page = write_page(out, NAMES, Heading(f"Recording {bag.resolve().name}", _LEAD))
    except OSError as error:
        no_folder = isinstance(error, FileExistsError | NotADirectoryError)
        why = "it is no folder" if no_folder else error.strerror
        return _refuse(f"cannot write the page to {out}: {why}; name another folder by --out")
    _tell(reports)
    print(f"page: {page}")
    return EXIT_OK


def _refuse(why: str) -> int:
    print(f"{COMMAND}: {why}", file=sys.stderr)
    return EXIT_BAD_INPUT


def _tell(reports: list[Report]) -> None:
    """Print what an engineer wants to know first: states with their reasons, and the targets."""
    for report in reports[:2]:
        for paragraph in report.setup:
            print(paragraph)
        for table in report.tables[:2]:
            print(f"\n{_text(table)}\n")


def _text(table: Table) -> str:
    """A table as text; its last column is not filled up."""
    rows = [table.header, *shortened(table.rows, _PRINTED, _OF_THE_END, "on the page")]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    return "\n".join(lines)


def _model(recording: Recording) -> str:
    path = recording.scenario.get("fvs_estimator_node", {}).get("model_path", "")
    return Path(path).name if path else ""
