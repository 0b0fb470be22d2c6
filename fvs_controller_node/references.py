"""Taught references: targets by name, in a YAML file that people read and edit."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np

from fvs_ros.arguments import unknown
from fvs_ros.kinds import Kind
from fvs_ros.kinds.kind import FIXED
from fvs_ros.yaml_text import read_yaml_file, write_yaml

_HEAD = """\
# Taught references. In the frame `object`, a reference is where the tool, or the camera on the arm,
# shall be seen from the object; else in the camera's. x, y, z in m; qx, qy, qz, qw is the
# orientation. speed is the share of max_joint_velocity_rad_s on the way there. Teaching writes the
# file anew, without comments.
"""
_FEATURE, _MOUNT = "feature", "mount"
_FRAME, _SPEED, _DEVIATION = "frame", "speed", "deviation_m"
#: Bytes of a file, which is read between two commands, and letters of a name.
_MOST_BYTES, _LONGEST_NAME = 2**16, 80


@dataclass(frozen=True)
class Reference:
    """One taught target."""

    z: np.ndarray  #: (m,)
    frame: str  #: ``object``, or the camera's
    speed: float = 1.0  #: share of the joints' speed limits
    deviation_m: float = 0.0  #: standard deviation of a coordinate, as taught


class References:
    """The references of one file, whose path may begin with ~.

    It is read at every use, since people edit it.
    """

    def __init__(self, path: str, kind: Kind, joint_names: Sequence[str]) -> None:
        # Unlike Path.expanduser, this leaves the ~ of an unknown user.
        self.path, self._kind = Path(os.path.expanduser(path)), kind
        #: What an entry must be of; that of an older version may lack all but the feature.
        joints, mount = list(joint_names), kind.camera_mount
        self._origin = {"version": 1, _FEATURE: kind.name, "joints": joints, _MOUNT: mount}

    def get(self, name: str) -> Reference:
        """A reference; a ``ValueError`` says why there is none that can be used."""
        content = self._read()
        if name not in content:
            raise ValueError(f"{self.path}: {unknown('reference', name, content)}")
        try:
            return self._parse(content[name])
        except ValueError as error:
            raise ValueError(f"{self.path}, {name}: {error}") from None

    def entries(self) -> dict[str, Reference | str]:
        """All references by name, or what is wrong with one; a ``ValueError`` if it is the file."""
        entries: dict[str, Reference | str] = {}
        for name, entry in self._read().items():
            try:
                entries[name] = self._parse(entry)
            except ValueError as error:
                entries[name] = str(error)
        return entries

    def keep(self, name: str, reference: Reference) -> None:
        """Write a reference into the file, beside the others; its speed stays, if it has one.

        A ``ValueError`` or an ``OSError`` says why that cannot be.
        """
        if not name or len(name) > _LONGEST_NAME or not name.isprintable():
            raise ValueError("the parameter reference must be a short name")
        content = self._read()
        before, speed = content.get(name), reference.speed
        if isinstance(before, dict) and _SPEED in before:
            speed = _speed(before)  # one that is refused must not become the full one
        if isinstance(before, dict) and before.get(_FRAME, reference.frame) != reference.frame:
            raise ValueError(
                f"{name} is taught in the frame {before[_FRAME]!s:.80}, and this would be in "
                f"{reference.frame}: is the object in view? Else take another name"
            )
        numbers = self._kind.columns_of(reference.z)
        content[name] = {
            **self._origin,
            _FRAME: reference.frame,
            **dict(zip(self._kind.columns, numbers.tolist(), strict=True)),
            _SPEED: speed,
            _DEVIATION: reference.deviation_m,
        }
        text = (_HEAD + write_yaml(content)).encode()
        if len(text) > _MOST_BYTES:
            raise ValueError(f"{self.path} would be larger than {_MOST_BYTES >> 10} kB")
        path = self.path.resolve()  # a link stays one
        temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_bytes(text)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)

    def _read(self) -> dict[str, Any]:
        try:
            if self.path.is_fifo():  # which would never answer
                raise ValueError("it is a pipe")
            content = read_yaml_file(self.path, _MOST_BYTES) or {}
            if not isinstance(content, dict):
                raise ValueError("expected names of references at the top")
            return {str(name): entry for name, entry in content.items()}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise ValueError(f"{self.path} cannot be read: {error}") from None

    def _parse(self, entry: Any) -> Reference:
        kind = self._kind
        if not isinstance(entry, dict):
            raise ValueError(f"expected {', '.join((_FEATURE, _FRAME, *kind.columns))}")
        known = (*self._origin, _FRAME, *kind.columns, _SPEED, _DEVIATION)
        for item in entry:
            if item not in known:
                raise ValueError(unknown("entry", str(item)[:_LONGEST_NAME], known))
        origin = {**self._origin, _FEATURE: None, _MOUNT: FIXED, **entry}
        for name, expected in self._origin.items():
            if origin[name] != expected:
                raise ValueError(f"it is of {name} {origin[name]!s:.200}, expected {expected}")
        frame = entry.get(_FRAME)
        if not isinstance(frame, str):
            raise ValueError("frame is missing: object, or the camera's frame")
        z = kind.parse(np.array([_number(entry, name) for name in kind.columns]))
        return Reference(z, frame, _speed(entry), _number(entry, _DEVIATION, 0.0))


def _speed(entry: dict[str, Any]) -> float:
    speed = _number(entry, _SPEED, 1.0)
    if not 0.0 < speed <= 1.0:
        raise ValueError(f"speed is {speed:g}, expected more than 0, up to 1")
    return speed


def _number(entry: dict[str, Any], name: str, default: float | None = None) -> float:
    value, number = entry.get(name, default), nan
    if isinstance(value, (int, float, str)) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            number = float(value)  # also of the text 1e-3, which is none in YAML 1.1
    if not isfinite(number):
        raise ValueError(f"{name} is {value!s:.20}, expected a number")
    return number
