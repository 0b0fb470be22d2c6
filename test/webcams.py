"""An arm of any joints that carries points before webcams, from a seed."""

import numpy as np

from fvs_ros.chain import SerialChain
from fvs_ros.pixel_chain import PixelChain, Webcam
from fvs_ros.rotations import rotation_from_vector

WAYS_M = 0.1 * np.array([[1.0, 0.0, 0.5], [0.0, 1.0, -0.5], [-1.0, 0.6, 0.3]])
#: The second camera looks from the side.
ASIDE = rotation_from_vector(np.array([0.0, 1.2, 0.0]))
LENSES = Webcam(600.0, (320.0, 240.0), -0.2), Webcam(500.0, (300.0, 250.0), -0.1)


def before_webcams(rng, joints, points, cameras):
    """The chain before each camera."""
    first = np.array([0.1, -0.1, 1.5])
    axes, near = rng.normal(size=(2, joints, 3))
    carried = np.append(first, WAYS_M[: points - 1])
    arm = SerialChain(axes, first + 0.3 * near, carried, np.zeros(joints))
    aside = arm.moved(ASIDE, np.array([0.0, 0.0, 1.5]) - ASIDE @ [0.0, 0.0, 1.5])
    return tuple(map(PixelChain, (arm, aside), LENSES))[:cameras]
