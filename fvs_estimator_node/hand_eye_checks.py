"""Whether images fit any arm of such joints before a camera at rest; if not, what is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fvs_estimator_node.calibration import GOOD, USABLE, CalibrationError
from fvs_estimator_node.files import DataSet
from fvs_ros.chain import cross_matrix
from fvs_ros.urdf import Kinematics

#: A joint that moves less, standard deviation in rad and m, determines nothing.
_STILL_RAD, _STILL_M = 0.02, 0.005
#: Nothing is further away, m.
_FAR_M = 30.0
#: Images are explained if they are nearer than this many times their noise.
_EXPLAINED = 1.6
#: Moments at which the camera may have been moved, share of the squared residuals that this must
#: explain, and share of the images before the first of them.
_MOMENTS, _BUMPED, _FEW = 40, 0.2, 0.05


def length(off_m: np.ndarray) -> float:
    """Median distance, m, of residuals, m, (k, m)."""
    return float(np.median(np.linalg.norm(off_m[:, :3], axis=1)))


def ordered(data: DataSet, arm: Kinematics) -> DataSet:
    """The data with the joints of the URDF, in its order; all of them have moved."""
    if data.feature_frame in ("", arm.root):
        raise CalibrationError(
            f"ball or tag has the frame {data.feature_frame!r}, expected the camera's"
        )
    for what, points_m in (("ball or tag", data.ball_m[:, :3]), ("the URDF", arm.points_m)):
        far_m = float(np.median(np.linalg.norm(points_m, axis=1)))
        if far_m > _FAR_M:
            raise CalibrationError(f"{what} has places {far_m:.0f} m away: expected metres")
    where = f"is {arm.tip} the link that carries what is seen?"
    missing = [name for name in arm.names if name not in data.joint_names]
    if missing:
        raise CalibrationError(
            f"the data lack {', '.join(missing)[:200]}, which move {arm.tip} in the URDF; "
            f"they hold {', '.join(data.joint_names)[:400]}: {where}"
        )
    joints = data.joints_rad[:, [data.joint_names.index(name) for name in arm.names]]
    least = np.where(arm.prismatic > 0.0, _STILL_M, _STILL_RAD)
    still = np.array(arm.names)[joints.std(axis=0) < least]
    if still.size > (len(arm.names) - 2 if data.still else 0):  # the URDF has the axes
        raise CalibrationError(
            f"{', '.join(still)[:200]} never moved: move every joint, by 0.1 rad or 20 mm at "
            f"least; {where}"
        )
    return replace(data, joints_rad=joints, joint_names=arm.names)


def refusal(data: DataSet, arm: Kinematics) -> CalibrationError:
    """Of images that no arm of these joints can give; the data with all joints that there are."""
    spread = data.joints_rad.std(axis=0)
    others = [
        name
        for name, one in zip(data.joint_names, spread, strict=True)
        if name not in arm.names and one > _STILL_RAD
    ]
    also = f" {', '.join(others)[:200]} moved, too, but is not among them." if others else ""
    return CalibrationError(
        f"no arm of the joints {', '.join(arm.names)[:200]} moves like that.{also} Is {arm.tip} "
        "the right link, are the joints in rad, and under their own names? Did camera and ball or "
        "tag stay where they were fixed, the camera on the arm or beside it as told?"
    )


def find_move(
    off_m: np.ndarray, seen_m: np.ndarray, white: np.ndarray, stamps_s: np.ndarray, noise_m: float
) -> str | None:
    """How what the camera sees was moved while the images were taken; empty if it was not.

    None if neither a chain nor a chain before a moved camera explains the images.

    Parameters
    ----------
    off_m, seen_m : ndarray, shape (k, 3)
        How far a chain that was fitted freely is from the images, and where they show the feature,
        m.
    white : ndarray, shape (k, 3, 3)
        Turns residuals into standard deviations.
    stamps_s : ndarray, shape (k,)
        Of the images, s.
    noise_m : float
        Of an image, m.
    """
    turns = np.swapaxes(cross_matrix(seen_m - seen_m.mean(axis=0)), 1, 2)
    slopes = np.concatenate([turns, np.broadcast_to(np.eye(3), turns.shape)], axis=2)
    rows, wanted = white @ slopes, (white @ off_m[..., None])[..., 0]
    # Sums up to each image, of squares and of products: any moment is tried at once.
    square = np.cumsum(np.einsum("kij,kil->kjl", rows, rows), axis=0)
    pull = np.cumsum(np.einsum("kij,ki->kj", rows, wanted), axis=0)

    def moved(k: int) -> tuple[float, np.ndarray, np.ndarray]:
        """Squares that a move after image k explains, and where it was before and after."""
        before = np.linalg.solve(square[k], pull[k])
        after = np.linalg.solve(square[-1] - square[k], pull[-1] - pull[k])
        always = np.linalg.solve(square[-1], pull[-1])
        gain = before @ pull[k] + after @ (pull[-1] - pull[k]) - always @ pull[-1]
        return float(gain), before, after

    # Of a few images at either end a move explains anything.
    moments = np.linspace(_FEW * len(off_m), (1.0 - _FEW) * len(off_m), _MOMENTS).astype(int)
    best = max(moments, key=lambda k: moved(k)[0])
    gain, before, after = moved(best)
    way_m = np.linalg.norm(slopes @ (after - before), axis=1).mean()
    if gain <= _BUMPED * np.sum(wanted**2) or way_m <= GOOD[0]:
        return None if length(off_m) > max(_EXPLAINED * noise_m, 0.5 * USABLE[0]) else ""
    late = np.arange(len(off_m))[:, None] > best
    rest = off_m - np.einsum("kij,kj->ki", slopes, np.where(late, after, before))
    if length(rest) > max(_EXPLAINED * noise_m, 0.5 * length(off_m)):
        return None
    turn_deg = np.degrees(np.linalg.norm((after - before)[:3]))
    return (
        f"the camera moved, or what it sees on its mount, by about {1e3 * way_m:.1f} mm and "
        f"{turn_deg:.1f} degrees in the image, some {stamps_s[best] - stamps_s[0]:.0f} s after the "
        "first image: fix it, and collect again"
    )
