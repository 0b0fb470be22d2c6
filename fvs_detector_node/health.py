"""What the node is doing, as a state and a sentence that says what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from fvs_detector_node.detector import Sighting
from fvs_detector_node.synchroniser import Synchroniser

WAITING, TRACKING, LOST, FAULT = "WAITING", "TRACKING", "LOST", "FAULT"

#: An input that is silent for this long is missing, s; the slowest cameras give 5 images a second.
MISSING_S = 1.0
#: This many images in a row without a newer stamp are a frozen stream.
_FROZEN_IMAGES = 5


@dataclass(frozen=True)
class Input:
    """One subscribed topic.

    Parameters
    ----------
    what : str
        What it carries.
    topic : str
        Full name.
    age_s : float
        Since its last message, s; infinite before the first.
    publishers : int
        How many there are.
    hint : str
        What to check where nothing comes.
    """

    what: str
    topic: str
    age_s: float = math.inf
    publishers: int = 0
    hint: str = ""


def judge(
    inputs: Iterable[Input],
    problem: str,
    pair_age_s: float,
    pairing: Synchroniser,
    sighting: Sighting | None,
) -> tuple[str, str]:
    """State and reason.

    Parameters
    ----------
    inputs : iterable of Input
        The subscribed topics.
    problem : str
        What is wrong with the newest messages; empty if nothing is.
    pair_age_s : float
        Since the last pair of images, s; infinite before the first.
    pairing : Synchroniser
        What pairs them.
    sighting : Sighting or None
        What the last pair gave.

    Returns
    -------
    state : str
        ``WAITING``, ``TRACKING``, ``LOST`` or ``FAULT``.
    reason : str
        One sentence.
    """
    if problem:
        return FAULT, problem
    for one in inputs:
        if one.age_s > MISSING_S:
            why = "no message arrives" if one.publishers else "no node publishes there"
            return WAITING, f"no {one.what} on {one.topic}: {why}; {one.hint}"
    if pair_age_s > MISSING_S:
        return _unpaired(pairing)
    if sighting is None:
        return WAITING, "waiting for the first pair of images"
    if sighting.problem:
        return LOST, sighting.problem
    return TRACKING, "the ball is seen, its position is published"


def _unpaired(pairing: Synchroniser) -> tuple[str, str]:
    if pairing.repeats >= _FROZEN_IMAGES:
        return FAULT, (
            f"the image stamps do not advance, {pairing.repeats} in a row: is the camera frozen?"
        )
    apart = "" if pairing.offset_s is None else f" but {1e3 * pairing.offset_s:+.1f} ms apart"
    return WAITING, (
        f"colour and depth are not of one moment{apart}: start the camera with enable_sync:=true"
    )


def mismatch(
    size: tuple[int, ...],
    depth_size: tuple[int, ...],
    frame: str,
    depth_frame: str,
    camera_size: tuple[int, ...],
) -> str:
    """Why colour, depth and calibration are not of one camera; empty if they are.

    Parameters
    ----------
    size, depth_size, camera_size : tuple of int
        Height and width of colour image, depth image and calibration, pixels.
    frame, depth_frame : str
        Frames of the two images.

    Returns
    -------
    str
        One sentence.
    """
    if camera_size != size:
        return f"camera_info is for {_px(camera_size)} pixels, colour images have {_px(size)}"
    differs = ""
    if depth_size != size:
        differs = f"{_px(depth_size)} pixels against {_px(size)}"
    elif depth_frame != frame:
        differs = f"frame {depth_frame[:60]!r} against {frame[:60]!r}"
    if not differs:
        return ""
    return (
        f"depth is not registered to colour: {differs}; start the camera with "
        "align_depth.enable:=true, and take the aligned topic"
    )


def _px(size: tuple[int, ...]) -> str:
    return f"{size[1]}x{size[0]}"
