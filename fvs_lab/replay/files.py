"""Opening a bag: which files it has, its notes, and what is readable of one that was cut off."""

from __future__ import annotations

import contextlib
import resource
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader

from fvs_tools.bag import NOTES, TYPES
from fvs_tools.scenario import read_yaml_file

_METADATA, _MCAP, _SQLITE = "metadata.yaml", ".mcap", ".db3"
#: An MCAP file begins and ends with it.
_MAGIC = b"\x89MCAP0\r\n"
#: A small file may unpack to any size: reading takes no more memory than this, bytes.
_MOST_MEMORY = 2**32


class BagError(ValueError):
    """A bag that cannot be read; the text says why."""


@dataclass(frozen=True)
class Bag:
    """Where a bag's messages and notes are.

    Parameters
    ----------
    paths : sequence of Path
        Its folder, or its files where the folder is incomplete.
    cut_off : bool
        Whether the recorder never finished it.
    notes : mapping of str to str
        What the recorder noted beside the messages (``custom_data``).
    """

    paths: Sequence[Path]
    cut_off: bool
    notes: Mapping[str, str]


def find(path: Path) -> Bag:
    """The bag in a folder, or of one file; a ``BagError`` if there is none, or more than one."""
    if not path.exists():
        raise BagError(f"there is no {path}")
    folder = path if path.is_dir() else path.parent
    metadata: Mapping[str, Any] = {}
    with contextlib.nullcontext() if path.is_dir() else contextlib.suppress(BagError):
        metadata = _yaml(folder / _METADATA).get("rosbag2_bagfile_information", {})
    listed = [folder / Path(name).name for name in metadata.get("relative_file_paths", [])]
    if not path.is_dir():
        metadata = metadata if path in listed else {}
        listed = [path]
    files = listed or [_only_file(folder)]
    cut_off = any(map(is_cut_off, files))
    notes = metadata.get("custom_data") or (_yaml(folder / NOTES) if not metadata else {})
    if path.is_dir() and metadata and not cut_off:
        files = [path]
    elif path.is_dir() and files[0].suffix == _SQLITE:
        cut_off = True  # without metadata it lacks what was still in the recorder's memory
    return Bag(files, cut_off, {str(key): str(value) for key, value in notes.items()})


def _only_file(folder: Path) -> Path:
    """The file of a folder without metadata."""
    files = sorted(one for one in folder.iterdir() if one.suffix in (_MCAP, _SQLITE))
    if not files:
        raise BagError(f"{folder} is no bag: it holds neither {_METADATA} nor an {_MCAP} file")
    if len(files) > 1:
        names = ", ".join(one.name for one in files)
        raise BagError(f"{folder} holds several files without {_METADATA}, name one: {names}")
    return files[0]


def _yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file; empty where there is no such file."""
    if not path.is_file():
        return {}
    try:
        content = read_yaml_file(path)
    except ValueError as error:
        raise BagError(f"cannot read {path}: {' '.join(str(error).split())}") from None
    return content if isinstance(content, dict) else {}


def is_cut_off(path: Path) -> bool:
    """Whether this is an MCAP file without its end."""
    if path.suffix != _MCAP or not path.is_file():
        return False
    with path.open("rb") as file:
        begins_well = _MAGIC.startswith(file.read(len(_MAGIC)))
        file.seek(max(len(_MAGIC), path.stat().st_size - len(_MAGIC)))
        return begins_well and file.read() != _MAGIC


class _CutOffReader(McapReader):
    """Reads an MCAP file without its end, and so without an index, from its beginning."""

    def open(self) -> None:
        """Find the topics in what is readable."""
        self.bio = self.path.open("rb")
        self.data_start, self.data_end = len(_MAGIC), self.path.stat().st_size
        with contextlib.suppress(Exception):  # at the first broken record, of any kind
            self.meta_scan()

    def messages(self, connections: Any, start: Any = None, stop: Any = None) -> Any:
        """All messages before the first broken record, as they lie in the file."""
        with contextlib.suppress(Exception):
            yield from self.messages_scan(connections, start, stop)


@contextlib.contextmanager
def opened(bag: Bag) -> Iterator[AnyReader]:
    """A reader of all files, which raises a ``MemoryError`` above 4 GB (on Linux)."""
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = _MOST_MEMORY if soft == resource.RLIM_INFINITY else min(soft, _MOST_MEMORY)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    try:
        reader = AnyReader(bag.paths, default_typestore=TYPES)
        for path, one in zip(bag.paths, reader.readers, strict=True):
            if isinstance(one, Reader) and is_cut_off(path):
                one.storage = _CutOffReader(path)
        with reader:
            yield reader
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
