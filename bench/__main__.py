"""Run the measurements of this folder in turn: ``python -m bench [NAME ...]``.

A folder, with a slash, is for the one that is named: ``python -m bench NAME ./FOLDER``.
"""

from __future__ import annotations

import importlib
import sys
import time
from pathlib import Path

from fvs_ros.arguments import Parser, unknown


def names() -> list[str]:
    """Names of the measurements: ``bench_loop.py`` is ``loop``."""
    return sorted(path.stem[len("bench_") :] for path in Path(__file__).parent.glob("bench_*.py"))


def main(argv: list[str]) -> int:
    """Run the named measurements, or all; the exit code tells whether all of them finished."""
    parser, known = Parser("python -m bench", __doc__), names()
    parser.add_argument("words", nargs="*", metavar="NAME", help=f"of {', '.join(known)}")
    words = parser.parse_args(argv).words
    folders = [word for word in words if "/" in word]
    wanted = [word for word in words if word not in folders]
    if folders and len(wanted) != 1:
        parser.error(f"name one measurement for {folders[0]}")
    for name in wanted:
        if name not in known:
            parser.error(unknown("measurement", name, known))
    failed = []
    sys.argv[1:] = folders
    for name in wanted or known:
        print(f"== {name}", flush=True)
        start_s = time.perf_counter()
        try:
            importlib.import_module(f"bench.bench_{name}").main()
        except Exception as error:  # one measurement that fails must not hide the others
            print(f"{name} failed: {type(error).__name__}: {error}", file=sys.stderr)
            failed.append(name)
        print(f"   {time.perf_counter() - start_s:.1f} s\n", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
