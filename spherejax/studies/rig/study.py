"""`sj.vehicle.rig`: kinematics and compliance of one corner of a car."""

import warnings
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import is_concrete, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import shape_of
from spherejax.foundations.terminals import waiting_for
from spherejax.foundations.types import Numeric
from spherejax.model.scene import Scene
from spherejax.model.system import Structure, System, compile_scene, flatten_system
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.joints.dry import Dry
from spherejax.studies.rig import equilibria, kinematics
from spherejax.studies.rig.bench import (
    LOADS,
    Corner,
    found_corner,
    on_rig,
    platform_of,
    side_of,
    without_friction,
    without_models,
)
from spherejax.studies.rig.characteristics import RigCurves
from spherejax.studies.rig.equilibria import RealPrograms
from spherejax.studies.rig.kinematics import RigPrograms
from spherejax.studies.rig.rig_result import Rig
from spherejax.studies.rig.shown import REASONS, RigStatus, RigWarning

PART = 0.02
"""Largest part of travel or rack [m], or of a steering angle [rad], that is closed at once: a body turns by about 4 deg
in it. Other parts have given the same curves to rounding, from 5 to 60 mm."""

N_PARTS_TRACED = 5
"""Parts of a stretch of a path whose length is traced."""

LOOSE = 1e-12
"""Square of the share of the applied accelerations that is left to what nothing holds; rounding leaves 1e-25."""


class WheelLoads(NamedTuple):
    """WheelLoads on the wheel, numbers or arrays with one entry a position.

    Attributes:
        longitudinal: force at the contact patch, forward [N]: braking, with the brake on the carrier, is negative.
        lateral: force at the contact patch, to the left [N].
        aligning: moment about the vertical [N m].
        driving: longitudinal force at the wheel's center [N], of a wheel that a shaft drives.
    """

    longitudinal: Numeric = 0.0
    lateral: Numeric = 0.0
    aligning: Numeric = 0.0
    driving: Numeric = 0.0


class Prepared(NamedTuple):
    """A corner on the rig, ready to be computed.

    Attributes:
        ideal: structure with ideal joints.
        ideal_numbers: its numbers.
        real: structure with the joints as they are; None where all are ideal.
        real_numbers: its numbers.
    """

    ideal: Structure
    ideal_numbers: Any
    real: Structure | None
    real_numbers: Any


def rig(
    scene: Scene,
    travel: Numeric = 0.0,
    *,
    steer: Numeric = 0.0,
    loads: WheelLoads | None = None,
    corner: Corner | None = None,
    part: float = PART,
) -> Rig:
    """Kinematics and compliance of a corner: toe, camber and the rest at each travel, steer and load.

        k = sj.vehicle.rig(sj.gallery.double_wishbone(), np.linspace(-0.08, 0.08, 17))
        print(k); k.toe, k.wheel_rate; k.figure(); k.to_xarray()

    A platform lifts the contact patch, the steering is held, loads act at the patch; nothing moves in time. With ideal
    joints the positions are those of a mechanism; with bushings and dry balls they are equilibria, which loads and the
    spring deflect. Tyres of the scene are taken off. Travel, steer and loads are numbers, or arrays of one length: the
    positions are taken in that order, each from the one before.

    The result follows traced numbers: `jax.vmap`, `jax.jit`, derivatives by hardpoints forward and in reverse, to the
    second order (of gradients and coefficients: they are derivatives themselves).

    Args:
        scene: one corner, e.g. of `sj.gallery.double_wishbone`, `sj.gallery.mcpherson`.
        travel: how far the contact patch is lifted over its design position [m], positive in bump.

    Other args:
        steer: displacement of the driver that steers [m], or its angle [rad].
        loads: on the wheel, `sj.vehicle.WheelLoads(lateral=-2000.0)`.
        corner: which body carries the wheel, and so on, where the scene has other names than the gallery.
        part: largest travel and steer that is closed at once [m, rad]; smaller for mechanisms smaller than a car's.

    Returns:
        Curves by name, `status` of each position, `print`, `.figure()`, `.to_xarray()`, `.to_csv(path)`.

    Limits: friction is left out, for at rest it holds any position within a band; bushings are relaxed (branches and
        friction of rubber carry nothing), and start relaxed where they were drawn.

    Raises:
        SceneError: for a request that makes no sense, joints that do not close, and lubricated joints, whose film
            carries nothing at rest.

    Warns:
        RigWarning: where positions were not found; their curves are NaN, and `status` says why.
    """
    corner = found_corner(scene, Corner() if corner is None else corner)
    points = _points(travel, steer, WheelLoads() if loads is None else loads)
    prepared = prepare(scene, corner)
    known = all(is_concrete(each) for each in (points, prepared.ideal_numbers, prepared.real_numbers))
    if known:
        points = np.asarray(points)
        with waiting_for("a suspension rig", program="rig_depths"):
            found = _computed_now(prepared, points, float(part))
        _warn_of_failures(found, stacklevel=3)
        return found
    return computed(prepared, points, path_of(points, part))


def prepare(scene: Scene, corner: Corner) -> Prepared:
    """A scene on the rig.

    Raises:
        SceneError: for a scene that cannot be simulated, and for lubricated joints.
    """
    compiled = compile_scene(on_rig(scene, corner))
    system = without_friction(compiled.system)
    _refuse_films(system)
    structure, numbers = flatten_system(without_models(system))
    for legal in compiled.conditions:
        # A traced number that is not legal cannot be refused; nothing is found with it.
        numbers = numbers if is_concrete(legal) else jnp.where(jnp.all(legal), numbers, jnp.nan)
    ideal = structure, numbers
    real = flatten_system(system) if system.force_joints else (None, np.zeros(0))
    return Prepared(*ideal, *real)


def _refuse_films(system: System) -> None:
    for name in system.force_joints:
        joint = system.spherical(name)
        model = joint.model
        if model.has_surfaces and not joint.is_ball:
            raise SceneError(
                f"rig: joint {name!r} is a journal with clearance in its bearing, of which the rig finds no rest "
                "position. Take sj.Ideal() or sj.Bushing(law=...) for it; balls in sockets may have clearance"
            )
        if not isinstance(model, Dry | Bushing) and model.has_surfaces:
            raise SceneError(
                f"rig: joint {name!r} is lubricated, and at rest its film carries nothing: the ball sinks to the wall. "
                "Take sj.Dry(clearance=...) with the same clearance: that is where it comes to rest"
            )


def _points(travel: Numeric, steer: Numeric, loads: WheelLoads) -> Any:
    """Travel, steer and loads of each position, shape (n, 6)."""
    if not isinstance(loads, WheelLoads):
        raise SceneError(
            f"rig: loads = {shown(loads)} must be sj.vehicle.WheelLoads(...), e.g. "
            f"sj.vehicle.WheelLoads(lateral=-2000.0)"
        )
    given = {"travel": travel, "steer": steer, **{f"loads.{name}": value for name, value in loads._asdict().items()}}
    lengths = {}
    for name, value in given.items():
        shape = shape_of(value)
        if shape is None or len(shape) > 1 or shape == (0,):
            raise SceneError(f"rig: {name} = {shown(value)} must be one number or a list of numbers, in SI units")
        if is_concrete(value) and not np.all(np.isfinite(np.asarray(value, np.float64))):
            raise SceneError(f"rig: {name} = {shown(value)} must be finite")
        if shape:
            lengths[name] = shape[0]
    if len(set(lengths.values())) > 1:
        raise SceneError(f"rig: {', '.join(lengths)} must be numbers or lists of one length; they have {lengths}")
    n = max(lengths.values(), default=1)
    xp: Any = np if all(is_concrete(value) for value in given.values()) else jnp
    return xp.stack([xp.broadcast_to(xp.asarray(value, xp.float64), (n,)) for value in given.values()], 1)


class RigPath(NamedTuple):
    """A way through all positions.

    Attributes:
        inputs: of each part's end, shape (m, 6).
        ends: which of them are the positions that were asked for (static).
    """

    inputs: Any
    ends: tuple[int, ...]


def path_of(points: Any, part: float) -> RigPath:
    """From the design position through all points, in parts that are small enough."""
    if not part > 0:
        raise SceneError(f"rig: part = {shown(part)} must be positive [m]")
    xp: Any = np if is_concrete(points) else jnp
    before = xp.concatenate([xp.zeros((1, points.shape[1])), points[:-1]])
    if xp is np:
        lengths = np.abs(points - before)[:, :2].max(1)
        counts = np.maximum(1, np.ceil(lengths / part - 1e-9)).astype(int)
    else:
        counts = np.full(len(points), N_PARTS_TRACED)
    shares = [np.arange(1, count + 1) / count for count in counts]
    inputs = [a + share[:, None] * (b - a) for a, b, share in zip(before, points, shares, strict=True)]
    return RigPath(xp.concatenate(inputs), tuple((np.cumsum(counts) - 1).tolist()))


def _computed_now(prepared: Prepared, points: np.ndarray, part: float) -> Rig:
    """With known numbers: without compiling anything, but for balls with clearance."""
    programs = RigPrograms(prepared.ideal)
    path = path_of(points, part)
    reach = kinematics.along_path_now(programs, prepared.ideal_numbers, path.inputs, path.ends)
    at = zip(reach.y, reach.is_reached, points, strict=True)
    if prepared.real is None:
        found = [_kinematic_now(programs, prepared, *each) for each in at]
    else:
        real = RealPrograms(prepared.real, prepared.ideal)
        found = [_equilibrium(real, prepared, *each, np) for each in at]
    curves, status = jax.tree.map(lambda *each: np.stack(each), *found)
    return _result(prepared, points, curves, status, np)


def _kinematic_now(programs: RigPrograms, prepared: Prepared, y, is_reached, inputs) -> tuple[RigCurves, Any]:
    reading = programs.read_now(prepared.ideal_numbers, y, inputs)
    return reading.curves, _kinematic_status(is_reached, reading.loose, np)


def _equilibrium(real: RealPrograms, prepared: Prepared, y, is_reached, inputs, xp: Any) -> tuple[RigCurves, Any]:
    """The equilibrium from a position of ideal joints; in JAX with the derivatives by all numbers."""
    numbers = (prepared.ideal_numbers, prepared.real_numbers, y, inputs)
    frozen = numbers if xp is np else jax.lax.stop_gradient(numbers)
    start = real.starter.at(*frozen, xp)
    found = equilibria.equilibrium_from(real.of(frozen[1], xp is np), start.y, start.multipliers, frozen[3], xp)
    status = xp.where(start.is_loaded, found.status, int(RigStatus.UNLOADED))
    kinematic = _kinematic_status(is_reached, start.loose, xp)
    equations = real.of(prepared.real_numbers, xp is np)
    if xp is jnp:
        found = equilibria.followed(equations, found, inputs)
    curves = equilibria.characteristics_at(real, equations, found, inputs, xp)
    return curves, xp.where(kinematic == RigStatus.FOUND, status, kinematic)


def computed(prepared: Prepared, points: Any, path: RigPath) -> Rig:
    """With traced numbers, or for many numbers in one program."""
    programs = RigPrograms(prepared.ideal)
    prepared = prepared._replace(
        ideal_numbers=jnp.asarray(prepared.ideal_numbers), real_numbers=jnp.asarray(prepared.real_numbers)
    )
    numbers = prepared.ideal_numbers
    frozen, along = jax.lax.stop_gradient((numbers, jnp.asarray(path.inputs)))
    reach = kinematics.along_path(programs, frozen, along, path.ends)
    real = None if prepared.real is None else RealPrograms(prepared.real, prepared.ideal)

    @partial(jax.checkpoint, prevent_cse=False)  # as in `kinematics.followed`
    def at(given):
        y, is_reached, inputs = given
        if real is not None:
            return _equilibrium(real, prepared, y, is_reached, inputs, jnp)
        y = kinematics.followed(programs, numbers, y, inputs)
        reading = programs.read(numbers, y, inputs)
        return reading.curves, _kinematic_status(is_reached, reading.loose, jnp)

    curves, status = jax.lax.map(at, (jax.lax.stop_gradient(reach.y), reach.is_reached, jnp.asarray(points)))
    return _result(prepared, jnp.asarray(points), curves, status, jnp)


def _kinematic_status(is_reached: Any, loose: Any, xp: Any) -> Any:
    found = xp.where(loose < LOOSE, int(RigStatus.FOUND), int(RigStatus.LOOSE))
    return xp.where(is_reached, found, int(RigStatus.OUT_OF_REACH))


def _result(prepared: Prepared, points: Any, curves: RigCurves, status: Any, xp: Any) -> Rig:
    system = prepared.ideal.system(prepared.ideal_numbers)
    platform = platform_of(system)
    good = status == RigStatus.FOUND

    def kept(curve):
        return xp.where(good.reshape(-1, *(1 for _ in curve.shape[1:])), curve, xp.nan)

    known: dict[str, Any] = {name: None if curve is None else kept(curve) for name, curve in curves._asdict().items()}
    side = xp.asarray(side_of(platform))
    return Rig(
        travel=points[:, 0],
        steer=points[:, 1],
        loads=points[:, 2:],
        **known,
        status=status,
        side=side,
        corner=platform.corner,
    )


def _warn_of_failures(found: Rig, stacklevel: int) -> None:
    status = np.asarray(found.status)
    for kind in RigStatus:
        places = np.flatnonzero(status == kind)
        if kind == RigStatus.FOUND or not places.size:
            continue
        first = places[0]
        where = f"travel = {float(found.travel[first]):.6g} m, steer = {float(found.steer[first]):.6g}"
        loads = ", ".join(f"{n} {float(v):.6g}" for n, v in zip(LOADS, found.loads[first], strict=True) if v != 0)
        warnings.warn(
            f"rig: {places.size} of {status.size} positions have no result (NaN), the first at {where}"
            f"{f', loads {loads}' if loads else ''}: {REASONS[kind]}",
            RigWarning,
            stacklevel=stacklevel + 1,
        )
