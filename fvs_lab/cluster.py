"""Many machines: an existing dask cluster, in place of this machine's cores."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import fvs_ros
from fvs_lab.lockstep import MODEL
from fvs_ros.paths import find_file

T = TypeVar("T")
R = TypeVar("R")

#: How long a scheduler may take to answer, and its first worker to appear, s.
_ANSWER_S = 10.0

_ALONE = Lock()


class ClusterError(RuntimeError):
    """A cluster that cannot be used; the text says why, and what to do."""


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """Join a cluster for a while.

    Parameters
    ----------
    address : str
        Of its scheduler, such as ``tcp://10.0.0.1:8786``.

    Yields
    ------
    dask.distributed.Client
        For joblib's backend ``dask``.

    Raises
    ------
    ClusterError
        If dask is not installed, nobody answers, or a worker would compute something else.
    """
    try:
        from dask.distributed import Client
    except ImportError:
        raise ClusterError(
            "--cluster needs dask.distributed, which is not installed; pip install distributed"
        ) from None
    try:
        # A client that finds nobody is not let go without a traceback: look before.
        asyncio.run(_knock(address))
        client = Client(address, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError, asyncio.TimeoutError) as error:
        raise ClusterError(f"no dask scheduler answers at {address}: {error}") from None
    with client:
        _check(client, address)
        yield client


async def _knock(address: str) -> None:
    from dask.distributed import Security
    from distributed.comm import connect

    keys = Security().get_connection_args("client")
    comm = await connect(address, timeout=_ANSWER_S, **keys)
    await comm.close()


def _check(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=_ANSWER_S)
    except (OSError, asyncio.TimeoutError):
        raise ClusterError(
            f"the scheduler at {address} has no workers; start some: dask worker {address}"
        ) from None
    try:
        digests = client.run(code_digest)
    except Exception as error:
        # Whatever a worker raises while it imports us arrives as it is.
        raise ClusterError(
            f"a worker of {address} cannot run fvs_ros ({error}); install the same version, with "
            "the extras sim and lab, on every machine"
        ) from None
    others = sorted(worker for worker, digest in digests.items() if digest != code_digest())
    if others:
        raise ClusterError(
            f"{', '.join(others)} of {address} has other code or another model than this machine; "
            "install the same version and start the workers anew"
        )


def code_digest() -> str:
    """Digest of this project's code and of the laboratory's model, as this process finds them."""
    root = Path(fvs_ros.__file__).parents[1]
    digest = hashlib.sha256(find_file(MODEL).read_bytes())
    for package in ("fvs_ros", "fvs_sim_node", "fvs_estimator_node", "fvs_controller_node"):
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def alone(function: Callable[[T], R], item: T) -> R:
    """Apply a function while no other thread of this process does.

    A worker of a cluster may have several threads, and a process has one simulation.
    """
    with _ALONE:
        return function(item)
