"""``fvs_train``: fit a model of the Jacobian to a data set of the collector, or to a table."""

from __future__ import annotations

import argparse
import hashlib
import platform
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from fvs_estimator_node.files import DataSet, TrainedModel, load_data_set, save_model
from fvs_estimator_node.training import METHODS, TrainingOptions, lens_text, train
from fvs_ros import console
from fvs_ros.arguments import Parser
from fvs_ros.paths import output_file
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_FAILURE, EXIT_OK
from fvs_tools.table import read_table
from fvs_tools.workers import HELP, Workers


@console.reader_may_leave()
def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    arguments = _parser().parse_args(argv)
    try:
        of_table = arguments.data.suffix == ".csv"
        data = read_table(arguments.data)[0] if of_table else load_data_set(arguments.data)
        output = output_file(arguments.output)
        trained = _train(data, arguments)
        provenance = {
            **trained.provenance,
            "data_file": arguments.data.name,
            "data_sha256": hashlib.sha256(arguments.data.read_bytes()).hexdigest(),
            "numpy": np.__version__,
            "python": platform.python_version(),
        }
        save_model(output, replace(trained, provenance=provenance))
    except (ValueError, OSError) as error:
        print(f"fvs_train: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("fvs_train: interrupted, no model was written", file=sys.stderr)
        return EXIT_FAILURE
    if not arguments.quiet:
        print(report(trained))
    for note in trained.notes:  # the estimator repeats them for the model that it loads
        print(f"note: {note}", file=sys.stderr if arguments.quiet else sys.stdout)
    print(f"model written to {output}; use it with -p model_path:={output}")
    return EXIT_OK


def _train(data: DataSet, arguments: argparse.Namespace) -> TrainedModel:
    options = TrainingOptions(arguments.method, arguments.neurons, arguments.seed)
    workers = Workers(arguments.backend).checked() if arguments.backend else map
    say = None if arguments.quiet else (lambda words: print(f"{words} ...", file=sys.stderr))
    with tqdm(
        desc="training",
        unit="it",
        leave=False,
        disable=arguments.quiet,
        delay=0.5,
        mininterval=0.2 if sys.stderr.isatty() else 10.0,
    ) as bar:

        def on_progress(iteration: int, iterations: int, error: float) -> None:
            bar.total = iterations
            bar.update(iteration - bar.n)
            bar.set_postfix_str(f"error {100.0 * error:.2f} %")

        return train(data, options, on_progress, say, workers)


def _parser() -> argparse.ArgumentParser:
    defaults = TrainingOptions()
    parser = Parser("fvs_train", __doc__)
    parser.add_argument("data", type=Path, metavar="DATA", help="data set, .npz, or table, .csv")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="MODEL", help="model to write, .npz"
    )
    parser.add_argument(
        "--method",
        choices=tuple(METHODS),
        default=defaults.method,
        help="poe fits a serial chain, and the networks to it: a minute of motion is enough; "
        "varpro trains networks, with centres and widths; ridge only their weights, in a second "
        "(default %(default)s)",
    )
    parser.add_argument(
        "--neurons",
        type=int,
        default=None,
        help=f"neurons of a network (default {METHODS['varpro']}, with poe {METHODS['poe']})",
    )
    parser.add_argument(
        "--seed", type=int, default=defaults.seed, help="equal seeds give equal models (default 0)"
    )
    parser.add_argument("--backend", help=f"{HELP} (default: this process)")
    parser.add_argument("--quiet", action="store_true", help="no progress bar and no table")
    return parser


def report(trained: TrainedModel) -> str:
    """The printed summary: errors and chain fit by each camera, box."""
    lines, cameras = [""], trained.cameras
    for camera in cameras:
        lines += [f"camera {camera}:"] * (len(cameras) > 1) + _fit_lines(trained, camera)
    low, high = (", ".join(f"{v:.2f}" for v in side) for side in trained.joint_box_rad)
    lines += [f"joints from [{low}]", f"         to [{high}] rad"]
    return "\n".join(lines)


def _fit_lines(trained: TrainedModel, camera: str) -> list[str]:
    e, lines, text = trained.figures(camera), list[str](), trained.kind.length_text
    if "pair_error_m" in e:
        lines.append(
            f"between held-out images: {text(e['pair_error_m'], 2)} rms, "
            f"{100.0 * e['pair_error_relative']:.2f} % of the motion, noise included"
        )
    if trained.chain is None:
        lines.append(f"no chain: {trained.provenance['no_chain']}")
    else:
        noise = "noise unknown: images too far apart"
        if "noise_m" in e:
            noise = f"noise {text(e['noise_m'], 2)}, misfit {e['misfit']:.2f}"
        lines += [
            f"Jacobian of the chain, in the box of the data: {100 * e['jacobian_deviation']:.3f} % "
            "(standard deviation; the camera's scale is not observable)",
            f"networks: {100 * e['distillation_error']:.2f} % off the chain (median)",
            # + 0.0: no negative zero
            f"images stamped late: {round(1e3 * e['time_offset_s'], 1) + 0.0:.1f} +- "
            f"{1e3 * e['time_offset_deviation_s']:.1f} ms",
            f"lens: {lens_text(e)}",
            f"distance from the chain: {text(e['residual_m'], 2)} (median); {noise}",
        ]
        if "ray_noise_m" in e:
            lines.append(
                f"noise of a position: {text(e['ray_noise_m'], 2)} along the line of sight, "
                f"{text(e['lateral_noise_m'], 2)} across"
            )
    return [*lines, f"{e['samples']} images, {e['outliers']} left out"]


if __name__ == "__main__":
    sys.exit(main())
