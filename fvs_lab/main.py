"""``fvs_experiments``: the paper's experiments, measured side by side, as numbers and a page."""

from __future__ import annotations

import argparse
import hashlib
import importlib
import importlib.util
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fvs_lab.report import EXPERIMENTS, LONG, write_page, write_report
from fvs_ros import console
from fvs_ros.arguments import Parser, how_to_install
from fvs_ros.paths import find_file, output_file, version
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_FAILURE, EXIT_OK
from fvs_tools.workers import HELP, Workers

#: Packages that the experiments need.
NEEDS = ("cmaes", "joblib", "jinja2", "matplotlib", "scipy")


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        "fvs_experiments",
        __doc__,
        {
            "experiments": EXPERIMENTS,
            "instead of an experiment": {
                "replay BAG": "table and figure of a recording; replay --help lists its arguments"
            },
        },
    )
    parser.add_argument(
        "name",
        metavar="EXPERIMENT",
        choices=(*EXPERIMENTS, "all", "replay"),
        help=f"one of those below; all leaves out {', '.join(LONG)}, which take long",
    )
    parser.add_argument(
        "--seeds",
        type=_positive,
        help="number of seeded cases or worlds (default: that of each experiment)",
    )
    parser.add_argument(
        "--jobs", type=_positive, default=os.cpu_count() or 1, help="processes (default: all cores)"
    )
    parser.add_argument("--backend", default=Workers.backend, help=HELP)
    parser.add_argument(
        "--out", type=Path, default=Path("out/experiments"), help="folder (default: %(default)s)"
    )
    parser.add_argument("--quick", action="store_true", help="run a small part, as a smoke test")
    parser.add_argument(
        "--scheme",
        action="append",
        default=[],
        help=f"{', '.join(LONG)}: only this scheme (repeatable; default: all)",
    )
    return parser


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, got {text!r}")
    return int(text)


def _lacks(program: str, needs: Sequence[str], extras: str) -> bool:
    """Whether packages are missing, which is then said."""
    missing = [name for name in needs if importlib.util.find_spec(name) is None]
    if missing:
        needed = f"{program} needs {', '.join(missing)}"
        print(f"{needed}: {how_to_install(extras, missing)}", file=sys.stderr)
    return bool(missing)


@console.reader_may_leave()
def main(argv: list[str] | None = None) -> int:
    """Run ``fvs_experiments``; returns the exit code."""
    argv = sys.argv[1:] if argv is None else argv
    if argv[:1] == ["replay"]:
        if _lacks("fvs_experiments replay", ("rosbags", "matplotlib"), "record,lab"):
            return EXIT_BAD_INPUT
        from fvs_lab.replay import main as replay

        return replay(argv[1:])
    parser = _parser()
    arguments = parser.parse_args(argv)
    if arguments.name not in LONG and arguments.scheme:
        parser.error(f"--scheme is for {' and '.join(LONG)}")
    if arguments.name == "replay":
        parser.error("replay comes first: fvs_experiments replay BAG")
    if _lacks("fvs_experiments", NEEDS, "sim,lab"):
        return EXIT_BAD_INPUT
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        print("fvs_experiments: interrupted; what was complete is kept")
        return EXIT_FAILURE


def _run(arguments: argparse.Namespace) -> int:
    from fvs_lab.experiment import Context
    from fvs_lab.robustness import EXPERIMENTS as LONG_ONES
    from fvs_lab.robustness import schemes_called

    try:
        output_file(arguments.out / "index.md")
        schemes_called(arguments.scheme)
        workers = Workers(arguments.backend, arguments.jobs).checked()
    except ValueError as error:
        print(f"fvs_experiments: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    context = Context(
        out=arguments.out,
        seeds=arguments.seeds,
        workers=workers,
        quick=arguments.quick,
        schemes=tuple(arguments.scheme),
    )
    most = [name for name in EXPERIMENTS if name not in LONG]
    names = most if arguments.name == "all" else [arguments.name]
    began_s = time.monotonic()
    for number, name in enumerate(names, start=1):
        print(f"== {name} ({number} of {len(names)})", flush=True)
        experiment = LONG_ONES.get(name) or importlib.import_module(f"fvs_lab.{name}").EXPERIMENT
        report = experiment.run(context)
        origin = _origin(arguments, experiment.model)
        write_report({"origin": origin, **report}, context.folder(name))
        for verdict in report["verdicts"]:
            print(f"   {verdict['word']} ({verdict['whose']}): {verdict['claim']}", flush=True)
            print(f"      {verdict['finding']}", flush=True)
        page = write_page(context.out)
    print(f"page: {page} ({(time.monotonic() - began_s) / 60.0:.1f} min)", flush=True)
    return EXIT_OK


def _origin(arguments: argparse.Namespace, model: str) -> dict[str, Any]:
    """Where results come from: command, version, model with its SHA-256's first digits."""
    command = ["fvs_experiments", arguments.name]
    command += [f"--seeds {arguments.seeds}"] if arguments.seeds else []
    command += [f"--scheme {json.dumps(name)}" for name in arguments.scheme]
    command += ["--quick"] if arguments.quick else []
    if model:
        digest = hashlib.sha256(find_file(model).read_bytes()).hexdigest()
        model = f"{Path(model).name} {digest[:12]}"
    quick = arguments.quick
    return {"command": " ".join(command), "version": version(), "model": model, "quick": quick}


if __name__ == "__main__":
    sys.exit(main())
