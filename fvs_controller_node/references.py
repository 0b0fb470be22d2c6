"""Taught references: targets by name, in a YAML file that people read and edit."""

from __future__ import annotations

import os
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fvs_ros.arguments import unknown
from fvs_ros.kinds import Kind
from fvs_ros.yaml_text import read_yaml_file

_HEAD = """\
# Taught references. In the frame `object`, a reference is where the tool shall be seen from the
# object; else in the camera's. x, y, z in m; qx, qy, qz, qw is the orientation. speed is the share
# of max_joint_velocity_rad_s on the way there.
"""
_FEATURE, _FRAME, _SPEED, _DEVIATION = "feature", "frame", "speed", "deviation_m"
#: References in a file, and letters of a name.
_MOST, _LONGEST_NAME = 1000, 80


@dataclass(frozen=True)
class Reference:
    """One taught target."""

    z: np.ndarray  #: (m,)
    frame: str  #: ``object``, or the camera's
    speed: float = 1.0  #: share of the joints' speed limits
    deviation_m: float = 0.0  #: standard deviation of a coordinate, as taught


class References:
    """The references of one file.

    Parameters
    ----------
    path : str
        The file, which may begin with ~; it is read at every use, since people edit it.
    kind : Kind
        What is servoed.
    """

    def __init__(self, path: str, kind: Kind) -> None:
        # Unlike Path.expanduser, this leaves the ~ of an unknown user.
        self.path, self._kind = Path(os.path.expanduser(path)), kind

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
        before = content.get(name)
        speed = before.get(_SPEED, reference.speed) if isinstance(before, dict) else reference.speed
        numbers = self._kind.columns_of(reference.z)
        content[name] = {
            _FEATURE: self._kind.name,
            _FRAME: reference.frame,
            **dict(zip(self._kind.columns, numbers.tolist(), strict=True)),
            _SPEED: speed,
            _DEVIATION: reference.deviation_m,
        }
        if len(content) > _MOST:
            raise ValueError(f"{self.path} holds {_MOST} references already")
        temporary = self.path.with_name(f".{self.path.name}.{os.getpid()}.tmp")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_text(_HEAD + yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
            temporary.replace(self.path)
        finally:
            temporary.unlink(missing_ok=True)

    def _read(self) -> dict[str, Any]:
        try:
            content = read_yaml_file(self.path) or {}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise ValueError(f"{self.path} cannot be read: {error}") from None
        if not isinstance(content, dict) or not all(isinstance(name, str) for name in content):
            raise ValueError(f"{self.path}: expected names of references at the top")
        return content

    def _parse(self, entry: Any) -> Reference:
        kind = self._kind
        if not isinstance(entry, dict):
            raise ValueError(f"expected {', '.join((_FEATURE, _FRAME, *kind.columns))}")
        if entry.get(_FEATURE) != kind.name:
            raise ValueError(f"it is of feature {entry.get(_FEATURE)!s:.20}, expected {kind.name}")
        speed = _number(entry, _SPEED, 1.0)
        if not 0.0 < speed <= 1.0:
            raise ValueError(f"speed is {speed:g}, expected more than 0, up to 1")
        frame = entry.get(_FRAME)
        if not isinstance(frame, str):
            raise ValueError("frame is missing: object, or the camera's frame")
        z = kind.parse(np.array([_number(entry, name) for name in kind.columns]))
        return Reference(z, frame, speed, _number(entry, _DEVIATION, 0.0))


def _number(entry: dict[str, Any], name: str, default: float | None = None) -> float:
    value = entry.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
        raise ValueError(f"{name} is {value!s:.20}, expected a number")
    return float(value)
