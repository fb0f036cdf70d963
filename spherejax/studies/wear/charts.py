"""Maps of a surface, with what a foundation does on it: of a ball and its socket, or of a journal and its bearing.

A ball's chart is a square of n times n cells of equal area, onto which the sphere is folded; a journal's is a ring of n
cells around the axis, each as long as the bearing; that of a journal that tilts has such a ring for each plane. Places
on all are unit vectors from the center: in the axes of the body for a ball, across z for a journal.
"""

import abc
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.types import Numeric, Scalar
from spherejax.physics.joints.rim import lobatto
from spherejax.physics.laws.conformity import AbstractConformity
from spherejax.physics.laws.cylinders import AbstractCylinder
from spherejax.physics.laws.depth import (
    LARGEST_DEGREE,
    LARGEST_ORDER,
    AbstractDepth,
    FourierDepth,
    HarmonicDepth,
    LegendreFourierDepth,
    grid_of,
    harmonics,
    waves,
)
from spherejax.physics.laws.wear import (
    foundation_depth,
    foundation_force,
    journal_foundation_depth,
    journal_foundation_force,
)
from spherejax.studies.wear import sphere

POINTS_PER_RING = 6
"""For each ring of a ball's patch: 2 pi of them would be as dense around as outwards."""


class Joint(NamedTuple):
    """Geometry of the joint.

    Attributes:
        clearance: c [m].
        radius: R, of the socket [m].
        width: R again for a ball; the length of the bearing for a journal [m]: R times this is what a cell's share of
            the unit sphere, or of the circle, is to be multiplied by for an area.
    """

    clearance: Scalar
    radius: Scalar
    width: Scalar

    @property
    def area(self) -> Scalar:
        """[m^2]."""
        return self.radius * self.width


class PatchPoints(NamedTuple):
    """PatchPoints of a patch.

    Attributes:
        u: unit vectors.
        fall: 1 - n.u.
        shares: of the unit sphere [sr], or of the circle [rad].
        ring: number of the ring of each, from the middle outwards.
    """

    u: Float[Array, "q 3"]
    fall: Float[Array, " q"]
    shares: Float[Array, " q"]
    ring: Float[np.ndarray, " q"]

    @property
    def x(self) -> Float[Array, " q"]:
        """n.u."""
        return 1 - self.fall


@dataclass(frozen=True)
class AbstractChart(abc.ABC):
    """A map of a surface.

    Attributes:
        n: how many cells it has along each side, or around.
        is_ball: whether it is of a ball and its socket.
        rings: numbers of rings that a patch may be looked at on; few different ones, for few programs.
        rings_per_cell: with as many rings as cells from a patch's middle to its edge, points and cells would beat:
            stripes of 20 %.
        usual_cells: fewest and most, where the number is chosen.
        possible_cells: fewer tell nothing, more take gigabytes.
        cells_per_patch: from the middle of a typical patch to its edge, where the number is chosen.
        degree: of the harmonics that a motion feels, where it is chosen; `largest_degree` is the largest.
    """

    n: int

    is_ball: ClassVar[bool]
    rings: ClassVar[tuple[int, ...]]
    rings_per_cell: ClassVar[float]
    usual_cells: ClassVar[tuple[int, int]]
    possible_cells: ClassVar[tuple[int, int]]
    cells_per_patch: ClassVar[float]
    degree: ClassVar[int]
    largest_degree: ClassVar[int]

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, ...]:
        """Of a map as an array."""

    @property
    def size(self) -> int:
        """How many cells."""
        return int(np.prod(self.shape))

    @property
    @abc.abstractmethod
    def share(self) -> float:
        """Of each cell of the unit sphere [sr], or of the circle [rad]."""

    @property
    def cell_shares(self) -> Float[np.ndarray, "*shape"]:
        """Of each cell of what is laid out, in an array of the shape of a map, or one that is broadcast to it."""
        return np.full((1,) * len(self.shape), self.share)

    def total(self, values: Numeric) -> float:
        """Sum of a map's cells, each times its share."""
        return float(np.sum(np.asarray(values))) * self.share

    @property
    @abc.abstractmethod
    def cell_width(self) -> float:
        """[rad]."""

    @property
    @abc.abstractmethod
    def centers(self) -> Float[np.ndarray, "size 3"]:
        """Unit vectors to the cells."""

    @abc.abstractmethod
    def corners(self, u: Numeric) -> tuple[Int[Array, "q k"], Float[Array, "q k"]]:
        """Numbers of the cells around unit vectors, and their weights: positive, with the sum 1."""

    def sampled(self, values: Numeric, u: Numeric) -> Float[Array, " q"]:
        """Numbers of a map, flat, interpolated at unit vectors."""
        cells, weights = self.corners(u)
        return jnp.sum(values[cells] * weights, axis=-1)

    @staticmethod
    @abc.abstractmethod
    def nodes(rings: int) -> tuple[np.ndarray, np.ndarray]:
        """Places of the rings between the middle and the edge, from 0 to 1, and their shares; the sum of those is 1."""

    @abc.abstractmethod
    def points(self, n: Float[Array, "3"], rise: Scalar, rings: int) -> PatchPoints:
        """PatchPoints on the patch 1 - n.u < rise."""

    @classmethod
    def cells_for(cls, half_angle: float) -> int:
        """How many cells give a patch with this half angle [rad] as many as are usual."""
        whole = cls.cells_per_patch / half_angle * cls.cells_across
        return int(np.clip(16 * np.ceil(whole / 16), *cls.usual_cells))

    cells_across: ClassVar[float]

    @staticmethod
    @abc.abstractmethod
    def force(depth: Numeric, joint: Joint, stiffness: Numeric) -> Numeric:
        """Force of a foundation [N] that unworn surfaces press in by a depth [m]."""

    @staticmethod
    @abc.abstractmethod
    def depth(force: Numeric, gap: Numeric, joint: Joint, stiffness: Numeric) -> Numeric:
        """How deep a force [N] presses the foundation of unworn surfaces with a gap [m]; the joint's own is `c`."""

    @staticmethod
    @abc.abstractmethod
    def matched_depth(model: Any, force: Numeric, penetration: Numeric) -> Numeric:
        """How deep a foundation yields whose patch on unworn surfaces is as wide as that of the contact [m]."""

    @staticmethod
    @abc.abstractmethod
    def harmonics(u: Float[np.ndarray, "q 3"], degree: int) -> Float[np.ndarray, "q k"]:
        """Smooth functions at unit vectors."""

    @staticmethod
    @abc.abstractmethod
    def grid(degree: int) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors all over the surface, and weights with the sum 1, which tell the harmonics of a degree apart."""

    @staticmethod
    @abc.abstractmethod
    def profile(coefficients: Numeric) -> AbstractDepth:
        """The depth with these coefficients of the harmonics [m]."""

    @staticmethod
    @abc.abstractmethod
    def degree_of(coefficients: Numeric) -> int:
        """Of so many coefficients."""


class SphereChart(AbstractChart):
    """Of a ball or its socket; see `spherejax.studies.wear.sphere`."""

    is_ball = True
    rings = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
    rings_per_cell = 1.75
    usual_cells = (96, 512)
    possible_cells = (16, 2048)
    cells_per_patch = 4.0
    cells_across = float(np.sqrt(4 * np.pi))
    degree = 8
    largest_degree = LARGEST_DEGREE

    @property
    def shape(self):
        """n rows, n columns."""
        return (self.n, self.n)

    @property
    def share(self):
        """4 pi/n^2 [sr]."""
        return sphere.cell_solid_angle(self.n)

    @property
    def cell_width(self):
        """Side of a square of a cell's area [rad]."""
        return sphere.cell_width(self.n)

    @property
    def centers(self):
        """Unit vectors to the cells, row by row."""
        return sphere.centers(self.n).reshape(-1, 3)

    def corners(self, u):
        """Four cells around each place."""
        return sphere.corners(u, self.n)

    @staticmethod
    def nodes(rings):
        """Gauss's rule in the radius."""
        nodes, weights = np.polynomial.legendre.leggauss(rings)
        return (nodes + 1) / 2, weights / 2

    def points(self, n, rise, rings):
        """Gauss's rule in the radius sqrt((1 - n.u)/rise), equal angles around."""
        rho, shares = self.nodes(rings)
        around = POINTS_PER_RING * rings
        turn = 2 * np.pi * (np.arange(around)[None] / around + 0.618 * np.arange(rings)[:, None])
        ring = np.repeat(np.arange(rings), around)
        fall = rise * np.repeat(rho**2, around)
        across = jnp.sqrt(fall * (2 - fall))
        first, second = _across(n)
        u = (1 - fall)[:, None] * n + across[:, None] * (
            np.cos(turn).reshape(-1, 1) * first + np.sin(turn).reshape(-1, 1) * second
        )
        solid_angles = rise * np.repeat(2 * rho * shares * (2 * np.pi / around), around)
        return PatchPoints(u, fall, solid_angles, ring)

    @staticmethod
    def force(depth, joint, stiffness):
        """Of the cap of a sphere."""
        return foundation_force(depth, joint.clearance, joint.radius, stiffness)

    @staticmethod
    def depth(force, gap, joint, stiffness):
        """Of the cap of a sphere."""
        return foundation_depth(force, gap, joint.radius, stiffness)

    @staticmethod
    def matched_depth(model, force, penetration):
        """Hertz's circle has a^2 = R^2 delta/c, the foundation's cap 2 R^2 delta_w/c."""
        return penetration / 2

    @staticmethod
    def harmonics(u, degree):
        """Spherical harmonics."""
        return harmonics(u, degree)

    @staticmethod
    def grid(degree):
        """Gauss nodes along the axis, equal angles around it."""
        return grid_of(2 * degree)

    @staticmethod
    def profile(coefficients):
        """Spherical harmonics."""
        return HarmonicDepth(coefficients)

    @staticmethod
    def degree_of(coefficients):
        """L, of (L + 1)^2 coefficients."""
        return round(np.sqrt(np.size(coefficients))) - 1


class CircleChart(AbstractChart):
    """Of a journal or its bearing: the angle around the axis, all along which the depth is the same."""

    is_ball = False
    rings = (16, 32, 64, 128, 256, 512, 1024, 2048, 4096)
    rings_per_cell = 4.0
    usual_cells = (192, 2048)
    possible_cells = (16, 8192)
    cells_per_patch = 16.0
    cells_across = 2 * np.pi
    degree = 16
    largest_degree = LARGEST_ORDER

    @property
    def shape(self):
        """n, around the axis."""
        return (self.n,)

    @property
    def share(self):
        """2 pi/n [rad]."""
        return 2 * np.pi / self.n

    @property
    def cell_width(self):
        """2 pi/n [rad]."""
        return 2 * np.pi / self.n

    @property
    def centers(self):
        """Unit vectors to the cells, across z."""
        turn = 2 * np.pi * (np.arange(self.n) + 0.5) / self.n
        return np.stack([np.cos(turn), np.sin(turn), np.zeros(self.n)], -1)

    def corners(self, u):
        """Two cells beside each place."""
        place = jnp.arctan2(u[..., 1], u[..., 0]) * (self.n / (2 * np.pi)) - 0.5
        low = jnp.floor(place)
        share = place - low
        cells = [jnp.mod(low.astype(int) + k, self.n) for k in (0, 1)]
        return jnp.stack(cells, axis=-1), jnp.stack([1 - share, share], axis=-1)

    @staticmethod
    def nodes(rings):
        """Middles of equal parts: Gauss's nodes of so many rings would take longer than all the rest."""
        return (np.arange(rings) + 0.5) / rings, np.full(rings, 1 / rings)

    def points(self, n, rise, rings):
        """With rho = sin(phi/2)/sqrt(rise/2), the ring's place, on either side of the middle."""
        rho, shares = self.nodes(rings)
        root = jnp.sqrt(rise / 2)
        half = jnp.arcsin(jnp.minimum(root * np.concatenate([rho, rho]), 1.0))
        sign = np.repeat([1.0, -1.0], rings)
        fall = rise * np.concatenate([rho, rho]) ** 2
        across = jnp.stack([-n[1], n[0], jnp.zeros(())])
        u = (1 - fall)[:, None] * n + (sign * jnp.sin(2 * half))[:, None] * across
        angles = 2 * root * np.concatenate([shares, shares]) / jnp.cos(half)
        return PatchPoints(u, fall, angles, np.concatenate([np.arange(rings)] * 2))

    @staticmethod
    def force(depth, joint, stiffness):
        """Of the arc of a cylinder."""
        return journal_foundation_force(depth, joint.clearance, joint.radius, joint.width, stiffness)

    @staticmethod
    def depth(force, gap, joint, stiffness):
        """Of the arc of a cylinder."""
        return journal_foundation_depth(force, gap, joint.radius, joint.width, stiffness)

    @staticmethod
    def matched_depth(model, force, penetration):
        """Hertz's strip has b^2 = 4 R^2 f/c with f = (sigma_i + sigma_j) F/(pi L), the foundation's 2 R^2 delta_w/c.

        A given stiffness says nothing of a width: the foundation yields as far as the contact then.
        """
        law: AbstractConformity | None = model.conformity
        if not isinstance(law, AbstractCylinder):
            return penetration
        compliance = model.socket_material.contact_compliance() + model.ball_material.contact_compliance()
        return 2 * compliance * force / (np.pi * law.length)

    @staticmethod
    def harmonics(u, degree):
        """1, cos phi, sin phi, cos 2 phi, ..."""
        return waves(u, degree)

    @staticmethod
    def grid(degree):
        """Equal angles, two for each half wave."""
        turn = 2 * np.pi * np.arange(4 * degree + 4) / (4 * degree + 4)
        u = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], -1)
        return u, np.full(len(turn), 1 / len(turn))

    @staticmethod
    def profile(coefficients):
        """A Fourier series."""
        return FourierDepth(coefficients)

    @staticmethod
    def degree_of(coefficients):
        """M, of 2 M + 1 coefficients."""
        return np.size(coefficients) // 2


@dataclass(frozen=True)
class AxialChart(CircleChart):
    """Of a bearing whose depth changes along its axis: rings in the planes of a journal that tilts.

    Attributes:
        n: cells around.
        planes: how many there are along the axis; each stands for its share of the length by Lobatto's rule.
    """

    planes: int = 2

    @property
    def shape(self):
        """Planes along the axis, n around it."""
        return (self.planes, self.n)

    @property
    def places(self) -> Float[np.ndarray, " planes"]:
        """Of the planes along the axis, from -1 at the first end to 1 at the second."""
        return lobatto(self.planes)[0]

    @property
    def cell_shares(self):
        """2 pi/n times the share of the length [rad]."""
        return (2 * np.pi / self.n) * lobatto(self.planes)[1][:, None]

    def total(self, values):
        """By the shares of the planes."""
        return float(np.sum(np.asarray(values).reshape(self.shape) * self.cell_shares))

    @property
    def centers(self):
        """Unit vectors to the cells, across z, plane by plane."""
        return np.tile(CircleChart(self.n).centers, (self.planes, 1))

    def at(self, values: Numeric, place: float) -> Float[np.ndarray, " n"]:
        """A map's cells around the axis at a place along it, by the polynomial through the planes."""
        k = self.planes - 1
        along = np.polynomial.legendre.legvander(np.array([place]), k)
        weights = along @ np.linalg.inv(np.polynomial.legendre.legvander(self.places, k))
        return (weights @ np.asarray(values).reshape(self.shape))[0]

    def profile(self, coefficients):  # type: ignore[override]
        """A Fourier series in each plane, and the polynomial along the axis through them."""
        return LegendreFourierDepth.through(self.places, [FourierDepth(row) for row in np.asarray(coefficients)])


def chart_of(is_ball: bool, n: int) -> AbstractChart:
    """The chart with n cells along each side, or around."""
    return SphereChart(n) if is_ball else CircleChart(n)


def _across(n: Float[Array, "3"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Two unit vectors across n and each other."""
    axis = jnp.where(jnp.abs(n[2]) < 0.9, jnp.array([0.0, 0.0, 1.0]), jnp.array([1.0, 0.0, 0.0]))
    first = jnp.cross(n, axis)
    first = first / jnp.sqrt(first @ first)
    return first, jnp.cross(n, first)
