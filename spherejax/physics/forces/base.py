"""What a force element is: wrenches on bodies as a function of time and motion."""

import abc
from collections.abc import Callable, Mapping
from typing import NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import Numeric, Scalar, Vector3
from spherejax.physics.bodies import Body
from spherejax.physics.kinematics import BodyMotion
from spherejax.physics.memory import MemoryEntry
from spherejax.physics.renamed import by_new_name, take_old_name

Motions = Mapping[str, BodyMotion]
"""The motion of every body by name, the ground included."""

FindPlace = Callable[[str], tuple[str, Numeric]]
"""Resolves `"body.point"` to the body's name and the point in body axes [m]."""

UNITS = {
    "effort": "N",
    "position": "m",
    "length": "m",
    "rate": "m/s",
    "force": "N",
    "moment": "N m",
    "angle": "rad",
    "angular_rate": "rad/s",
    "depth": "rad",
    "torque": "N m",
    "load": "N",
    "lag": "m",
    "lag_rate": "m/s",
    "compression": "m",
    "compression_rate": "m/s",
    "road_position": "m",
    "road_height": "m",
    "road_rate": "m/s",
    "road_power": "W",
    "dissipated_power": "W",
    "power": "W",
    "potential_energy": "J",
}
"""Units of the results that force elements report, by name."""


class Wrench(NamedTuple):
    """A force and a moment on a body.

    Attributes:
        force: world axes [N].
        moment: about the center of mass, world axes [N m].
    """

    force: Vector3
    moment: Vector3


class Touch(NamedTuple):
    """How deep a surface is pressed in that presses back and never pulls.

    Attributes:
        depth: [m or rad], negative without a touch; a smooth function of time.
        rate: its time derivative.
    """

    depth: Scalar
    rate: Scalar


class AbstractForce(eqx.Module):
    """A force element. One of your own is `wrenches` in `jnp`, and `potential_energy` if it has one:

        class Attraction(sj.forces.AbstractForce):
            strength: float  # N m

            @property
            def body_names(self):
                return ("ball",)

            def wrenches(self, t, motions):
                r = motions["ball"].position
                return {"ball": sj.forces.Wrench(-self.strength * r / (0.01 + r @ r), jnp.zeros(3))}

            def potential_energy(self, t, motions):
                r = motions["ball"].position
                return 0.5 * self.strength * jnp.log(0.01 + r @ r)

    Numbers in it are leaves: they can be swept, batched and differentiated. Operations between elements, `jnp.where`,
    `@` and `jnp.cross` keep a scene fast; others work, on array code, with a warning.
    """

    @abc.abstractmethod
    def wrenches(self, t: Scalar, motions: Motions) -> dict[str, Wrench]:
        """The wrench on each body that the element acts on, by name; one on the ground is left out of account.

        Args:
            t: time [s].
            motions: motion of every body, the ground included.
        """

    def potential_energy(self, t: Scalar, motions: Motions) -> Scalar:
        """Energy stored in the element [J]; zero unless the element says otherwise."""
        del t, motions
        return jnp.zeros(())

    @property
    def never_adds_energy(self) -> bool:
        """Whether the element only stores and dissipates, and reports all that it stores (static).

        Every run checks that the energy of the parts that say so rises by no more than all others put in, whose work
        is integrated beside the state.
        """
        return False

    @property
    def conserves_energy(self) -> bool:
        """Whether the element's work is exactly the change of its `potential_energy`: nothing is dissipated (static).

        Where all parts say so, or have their work integrated beside the state, every run checks that the energy
        does not fall, either. An element that says nothing may dissipate.
        """
        return False

    @property
    def is_motor(self) -> bool:
        """Whether the element is there to move bodies (static): on bodies that cannot move, `sj.simulate` warns."""
        return False

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """What the element remembers (static); one that does is an `AbstractForceWithMemory`."""
        return ()

    @property
    def n_touches(self) -> int:
        """Number of surfaces that the element presses on from one side (static)."""
        return 0

    def touches(self, t: Scalar, motions: Motions) -> tuple[Touch, ...]:
        """How deep each of those surfaces is pressed in; a step ends where one begins or ceases to press.

        Without it a touch that is shorter than a step can be missed.
        """
        del t, motions
        return ()

    @property
    def force_at_touch(self) -> Scalar | None:
        """The force that is there at once where a touch begins; None where it surely grows from zero.

        Derivatives of runs do not go through a force that jumps; see `spherejax.motion.derivatives.through_touches`.
        """
        return None

    def time_to_breakpoint(self, t: Scalar, motions: Motions) -> Scalar | None:
        """How soon [s] something comes that a longer step could pass over, such as a bump; None if nothing is known."""
        del t, motions
        return None

    def room(self, t: Scalar, motions: Motions) -> Scalar | None:
        """The earlier name of `time_to_breakpoint`; a class that overrides it is served, with a warning."""
        return by_new_name(self, "room", "time_to_breakpoint")(t, motions)

    def __init_subclass__(cls, **settings):
        super().__init_subclass__(**settings)
        take_old_name(cls, "room", "time_to_breakpoint")

    def unknown_in_time(self, t: Scalar, motions: Motions) -> tuple[tuple[Array, str], ...]:
        """Values that follow functions of time of which nothing is known, each with its unit "N", "N m", "m" or "1".

        They are looked at between the stages of each step, so that no pulse of a twenty-thousandth of the motion is
        passed over; of a class of the user's own these are all wrenches. What is shorter can be missed, unless
        `time_to_breakpoint` says where it begins and ends.
        """
        return all_of(self.wrenches(t, motions)) if is_users_own(self) else ()

    def parts(self, t: Scalar, motions: Motions) -> dict[str, Array]:
        """Named results for inspection, e.g. `length` [m], `force` [N]; see `Trajectory.force`."""
        del t, motions
        return {}

    @property
    def part_units(self) -> Mapping[str, str]:
        """Units of these results by name, for tables and files (static)."""
        return UNITS

    def placed(self, bodies: Mapping[str, Body], find: FindPlace) -> Self:
        """The same element with named points and directions at the start resolved into body axes.

        Args:
            bodies: the scene's bodies by name.
            find: resolves `"body.point"`.
        """
        del bodies, find
        return self

    def requirements(self) -> list[Requirement]:
        """What the element's numbers must satisfy."""
        return []

    @property
    def body_names(self) -> tuple[str, ...]:
        """Bodies that the element names, checked against the scene."""
        return ()


def is_users_own(force: AbstractForce) -> bool:
    """Whether the class of an element is not one of this package (static)."""
    return not type(force).__module__.startswith("spherejax.")


def all_of(wrenches: Mapping[str, Wrench]) -> tuple[tuple[Array, str], ...]:
    """Forces and moments with their units."""
    return tuple(pair for each in wrenches.values() for pair in ((each.force, "N"), (each.moment, "N m")))


def power_on_bodies(wrenches: Mapping[str, Wrench], motions: Motions) -> Scalar:
    """Power that wrenches put into the bodies [W]."""
    total = jnp.zeros(())
    for name, wrench in wrenches.items():
        motion = motions[name]
        total = total + wrench.force @ motion.velocity + wrench.moment @ motion.angular_velocity
    return total


def body_of(name: str) -> str:
    """The body in `"body.point"` or `"body"`."""
    return name.partition(".")[0]


def place_of(name: str, find: FindPlace) -> Numeric:
    """The place that `"body.point"` names, in body axes [m]; `"body"` alone is its center of mass."""
    return find(name)[1] if "." in name else np.zeros(3)
