"""Drift control: what holds a motion on its constraints, which the equations of motion only differentiate twice.

The accelerations satisfy D a = gamma. Integrated, a steady error of theirs becomes a violation of the velocity
constraints that grows with time, and a violation of the position constraints that grows with its square. Quaternions
leave the unit sphere in the same way.
"""

from typing import Annotated, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import Number, Unit


class AbstractDriftControl(eqx.Module):
    """How drift off the constraints is held back: by feedback in the equations, or by correcting each step.

    A control with feedback implements `acceleration_feedback` and `norm_feedback`; one that corrects steps sets
    `n_corrections`. The class is static, the numbers in it are leaves.

    Attributes:
        n_corrections: Newton corrections of positions and velocities at the end of each step (static).
    """

    n_corrections: ClassVar[int] = 0

    def requirements(self) -> list[Requirement]:
        """What the numbers of the control must satisfy."""
        return []

    def acceleration_feedback(self, residual: Float[Array, " n"], rate: Float[Array, " n"]) -> Float[Array, " n"]:
        """What is taken from gamma in D a = gamma [m/s^2 or 1/s^2].

        Args:
            residual: Phi [m or 1].
            rate: Phi_dot [m/s or 1/s].
        """
        del rate
        return 0.0 * residual

    @property
    def norm_feedback(self) -> Number:
        """Rate f [1/s] with which quaternions p are pulled back to unit norm: p_dot = ... - f (|p|^2 - 1) p."""
        return 0.0


class NoDriftControl(AbstractDriftControl):
    """The equations of motion as they are, D a = gamma.

    The violations grow as the tolerance lets them; they show what another control has to do.
    """


class Baumgarte(AbstractDriftControl):
    """Baumgarte's stabilization: D a = gamma - 2 alpha Phi_dot - beta^2 Phi (Eq. 2).

    Attributes:
        alpha: feedback of the velocity violation [1/s]; it also pulls quaternions back to unit norm.
        beta: feedback of the position violation [1/s].

    It does not pass singular positions, where the constraint equations lose rank: it feeds a violation back along a
    direction that is about to vanish, and takes the energy of the motion. Such a run ends with the status AUDIT_FAILED;
    `PostStabilization` passes.

    Zero switches the feedback off. Defaults from Table 3 of the paper. Violations decay within 1/alpha, so they settle
    at what the integration adds in that time; larger rates hold them closer and make the equations stiffer.

    Source: Baumgarte (1972), Comput. Methods Appl. Mech. Eng. 1:1-16.
    """

    alpha: Annotated[Number, Unit("1/s")] = 5.0
    beta: Annotated[Number, Unit("1/s")] = 5.0

    def requirements(self) -> list[Requirement]:
        """Non-negative rates."""
        return [
            Requirement(
                name,
                value,
                (value >= 0) & (value < np.inf),
                "be finite and not negative [1/s]",
                "Give zero to switch the feedback off.",
            )
            for name, value in (("alpha", self.alpha), ("beta", self.beta))
        ]

    def acceleration_feedback(self, residual, rate):
        """2 alpha Phi_dot + beta^2 Phi."""
        return 2 * self.alpha * rate + self.beta * self.beta * residual

    @property
    def norm_feedback(self) -> Number:
        """The rate is alpha, as for any other constraint."""
        return self.alpha


class PostStabilization(AbstractDriftControl):
    """One Newton correction of positions and velocities after each step; no feedback. The default of a scene.

    Quaternions are divided by their norms; the bodies move by -M^-1 D^T S^-1 Phi, S = D M^-1 D^T, the least
    displacement in the metric of their masses and inertias; the velocities lose M^-1 D^T S^-1 D v, with D v after the
    displacement and with the S from before it, which is factorized once. A violation d that a step leaves becomes
    one of the order of d^2 / (length of the bodies): rounding, but for loose tolerances. Samples between the ends of
    steps are corrected likewise.

    Source: Ascher et al. (1994), Numer. Math. 67:131-149, with D v evaluated anew.
    """

    n_corrections: ClassVar[int] = 1


class Projection(AbstractDriftControl):
    """Each step ends on the constraints to rounding: the correction of `PostStabilization` three times; no feedback.

    Newton's method squares the violation each time: three corrections take a violation of a hundredth of a body's
    length to rounding.

    Source: Eich (1993), SIAM J. Numer. Anal. 30:1467-1482.
    """

    n_corrections: ClassVar[int] = 3
