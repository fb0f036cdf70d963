"""The contacts that wear together: that of one joint, or those in the planes of a journal that tilts.

A journal that tilts is pressed in planes across the bearing's axis, each of which stands for a share of its length; see
`spherejax.physics.joints.rim`. Each share is worn by the contact of its plane as a bearing of that length, and the maps
lie beside each other. What is rubbed off is the sum, by the rule that shares out the contact.
"""

from collections.abc import Iterable
from itertools import count, takewhile
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import enforce, is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.legal import positive
from spherejax.model.system import System
from spherejax.physics.joints.journal import PlacedJournal
from spherejax.physics.joints.rim import lobatto
from spherejax.physics.laws.cylinders import AbstractCylinder
from spherejax.studies.wear.charts import AbstractChart, AxialChart, CircleChart, Joint, SphereChart
from spherejax.studies.wear.cycles import Rate
from spherejax.studies.wear.deposit import Maps, Told
from spherejax.studies.wear.rubbing import RubbingCycle, no_wear

OFF = 1e-6
"""How far a plane may be from where Lobatto's rule has it, as a share of the bearing's length."""


class Surface(NamedTuple):
    """What wears of a joint.

    Attributes:
        joint: its name; of a journal that tilts the name that its planes begin with.
        kind: of the maps of each contact.
        parts: names of the joints with a contact, and geometry of each.
    """

    joint: str
    kind: type[AbstractChart]
    parts: tuple[tuple[str, Joint], ...]

    @property
    def area(self) -> float:
        """Of what a chart lays out as its unit [m^2], all parts together."""
        return float(sum(float(geometry.area) for _, geometry in self.parts))

    def chart(self, cells: int) -> AbstractChart:
        """The maps of all parts."""
        if len(self.parts) == 1:
            return self.kind(cells)
        return AxialChart(cells, len(self.parts))


def names_of(joint: Any, joints: Iterable[str]) -> tuple[str, ...]:
    """The names of a joint's contacts: its own, or NAME_1, NAME_2, ... of a journal that tilts."""
    there = tuple(joints)  # what is no text, and cannot be looked up in a set, is answered by who asked
    planes = tuple(takewhile(there.__contains__, (f"{joint}_{i}" for i in count(1))))
    return (joint,) if joint in there or not planes else planes


def surface_of(system: System, joint: str, length: float | None) -> Surface:
    """The kind of a joint's maps, and its geometry.

    Raises:
        SceneError: for a plane of a journal that tilts by itself, planes that are none of one journal, and a length
            that is missing, that a ball has not, or that is another than that of the planes.
    """
    if length is not None:
        if isinstance(length, bool | str) or not is_concrete(length) or np.ndim(length) != 0:
            raise SceneError(f"wear of joint {joint!r}: length = {length!r} must be a number")
        enforce(f"wear of joint {joint!r}", [positive("length", length, "m")])
    names = names_of(joint, system.contact_joints)
    if names != (joint,):
        return _of_planes(system, joint, names, length)
    placed = system.spherical(joint)
    model: Any = placed.model
    radius = float(model.socket_radius)
    if placed.is_ball:
        if length is not None:
            raise SceneError(f"wear of joint {joint!r}: it is a ball in its socket, which has no length=; leave it out")
        return Surface(joint, SphereChart, ((joint, _geometry(model, radius)),))
    if not placed.is_parallel:
        raise SceneError(rim_alone(joint))
    if length is None:
        if not isinstance(model.conformity, AbstractCylinder):
            raise SceneError(
                f"wear of joint {joint!r}: how long its bearing is does not follow from its stiffness; give length= [m]"
            )
        length = float(model.conformity.length)
    return Surface(joint, CircleChart, ((joint, _geometry(model, float(length))),))


def rim_alone(joint: str) -> str:
    """What is said of a plane of a journal that tilts, by itself."""
    return (
        f"joint {joint!r} is a rim of a journal that tilts, and the bearing wears along its axis as a whole. Give the "
        "name of the journal that sj.joints.tilting_journal made, 'pin' for 'pin_1' and 'pin_2'"
    )


def _geometry(model: Any, width: float) -> Joint:
    return Joint(jnp.asarray(float(model.clearance)), jnp.asarray(float(model.socket_radius)), jnp.asarray(width))


def _of_planes(system: System, joint: str, names: tuple[str, ...], length: float | None) -> Surface:
    placed = [system.spherical(name) for name in names]
    first: Any = placed[0]
    whole, shares = 0.0, np.zeros(0)
    models: list[Any] = [one.model for one in placed]
    alike = len(placed) > 1 and all(
        isinstance(one, PlacedJournal)
        and not one.is_parallel
        and one.bodies == first.bodies
        and float(model.clearance) == float(models[0].clearance)
        and float(model.socket_radius) == float(models[0].socket_radius)
        for one, model in zip(placed, models, strict=True)
    )
    if alike:
        centers = np.stack([np.asarray(one.socket_place) for one in placed])
        places, shares = lobatto(len(placed))
        middle, along = 0.5 * (centers[0] + centers[-1]), np.asarray(first.frame)[:, 2]
        whole = float((centers[-1] - centers[0]) @ along)
        off = np.abs(centers - middle - 0.5 * whole * places[:, None] * along).max()
        alike = whole > 0 and off < OFF * whole
    if not alike:
        raise SceneError(
            f"joints {names[0]!r} to {names[-1]!r} are not the planes of one journal that tilts: two and more of the "
            "same bodies, clearance and radius, at the places of Lobatto's rule. Make them by sj.joints.tilting_journal"
        )
    if length is not None and abs(float(length) - whole) > OFF * whole:
        raise SceneError(
            f"wear of joint {joint!r}: length = {float(length):.6g} m, and its planes are {whole:.6g} m apart; leave "
            "length= out"
        )
    parts = [(name, _geometry(model, share * whole)) for name, model, share in zip(names, models, shares, strict=True)]
    return Surface(joint, CircleChart, tuple(parts))


class RubbingCycles(NamedTuple):
    """One cycle of all contacts that wear together.

    Attributes:
        joint: its name.
        parts: the cycle of each contact.
        chart: of all maps.
        area: of what the chart lays out as its unit [m^2].
    """

    joint: str
    parts: tuple[RubbingCycle, ...]
    chart: AbstractChart
    area: float

    @property
    def coefficients(self) -> tuple[float, float]:
        """k of socket and ball [m^2/N]."""
        return self.parts[0].coefficients

    @property
    def clearance(self) -> float:
        """c [m]."""
        return float(self.parts[0].geometry.clearance)

    @property
    def rubbing(self) -> tuple[RubbingCycle, ...]:
        """The parts that touch at all."""
        return tuple(part for part in self.parts if len(part.contacts.duration))

    def split(self, depth: Maps) -> list[Maps]:
        """The maps of each part."""
        count = len(self.parts)
        return [Maps(*rows) for rows in zip(*(jnp.split(each, count) for each in depth), strict=True)]

    def rubbed(self, depth: Maps) -> list[tuple[Maps, Told]]:
        """Rubbing work by cell [J], and what is told of each contact, part by part; see `RubbingCycle.rubbed`."""
        return [part.rubbed(own) for part, own in zip(self.parts, self.split(depth), strict=True)]

    def rate(self, depth: Maps) -> Rate:
        """What the cycle wears off; how far the ball goes is the mean over the rubbing work of all parts."""
        rates = [part.rate(own) for part, own in zip(self.parts, self.split(depth), strict=True)]
        if len(rates) == 1:
            return rates[0]
        volumes = np.array([rate.volume for rate in rates])
        work = volumes.sum(axis=1)  # in the ratio of the rubbing work
        share = work / max(work.sum(), np.finfo(float).tiny)
        socket, ball = volumes.sum(axis=0).tolist()
        return Rate(
            Maps(*(jnp.concatenate(each) for each in zip(*(rate.depth for rate in rates), strict=True))),
            float(share @ [rate.approach for rate in rates]),
            float(share @ [rate.aside for rate in rates]),
            (socket, ball),
        )

    @property
    def unworn(self) -> Maps:
        """Depths of zero."""
        return no_wear(self.chart)
