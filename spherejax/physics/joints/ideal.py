"""The ideal model: constraint equations (Eqs 3 to 10) instead of forces."""

from typing import ClassVar

from spherejax.foundations.checks import Requirement
from spherejax.physics.joints.base import AbstractSphericalModel


class Ideal(AbstractSphericalModel):
    """The joint's equations hold exactly: no clearance, no dissipation; of a spherical joint, the centers coincide."""

    is_ideal: ClassVar[bool] = True

    def requirements(self) -> list[Requirement]:
        """An ideal joint has no numbers."""
        return []
