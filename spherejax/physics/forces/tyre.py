"""A tyre on a road whose height is a function: it presses the wheel up where it is pressed in.

The road passes below: with the speed v of the vehicle, which its model leaves out, the wheel's center is above

    x_B = v t + x,    compression = radius - (z - z_road(x_B, t))

with x forward and z up.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.foundations.checks import Requirement
from spherejax.foundations.errors import SceneError
from spherejax.foundations.legal import positive
from spherejax.foundations.types import Function, Named, Number, Numeric, Scalar, Unit, Vector3
from spherejax.physics.bodies import GROUND, Body
from spherejax.physics.forces.base import AbstractForce, FindPlace, Motions, Touch, Wrench, body_of, place_of
from spherejax.physics.forces.one_sided import OneSided
from spherejax.physics.functions.base import AbstractFunction, Given, as_function, function_requirements
from spherejax.physics.functions.shapes import finite
from spherejax.physics.kinematics import PointMotion, point_motion


class Tread(NamedTuple):
    """How a tyre meets the road.

    Attributes:
        center: motion of the wheel's center.
        compression: [m], negative off the road.
        compression_rate: [m/s].
        road_position: x_B [m].
        road_height: z_road [m].
        road_rate: rate of the road's height below the wheel [m/s].
        road_slope: dz_road/dx.
    """

    center: PointMotion
    compression: Scalar
    compression_rate: Scalar
    road_position: Scalar
    road_height: Scalar
    road_rate: Scalar
    road_slope: Scalar


class Tyre(AbstractForce):
    """A tyre as a spring and a damper between the wheel's center and the road; it never holds the wheel down.

    The load is the law of `spherejax.physics.forces.one_sided` with the compression p as depth:

        f = max(0, k p + spring(p) + rise(p) (c p_rate + damper(p_rate)))    (k ramp(p) with an onset)

    and acts at the wheel's center, upwards, without a moment. There is no longitudinal and no lateral force.

    Attributes:
        center: `"body.point"` of the wheel's center; `"body"` alone is its center of mass.
        radius: of the unloaded tyre [m].
        stiffness: k [N/m].
        damping: c [N s/m]; it needs an onset.
        onset: compression over which stiffness and damping build up [m]; 0 by default: the stiffness is there at once.
        spring: load [N] by compression [m]; any function of one number.
        damper: load [N] by compression rate [m/s]; any function of one number.
        road: height z [m] by x [m]: `Bump`, `Sine`, `Table`, ..., or a function of your own of x and t; None: flat at
            z = 0.
        speed: v [m/s], with which the road passes below towards -x.
        normal_to_road: whether the force is normal to the road: the load upwards, and slope times the load backwards,
            which is what a wheel on a slope without friction feels. Otherwise it is vertical on any slope.

    The road does work, `road_power`: with what the tyre stores and dissipates it closes the balance of powers.
    """

    center: str = eqx.field(static=True)
    radius: Number
    stiffness: Number
    damping: Number
    onset: Number
    spring: AbstractFunction | None
    damper: AbstractFunction | None
    road: AbstractFunction | Given | None
    speed: Number
    normal_to_road: bool = eqx.field(static=True)
    place: Numeric | None

    def __init__(
        self,
        center: Annotated[str, Named.END],
        radius: Annotated[Number, Unit("m")],
        stiffness: Annotated[Number, Unit("N/m")] = 0.0,
        damping: Annotated[Number, Unit("N s/m")] = 0.0,
        onset: Annotated[Number, Unit("m")] = 0.0,
        *,
        spring: Annotated[Callable | None, Function("m", "N")] = None,
        damper: Annotated[Callable | None, Function("m/s", "N")] = None,
        road: Annotated[Callable | None, Function("m", "m")] = None,
        speed: Annotated[Number, Unit("m/s")] = 0.0,
        normal_to_road: bool = False,
    ):
        self.center = center
        self.radius = radius
        self.stiffness = stiffness
        self.damping = damping
        self.onset = onset
        self.spring = as_function(spring)
        self.damper = as_function(damper)
        self.road = road if road is None or isinstance(road, AbstractFunction | Given) else _given_road(road)
        self.speed = speed
        self.normal_to_road = normal_to_road
        self.place = None

    def tread(self, t: Scalar, motions: Motions) -> Tread:
        """Where the tyre meets the road."""
        if self.place is None:
            raise SceneError("the tyre is not in a scene yet: its place is known once the scene is compiled")
        center = point_motion(motions[body_of(self.center)], jnp.asarray(self.place))
        time = jnp.asarray(t, jnp.float64)
        x = self.speed * time + center.position[0]
        one, zero = jnp.ones(()), jnp.zeros(())
        height, slope = jax.jvp(self._road_height, (x, time), (one, zero))
        _, rate = jax.jvp(self._road_height, (x, time), (self.speed + center.velocity[0], one))
        compression = self.radius - (center.position[2] - height)
        return Tread(center, compression, rate - center.velocity[2], x, height, rate, slope)

    def wrenches(self, t, motions):
        """The load on the wheel."""
        tread = self.tread(t, motions)
        load = self._law.press(tread.compression, tread.compression_rate).force
        force = load * self._direction(tread.road_slope)
        return {body_of(self.center): Wrench(force, jnp.cross(tread.center.arm, force))}

    @property
    def never_adds_energy(self) -> bool:
        """On a flat road, with numbers for damping, and a spring that knows its integral."""
        return self.road is None and self._law.never_adds_energy

    @property
    def conserves_energy(self) -> bool:
        """Without damping, and without a spring function, which may pull: a tyre only presses."""
        return self.road is None and self._law.conserves_energy

    @property
    def force_at_touch(self) -> Scalar | None:
        """That of the law [N]."""
        return self._law.force_at_touch

    @property
    def n_touches(self) -> int:
        """The road."""
        return 1

    def time_to_breakpoint(self, t, motions):
        """To where the road begins, ends or turns, at the speed of now."""
        if not isinstance(self.road, AbstractFunction):
            return None
        tread = self.tread(t, motions)
        rate = self.speed + tread.center.velocity[0]
        distance = self.road.distance_to_breakpoint(tread.road_position, rate >= 0)
        return None if distance is None else distance / jnp.maximum(jnp.abs(rate), 1e-300)

    def touches(self, t, motions):
        """How deep the tyre is pressed in."""
        tread = self.tread(t, motions)
        return (Touch(tread.compression, tread.compression_rate),)

    def potential_energy(self, t, motions):
        """Energy stored in the tyre [J]."""
        tread = self.tread(t, motions)
        return self._law.press(tread.compression, tread.compression_rate).energy

    def parts(self, t, motions) -> dict[str, Array]:
        """`load` [N] (vertical), `compression` [m], its rate, the road below the wheel, `dissipated_power` [W]."""
        tread = self.tread(t, motions)
        press = self._law.press(tread.compression, tread.compression_rate)
        # A force normal to the road does no work on a wheel that moves along a road at rest.
        along = tread.road_slope * tread.center.velocity[0] if self.normal_to_road else 0.0
        return {
            "load": press.force,
            "compression": tread.compression,
            "compression_rate": tread.compression_rate,
            "road_position": tread.road_position,
            "road_height": tread.road_height,
            "road_rate": tread.road_rate,
            "road_power": press.force * (tread.road_rate - along),
            "dissipated_power": (press.force - press.elastic) * tread.compression_rate,
        }

    def placed(self, bodies: Mapping[str, Body], find: FindPlace) -> Self:
        """The wheel's center in body axes."""
        del bodies
        place = place_of(self.center, find)
        return eqx.tree_at(lambda force: force.place, self, place, is_leaf=lambda x: x is None)

    def requirements(self) -> list[Requirement]:
        """A positive radius, a finite speed, and what law and functions require."""
        remedy = "Name a point of a moving body."
        road = self.road if isinstance(self.road, AbstractFunction) else None
        return [
            Requirement("center", self.center, body_of(self.center) != GROUND, "be on a moving body", remedy),
            positive("radius", self.radius, "m"),
            finite("speed", self.speed),
            *self._law.requirements(),
            *function_requirements("road", road),
        ]

    @property
    def body_names(self) -> tuple[str, str]:
        """The wheel, and the ground that carries the road."""
        return body_of(self.center), GROUND

    @property
    def _law(self) -> OneSided:
        return OneSided(self.stiffness, self.damping, self.spring, self.damper, self.onset)

    def road_heights(self, x, t) -> np.ndarray:
        """Height of the road [m] below places x [m] of the scene at a time t [s]; shape of `x`."""
        below = jnp.asarray(x, jnp.float64) + self.speed * t
        return np.asarray(jax.vmap(lambda one: self._road_height(one, jnp.asarray(t, jnp.float64)))(below))

    def _road_height(self, x: Scalar, t: Scalar) -> Scalar:
        if self.road is None:
            return jnp.zeros(())
        height = self.road(x) if isinstance(self.road, AbstractFunction) else self.road(x, t)
        return jnp.asarray(height, jnp.float64)

    def _direction(self, slope: Scalar) -> Vector3:
        if self.normal_to_road:
            return jnp.stack([-slope, jnp.zeros(()), jnp.ones(())])
        return jnp.asarray(np.array([0.0, 0.0, 1.0]))


def _given_road(road: Callable) -> Given:
    if not callable(road):
        raise SceneError(f"road = {road!r} is no function; give Bump(...), Table(x, z), or a function of x and t")
    return Given(road)
