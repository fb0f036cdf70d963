"""The search from one start: rounds of sequential quadratic programming (SciPy's SLSQP) with sharper and sharper peaks.

Everything is scaled: the measure to make least by its value at the start, limits by their size.
"""

import sys
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.studies.design.problem import DesignProblem, Measures

FAILED = 10.0
"""A design whose run fails counts as this many times the worst seen, so that a line search turns back."""

EXTRA_ROUNDS = 2
"""Rounds more at the last sharpness, while the true peaks do not keep the limits."""


class Search(NamedTuple):
    """What a search from one start has seen.

    Attributes:
        start: the first design.
        end: where the last round ended.
        seen: all designs, in order.
        n_iterations: of all rounds.
        message: how the last round ended.
        converged: whether it ended by its tolerance.
    """

    start: Measures
    end: Measures
    seen: list[Measures]
    n_iterations: int
    message: str
    converged: bool


class Interrupted(Exception):  # noqa: N818 - it carries a result
    """Ctrl-C, with what had been seen."""

    def __init__(self, search: Search):
        super().__init__("interrupted")
        self.search = search


class Constrained:
    """min f with g_j within limits, of scaled unknowns.

    Attributes:
        problem: measures and derivatives; the first measure is made least.
        first: the given start.
        limits: pairs (lower, upper).
        limited: index of the measure that each limits.
        tolerance: how closely limits are kept, as a share.
    """

    def __init__(self, problem: DesignProblem, first: Measures, limits, limited: list[int], tolerance: float):
        self.problem, self.first, self.tolerance = problem, first, tolerance
        self.limits, self.limited = limits, limited
        self.objective_scale = abs(first.true[0]) or 1.0
        # One row for each finite side: sign * (measure - bound) / scale <= 0.
        self.rows = [
            (index, sign, bound, abs(bound) or abs(first.true[index]) or 1.0)
            for index, (low, high) in zip(limited, limits, strict=True)
            for sign, bound in ((-1.0, low), (1.0, high))
            if np.isfinite(bound)
        ]

    def excesses(self, values: np.ndarray) -> np.ndarray:
        """How far each limit is overstepped, as a share of it; negative where it is kept."""
        return np.array([sign * (values[index] - bound) / scale for index, sign, bound, scale in self.rows])

    def excess_slopes(self, slopes: np.ndarray) -> np.ndarray:
        """Derivatives of `excesses`, shape (n_rows, k)."""
        rows = [sign * slopes[index] / scale for index, sign, _, scale in self.rows]
        return np.array(rows).reshape(-1, slopes.shape[1])

    def keeps_limits(self, one: Measures) -> bool:
        """Whether the true measures are within the limits, to the tolerance."""
        return one.succeeded and bool(np.all(self.excesses(one.true) <= self.tolerance))

    def best(self, seen: list[Measures]) -> Measures:
        """The design of the least measure that keeps the limits; if none does, the one that oversteps least."""
        legal = [one for one in seen if self.keeps_limits(one)]
        if legal:
            return min(legal, key=lambda one: one.true[0])
        finite = [one for one in seen if one.succeeded]
        return min(finite, key=lambda one: np.max(self.excesses(one.true), initial=-np.inf))

    def multipliers(self, one: Measures) -> tuple[np.ndarray, float]:
        """Prices of the limits, and what remains of the gradient (0 at an optimum), by the conditions of Karush, Kuhn
        and Tucker, both for scaled measures.

        Only limits and bounds that the design touches count.
        """
        correction = corrections(self.problem, one)
        slopes = one.slopes * correction[:, None]
        gradient = slopes[0] / self.objective_scale
        touched = np.abs(self.excesses(one.true)) < 10 * self.tolerance
        columns = list(self.excess_slopes(slopes)[touched])
        low, high = self.problem.bounds.T
        for at, (l, u, h) in enumerate(zip(low, one.u, high, strict=True)):  # noqa: E741
            for sign, is_touched in ((-1.0, u - l < self.tolerance), (1.0, h - u < self.tolerance)):
                if is_touched:
                    columns.append(sign * np.eye(one.u.size)[at])
        prices = np.zeros(len(self.rows))
        size = np.linalg.norm(gradient)
        if not columns:
            return prices, 1.0 if size > 0 else 0.0
        from scipy import optimize  # not every process that imports this package needs it

        found, residual = optimize.nnls(np.array(columns).T, -gradient)
        prices[touched] = found[: int(np.sum(touched))]
        return prices, float(residual / size) if size else 0.0


def corrections(problem: DesignProblem, one: Measures) -> Float[np.ndarray, " m"]:
    """True over smooth measures; 1 where they are the same."""
    peaks = np.array([each.kind == "peak" for each in problem.measures])
    return np.where(peaks & (one.smooth != 0), one.true / np.where(one.smooth == 0, 1.0, one.smooth), 1.0)


def search(
    task: Constrained, u: np.ndarray, sharpnesses: tuple[float, ...], max_iterations: int, label: str | None
) -> Search:
    """Rounds from one start.

    Raises:
        Interrupted: by Ctrl-C, with what had been seen.
    """
    seen: list[Measures] = []
    state = Search(_seen(task, u, sharpnesses[0], seen), task.first, seen, 0, "", False)
    if not state.start.succeeded:
        return state._replace(message=f"the run of this start failed: {state.start.diagnosis}")
    rounds = list(sharpnesses) + [sharpnesses[-1]] * EXTRA_ROUNDS
    for number, sharpness in enumerate(rounds):
        if number >= len(sharpnesses) and task.keeps_limits(state.end):
            break
        try:
            found = _round(task, u, sharpness, max_iterations, seen)
        except KeyboardInterrupt:
            raise Interrupted(state._replace(end=seen[-1], message="interrupted")) from None
        u = found.x
        end = _seen(task, u, sharpness, seen)
        state = state._replace(
            end=end, n_iterations=state.n_iterations + int(found.nit), message=found.message, converged=found.success
        )
        if label is not None:
            print(_line(task, end, label, sharpness, found), file=sys.stderr)
    return state


def _round(task: Constrained, u, sharpness: float, max_iterations: int, seen: list[Measures]):
    correction = corrections(task.problem, _seen(task, u, sharpness, seen))
    low, high = task.problem.bounds.T
    worst = [1.0]

    def at(u) -> Measures:
        return _seen(task, np.clip(u, low, high), sharpness, seen)

    def value(u):
        one = at(u)
        if not one.succeeded:
            return FAILED * worst[0]
        found = correction[0] * one.smooth[0] / task.objective_scale
        worst[0] = max(worst[0], abs(found))
        return found

    def slope(u):
        return np.nan_to_num(correction[0] * at(u).slopes[0] / task.objective_scale)

    def room(u):
        one = at(u)
        return -task.excesses(correction * one.smooth) if one.succeeded else np.full(len(task.rows), -FAILED)

    def room_slopes(u):
        return np.nan_to_num(-task.excess_slopes(correction[:, None] * at(u).slopes))

    limits = [{"type": "ineq", "fun": room, "jac": room_slopes}] if task.rows else []
    options = {"ftol": task.tolerance * 1e-2, "maxiter": max_iterations}
    bounds = list(zip(low, high, strict=True))
    from scipy import optimize

    return optimize.minimize(value, u, jac=slope, method="SLSQP", bounds=bounds, constraints=limits, options=options)


def _seen(task: Constrained, u, sharpness: float, seen: list[Measures]) -> Measures:
    one = task.problem.evaluate(u, sharpness)
    if not seen or seen[-1] is not one:
        seen.append(one)
    return one


def _line(task: Constrained, end: Measures, label: str, sharpness: float, found) -> str:
    values = ", ".join(
        f"{name} {value:.6g}" for name, value in zip(task.problem.unknowns.names, _flat(task, end), strict=True)
    )
    objective = task.problem.measures[0]
    kept = "limits kept" if task.keeps_limits(end) else "limits not kept yet"
    return (
        f"{label}sharpness {sharpness:g}: {objective.name} {end.true[0]:.6g} {objective.unit} at {values}; {kept}; "
        f"{found.nit} iterations"
    )


def _flat(task: Constrained, one: Measures) -> np.ndarray:
    return task.problem.unknowns.flat_values_of(one.u)
