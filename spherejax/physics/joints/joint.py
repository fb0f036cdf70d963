"""Places: which two bodies meet, and where. The place is a joint's geometry; how it resists is its model.

A joint as the user describes it names points, or gives points and axes in world axes at the start; a *placed* joint
carries the same geometry in body axes, ready for the equations of motion. A joint of one's own is a pair of them.
"""

import abc
from collections.abc import Callable, Mapping
from typing import ClassVar, Self

import equinox as eqx

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import Numeric, Scalar
from spherejax.physics.bodies import Body
from spherejax.physics.functions.base import AbstractFunction
from spherejax.physics.joints.reaction_friction import AbstractJointFriction
from spherejax.physics.joints.rows import ConstraintRows
from spherejax.physics.kinematics import BodyMotion
from spherejax.physics.memory import MemoryEntry

Motions = Mapping[str, BodyMotion]
"""The motion of every body by name, the ground included."""

FindPlace = Callable[[str], tuple[str, Numeric]]
"""Resolves `"body.point"` to the body's name and the point in body axes [m]."""


class AbstractPlacedJoint(eqx.Module):
    """A joint between two named bodies, with its geometry in body axes.

    Attributes:
        bodies: names of the two bodies.
        is_driven: whether its equations depend on time (static).
        effort_unit: SI unit of what a driver drives with, a moment or a force (static).
    """

    bodies: eqx.AbstractVar[tuple[str, str]]
    is_driven: ClassVar[bool] = False
    effort_unit: ClassVar[str] = "N"

    @property
    @abc.abstractmethod
    def points(self) -> tuple[Numeric, Numeric]:
        """The joint's point on each body, body axes [m]; reactions are about the second one."""

    @property
    @abc.abstractmethod
    def n_rows(self) -> int:
        """Number of constraint equations (static)."""

    @abc.abstractmethod
    def constraint_rows(self, t: Scalar, motions: Motions) -> ConstraintRows | None:
        """The joint's constraint equations at time t [s], or None."""

    @property
    def functions_of_time(self) -> tuple[AbstractFunction, ...]:
        """What a driver prescribes, by time [s]."""
        return ()

    def assembly_rows(self, t: Scalar, motions: Motions) -> ConstraintRows | None:
        """The equations that a consistent start satisfies, or None; the constraint equations unless told otherwise."""
        return self.constraint_rows(t, motions)

    @property
    def answers_with_force(self) -> bool:
        """Whether the joint answers a relative motion with a force, by a model (static)."""
        return False

    @property
    def friction(self) -> AbstractJointFriction | None:
        """Friction by the joint's reaction; None for a joint without."""
        return None

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """What the joint remembers (static); empty without memory."""
        return () if self.friction is None else self.friction.memory

    @property
    def never_adds_energy(self) -> bool:
        """Whether the joint only stores and dissipates, and reports all that it stores (static)."""
        return not self.is_driven and (self.friction is None or self.friction.model.never_adds_energy)

    @property
    def conserves_energy(self) -> bool:
        """Whether the joint does no work on the bodies: it constrains, without friction (static)."""
        return not (self.is_driven or self.answers_with_force) and self.friction is None

    def as_if_ideal(self) -> "Self | AbstractPlacedJoint | None":
        """The joint for assembly, without a model; None for one that leaves the start alone."""
        return self


class AbstractPlacedAtPoints(AbstractPlacedJoint):
    """A placed joint that keeps its point on each body.

    Attributes:
        places: the joint's point on each body, body axes [m].
    """

    places: eqx.AbstractVar[tuple[Numeric, Numeric]]

    @property
    def points(self) -> tuple[Numeric, Numeric]:
        """The point on each body."""
        return self.places


class AbstractJoint(eqx.Module):
    """A joint as the user describes it."""

    @abc.abstractmethod
    def joined(self, find: FindPlace) -> tuple[str, str]:
        """Names of the two bodies that it joins."""

    @abc.abstractmethod
    def placed(self, bodies: Mapping[str, Body], find: FindPlace) -> AbstractPlacedJoint:
        """The same joint with its geometry in body axes."""

    @abc.abstractmethod
    def requirements(self) -> list[Requirement]:
        """What the joint's numbers must satisfy."""

    def as_described(self) -> "AbstractJoint":
        """The joint without a concentric start of its model: a start that the load has pressed stays so."""
        return self


class AbstractPairJoint(AbstractJoint):
    """A joint that names its two bodies; what is fixed in the first one guides the second."""

    bodies: eqx.AbstractVar[tuple[str, str]]

    def joined(self, find):
        """The two bodies."""
        del find
        return self.bodies
