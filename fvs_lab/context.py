"""Settings of an experiment, and how it uses all cores."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from fvs_lab.outcome import Outcome
from fvs_lab.results import Results
from fvs_lab.trials import Case, Conditions, Variant, run_trial

T = TypeVar("T")
R = TypeVar("R")


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
        Number of processes.
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
    """

    out: Path
    seeds: int | None = None
    jobs: int = 1
    quick: bool = False
    rendered: bool = True
    nodes: bool = True
    trials: int | None = None
    schemes: tuple[str, ...] = ()

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
            The results in the items' order, whatever the number of processes.
        """
        from joblib import Parallel, delayed
        from tqdm import tqdm

        items = list(items)
        if not sys.stderr.isatty():
            print(f"   {label}: {len(items)} runs ...", flush=True)
        parallel = Parallel(n_jobs=self.jobs, return_as="generator")
        done = parallel(delayed(function)(item) for item in items)
        return list(tqdm(done, desc=label, total=len(items), leave=False, disable=None))

    def run(
        self,
        variants: Iterable[Variant],
        cases: Sequence[Case],
        label: str,
        measure: Callable[[Variant, Case, Outcome], Mapping[str, Any]] | None = None,
        **fields: Any,
    ) -> Results:
        """Run every variant on every case.

        Parameters
        ----------
        variants : iterable of Variant
            What is compared.
        cases : sequence of Case
            Starts and goals, the same for all.
        label : str
            What the progress bar says.
        measure : callable, optional
            Further columns of a run.
        **fields
            Of all trials, such as ``duration_s`` and ``record``.
        """
        pairs = [(variant, case) for variant in variants for case in cases]
        return self.run_pairs(pairs, label, measure, **fields)

    def run_pairs(
        self,
        pairs: Sequence[tuple[Variant, Case]],
        label: str,
        measure: Callable[[Variant, Case, Outcome], Mapping[str, Any]] | None = None,
        **fields: Any,
    ) -> Results:
        """Run variants on cases of their own; see :meth:`run`."""
        trials = [variant.trial(case, self.conditions(), **fields) for variant, case in pairs]
        outcomes = self.map(run_trial, trials, label)
        rows = []
        for (variant, case), outcome in zip(pairs, outcomes, strict=True):
            more = measure(variant, case, outcome) if measure else {}
            rows.append({**outcome.row(**variant.labels, case=case.name), **more})
        return Results(rows)
