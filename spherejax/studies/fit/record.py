"""How much of the record a method sees: all of it, or a part that grows.

A start that is far off predicts a vibration of another frequency. After a few periods it is out of step with what was
measured, and the cost has minima wherever it is in step again by chance. Over a short part of the record there is
no such minimum yet; its estimates bring the next part, twice as long, in step.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from spherejax.studies.fit.experiment import CostAndGradient
from spherejax.studies.fit.methods import Course, Ending, Method, cost_of
from spherejax.studies.fit.problem import Evaluation, Problem

Watching = Callable[[list[Course]], None]


class Horizon(Protocol):
    """How the record is shown to a method: `Whole`, `Grown`, or one of your own."""

    def minimize(
        self, problem: Problem, method: Method, us: np.ndarray, *, noise_is_known: bool, watch: Watching
    ) -> list[Course]:
        """Minimise from one or more starts; the courses end with residuals and Jacobian of the whole record."""
        ...


@dataclass(frozen=True)
class Whole:
    """The whole record at once."""

    def minimize(
        self, problem: Problem, method: Method, us: np.ndarray, *, noise_is_known: bool, watch: Watching
    ) -> list[Course]:
        """Minimise from one or more starts."""
        return method.minimize(problem, us, noise_is_known=noise_is_known, watch=watch)


@dataclass(frozen=True)
class Grown:
    """Rough fits of parts of the record, each twice as long as the one before, then the whole.

    Attributes:
        doublings: how often the first part is doubled.
        held: in the rough fits an unknown counts as known to this standard deviation (of a positive parameter: of its
            logarithm), so that what a short part does not show stays where it is.
    """

    doublings: int = 5
    held: float = 3.0

    def minimize(
        self, problem: Problem, method: Method, us: np.ndarray, *, noise_is_known: bool, watch: Watching
    ) -> list[Course]:
        """Minimise from one or more starts."""
        first, us = np.array(us), np.array(us)
        courses: list[Course | None] = [None] * len(us)
        for end in self._ends(problem):
            part = Held(problem.until(end), us.copy(), self.held)
            found = method.roughly().minimize(part, us, noise_is_known=noise_is_known, watch=watch)
            courses = [new.after(old, end) for new, old in zip(found, courses, strict=True)]
            # Where a longer part cannot be run, what the shorter one has found is of no use.
            us = np.stack([new.u if new.us else start for new, start in zip(found, first, strict=True)])
            if any(course.ending is Ending.INTERRUPTED for course in found):
                return of_the_whole([course for course in courses if course is not None], problem)
        found = method.minimize(problem, us, noise_is_known=noise_is_known, watch=watch)
        lost = [not new.us and not np.array_equal(u, start) for new, u, start in zip(found, us, first, strict=True)]
        if any(lost):
            again = np.where(np.array(lost)[:, None], first, us)
            second = method.minimize(problem, again, noise_is_known=noise_is_known, watch=watch)
            found = [new if was_lost else old for new, old, was_lost in zip(second, found, lost, strict=True)]
        found = [new.after(old, np.inf) if new.us else new for new, old in zip(found, courses, strict=True)]
        whole = partial(method.minimize, problem, noise_is_known=noise_is_known, watch=watch)
        return no_worse_than_starts(problem, found, first, whole)

    def _ends(self, problem: Problem) -> list[float]:
        """Ends of the parts that show enough for a fit [s]."""
        begin = min(each.measured.t0 for each in problem.experiments)
        end = max(float(each.measured.ts[-1]) for each in problem.experiments)
        ends = [begin + (end - begin) / 2**i for i in range(self.doublings, 0, -1)]
        return [each for each in ends if _shows_enough(problem, each)]


def no_worse_than_starts(
    problem: Problem, courses: list[Course], starts: np.ndarray, minimize: Callable[[np.ndarray], list[Course]]
) -> list[Course]:
    """Courses whose minima are no larger than the costs at their starts, which a short part of a record may lead away.

    What was looked at elsewhere is kept in `Course.others`.

    Args:
        problem: with the whole record.
        courses: through its parts.
        starts: of each.
        minimize: from some unknowns, over the whole record.
    """
    moved = [i for i, each in enumerate(courses) if each.us and not np.array_equal(each.u, starts[i])]
    if not moved or any(each.ending is Ending.INTERRUPTED for each in courses):
        return courses
    try:
        at = problem.evaluate(starts[moved])
    except KeyboardInterrupt:  # what has been found is kept
        for each in courses:
            each.ending = Ending.INTERRUPTED
        return courses
    costs = {i: np.inf if bad else cost_of(r) for i, r, bad in zip(moved, at.residuals, at.failed, strict=True)}
    worse = [i for i in moved if costs[i] < courses[i].cost]
    again = dict(zip(worse, minimize(starts[worse]) if worse else [], strict=True))
    found = list(courses)
    for i in moved:
        others, other = [(starts[i], costs[i])], again.get(i)
        if other is not None and other.us and other.cost < courses[i].cost:
            others.append((courses[i].u, courses[i].cost))
            found[i] = other.after(courses[i], np.inf)
        elif other is not None and other.ending is Ending.INTERRUPTED:
            found[i].ending = Ending.INTERRUPTED
        found[i].others = others
    return found


def _shows_enough(problem: Problem, end: float) -> bool:
    n = sum(int(np.sum(each.until(end).is_measured)) for each in problem.experiments)
    return n >= 5 * problem.unknowns.size


class Held:
    """A problem in which unknowns are known beforehand, loosely."""

    def __init__(self, problem: Problem, us: np.ndarray, deviation: float):
        self.problem, self.us, self.deviation = problem, us, deviation
        self.n_residuals = problem.n_residuals + us.shape[1]

    def cost_and_gradient(self, u: np.ndarray) -> CostAndGradient:
        """Half the sum of squares and its gradient in reverse mode."""
        found = self.problem.cost_and_gradient(u)
        (away,) = self._away(u[None])
        return found._replace(cost=found.cost + cost_of(away), gradient=found.gradient + away / self.deviation)

    def evaluate(self, us: np.ndarray) -> Evaluation:
        """Residuals with those of what is known beforehand."""
        found = self.problem.evaluate(us)
        away = self._away(us)
        identity = np.broadcast_to(np.eye(us.shape[1]) / self.deviation, (len(us), us.shape[1], us.shape[1]))
        return found._replace(
            residuals=np.concatenate([found.residuals, away], 1),
            jacobians=np.concatenate([found.jacobians, identity], 1),
        )

    def _away(self, us: np.ndarray) -> np.ndarray:
        """From each one's own start, in standard deviations; from the nearest one where only some of them go on."""
        starts = self.us
        if len(us) != len(starts):
            starts = starts[np.argmin(np.sum((us[:, None] - starts) ** 2, 2), axis=1)]
        return (us - starts) / self.deviation


def of_the_whole(courses: list[Course], problem: Problem) -> list[Course]:
    """Courses that were interrupted while the record grew, with residuals of the whole."""
    found = problem.evaluate(np.stack([course.u if course.us else problem.u0 for course in courses]))
    for lane, course in enumerate(courses):
        course.ending = course.ending or Ending.INTERRUPTED
        if not course.us or found.failed[lane]:
            courses[lane] = Course(ending=Ending.FAILED_START, diagnosis=course.diagnosis or found.diagnoses[lane])
        else:
            course.accept(course.u, found.residuals[lane], found.jacobians[lane])
    return courses
