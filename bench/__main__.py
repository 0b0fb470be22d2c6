"""Run the measurements of this folder in turn: ``python -m bench [NAME ...]``.

What begins with a dash or holds a slash is handed on to the one that is named: ``python -m bench
NAME --option``.
"""

from __future__ import annotations

import importlib
import sys
import time
from pathlib import Path

from fvs_ros.arguments import unknown


def names() -> list[str]:
    """Names of the measurements: ``bench_loop.py`` is ``loop``."""
    return sorted(path.stem[len("bench_") :] for path in Path(__file__).parent.glob("bench_*.py"))


def main(arguments: list[str]) -> int:
    """Run the named measurements, or all; the exit code tells whether all of them finished."""
    own = next(
        (i for i, word in enumerate(arguments) if word[0] == "-" or "/" in word), len(arguments)
    )
    wanted, options = arguments[:own], arguments[own:]
    known = names()
    if options and len(wanted) != 1:
        print(f"name one measurement before {options[0]}: {', '.join(known)}", file=sys.stderr)
        return 2
    for name in wanted:
        if name not in known:
            print(unknown("measurement", name, known), file=sys.stderr)
            return 2
    failed = []
    sys.argv[1:] = options
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
