"""What an experiment is told, and how it uses all cores, of one machine or of many."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from fvs_lab.cluster import alone, connected
from fvs_lab.trials import Conditions

T = TypeVar("T")
R = TypeVar("R")
Key = TypeVar("Key")


@dataclass(frozen=True)
class Context:
    """Settings of one call of ``fvs_experiments``.

    Parameters
    ----------
    out : Path
        Folder of the page; each experiment has one of its own name in it.
    seeds : int, optional
        Number of seeded cases; each experiment has its own default.
    jobs : int
        Number of processes on this machine.
    quick : bool
        Whether to do a small part of everything, to see that it works.
    rendered : bool
        Whether ball positions come from rendered images.
    nodes : bool
        Whether spot checks through the real nodes are made.
    trials : int, optional
        Number of random worlds; by default as many as the experiment finds enough.
    schemes : tuple of str
        Who is sent through them; empty for all.
    cluster : str
        Address of a dask scheduler whose workers do the runs; empty for this machine.
    """

    out: Path
    seeds: int | None = None
    jobs: int = 1
    quick: bool = False
    rendered: bool = True
    nodes: bool = True
    trials: int | None = None
    schemes: tuple[str, ...] = ()
    cluster: str = ""

    def folder(self, name: str) -> Path:
        """The folder of an experiment, made if need be."""
        path = self.out / name
        path.mkdir(parents=True, exist_ok=True)
        return path

    def count(self, default: int, quick: int) -> int:
        """Number of seeded cases."""
        if self.seeds is not None:
            return self.seeds
        return quick if self.quick else default

    def conditions(self, **changes: Any) -> Conditions:
        """The laboratory's standard conditions, with changes."""
        return replace(Conditions(rendered=self.rendered), **changes)

    def map(self, function: Callable[[T], R], items: Iterable[T], label: str) -> list[R]:
        """Apply a function to all items, on all cores, with a progress bar.

        Parameters
        ----------
        function : callable
            Of one item; must be importable by other processes.
        items : iterable
            The items.
        label : str
            What the progress bar says.

        Returns
        -------
        list
            The results in the items' order, whatever the number of processes and their place.

        Raises
        ------
        ClusterError
            If there is to be a cluster, and it cannot be used.
        """
        from joblib import delayed
        from tqdm import tqdm

        items = list(items)
        if not sys.stderr.isatty():
            print(f"   {label}: {len(items)} runs ...", flush=True)
        with (
            self._engine() as (parallel, engine),
            tqdm(total=len(items), desc=label, leave=False, disable=None) as bar,
        ):
            # Results one by one, as they come, are not to be had from every engine; its count is.
            parallel.print_progress = lambda: bar.update(parallel.n_completed_tasks - bar.n)
            return parallel(delayed(engine(function))(item) for item in items)

    def map_groups(
        self, function: Callable[[T], R], groups: Mapping[Key, Sequence[T]], label: str
    ) -> dict[Key, list[R]]:
        """Apply a function to the items of all groups at once; the results by group."""
        results = iter(self.map(function, chain.from_iterable(groups.values()), label))
        return {key: [next(results) for _ in items] for key, items in groups.items()}

    @contextmanager
    def _engine(self) -> Iterator[tuple[Any, Callable]]:
        """Joblib on this machine or on the cluster, and what must be done to a function there."""
        from joblib import Parallel, parallel_config

        if not self.cluster:
            yield Parallel(n_jobs=self.jobs), lambda function: function
            return
        with connected(self.cluster) as client, parallel_config(backend="dask", client=client):
            yield Parallel(n_jobs=-1), lambda function: partial(alone, function)
