"""Reader of bags, whatever their recorder left of them.

A rosbag2 is read from its files, MCAP or SQLite: ``metadata.yaml`` may be missing, a file may be
compressed as a whole or message by message, an MCAP file may end anywhere. Channels of JSON are
passed over.
"""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2.storage_mcap import McapReader, Schema, zstd
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from fvs_ros.yaml_text import read_yaml_file
from fvs_tools.bag import TYPES

_METADATA, _MCAP, _SQLITE = "metadata.yaml", ".mcap", ".db3"
_COMPRESSED = (".zstd", ".zst")
#: An MCAP file begins and ends with it.
_MAGIC = b"\x89MCAP0\r\n"
#: A message that is compressed begins with it; one in CDR begins with zero.
_ZSTD = b"\x28\xb5\x2f\xfd"


class BagError(ValueError):
    """A bag that cannot be read; the text says why."""


class BagReader:
    """An open bag: its topics, and their messages."""

    def __init__(self, storages: Collection[Any], cut_off: bool) -> None:
        #: Whether its recorder never finished it, or a part of it is missing.
        self.cut_off = cut_off
        self._storages = storages
        #: One for each topic of each file.
        self.connections: list[Connection] = [
            connection
            for storage in storages
            for connection in storage.connections
            if connection.ext.serialization_format == "cdr"
        ]

    def messages(
        self, connections: Collection[Connection] | None = None
    ) -> list[tuple[Connection, int, bytes]]:
        """Connection, time of arrival, ns, and bytes of each message in order of arrival."""
        chosen = self.connections if connections is None else connections
        messages = []
        for storage in self._storages:
            own = [each for each in storage.connections if any(each is other for other in chosen)]
            for connection, time_ns, raw in storage.messages(own) if own else ():
                packed = bytes(raw[:4]) == _ZSTD
                messages.append((connection, time_ns, zstd.decompress(raw) if packed else raw))
        return sorted(messages, key=lambda message: message[1])

    def decoded(
        self, connections: Collection[Connection] | None = None
    ) -> Iterator[tuple[Connection, int, Any]]:
        """The same with each message's content; a damaged one is passed over as if cut off."""
        for connection, time_ns, raw in self.messages(connections):
            try:
                message = TYPES.deserialize_cdr(raw, connection.msgtype)
            except Exception:  # what damaged bytes raise is not documented
                self.cut_off = True
            else:
                yield connection, time_ns, message


@contextmanager
def open_bag(path: Path) -> Iterator[BagReader]:
    """Read a bag: a folder of a rosbag2, or its one file.

    A ``BagError`` says what is wrong with it, whenever that shows.
    """
    try:
        with ExitStack() as stack:
            files, cut_off = _find(path)
            space = Path(stack.enter_context(TemporaryDirectory(prefix="fvs_bag_")))
            storages = [_opened(file, space / str(i), stack) for i, file in enumerate(files)]
            cut_off |= any(getattr(storage, "cut_off", False) for storage in storages)
            reader = BagReader(storages, cut_off)
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


def _find(path: Path) -> tuple[list[Path], bool]:
    """A bag's files, and whether it is incomplete."""
    if not path.exists():
        raise BagError("there is no such file or folder")
    folder = path if path.is_dir() else path.parent
    metadata: dict[str, Any] = {}
    with suppress(OSError, ValueError, AttributeError):  # there may be none, or a damaged one
        metadata = read_yaml_file(folder / _METADATA).get("rosbag2_bagfile_information", {})
    files, named = [path], list[Path]()
    if path.is_dir() or path.name == _METADATA:
        named = [folder / Path(name).name for name in metadata.get("relative_file_paths", [])]
        # Who unpacks or renames a file seldom writes so into the metadata.
        present = [file for file in named if file.exists()] or sorted(folder.iterdir())
        files = [file for file in present if _kind(file)]
    if not files:
        raise BagError(f"it holds neither {_METADATA} nor an {_MCAP} file")
    # A database without metadata lacks what was still in the recorder's memory.
    unfinished = not metadata and _kind(files[0]) == _SQLITE
    return files, unfinished or len(files) < len(named)


def _kind(path: Path) -> str:
    """Ending of a bag's file, without that of its compression; empty for another file."""
    name = path.name.removesuffix(path.suffix) if path.suffix in _COMPRESSED else path.name
    return next((ending for ending in (_MCAP, _SQLITE) if name.endswith(ending)), "")


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
    storage: Any = {_MCAP: _Mcap, _SQLITE: Sqlite3Reader}[kind](path)
    storage.open()
    stack.callback(storage.close)
    return storage


class _Schemas(dict[int, Schema]):
    """Schemas of a file; of an encoding that rosbags refuses they count as not given."""

    def __setitem__(self, key: int, schema: Schema) -> None:
        known = schema.encoding in ("ros2msg", "ros2idl", "omgidl")
        super().__setitem__(key, schema if known else schema._replace(encoding=""))


class _Mcap(McapReader):
    """Reads an MCAP file from its beginning up to its first broken record."""

    cut_off = False

    def open(self) -> None:
        """Find the topics in what is readable."""
        end = max(len(_MAGIC), self.path.stat().st_size - len(_MAGIC))
        self.bio = self.path.open("rb")
        if not _MAGIC.startswith(self.bio.read(len(_MAGIC))):
            raise BagError(f"it is no {_MCAP} file")
        self.bio.seek(end)
        self.cut_off = self.bio.read() != _MAGIC
        self.schemas = _Schemas()
        self.data_start, self.data_end = len(_MAGIC), end
        try:
            self.meta_scan()
        except Exception:  # at the first broken record, of any kind
            self.cut_off = True

    def messages(self, connections: Any, start: Any = None, stop: Any = None) -> Any:
        """All messages before the first broken record."""
        with suppress(Exception):
            yield from self.messages_scan(connections, start, stop)
