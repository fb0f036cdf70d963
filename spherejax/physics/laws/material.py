"""Elastic material of ball and socket, and the contact stiffness that follows from it."""

from typing import Annotated

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric, positive
from spherejax.foundations.types import Number, Scalar, Unit
from spherejax.physics.laws.base import AbstractLaw


class Material(AbstractLaw):
    """A linear, isotropic elastic material; the defaults are the steel of the paper's Table 3.

    Attributes:
        youngs_modulus: E [Pa].
        poissons_ratio: nu [-].
    """

    youngs_modulus: Annotated[Number, Unit("Pa")] = 207e9
    poissons_ratio: Annotated[Number, Unit("1")] = 0.3

    def contact_compliance(self) -> Number:
        """sigma = (1 - nu**2)/E [1/Pa].

        Source: Rodrigues da Silva et al. (2022), Eq. 25.
        """
        return (1.0 - self.poissons_ratio**2) / self.youngs_modulus

    def requirements(self) -> list[Requirement]:
        """E > 0 and -1 < nu <= 1/2, the thermodynamic bounds."""
        nu = numeric(self.poissons_ratio)
        return [
            positive("youngs_modulus", self.youngs_modulus, "Pa"),
            Requirement(
                "poissons_ratio",
                self.poissons_ratio,
                (nu > -1.0) & (nu <= np.float64(0.5)),
                "lie in (-1, 0.5]",
                "Metals lie near 0.3.",
            ),
        ]


def generalized_stiffness(
    socket_radius: Number, ball_radius: Number, socket_material: Material, ball_material: Material
) -> Scalar:
    """Stiffness K of Hertz's law for a ball inside a spherical socket [N/m**1.5].

        K = 4/(3 (sigma_i + sigma_j)) sqrt(R_i R_j/(R_i + R_j)),    R_i = -socket_radius, R_j = ball_radius

    A concave surface counts with a negative radius, so a tighter fit is stiffer.

    Args:
        socket_radius: [m], above `ball_radius`.
        ball_radius: [m].
        socket_material: of body i.
        ball_material: of body j.

    Limits: K grows without bound as the clearance tends to 0; it is NaN for a ball that does not fit.

    Source: Rodrigues da Silva et al. (2022), Eqs. 24 and 25. With the defaults, a socket of 10 mm and
    clearances of 0.05, 0.10, 0.20, 0.50 mm: 2.139263e11, 1.508882e11, 1.061538e11, 6.610198e10 N/m**1.5
    (1.5089e11 is printed).
    """
    effective_radius = socket_radius * ball_radius / (socket_radius - ball_radius)
    compliance = socket_material.contact_compliance() + ball_material.contact_compliance()
    return 4.0 / (3.0 * compliance) * jnp.sqrt(effective_radius)
