"""Where the project's own files (scenarios, models) lie: beside the source or in a ROS share."""

from __future__ import annotations

import os
import sys
from pathlib import Path

PACKAGE = "fvs_ros"


def _share_folders() -> list[Path]:
    source = Path(__file__).resolve().parents[2]
    folders = [source] if (source / "package.xml").is_file() else []
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    return folders + [Path(p) / "share" / PACKAGE for p in [*prefixes, sys.prefix]]


def find_file(name: str, folder: str = "config") -> Path:
    """A file given by path, or by name within the project's own folder.

    Parameters
    ----------
    name : str
        A path; if relative and not found from the working directory, it is looked up in
        ``folder`` of the source tree, then of each ROS prefix.
    folder : str
        Folder of the project.

    Returns
    -------
    Path
        An existing file.

    Raises
    ------
    FileNotFoundError
        If it is nowhere; the text lists where it was looked for.
    """
    try:
        given = Path(name).expanduser()
    except RuntimeError:
        raise FileNotFoundError(f"no file {name}: there is no such user") from None
    places = [given]
    if not given.is_absolute():
        places += [share / folder / given for share in _share_folders()]
    for place in places:
        if place.is_file():
            return place
    raise FileNotFoundError(f"no file {name}; looked in {', '.join(str(p) for p in places)}")
