"""Which version of this package runs."""

from __future__ import annotations

from importlib import metadata


def version() -> str:
    """Version of this package; empty where it is not installed."""
    try:
        return metadata.version("fvs_ros")
    except metadata.PackageNotFoundError:
        return ""
