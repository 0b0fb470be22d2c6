"""The demo's task and its scores: a sequence of targets, scored by where ball or tag truly is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fvs_ros.kinds import Kind, KindConfig
from fvs_ros.params import parameter
from fvs_tools.score import FINE_ERROR_M, SETTLED_ERROR_M, TargetScore, judge


@dataclass(frozen=True)
class DemoConfig(KindConfig):
    """Parameters of ``fvs_demo_node``."""

    model_path: str = parameter(
        "",
        "trained model; targets are positions from its training data; empty: that of the simulated "
        "UR5",
    )
    tf_prefix: str = parameter("", "prefix of the joint names, like a UR driver's")
    targets: int = parameter(4, "number of targets", 1, 100)
    seed: int = parameter(0, "seed of the choice of targets", 0)
    distance_m: float = parameter(0.3, "wanted distance from one target to the next", 0.05, 1.0)
    target_s: float = parameter(4.0, "time given to each target", 1.0, 60.0)
    relative: bool = parameter(
        False,
        "teach where the tool, or the camera on the arm, is, seen from the object; then the object "
        "jumps, not the target",
    )
    output_dir: str = parameter("out/demo", "folder for the results and the figure")


PARAMETERS = DemoConfig.declared()

#: Longest wait for the loop to be ready once the controller runs, s of real and of loop time.
START_TIMEOUT_S = 30.0
#: Farthest jump of an object along and across the table and up, m, and about its vertical, rad;
#: share of it that stays in view of a camera on the arm.
_JUMP_M, _JUMP_RAD, _IN_VIEW = np.array([0.12, 0.12, 0.05]), np.radians(30.0), 0.4
#: Okabe and Ito's, told apart by all readers.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")
#: The simulator's parameters of the object's place.
OBJECT = ("object_position_m", "object_rotation_deg")


def jump_of_object(
    home: dict[str, Sequence[float]], kind: Kind, rng: np.random.Generator
) -> dict[str, list[float]]:
    """Parameters of the simulator that put its object somewhere else, near those at ``home``."""
    share = _IN_VIEW if kind.on_arm else 1.0
    position_m, rotation_deg = (np.array(home[name]) for name in OBJECT)
    position_m += rng.uniform(-share * _JUMP_M, share * _JUMP_M)
    angle_rad = rng.uniform(-share * _JUMP_RAD, share * _JUMP_RAD)
    about_vertical = Rotation.from_rotvec([0.0, 0.0, angle_rad])
    rotation = about_vertical * Rotation.from_rotvec(rotation_deg, degrees=True)
    places = position_m.tolist(), rotation.as_rotvec(degrees=True).tolist()
    return dict(zip(OBJECT, places, strict=True))


@dataclass
class TargetRecord:
    """Record of the motion to one target, camera frame, shape (m,), since it was given."""

    kind: Kind
    target: np.ndarray
    start_s: float
    note: str = ""  #: behind its row of the table
    #: Moments, s, and true features.
    truths: list[tuple[float, np.ndarray]] = field(default_factory=list)
    #: Moments, s, and joint velocities, rad/s.
    joints: list[tuple[float, np.ndarray]] = field(default_factory=list)

    def errors_m(self) -> tuple[np.ndarray, np.ndarray]:
        """Moments, s, (n,), and errors, m, (n, d)."""
        times_s, features = zip(*self.truths, strict=True)
        return np.array(times_s), np.array([self.kind.error(z, self.target) for z in features])

    def score(self) -> TargetScore:
        """Score it by the truth."""
        velocities = np.array([velocity for _, velocity in self.joints])
        return judge(self.kind, *self.errors_m(), velocities)


def table(records: Sequence[TargetRecord]) -> str:
    """The scores as text, the verdict first."""

    def seconds(value: float | None) -> str:
        return "never" if value is None else f"{value:.2f} s"

    kind = records[0].kind
    bounds = (f"to {kind.length_text(m)}" for m in (SETTLED_ERROR_M, FINE_ERROR_M))
    rows = [("target", "start", *bounds, "final rms", "peak joint speed", "")]
    for number, record in enumerate(records, start=1):
        score = record.score()
        start, final = kind.length_text(score.start_distance_m), score.final(kind)
        settled = seconds(score.settling_5mm_s), seconds(score.settling_2mm_s)
        speed = f"{score.peak_joint_speed_rad_s:.2f} rad/s"
        rows.append((str(number), start, *settled, final, speed, record.note))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(map(str.rjust, row, widths)).rstrip() for row in rows)
    return "\n".join([verdict(records), *lines])


def write_results(folder: Path, records: Sequence[TargetRecord]) -> None:
    """Write ``results.json``."""
    content = [{"target_m": each.target.tolist(), **asdict(each.score())} for each in records]
    (folder / "results.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def verdict(records: Sequence[TargetRecord]) -> str:
    """How many targets settled."""
    settled = sum(record.score().settling_5mm_s is not None for record in records)
    return f"{settled} of {len(records)} targets settled"


def draw(path: Path, records: Sequence[TargetRecord], joint_names: Sequence[str]) -> None:
    """Draw true errors and joint speeds over time into a PNG file, the verdict above them."""
    from cycler import cycler
    from matplotlib.figure import Figure

    kind, origin_s = records[0].kind, records[0].start_s
    unit, unit_m = ("mm", 1e-3) if kind.rigid else ("px", float(kind.unit[0]))
    panels = {"way_m": (unit, unit_m)}
    if "arc_m" in kind.parts_m(records[0].errors_m()[1]):
        panels["arc_m"] = ("degrees", float(np.radians(kind.unit[-1])))
    moments = [(r.start_s - origin_s + t_s, speeds) for r in records for t_s, speeds in r.joints]
    count = len(panels) + bool(moments)
    figure = Figure(figsize=(10.0, 2.6 * count + 0.6), layout="constrained")
    figure.suptitle(f"{verdict(records)}: {kind.what} to target")
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    for axis, (part, (unit, unit_m)) in zip(axes, panels.items(), strict=False):
        for record in records:
            time_s, errors_m = record.errors_m()
            time_s = time_s + record.start_s - origin_s
            # A logarithmic axis has no zero.
            lengths_m = np.maximum(kind.parts_m(errors_m)[part], 1e-6)
            axis.plot(time_s, lengths_m / unit_m, ".-", color=COLOURS[0], markersize=1.5)
        bound = SETTLED_ERROR_M / unit_m
        look: dict[str, Any] = {"linestyle": "--", "linewidth": 1, "color": "0.4"}
        axis.axhline(bound, label=f"settled: {bound:.2g} {unit}", **look)
        axis.set(yscale="log", ylabel=f"error ({unit})")
        axis.yaxis.set_major_formatter("{x:g}")
    if moments:
        axes[-1].set_prop_cycle(cycler(linestyle=("-", "--", ":")) * cycler(color=COLOURS))
        axes[-1].plot(*zip(*moments, strict=True), linewidth=1.2, label=list(joint_names))
        axes[-1].set(ylabel="joint speed (rad/s)")
    for number in range(0, len(records), 1 + len(records) // 16):  # more labels would overlap
        start_s, settled_s = records[number].start_s, records[number].score().settling_5mm_s
        words = "not settled" if settled_s is None else f"{settled_s:.2f} s"
        text = f"{number + 1}: {words}" if len(records) <= 8 else f"{number + 1}"
        top = axes[0].get_xaxis_transform()
        axes[0].text(start_s - origin_s, 1.03, text, fontsize=9, transform=top)
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.set(xlabel="time (s)")
        axis.tick_params(labelbottom=True)
        for record in records:
            axis.axvline(record.start_s - origin_s, color="0.7", linewidth=1, zorder=0)
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=9, frameon=False)
    figure.savefig(path, dpi=110)
