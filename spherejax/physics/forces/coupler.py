"""Couplers: a spring and a damper between the coordinates of two joints, as gears, belts and linkages have them.

A coordinate x is counted from the start of the motion: a length, or of a joint that turns its angle, or the arc on a
radius. With

    u = x_2 - ratio x_1 - offset,    f = k u + c u_rate

the force along x_2 is -f and the one along x_1 is ratio f, so that the power on the bodies is -f u_rate.
"""

import abc
from collections.abc import Mapping
from typing import Annotated, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from spherejax.foundations.checks import Requirement, concretely
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import two_names
from spherejax.foundations.legal import non_negative, positive
from spherejax.foundations.rotation import normalized, rotation_matrix
from spherejax.foundations.types import Named, Number, Numeric, Scalar, Triple, Unit
from spherejax.physics.bodies import GROUND, Body, numbers
from spherejax.physics.forces.base import UNITS, AbstractForce, FindPlace, Motions, Wrench, body_of, place_of
from spherejax.physics.forces.line import (
    Attachment,
    direction_on,
    is_direction,
    is_without_damping,
    line_requirements,
    start_quaternion,
    two_ends,
)
from spherejax.physics.forces.turns import TorsionalAttachment, Twist, attached
from spherejax.physics.functions.shapes import finite


class CoordinateMotion(NamedTuple):
    """How far a coordinate has gone.

    Attributes:
        value: x, 0 at the start [m or rad].
        rate: its time derivative [m/s or rad/s].
    """

    value: Scalar
    rate: Scalar


class AbstractCoordinate(eqx.Module):
    """How far one body has turned or slid against another: a length [m] with forces [N], or an angle with moments."""

    @property
    def is_angle(self) -> bool:
        """Whether it is an angle [rad], and efforts along it are moments [N m] (static)."""
        return False

    @property
    def part_units(self) -> Mapping[str, str]:
        """SI units of its position, its rate and the effort along it."""
        position, effort = ("rad", "N m") if self.is_angle else ("m", "N")
        return {"position": position, "rate": f"{position}/s", "effort": effort}

    @property
    @abc.abstractmethod
    def body_names(self) -> tuple[str, str]:
        """The two bodies."""

    @abc.abstractmethod
    def motion(self, motions: Motions) -> CoordinateMotion:
        """Value and rate of the placed coordinate."""

    @abc.abstractmethod
    def wrenches(self, motions: Motions, force: Scalar) -> dict[str, Wrench]:
        """Wrenches on both bodies of an effort along the coordinate [N or N m]: their power is effort times rate."""

    @abc.abstractmethod
    def placed(self, bodies: Mapping[str, Body], find: FindPlace) -> Self:
        """The same in body axes."""

    @abc.abstractmethod
    def requirements(self) -> list[Requirement]:
        """What its numbers must satisfy."""


class Turn(AbstractCoordinate):
    """The angle by which a body has turned against another since the start, as of a `TorsionalSpring`; or its arc.

    Without a radius it is an angle [rad], and efforts along it are moments [N m]. With a radius it is the arc on it
    [m], and efforts are forces [N] that act on this radius.

    Attributes:
        bodies: names of the two bodies; `"ground"` is one.
        axis: world axes at the start, any length; it turns with the first body.
        radius: on which an arc is measured, as a gear's pitch radius [m]; None, the default, for the angle.
        attachment: the geometry in body axes, once the scene is compiled.

    The angle goes on through any number of turns: an element with such a coordinate has an entry of the state for how
    far it has `turned` [rad]. Limits: as those of a `TorsionalSpring`.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    axis: Triple
    radius: Number | None
    attachment: TorsionalAttachment | None

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        axis: Annotated[Triple, Unit("1")],
        radius: Annotated[Number | None, Unit("m")] = None,
    ):
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.axis = numbers(axis)
        self.radius = radius
        self.attachment = None

    @property
    def body_names(self):
        """The two bodies."""
        return self.bodies

    @property
    def is_angle(self):
        """Without a radius."""
        return self.radius is None

    def motion(self, motions):
        """The angle or the arc, and its rate."""
        twist = self._twist(motions)
        if self.radius is None:
            return CoordinateMotion(twist.angle, twist.rate)
        return CoordinateMotion(self.radius * twist.angle, self.radius * twist.rate)

    def wrenches(self, motions, force):
        """A couple along the direction in which the twist grows."""
        effort = force if self.radius is None else self.radius * force
        moment = effort * self._twist(motions).direction
        return {self.bodies[0]: Wrench(jnp.zeros(3), -moment), self.bodies[1]: Wrench(jnp.zeros(3), moment)}

    def placed(self, bodies, find):
        """The axis and the relative orientation at the start, in body axes."""
        del find
        attachment = attached(bodies, self.bodies, self.axis)
        return eqx.tree_at(lambda turn: turn.attachment, self, attachment, is_leaf=lambda x: x is None)

    def _twist(self, motions: Motions) -> Twist:
        return known_geometry(self.attachment).twist(motions)

    def requirements(self):
        """Two bodies, an axis, a radius."""
        remedy = "Name two different bodies; 'ground' is one."
        return [
            Requirement("bodies", self.bodies, self.bodies[0] != self.bodies[1], "be two bodies", remedy),
            is_direction("axis", self.axis),
            *([] if self.radius is None else [positive("radius", self.radius, "m")]),
        ]


class AbstractStretch(AbstractCoordinate):
    """The change of a distance between points of two bodies since the start [m]."""

    ends: eqx.AbstractVar[tuple[str, str]]
    attachment: eqx.AbstractVar[Attachment | None]
    start: eqx.AbstractVar[Numeric | None]

    @property
    def body_names(self):
        """The two bodies."""
        return body_of(self.ends[0]), body_of(self.ends[1])

    def motion(self, motions):
        """The distance, less that of the start."""
        stretch = known_geometry(self.attachment).stretch(motions)
        return CoordinateMotion(stretch.length - known_geometry(self.start), stretch.rate)

    def wrenches(self, motions, force):
        """A force along the distance that lengthens it, and its opposite; of a `Travel` both at the second point."""
        attachment = known_geometry(self.attachment)
        return attachment.wrenches(motions, -force * attachment.stretch(motions).direction)

    def _attached(self, bodies: Mapping[str, Body], find: FindPlace, direction, distance, *axis) -> Self:
        """With its geometry: the points, a direction in the first body or none, and the distance at the start."""
        places = place_of(self.ends[0], find), place_of(self.ends[1], find)
        poses = [pose_at_start(bodies, name) for name in self.body_names]
        start = concretely(distance, *axis, *poses[0], places[0], *poses[1], places[1])
        return eqx.tree_at(
            lambda own: (own.attachment, own.start),
            self,
            (Attachment(self.body_names, places, direction), start),
            is_leaf=lambda x: x is None,
        )


class Travel(AbstractStretch):
    """The distance by which a point has moved along a direction of another body since the start [m].

    Attributes:
        ends: `"body.point"` of two points; `"body"` alone is its center of mass.
        direction: fixed in the first body, world axes at the start, any length.
        attachment: the geometry in body axes, once the scene is compiled.
        start: distance of the points along the direction at the start [m], once the scene is compiled.
    """

    ends: tuple[str, str] = eqx.field(static=True)
    direction: Triple
    attachment: Attachment | None
    start: Numeric | None

    def __init__(self, ends: Annotated[tuple[str, str], Named.ENDS], direction: Annotated[Triple, Unit("1")]):
        self.ends = two_ends(ends)
        self.direction = numbers(direction)
        self.attachment = None
        self.start = None

    def placed(self, bodies, find):
        """The points and the direction in body axes."""
        direction = concretely(direction_on, self.direction, start_quaternion(bodies, self.body_names[0]))
        return self._attached(bodies, find, direction, _distance, self.direction)

    def requirements(self):
        """Two bodies and a direction."""
        return line_requirements(self.ends, self.direction)


class Coupler(AbstractForce):
    """A spring and a damper that hold one joint's coordinate at a multiple of another's: gears, a belt, a linkage.

        u = x_2 - ratio x_1 - offset,    f = k u + c u_rate

    f resists the second coordinate, and ratio f drives the first. The stiffer, the closer to gears without play. Both u
    and f are in the units of the second coordinate: m and N, or rad and N m of a `Turn` without a radius.

        meshing = sj.forces.Coupler(
            sj.Turn(("housing", "pinion"), axis=(0, 0, 1), radius=0.02),
            sj.Turn(("housing", "wheel"), axis=(0, 0, 1), radius=0.06),
            ratio=-1.0, stiffness=1e7, damping=50.0,
        )

    What carries the bearings takes what the two moments do not balance: no force presses the wheels apart here.

    Attributes:
        first: the coordinate x_1, a `Turn` or a `Travel`.
        second: the coordinate x_2, a `Turn` or a `Travel`.
        ratio: of x_2 to x_1 [-, rad/m or m/rad]; -1 of wheels that mesh outside, 1 of a belt.
        stiffness: k [N/m or N m/rad].
        damping: c [N s/m or N m s/rad].
        offset: u = 0 where x_2 is this much more than ratio x_1 [m or rad].
    """

    first: AbstractCoordinate
    second: AbstractCoordinate
    ratio: Number
    stiffness: Number
    damping: Number
    offset: Number

    def __init__(
        self,
        first: AbstractCoordinate,
        second: AbstractCoordinate,
        ratio: Annotated[Number, Unit("{ratio}", "-, rad/m or m/rad")] = 1.0,
        stiffness: Annotated[Number, Unit("{stiffness}", "N/m or N m/rad")] = 0.0,
        damping: Annotated[Number, Unit("{damping}", "N s/m or N m s/rad")] = 0.0,
        offset: Annotated[Number, Unit("{second}", "m or rad")] = 0.0,
    ):
        self.first = first
        self.second = second
        self.ratio = ratio
        self.stiffness = stiffness
        self.damping = damping
        self.offset = offset

    @staticmethod
    def unit_words(first: AbstractCoordinate, second: AbstractCoordinate) -> dict[str, str]:
        """Units of its numbers by its coordinates."""
        one, other = first.part_units["position"], second.part_units["position"]
        stiffness, damping = ("N m/rad", "N m s/rad") if second.is_angle else ("N/m", "N s/m")
        ratio = "1" if one == other else f"{other}/{one}"
        return {"second": other, "ratio": ratio, "stiffness": stiffness, "damping": damping}

    @property
    def part_units(self) -> Mapping[str, str]:
        """Of the second coordinate."""
        units = self.second.part_units
        return {**UNITS, "lag": units["position"], "lag_rate": units["rate"], "force": units["effort"]}

    @property
    def never_adds_energy(self) -> bool:
        """It stores and dissipates."""
        return True

    @property
    def conserves_energy(self) -> bool:
        """Without damping."""
        return is_without_damping(self.damping)

    def _press(self, motions: Motions) -> tuple[Scalar, Scalar, Scalar]:
        """u [m or rad], its rate, and f [N or N m]."""
        first, second = self.first.motion(motions), self.second.motion(motions)
        u = second.value - self.ratio * first.value - self.offset
        rate = second.rate - self.ratio * first.rate
        return u, rate, self.stiffness * u + self.damping * rate

    def wrenches(self, t, motions):
        """Of both coordinates, added up where they share a body."""
        del t
        force = self._press(motions)[2]
        return coupled_wrenches(self.first, self.second, motions, self.ratio * force, -force)

    def potential_energy(self, t, motions):
        """k u^2/2 [J]."""
        del t
        u = self._press(motions)[0]
        return 0.5 * self.stiffness * u * u

    def parts(self, t, motions) -> dict[str, Array]:
        """`lag` u [m or rad], `lag_rate`, `force` f [N or N m], `dissipated_power` [W]."""
        del t
        u, rate, force = self._press(motions)
        return {"lag": u, "lag_rate": rate, "force": force, "dissipated_power": self.damping * rate * rate}

    def placed(self, bodies, find):
        """Both coordinates in body axes."""
        placed = self.first.placed(bodies, find), self.second.placed(bodies, find)
        return eqx.tree_at(lambda force: (force.first, force.second), self, placed)

    def requirements(self) -> list[Requirement]:
        """Two coordinates, k >= 0, c >= 0, finite numbers."""
        units = self.unit_words(self.first, self.second)
        return [
            *coupled_requirements(self.first, self.second),
            finite("ratio", self.ratio),
            non_negative("stiffness", self.stiffness, units["stiffness"]),
            non_negative("damping", self.damping, units["damping"]),
            finite("offset", self.offset),
        ]

    @property
    def body_names(self) -> tuple[str, ...]:
        """The bodies of both coordinates, each once."""
        return tuple(dict.fromkeys((*self.first.body_names, *self.second.body_names)))


def coupled_wrenches(
    first: AbstractCoordinate, second: AbstractCoordinate, motions: Motions, on_first: Scalar, on_second: Scalar
) -> dict[str, Wrench]:
    """Wrenches of an effort along each of two coordinates [N or N m], added up where they share a body."""
    found = dict(first.wrenches(motions, on_first))
    for name, wrench in second.wrenches(motions, on_second).items():
        there = found.get(name, Wrench(jnp.zeros(3), jnp.zeros(3)))
        found[name] = Wrench(there.force + wrench.force, there.moment + wrench.moment)
    return found


def coupled_requirements(first: AbstractCoordinate, second: AbstractCoordinate) -> list[Requirement]:
    """Those of two coordinates, in the fields `first` and `second`."""
    return [
        required._replace(field=f"{field}.{required.field}")
        for field, coordinate in (("first", first), ("second", second))
        for required in coordinate.requirements()
    ]


def known_geometry(part):
    """A part that is there once the scene is compiled."""
    if part is None:
        raise SceneError("the element is not in a scene yet: its geometry is known once the scene is compiled")
    return part


def pose_at_start(bodies: Mapping[str, Body], name: str) -> tuple[Numeric, Numeric]:
    """Position [m] and orientation of a body, the ground included, as the scene describes it."""
    if name == GROUND:
        return numbers((0.0, 0.0, 0.0)), numbers((1.0, 0.0, 0.0, 0.0))
    return bodies[name].position, bodies[name].quaternion


def _distance(direction, first, first_quaternion, first_place, second, second_quaternion, second_place):
    """How far the second point is from the first one along a direction, world axes [m]."""
    start = first + rotation_matrix(normalized(first_quaternion)) @ first_place
    end = second + rotation_matrix(normalized(second_quaternion)) @ second_place
    return (end - start) @ direction / jnp.sqrt(direction @ direction)
