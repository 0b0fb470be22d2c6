"""Tags: how exact corners and poses of drawn images are, and whether any pose is wrong.

``python -m bench tags`` draws 10,000 images. A pose is wrong if its angle is off by 5 degrees.

``python -m bench tags ./FOLDER`` compares with AprilTag's own detector (``pip install
pupil-apriltags``) on photographs of 36h11 tags instead; the numbers of docs/tags.md are of
``images`` of github.com/swatbotics/apriltag and ``test`` of github.com/pupil-labs/apriltags.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import cv2
import numpy as np
from drawn_tags import SIZE_M, VGA, corners_px, draw, random_pose

from bench.timing import spread
from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.tag_corners import FIT, TagReader, across_px
from fvs_detector_node.tag_pose import TagDetector
from fvs_detector_node.tags import Tag
from fvs_ros.rotations import vector_from_rotation_rad
from fvs_ros.vectors import length

TAG = Tag(tag_size_m=SIZE_M)
IMAGES = 10_000


def drawn(rng):
    reader, finder = TagReader(TAG), TagDetector(DetectorConfig(tag=TAG))
    errors_px, errors, spent_ms, unread, unsure, wrong = [], [], [], 0, 0, 0
    for k in range(IMAGES):
        pose = random_pose(rng, 1.2)
        grey = draw([(0, *pose)], rng=rng)[..., 0].copy()
        begin_s = time.perf_counter()
        corners, _ = reader.read(grey)
        spent_ms.append(1e3 * (time.perf_counter() - begin_s))
        if not corners:
            unread += 1
            continue
        errors_px.append(corners[0].px - corners_px(*pose))
        tag = finder.find(float(k), corners, VGA).detection
        if tag is None:
            unsure += 1
            continue
        angle = np.degrees(length(vector_from_rotation_rad(tag.rotation.T @ pose[0])))
        wrong += angle > 5.0
        errors.append((1e3 * np.linalg.norm(tag.position_m - pose[1]), angle))
    print(f"{IMAGES} drawn tags of {1e3 * SIZE_M:g} mm, 0.4 to 1.2 m away, tilted by up to 69 deg")
    print(f"  corners, rms           {np.sqrt(np.square(errors_px).mean()):7.3f} px")
    print(f"  finding the corners    {spread(spent_ms, 'ms')}")
    print(f"  unread {unread}, two poses fit {unsure}, wrong {wrong}")
    position_mm, angle = np.median(errors, axis=0)
    print(f"  pose, median error     {position_mm:7.2f} mm {angle:.2f} deg", flush=True)


def photographed(folder):
    """How far corners in photographs are from those of another detector."""
    from pupil_apriltags import Detector

    other, readers = Detector(families="tag36h11", quad_decimate=1.0), {}
    count, errors_px = 0, []
    for path in sorted(Path(folder).rglob("*")):
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
        for theirs in [] if grey is None else other.detect(grey):
            if across_px(theirs.corners) < FIT.cell_px * TAG.cells:
                continue
            number, count = theirs.tag_id, count + 1
            reader = readers.setdefault(number, TagReader(Tag(tag_id=number)))
            corners, _ = reader.read(grey)
            if not corners:
                continue
            # Theirs begin elsewhere, and count from the pixels' corners instead of the middles.
            orders = (
                np.roll(theirs.corners[::step] - 0.5, k, 0) for k in range(4) for step in (1, -1)
            )
            apart = min((corners[number].px - order for order in orders), key=np.linalg.norm)
            if np.abs(apart).max() < 5.0:  # else another tag of the same number
                errors_px.append(np.sqrt(np.square(apart).mean()))
    half, most = np.percentile(errors_px, [50, 90])
    rms = np.sqrt(np.square(errors_px).mean())
    print(
        f"{count} wide enough tags in photographs by AprilTag's detector, {len(errors_px)} by ours"
    )
    print(f"  corners apart          rms {rms:.3f} px; half {half:.3f} px, 90 % {most:.3f} px")


def main():
    if sys.argv[1:]:
        photographed(sys.argv[1])
        return
    drawn(np.random.default_rng(0))
