"""Levenberg-Marquardt on forward sensitivities, with optimistix.

optimistix wants the function that it minimises inside its compiled step. Here that would be all integrations, compiled
anew for each fit. But what a step asks of the function is its value and Jacobian at one point that is known
beforehand, `state.y_eval`. So the integrations are made first, by programs that are compiled once for a structure, and
the step is given the tangent plane at this point. Long residuals are replaced by the few numbers that hold all that
a least-squares step can see of them: with the factorisation Q R of the matrix [J r], the columns of R.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from spherejax.studies.fit.methods import Course, Ending, Residuals, cost_of

SHORTEST_STEP = 1e-9
"""A full step that changes every unknown by less has converged, whatever the noise: u is of order one."""

FAILED = 1e100
"""Stands for the residual of a run that failed: finite, so that nothing becomes NaN, and never accepted."""


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Levenberg-Marquardt: the method for up to some tens of parameters.

    Attributes:
        tolerance: converged when a full Gauss-Newton step would move no combination of parameters by more than this
            share of its standard deviation; or, where the errors of the runs forbid to see that, ten times this share.
        max_iterations: steps tried by each start at most.
        damping: first damping, as a share of the largest eigenvalue of J^T J.
        longest_step: no unknown moves by more in a step; of a positive parameter its logarithm.
    """

    tolerance: float = 1e-2
    max_iterations: int = 100
    damping: float = 1e-3
    longest_step: float = 2.0

    def roughly(self) -> "LevenbergMarquardt":
        """The same for a fit whose result is only a start."""
        return replace(self, tolerance=max(0.1, self.tolerance))

    def minimize(
        self,
        problem: Residuals,
        us: np.ndarray,
        *,
        noise_is_known: bool,
        watch: Callable[[list[Course]], None] = lambda courses: None,
    ) -> list[Course]:
        """Minimise a sum of squares from one or more starts.

        Args:
            problem: has `evaluate`.
            us: unknowns where each start begins, shape (lanes, k).
            noise_is_known: whether residuals of size one are expected.
            watch: told of every step.

        Returns:
            The course of each start. An interrupt (Ctrl-C) ends it with what has been found; one before anything has
            been found is passed on.
        """
        courses = [Course() for _ in us]
        try:
            self._minimize(problem, us, noise_is_known, courses, watch)
        except KeyboardInterrupt:
            if not any(course.us for course in courses):
                raise
            for course in courses:
                course.ending = course.ending or Ending.INTERRUPTED
        return courses

    def _minimize(self, problem: Residuals, us, noise_is_known: bool, courses: list[Course], watch) -> None:
        us = np.array(us, np.float64)
        first = problem.evaluate(us)
        for lane, course in enumerate(courses):
            course.n_iterations = 1
            if first.failed[lane]:
                course.ending, course.diagnosis, course.n_failed = Ending.FAILED_START, first.diagnoses[lane], 1
            else:
                course.accept(us[lane], first.residuals[lane], first.jacobians[lane])
        scales = np.array([_scale_of(course.jacobian, self.damping) if course.us else 1.0 for course in courses])
        stepping = _stepping(len(us), us.shape[1])
        y, state = stepping.beginning(us)
        found = first
        watch(courses)
        while True:
            y, state = stepping.step(y, state, us, _compressed(found, scales))
            for lane, course in enumerate(courses):
                if course.ending is None:
                    course.ending = self._ending_of(course, noise_is_known, np.asarray(state.y_eval)[lane])
            watch(courses)
            if all(course.ending is not None for course in courses):
                return
            us, state = self._next(courses, y, state)
            found = problem.evaluate(us)
            for lane, course in enumerate(courses):
                if course.ending is None:
                    _take(course, us[lane], found, lane)

    def _next(self, courses: list[Course], y, state):
        """Where to look next: no unknown too far away, and those that are done stay."""
        y, wanted = np.asarray(y), np.asarray(state.y_eval)
        steps = wanted - y
        longest = np.max(np.abs(steps), 1, keepdims=True)
        steps = steps * np.minimum(1.0, self.longest_step / np.maximum(longest, 1e-300))
        us = y + steps
        for lane, course in enumerate(courses):
            if course.ending is not None and course.us:
                us[lane] = course.u
        return us, eqx.tree_at(lambda s: s.y_eval, state, jnp.asarray(us))

    def _ending_of(self, course: Course, noise_is_known: bool, proposed: np.ndarray) -> Ending | None:
        if is_converged(course.residuals, course.jacobian, noise_is_known, self.tolerance):
            return Ending.CONVERGED
        is_near = is_converged(course.residuals, course.jacobian, noise_is_known, 10 * self.tolerance)
        if (course.was_rejected and is_near) or np.max(np.abs(proposed - course.u)) < SHORTEST_STEP / 10:
            return Ending.NO_FURTHER_DECREASE
        return Ending.TOO_MANY_ITERATIONS if course.n_iterations >= self.max_iterations else None


def _take(course: Course, u: np.ndarray, found, lane: int) -> None:
    """Note what a step has found."""
    course.n_iterations += 1
    course.was_rejected = True
    if found.failed[lane]:
        course.n_failed, course.diagnosis = course.n_failed + 1, found.diagnoses[lane]
    elif _is_accepted(course, u, found.residuals[lane]):
        course.accept(u, found.residuals[lane], found.jacobians[lane])
        course.was_rejected = False


def _is_accepted(course: Course, u: np.ndarray, residuals: np.ndarray) -> bool:
    """By the criterion of optimistix's trust region."""
    predicted = cost_of(course.residuals + course.jacobian @ (u - course.u)) - course.cost
    return cost_of(residuals) - course.cost <= float(LEAST_GAIN * predicted)


def is_converged(residuals: np.ndarray, jacobian: np.ndarray, noise_is_known: bool, tolerance: float) -> bool:
    """Whether a full Gauss-Newton step would move nothing by more than a share of its standard deviation.

    The relative offset of Bates and Watts: the part of the residuals that parameters can still remove, against what
    they cannot.
    """
    n, k = jacobian.shape
    left, singular, right = np.linalg.svd(jacobian, full_matrices=False)
    counts = singular > singular[0] * max(n, k) * np.finfo(float).eps if k else np.zeros(0, bool)
    removable = (left.T @ residuals)[counts]
    variance = max(2 * cost_of(residuals) - removable @ removable, 0.0) / max(n - k, 1)
    if noise_is_known:
        variance = max(variance, 1.0)
    if np.sqrt(removable @ removable / max(k, 1)) <= tolerance * np.sqrt(variance):
        return True
    step = right.T[:, counts] @ (removable / singular[counts])
    return bool(np.max(np.abs(step), initial=0.0) < SHORTEST_STEP)


LEAST_GAIN = 0.01
"""A step is kept if it gains at least this share of what the tangent plane promises."""


# The step of optimistix -----------------------------------------------------------------------------------------------

SEARCH = optx.ClassicalTrustRegion(high_cutoff=0.75, low_cutoff=LEAST_GAIN, high_constant=5.0, low_constant=0.2)
"""optimistix's own widens the region only where the model is right to one percent: too careful for motions."""


def _tangent_plane(u, plane):
    at, residuals, jacobian = plane
    return residuals + jacobian @ (u - at), None


class _Stepping:
    """optimistix's solver, compiled for a number of lanes and unknowns."""

    def __init__(self, lanes: int, k: int):
        solver = optx.LevenbergMarquardt(rtol=0.0, atol=0.0)  # it ends by our criterion
        self.solver = eqx.tree_at(lambda s: s.search, solver, SEARCH)
        self.lanes, self.k = lanes, k
        self.step = jax.jit(jax.vmap(self._step))

    def beginning(self, us: np.ndarray):
        """Unknowns and state before the first step."""
        residuals = jax.ShapeDtypeStruct((self.k + 1,), jnp.float64)
        plane = (us[0], np.zeros(self.k + 1), np.zeros((self.k + 1, self.k)))

        def begin(u):
            options = {"jac": "bwd"}
            return self.solver.init(_tangent_plane, u, plane, options, residuals, None, frozenset())

        return jnp.asarray(us), jax.vmap(begin)(jnp.asarray(us))

    def _step(self, y, state, at, plane) -> Any:
        plane = (at, *plane)
        y, state, _ = self.solver.step(_tangent_plane, y, plane, {"jac": "bwd"}, state, frozenset())
        return y, state


@lru_cache(maxsize=32)
def _stepping(lanes: int, k: int) -> _Stepping:
    return _Stepping(lanes, k)


def _scale_of(jacobian: np.ndarray, damping: float) -> float:
    """Residuals are divided by this, for optimistix's first damping of 1 to be the wanted one."""
    largest = np.linalg.norm(jacobian, 2)
    return float(largest * np.sqrt(damping)) or 1.0


def _compressed(found, scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals and Jacobians of all lanes by the k + 1 numbers that a step can see of each column."""
    lanes, n, k = found.jacobians.shape
    residuals, jacobians = np.zeros((lanes, k + 1)), np.zeros((lanes, k + 1, k))
    for lane in range(lanes):
        if found.failed[lane]:
            residuals[lane] = FAILED
            continue
        columns = np.column_stack([found.jacobians[lane], found.residuals[lane]]) / scales[lane]
        upper = np.asarray(np.linalg.qr(columns, mode="r"))
        rows = min(n, k + 1)
        jacobians[lane, :rows], residuals[lane, :rows] = upper[:, :k], upper[:, k]
    return residuals, jacobians
