"""First-order descent with optax, for many parameters.

Each step needs the gradient of the cost alone. With few unknowns it is J^T r from the forward sensitivities; with many
it comes from one sweep in reverse, back along the kept steps of each run, whose time does not grow with their number:
see `motion.derivatives.pullback`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.studies.fit.levenberg_marquardt import is_converged
from spherejax.studies.fit.methods import Course, Ending, Residuals, cost_of

if TYPE_CHECKING:
    import optax

MANY = 30
"""Unknowns from which on reverse mode is cheaper: a run in reverse takes about as long as this many sensitivities."""

SMALLEST_SHARE = 1e-6
"""Steps are given up when failed runs have shortened them to this share."""


@dataclass(frozen=True)
class Descent:
    """Descent with an optimiser of optax, for many parameters.

    Attributes:
        optimiser: e.g. `optax.adam(1e-2)`. Its steps are in the unknowns of the fit: for a positive parameter in its
            logarithm, so that 1e-2 is one percent. It is given the gradient of the mean square of residuals, halved.
        n_steps: how many steps are made.
        patience: a start ends when its cost has fallen by less than `tolerance` (relative) in so many steps.
        tolerance: see `patience`.
        reverse: whether gradients are computed in reverse mode; None: with more than 30 unknowns.
    """

    optimiser: "optax.GradientTransformation"
    n_steps: int = 500
    patience: int = 50
    tolerance: float = 1e-6
    reverse: bool | None = None

    def __post_init__(self):
        import optax  # whoever asks for a descent has imported it already

        if not isinstance(self.optimiser, optax.GradientTransformation):
            raise SceneError(f"Descent needs an optimiser of optax, e.g. optax.adam(1e-2); it got {self.optimiser!r}")
        if self.n_steps < 1:
            raise SceneError(f"Descent: n_steps = {self.n_steps} must be at least 1")

    @property
    def max_iterations(self) -> int:
        """Steps tried by each start at most."""
        return self.n_steps

    def roughly(self) -> "Descent":
        """The same for a fit whose result is only a start."""
        return replace(self, n_steps=max(1, self.n_steps // 4), patience=max(1, self.patience // 4), tolerance=1e-3)

    def minimize(
        self,
        problem: Residuals,
        us: np.ndarray,
        *,
        noise_is_known: bool,
        watch: Callable[[list[Course]], None] = lambda courses: None,
    ) -> list[Course]:
        """Minimise a sum of squares from one or more starts; as `LevenbergMarquardt.minimize`."""
        us = np.array(us, np.float64)
        descents = [_Descending(self, problem, u) for u in us]
        courses = [descent.course for descent in descents]
        reverse = us.shape[1] > MANY if self.reverse is None else self.reverse
        gradients = _in_reverse if reverse and hasattr(problem, "cost_and_gradient") else _forward
        try:
            while going := [descent for descent in descents if descent.course.ending is None]:
                for descent, found in zip(going, gradients(problem, [each.u for each in going]), strict=True):
                    descent.take(found)
                watch(courses)
        except KeyboardInterrupt:
            if not any(course.us for course in courses):
                raise
            for course in courses:
                course.ending = course.ending or Ending.INTERRUPTED
        _finish(problem, courses, noise_is_known)
        return courses


@dataclass(frozen=True)
class _Gradient:
    """Cost and gradient at some unknowns; NaN where the run failed."""

    cost: float
    gradient: np.ndarray
    n_residuals: int
    diagnosis: str = ""


def _forward(problem: Residuals, us: list[np.ndarray]) -> list[_Gradient]:
    """From forward sensitivities."""
    found = problem.evaluate(np.stack(us))
    return [
        _Gradient(cost_of(r) if not failed else np.nan, j.T @ r, r.size, why)
        for r, j, failed, why in zip(found.residuals, found.jacobians, found.failed, found.diagnoses, strict=True)
    ]


def _in_reverse(problem: Any, us: list[np.ndarray]) -> list[_Gradient]:
    """Back along the steps of the runs."""
    found = [problem.cost_and_gradient(u) for u in us]
    return [_Gradient(each.cost, each.gradient, problem.n_residuals, each.diagnosis) for each in found]


class _Descending:
    """One start on its way."""

    def __init__(self, method: Descent, problem: Residuals, u: np.ndarray):
        import optax

        self.method, self.problem = method, problem
        self.u = self.last = np.array(u)
        self.optimiser = optax.with_extra_args_support(method.optimiser)
        self.state: Any = self.optimiser.init(self.u)
        self.share = 1.0
        self.step = np.zeros_like(self.u)
        self.course = Course()

    def take(self, found: _Gradient) -> None:
        """Go on from what was found at `u`."""
        course, method = self.course, self.method
        course.n_iterations += 1
        if not (np.isfinite(found.cost) and np.all(np.isfinite(found.gradient))):
            self._retreat(found)
            return
        if found.cost < course.cost:
            course.us.append(self.u.copy())
            course.costs.append(found.cost)
            course.ends.append(np.inf)
            self.share = min(1.0, 2 * self.share)
        self.costs = [*getattr(self, "costs", []), course.cost]
        if len(self.costs) > method.patience:
            before = self.costs[-1 - method.patience]
            if before - course.cost <= method.tolerance * before:
                course.ending = Ending.NO_FURTHER_DECREASE
        if course.n_iterations >= method.n_steps:
            course.ending = course.ending or Ending.TOO_MANY_ITERATIONS
        mean = max(found.n_residuals, 1)
        step, self.state = self.optimiser.update(found.gradient / mean, self.state, self.u, value=found.cost / mean)
        self.last, self.step = self.u, np.asarray(step)
        self.u = self.last + self.share * self.step

    def _retreat(self, found: _Gradient) -> None:
        """Take back a step whose run failed, and go on with shorter ones."""
        course = self.course
        course.n_failed, course.diagnosis = course.n_failed + 1, found.diagnosis
        self.share /= 2
        if not course.us:
            course.ending = Ending.FAILED_START
        elif self.share < SMALLEST_SHARE or course.n_iterations >= self.method.n_steps:
            course.ending = Ending.TOO_MANY_ITERATIONS
        self.u = self.last + self.share * self.step


def _finish(problem: Residuals, courses: list[Course], noise_is_known: bool) -> None:
    """Residuals and Jacobians where the starts have ended."""
    best = [course for course in courses if course.us]
    if not best:
        return
    found = problem.evaluate(np.stack([course.u for course in best]))
    for lane, course in enumerate(best):
        course.residuals, course.jacobian = found.residuals[lane], found.jacobians[lane]
        course.costs[-1] = cost_of(course.residuals)
        if course.ending is not Ending.INTERRUPTED and is_converged(
            course.residuals, course.jacobian, noise_is_known, tolerance=0.1
        ):
            course.ending = Ending.CONVERGED
