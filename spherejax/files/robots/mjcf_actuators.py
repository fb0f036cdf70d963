"""Actuators of a MuJoCo model that are functions of one joint's position and rate, and what others there are.

With the control u (a number here), the gear g and the joint's position q, MuJoCo's actuator without activation makes
the effort

    g p,    p = G u + b_0 + b_1 g q + b_2 g q_rate,    within forcerange

on its joint. Motors have b = 0, position servos G = k_p, b_1 = -k_p, b_2 = -k_v, velocity servos G = k_v, b_2 = -k_v.
Here that is an `Actuator` where the effort does not depend on the motion, and a `PID` without integral where it does.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from spherejax.files.robots.mjcf_model import CompiledFile, keyframe_number, library
from spherejax.files.robots.robot import undotted
from spherejax.foundations.errors import SceneError, one_of
from spherejax.physics.forces.actuators import Actuator
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.forces.controllers import PID
from spherejax.physics.forces.coupler import AbstractCoordinate


class JointActuator(NamedTuple):
    """An actuator on one joint, its gear and its control taken in.

    Attributes:
        name: its name, or `actuator_` and its number.
        driven: effort of the control [N or N m].
        constant: effort besides, at position 0 and rest [N or N m]; position 0 is MuJoCo's.
        by_position: derivative of the effort by the position [N/m or N m/rad].
        by_rate: derivative of the effort by the rate [N s/m or N m s/rad].
        limits: least and largest effort [N or N m]; None without limits.
        origin: MuJoCo's position of the joint where the file draws it [m or rad].
    """

    name: str
    driven: float
    constant: float
    by_position: float
    by_rate: float
    limits: tuple[float, float] | None
    origin: float

    def force(self, coordinate: AbstractCoordinate, position: float) -> AbstractForce:
        """The force element.

        Args:
            coordinate: of the joint, counted from the start.
            position: of the joint at the start, from where the file draws it [m or rad].
        """
        if self.by_position == 0.0 and self.by_rate == 0.0:
            if self.limits is None:
                return Actuator(coordinate, self.driven, self.constant)
            return Actuator(coordinate, float(np.clip(self.driven + self.constant, *self.limits)))
        # Where the coordinate is 0, MuJoCo's position is this.
        effort = self.driven + self.constant + self.by_position * (self.origin + position)
        if self.by_position == 0.0:
            return PID(coordinate, effort / -self.by_rate, -self.by_rate, limits=self.limits, of_rate=True)
        derivative = -self.by_rate if self.by_rate else None
        reference = effort / -self.by_position
        return PID(coordinate, reference, -self.by_position, derivative=derivative, limits=self.limits)


def actuators_of(
    file: CompiledFile, controls: Mapping[str, Any], keyframe: str | None
) -> dict[str, tuple[JointActuator, ...]]:
    """The actuators of each joint by the joint's name, as far as they can be read; `unread` names the others.

    Args:
        file: compiled.
        controls: MuJoCo's `ctrl` of actuators by name.
        keyframe: whose controls others have; None: they are 0.

    Raises:
        SceneError: for a control of an actuator that there is not, or that is no finite number.
    """
    numbers = {undotted(_name(file, number)): number for number in _numbers(file)}
    for name, control in controls.items():
        if name not in numbers:
            raise SceneError(f"{file.path}: controls: there is no actuator {name!r}; {one_of(numbers, name)}")
        if not (isinstance(control, int | float | np.number) and np.isfinite(control)):
            raise SceneError(f"{file.path}: controls[{name!r}] = {control!r} must be a finite number")
    at_start = None if keyframe is None else file.model.key_ctrl[keyframe_number(file, keyframe)]
    found: dict[str, tuple[JointActuator, ...]] = {}
    for name, number in numbers.items():
        if _obstacle(file, number) is None:
            joint = file.joints[_joint_of(file, number)]
            one = _joint_actuator(file, number, name, controls.get(name), at_start)
            found[joint] = (*found.get(joint, ()), one)
    return found


def _joint_actuator(file: CompiledFile, number: int, name: str, control: Any, at_start: Any) -> JointActuator:
    model, joint = file.model, _joint_of(file, number)
    if control is None:
        entry = int(model.actuator_ctrladr[number]) if hasattr(model, "actuator_ctrladr") else number
        control = 0.0 if at_start is None else at_start[entry]
    if model.actuator_ctrllimited[number] and file.has("CLAMPCTRL"):
        control = np.clip(control, *model.actuator_ctrlrange[number])
    gear, b = float(model.actuator_gear[number][0]), np.zeros(3)
    if int(model.actuator_biastype[number]) == int(library().mjtBias.mjBIAS_AFFINE):
        b = np.array(model.actuator_biasprm[number][:3], np.float64)
    return JointActuator(
        name,
        driven=gear * float(model.actuator_gainprm[number][0]) * float(control),
        constant=gear * float(b[0]),
        by_position=gear**2 * float(b[1]),
        by_rate=gear**2 * float(b[2]),
        limits=_limits(file, number, joint, gear),
        origin=float(model.qpos0[model.jnt_qposadr[joint]]),
    )


def unread(file: CompiledFile) -> Iterator[str]:
    """Actuators that no force element does what they do, with what it is about them."""
    for number in _numbers(file):
        why = _obstacle(file, number)
        if why is not None:
            yield f"{_name(file, number)} ({why})"


def _numbers(file: CompiledFile) -> list[int]:
    """Numbers of the actuators that the file has switched on, all or by group."""
    # In MuJoCo 4 `nu` counts controls, and one actuator may have none.
    model = file.model
    n = int(getattr(model, "nactuator", model.nu)) if file.has("ACTUATION") else 0
    groups = [min(max(int(group), 0), 31) for group in model.actuator_group]
    off = int(getattr(model.opt, "disableactuator", 0))
    return [number for number in range(n) if not off >> groups[number] & 1]


def _name(file: CompiledFile, number: int) -> str:
    mujoco = library()
    return mujoco.mj_id2name(file.model, mujoco.mjtObj.mjOBJ_ACTUATOR, number) or f"actuator_{number}"


def _obstacle(file: CompiledFile, number: int) -> str | None:
    """What about an actuator has no counterpart; None for one that is read."""
    model, mujoco = file.model, library()
    kinds = (
        ("dyntype", mujoco.mjtDyn, ("NONE",)),
        ("gaintype", mujoco.mjtGain, ("FIXED",)),
        ("biastype", mujoco.mjtBias, ("NONE", "AFFINE")),
        ("trntype", mujoco.mjtTrn, ("JOINT", "JOINTINPARENT")),
    )
    for field, kind, readable in kinds:
        word = kind(int(getattr(model, f"actuator_{field}")[number])).name.rpartition("_")[2]
        if word not in readable:
            return f"{field} {word.lower()}"
    joint = int(model.actuator_trnid[number][0])
    if file.kind(joint) not in ("revolute", "prismatic"):
        return f"on a {file.kind(joint)} joint"
    for field in ("armature", "damping", "dampingpoly", "delay"):
        if np.any(np.asarray(getattr(model, f"actuator_{field}", np.zeros(number + 1)))[number]):
            return field
    if int(np.asarray(getattr(model, "actuator_plugin", np.full(number + 1, -1)))[number]) >= 0:
        return "plugin"
    on_joint = [one for one in _numbers(file) if _joint_of(file, one) == joint]
    if model.jnt_actfrclimited[joint] and len(on_joint) > 1:
        return f"actuatorfrcrange of joint {file.joints[joint]}, of several actuators"
    return None


def _joint_of(file: CompiledFile, number: int) -> int:
    """Number of the joint that an actuator is on; -1 for another thing."""
    on_joint = [int(getattr(library().mjtTrn, f"mjTRN_{word}")) for word in ("JOINT", "JOINTINPARENT")]
    is_on_joint = int(file.model.actuator_trntype[number]) in on_joint
    return int(file.model.actuator_trnid[number][0]) if is_on_joint else -1


def _limits(file: CompiledFile, number: int, joint: int, gear: float) -> tuple[float, float] | None:
    """Of the effort on the joint: the actuator's own, and the joint's."""
    model, limits = file.model, np.array([-np.inf, np.inf])
    if model.actuator_forcelimited[number]:
        limits = np.sort(gear * np.asarray(model.actuator_forcerange[number], np.float64))
    if model.jnt_actfrclimited[joint]:
        limits = np.clip(np.asarray(model.jnt_actfrcrange[joint], np.float64), *limits)
    return None if np.isinf(limits).any() else (float(limits[0]), float(limits[1]))
