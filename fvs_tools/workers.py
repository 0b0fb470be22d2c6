"""Work of many equal parts on this machine's cores, or on a cluster's: joblib's backends."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from fvs_ros.arguments import how_to_install

T = TypeVar("T")
R = TypeVar("R")

#: Help of the argument ``--backend``.
HELP = (
    "joblib backend: loky (processes of this machine), ray, or "
    "dask,scheduler_host=tcp://HOST:8786 for a cluster whose workers have fvs_ros"
)


@dataclass(frozen=True)
class Workers:
    """Apply a function to all items, like the built-in ``map``, by other processes.

    Both must be picklable. Results are in the items' order and as of one process.
    """

    backend: str = "loky"  #: its name, and settings of its own after it: ``NAME,key=value``
    jobs: int = -1  #: number of processes, -1 for all cores; a cluster has its own

    def __call__(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """The results, each as soon as it and those before are there."""
        try:
            from joblib import Parallel, delayed, parallel_config
        except ImportError:
            raise ImportError(f"joblib is missing: {how_to_install('lab', ['joblib'])}") from None
        name, *settings = self.backend.split(",")
        if not all("=" in setting for setting in settings):
            raise ValueError("expected NAME,key=value")
        if name == "ray":
            from ray.util.joblib import register_ray

            register_ray()
        # Who takes a few results drops the others on purpose.
        warnings.filterwarnings("ignore", r"\d+ tasks which were still being processed")
        pairs = dict(setting.split("=", 1) for setting in settings)
        with parallel_config(name, n_jobs=self.jobs, **pairs):
            parallel = Parallel(return_as="generator")
        results: Iterator[R] = parallel(delayed(function)(item) for item in items)
        return results

    def checked(self) -> Workers:
        """These, once they have worked; a ``ValueError`` says why not."""
        try:
            list(self(abs, [0]))
        except (ImportError, OSError, TypeError, ValueError) as error:
            raise ValueError(f"--backend {self.backend}: {error}") from error
        return self
