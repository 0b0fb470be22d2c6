"""Does the controller keep its promises, whatever happens? A million ticks of everything.

python -m bench fuzz; FVS_BENCH_CYCLES is the number of ticks, FVS_BENCH_SEED the first seed.

Each rule of :class:`Machine` is one thing that happens in a judged world; Hypothesis draws their
order and numbers, on every core. The first broken promise ends the campaign: Hypothesis shrinks it
to the shortest script that breaks it, and prints that.
"""

from __future__ import annotations

import math
import os
import sys
import time
import traceback
import warnings
from collections import Counter
from unittest import mock

import hypothesis
import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    rule,
    run_state_machine_as_test,
)
from joblib import Parallel, delayed
from std_msgs.msg import Bool, Float64, Float64MultiArray, MultiArrayDimension
from tqdm import tqdm

from bench.fuzz_promises import JudgedWorld
from bench.fuzz_world import (
    BALL,
    FRESH_TICKS,
    HOME_BALL_M,
    JOINT_STATES,
    MAX_AGE,
    MOST_JOINTS,
    OBJECT,
    PLANTS,
    TICK_S,
)
from fvs_controller_node.base import ControlOutput
from fvs_controller_node.config import LAWS, PARAMETERS
from fvs_controller_node.reasons import Reason
from fvs_controller_node.relation import OBJECT_FRAME
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.interface import POSITION, VELOCITY
from fvs_ros.joints import UR_JOINT_NAMES
from fvs_ros.kinds.kind import FIXED, MOUNTS
from fvs_ros.limits import URDF_LIMITS

CHUNK_TICKS = 20_000
SETTINGS = hypothesis.settings(
    max_examples=20,
    stateful_step_count=15,
    database=None,
    deadline=None,
    phases=[hypothesis.Phase.generate],
    suppress_health_check=list(hypothesis.HealthCheck),
)
#: Shrinking takes minutes; a test cannot wait for it.
_SHRINKS = hypothesis.settings(SETTINGS, phases=[*SETTINGS.phases, hypothesis.Phase.shrink])

N_AXES = HOME_BALL_M.size
ODD = (
    *(math.nan, math.inf, -math.inf, 1e308, -1e300, 5e-324, -5e-324, 0.0, -0.0, 1e-300),
    *(1e9, 100.0, 100.00001, -100.0, math.pi, 1e-9),
)
#: What would take long otherwise, made quick.
IMPATIENT = {"resume_within_s": 0.5, "stall_time_s": 0.6}

TICKS = st.integers(0, 60)
OFTEN = st.sampled_from([True, True, True, False])
JOINT = st.integers(0, MOST_JOINTS - 1)
NUMBER = st.one_of(st.sampled_from(ODD), st.floats())
FRAME = st.sampled_from([CAMERA_FRAME] * 3 + ["", "base", "\0", " " + CAMERA_FRAME, "x" * 999])
#: Of a tick on the steady clock, s; of a stamp beside its clock, s.
STEADY_S = st.sampled_from([TICK_S] * 4 + [0.0, 1e-9, 0.002, 0.012, 0.03, 0.07, 0.3, 5.0, 1e6])
STAMP_S = st.sampled_from([TICK_S, 0.0, 0.05, -0.05, 0.5, -0.5, -5.0, 3600.0, -(2.0**31), 4e9])
WORDS = st.sampled_from(["unknown", "", "nan", "-1", "1e999", "0x10", "1_0", "\0", "9" * 5000])
NAMES = st.sampled_from([*UR_JOINT_NAMES, "gripper", "", "é", "a" * 99])


def vector(size, largest=1.0):
    """Draw numbers of either sign, up to some size."""
    return st.lists(st.floats(-largest, largest), min_size=size, max_size=size)


def odd_at(places):
    """Draw which numbers of a message become odd: index -> number."""
    return st.dictionaries(st.integers(0, places - 1), NUMBER, max_size=2)


def value_of(parameter):
    """Draw a value in the range of a parameter, of any magnitude."""
    if parameter.choices:
        return st.sampled_from(parameter.choices)
    if parameter.kind is bool:
        return st.booleans()
    low = -10.0 if parameter.minimum is None else parameter.minimum
    high = 1e3 if parameter.maximum is None else parameter.maximum
    if parameter.kind is int:
        return st.integers(int(low), int(min(high, low + 20)))
    number = st.one_of(st.floats(low, high), st.sampled_from((low, high)))
    if low >= 0.0:
        exponents = st.floats(math.log10(max(low, 1e-6 * high)), math.log10(high))
        number = st.one_of(number, exponents.map(lambda e: min(high, max(low, 10.0**e))))
    if not parameter.is_list:
        return number
    size = len(parameter.default) or MOST_JOINTS
    numbers = st.lists(number, min_size=size, max_size=size)
    if not parameter.default:  # of the joints
        return numbers | st.just([])
    return numbers | vector(size, 0.5).map(lambda by: np.add(parameter.default, by).tolist())


OF_JOINTS = vector(MOST_JOINTS, 0.6)
LIVE = st.sampled_from([parameter for parameter in PARAMETERS if parameter.live])
CHANGES = st.one_of(
    st.sampled_from([{name: value} for name, value in IMPATIENT.items()]),
    st.lists(LIVE.flatmap(lambda p: st.tuples(st.just(p.name), value_of(p))), max_size=3).map(dict),
    st.builds(lambda p, value: {p.name: value}, LIVE, st.sampled_from((*ODD, "nonsense"))),
)


class Machine(RuleBasedStateMachine, JudgedWorld):
    """A world and what happens in it; called by hand, the rules are a script."""

    def __init__(self):
        RuleBasedStateMachine.__init__(self)

    @initialize(
        law=st.sampled_from(sorted(LAWS)),
        autostart=st.sampled_from([False, False, False, True]),
        simulated_time=st.booleans(),
        epoch_s=st.sampled_from([1000.0, 0.0, 1.7e9, 2147483600.0]),
        joints=st.integers(4, MOST_JOINTS),
        jerk=st.sampled_from([0.0, 0.0, 60.0, 500.0]),
        interface=st.sampled_from([VELOCITY, VELOCITY, POSITION]),
        mount=st.sampled_from(MOUNTS),
        at_work=OFTEN,
    )
    def begin(
        self,
        law="proportional",
        autostart=False,
        at_work=False,
        jerk=0.0,
        interface=VELOCITY,
        mount=FIXED,
        **world,
    ):
        """Make the world, of the plainest law by default, at rest or at work."""
        parameters = {"law": law, "autostart": autostart, "max_joint_jerk_rad_s3": jerk}
        parameters |= {"command_interface": interface, "camera_mount": mount}
        JudgedWorld.__init__(self, parameters, **world)
        if at_work:
            self.work()

    def teardown(self):
        """End the node, unless something is wrong already: zeros, whatever comes after."""
        if sys.exc_info()[0] is None and hasattr(self, "node"):
            self.last = self.node._loop.supervisor.shutdown().velocity_rad_s
            self.end_session()
            self.bad.add("the end")
            self.run(3)

    def _of_joints(self, values):
        """As many of the values as the arm has joints."""
        return np.resize(values, self.joints.size)

    # ---- the operator -----------------------------------------------------------------------

    @rule(step_rad=OF_JOINTS, ticks=TICKS, mend=OFTEN)
    def work(self, step_rad=(0.3,), ticks=25, mend=True):
        """Do all that servoing needs, mend what is broken, and go where these joints lead."""
        if mend:
            self.robot(True, 100.0, 0)
            self.show(1.0)
            self.plant, self.estimate = "obeys", self.true
        self.run(FRESH_TICKS)
        self.send_target(self.ball() + self.true @ self._of_joints(step_rad))
        self.start()
        self.run(ticks)

    work_again = work  # twice as often as anything else: most of the time the arm should move

    @rule(
        ticks=TICKS,
        silent=st.just(()) | st.sets(st.sampled_from(list(MAX_AGE))),
        frozen=st.just(()) | st.sets(st.sampled_from((JOINT_STATES, BALL, OBJECT))),
        steady_s=STEADY_S,
        ros_s=st.one_of(st.none(), STAMP_S),
    )
    def wait(self, ticks, **how):
        """Let time pass, by any clocks, with inputs that fall silent or repeat their stamps."""
        self.run(ticks, **how)

    @rule(
        name=st.sampled_from(
            ["start", "stop", "set_current_as_target", "teach", "go_to_reference"]
        ),
        ticks=TICKS,
    )
    def call(self, name, ticks=0):
        """Call a service."""
        own = {"start": self.start, "stop": self.stop}
        own.get(name, lambda: self.node.call(f"~/{name}"))()
        self.run(ticks)

    @rule(target_m=st.lists(NUMBER, min_size=N_AXES, max_size=N_AXES), frame=FRAME)
    def odd_target(self, target_m, frame=CAMERA_FRAME):
        """Send any target, in any frame."""
        self.send_target(self.ball() if target_m is None else target_m, frame)
        self.run(3)

    @rule(step_m=vector(N_AXES, 0.02), count=st.integers(1, 40), every=st.integers(1, 9))
    def moving_target(self, step_m, count, every):
        """Send a target again and again on its way."""
        at_m = self.ball()
        for _ in range(count):
            at_m = at_m + step_m
            self.send_target(at_m)
            self.run(every)

    @rule(way_m=vector(N_AXES, 0.2), ticks=TICKS)
    def relate(self, way_m, ticks):
        """Put an object there, unless the ball is one, and send a target relative to it."""
        self.object_m = self.ball()
        self.run(FRESH_TICKS)
        own = self.on_arm
        self.send_target(-np.add(self.ball(), way_m) if own else way_m, OBJECT_FRAME)
        self.start()
        self.run(ticks)

    @rule(step_m=vector(N_AXES, 0.3), steps=st.integers(1, 100), seen=st.booleans())
    def carry(self, step_m, steps, seen=True):
        """Carry the object away, at once or steadily, in view or not."""
        if self.object_m is not None:
            for _ in range(steps):
                self.object_m = self.object_m + np.array(step_m) / steps
                self.run(1, silent=() if seen else [OBJECT])

    @rule(way_m=vector(N_AXES, 0.2), ticks=st.integers(0, 300))
    def grip(self, way_m, ticks):
        """Let the object ride on the tool, with a target relative to it."""
        self.relate(way_m, 0)
        for _ in range(ticks):
            ball_m = self.ball()
            self.run(1)
            self.object_m = self.object_m + self.ball() - ball_m

    def carry_hidden(self, step_m):
        """Carry the object away while it is hidden; once it is seen, a motion needs a start."""
        self.carry(step_m, 100, False)
        self.run(9)
        self.end_session()
        self.run(50)

    @rule(odd=odd_at(N_AXES), late_s=STAMP_S, frame=FRAME)
    def odd_object(self, odd, late_s=0.0, frame=CAMERA_FRAME):
        """Send an object's position with numbers, stamp or frame that are odd."""
        object_m = HOME_BALL_M.copy()
        object_m[list(odd)] = list(odd.values())
        self.send_object(object_m, self.ros_s - late_s, frame)

    @rule(changes=CHANGES, ticks=TICKS)
    def change(self, changes, ticks=0):
        """Change live parameters in mid-motion."""
        count = self.joints.size  # also of what is drawn for more joints
        ends = {*changes} & {*URDF_LIMITS}
        cut = {name: changes[name][:count] for name in ends if isinstance(changes[name], list)}
        self.set({**changes, **cut})
        self.run(ticks)

    @rule(room_rad=st.lists(st.floats(-0.05, 0.3), min_size=MOST_JOINTS, max_size=MOST_JOINTS))
    def close_in(self, room_rad):
        """Let the ends of the joints' ranges close in on where the arm is."""
        room_rad = self._of_joints(room_rad)
        low = self.joints - room_rad
        high = np.maximum(self.joints + room_rad, low + 0.002)
        self.change({"joint_min_rad": low.tolist(), "joint_max_rad": high.tolist()}, 10)

    @rule(joint=JOINT, side=st.sampled_from([-1, 1]), room_rad=st.floats(0.0, 0.3), ticks=TICKS)
    def to_the_limit(self, joint, side, room_rad, ticks):
        """Put the arm near an end of its range, with a target beyond."""
        joint %= self.joints.size
        ball_m = self.ball()
        end_rad = self.limits.upper_rad if side > 0 else self.limits.lower_rad
        near_rad = end_rad[joint] - side * room_rad
        if abs(near_rad - self.joints[joint]) > 1.5 * math.pi:
            return  # by about a turn, which is none of a driver that wraps
        self.joints[joint] = near_rad
        self._push(ball_m - self.ball())
        self.honest = False
        self.run(FRESH_TICKS)
        self.send_target(self.ball() + side * 0.5 * self.true[:, joint])
        self.start()
        self.run(ticks)

    # ---- robot, camera, estimator -----------------------------------------------------------

    @rule(running=OFTEN, percent=st.sampled_from([100.0] * 9 + [30.0, -1.0, *ODD]), ticks=TICKS)
    def robot(self, running=True, percent=100.0, ticks=5):
        """Let the robot's program stop or run, and turn its speed slider."""
        self.program_runs = running
        if math.isfinite(percent):
            self.scaling = percent
            self.bad.discard("speed_scaling")
        else:
            self.bad.add("speed_scaling")
        if not running or -math.inf < percent <= 0.0:
            self.end_session()
        self.node._on_program_running(Bool(data=running))
        self.node._on_speed_scaling(Float64(data=percent))
        self.run(ticks)

    @rule(plant=st.sampled_from(sorted(PLANTS)), ticks=TICKS)
    def arm(self, plant, ticks):
        """Let the drives answer in another way."""
        self.plant = plant
        self.run(ticks)

    @rule(joint=JOINT, step_rad=st.floats(-0.5, 0.5))
    def knock(self, joint, step_rad):
        """Let a joint jump."""
        self.joints[joint % self.joints.size] += step_rad
        self.honest = False
        self.new_image = True
        self.run(8)

    @rule(values=OF_JOINTS, own=st.booleans(), ticks=st.integers(1, 9))
    def other_commander(self, values, own=False, ticks=9):
        """Let another node command the arm, or one's own commands come back."""
        for _ in range(ticks):
            command = (self.last if own else self._of_joints(values)).tolist()
            if tuple(command) not in self.node._sent:
                self.end_session()
            self.node._on_any_command(Float64MultiArray(data=command))
            self.run(1)

    @rule(
        signs=st.sampled_from([(1, 1, 1), (-1, -1, -1), (1, -1, 1)]),
        scale=st.sampled_from([1.0, 1.0, 0.3, 8.0, 1e3]),
        smallest=st.sampled_from([None, 0.0, 0.02, 0.04, 0.06]),
        noise=st.one_of(st.just(0.0), vector(N_AXES * MOST_JOINTS)),
        ticks=TICKS,
    )
    def estimator(self, signs=1, scale=1.0, smallest=None, noise=0.0, ticks=20):
        """Let the estimator err: in sign, scale, smallest singular value, or anyhow."""
        true = self.true
        u, s, vt = np.linalg.svd(true, full_matrices=False)
        s[-1] = s[-1] if smallest is None else smallest
        erring = scale * (u * s) @ vt + np.resize(noise, true.shape)
        self.estimate = np.resize(signs, (N_AXES, 1)) * erring
        self.run(ticks)

    @rule(share=st.sampled_from([1.0, 0.0, -1.0, 0.1, 0.5, 2.0]), ticks=TICKS, steady_s=STEADY_S)
    def show(self, share, ticks=0, steady_s=TICK_S):
        """From where the ball is, let the camera show this share of its motion; 0: it is frozen."""
        ball_m, self.seen_share = self.ball(), share
        self._push(ball_m - self.ball())
        self.run(ticks, steady_s=steady_s)

    @rule(step_m=vector(N_AXES, 0.3), steps=st.integers(1, 100), steady_s=STEADY_S)
    def push(self, step_m, steps, steady_s=TICK_S):
        """Push the ball, or the camera, away: at once or steadily."""
        for _ in range(steps):
            self._push(np.array(step_m) / steps)
            self.run(1, steady_s=steady_s)

    @rule(size_m=st.floats(0.02, 0.12), ticks=st.integers(0, 600))
    def swing(self, size_m, ticks):
        """Let the ball swing, whatever the arm does."""
        for tick in range(ticks):
            by_m = size_m * (math.sin(0.1 * tick) - math.sin(0.1 * (tick - 1)))
            self._push(by_m * np.eye(N_AXES)[0])
            self.run(1, steady_s=0.01)

    def _push(self, step_m):
        self.push_m = self.push_m + step_m
        self.new_image = True  # the image shows more than the arm's motion

    # ---- messages and answers that should not be ---------------------------------------------

    @rule(
        names=st.one_of(st.permutations(range(MOST_JOINTS)), st.lists(NAMES, max_size=9)),
        odd=odd_at(9),
        more=st.integers(-1, 1),
        late_s=STAMP_S,
    )
    def odd_joints(self, names=range(MOST_JOINTS), odd=None, more=0, late_s=0.0):
        """Send joint states with names (or places), positions or stamps that are odd."""
        own = self.names
        names = [own[name] if isinstance(name, int) else name for name in names
                 if name not in range(len(own), MOST_JOINTS)]  # fmt: skip
        known = dict(zip(own, self.joints.tolist(), strict=True))
        positions = [known.get(name, 0.5) for name in (*names, "")][: len(names) + more]
        for index, value in (odd or {}).items():
            positions[index : index + 1] = [value] if index < len(positions) else []
        self.send_joints(positions, self.ros_s - late_s, names)

    @rule(odd=odd_at(N_AXES), late_s=STAMP_S, frame=FRAME)
    def odd_ball(self, odd, late_s=0.0, frame=CAMERA_FRAME):
        """Send a ball position with numbers, stamp or frame that are odd."""
        ball_m = self.ball().copy()
        ball_m[list(odd)] = list(odd.values())
        self.send_ball(ball_m, self.ros_s - late_s, frame)

    @rule(
        odd=odd_at(N_AXES * 4),
        size=st.sampled_from([None, None, 0, 1, 17, 18, 19, 36]),
        sizes=st.sampled_from([[], None, (6, 3), [18], [2**32 - 1] * 2]),
    )
    def odd_jacobian(self, odd, size, sizes):
        """Send a Jacobian with numbers or dimensions that are odd."""
        data, true = self.estimate.ravel().copy(), self.true
        data[list(odd)] = list(odd.values())
        size, sizes = true.size if size is None else size, true.shape if sizes is None else sizes
        message = Float64MultiArray(data=np.resize(data, size).tolist())
        message.layout.dim = [MultiArrayDimension(size=length) for length in sizes]
        self.send_jacobian(message)

    @rule(data=st.one_of(vector(8 * (MOST_JOINTS + 1), 3.0), st.lists(NUMBER, max_size=49)))
    def odd_chain(self, data):
        """Send any chain, or what is none."""
        self.send_chain(Float64MultiArray(data=data[: 8 * (self.joints.size + 1)]))

    @rule(key=WORDS, value=WORDS, message=WORDS)
    def odd_status(self, key, value, message):
        """Let the estimator say anything."""
        pairs = [KeyValue(key=key, value=value), KeyValue(key="state", value="WAITING")]
        self.node._on_estimator_status(DiagnosticStatus(values=pairs, message=message))

    @rule(
        velocity=st.lists(NUMBER, max_size=MOST_JOINTS), sliding=st.lists(NUMBER, max_size=N_AXES)
    )
    def mad_law(self, velocity=(), sliding=()):
        """Let the law answer anything, or fail."""
        answer = ControlOutput(np.array(velocity), np.array(sliding), np.ones(N_AXES))
        error = None if velocity else ZeroDivisionError("a law's own mistake")
        law = type(self.node._loop.law)
        with mock.patch.object(law, "command", side_effect=error, return_value=answer):
            self.run(3)


# ---- the campaign ---------------------------------------------------------------------------


def play(seed, ticks=CHUNK_TICKS, settings=SETTINGS):
    """Play at least some ticks; returns counts by name, and what broke a promise."""
    warnings.simplefilter("ignore")  # of numpy, about the numbers that are sent here
    counts = Counter()

    class Counted(Machine):
        def teardown(self):
            super().teardown()
            if hasattr(self, "node"):
                counts.update(self.reasons)
                counts.update(episodes=1, ticks=self.reasons.total(), moving=self.moving_ticks)

    while counts["ticks"] < ticks:
        try:
            run_state_machine_as_test(hypothesis.seed(seed)(Counted), settings=settings)
        except Exception:
            return counts, traceback.format_exc()
        seed += 1
    return counts, ""


def main():
    """Play on all cores, and print what was reached."""
    chunks = -(-int(os.environ.get("FVS_BENCH_CYCLES", "1000000")) // CHUNK_TICKS)
    first = int(os.environ.get("FVS_BENCH_SEED", "0"))
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    counts = Counter()
    begin_s = time.perf_counter()
    parallel = Parallel(n_jobs=-1, return_as="generator_unordered")
    seeds = range(1000 * first, 1000 * (first + chunks), 1000)
    campaign = parallel(delayed(play)(seed, settings=_SHRINKS) for seed in seeds)
    for played, broken in tqdm(campaign, "fuzz", chunks):
        counts.update(played)
        if broken:
            raise RuntimeError(f"a promise was broken\n{broken}")
    ticks = counts["ticks"]
    print(
        f"{ticks} ticks in {counts['episodes']} episodes, {time.perf_counter() - begin_s:.0f} s; "
        f"{counts['moving'] / ticks:.0%} of the commands are not zero"
    )
    for reason in sorted(Reason, key=lambda reason: -counts[reason.name]):
        print(f"  {reason.name:20s} {counts[reason.name]:9d} {counts[reason.name] / ticks:7.2%}")
    unreached = [reason.name for reason in Reason if not counts[reason.name]]
    print(f"reasons never reached: {', '.join(unreached) or 'none'}")
    print("every promise was kept")
