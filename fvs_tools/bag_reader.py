"""Reader of bags, whatever their recorder left of them.

A rosbag2 is read from its files, MCAP or SQLite: ``metadata.yaml`` may be missing, a file may be
compressed as a whole or message by message, an MCAP file may end anywhere or lack its summary. What
cannot be understood (a channel of JSON, a service's events) is passed over.
"""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from heapq import merge
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Rosbag1
from rosbags.rosbag2.storage_mcap import McapReader, Schema, zstd
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_typestore

from fvs_tools.bag import NOTES, TYPES
from fvs_tools.scenario import read_yaml_file

_METADATA, _MCAP, _SQLITE, _ROS1 = "metadata.yaml", ".mcap", ".db3", ".bag"
_COMPRESSED = (".zstd", ".zst")
_ROS1_TYPES = get_typestore(Stores.ROS1_NOETIC)
#: An MCAP file begins and ends with it.
_MAGIC = b"\x89MCAP0\r\n"
#: A message that is compressed begins with it; one in CDR begins with zero.
_ZSTD = b"\x28\xb5\x2f\xfd"


class BagError(ValueError):
    """A bag that cannot be read; the text says why."""


class BagReader:
    """An open bag: its topics, and their messages."""

    def __init__(self, storages: Collection[Any], notes: Mapping[str, Any], cut_off: bool) -> None:
        #: Whether its recorder never finished it, or a part of it is missing.
        self.cut_off = cut_off
        #: What its recorder noted (``custom_data``).
        self.notes = notes
        self._storages = storages
        self._ros1 = any(isinstance(one, Rosbag1) for one in storages)
        #: One for each topic of each file.
        self.connections: list[Connection] = [
            one
            for storage in storages
            for one in storage.connections
            if getattr(one.ext, "serialization_format", "cdr") == "cdr"
        ]

    @property
    def middle_ns(self) -> int | None:
        """Time of arrival in the middle, ns; None for a bag without an index."""
        some = [one if self._ros1 else one.metadata for one in self._storages]
        first, last = min(one.start_time for one in some), max(one.end_time for one in some)
        return (first + last) // 2 if first < last else None

    def messages(
        self, connections: Collection[Connection] | None = None, start: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Connection, time of arrival, ns, and bytes of each message in order of arrival."""
        chosen = self.connections if connections is None else connections
        parts = []
        for storage in self._storages:
            own = [one for one in storage.connections if any(one is some for some in chosen)]
            if own:
                parts.append(storage.messages(own, start))
        for connection, time_ns, raw in merge(*parts, key=lambda one: one[1]):
            whole = zstd.decompress(raw) if bytes(raw[:4]) == _ZSTD else raw
            yield connection, time_ns, whole

    def deserialize(self, raw: bytes, kind: str) -> Any:
        """The message in some bytes of one of ROS's own types."""
        return (_ROS1_TYPES.deserialize_ros1 if self._ros1 else TYPES.deserialize_cdr)(raw, kind)


@contextmanager
def open_bag(path: Path) -> Iterator[BagReader]:
    """Read a bag: a folder of a rosbag2, or its one file; or a bag of ROS 1.

    A ``BagError`` says what is wrong with it, whenever that shows.
    """
    try:
        with ExitStack() as stack:
            files, notes, cut_off = _find(path)
            space = Path(stack.enter_context(TemporaryDirectory(prefix="fvs_bag_")))
            storages = [_opened(file, space / str(i), stack) for i, file in enumerate(files)]
            reader = BagReader(
                storages, notes, cut_off or any(getattr(one, "cut_off", False) for one in storages)
            )
            if reader.cut_off and not reader.connections:
                raise BagError("it was cut off before any message was written into it")
            yield reader
    except BagError as error:
        raise BagError(f"cannot read {path}: {error}") from None
    except ValueError:
        raise
    except Exception as error:  # a damaged file shows anywhere in the reader
        words = " ".join(str(error).split())[:200]
        raise BagError(
            f"cannot read {path}: it is damaged or no bag ({type(error).__name__}: {words})"
        ) from error


def _find(path: Path) -> tuple[list[Path], Mapping[str, Any], bool]:
    """A bag's files, its recorder's notes, and whether it is incomplete."""
    if not path.exists():
        raise BagError("there is no such file or folder")
    folder = path if path.is_dir() else path.parent
    metadata = _yaml(folder / _METADATA).get("rosbag2_bagfile_information", {})
    notes = metadata.get("custom_data") or _yaml(folder / NOTES)
    if path.is_file() and path.name != _METADATA:
        return [path], notes, not metadata and path.suffix == _SQLITE
    named = [folder / Path(one).name for one in metadata.get("relative_file_paths", [])]
    # Who unpacks or renames a file seldom writes so into the metadata.
    some = [one for one in named if one.exists()] or sorted(folder.iterdir())
    files = [one for one in some if _kind(one)]
    if not files:
        raise BagError(f"it holds neither {_METADATA} nor an {_MCAP} file")
    # A database without metadata lacks what was still in the recorder's memory.
    unfinished = not metadata and _kind(files[0]) == _SQLITE
    return files, notes, unfinished or len(files) < len(named)


def _yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file; empty where there is no such file, or it is damaged."""
    content = None
    with suppress(OSError, ValueError):
        content = read_yaml_file(path)
    return content if isinstance(content, dict) else {}


def _kind(path: Path) -> str:
    """Ending of a bag's file, without that of its compression; empty for another file."""
    name = path.name.removesuffix(path.suffix) if path.suffix in _COMPRESSED else path.name
    return next((one for one in (_MCAP, _SQLITE, _ROS1) if name.endswith(one)), "")


def _opened(path: Path, space: Path, stack: ExitStack) -> Any:
    """The storage in a file; what has to be unpacked for it is put into a folder."""
    kind = _kind(path)
    if not kind:
        raise BagError(f"it is no {_MCAP} or {_SQLITE} file")
    if path.suffix in _COMPRESSED:
        space.mkdir()
        with zstd.open(path, "rb") as packed, (space / path.stem).open("wb") as plain:
            shutil.copyfileobj(packed, plain)
        path = space / path.stem
    log = path.with_name(f"{path.name}-wal")
    if kind == _SQLITE and log.is_file() and log.stat().st_size:
        space.mkdir(exist_ok=True)
        path = _with_log(path, log, space)
    storage: Any = {_MCAP: _Mcap, _SQLITE: Sqlite3Reader, _ROS1: Rosbag1}[kind](path)
    storage.open()
    stack.callback(storage.close)
    return storage


def _with_log(path: Path, log: Path, space: Path) -> Path:
    """A copy of a database with the messages that a killed recorder left in the log beside it."""
    for one in (path, log):
        shutil.copy(one, space / one.name)
    with contextlib.closing(sqlite3.connect(space / path.name)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return space / path.name


class _Schemas(dict[int, Schema]):
    """Schemas of a file; of an encoding that rosbags refuses they count as not given."""

    def __setitem__(self, key: int, schema: Schema) -> None:
        known = schema.encoding in ("ros2msg", "ros2idl", "omgidl")
        super().__setitem__(key, schema if known else schema._replace(encoding=""))


class _Mcap(McapReader):
    """Reads an MCAP file by its index, or, where that is not whole, from its beginning."""

    cut_off = False
    _scanned = False

    def open(self) -> None:
        """Find the topics; of a file without its end, or its index, those in what is readable."""
        end = max(len(_MAGIC), self.path.stat().st_size - len(_MAGIC))
        with self.path.open("rb") as file:
            begins_well = _MAGIC.startswith(file.read(len(_MAGIC)))
            file.seek(end)
            self.cut_off = begins_well and file.read() != _MAGIC
        self.schemas = _Schemas()
        if not begins_well:
            super().open()  # raises
        if not self.cut_off:
            with suppress(Exception):
                super().open()
            names = {one.msgtype for one in self.connections}
            if names and "__schemaless__" not in names:
                return
            if self.bio is not None:
                self.close()
        self._scanned, self.bio = True, self.path.open("rb")
        self.data_start, self.data_end = len(_MAGIC), end
        try:
            self.meta_scan()
        except Exception:  # at the first broken record, of any kind
            self.cut_off = True

    def messages(self, connections: Any, start: Any = None, stop: Any = None) -> Any:
        """All messages, of a scanned file those before the first broken record."""
        if not self._scanned:
            yield from super().messages(connections, start, stop)
            return
        with suppress(Exception):
            yield from self.messages_scan(connections, start, stop)
