"""What is read off a corner at one position: angles, offsets, and their rates by travel, steer and loads.

All are of the wheel's axis s (outward), the contact patch p, the wheel's center c and the steering axis from its lower
to its upper point; with side = 1 for a left corner and -1 for a right one:

    toe     = atan2(s_x, side s_y)            positive toe-in
    camber  = -asin(s_z)                      positive with the wheel's top outwards
    caster  = atan2(-k_x, k_z)                k: direction of the steering axis; positive with its top to the rear
    kingpin inclination = atan2(-side k_y, k_z)   positive with its top inwards
    scrub radius  = side (p_y - g_y)          g: where the axis meets the road; positive with g inward of the patch
    caster trail  = g_x - p_x                 positive with g ahead of the patch

Source: ISO 8855:2011, sections 7.1 and 7.2 (definitions and signs).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.types import Scalar, Vector3
from spherejax.model.system import System
from spherejax.motion.equations.body_motions import BodyMotions, body_motions
from spherejax.physics.forces.line import AbstractLineForce
from spherejax.physics.kinematics import point_motion
from spherejax.physics.state import State
from spherejax.studies.rig.bench import LOADS, PlacedPlatform, moved, platform_of, side_of

GIVES = ("toe", "camber", "longitudinal", "lateral")
"""What a load changes: toe [rad], camber [rad], and in x and y the place of the tread's point on the road [m], with the
wheel locked to its carrier. That point is where the loads act: coefficients of pairs are equal (Betti)."""


class RigMeasured(NamedTuple):
    """What follows from where the bodies are.

    Attributes:
        toe, camber, caster, kingpin_inclination: [rad]; the last two None without a steering axis.
        scrub_radius, caster_trail: [m]; None without a steering axis.
        patch: the contact patch, world axes [m].
        center: the wheel's center [m].
        spring_length: [m]; None without a spring.
    """

    toe: Scalar
    camber: Scalar
    caster: Any
    kingpin_inclination: Any
    scrub_radius: Any
    caster_trail: Any
    patch: Vector3
    center: Vector3
    spring_length: Any


def measured(system: System, motions: BodyMotions) -> RigMeasured:
    """Read the wheel and the steering axis."""
    platform = platform_of(system)
    corner = platform.corner
    side, carrier = side_of(platform), motions[corner.carrier]
    spin = platform.wheel.spin(carrier)
    center = point_motion(carrier, jnp.asarray(platform.wheel.center)).position
    patch = center + platform.wheel.patch_arm(carrier)
    toe = jnp.arctan2(spin[0], side * spin[1])
    camber = -jnp.arcsin(spin[2])
    axis = _axis(platform, motions, patch, side)
    spring: Any = system.forces[corner.spring] if corner.spring is not None else None
    is_line = isinstance(spring, AbstractLineForce)
    attachment: Any = spring.attachment if is_line else None
    length = attachment.stretch(motions).length if is_line else None
    return RigMeasured(toe, camber, *axis, patch=patch, center=center, spring_length=length)


def _axis(platform: PlacedPlatform, motions: BodyMotions, patch: Vector3, side: Scalar) -> tuple[Any, Any, Any, Any]:
    """Caster, kingpin inclination, scrub radius and caster trail."""
    if not platform.kingpin_bodies:
        return None, None, None, None
    ends = zip(platform.kingpin_bodies, platform.kingpin_places, strict=True)
    lower, upper = (point_motion(motions[body], jnp.asarray(place)).position for body, place in ends)
    k = upper - lower
    at_road = lower + k * ((patch[2] - lower[2]) / k[2])
    return (
        jnp.arctan2(-k[0], k[2]),
        jnp.arctan2(-side * k[1], k[2]),
        side * (patch[1] - at_road[1]),
        at_road[0] - patch[0],
    )


class RigCurves(NamedTuple):
    """One position on the rig.

    Attributes:
        toe, camber, caster, kingpin_inclination: [rad].
        scrub_radius, caster_trail: [m].
        track_change: how far the contact patch has gone outward from where it was drawn (half the change of track) [m].
        recession: how far the wheel's center has gone to the rear [m].
        center_travel: how far the wheel's center has gone up [m].
        wheel_load: vertical force on the contact patch [N].
        wheel_rate: its derivative by travel [N/m].
        motion_ratio: compression of the spring by travel [-].
        roll_center_height: over the road [m].
        braking_angle: of the side-view swing arm for forces at the contact patch, brakes on the carrier [rad].
        driving_angle: the same for forces at the wheel's center, driven by shafts [rad].
        toe_gradient: derivative of toe by travel (bump steer) [rad/m].
        camber_gradient: derivative of camber by travel [rad/m].
        steer_gradient: derivative of the wheel's steer angle (positive to the left) by the steering's displacement
            [rad/m, or 1 of an angle]; None without steering.
        steering_effort: force or moment with which the steering is held [N or N m]; None without.
        compliance: derivatives of toe, camber, and of the place of the tread's point on the road in x and in y by each
            of the loads, at fixed travel, shape (4, 4); zero where all joints are ideal.
    """

    toe: Scalar
    camber: Scalar
    caster: Any
    kingpin_inclination: Any
    scrub_radius: Any
    caster_trail: Any
    track_change: Scalar
    recession: Scalar
    center_travel: Scalar
    wheel_load: Scalar
    wheel_rate: Scalar
    motion_ratio: Any
    roll_center_height: Scalar
    braking_angle: Scalar
    driving_angle: Scalar
    toe_gradient: Scalar
    camber_gradient: Scalar
    steer_gradient: Any
    steering_effort: Any
    compliance: Float[Array, "4 4"]


class Holding(NamedTuple):
    """What holds the corner in its position.

    Attributes:
        wheel_load: [N].
        steering_effort: [N or N m]; None without steering.
    """

    wheel_load: Scalar
    steering_effort: Any


def curves_of(
    system: System,
    state: State,
    steps: Float[Array, "n_inputs b 6"],
    holding: Holding,
    wheel_rate: Scalar,
) -> RigCurves:
    """All characteristics at a position.

    Args:
        system: the system on the rig.
        state: positions.
        steps: derivatives of the bodies' places by travel, steer and the loads; without the loads where nothing gives.
        holding: what holds it.
        wheel_rate: derivative of the wheel load by travel [N/m].
    """
    platform = platform_of(system)
    corner, side = platform.corner, side_of(platform)

    def at(step):
        position, quaternion = moved(state.position, state.quaternion, step)
        return measured(system, body_motions(system, state._replace(position=position, quaternion=quaternion)))

    none = jnp.zeros_like(steps[0])
    here, by_travel = jax.jvp(at, (none,), (steps[0],))
    patch_change, center_change = here.patch - platform.design_patch, here.center - platform.design_center
    # The patch's own rise by travel is 1, the center's nearly so.
    half_track = side * here.patch[1]
    steer = None
    if corner.steering is not None:
        _, by_steer = jax.jvp(at, (none,), (steps[1],))
        steer = -side * by_steer.toe
    return RigCurves(
        *here[:6],
        track_change=side * patch_change[1],
        recession=-center_change[0],
        center_travel=center_change[2],
        wheel_load=holding.wheel_load,
        wheel_rate=wheel_rate,
        motion_ratio=None if here.spring_length is None else -by_travel.spring_length,
        roll_center_height=half_track * side * by_travel.patch[1],
        braking_angle=jnp.arctan(by_travel.patch[0]),
        driving_angle=jnp.arctan2(by_travel.center[0], by_travel.center[2]),
        toe_gradient=by_travel.toe,
        camber_gradient=by_travel.camber,
        steer_gradient=steer,
        steering_effort=holding.steering_effort,
        compliance=_compliance(at, steps[2:], none, list(system.bodies).index(corner.carrier)),
    )


def _compliance(at, steps: Float[Array, "n b 6"], none: Float[Array, "b 6"], carrier: int) -> Float[Array, "4 4"]:
    """Derivatives by the loads, one load a column."""
    if not steps.shape[0]:
        return jnp.zeros((len(GIVES), len(LOADS)))

    def along(step):
        here, change = jax.jvp(at, (none,), (step,))
        tread = change.center + jnp.cross(step[carrier, 3:], here.patch - here.center)
        return jnp.stack([change.toe, change.camber, tread[0], tread[1]])

    return jax.vmap(along, out_axes=1)(steps)
