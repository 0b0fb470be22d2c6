"""A chain and the lens before it, from the pixels of points."""

from dataclasses import replace

import numpy as np
import pytest
from cases import each
from recordings import relative_error, seen_from_anywhere

from fvs_estimator_node.chain_fit import ChainFitError
from fvs_estimator_node.files import (
    DataSet,
    FileError,
    load_data_set,
    load_model,
    save_data_set,
    save_model,
)
from fvs_estimator_node.joint_path import Path
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.pairs import TrainingError
from fvs_estimator_node.pixel_fit import changed, fit_pixels, residuals
from fvs_estimator_node.training import TrainingOptions, train
from fvs_ros.chain import SerialChain
from fvs_ros.kinds import KindConfig
from fvs_ros.kinds.points import Points
from fvs_ros.pixel_chain import PixelChain, Webcam
from fvs_tools.train import report

#: With a rolling shutter that takes 20 ms for a picture of 480 rows.
LENS = Webcam(560.0, (310.0, 255.0), -0.25, 0.06, 4e-5)
NOISE_PX, RATE_HZ, REACH_RAD = 0.3, 30.0, 0.3
#: Ways from the first point to the others, m.
OTHERS_M = 0.08 * np.array(
    [[1.0, 0.0, 0.5], [0.0, 1.0, -0.5], [-1.0, 0.6, 0.3], *np.ndindex(2, 2, 2)]
)


def before_camera(chain, points=1):
    """The chain with some points, and the camera."""
    return PixelChain(
        replace(chain, feature_m=np.append(chain.feature_m, OTHERS_M[: points - 1])), LENS
    )


def strange_arm(joints, rng):
    """Axes anywhere within half a metre of a point that the camera sees."""
    ball = np.array([0.1, -0.1, 1.5])
    points = ball + 0.25 * rng.normal(size=(joints, 3))
    return SerialChain(rng.normal(size=(joints, 3)), points, ball, np.zeros(joints))


def recorded(model, seconds=60.0, noise_px=NOISE_PX, outliers=0.0, seed=0, rate_hz=RATE_HZ):
    """What the camera records of random motion about the reference joints."""
    reference, rng = model.chain.reference_rad, np.random.default_rng([seed, 5])
    names = tuple(f"joint_{i + 1}" for i in range(len(reference)))
    config = MotionConfig(joint_names=names, joint_range_rad=(REACH_RAD,))
    motion, stamps = RandomMotion(reference, config, rng), np.arange(1.0, seconds, 1.0 / rate_hz)
    exposed_s = stamps - model.webcam.late_s
    z = model.position(motion.path(exposed_s)[0])
    rows = z[:, 1::2] - z[:, 1::2].mean()
    for point in range(rows.shape[1]):
        time_s = exposed_s + model.webcam.line_s * rows[:, point]
        of_point = slice(2 * point, 2 * point + 2)
        z[:, of_point] = model.position(motion.path(time_s)[0])[:, of_point]
    z = z + noise_px * rng.normal(size=z.shape)
    z += 30.0 * rng.normal(size=z.shape) * (rng.random((len(z), 1)) < outliers)
    run = np.zeros(len(z))
    return DataSet(stamps, motion.path(stamps)[0], z, run, feature="points")


def box_of(model, count=100):
    draws = np.random.default_rng(3).uniform(-1.0, 1.0, (count, len(model.chain.axes)))
    return model.chain.reference_rad + REACH_RAD * draws


def test_derivatives_are_exact():
    model = before_camera(seen_from_anywhere(np.random.default_rng(1)), 3)
    model = replace(model, webcam=replace(LENS, line_s=0.0))  # they are those without
    data = recorded(model, 5.0)
    path = Path(data)
    images, pixels = np.arange(5), data.z[path.indices].reshape(-1, 3, 2)
    slopes = residuals(model, path, pixels, images)[1]
    for column, step in enumerate(1e-6 * np.eye(slopes.shape[-1])):
        forth, back = (
            residuals(changed(model, way * step), path, pixels, images)[0] for way in (1.0, -1.0)
        )
        np.testing.assert_allclose(slopes[..., column], (forth - back) / 2e-6, rtol=1e-5, atol=1e-3)
    joints = data.joints_rad[:5]
    numeric = [
        (model.position(joints + step) - model.position(joints - step)) / 2e-6
        for step in 1e-6 * np.eye(6)
    ]
    np.testing.assert_allclose(
        model.jacobian(joints), np.stack(numeric, axis=-1), rtol=1e-5, atol=1e-4
    )


@each(
    "chain, points, outliers",
    [
        (seen_from_anywhere(np.random.default_rng(1)), 1, 0.0),
        (seen_from_anywhere(np.random.default_rng(2)), 1, 0.05),
        (strange_arm(7, np.random.default_rng(3)), 4, 0.0),
        (seen_from_anywhere(np.random.default_rng(5)), 12, 0.02),
        (strange_arm(5, np.random.default_rng(4)), 1, 0.0),
    ],
)
def test_a_minute_tells_arm_and_lens(chain, points, outliers):
    model = before_camera(chain, points)
    fit = fit_pixels(recorded(model, outliers=outliers))
    joints = box_of(model)
    error = relative_error(fit.chain.jacobian(joints), model.jacobian(joints))
    assert np.median(error) < 0.003
    assert np.median(error) < 3.0 * np.median(fit.jacobian_deviation(joints))
    assert fit.chain.webcam.focal_px == pytest.approx(LENS.focal_px, rel=0.02)
    off = np.abs(fit.chain.webcam.numbers - LENS.numbers) / fit.webcam_deviation
    assert off.max() < 4.0
    assert fit.misfit == pytest.approx(1.0, abs=0.1)
    assert fit.outliers == pytest.approx(outliers * fit.samples, abs=0.015 * fit.samples)


def test_two_webcams_of_other_lenses_rates_and_delays(tmp_path):
    front = before_camera(seen_from_anywhere(np.random.default_rng(1)))
    side = before_camera(seen_from_anywhere(np.random.default_rng(2)))
    side = replace(side, webcam=Webcam(640.0, (330.0, 235.0), -0.1, 0.02))
    models, cameras = (front, side), ("front", "side")
    parts = recorded(front), recorded(side, 40.0, rate_hz=25.0)
    columns = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("stamps_s", "joints_rad", "z")
    )
    camera = np.repeat([0, 1], [len(part) for part in parts])
    data = DataSet(*columns, camera, camera=camera, cameras=cameras, feature="points")
    with pytest.raises(TrainingError, match="of one camera: train with the method poe"):
        train(data, TrainingOptions("ridge"))

    save_data_set(tmp_path / "d.npz", data)
    data = load_data_set(tmp_path / "d.npz")
    save_model(tmp_path / "m.npz", train(data, TrainingOptions("poe")))
    joints = box_of(front)

    def judge(chosen):
        kind = Points(cameras=chosen)
        trained = load_model(tmp_path / "m.npz", None, KindConfig(feature="points", points=kind))
        assert (trained.kind, trained.cameras) == (kind, chosen)
        for name, rows in zip(chosen, kind.rows, strict=True):
            true = models[cameras.index(name)].jacobian(joints)
            by_chain = relative_error(trained.chain.jacobian(joints)[:, rows], true)
            by_networks = relative_error(trained.model.jacobian(joints)[:, rows], true)
            assert np.median(by_chain) < 0.003
            assert np.median(by_networks) < 0.01
        return trained

    trained = judge(cameras)
    assert trained.errors["front/focal_px"] == pytest.approx(560.0, rel=0.02)
    assert trained.errors["side/focal_px"] == pytest.approx(640.0, rel=0.02)
    assert trained.errors["side/samples"] < trained.errors["front/samples"]
    assert [note[:6] for note in trained.notes] == ["front:", "side: "]  # of the delays
    text = report(trained)
    assert "camera side:\nJacobian of the chain" in text
    for own, rows in zip(data.parts, trained.kind.rows, strict=True):
        z = trained.z_samples[:, rows]
        assert np.all((own.z.min(axis=0) <= z) & (z <= own.z.max(axis=0)))
    judge(("side",))
    judge(("side", "front"))
    for other, text in (("left",), "left"), (("front", "left"), "front, left"), (("",), "one with"):
        kind = KindConfig(feature="points", points=Points(cameras=other))
        words = f"cameras: front, side, expected .* cameras: {text}"
        with pytest.raises(FileError, match=words):
            load_model(tmp_path / "m.npz", None, kind)


def test_still_poses_will_do():
    model = before_camera(seen_from_anywhere(np.random.default_rng(1)), 4)
    joints = box_of(model, 28)
    z = model.position(joints) + NOISE_PX * np.random.default_rng(2).normal(size=(28, 8))
    k = np.arange(28.0)
    fit = fit_pixels(DataSet(k, joints, z, k, feature="points", still=True))
    others = box_of(model)
    assert np.abs(fit.chain.position(others) - model.position(others)).max() < 2.0
    assert fit.chain.webcam.focal_px == pytest.approx(LENS.focal_px, rel=0.05)


def test_what_tells_no_jacobian_is_refused_with_what_to_do():
    model = before_camera(seen_from_anywhere(np.random.default_rng(1)))
    data = recorded(model)
    elsewhere = data.joints_rad[np.random.default_rng(0).permutation(len(data))]
    for bad, words in (
        (recorded(model, 4.0), "at least 100 images.* collect longer"),
        (recorded(model, 6.0), "known to .* % only.* collect longer or in a wider box"),
        (replace(data, z=np.ones_like(data.z)), "do not move"),
        (replace(data, joints_rad=elsewhere), "no arm with these joints"),
    ):
        with pytest.raises(ChainFitError, match=words):
            fit_pixels(bad)
