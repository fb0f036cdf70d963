"""One corner of a car by its hardpoints: double wishbone and McPherson strut, for the rig and for the road.

ISO 8855 axes: x forward, y to the left, z up; the origin is on the road, in the middle of the axle. The corner is the
left one. Its chassis is the ground.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import concretely, is_concrete, shown
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.forms import shape_of
from spherejax.foundations.types import Number, Numeric
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import Scene
from spherejax.physics.bodies import Body, numbers
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.forces.spring_damper import SpringDamper
from spherejax.physics.forces.tyre import Tyre
from spherejax.physics.functions.shapes import Constant
from spherejax.physics.joints.axial import Prismatic, Revolute
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.distance import Distance
from spherejax.physics.joints.drivers import TranslationDriver
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.joint import AbstractJoint
from spherejax.physics.joints.spherical import Spherical

Y_AXIS = (0.0, 1.0, 0.0)

DOUBLE_WISHBONE: Mapping[str, tuple[float, float, float]] = {
    "lower_arm_front": (0.180, 0.360, 0.185),
    "lower_arm_rear": (-0.180, 0.370, 0.195),
    "lower_ball": (0.008, 0.700, 0.190),
    "upper_arm_front": (0.110, 0.420, 0.495),
    "upper_arm_rear": (-0.140, 0.430, 0.475),
    "upper_ball": (-0.025, 0.645, 0.520),
    "tie_rod_inner": (-0.130, 0.365, 0.235),
    "tie_rod_outer": (-0.140, 0.690, 0.244),
    "spring_lower": (0.000, 0.580, 0.200),
    "spring_upper": (0.000, 0.450, 0.640),
    "wheel_center": (0.000, 0.750, 0.300),
    "contact_patch": (0.000, 0.750, 0.000),
}
"""Hardpoints of a passenger car's left front double wishbone, drawn for this gallery [m]: 1.5 m of track, caster of
5.7 deg, kingpin inclination of 9.5 deg, 18 mm of scrub radius and 27 mm of caster trail."""

MCPHERSON: Mapping[str, tuple[float, float, float]] = {
    "lower_arm_front": (0.030, 0.360, 0.190),
    "lower_arm_rear": (-0.280, 0.370, 0.200),
    "lower_ball": (0.005, 0.700, 0.180),
    "strut_lower": (-0.008, 0.640, 0.430),
    "strut_top": (-0.035, 0.560, 0.860),
    "tie_rod_inner": (-0.130, 0.330, 0.262),
    "tie_rod_outer": (-0.140, 0.680, 0.260),
    "wheel_center": (0.000, 0.750, 0.300),
    "contact_patch": (0.000, 0.750, 0.000),
}
"""Hardpoints of a passenger car's left front McPherson strut, drawn for this gallery [m]."""

ARM_MASS, UPRIGHT_MASS, RACK_MASS, ROD_MASS, STRUT_MASS = 6.0, 38.0, 3.0, 0.8, 3.0
"""Masses [kg] of an arm, of the upright with the wheel, of the rack, of a tie rod, of the strut's upper part."""


def double_wishbone(
    hardpoints: Mapping[str, Numeric] | None = None,
    *,
    ball_joint: AbstractSphericalModel | None = None,
    bushes: AbstractSphericalModel | None = None,
    tie_rod_joint: AbstractSphericalModel | None = None,
    static_toe: Number = 0.0,
    static_camber: Number = 0.0,
    spring_rate: Number = 60e3,
    damping: Number = 3e3,
    preload: Number = 5.6e3,
    steering: Callable | None = None,
    tyre_stiffness: Number = 200e3,
    tyre_compression: Number = 0.020,
    road: Callable | None = None,
    speed: Number = 0.0,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """A left front double wishbone: two arms, an upright with the wheel, a tie rod on a rack, a spring.

        sj.vehicle.rig(sj.gallery.double_wishbone({"upper_ball": (-0.025, 0.640, 0.515)}), travel=...)

    Bodies `lower_arm`, `upper_arm`, `upright`, `rack`; joints `lower_ball`, `upper_ball`, `tie_rod`, `rack_slide`,
    the driver `steering`, and at the chassis `lower_arm` and `upper_arm`, or with bushes `lower_arm_front`,
    `lower_arm_rear`, `upper_arm_front`, `upper_arm_rear`. With ideal joints one degree of freedom: the wheel's travel.

    Args:
        hardpoints: places that differ from the drawn ones, by name, world axes [m], each of shape (3,).
        ball_joint: model of the lower and the upper ball joint, whose socket is on the arm; ideal by default.
        bushes: model of the bushes at the chassis, two for each arm, in axes with z along the arm's axis, e.g.
            `sj.Bushing(law=sj.laws.MatrixElastomer.cylindrical((0, 0, 1), ...))`; None: each arm turns on one hinge.
        tie_rod_joint: model of the outer joint of the tie rod, which is a body of its own then; None: the tie rod is
            a massless link.
        static_toe: toe angle at the design position [rad], positive toe-in.
        static_camber: camber angle there [rad], positive with the wheel's top outwards.
        spring_rate: of the spring [N/m].
        damping: of the damper beside it [N s/m].
        preload: force with which the spring presses at the design position [N].
        steering: displacement of the rack to the left [m] by time [s]; at rest by default.
        tyre_stiffness: radial [N/m].
        tyre_compression: how far the tyre is pressed in at the design position [m].
        road: height [m] by x [m]; flat by default.
        speed: with which the road passes below [m/s].
        drift: drift control; `PostStabilization()` by default.

    Returns:
        The scene at the design position.

    Raises:
        SceneError: for a hardpoint that has no such name, or that is no place.
    """
    at = _places(DOUBLE_WISHBONE, hardpoints)
    bodies = {
        "lower_arm": _arm(at, "lower_arm", ("lower_ball", "spring_lower")),
        "upper_arm": _arm(at, "upper_arm", ("upper_ball",)),
        "upright": _upright(at, ("lower_ball", "upper_ball", "tie_rod_outer"), static_toe, static_camber),
    }
    joints: dict[str, AbstractJoint] = {
        **_chassis_joints("lower_arm", at, bushes),
        **_chassis_joints("upper_arm", at, bushes),
        "lower_ball": Spherical("lower_arm.lower_ball", "upright.lower_ball", _or_ideal(ball_joint)),
        "upper_ball": Spherical("upper_arm.upper_ball", "upright.upper_ball", _or_ideal(ball_joint)),
    }
    _add_steering(bodies, joints, at, tie_rod_joint, steering)
    forces = {
        "spring": _spring(("ground.spring_upper", "lower_arm.spring_lower"), at, spring_rate, damping, preload),
        "tyre": _tyre(at, tyre_stiffness, tyre_compression, road, speed),
    }
    return Scene(bodies, joints, forces, ground_points={"spring_upper": at["spring_upper"]}, drift=drift)


def mcpherson(
    hardpoints: Mapping[str, Numeric] | None = None,
    *,
    ball_joint: AbstractSphericalModel | None = None,
    bushes: AbstractSphericalModel | None = None,
    top_mount: AbstractSphericalModel | None = None,
    tie_rod_joint: AbstractSphericalModel | None = None,
    static_toe: Number = 0.0,
    static_camber: Number = 0.0,
    spring_rate: Number = 25e3,
    damping: Number = 1.5e3,
    preload: Number = 3.6e3,
    steering: Callable | None = None,
    tyre_stiffness: Number = 200e3,
    tyre_compression: Number = 0.020,
    road: Callable | None = None,
    speed: Number = 0.0,
    drift: AbstractDriftControl | None = None,
) -> Scene:
    """A left front McPherson strut: a lower arm, an upright that slides on the strut's rod, a tie rod on a rack.

    Bodies `lower_arm`, `upright` (with the strut's tube), `strut` (its rod), `rack`; joints `lower_ball`, `strut`
    (the slide), `top_mount`, `tie_rod`, `rack_slide`, the driver `steering`, and at the chassis `lower_arm`, or with
    bushes `lower_arm_front` and `lower_arm_rear`. Spring and damper act along the strut.

    Args:
        hardpoints: places that differ from the drawn ones, by name, world axes [m], each of shape (3,).
        ball_joint: model of the lower ball joint, whose socket is on the arm; ideal by default.
        bushes: as of `double_wishbone`.
        top_mount: model of the joint between chassis and strut; ideal by default.
        tie_rod_joint: as of `double_wishbone`.
        static_toe: toe angle at the design position [rad], positive toe-in.
        static_camber: camber angle there [rad], positive with the wheel's top outwards.
        spring_rate: of the spring [N/m].
        damping: of the damper [N s/m].
        preload: force with which the spring presses at the design position [N].
        steering: displacement of the rack to the left [m] by time [s]; at rest by default.
        tyre_stiffness: radial [N/m].
        tyre_compression: how far the tyre is pressed in at the design position [m].
        road: height [m] by x [m]; flat by default.
        speed: with which the road passes below [m/s].
        drift: drift control; `PostStabilization()` by default.

    Returns:
        The scene at the design position.

    Raises:
        SceneError: as of `double_wishbone`.
    """
    at = _places(MCPHERSON, hardpoints)
    upright = _upright(at, ("lower_ball", "strut_lower", "tie_rod_outer"), static_toe, static_camber)
    bodies = {
        "lower_arm": _arm(at, "lower_arm", ("lower_ball",)),
        "upright": upright,
        "strut": _placed(STRUT_MASS, (0.04, 0.04, 0.004), at["strut_top"], {"top": at["strut_top"]}),
    }
    joints: dict[str, AbstractJoint] = {
        **_chassis_joints("lower_arm", at, bushes),
        "lower_ball": Spherical("lower_arm.lower_ball", "upright.lower_ball", _or_ideal(ball_joint)),
        "strut": Prismatic(("upright", "strut"), at["strut_lower"], at["strut_top"] - at["strut_lower"]),
        "top_mount": Spherical("ground.strut_top", "strut.top", _or_ideal(top_mount)),
    }
    _add_steering(bodies, joints, at, tie_rod_joint, steering)
    placed = {"spring_upper": at["strut_top"], "spring_lower": at["strut_lower"]}
    forces = {
        "spring": _spring(("strut.top", "upright.strut_lower"), placed, spring_rate, damping, preload),
        "tyre": _tyre(at, tyre_stiffness, tyre_compression, road, speed),
    }
    return Scene(bodies, joints, forces, ground_points={"strut_top": at["strut_top"]}, drift=drift)


def _places(drawn: Mapping[str, tuple[float, float, float]], given: Mapping[str, Numeric] | None) -> dict[str, Any]:
    """All hardpoints, those that are given in place of those that are drawn."""
    given = {} if given is None else given
    if not isinstance(given, Mapping):
        raise SceneError(f'hardpoints = {shown(given)} must be places by name, e.g. {{"upper_ball": (0.0, 0.65, 0.5)}}')
    at = {name: numbers(place) for name, place in drawn.items()}
    for name, place in given.items():
        if name not in drawn:
            raise SceneError(f"there is no hardpoint {name!r}; {one_of(drawn, str(name))}")
        if shape_of(place) != (3,):
            raise SceneError(f"hardpoint {name!r} = {shown(place)} must be three numbers x, y, z [m]")
        at[name] = numbers(place)
        if is_concrete(at[name]) and not np.all(np.isfinite(np.asarray(at[name]))):
            raise SceneError(f"hardpoint {name!r} = {shown(place)} must be finite [m]")
    return at


def _or_ideal(model: AbstractSphericalModel | None) -> AbstractSphericalModel:
    return Ideal() if model is None else model


def _placed(mass: float, inertia: Any, center: Any, points: Mapping[str, Any]) -> Body:
    """A body whose axes are those of the world at the design position; all places are in world axes."""
    return Body(mass, inertia, position=center, points={name: place - center for name, place in points.items()})


def _arm(at: Mapping[str, Any], arm: str, ends: tuple[str, ...]) -> Body:
    front, rear, ball = at[f"{arm}_front"], at[f"{arm}_rear"], at[ends[0]]
    center = (front + rear + ball) / 3.0
    points = {"front": front, "rear": rear, **{name: at[name] for name in ends}}
    return _placed(ARM_MASS, (0.08, 0.10, 0.16), center, points)


def _upright(at: Mapping[str, Any], names: tuple[str, ...], toe: Number, camber: Number) -> Body:
    """With the wheel, whose axis is a second point of it, a tenth of a meter outwards."""
    spin = concretely(_spin_axis, toe, camber)
    center = at["wheel_center"]
    points = {name: at[name] for name in (*names, "wheel_center", "contact_patch")}
    return _placed(UPRIGHT_MASS, (0.8, 1.2, 0.8), center, {**points, "spin_axis": center + 0.1 * spin})


def _spin_axis(toe, camber):
    """The left wheel's axis, outwards: toe-in turns it forward, camber downward."""
    toe, camber = (jnp.asarray(angle, jnp.float64) for angle in (toe, camber))
    return jnp.stack([jnp.cos(camber) * jnp.sin(toe), jnp.cos(camber) * jnp.cos(toe), -jnp.sin(camber)])


def _chassis_joints(arm: str, at: Mapping[str, Any], bushes: AbstractSphericalModel | None) -> dict[str, AbstractJoint]:
    """One hinge; with bushes two of them on the same axis, for the second hinge adds nothing to a rigid one."""
    front, rear = at[f"{arm}_front"], at[f"{arm}_rear"]
    if bushes is None:
        return {arm: Revolute(("ground", arm), 0.5 * (front + rear), front - rear)}
    places = {f"{arm}_front": front, f"{arm}_rear": rear}
    return {name: Revolute(("ground", arm), place, front - rear, bushes) for name, place in places.items()}


def _add_steering(
    bodies: dict[str, Body],
    joints: dict[str, AbstractJoint],
    at: Mapping[str, Any],
    model: AbstractSphericalModel | None,
    steering: Callable | None,
) -> None:
    """The rack with its driver, and the tie rod."""
    inner, outer = at["tie_rod_inner"], at["tie_rod_outer"]
    bodies["rack"] = _placed(RACK_MASS, (0.05, 0.005, 0.05), inner, {"tie_rod": inner})
    joints["rack_slide"] = Prismatic(("ground", "rack"), inner, Y_AXIS)
    travel = Constant(0.0) if steering is None else steering
    joints["steering"] = TranslationDriver(("ground", "rack"), inner, Y_AXIS, travel)
    if model is None:
        joints["tie_rod"] = Distance("rack.tie_rod", "upright.tie_rod_outer")
        return
    bodies["tie_rod"] = _placed(ROD_MASS, (8e-3, 4e-4, 8e-3), 0.5 * (inner + outer), {"inner": inner, "outer": outer})
    joints["tie_rod_inner"] = Spherical("rack.tie_rod", "tie_rod.inner")
    joints["tie_rod"] = Spherical("tie_rod.outer", "upright.tie_rod_outer", model)


def _spring(
    ends: tuple[str, str], at: Mapping[str, Any], rate: Number, damping: Number, preload: Number
) -> AbstractForce:
    """A spring that presses with the preload at the design position."""
    length = concretely(_distance, at["spring_upper"], at["spring_lower"])
    return SpringDamper(ends, stiffness=rate, damping=damping, free_length=length + preload / rate)


def _distance(first, second):
    apart = jnp.asarray(first) - jnp.asarray(second)
    return jnp.sqrt(apart @ apart)


def _tyre(at: Mapping[str, Any], stiffness: Number, compression: Number, road, speed: Number) -> AbstractForce:
    radius = at["wheel_center"][2] - at["contact_patch"][2] + compression
    return Tyre("upright.wheel_center", radius=radius, stiffness=stiffness, road=road, speed=speed)
