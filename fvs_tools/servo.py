"""Estimator and controller of one arm in one object, without ROS: measurements in, commands out.

It has no clock: whoever owns the robot passes stamps, s, of one clock that goes on steadily.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from math import inf, isfinite
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fvs_controller_node.config import default_values
from fvs_controller_node.inbox import JACOBIAN
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.reasons import Reason
from fvs_controller_node.references import Reference
from fvs_controller_node.supervisor import Command
from fvs_estimator_node.base import Estimator
from fvs_estimator_node.files import load_model
from fvs_estimator_node.loop import EstimationLoop
from fvs_estimator_node.registry import create_estimator
from fvs_ros.clock import Pace
from fvs_ros.interface import POSITION, PositionPath
from fvs_ros.joints import JointMap, JointStateError
from fvs_ros.kinds import KindConfig
from fvs_ros.limits import with_urdf_limits
from fvs_ros.paths import find_file
from fvs_ros.urdf import UrdfJoint, read_joints
from fvs_tools.schemes import Scheme
from fvs_tools.schemes import scheme as scheme_called

#: Images that wait for the next joints; the oldest gives way.
_MOST_WAITING = 64
_Servo = TypeVar("_Servo", bound="Servo")


class Servo:
    """Visual servoing of one arm: ``observe`` the arm, then send it ``command``, at each period.

    The arm moves once a target is set and five samples of every input are fresh. What ends a
    session needs ``start``. ``status`` says what it does and why; ``loop`` and ``estimation`` are
    the controller and the estimator.

    Parameters
    ----------
    estimator : Estimator
        Learns and gives the Jacobian; the kind of feature is its own.
    values : mapping, optional
        The controller node's parameters, where they differ from the defaults; ``autostart`` is on.
    urdf : mapping, optional
        Joints of a URDF by name: their limits, where ``values`` hold none.
    """

    def __init__(
        self,
        estimator: Estimator,
        values: Mapping[str, Any] | None = None,
        urdf: Mapping[str, UrdfJoint] | None = None,
    ) -> None:
        own = default_values(**{"autostart": True, **(values or {}), **estimator.kind.values})
        self.loop = ServoLoop(with_urdf_limits(own, urdf or {}))
        self.estimation = EstimationLoop(estimator)
        self.kind = self.loop.kind  #: of what is servoed
        self.joint_names = self.loop.supervisor.config.joint_names  #: in the order of all vectors
        self._joint_map, self._pace = JointMap(self.joint_names), Pace(own["joint_state_rate_hz"])
        self._path = PositionPath() if own["command_interface"] == POSITION else None
        self._waiting: deque[Callable[[float], None]] = deque(maxlen=_MOST_WAITING)
        #: Time for ages: the joints' stamps and what commands without a newer one counted for.
        self._now_s, self._ahead_s, self._stamp_s = 0.0, 0.0, -inf
        self._newer, self._new_target = False, False

    @classmethod
    def load(
        cls: type[_Servo], model: str, scheme: Scheme | str = "best", urdf: str = "", **values: Any
    ) -> _Servo:
        """Servo by a model of ``fvs_train``, which knows joints, kind of feature and mount.

        Model and URDF are paths, or names in the project's ``config`` folder; ``values`` are the
        controller node's parameters, such as ``max_joint_velocity_rad_s``. Without a URDF, or
        ``joint_min_rad`` and ``joint_max_rad``, no joint but a UR's slows before its end. A
        ``ValueError`` says what does not fit together.
        """
        chosen, trained = scheme_called(scheme), load_model(find_file(model))
        own = {"law": chosen.law, **chosen.controller_values, "joint_names": trained.joint_names}
        own |= {**trained.kind.values, "feature_frame": trained.feature_frame, **values}
        seen = KindConfig.from_values(own)
        trained = load_model(find_file(model), own["joint_names"], seen)
        estimator = create_estimator(
            chosen.method, chosen.estimator_values, lambda: trained, seen.kind
        )
        joints = read_joints(find_file(urdf).read_bytes()) if urdf else {}
        if urdf and (missing := set(own["joint_names"]) - set(joints)):
            raise ValueError(f"{urdf} has no joint {min(missing)}, which the model moves")
        return cls(estimator, own, joints)

    # ---- measurements -------------------------------------------------------------------------

    def observe(
        self,
        stamp_s: float,
        joints_rad: ArrayLike | None,
        measurement: ArrayLike | None = None,
        exposed_s: float | None = None,
    ) -> None:
        """Take the joints now, rad (m), (n,), None if they could not be read, and a measurement.

        The image of the ``measurement``, (m,), was exposed at ``exposed_s``, by default now. What
        is not finite or of a wrong size, and a jump of a joint, stop the arm at once. Joints whose
        stamp does not advance grow old.
        """
        if not isfinite(stamp_s):
            raise ValueError(f"stamp_s must be a finite time, s, got {stamp_s}")
        self.see(stamp_s if exposed_s is None else exposed_s, measurement)
        if stamp_s > self._stamp_s:
            self._ahead_s = max(self._ahead_s, self._now_s - stamp_s)
            self._now_s, self._newer = stamp_s + self._ahead_s, True
        self._stamp_s, now_s = stamp_s, self._now_s
        while self._waiting:
            self._waiting.popleft()(now_s)
        if joints_rad is None:
            return
        try:
            joints = self._joint_map.positions(
                self.joint_names, np.ravel(joints_rad).tolist(), stamp_s
            )
        except JointStateError as error:
            self.estimation.lose_joints()
            self.loop.bad_joints(str(error))
            return
        estimation, loop = self.estimation, self.loop
        estimation.add_joints(stamp_s, joints)
        problem, chain = estimation.problem, estimation.estimator.chain
        if not problem:
            loop.add_jacobian(now_s, estimation.jacobian(joints))
        if chain is not None:
            loop.add_chain(now_s, chain)
        loop.supervisor.inputs[JACOBIAN].set_source_status(now_s, problem)
        loop.add_joints(now_s, stamp_s, joints)

    def see(self, exposed_s: float, measurement: ArrayLike | None, camera: int = 0) -> None:
        """Take what a camera measured, (m,), for the next ``observe``; from any thread.

        None where it saw nothing. A ball is x, y, z, m; points are u, v, px; of a tag's position
        and quaternion ``kind.parse`` makes the 12 numbers.
        """
        if not 0 <= camera < len(self.kind.parts):
            raise ValueError(f"camera {camera} is none of {self.kind.cameras}")
        if measurement is not None:
            self._waiting.append(partial(self._add_image, exposed_s, measurement, camera))

    def see_object(self, exposed_s: float, measurement: ArrayLike | None) -> None:
        """Take the same of the object that targets may be relative to."""
        if measurement is not None:
            z = self.kind.checked(np.asarray(measurement, dtype=float))
            self._waiting.append(lambda now_s: self.loop.add_object(now_s, exposed_s, z))

    def _add_image(
        self, exposed_s: float, measurement: ArrayLike, camera: int, now_s: float
    ) -> None:
        inputs = self.loop.supervisor.inputs
        try:
            z = self.kind.parts[camera].checked(np.asarray(measurement, dtype=float))
        except ValueError as error:
            inputs[inputs.features[camera]].bad(f"the {self.kind.what} {error}")
            return
        self.estimation.add_image(exposed_s, z, camera)
        self.loop.add_image(now_s, exposed_s, z, camera)

    # ---- the target ---------------------------------------------------------------------------

    def set_target(self, target: ArrayLike | Reference) -> None:
        """Take a target: a measurement in the camera's frame, (m,), or one that was taught.

        A ``ValueError`` says why it is refused.
        """
        if isinstance(target, Reference):
            accepted, text = self.loop.go_to(target)
        else:
            z, frame = np.asarray(target, dtype=float), self.loop.supervisor.config.feature_frame
            accepted, text = self.loop.add_target(self.kind.checked(z), frame, self._now_s)
        if not accepted:
            raise ValueError(text)
        self._new_target = True

    def teach(self) -> Reference:
        """Where the tool is at rest, from the object where one is seen; a ``ValueError`` if not."""
        return self.loop.teach(self._now_s)

    def start(self) -> None:
        """Begin anew after a hold that needs it; a ``ValueError`` says why that cannot be."""
        started, text = self.loop.supervisor.start(self._now_s)
        if not started:
            raise ValueError(text)

    def stop(self) -> None:
        """End servoing: the next commands ramp to rest."""
        self.loop.supervisor.stop()

    # ---- commands -----------------------------------------------------------------------------

    def command(self, dt_s: float | None = None) -> Any:
        """What to send to the arm now, after all limits, (n,).

        Joint velocities, rad/s (m/s). With ``command_interface`` ``position`` positions, rad (m),
        or None while there is nothing to send: the arm holds its last position. ``dt_s`` is the
        time until the next command, s; by default the usual period of the stamps. Without a newer
        stamp than before the last command, all measurements are older by so much.
        """
        paced_s = self._pace.joint_state(self._stamp_s) if self._newer else self._pace.missing()
        dt_s = paced_s if dt_s is None else dt_s
        if not 0.0 <= dt_s < inf:
            raise ValueError(f"dt_s must be a finite time from 0 on, s, got {dt_s}")
        self._now_s += 0.0 if self._newer else dt_s
        self._newer, self._new_target = False, False
        velocity = self.loop.tick(self._now_s, dt_s).velocity_rad_s
        if self.loop.sliding_variable is not None:
            self.estimation.add_sliding_variable(self._now_s, self.loop.sliding_variable)
        if self._path is None:
            return velocity
        measured, supervisor = self.loop.measured_rad, self.loop.supervisor
        return self._path.follow(velocity, measured, dt_s, supervisor.config, supervisor.started)

    @property
    def status(self) -> Command:
        """The last command with its state, reason and ``text``: what it does, or why it holds."""
        return self.loop.supervisor.last

    @property
    def settled(self) -> bool:
        """Whether the target is reached, by the last command."""
        return self.status.reason is Reason.SETTLED and not self._new_target

    @property
    def feature(self) -> np.ndarray | None:
        """What is servoed, predicted to the newest joints, (m,); None while it is not known."""
        return self.loop.feature

    def jacobian(self, joints_rad: ArrayLike) -> np.ndarray:
        """Motion of the feature by the joints at joints, rad, (n,): m/rad, (d, n).

        A ``ValueError`` says why there is no estimate yet, or that these are no joints.
        """
        if self.estimation.problem:
            raise ValueError(self.estimation.problem)
        joints = np.asarray(joints_rad, dtype=float)
        if joints.shape != (len(self.joint_names),) or not np.isfinite(joints).all():
            raise ValueError(f"expected {len(self.joint_names)} finite joints, got {joints}")
        return self.estimation.at(joints)
