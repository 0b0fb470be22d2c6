"""The package's files (in the source tree or a ROS share), programs and version."""

from __future__ import annotations

import os
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any
from warnings import warn

PACKAGE = "fvs_ros"
#: Where ROS is installed, if it is: programs that sourced none find its meshes, too.
_INSTALLED = Path("/opt/ros")
#: Like ``python -m``, but never imports what lies in the working directory (the empty name). The
#: kernel (Linux) sends it SIGTERM when the parent has died: PR_SET_PDEATHSIG is 1.
_RUN = (
    "import sys; sys.path[:] = filter(None, sys.path); import ctypes, os, runpy; "
    "ctypes.CDLL(None).prctl(1, 15); os.getppid() == {parent} or sys.exit(1); "
    "runpy.run_module({module!r}, run_name='__main__', alter_sys=True)"
)


def share_folder() -> Path:
    """The folder of ``config/``: the source tree, or ``share/fvs_ros`` of what it is installed in.

    That is a virtual environment, a user's folder, or a ROS prefix.
    """
    source = Path(__file__).resolve().parents[1]
    installed = (folder / "share" / PACKAGE for folder in (source, *source.parents))
    return next((path for path in (source, *installed) if (path / "package.xml").is_file()), source)


def find_file(name: str) -> Path:
    """An existing file given by path, or by name within the project's own folder.

    A relative path that is not found from the working directory is looked up in ``config`` of
    :func:`share_folder`. The ``FileNotFoundError`` lists where it was looked for.
    """
    try:
        path = Path(name).expanduser()
    except RuntimeError:
        raise FileNotFoundError(f"no file {name}: there is no such user") from None
    candidates = dict.fromkeys((path, share_folder() / "config" / path))
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise FileNotFoundError(f"no file {name}; looked in {', '.join(map(str, candidates))}")


def output_file(name: str | Path, *endings: str) -> Path:
    """A file to write, its folder made and tried now: errors show before minutes of work.

    The ``ValueError`` says why it cannot be written; ``endings`` are those that it may have.
    """
    try:
        path = Path(name).expanduser()
        if endings and path.suffix not in endings:
            raise ValueError(f"{path}: expected a file that ends in {' or '.join(endings)}")
        if path.is_dir():
            raise ValueError(f"{path} is a folder, expected the name of a file to write")
        path.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path.parent).close()
    except (OSError, RuntimeError) as error:  # a RuntimeError: there is no such user
        why = getattr(error, "strerror", None) or error
        raise ValueError(f"{name} cannot be written: {why}") from error
    return path


def find_mesh(name: str, urdf: Path | None = None) -> Path | None:
    """The file that a URDF means by ``package://PACKAGE/path``, ``file://path`` or a path.

    It is looked for beside the URDF, if that is a file, and where ROS is sourced or installed.
    """
    inside = name.removeprefix("file://").removeprefix("package://")
    folders = [Path("/")] if urdf is None else urdf.resolve().parents
    beside = [folder / path for folder in folders for path in (inside, inside.partition("/")[2])]
    sourced = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    prefixes = (*map(Path, sourced), *sorted(_INSTALLED.glob("*"), reverse=True))
    candidates = [*beside, *(prefix / "share" / inside for prefix in prefixes)]
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def program(module: str) -> list[str]:
    """Command that runs a module as a program, in this Python.

    It gets SIGTERM when this process ends, even if that was killed.
    """
    return [sys.executable, "-c", _RUN.format(module=module, parent=os.getpid())]


def registered(registry: str, own: dict[str, Any]) -> dict[str, Any]:
    """A registry with what installed packages add: their entry points ``fvs_ros.REGISTRY``.

    What cannot be imported, or has a name that is taken, is said and left out.
    """
    added = dict[str, Any]()
    for point in metadata.entry_points(group=f"{PACKAGE}.{registry}"):
        try:
            if point.name in {**own, **added}:
                raise ValueError("another has this name")
            added[point.name] = point.load()
        except Exception as error:  # whatever a package of others raises
            warn(
                f"{point.group}: {point.name} = {point.value} is left out: {error!r}", stacklevel=2
            )
    return {**added, **own}


def version() -> str:
    """Version of this package; empty where it is not installed."""
    try:
        return metadata.version(PACKAGE)
    except metadata.PackageNotFoundError:
        return ""
