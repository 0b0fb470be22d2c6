"""What the node is doing, as a state and a sentence that says what to do next."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fvs_detector_node.detector import Sighting

WAITING, TRACKING, LOST, FAULT = "WAITING", "TRACKING", "LOST", "FAULT"

#: An input that is silent for so long is missing, and a bad message over, s; the slowest cameras
#: give 5 images a second.
_MISSING_S = 1.0
#: So many images in a row without a newer stamp are a frozen stream.
_FROZEN_IMAGES = 5


@dataclass(frozen=True)
class Input:
    """One subscribed topic.

    Parameters
    ----------
    topic : str
        Full name.
    age_s : float
        Since its last message, s; infinite before the first.
    publishers : int
        How many there are.
    """

    topic: str
    age_s: float = math.inf
    publishers: int = 0

    @property
    def missing(self) -> bool:
        """Whether nothing comes."""
        return self.age_s > _MISSING_S

    def silence(self) -> str:
        """What is known about its silence, in words."""
        if self.publishers:
            return "somebody publishes there, but nothing arrives (image_reliability, network?)"
        return "nobody publishes there"


@dataclass(frozen=True)
class Snapshot:
    """What the node knows at a moment.

    Parameters
    ----------
    colour, depth, info : Input
        The three topics.
    problem : str
        What was wrong with the last bad message.
    problem_age_s : float
        How long that is ago, s.
    pair_age_s : float
        Since the last pair of images, s; infinite before the first.
    offset_s : float or None
        Depth's stamp less colour's, of the nearest two found, s.
    tolerance_s : float
        Largest offset of a pair, s.
    repeats : int
        Images in a row whose stamps did not advance.
    calibrated : bool
        Whether a usable camera_info has come.
    sighting : Sighting or None
        What the last pair gave.
    """

    colour: Input
    depth: Input
    info: Input
    problem: str = ""
    problem_age_s: float = math.inf
    pair_age_s: float = math.inf
    offset_s: float | None = None
    tolerance_s: float = 0.0
    repeats: int = 0
    calibrated: bool = False
    sighting: Sighting | None = None


def judge(now: Snapshot) -> tuple[str, str]:
    """State and reason.

    Returns
    -------
    state : str
        ``WAITING``, ``TRACKING``, ``LOST`` or ``FAULT``.
    reason : str
        One sentence.
    """
    if now.problem_age_s < _MISSING_S:
        return FAULT, now.problem
    missing = _missing_input(now)
    if missing:
        return WAITING, missing
    if now.pair_age_s > _MISSING_S:
        return _unpaired(now)
    if now.sighting is None:
        return WAITING, "waiting for the first pair of images"
    if now.sighting.problem:
        return LOST, now.sighting.problem
    return TRACKING, "the ball is seen, its position is published"


def mismatch(
    size: tuple[int, int],
    depth_size: tuple[int, int],
    frame: str,
    depth_frame: str,
    camera_size: tuple[int, int],
) -> str:
    """Why colour, depth and calibration are not of one camera; empty if they are.

    Parameters
    ----------
    size, depth_size, camera_size : tuple of int
        Width and height of colour image, depth image and calibration, pixels.
    frame, depth_frame : str
        Frames of the two images.

    Returns
    -------
    str
        One sentence.
    """
    aligned = "start the camera with align_depth.enable:=true, and take the aligned topic"
    if depth_size != size:
        return (
            f"depth is not registered to colour: {depth_size[0]}x{depth_size[1]} pixels against "
            f"{size[0]}x{size[1]}; {aligned}"
        )
    if depth_frame != frame:
        return (
            f"depth is not registered to colour: frame {depth_frame[:60]!r} against "
            f"{frame[:60]!r}; {aligned}"
        )
    if camera_size != size:
        return (
            f"camera_info is for {camera_size[0]}x{camera_size[1]} pixels, but the colour images "
            f"have {size[0]}x{size[1]}: is it of the same camera?"
        )
    return ""


def _unpaired(now: Snapshot) -> tuple[str, str]:
    """State and reason while images come, but no pairs."""
    if now.repeats >= _FROZEN_IMAGES:
        return FAULT, (
            f"the stamps of the images do not advance, {now.repeats} in a row: is the camera "
            "frozen, or its clock wrong?"
        )
    offset = "unknown" if now.offset_s is None else f"{1e3 * now.offset_s:+.1f} ms"
    return WAITING, (
        f"colour and depth images are never within sync_tolerance_s ({now.tolerance_s:g} s): "
        f"the nearest depth is off by {offset}; start the camera with enable_sync:=true"
    )


def _missing_input(now: Snapshot) -> str:
    """Which input does not come, and what to do; empty if all come."""
    if now.colour.missing:
        return (
            f"no colour images on {now.colour.topic}: {now.colour.silence()}; is the camera "
            "running, and are its topics called so (camera_topics)?"
        )
    if now.depth.missing:
        return (
            f"no depth images on {now.depth.topic}: {now.depth.silence()}; start the camera with "
            "align_depth.enable:=true"
        )
    if not now.calibrated:
        return (
            f"no camera_info on {now.info.topic}: {now.info.silence()}; it belongs to the colour "
            "images, is it remapped as well?"
        )
    return ""
