"""The demo's task and its scores: a sequence of targets, scored by where ball or tag truly is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fvs_ros.camera import Intrinsics
from fvs_ros.kinds import Kind, KindConfig
from fvs_ros.params import parameter
from fvs_tools.score import FINE_ERROR_M, SETTLED_ERROR_M, TargetScore, judge, largest_part_m


@dataclass(frozen=True)
class DemoConfig(KindConfig):
    """Parameters of ``fvs_demo_node``."""

    model_path: str = parameter(
        "",
        "trained model; targets are positions from its training data; empty: that of the simulated "
        "UR5",
    )
    targets: int = parameter(4, "number of targets", 1, 100)
    target_positions: str = parameter(
        "",
        "targets: 'x y z; x y z; ...', m, of a pose with its quaternion 'x y z qx qy qz qw; ...'; "
        "empty: chosen by the seed",
    )
    seed: int = parameter(0, "seed of the choice of targets", 0)
    distance_m: float = parameter(0.3, "wanted distance from one target to the next", 0.05, 1.0)
    target_s: float = parameter(4.0, "time given to each target", 1.0, 60.0)
    output_dir: str = parameter("out/demo", "folder for the results and the figure")


PARAMETERS = DemoConfig.declared()

#: Candidates within this of the wanted distance are equally good; otherwise the nearest is taken.
_DISTANCE_TOLERANCE_M = 0.02
#: Length of a drawn axis, m.
_AXIS_M = 0.06
#: Longest wait for the loop to be ready, s: all nodes may start on a busy machine.
START_TIMEOUT_S = 30.0


def choose_target(
    kind: Kind,
    candidates: np.ndarray,
    z: np.ndarray,
    distance_m: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """A target about ``distance_m`` from where the feature is, (m,), camera frame.

    It is one of the candidates, shape (n, m): where the feature has been.
    """
    apart_m = np.linalg.norm((candidates - z) * kind.weights, axis=1)
    mismatch_m = np.abs(apart_m - distance_m)
    fitting = np.flatnonzero(mismatch_m <= max(_DISTANCE_TOLERANCE_M, mismatch_m.min()))
    return candidates[rng.choice(fitting)]


def given_targets(text: str, kind: Kind) -> list[np.ndarray]:
    """The targets of ``target_positions``, (m,) each; a ``ValueError`` if they are none."""
    targets = []
    for part in filter(str.strip, text.split(";")):
        try:
            numbers = np.array(part.split(), dtype=float)
            if not np.isfinite(numbers).all():
                raise ValueError("expected finite numbers")
            targets.append(kind.parse(numbers))
        except ValueError as error:
            raise ValueError(f"target_positions: {part!r}: {error}") from error
    return targets


@dataclass
class TargetRecord:
    """Record of the motion to one target, camera frame, shape (m,), since it was given."""

    kind: Kind
    target: np.ndarray
    start_s: float
    #: Whether late inputs held the arm.
    slowed: bool = False
    #: Moments, s, and true features.
    seen: list[tuple[float, np.ndarray]] = field(default_factory=list)
    #: Moments, s, and joint velocities, rad/s.
    joints: list[tuple[float, np.ndarray]] = field(default_factory=list)

    def errors_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Moments, s, (n,), and errors, m, (n, d)."""
        times_s, features = zip(*self.seen, strict=True)
        return np.array(times_s), np.array([self.kind.minus(z, self.target) for z in features])


def score(record: TargetRecord) -> TargetScore:
    """Score one target by the truth."""
    velocities = np.array([velocity for _, velocity in record.joints])
    return judge(record.kind, *record.errors_m(), velocities)


def table(scores: Sequence[TargetScore], notes: Sequence[str]) -> str:
    """The scores as text, with a note behind each."""

    def seconds(value: float | None) -> str:
        return "never" if value is None else f"{value:.2f} s"

    width = max([9, *(len(one.final) for one in scores)])
    head = (
        f"{'target':>6}  {'start':>8}  {f'to {SETTLED_ERROR_M * 1e3:g} mm':>9}  "
        f"{f'to {FINE_ERROR_M * 1e3:g} mm':>9}  {'final rms':>{width}}  {'peak joint speed':>16}"
    )
    rows = [
        f"{number:>6}  {s.start_distance_m * 1e3:>5.0f} mm  {seconds(s.settling_5mm_s):>9}  "
        f"{seconds(s.settling_2mm_s):>9}  {s.final:>{width}}  "
        f"{s.peak_joint_speed_rad_s:>10.2f} rad/s" + (f"  {note}" if note else "")
        for number, (s, note) in enumerate(zip(scores, notes, strict=True), start=1)
    ]
    return "\n".join([head, *rows])


def write_results(folder: Path, records: list[TargetRecord], scores: list[TargetScore]) -> None:
    """Write ``results.json``."""
    folder.mkdir(parents=True, exist_ok=True)
    content = [
        {"target_m": record.target.tolist(), **asdict(one)}
        for record, one in zip(records, scores, strict=True)
    ]
    (folder / "results.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def draw(
    path: Path,
    records: list[TargetRecord],
    joint_names: Sequence[str],
    image_rgb: np.ndarray | None,
    intrinsics: Intrinsics | None,
) -> None:
    """Draw the run into a PNG file: error and joint speeds over time, camera view with the trail.

    The view is the one at the end, shape (height, width, 3), if it came.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplot_mosaic(
        [["error", "view"], ["speed", "view"]],
        figsize=(13, 6.2),
        width_ratios=[1.0, 1.15],
        layout="constrained",
    )
    colours = plt.get_cmap("viridis")(np.linspace(0.05, 0.85, len(records)))
    origin_s = records[0].start_s
    view = axes["view"]
    view.axis("off")
    if image_rgb is not None:
        view.imshow(image_rgb)
    for number, (record, colour) in enumerate(zip(records, colours, strict=True), start=1):
        time_s, errors_m = record.errors_m()
        larger_mm = 1e3 * largest_part_m(record.kind, errors_m)
        axes["error"].semilogy(time_s, larger_mm, color=colour, label=f"target {number}")
        axes["speed"].axvline(record.start_s - origin_s, color=colour, linewidth=1.5, alpha=0.7)
        if intrinsics is not None:
            trail_m = np.array([feature_m[:3] for _, feature_m in record.seen])
            view.plot(*intrinsics.project(trail_m).T, color=colour)
            at = intrinsics.project(record.target[:3])
            _draw_axes(view, intrinsics, record.kind, record.target)
            view.plot(*at, "+", color="white", markersize=15, markeredgewidth=4)
            view.plot(*at, "+", color=colour, markersize=14, markeredgewidth=2)
            view.set(xlim=(0, intrinsics.width), ylim=(intrinsics.height, 0))
    axes["error"].axhline(SETTLED_ERROR_M * 1e3, color="0.4", linestyle="--", linewidth=1)
    moments = [(r.start_s - origin_s + t_s, speeds) for r in records for t_s, speeds in r.joints]
    axes["speed"].plot(*zip(*moments, strict=True), linewidth=1, label=list(joint_names))
    what = records[0].kind.what
    axes["error"].set(
        ylabel="true error (mm)", title=f"{what.capitalize()} to its target, largest part"
    )
    axes["speed"].set(xlabel="time (s)", ylabel="joint speed (rad/s)", title="Joint speeds")
    view.set_title(f"Camera view at the end, trail of the {what}, targets (+)")
    for name in ("error", "speed"):
        axes[name].legend(fontsize=8, ncols=2)
        axes[name].grid(alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_axes(view: Any, intrinsics: Intrinsics, kind: Kind, z: np.ndarray) -> None:
    """Draw the directions of a feature: x red, y green, z blue."""
    for axis, colour in zip(kind.directions(z), ("tab:red", "tab:green", "tab:blue"), strict=False):
        tip_m = z[:3] + _AXIS_M * axis / np.linalg.norm(axis)
        view.plot(*intrinsics.project(np.stack([z[:3], tip_m])).T, color=colour, linewidth=2)
