"""Joints made of elementary equations, in body axes: points that coincide, planes, right angles."""

from collections.abc import Mapping

import equinox as eqx

from spherejax.foundations.types import Numeric
from spherejax.physics.bodies import Body
from spherejax.physics.joints.body_axes import cross, perpendicular, turned, unit
from spherejax.physics.joints.joint import AbstractPlacedAtPoints
from spherejax.physics.joints.reaction_friction import AbstractJointFriction
from spherejax.physics.joints.rows import coincidence_rows, perpendicularity_row, plane_row, stacked

Directions = tuple[Numeric, ...]

RightAngles = tuple[tuple[Numeric, Numeric], ...]
"""Pairs of directions that stay perpendicular, each on the first and on the second body."""


class PlacedPair(AbstractPlacedAtPoints):
    """A joint made of elementary equations, in body axes.

    Attributes:
        bodies: names of the two bodies.
        places: the joint's point on each body, body axes [m].
        coincides: whether the two points coincide: three equations.
        normals: directions on the first body; the second point stays in the planes through the first point that they
            are normal to: one equation each.
        right_angles: pairs of directions, on the first and on the second body, that stay perpendicular: one equation
            each.
        axes: the joint's axes on the second body, for whoever draws or drives it.
        rubbing: friction by the joint's reaction, or None.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    places: tuple[Numeric, Numeric]
    coincides: bool = eqx.field(static=True)
    normals: Directions
    right_angles: RightAngles
    axes: Directions
    rubbing: AbstractJointFriction | None = None

    @property
    def friction(self) -> AbstractJointFriction | None:
        """Friction, where the joint has some."""
        return self.rubbing

    def as_if_ideal(self):
        """Without friction, which a start does not need: one program serves all."""
        if self.rubbing is None:
            return self
        return PlacedPair(self.bodies, self.places, self.coincides, self.normals, self.right_angles, self.axes)

    @property
    def n_rows(self) -> int:
        """As many as its equations."""
        return (3 if self.coincides else 0) + len(self.normals) + len(self.right_angles)

    def constraint_rows(self, t, motions):
        """The elementary equations, one after the other."""
        del t
        first, second = motions[self.bodies[0]], motions[self.bodies[1]]
        return stacked(
            *([coincidence_rows(first, second, *self.places)] if self.coincides else []),
            *(plane_row(first, second, *self.places, b) for b in self.normals),
            *(perpendicularity_row(first, second, b, u) for b, u in self.right_angles),
        )


def two_across(bodies: Mapping[str, Body], body: str, axis) -> tuple[Numeric, Numeric]:
    """Two directions of a body that are perpendicular to an axis and to each other."""
    along = unit(axis)
    across = perpendicular(along)
    return turned(bodies, body, across), turned(bodies, body, cross(along, across))


def right_angles_of_all_axes(bodies: Mapping[str, Body], pair: tuple[str, str], axis):
    """Three right angles that hold two bodies' orientations together: x with y, y with z, z with x."""
    z = unit(axis)
    x = perpendicular(z)
    y = cross(z, x)
    first, second = pair
    return tuple((turned(bodies, first, b), turned(bodies, second, u)) for b, u in ((x, y), (y, z), (z, x)))
