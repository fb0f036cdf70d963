"""What the contacts of one cycle rub off at any depths of wear, with what is checked every time."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.motion.integration.status import SimulationError
from spherejax.physics.laws.depth import AbstractDepth
from spherejax.studies.wear.charts import AbstractChart, Joint
from spherejax.studies.wear.contacts import CREEPING, ContactInstants
from spherejax.studies.wear.cycles import Rate
from spherejax.studies.wear.deposit import Maps, Told, rubbed

LOST = 1e-9
"""What may be missing of the rubbing work on a map, as a share of it: rounding of sums."""

UNBALANCED = 1e-6
"""What the pressure's resultant along the contact's direction may differ from the normal force by, as a share."""

NARROWEST, WIDEST = 0.8, 1.6
"""Rubbing work of patches over that of their resultants: 1 for small patches, 3/2 for a hemisphere pressed along its
axis, pi/2 for half a bearing that is pressed evenly, less than 1 for a ball that is rubbed across."""


class RubbingCycle(NamedTuple):
    """One cycle of a joint.

    Attributes:
        joint: its name.
        contacts: of the cycle.
        geometry: of the joint.
        chart: of the maps.
        coefficients: k of socket and ball [m^2/N].
        shape: depths of the surfaces before any wear [m].
        approach: how far the ball goes beyond the clearance in each contact before any wear [m].
    """

    joint: str
    contacts: ContactInstants
    geometry: Joint
    chart: AbstractChart
    coefficients: tuple[float, float]
    shape: Maps
    approach: np.ndarray

    @property
    def cell_area(self) -> float:
        """[m^2]."""
        return float(self.geometry.area) * self.chart.share

    def rubbed(self, depth: Maps) -> tuple[Maps, Told]:
        """Rubbing work by cell [J] with surfaces worn as deep as `depth` [m], and what is told of each contact."""
        contacts, shape = self.contacts, self.shape
        worn = Maps(shape.socket + depth.socket, shape.ball + depth.ball)
        return rubbed(worn, contacts.contact, contacts.duration, self.geometry, self.chart)

    def rate(self, depth: Maps) -> Rate:
        """What the cycle wears off.

        Raises:
            SimulationError: where the maps miss some of the work, or a pressure does not balance its force.
        """
        if not len(self.contacts.duration):
            return Rate(no_wear(self.chart), 0.0, 0.0)
        work, told = self.rubbed(depth)
        conserved(self.joint, work, told, self.contacts)
        (k_socket, k_ball), area = self.coefficients, self.cell_area
        weights = told.power * self.contacts.duration
        total = float(weights.sum())
        share = weights / max(total, np.finfo(float).tiny)
        return Rate(
            Maps(k_socket / area * work.socket, k_ball / area * work.ball),
            float(share @ (told.approach - self.approach)),
            float(share @ told.aside),
            (k_socket * total, k_ball * total),
        )


def cycle_of(
    joint: str, geometry: Joint, contacts: ContactInstants, chart: AbstractChart, coefficients, shape: Maps
) -> RubbingCycle:
    """The cycle of contacts that a run has told.

    Args:
        joint: name of the joint.
        geometry: of the joint.
        contacts: of the cycle.
        chart: of the maps.
        coefficients: k of socket and ball [m^2/N].
        shape: depths before any wear [m].
    """
    cycle = RubbingCycle(joint, contacts, geometry, chart, coefficients, shape, np.zeros(len(contacts.duration)))
    if not len(contacts.duration):
        return cycle
    return cycle._replace(approach=cycle.rubbed(no_wear(chart))[1].approach)


def no_wear(chart: AbstractChart) -> Maps:
    """Depths of zero."""
    return Maps(jnp.zeros(chart.size), jnp.zeros(chart.size))


def shape_of(model: Any, chart: AbstractChart) -> Maps:
    """Depths of a joint's surfaces in the cells of maps [m]."""
    u = jnp.asarray(chart.centers)
    surfaces = model.surfaces
    return Maps(*(_sampled(depth, u) for depth in (surfaces.socket_depth, surfaces.ball_depth)))


def _sampled(depth: AbstractDepth | None, u):
    return jnp.zeros(len(u)) if depth is None else jax.vmap(depth.depth)(u)


def conserved(joint: str, work: Maps, told: Told, contacts: ContactInstants) -> tuple[float, float]:
    """Shares by which a map's work and the resultants of the pressure are off; raises where that is too much."""
    total = float(told.power @ contacts.duration)
    scale = max(total, np.finfo(float).tiny)
    lost = max(abs(float(jnp.sum(each)) - total) / scale for each in work) if total > 0 else 0.0
    unbalanced = float(np.max(np.abs(told.balance)))
    if not (lost <= LOST and unbalanced <= UNBALANCED):
        raise SimulationError(
            f"wear of joint {joint!r} is not conserved: the maps miss {lost:.1e} of the rubbing work ({LOST:.0e} is "
            f"allowed), and the pressure's resultant differs from the normal force by {unbalanced:.1e} of it "
            f"({UNBALANCED:.0e}). This is a fault of the program, or of numbers beyond its range; please report it"
        )
    return lost, unbalanced


def require_expected(joint: str, work: float, contacts: ContactInstants) -> None:
    """Whether those that stand for alike instants rub as much as all instants do.

    Raises:
        SimulationError: where they do not.
    """
    slow = CREEPING * float(np.asarray(contacts.contact.force) @ contacts.duration)
    if contacts.expected > slow and not NARROWEST < work / contacts.expected < WIDEST:
        raise SimulationError(
            f"wear of joint {joint!r}: patches that stand for alike instants rub {work:.4g} J, and all instants "
            f"{contacts.expected:.4g} J. This is a fault of the program; please report it, with the scene"
        )
