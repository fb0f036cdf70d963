"""The bench on which a corner stands: a platform that lifts the wheel, loads at its contact patch, a held rack.

Signs and axes are those of ISO 8855: x forward, y to the left, z up. The corner may be the left or the right one; which
it is says the contact patch.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.checks import concretely
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.rotation import normalized, rotation_matrix
from spherejax.foundations.types import Numeric, Scalar, Vector3
from spherejax.model.drift import NoDriftControl
from spherejax.model.scene import Scene
from spherejax.model.system import System
from spherejax.physics.bodies import GROUND
from spherejax.physics.forces.base import AbstractForce, Wrench
from spherejax.physics.forces.tyre import Tyre
from spherejax.physics.functions.shapes import Constant
from spherejax.physics.joints.body_axes import in_world
from spherejax.physics.joints.drivers import RotationDriver, TranslationDriver
from spherejax.physics.joints.joint import AbstractJoint, AbstractPlacedJoint
from spherejax.physics.joints.rows import differentiated_rows
from spherejax.physics.kinematics import BodyMotion, point_motion

PLATFORM, PATCH = "rig_platform", "rig_patch"
"""Names of the joint and of the force that the rig adds to a scene."""

LOADS = ("longitudinal", "lateral", "aligning", "driving")
"""What is applied to the wheel, in the order of all arrays of loads."""

N_INPUTS = 2 + len(LOADS)
"""Travel, steer and the loads."""


class Corner(NamedTuple):
    """Names in a scene of what a rig has to know. The defaults are those of the gallery's corners.

    Attributes:
        carrier: the body that carries the wheel.
        wheel_center: a point of the carrier.
        spin_axis: a second point of it on the wheel's axis, further outward.
        contact_patch: a point of it below the wheel's center, at the design position on the road: it gives the loaded
            radius, the height of the road and, by the sign of y, the side of the car.
        kingpin: two points of the steering axis, `"body.point"`, the lower one first; None: `lower_ball` and
            `upper_ball` of the carrier, or the ground's `strut_top` as the upper one; (): there is no such axis.
        steering: the driver that steers, translational (a rack) or rotational; None: the corner is not steered.
        spring: the force element whose length gives the motion ratio; None: there is none.
    """

    carrier: str = "upright"
    wheel_center: str = "wheel_center"
    spin_axis: str = "spin_axis"
    contact_patch: str = "contact_patch"
    kingpin: tuple[str, ...] | None = None
    steering: str | None = "steering"
    spring: str | None = "spring"


class Wheel(eqx.Module):
    """A wheel on its carrier, in the carrier's axes.

    Attributes:
        center: [m].
        axis: its axis, outward, of any length.
        radius: loaded radius, from the center to the contact patch [m].
    """

    center: Numeric
    axis: Numeric
    radius: Numeric

    def spin(self, carrier: BodyMotion) -> Vector3:
        """The wheel's axis, world axes, of length 1."""
        axis = carrier.rotation @ jnp.asarray(self.axis)
        return axis / jnp.sqrt(axis @ axis)

    def patch_arm(self, carrier: BodyMotion) -> Vector3:
        """From the wheel's center to the lowest point of the wheel, -R (z - (z . s) s)/|...| [m]."""
        spin = self.spin(carrier)
        up = jnp.array([0.0, 0.0, 1.0]) - spin[2] * spin
        return -self.radius * up / jnp.sqrt(1.0 - spin[2] * spin[2])


class Platform(AbstractJoint):
    """The height of the contact patch is prescribed: one equation, whose reaction is the wheel's vertical load.

        Phi = z_patch - z_design - travel [m]

    Attributes:
        corner: names.
        travel: how far the patch is lifted over its design position [m].
    """

    corner: Corner = eqx.field(static=True)
    travel: Numeric

    def joined(self, find):
        """The ground and the carrier."""
        del find
        return GROUND, self.corner.carrier

    def requirements(self):
        """None: the rig has looked at its numbers."""
        return []

    def placed(self, bodies, find):
        """The wheel on its carrier, the steering axis, and where the wheel was drawn."""
        carrier = self.corner.carrier
        wheel = wheel_on(self.corner, find)
        kingpin = tuple(find(name) for name in self.corner.kingpin or ())
        center = in_world(bodies, carrier, wheel.center)
        # With camber the lowest point of the wheel as drawn is not quite the contact patch as drawn.
        patch = center + concretely(_patch_arm, wheel, bodies[carrier].quaternion)
        return PlacedPlatform(
            (GROUND, carrier),
            wheel,
            tuple(place for _, place in kingpin),
            tuple(body for body, _ in kingpin),
            patch,
            center,
            self.travel,
            self.corner,
        )


class PlacedPlatform(AbstractPlacedJoint):
    """A platform under a wheel.

    Attributes:
        bodies: the ground and the carrier.
        wheel: on the carrier.
        kingpin_places: two points of the steering axis, in axes of
        kingpin_bodies: their bodies.
        design_patch: where the wheel's lowest point was drawn, world axes [m].
        design_center: where the wheel's center was drawn [m].
        travel: [m].
        corner: names.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    wheel: Wheel
    kingpin_places: tuple[Numeric, ...]
    kingpin_bodies: tuple[str, ...] = eqx.field(static=True)
    design_patch: Numeric
    design_center: Numeric
    travel: Numeric
    corner: Corner = eqx.field(static=True)
    is_driven = True

    @property
    def points(self):
        """The patch as drawn, and the wheel's center."""
        return self.design_patch, self.wheel.center

    @property
    def n_rows(self) -> int:
        """One."""
        return 1

    def constraint_rows(self, t, motions):
        """The height that is missing."""

        def residual(t, first, second):
            del t, first
            center = point_motion(second, jnp.asarray(self.wheel.center)).position
            height = center[2] + self.wheel.patch_arm(second)[2]
            return jnp.stack([height - self.design_patch[2] - self.travel])

        return differentiated_rows(residual, t, motions[self.bodies[0]], motions[self.bodies[1]], is_driven=False)


class PatchLoads(AbstractForce):
    """Loads on the wheel, in axes of the road.

    Attributes:
        corner: names.
        loads: longitudinal [N] and lateral force [N] at the contact patch, aligning moment [N m], and a longitudinal
            force at the wheel's center [N], that of a driven wheel whose shaft takes the torque; shape (4,).
        wheel: on its carrier, once the scene is compiled.
    """

    corner: Corner = eqx.field(static=True)
    loads: Numeric
    wheel: Wheel | None = None

    def placed(self, bodies, find):
        """The wheel on its carrier."""
        del bodies
        return PatchLoads(self.corner, self.loads, wheel_on(self.corner, find))

    def wrenches(self, t, motions):
        """On the carrier."""
        del t
        assert self.wheel is not None
        carrier = motions[self.corner.carrier]
        center = point_motion(carrier, jnp.asarray(self.wheel.center)).arm
        along, across, about, drive = (self.loads[k] for k in range(len(LOADS)))
        zero = jnp.zeros(())
        at_patch, at_center = jnp.stack([along, across, zero]), jnp.stack([drive, zero, zero])
        arm = center + self.wheel.patch_arm(carrier)
        moment = jnp.cross(arm, at_patch) + jnp.cross(center, at_center) + jnp.stack([zero, zero, about])
        return {self.corner.carrier: Wrench(at_patch + at_center, moment)}

    @property
    def body_names(self):
        """The carrier."""
        return (self.corner.carrier,)


def wheel_on(corner: Corner, find) -> Wheel:
    """The wheel of a corner, by the points of its carrier."""
    center, outer, patch = (
        find(f"{corner.carrier}.{name}")[1] for name in (corner.wheel_center, corner.spin_axis, corner.contact_patch)
    )
    return Wheel(center, outer - center, concretely(_length, patch - center))


def _patch_arm(wheel: Wheel, quaternion):
    turned, zero = normalized(jnp.asarray(quaternion)), jnp.zeros(3)
    return wheel.patch_arm(BodyMotion(zero, turned, rotation_matrix(turned), zero, zero))


def _length(vector):
    vector = jnp.asarray(vector)
    return jnp.sqrt(vector @ vector)


def on_rig(scene: Scene, corner: Corner) -> Scene:
    """The scene on a rig at its design position: tyres taken off, a platform under the wheel, its steering held."""
    joints: dict[str, AbstractJoint] = {**scene.joints, PLATFORM: Platform(corner, jnp.zeros(()))}
    if corner.steering is not None:
        joints[corner.steering] = _held(joints[corner.steering])
    forces = {name: force for name, force in scene.forces.items() if not isinstance(force, Tyre)}
    forces[PATCH] = PatchLoads(corner, jnp.zeros(len(LOADS)))
    # Drift control is of motions; without its numbers all scenes of a kind are one program.
    return Scene(
        scene.bodies,
        joints,
        forces,
        gravity=scene.gravity,
        ground_points=scene.ground_points,
        drift=NoDriftControl(),
    )


def found_corner(scene: Scene, corner: Corner) -> Corner:
    """The corner with its steering axis, once all that it names is there.

    Raises:
        SceneError: for what the corner names and the scene has not.
    """
    remedy = "Say what is what with corner=sj.vehicle.Corner(...)"
    if corner.carrier not in scene.bodies:
        raise SceneError(
            f"rig: no body {corner.carrier!r} carries the wheel; {one_of(scene.bodies, corner.carrier)}. {remedy}"
        )
    points = scene.bodies[corner.carrier].points
    for name in (corner.wheel_center, corner.spin_axis, corner.contact_patch):
        if name not in points:
            raise SceneError(f"rig: body {corner.carrier!r} has no point {name!r}; {one_of(points, name)}. {remedy}")
    kingpin = _kingpin(scene, corner, remedy) if corner.kingpin is None else tuple(corner.kingpin)
    if len(kingpin) not in (0, 2):
        raise SceneError(f"rig: kingpin = {corner.kingpin!r} must be two points, or () for none. {remedy}")
    for name in kingpin:
        scene.find(name)
    if corner.steering is not None:
        driver = scene.joints.get(corner.steering)
        if driver is None:
            drivers = [n for n, j in scene.joints.items() if isinstance(j, TranslationDriver | RotationDriver)]
            raise SceneError(
                f"rig: there is no driver {corner.steering!r} that steers; {one_of(drivers, corner.steering)}. "
                f"{remedy}, with steering=None where nothing steers"
            )
        if not isinstance(driver, TranslationDriver | RotationDriver):
            raise SceneError(f"rig: {corner.steering!r} is no TranslationDriver and no RotationDriver. {remedy}")
    if corner.spring is not None and corner.spring not in scene.forces:
        listed = one_of(scene.forces, corner.spring)
        raise SceneError(f"rig: there is no force {corner.spring!r}; {listed}. {remedy}, with spring=None for none")
    return corner._replace(kingpin=kingpin)


def _kingpin(scene: Scene, corner: Corner, remedy: str) -> tuple[str, str]:
    points = scene.bodies[corner.carrier].points
    lower, upper = "lower_ball", "upper_ball"
    if lower in points and upper in points:
        return f"{corner.carrier}.{lower}", f"{corner.carrier}.{upper}"
    if lower in points and "strut_top" in scene.ground_points:
        return f"{corner.carrier}.{lower}", f"{GROUND}.strut_top"
    raise SceneError(
        f"rig: nothing says where the steering axis is: body {corner.carrier!r} has no points {lower!r} and {upper!r}. "
        f'{remedy}, e.g. kingpin=("upright.lower", "upright.upper"), or kingpin=() for none'
    )


def _held(driver: AbstractJoint) -> AbstractJoint:
    if isinstance(driver, TranslationDriver):
        return eqx.tree_at(lambda d: d.travel, driver, Constant(jnp.zeros(())))
    return eqx.tree_at(lambda d: d.angle, driver, Constant(jnp.zeros(())))


def platform_of(system: System) -> PlacedPlatform:
    """The platform of a system on the rig."""
    platform = system.joints[PLATFORM]
    assert isinstance(platform, PlacedPlatform)
    return platform


def with_inputs(system: System, inputs: Float[Array, " 6"]) -> System:
    """The system on a rig whose platform, rack and loads are those of `inputs`."""
    corner = platform_of(system).corner
    places: list[Any] = [lambda s: s.joints[PLATFORM].travel, lambda s: s.forces[PATCH].loads]
    values: list[Any] = [inputs[0], inputs[2:]]
    if corner.steering is not None:
        of_rack = hasattr(system.joints[corner.steering], "travel")
        places.append(lambda s: _function(s.joints[corner.steering], of_rack).value)
        values.append(inputs[1])
    system = eqx.tree_at(lambda s: s.stacks, system, None, is_leaf=lambda x: x is None)
    return eqx.tree_at(lambda s: [place(s) for place in places], system, values)


def _function(driver: Any, of_rack: bool) -> Any:
    return driver.travel if of_rack else driver.angle


def without_models(system: System) -> System:
    """The system with ideal joints, and all its forces: the geometry of the suspension."""
    ideal = {name: joint.as_if_ideal() for name, joint in system.joints.items()}
    joints = {name: joint for name, joint in ideal.items() if joint is not None}
    return System(system.bodies, joints, system.forces, system.gravity, system.drift, (), False)


def without_friction(system: System) -> System:
    """The system whose ideal joints have no friction: at rest it would hold anything within a band."""
    joints: Mapping[str, Any] = {
        name: joint.as_if_ideal() if joint.friction is not None else joint for name, joint in system.joints.items()
    }
    return eqx.tree_at(lambda s: s.joints, system, dict(joints))


def moved(positions: Float[Array, "b 3"], quaternions: Float[Array, "b 4"], steps: Float[Array, "b 6"]):
    """Positions and quaternions after small translations [m] and rotations [rad]."""
    half = 0.5 * steps[:, 3:]
    scalar = quaternions[:, :1] - jnp.sum(half * quaternions[:, 1:], 1, keepdims=True)
    vector = quaternions[:, 1:] + quaternions[:, :1] * half + jax.vmap(jnp.cross)(half, quaternions[:, 1:])
    turned = jnp.concatenate([scalar, vector], 1)
    return positions + steps[:, :3], turned / jnp.sqrt(jnp.sum(turned * turned, 1, keepdims=True))


def side_of(platform: PlacedPlatform) -> Scalar:
    """1 for a left corner, -1 for a right one."""
    return jnp.sign(jnp.asarray(platform.design_patch)[1])
