"""Continuation: along a branch of cycles from one to the next, round its folds.

Unknowns are the independent coordinates, the period where it is free, and the number. The tangent of the branch is the
null vector of [M - 1, T f, dr/dp] that moves across the orbit; a step along it is corrected by the least Newton steps,
which lead back across the tangent, so that a fold is passed like any other point. Steps grow and shrink by how many
corrections were needed and by how far the tangent turned.

Source: E. Allgower, K. Georg, Numerical Continuation Methods (1990), chapters 3 and 6; R. Seydel, Practical
Bifurcation and Stability Analysis, 3rd ed. (2010), chapter 4 and section 7.5.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.studies.cycles.cycle_result import Multipliers
from spherejax.studies.cycles.shooting import (
    CandidateState,
    SearchOutcome,
    Shooting,
    Shot,
    matrix,
    search,
    stacked_places,
)

SMALLEST_STEP = 1e-5
"""Shares of the span, or of the size of the cycle: a branch that asks for shorter steps ends."""

FEW, MANY = 4, 7
"""Newton steps below which the next step is longer, and above which it is shorter."""

GENTLE = 0.85
"""Cosine of the angle by which the tangent may turn in a step; beyond, the step is made again, half as long."""

N_LOCATED = 8
"""Largest number of trial points in the search for an event between two points."""

LOCATED = 1e-6
"""An event is found to this share of the step between its points."""


class BranchPoint(NamedTuple):
    """A cycle of a branch.

    Attributes:
        shot: its state, and what a period makes of it.
        tangent: of the branch, of length one: coordinates in shares of the cycle's size, dT/T where the period is free,
            and the number in shares of the span.
        multipliers: of the cycle.
    """

    shot: Shot
    tangent: Float[np.ndarray, " k"]
    multipliers: Multipliers

    @property
    def slope(self) -> float:
        """How fast the number goes along the branch."""
        return float(self.tangent[-1])

    @property
    def direction(self) -> Float[np.ndarray, " n_z"]:
        """The change of the state along the tangent, world axes."""
        shot = self.shot
        n = len(shot.residual)
        basis = shot.coordinates.basis[:, shot.chosen] * shot.units
        return basis @ (self.tangent[:n] * shot.size) + shot.start_by_number * self.tangent[-1]


class Stepper:
    """Goes along a branch.

    Args:
        shooting: with the span of the number as the change `by`.
        tolerance: to which cycles close.
        unknown_period: whether the period is free.
        knows_time: whether anything depends on time.
    """

    def __init__(self, shooting: Shooting, tolerance: float, unknown_period: bool, knows_time: bool):
        self.shooting, self.tolerance = shooting, tolerance
        self.unknown_period, self.knows_time = unknown_period, knows_time

    def point(self, shot: Shot, before: BranchPoint | None) -> BranchPoint:
        """A cycle as a point, its tangent the way that leads on from the one before; at first, to larger shares."""
        J, _ = matrix(shot, self.unknown_period, True)
        n = len(shot.residual)
        # In shares of the size: every column of the state is that much shorter, and so is the residual.
        _, _, right = np.linalg.svd(J)
        null = right[n - self.n_shifts :].T
        if self.n_shifts:
            shift = np.zeros(len(right))
            shift[:n] = shot.by_period
            inside = null.T @ shift
            inside = inside / (np.linalg.norm(inside) or 1.0)
            across = np.eye(len(inside)) - np.outer(inside, inside)
            null = null @ np.linalg.svd(across)[0][:, : len(inside) - 1]
        tangent = null[:, -1] if null.shape[1] == 1 else null @ null[-1] / (np.linalg.norm(null[-1]) or 1.0)
        tangent = tangent / np.linalg.norm(tangent)
        leads = tangent[-1]
        if before is not None:
            leads = self._along(shot, before.direction, before.slope) @ tangent
        tangent = tangent if leads >= 0 else -tangent
        rtol = self.shooting.family.rtol
        return BranchPoint(shot, tangent, Multipliers.of(shot.monodromy, self.knows_time, rtol, shot.doubt))

    @property
    def n_shifts(self) -> int:
        """Directions besides the branch that lead to a cycle: along itself, where nothing knows the time."""
        return 0 if self.knows_time or not self.unknown_period else 1

    def _along(self, shot: Shot, direction: np.ndarray, slope: float) -> np.ndarray:
        """A direction of another point in the unknowns of this one."""
        inverse = shot.coordinates.inverse[shot.chosen] / shot.units[:, None]
        x = inverse @ direction / shot.size
        return np.concatenate([x, np.zeros(int(self.unknown_period)), [slope]])

    def turned(self, first: BranchPoint, second: BranchPoint) -> float:
        """Cosine of the angle between two tangents, as far as state and number show it."""
        before = self._along(second.shot, first.direction, first.slope)
        return float(before @ second.tangent / max(np.linalg.norm(before), 1e-300))

    def predicted(self, point: BranchPoint, step: float) -> CandidateState:
        """The place after a step along the tangent."""
        shot, n = point.shot, len(point.shot.residual)
        change = step * point.tangent
        period = shot.place.period * np.exp(change[n]) if self.unknown_period else shot.place.period
        by = self.shooting.by
        assert by is not None
        y = shot.moved(self.shooting.family, shot.size * change[:n], change[-1])
        return self.shooting.timed(CandidateState(y, period, shot.place.values + change[-1] * by))

    def corrected(self, place: CandidateState, *, by_number: bool = True) -> SearchOutcome:
        """The cycle that corrections lead to."""
        return search(
            self.shooting,
            stacked_places([place]),
            tolerance=self.tolerance,
            unknown_period=self.unknown_period,
            by_number=by_number,
        )[0]

    def located(
        self, first: BranchPoint, step: float, value: Callable[[BranchPoint], float], ends: tuple[float, float]
    ) -> BranchPoint:
        """The point of a step at which a function of points changes sign, by the Illinois rule."""
        (a, b), (fa, fb) = (0.0, step), ends
        best, best_size = first, abs(fa)
        for _ in range(N_LOCATED):
            middle = b - fb * (b - a) / (fb - fa)
            found = self.corrected(self.predicted(first, middle))
            if not found.is_cycle:
                break
            point = self.point(found.shot, first)
            f = value(point)
            if abs(f) < best_size:
                best, best_size = point, abs(f)
            if abs(b - a) < LOCATED * abs(step) or f == 0:
                break
            if f * fb < 0:
                a, fa = b, fb
            else:
                fa = fa / 2
            b, fb = middle, f
            if abs(f) < 1e-9:
                break
        return best
