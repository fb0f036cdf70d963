"""Efforts along a coordinate as functions of time, or as samples of a signal: motors, hydraulic cylinders, shakers.

A coordinate is a `Turn` about an axis, a `Travel` along a direction, or an `Extension` between two points, counted from
the start of the motion. Along a `Turn` it is an angle in rad, and efforts are moments in N m; along the others, and
along a `Turn` on a radius, it is a length in m, and efforts are forces in N.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric
from spherejax.foundations.numerics import CONCENTRIC_RADIUS
from spherejax.foundations.rotation import normalized, rotation_matrix
from spherejax.foundations.types import Function, Listed, Named, Number, Numeric, Scalar, Unit
from spherejax.physics.bodies import Body, numbers
from spherejax.physics.forces.base import UNITS, AbstractForce, FindPlace
from spherejax.physics.forces.coupler import AbstractCoordinate, AbstractStretch
from spherejax.physics.forces.line import Attachment, two_ends
from spherejax.physics.forces.remembering import AbstractForceWithMemory, ForceAction, Instants
from spherejax.physics.functions.base import AbstractFunction, function_requirements
from spherejax.physics.functions.shapes import finite, function_or_constant
from spherejax.physics.memory import MemoryEntry, Scale


class Extension(AbstractStretch):
    """How much farther two points are from each other than at the start [m]: the stroke of a cylinder.

    It is 0 at the start: a reference of 0 holds the start's length, and one of 0.02 lengthens it by 20 mm. For a length
    L give L less the distance at the start, which is `start` of the compiled coordinate.

    Attributes:
        ends: `"body.point"` of two points; `"body"` alone is its center of mass.
        attachment: the geometry in body axes, once the scene is compiled.
        start: distance of the points at the start [m], once the scene is compiled.

    Limits: points that meet have no line between them; forces stay finite there.
    """

    ends: tuple[str, str] = eqx.field(static=True)
    attachment: Attachment | None
    start: Numeric | None

    def __init__(self, ends: Annotated[tuple[str, str], Named.ENDS]):
        self.ends = two_ends(ends)
        self.attachment = None
        self.start = None

    def placed(self, bodies, find):
        """The points in body axes."""
        return self._attached(bodies, find, None, _distance)

    def requirements(self):
        """Two bodies."""
        first, second = self.body_names
        remedy = "Name points of two different bodies; 'ground' is one."
        return [Requirement("ends", self.ends, first != second, "be on two bodies", remedy)]


class AbstractMotor(AbstractForce):
    """What actuators and controllers share: they drive a coordinate, whose units are theirs."""

    coordinate: eqx.AbstractVar[AbstractCoordinate]

    @staticmethod
    def unit_words(coordinate: AbstractCoordinate) -> dict[str, str]:
        """Units of its numbers by its coordinate."""
        return dict(coordinate.part_units)

    @property
    def part_units(self) -> Mapping[str, str]:
        """Those of the coordinate."""
        return {**UNITS, **self.coordinate.part_units}

    @property
    def is_motor(self) -> bool:
        """It moves its coordinate."""
        return True

    @property
    def body_names(self) -> tuple[str, ...]:
        """The bodies of the coordinate."""
        return self.coordinate.body_names

    def placed(self, bodies: Mapping[str, Body], find: FindPlace) -> Self:
        """The coordinate in body axes."""
        return eqx.tree_at(lambda own: own.coordinate, self, self.coordinate.placed(bodies, find))


class Actuator(AbstractMotor):
    """An effort along a coordinate as a function of time: a motor's torque, a cylinder's force.

        f = effort(t) + offset

    positive where it makes the coordinate grow.

        sj.Actuator(sj.Turn(("ground", "rotor"), axis=(0, 0, 1)), effort=sj.functions.SmoothStep(0.0, 0.1, 0.0, 2.0))

    Attributes:
        coordinate: a `Turn`, a `Travel` or an `Extension`.
        effort: f [N or N m] by time [s]: a number, `Table`, `Sine`, any function of one number. Steps of the
            integration end where a function says that it begins, ends or turns.
        offset: a number that is added [N or N m]; an input for `sj.linearize` about a motion that the function drives.

    Limits: a pulse of a function of one's own that is shorter than 1/20,000 of the motion can be passed over; declare
    it by the breaks of a `Piecewise`, where steps end: `sj.functions.Piecewise([0.4, 0.40001], [f, f, f])`.
    """

    coordinate: AbstractCoordinate
    effort: AbstractFunction
    offset: Number

    def __init__(
        self,
        coordinate: AbstractCoordinate,
        effort: Annotated[Number | Callable, Unit("{effort}", "N or N m"), Function("s", "{effort}", "N or N m")] = 0.0,
        offset: Annotated[Number, Unit("{effort}", "N or N m")] = 0.0,
    ):
        self.coordinate = coordinate
        self.effort = function_or_constant(effort)
        self.offset = offset

    def _force(self, t: Scalar) -> Scalar:
        return self.effort(t) + self.offset

    def wrenches(self, t, motions):
        """Of the coordinate."""
        return self.coordinate.wrenches(motions, self._force(t))

    def parts(self, t, motions) -> dict[str, Array]:
        """`effort` [N or N m]; `position` [m or rad] and `rate` of the coordinate."""
        motion = self.coordinate.motion(motions)
        return {"effort": self._force(t), "position": motion.value, "rate": motion.rate}

    def unknown_in_time(self, t, motions):
        """The effort, where it is a function of one's own that does not say where it turns."""
        del motions
        return ((self.effort(t), self.coordinate.part_units["effort"]),) if self.effort.is_unknown else ()

    def time_to_breakpoint(self, t, motions):
        """To where the effort begins, ends or turns."""
        del motions
        return self.effort.distance_to_breakpoint(t, True)

    def requirements(self) -> list[Requirement]:
        """A coordinate, a function, a finite number."""
        return [
            *coordinate_requirements(self.coordinate),
            *function_requirements("effort", self.effort),
            finite("offset", self.offset),
        ]


class SampledActuator(AbstractMotor, AbstractForceWithMemory):
    """An effort along a coordinate that is given as samples of a signal: held between them, or in straight lines.

    Steps of the integration end on the samples, and what happens at one is not felt before it. Their number does not
    slow down a step's evaluations, as points of a `Table` do.

        sj.forces.SampledActuator(sj.Travel(("ground", "table"), (1, 0, 0)), times=t, values=measured)

    Attributes:
        coordinate: a `Turn`, a `Travel` or an `Extension`.
        times: of the samples, increasing [s], shape (n,).
        values: the efforts there [N or N m], shape (n,).
        linear: whether to go in straight lines from sample to sample; else the last one is held.

    Before the first sample the effort is nothing, behind the last one it stays.
    """

    coordinate: AbstractCoordinate
    times: Numeric
    values: Numeric
    linear: bool = eqx.field(static=True)

    def __init__(
        self,
        coordinate: AbstractCoordinate,
        times: Annotated[Listed, Unit("s")],
        values: Annotated[Listed, Unit("{effort}", "N or N m")],
        linear: bool = False,
    ):
        self.coordinate = coordinate
        self.times = numbers(times)
        self.values = numbers(values)
        self.linear = linear

    @property
    def memory(self):
        """The effort at the last sample; its slope and instant, where lines are drawn."""
        unit, scale = effort_entry(self.coordinate)
        lines = MemoryEntry("slope", f"{unit}/s", 1.0), MemoryEntry("since", "s", 1.0)
        return MemoryEntry("effort", unit, scale), *(lines if self.linear else ())

    @property
    def sampling(self):
        """At the given times."""
        return Instants(self.times)

    def sampled(self, t, motions, memory):
        """The value of the sample at t."""
        del motions, memory
        here = self.sampling.number_at(t) == np.arange(np.shape(self.times)[0])
        value = _chosen(here, self.values)
        if not self.linear:
            return value[None]
        times, values = jnp.asarray(self.times), jnp.asarray(self.values)
        slopes = jnp.concatenate([(values[1:] - values[:-1]) / (times[1:] - times[:-1]), jnp.zeros(1)])
        return jnp.stack([value, _chosen(here, slopes), _chosen(here, times)])

    def action(self, t, motions, memory):
        """Of the coordinate; parts as of an `Actuator`."""
        effort = memory[0] + memory[1] * (t - memory[2]) if self.linear else memory[0]
        motion = self.coordinate.motion(motions)
        parts = {"effort": effort, "position": motion.value, "rate": motion.rate}
        return ForceAction(self.coordinate.wrenches(motions, effort), jnp.zeros(len(memory)), parts=parts)

    def requirements(self) -> list[Requirement]:
        """A coordinate, and as many values as increasing times."""
        return [*coordinate_requirements(self.coordinate), *_sample_requirements(self.times, self.values)]


def effort_entry(coordinate: AbstractCoordinate) -> tuple[str, Scale]:
    """The unit of an effort that is remembered, and what its errors are judged by."""
    return coordinate.part_units["effort"], "moment" if coordinate.is_angle else "force"


def coordinate_requirements(coordinate: AbstractCoordinate) -> list[Requirement]:
    """Of the field `coordinate`."""
    return [each._replace(field=f"coordinate.{each.field}") for each in coordinate.requirements()]


def _sample_requirements(times, values) -> list[Requirement]:
    times, values = numeric(times), numeric(values)
    if times.ndim != 1 or times.shape != values.shape or times.shape[0] < 1:
        expected = "be a list of one or more numbers, as many as values"
        return [Requirement("times", times, False, expected, "Give one value for each time.")]
    increase = (times[1:] > times[:-1]).all() & (abs(times) < np.inf).all()
    return [
        Requirement("times", times, increase, "increase and be finite", "Sort the samples and leave out doubles."),
        Requirement("values", values, abs(values) < np.inf, "be finite", "Check the signal."),
    ]


def _chosen(here: Array, values) -> Scalar:
    return jnp.sum(jnp.where(here, jnp.asarray(values), 0.0))


def _distance(first, first_quaternion, first_place, second, second_quaternion, second_place):
    """Of two points at the start [m]."""
    start = first + rotation_matrix(normalized(first_quaternion)) @ first_place
    end = second + rotation_matrix(normalized(second_quaternion)) @ second_place
    return jnp.sqrt((end - start) @ (end - start) + CONCENTRIC_RADIUS**2)
