"""The whole controller without ROS: track, target, law and supervisor in one object.

The node passes messages in and sends the result of ``tick``; the laboratory uses the same object.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import inf, nan
from typing import Any

import numpy as np

from fvs_controller_node.agreement import Verdict
from fvs_controller_node.base import Change, ControlInput, ControlLaw, ControlOutput
from fvs_controller_node.config import ControllerConfig, SupervisorConfig, default_values, make_law
from fvs_controller_node.drive_lag import DriveLag, brake
from fvs_controller_node.eye import Eye
from fvs_controller_node.inbox import JACOBIAN, JOINT_STATES, OBJECT
from fvs_controller_node.monitors import LEAST_SEEN
from fvs_controller_node.reasons import Finding, Reason, State
from fvs_controller_node.references import Reference
from fvs_controller_node.relation import OBJECT_FRAME, Lens, Relation, Teacher
from fvs_controller_node.supervisor import Command, Present, Supervisor, checked
from fvs_controller_node.target_motion import TargetMotion, on_own_clock
from fvs_ros.filter import Image
from fvs_ros.following import LONGEST_LAG_S, Following
from fvs_ros.interface import POSITION, Backlash
from fvs_ros.limits import tick_s
from fvs_ros.pixel_chain import AnyChain, PixelChains
from fvs_ros.timeline import repeats
from fvs_ros.vectors import largest, length

#: Motion of a joint in which a measurement with noise changes, rad.
_MOVED_RAD = 1e-3
#: An object is not put elsewhere again within this time, s; a pose that flips would be.
_PUT_AGAIN_S = 2.0


class ServoLoop:
    """One pass per tick: joints, feature and Jacobian in; one command out.

    ``values`` are all of the node's parameters by name, by default the defaults. A ``ValueError``
    says which do not fit together.
    """

    law: ControlLaw

    def __init__(self, values: Mapping[str, Any] | None = None) -> None:
        values = default_values() if values is None else values
        self.supervisor = Supervisor(SupervisorConfig.from_values(values))
        self.kind = self.supervisor.config.kind
        self.eyes = [Eye(part) for part in self.kind.parts]  #: what each camera shows
        self._drive_lag, self._following = DriveLag(), Following()
        self._backlash, self._play_rad = Backlash(), np.zeros(1)
        self._lens = Lens(self.kind)
        self._relation = Relation(self.kind, self.supervisor.goal, self._lens)
        self._teacher = Teacher(self.kind, self._lens, [eye.last_second for eye in self.eyes])
        self._object_s: float | None = None  # stamp of the object's newest image
        self._drift, self._drift_run = TargetMotion(self.kind), -1  # of what moves by itself
        self._drift_m_s: np.ndarray | None = None  # its velocity now, (d,); None at rest
        self.configure(values)
        self._chain: AnyChain | None = None
        self._chain_s = -inf
        self._stamp_s = 0.0  # of the newest joint state
        self._newest: Image | None = None  # accepted
        self._put_s = -inf  # when the object was put elsewhere
        #: What is measured, and the joints when that was first so.
        self._stood: tuple[np.ndarray, np.ndarray | None] = np.zeros(0), None
        self._change = Change.TARGET  # since the last call of the law
        self._new_image = False  # likewise
        #: That of the law, m, (d,), at the first tick after an image; else None.
        self.sliding_variable: np.ndarray | None = None
        self._joints: np.ndarray | None = None
        self.measured_rad: np.ndarray | None = None  #: joints that count, (n,), as they came
        self.jacobian: np.ndarray | None = None  #: the one in use, m/rad, (d, n)
        self._home: np.ndarray | None = None  # joints at the last start

    def configure(self, values: Mapping[str, Any]) -> None:
        """Take over changed values while running; nothing changes if one is refused."""
        law = make_law(values)
        own = ControllerConfig.from_values(values)
        self.supervisor.configure(SupervisorConfig.from_values(values))
        self.law, self._feeds_forward = law, own.target_feed_forward
        self._rest_when_settled = own.rest_when_settled
        self._object_moves = self.supervisor.config.follows_object
        # What is learned is the lag of velocities; a position drive may take longer.
        self._least_lag_s = LONGEST_LAG_S if own.command_interface == POSITION else 0.0
        self._following.restart()  # a range may count for another length now

    # ---- inputs: arrival times on the steady clock --------------------------------------------

    def add_joints(self, now_s: float, stamp_s: float, joints_rad: np.ndarray) -> None:
        """Take a joint state: arrival and stamp, s; positions (n,), rad."""
        inputs = self.supervisor.inputs
        if self._joints is not None and repeats(stamp_s, self._stamp_s):
            inputs[JOINT_STATES].stuck(now_s)
            return
        if not inputs.add(JOINT_STATES, now_s, joints_rad):
            return
        # A held position must not be led away by joint states that do not count yet.
        if self.measured_rad is None or inputs[JOINT_STATES].find(now_s) is None:
            self.measured_rad = joints_rad
        velocity, joints = self.supervisor.velocity_rad_s, np.array(joints_rad, dtype=float)
        servoing = self.supervisor.last.state is State.SERVOING
        if servoing:
            unit = self.supervisor.config.unit
            most_s = max(self._drive_lag.most_s, self._least_lag_s)
            scaled = inputs.speed_scaling * velocity / unit
            self._following.add(now_s, stamp_s, scaled, joints / unit, most_s)
        else:
            self._following.restart()
        self._stamp_s = stamp_s
        compare = servoing and inputs.full_speed
        joints = self._backlash.joints(joints, self._play_rad)
        self._joints = self._drive_lag.add(stamp_s, velocity, joints, compare)
        if self._chain is not None:
            self.jacobian = self.kind.along(self._chain, self._joints)[1]
        for eye, rows in zip(self.eyes, self.kind.rows, strict=True):
            eye.judge()  # one joint state later: no tick has all of an image's work
            jacobian = None if self.jacobian is None else self.jacobian[rows]
            self._accept(eye, eye.track.add_joints(stamp_s, self._joints, jacobian))

    def bad_joints(self, why: str) -> None:
        """Take a joint state that cannot be used, and why."""
        for eye in self.eyes:
            eye.track.reset()  # after a jump: the feature did not move with it
            eye.restart()
        self.supervisor.inputs[JOINT_STATES].bad(why)

    def add_image(self, now_s: float, stamp_s: float, z: np.ndarray, camera: int = 0) -> None:
        """Take what a camera measured, (m,): its arrival and exposure, s."""
        eye, inputs = self.eyes[camera], self.supervisor.inputs
        name = inputs.features[camera]
        if repeats(stamp_s, eye.image_s):
            inputs[name].stuck(now_s)
            return
        eye.image_s = stamp_s
        if self._object_moves and self._is_frozen(z):
            inputs[name].stuck(now_s)
            return
        if inputs.add(name, now_s, z):
            self._accept(eye, eye.track.add_image(stamp_s - eye.late_s, z))

    def _is_frozen(self, z: np.ndarray) -> bool:
        """Whether the arm has moved, and what it measures stays the same to the last digit."""
        before, then = self._stood
        joints = self._joints
        if joints is None or then is None or not np.array_equal(z, before):
            self._stood = z, joints
            return False
        return largest(joints - then) > _MOVED_RAD

    def _accept(self, eye: Eye, images: list[Image]) -> None:
        if images:
            if self.kind.on_arm:
                self._look_for_another_place(images[0])
                self._newest = images[-1]
            # An image that stands may be that of a moving object.
            eye.add(images, judged=not self._object_moves)
            for image in images if self._object_moves else []:
                self._add_drift(image)
            self._new_image = True
            self._note(Change.MEASUREMENT)

    def _look_for_another_place(self, image: Image) -> None:
        """Begin anew where the object was put elsewhere: its jump is no fault of the arm.

        A frozen picture lags by at most the predicted motion, so only a jump of more than twice
        that counts as a moved object.
        """
        last = self._newest
        if last is None or image.run == last.run or image.stamp_s < self._put_s + _PUT_AGAIN_S:
            return
        moved_m = image.moved_m - last.moved_m
        if length(image.seen_m - last.seen_m - moved_m) > 2.0 * length(moved_m):
            self._put_s = image.stamp_s
            self.eyes[0].restart()
            self.supervisor.goal.progress.restart()

    def _add_drift(self, image: Image) -> None:
        """Take the part of the path that the joints do not explain."""
        if image.run != self._drift_run:
            self._drift.forget()
        self._drift_run = image.run
        age_s = self._stamp_s - image.stamp_s
        self._drift.add_path(image.seen_m - image.moved_m, image.stamp_s, age_s)

    def add_object(self, now_s: float, stamp_s: float, z: np.ndarray) -> None:
        """Take an object's measurement in the camera's frame, (m,): arrival and exposure, s."""
        monitor = self.supervisor.inputs[OBJECT]
        if repeats(stamp_s, self._object_s):
            monitor.stuck(now_s)
            return
        self._object_s = stamp_s
        was_hidden = monitor.late(now_s)
        if not self.supervisor.inputs.add(OBJECT, now_s, z):
            return
        self._teacher.object.add(stamp_s, z)
        there_s = on_own_clock(stamp_s, self._stamp_s)
        target = self._relation.add_image(z, there_s, was_hidden)
        if self._relation.moved_m:
            moved = self.kind.length_text(self._relation.moved_m)
            self.supervisor.end(Reason.OBJECT_MOVED.because(moved=moved))
        if target is not None:
            frame, goal = self.supervisor.config.feature_frame, self.supervisor.goal
            accepted, why = self._set_target(target, frame, there_s, self._stamp_s - there_s)
            if not accepted:
                monitor.bad(why)
            hidden_s = self.supervisor.config.object_may_be_hidden_s
            monitor.spare_s = hidden_s if goal.rests else 0.0
            self._end_a_ride()

    def _end_a_ride(self) -> None:
        """End the session where the object moves with the tool, which never gets there."""
        goal = self.supervisor.goal
        servoing = self.supervisor.last.state is State.SERVOING
        if not servoing or goal.z is None or goal.error_m is None:
            self._relation.lead = None
        elif self._relation.rides(goal.z, goal.error_m, self.supervisor.config.stall_error_m):
            left = self.kind.error_text(goal.error_m)
            self.supervisor.end(Reason.OBJECT_RIDES.because(left=left))

    def add_jacobian(self, now_s: float, jacobian: np.ndarray) -> None:
        """Take the Jacobian, (d, n), m/rad, and its arrival; while a chain comes, it gives it."""
        inputs, max_age_s = self.supervisor.inputs, self.supervisor.config.jacobian_max_age_s
        if inputs.add(JACOBIAN, now_s, jacobian) and now_s - self._chain_s > max_age_s:
            self._chain = None
            for eye in self.eyes:
                eye.late_s = 0.0
            self.jacobian = self.kind.possible(np.array(jacobian, dtype=float))

    def add_chain(self, now_s: float, chain: AnyChain) -> None:
        """Take the arm as the camera sees it now, and its arrival; it gives the Jacobian.

        The Jacobian that comes with it counts as the message.
        """
        self._chain, self._chain_s, self._lens.error = chain, now_s, chain.lens
        if isinstance(chain, PixelChains):
            for eye, of_eye in zip(self.eyes, chain.each, strict=True):
                eye.late_s = of_eye.webcam.late_s
        self._play_rad = chain.play_rad

    # ---- the target ---------------------------------------------------------------------------

    def add_target(
        self, z: np.ndarray, frame: str, stamp_s: float = 0.0, camera: int | None = None
    ) -> tuple[bool, str]:
        """Take a target, (m,), or a camera's part of one; one that is updated often moves.

        A part replaces that of the present target; without one, each camera has to give its own
        first. In the frame ``object`` it is relative to the object. A stamp (s; 0 for now) says
        when it was there, on the clock of the joint states. The answer is the supervisor's: see
        :meth:`~fvs_controller_node.goal.Goal.set`; without a text while parts are awaited.
        """
        there_s, only = on_own_clock(stamp_s, self._stamp_s), None
        if frame == OBJECT_FRAME and self.kind.on_arm:
            z = self._lens.measured(self.kind.inverse(z))
            frame = self.supervisor.config.feature_frame
        elif frame == OBJECT_FRAME and len(self.eyes) > 1:
            return False, "target refused: one relative to an object is of a single camera"
        elif frame == OBJECT_FRAME:
            return self._set_relation(z)
        elif camera is not None:
            part, goal = self.kind.parts[camera], self.supervisor.goal
            why = part.unseen(z)
            if why:
                return False, f"target refused: {part.topics.target.name}: {why}"
            only = camera if goal.target is not None else None
            whole = goal.whole(z, camera)
            if whole is None:
                return True, ""
            z = whole
        accepted, text = self._set_target(z, frame, there_s, self._stamp_s - there_s, only)
        if accepted:
            self._be_relative_to_object(None)
        return accepted, text

    def _set_relation(self, wanted: np.ndarray) -> tuple[bool, str]:
        goal, frame = self.supervisor.goal, self.supervisor.config.feature_frame
        target = self._relation.target(wanted)
        if target is not None:
            accepted, text = self._set_target(target, frame)
            if not accepted:
                return accepted, text
        else:
            goal.forget()
        self._be_relative_to_object(wanted)
        return True, f"target set to {self.kind.text(wanted)} from the object"

    def _be_relative_to_object(self, wanted: np.ndarray | None) -> None:
        self._relation.wanted = wanted
        monitor = self.supervisor.inputs[OBJECT]
        monitor.needed, monitor.spare_s = wanted is not None, 0.0
        if self._teacher.object.rests:  # until the next image, should one come
            monitor.spare_s = self.supervisor.config.object_may_be_hidden_s
        self.supervisor.goal.speed, self.supervisor.goal.reference = 1.0, ""

    def teach(self, now_s: float) -> Reference:
        """Where the tool is at rest; a ``ValueError`` says why that is not known well."""
        inputs = self.supervisor.inputs
        late = inputs.late(now_s)
        if late:
            raise ValueError(late)
        monitor, config = inputs[OBJECT], self.supervisor.config
        age_s, may_be_s = monitor.age_s(now_s), config.object_may_be_hidden_s
        relative = age_s <= max(may_be_s, config.resume_within_s)  # else there is no object
        if relative and age_s > may_be_s and monitor.late(now_s):
            raise ValueError(f"{monitor.name} is {age_s:.1f} s old; is the object in view?")
        z, deviation_m = self._teacher.teach(relative)
        of_object = relative or self.kind.on_arm
        if self.kind.on_arm:
            why = config.out_of_view(self.kind, self._lens.measured(self.kind.inverse(z)))
            if why:  # it would be refused as a target
                raise ValueError(f"the {self.kind.what} is {why}")
        frame = OBJECT_FRAME if of_object else config.feature_frame
        return Reference(z, frame, deviation_m=deviation_m)

    def go_to(self, reference: Reference, name: str = "") -> tuple[bool, str]:
        """Make a taught reference the target, at its speed; its name is said on the status."""
        accepted, text = self.add_target(reference.z, reference.frame)
        if accepted:
            self.supervisor.goal.speed, self.supervisor.goal.reference = reference.speed, name
            self.supervisor.goal.progress.restart()  # it is settled anew, however near
        return accepted, text

    def set_current_as_target(self, now_s: float) -> tuple[bool, str]:
        """Make the feature's present value the target, if it is known now."""
        late = self.supervisor.inputs.late(now_s)
        if late:
            return False, f"target refused: {late}"
        z = self.feature
        if z is None:
            return False, f"target refused: the {self.kind.what}'s position is not known yet"
        self._be_relative_to_object(None)
        return self._set_target(z, self.supervisor.config.feature_frame)

    @property
    def feature(self) -> np.ndarray | None:
        """The feature at the newest joint state, (m,); None while it is not known."""
        shown = [z for eye in self.eyes if (z := eye.track.now()) is not None]
        return np.concatenate(shown) if len(shown) == len(self.eyes) else None

    def _set_target(self, *target: Any) -> tuple[bool, str]:
        goal = self.supervisor.goal
        before = goal.target
        accepted, text = goal.set(*target)
        if accepted:
            other = before is None or (before != target[0]).any()
            if self._may_rest and other and not goal.moving:
                goal.progress.restart()  # it rests at this one only, however near
            self._note(Change.MEASUREMENT if goal.moving and self._feeds_forward else Change.TARGET)
        return accepted, text

    @property
    def _may_rest(self) -> bool:
        return self._rest_when_settled or bool(self._play_rad.any())

    def _note(self, change: Change) -> None:
        if self._change is not Change.TARGET:
            self._change = change

    # ---- the tick -----------------------------------------------------------------------------

    def tick(self, now_s: float, dt_s: float) -> Command:
        """Decide on the command for this tick.

        ``now_s`` is the steady clock, ``dt_s`` what the tick counts for: the time until the next.
        """
        dt_s, self.sliding_variable = tick_s(dt_s), None
        present = self._present(now_s)
        finding, output = self.supervisor.permit(now_s, dt_s, present), None
        if finding is None:
            finding, output = self._ask(present, dt_s)
        command = self.supervisor.release(now_s, dt_s, finding, output)
        if command.state is not State.SERVOING:
            self.law.reset()
        if not self.supervisor.started:
            self._home = None
        return command

    def _present(self, now_s: float) -> Present:
        """What is known at this tick."""
        if self._feeds_forward:
            self.supervisor.goal.move_on(self._stamp_s)
        if self._home is None:  # motion before this start must not count
            for eye in self.eyes:
                eye.agreement.restart()
        drift_m, self._drift_m_s = None, None
        if self._object_moves:
            _, drift_m, self._drift_m_s = self._drift.at(self._stamp_s)
        if self._drift_m_s is None or not self._drift_m_s.any():
            drift_m = self._drift_m_s = None
        z = self._look(now_s, drift_m)
        problems = (eye.track.problem for eye in self.eyes)
        return Present(
            joints_rad=self._joints,
            z=z,
            jacobian=self._counted,
            pending_rad=self._drive_lag.pending_rad,
            freedom=min(self.kind.freedom, len(self._seeing) * self.kind.parts[0].size),
            drift_m_s=self._drift_m_s,
            problem="" if z is not None else next(filter(None, problems), ""),
            verdict=self._verdict,
            not_following=self._following.fault,
        )

    @property
    def _counted(self) -> np.ndarray | None:
        """The Jacobian, (d, n), without what a camera that is lost would see."""
        lost = self.supervisor.inputs.lost
        if self.jacobian is None or not lost:
            return self.jacobian
        counted = self.jacobian.copy()
        for i in lost:
            counted[self.kind.rows[i]] = 0.0
        return counted

    @property
    def _seeing(self) -> list[Eye]:
        """The cameras that are not lost."""
        return [eye for i, eye in enumerate(self.eyes) if i not in self.supervisor.inputs.lost]

    @property
    def _verdict(self) -> Verdict | None:
        """The worst of the cameras that see; None while too little moved."""
        verdicts = [
            eye.agreement.verdict._replace(camera=eye.track.kind.cameras[0])
            for eye in self._seeing
            if eye.agreement.verdict is not None
        ]
        follows = [(each.seen_share >= LEAST_SEEN, -each.error_ratio, each) for each in verdicts]
        return min(follows)[-1] if follows else None

    def _look(self, now_s: float, drift_m: np.ndarray | None) -> np.ndarray | None:
        """Find which cameras are lost, and the feature now, (m,); None if it is unknown.

        In a session, one that is silent or cannot be paired is lost while another sees: it counts
        as if it showed what is wanted. To start, all must see.
        """
        shown = [eye.track.now(drift_m) for eye in self.eyes]
        inputs, goal = self.supervisor.inputs, self.supervisor.goal
        target = goal.target
        lost = {
            i: self.eyes[i].track.problem
            for i, z in enumerate(shown)
            if inputs.may_leave(i, now_s, shows=z is not None)
        }
        if not self.supervisor.started or target is None or len(lost) == len(shown):
            lost = {}
        if lost.keys() != inputs.lost.keys():
            goal.progress.restart()  # the error is another one
            self._note(Change.TARGET)
        inputs.lost = lost
        for i in lost:
            assert target is not None
            shown[i] = target[self.kind.rows[i]]
        known = [z for z in shown if z is not None]
        return np.concatenate(known) if len(known) == len(shown) else None

    def _ask(self, present: Present, dt_s: float) -> tuple[Finding | None, ControlOutput | None]:
        """The law's output, or what is wrong with it."""
        last = self.supervisor.velocity_rad_s
        if dt_s <= 0.0:  # it repeats the last command
            return None, ControlOutput.plain(last, self.kind.size)
        if self._rests:
            return None, ControlOutput.plain(np.zeros_like(last), self.kind.size)
        finding, output = None, None
        try:
            output = checked(self._propose(present, last, dt_s), len(last), self.kind.size)
        except Exception as error:  # whatever a law does wrong
            finding = Reason.LAW_FAULT.because(why=f"{type(error).__name__}: {error}")
        doubted = any(eye.track.filter.outliers for eye in self._seeing)
        if output is not None and doubted:  # no joint speeds up or turns back
            wanted = np.clip(output.velocity_rad_s, np.minimum(last, 0.0), np.maximum(last, 0.0))
            output = output._replace(velocity_rad_s=wanted)
        if output is not None and self._new_image:
            self.sliding_variable = output.sliding_variable
        self._change, self._new_image = Change.NOTHING, False
        return finding, output

    @property
    def _rests(self) -> bool:
        """Whether it has arrived where motors would only hunt in the play of their joints."""
        goal = self.supervisor.goal
        moving = any(v is not None and v.any() for v in (goal.velocity_m_s, self._drift_m_s))
        return self._may_rest and goal.progress.settled and not moving

    def _propose(self, present: Present, applied: np.ndarray, dt_s: float) -> ControlOutput:
        """Ask the law, with arm and target predicted to when its command takes effect."""
        joints, goal = present.joints_rad, self.supervisor.goal
        error_m = goal.error_m
        assert present.jacobian is not None
        assert joints is not None
        assert error_m is not None
        jacobian = self.kind.of_task(present.z, present.jacobian)
        if self._home is None:
            self._home = joints
        chain = self._chain
        lost = self.supervisor.inputs.lost
        if lost and isinstance(chain, PixelChains):
            chain = replace(chain, blind=tuple(lost))
        error_m = error_m + jacobian.dot(present.pending_rad)
        feed_forward = None
        velocity_m_s = goal.velocity_m_s
        if self._drift_m_s is not None:  # as if the target moved the other way
            velocity_m_s = (0.0 if velocity_m_s is None else velocity_m_s) - self._drift_m_s
        if self._feeds_forward and velocity_m_s is not None and velocity_m_s.any():
            error_m = error_m - self._drive_lag.lag_s * self.kind.of_task(present.z, velocity_m_s)
            feed_forward = self.law.inverse.joint_velocity(
                jacobian, velocity_m_s, joints, self._home
            )
            applied = applied - feed_forward
        state = ControlInput(
            error_m=error_m,
            jacobian=jacobian,
            applied_rad_s=applied,
            joints_rad=joints + present.pending_rad,
            dt_s=dt_s,
            home_rad=self._home,
            chain=chain,
            change=self._change,
            feed_forward_rad_s=feed_forward,
            kind=self.kind,
        )
        output = self.law.command(state)
        if not self.law.plans:
            output = brake(output, state, self.supervisor.config)
        if feed_forward is not None:
            output = output._replace(velocity_rad_s=output.velocity_rad_s + feed_forward)
        return output

    def status_values(self, now_s: float) -> dict[str, float | str]:
        """Return the supervisor's key numbers, and the images' latency."""
        tracks = [eye.track for eye in self.eyes]
        latencies_s = [nan if track.latency_s is None else track.latency_s for track in tracks]
        return {
            **self.supervisor.status_values(now_s),
            "image_latency_s": max(latencies_s),
            "position_noise_m": max(track.filter.noise_m for track in tracks),
            "position_deviation_m": max(track.filter.deviation_m for track in tracks),
            "drive_lag_s": self._drive_lag.lag_s,
        }
