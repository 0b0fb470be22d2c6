"""Tags in photographs: how far our corners are from those of AprilTag's own detector.

``FVS_PHOTOGRAPHS=FOLDER python -m bench photographs``, with ``pip install pupil-apriltags``. Any
photographs of 36h11 tags do; the numbers of docs/tags.md are of the folders ``images`` of
github.com/swatbotics/apriltag and ``test`` of github.com/pupil-labs/apriltags.
"""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np

from fvs_detector_node.tag_corners import TagReader
from fvs_detector_node.tags import Tag

#: The other detector's pixels begin at their corners, ours at their centres.
HALF_PX = 0.5


def apart_px(corners_px, others_px):
    """Differences of corners, px, (4, 2), whatever corner comes first."""
    turns = (np.roll(others_px[::way], k, axis=0) for k in range(4) for way in (1, -1))
    return min((one - corners_px for one in turns), key=lambda one: np.abs(one).max())


def main():
    try:
        from pupil_apriltags import Detector
    except ImportError:
        print("skipped: it needs the independent detector, pip install pupil-apriltags")
        return
    folder = os.environ.get("FVS_PHOTOGRAPHS", "")
    paths = sorted(one for one in Path(folder or "/nowhere").rglob("*") if one.is_file())
    other, count, sides_px, off_px = Detector(families="tag36h11", quad_decimate=1.0), 0, [], []
    readers = [TagReader(Tag(tag_id=number)) for number in range(587)]
    for path in paths:
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if grey is None:
            continue
        for theirs in other.detect(grey):
            count += 1
            found, _ = readers[theirs.tag_id].find(grey)
            if not found:
                continue
            corners_px = found[theirs.tag_id].px
            apart = apart_px(corners_px, theirs.corners - HALF_PX)
            if np.abs(apart).max() < 5.0:  # else another tag of the same number
                sides_px.append(np.linalg.norm(corners_px[1] - corners_px[0]))
                off_px.append(np.sqrt(np.square(apart).mean()))
    if not off_px:
        print(f"skipped: no tags of 36h11 in photographs below FVS_PHOTOGRAPHS={folder!r}")
        return
    print(
        f"{len(paths)} files, {count} tags of the other detector, {len(off_px)} read by ours, too"
    )
    half, most = np.percentile(off_px, [50, 90])
    rms = np.sqrt(np.square(off_px).mean())
    print(
        f"  corners apart          rms {rms:.3f} px; of tags, half {half:.3f}, 90 % {most:.3f} px"
    )
    print(f"  their sides            {min(sides_px):.0f} to {max(sides_px):.0f} px")
