"""How a joint's reaction is spread over its surfaces: what the sum of the pressures is to their resultant.

Friction follows the pressure p on each piece of the surface, the joint's reaction F is what the pressures add up to as
vectors. For a ball of radius R, with n along the reaction, that slides everywhere with the friction coefficient mu,

    M = -mu R |F| (k_perp (I - n n^T) + k_par n n^T) w/|w|

k_perp for a rotation w across the reaction, k_par for one about it. A shaft in its bearing turns across the reaction,
and slides along it with the same factor: k_perp = (integral of p dA)/|F|.
"""

import math
from typing import ClassVar

import equinox as eqx

from spherejax.foundations.checks import Requirement
from spherejax.physics.laws.base import AbstractLaw


class AbstractPressure(AbstractLaw):
    """How the reaction is spread over a joint's surfaces.

    Attributes:
        across: k_perp, for a rotation across the reaction [-].
        about: k_par, for a rotation about the reaction [-].
        follows_reaction: whether the reaction presses at all.
    """

    across: eqx.AbstractClassVar[float]
    about: eqx.AbstractClassVar[float]
    follows_reaction: ClassVar[bool] = True
    never_adds_energy: ClassVar[bool] = True

    def requirements(self) -> list[Requirement]:
        """None: it has no numbers."""
        return []


class CosinePressure(AbstractPressure):
    """A pressure that falls with the cosine of the angle from the reaction, on the half that is pressed: worn in.

    k_perp = 4/pi, k_par = 1, for balls; k_perp holds for shafts too. Source: the integrals over the half sphere and the
    half cylinder, elementary.
    """

    across: ClassVar[float] = 4.0 / math.pi
    about: ClassVar[float] = 1.0


class UniformPressure(AbstractPressure):
    """The same pressure all over the half that is pressed: a soft liner, or a fit without play.

    k_perp = k_par = pi/2, for balls; k_perp holds for shafts too. Source: the integrals over the half sphere and the
    half cylinder, elementary.
    """

    across: ClassVar[float] = math.pi / 2.0
    about: ClassVar[float] = math.pi / 2.0


class PointContact(AbstractPressure):
    """All the reaction at one point (of a shaft: along one line): much play, or the flat faces of a guide.

    k_perp = 1, k_par = 0: a ball spins about the reaction without friction.
    """

    across: ClassVar[float] = 1.0
    about: ClassVar[float] = 0.0


class PreloadAlone(AbstractPressure):
    """The reaction does not count: friction is that of the preload, whatever the joint carries.

    The moment of a ball joint that was measured without load. Nothing is iterated then.
    """

    across: ClassVar[float] = 0.0
    about: ClassVar[float] = 0.0
    follows_reaction: ClassVar[bool] = False
