"""What every force law has in common."""

import abc
from typing import ClassVar

import equinox as eqx

from spherejax.foundations.checks import Requirement


class AbstractLaw(eqx.Module):
    """A force law: physical numbers as leaves, pure functions as methods.

    Attributes:
        never_adds_energy: whether the law only stores and dissipates, and reports what it stores; a law of your own may
            say so, and every run then checks it. The work of a law that does not is integrated beside the state, and
            counts as put in from outside.
    """

    never_adds_energy: ClassVar[bool] = False

    @abc.abstractmethod
    def requirements(self) -> list[Requirement]:
        """The values that the law is defined for."""
