"""What a force element is: wrenches on bodies as a function of time and motion."""

import abc
from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import Scalar, Vector3
from spherejax.physics.kinematics import BodyMotion


class Wrench(NamedTuple):
    """A force and a moment on a body.

    Attributes:
        force: world axes [N].
        moment: about the center of mass, world axes [N m].
    """

    force: Vector3
    moment: Vector3


class AbstractForce(eqx.Module):
    """A force element; a user's own implements `wrenches` in array code, and `potential_energy` if it has one."""

    @abc.abstractmethod
    def wrenches(self, t: Scalar, motions: Mapping[str, BodyMotion]) -> dict[str, Wrench]:
        """The wrench on each body that the element acts on, by name.

        Args:
            t: time [s].
            motions: motion of every body, the ground included.
        """

    def potential_energy(self, t: Scalar, motions: Mapping[str, BodyMotion]) -> Scalar:
        """Energy stored in the element [J]; zero unless the element says otherwise."""
        del t, motions
        return jnp.zeros(())

    def requirements(self) -> list[Requirement]:
        """What the element's numbers must satisfy."""
        return []

    @property
    def body_names(self) -> tuple[str, ...]:
        """Bodies that the element names, checked against the scene."""
        return ()
