"""The record grows instant by instant where it must, and fast where it may: for chaotic contact.

Behind every impact a difference of the parameters grows. A start that is far off has lost the measured motion after a
few impacts, and the cost over the whole record is a thicket of minima. Over a record that ends just behind the first
impact there is one minimum; from there the next impact is within reach, and so on. The gradient is asked only as far
as it means something.

A longer part is *explained* when a fit of it, begun at the estimates of the part before, leaves residuals like those
before. If not, the step was too long: it is shortened, down to one instant of measurement. What one instant more
cannot explain from here is tried from other parameters around the estimates.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.studies.fit.methods import Course, Ending, Method
from spherejax.studies.fit.problem import Problem
from spherejax.studies.fit.record import Held, Watching, no_worse_than_starts, of_the_whole
from spherejax.studies.random_numbers import Rng, generator, rng_was_seed

SMALLEST_SIZE = 1e-6
"""Residuals below this share of what was measured are errors of the runs: measurements without noise have no less."""


@dataclass(frozen=True)
class GrowingHorizon:
    """The first part of the record is fitted, then longer and longer ones; each start by itself.

    Attributes:
        first: length of the first part [s]; None: five measured instants, or more where there are many parameters.
        explained: how many times larger the residuals of a part may be (root mean square) than those of the part
            before, or than the stated noise, and count as explained.
        restarts: from how many other parameters a part is tried that is not explained otherwise.
        spread: how far away these are, in each unknown (of positive parameters: a factor of exp(spread) or less).
        held: in the fits of parts an unknown counts as known to this standard deviation around where the fit began
            (of a positive parameter: of its logarithm), so that what a short part does not show stays where it is.
        rng: of the restarts, a whole number or a generator.
    """

    first: float | None = None
    explained: float = 3.0
    restarts: int = 8
    spread: float = 0.8
    held: float = 3.0
    rng: Rng = 0

    def __post_init__(self):
        for name in ("explained", "spread", "held") + (("first",) if self.first is not None else ()):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise SceneError(f"GrowingHorizon: {name} = {value!r} must be positive")
        if not self.explained > 1:
            raise SceneError(f"GrowingHorizon: explained = {self.explained:.6g} must be more than 1, e.g. 3")
        if self.restarts < 0:
            raise SceneError(f"GrowingHorizon: restarts = {self.restarts} must not be negative")

    def minimize(
        self, problem: Problem, method: Method, us: np.ndarray, *, noise_is_known: bool, watch: Watching
    ) -> list[Course]:
        """Minimise from one or more starts; the courses end with residuals and Jacobian of the whole record."""
        courses: list[Course] = []
        for u in np.asarray(us, np.float64):

            def fitted(part, u, method=method):
                def told(now):
                    watch([*courses, *now])

                return method.minimize(part, u[None], noise_is_known=noise_is_known, watch=told)[0]

            courses.append(_Growth(self, problem, method, fitted, u, noise_is_known).course())
            if courses[-1].ending is Ending.INTERRUPTED:
                break
        return courses


GrowingHorizon.__init__ = rng_was_seed(GrowingHorizon.__init__)  # pyright: ignore[reportAttributeAccessIssue]


class _HorizonPart(NamedTuple):
    """A fit of a part of the record.

    Attributes:
        course: where it went.
        size: root mean square of its residuals.
        newest: of those behind the part before.
    """

    course: Course
    size: float
    newest: float


class _Growth:
    """One start on its way through the record."""

    def __init__(
        self, horizon: GrowingHorizon, problem: Problem, method: Method, fitted: Callable, u, noise_is_known: bool
    ):
        self.horizon, self.problem, self.method, self.fitted = horizon, problem, method, fitted
        self.start, self.size = u, 1.0 if noise_is_known else 0.0
        self.instants = np.unique(np.concatenate([instants_of(each) for each in problem.experiments]))
        self.random = generator(horizon.rng)
        self.gone: Course | None = None

    def course(self) -> Course:
        """Through the record, then the whole."""
        try:
            u = self._grown()
            found = self.fitted(self.problem, u).after(self.gone, np.inf)
            start = self.start[None]
            return no_worse_than_starts(self.problem, [found], start, lambda u: [self.fitted(self.problem, u[0])])[0]
        except KeyboardInterrupt:
            if self.gone is None:
                raise
            self.gone.ending = Ending.INTERRUPTED
            return of_the_whole([self.gone], self.problem)[0]

    def _grown(self) -> np.ndarray:
        """Estimates from rough fits of longer and longer parts, the last of them the whole."""
        n, u = self.instants.size, self.start
        reached, step = 0, self._first()
        while reached < n:
            step = min(step, n - reached)
            found = self._part(u, reached, step)
            if self.size == 0 or not self._is_explained(found):
                if step > 1 and self.size > 0:
                    step = max(1, step // 4)
                    continue
                found = self._from_elsewhere(found, u, reached, step)
            if found.course.us:
                self.gone = found.course.after(self.gone, float(self.instants[reached + step - 1]))
                u, self.size = found.course.u, max(self.size, found.size, SMALLEST_SIZE)
            reached, step = reached + step, 2 * step
        return u

    def _first(self) -> int:
        """How many instants the first part has."""
        if self.horizon.first is None:
            return max(5, 2 * self.problem.unknowns.size)
        return max(1, int(np.searchsorted(self.instants, self.instants[0] + self.horizon.first, side="right")))

    def _part(self, u: np.ndarray, reached: int, step: int) -> _HorizonPart:
        """A rough fit of the first instants, `step` more than before."""
        end = float(self.instants[reached + step - 1])
        problem = self.problem.until(end)
        course = self.fitted(Held(problem, self.start[None], self.horizon.held), u, self.method.roughly())
        if course.ending is Ending.INTERRUPTED:
            self.gone = course.after(None, end) if self.gone is None else self.gone
            raise KeyboardInterrupt
        if not course.us:
            return _HorizonPart(course, np.inf, np.inf)
        residuals = course.residuals[: problem.n_residuals]
        is_new = np.concatenate([instants_of(each) for each in problem.experiments]) >= self.instants[reached]
        return _HorizonPart(course, _root_mean_square(residuals), _root_mean_square(residuals[is_new]))

    def _is_explained(self, found: _HorizonPart) -> bool:
        """Whether the residuals, and those of what is new among them, are like those before."""
        return max(found.newest, found.size) <= self.horizon.explained * self.size

    def _from_elsewhere(self, found: _HorizonPart, u: np.ndarray, reached: int, step: int) -> _HorizonPart:
        """A part tried from other parameters; the best fit.

        Where the size of the noise is not known yet, all of them are tried: this part will be the measure of it.
        """
        for _ in range(self.horizon.restarts):
            away = self.random.uniform(-self.horizon.spread, self.horizon.spread, u.size)
            other = self._part(u + away, reached, step)
            if other.size < found.size:
                found = other
            if self.size > 0 and self._is_explained(found):
                break
        return found


def instants_of(experiment) -> np.ndarray:
    """When each residual of an experiment was measured [s]."""
    return experiment.measured.ts[np.nonzero(experiment.is_measured)[0]]


def _root_mean_square(residuals: np.ndarray) -> float:
    return float(np.sqrt(np.mean(residuals**2))) if residuals.size else 0.0
