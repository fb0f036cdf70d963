"""A revolute joint with clearance: a journal that plays in its bearing, both with parallel axes.

The journal keeps its place along the bearing and its direction (three constraint equations) and moves across the axis
within the clearance, where a model answers: the same laws, modes and landings as of a ball in its socket, in the plane.
"""

from typing import ClassVar

from spherejax.physics.joints.elementary import PlacedPair
from spherejax.physics.joints.spherical import PlacedSpherical
from spherejax.physics.kinematics import RelativeMotion


class PlacedJournal(PlacedSpherical):
    """A journal in a bearing, in body axes.

    Attributes:
        bodies: names of the bearing's and the journal's body.
        socket_place: the bearing's center on its body, body axes [m].
        ball_place: the journal's center on its body, body axes [m].
        start_quaternion: journal's body against bearing's body at the start.
        model: how the joint resists.
        starts_concentric: whether the start is assembled as if the joint were ideal.
        frame: axes with z along the bearing in those of its body, as columns, shape (3, 3).
        ideal: the revolute joint that this one is without clearance.
        guide: what holds the journal along the axis and parallel to it.
    """

    is_ball: ClassVar[bool] = False

    guide: PlacedPair | None = None

    @property
    def n_rows(self) -> int:
        """Three: one along the axis, two of directions."""
        return self._guide.n_rows

    def constraint_rows(self, t, motions):
        """What holds the journal along the axis and parallel to it."""
        return self._guide.constraint_rows(t, motions)

    def assembly_rows(self, t, motions):
        """Those of the joint without clearance, unless the user placed the journal elsewhere."""
        start = self._guide if self.ideal is None or not self.starts_concentric else self.ideal
        return start.assembly_rows(t, motions)

    def as_if_ideal(self):
        """The joint without clearance; what guides the journal where that stays where the user placed it."""
        return self.ideal if self.starts_concentric else self._guide

    def across(self, motion: RelativeMotion) -> RelativeMotion:
        """Motion of the journal across the bearing's axis; the part along it is the guide's."""
        axis = motion.socket_rotation[:, 2]
        e, rate = motion.eccentricity, motion.eccentricity_rate
        return motion._replace(eccentricity=e - (e @ axis) * axis, eccentricity_rate=rate - (rate @ axis) * axis)

    @property
    def _guide(self) -> PlacedPair:
        assert self.guide is not None
        return self.guide
