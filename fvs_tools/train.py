"""``fvs_train``: train the Jacobian networks from a data set of the collector."""

from __future__ import annotations

import argparse
import hashlib
import math
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fvs_estimator_node.dataset import DataSet, load_data_set
from fvs_estimator_node.model_file import TrainedModel, save_model
from fvs_estimator_node.teaching import NEURONS, TaughtModel, train_structured, with_chain
from fvs_estimator_node.training import (
    METHODS,
    TrainingOptions,
    TrainingProgress,
    TrainingResult,
    train,
)
from fvs_ros import console
from fvs_ros.arguments import Parser, one_of
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_FAILURE, EXIT_OK

#: The method that assumes a serial chain.
STRUCTURED = "poe"
#: A network with a larger error is doubtful, if its joint moves the ball by this share of what the
#: one does that moves it most.
_DOUBTFUL, _MATTERS = 0.15, 0.2


@console.reader_may_leave()
def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    arguments = _parser().parse_args(argv)
    try:
        data = load_data_set(arguments.data)
        _check_output(arguments.output)
        trained, words, notes, out_of_time = _train(data, arguments)
        provenance = {
            **trained.provenance,
            "notes": notes,  # the estimator says them again, of the model it loads
            "data_file": arguments.data.name,
            "data_sha256": _sha256(arguments.data),
            "stopped_by_time": out_of_time,
            "numpy": np.__version__,
            "python": platform.python_version(),
        }
        save_model(arguments.output, replace(trained, provenance=provenance))
    except (ValueError, OSError) as error:
        print(f"fvs_train: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("fvs_train: interrupted, no model was written", file=sys.stderr)
        return EXIT_FAILURE
    if not arguments.quiet:
        print(words)
    for note in notes:
        print(f"note: {note}", file=sys.stderr if arguments.quiet else sys.stdout)
    print(f"model written to {arguments.output}")
    return EXIT_OK


def _train(
    data: DataSet, arguments: argparse.Namespace
) -> tuple[TrainedModel, str, list[str], bool]:
    """The model, its figures and notes in words, and whether time was over before the training."""
    started_s = time.monotonic()
    if arguments.method == STRUCTURED:
        say = None if arguments.quiet else (lambda words: print(f"{words} ...", file=sys.stderr))
        neurons = NEURONS if arguments.neurons is None else arguments.neurons
        taught = train_structured(data, neurons, arguments.seed, say)
        words = report_structured(taught, time.monotonic() - started_s)
        return taught.trained, words, list(taught.notes), False
    options = TrainingOptions(
        method=arguments.method,
        neurons=TrainingOptions.neurons if arguments.neurons is None else arguments.neurons,
        seed=arguments.seed,
    )
    with _Bar(arguments.max_seconds, quiet=arguments.quiet) as bar:
        result = train(data, options, bar.report)
    words = report(result, time.monotonic() - started_s)
    trained, chain = with_chain(result.trained, data, arguments.seed)
    notes = [*result.notes, *_doubts(result)]
    return trained, f"{words}\n{chain}", notes, bar.out_of_time


def _parser() -> argparse.ArgumentParser:
    defaults = TrainingOptions()
    parser = Parser("fvs_train", __doc__)
    parser.add_argument("data", type=Path, metavar="DATA", help="data set, .npz")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="MODEL", help="model to write, .npz"
    )
    parser.add_argument(
        "--method",
        type=one_of("method", (*METHODS, STRUCTURED)),
        default=defaults.method,
        help="varpro also moves the neurons; ridge solves for the weights only, in about a second; "
        "poe fits a chain of six revolute joints, which teaches the networks: a minute of motion "
        "is enough (default %(default)s)",
    )
    parser.add_argument(
        "--neurons",
        type=int,
        default=None,
        help=f"per network (default {defaults.neurons}, with poe {NEURONS})",
    )
    parser.add_argument(
        "--seed", type=int, default=defaults.seed, help="equal seeds give equal models (default 0)"
    )
    parser.add_argument(
        "--max-seconds",
        type=float,
        default=None,
        help="stop refining after this time and keep the best so far (default: no limit)",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar and no table")
    return parser


def _check_output(path: Path) -> None:
    """Find out before the training, not after it, that the model cannot be written."""
    if path.is_dir():
        raise ValueError(f"{path} is a folder, expected the name of a model file to write")
    if not path.absolute().parent.is_dir():
        raise ValueError(f"the folder {path.absolute().parent} for the model does not exist")


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while chunk := stream.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()


def report(result: TrainingResult, seconds: float) -> str:
    """What a user should see: errors, boxes, time."""
    lines = ["", "network              column m/rad  error"]
    for name, network in zip(result.trained.joint_names, result.networks, strict=True):
        error = (
            "does not move the ball"
            if network.relative is None
            else f"{100.0 * network.relative:6.2f} %"
        )
        lines.append(f"{name:20s} {network.column_m_rad:11.3f}  {error}")
    low, high = result.trained.joint_box_rad
    lines += [
        "(errors at held-out joints against a smooth fit that is itself about a percent off)",
        "",
        f"prediction between held-out images: {1e3 * result.pair_error_m:.2f} mm rms, "
        f"{100.0 * result.pair_error_relative:.2f} % of the ball's motion, noise included",
    ]
    if result.step_error_relative is not None:
        lines.append(
            f"prediction from one held-out image to the next: "
            f"{100.0 * result.step_error_relative:.1f} %, mostly noise"
        )
    lines += [
        f"joints from [{', '.join(f'{v:.2f}' for v in low)}]",
        f"         to [{', '.join(f'{v:.2f}' for v in high)}] rad",
        f"{result.samples} images, {result.held_out_samples} held out, {result.outliers} left out; "
        f"{result.iterations} iterations, {seconds:.1f} s",
    ]
    return "\n".join(lines)


def report_structured(taught: TaughtModel, seconds: float) -> str:
    """What a user should see of a structured training."""
    fit = taught.fit
    low, high = taught.trained.joint_box_rad
    told = (
        "images too far apart to tell how much of it is noise"
        if math.isnan(fit.noise_m)
        else f"of which noise explains {1e3 * fit.noise_m:.2f} mm: misfit {fit.misfit:.2f}"
    )
    lines = [
        "",
        f"Jacobian of the chain, in the box of the data: {100 * taught.jacobian_deviation:.3f} % "
        "(standard deviation; as the camera sees, whose scale no motion tells)",
        f"six networks taught by it: {100 * taught.teaching_error:.2f} % off the chain (median)",
        # + 0.0: no negative zero
        f"images stamped late: {round(1e3 * fit.time_offset_s, 1) + 0.0:.1f} +- "
        f"{1e3 * fit.time_offset_deviation_s:.1f} ms",
        f"noise of a ball position: {1e3 * fit.ray_noise_m:.2f} mm along the line of sight, "
        f"{1e3 * fit.lateral_noise_m:.2f} mm across",
        f"distance from the chain: {1e3 * fit.residual_m:.2f} mm (median), {told}",
        f"joints from [{', '.join(f'{v:.2f}' for v in low)}]",
        f"         to [{', '.join(f'{v:.2f}' for v in high)}] rad",
        f"{fit.samples} images, {fit.outliers} left out; {seconds:.1f} s",
    ]
    return "\n".join(lines)


def _doubts(result: TrainingResult) -> list[str]:
    """What makes a model unfit for use, in words; empty if nothing does."""
    largest = max(network.column_m_rad for network in result.networks)
    bad = [
        name
        for name, network in zip(result.trained.joint_names, result.networks, strict=True)
        if network.relative is not None
        and network.relative > _DOUBTFUL
        and network.column_m_rad > _MATTERS * largest
    ]
    if not bad:
        return []
    return [
        f"{', '.join(bad)}: over {100 * _DOUBTFUL:.0f} % off; collect longer or in a wider box, "
        "and see that one robot and one detector alone were publishing"
    ]


class _Bar:
    """A progress bar, seldom redrawn off a terminal; ends the training when time is over."""

    def __init__(self, max_seconds: float | None, quiet: bool) -> None:
        self._max_seconds = max_seconds
        self._quiet = quiet
        self._started_s = time.monotonic()
        self._bar: Any = None
        self.out_of_time = False

    def __enter__(self) -> _Bar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def report(self, progress: TrainingProgress) -> bool:
        """Show the progress; True when the time is over."""
        if not self._quiet:
            self._show(progress)
        if self._max_seconds is not None:
            self.out_of_time = time.monotonic() - self._started_s > self._max_seconds
        return self.out_of_time

    def _show(self, progress: TrainingProgress) -> None:
        if self._bar is None:
            try:
                from tqdm import tqdm
            except ImportError:
                self._quiet = True
                return
            self._bar = tqdm(
                total=progress.iterations,
                desc="training",
                unit="it",
                leave=False,
                mininterval=0.2 if sys.stderr.isatty() else 10.0,
            )
        self._bar.update(progress.iteration - self._bar.n)
        self._bar.set_postfix_str(f"error {100.0 * progress.validation_error:.2f} %")


if __name__ == "__main__":
    sys.exit(main())
