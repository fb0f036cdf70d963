"""The result of a design study."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from spherejax.motion.results.trajectory import Trajectory
from spherejax.studies.design.constrained import Constrained, Search, corrections
from spherejax.studies.design.problem import DesignProblem, Measures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

APART = 1e-2
"""Searches whose ends differ by more than this share of the measure have found different designs."""

NEAR_OPTIMAL = 0.05
"""What may remain of the gradient, as a share of it, in a design that is called optimal."""


class Limit(NamedTuple):
    """A limit and how the design stands to it.

    Attributes:
        name: of the measure.
        lower, upper: what is allowed; infinite where nothing is.
        value: of the design.
        start: of the start.
        active: whether the design lies on it, and would be better without it.
        price: how much the measure that is made least would fall if the limit were looser by one of its units.
        unit: of the measure.
    """

    name: str
    lower: float
    upper: float
    value: float
    start: float
    active: bool
    price: float
    unit: str


@dataclass(frozen=True)
class Design:
    """The best design that was found.

    Attributes:
        values: parameters by name.
        start: those of the start.
        minimized: name of the measure that was made least.
        unit: its unit; empty where it is not known.
        objective: the measure of the design; for a peak the largest sample.
        objective_at_start: of the start.
        limits: each limit, and how the design stands to it.
        gradient: derivative of each measure by each parameter at the design, by names; of a peak that of the smooth
            one of the last sharpness.
        optimality: what remains of the gradient of the measure that limits and bounds do not balance, as a share of
            it (both by relative changes of the parameters): 0 at an optimum.
        ends: measure at the end of the search from each start; NaN where the limits were not kept there.
        status: `converged`, `stopped` (the iterations were used up), `limits not kept` or `interrupted`.
        warnings: what should be known.
        history: all designs that were tried: measures and parameters.
        n_evaluations: runs with derivatives.
        n_iterations: of the quadratic programming.
        seconds: compiling included [s].
        problem: the measures as functions of the parameters.
    """

    values: dict[str, Any]
    start: dict[str, Any]
    minimized: str
    unit: str
    objective: float
    objective_at_start: float
    limits: list[Limit]
    gradient: dict[str, dict[str, float]]
    optimality: float
    ends: list[float]
    status: str
    warnings: list[str]
    history: dict[str, np.ndarray]
    n_evaluations: int
    n_iterations: int
    seconds: float
    problem: DesignProblem

    @property
    def succeeded(self) -> bool:
        """Whether the search converged to a design that keeps the limits."""
        return self.status == "converged"

    @property
    def gain(self) -> float:
        """By which share the measure is less than at the start."""
        return 1 - self.objective / self.objective_at_start

    @cached_property
    def run(self) -> Trajectory:
        """The motion of the design."""
        return self.problem.run(self.values)

    @cached_property
    def run_at_start(self) -> Trajectory:
        """The motion of the start."""
        return self.problem.run(self.start)

    def figures(self) -> "dict[str, Figure]":
        """`history`: the measures of all designs that were tried, with their limits."""
        from spherejax.output.plot.design import history_figure

        limits = {limit.name: (limit.lower, limit.upper) for limit in self.limits}
        units = {self.minimized: self.unit, **{limit.name: limit.unit for limit in self.limits}}
        measures = {name: self.history[name] for name in units}
        title = f"Designs tried: {self.minimized} {100 * self.gain:.3g} % below the start"
        return {"history": history_figure(measures, limits, units, self.history["keeps limits"], title)}

    def __str__(self) -> str:
        lines = [
            f"{self.minimized}: {self.objective:.5g} {self.unit}, at the start {self.objective_at_start:.5g} "
            f"({-100 * self.gain:+.3g} %)"
        ]
        for name, value in self.values.items():
            lines.append(f"  {name} = {_shown(value)}, at the start {_shown(self.start[name])}")
        lines += [f"  {_of_limit(limit, self.unit)}" for limit in self.limits]
        lines.append(
            f"{self.status}: {self.n_iterations} iterations, {self.n_evaluations} runs with derivatives, "
            f"{self.seconds:.3g} s; {100 * self.optimality:.2g} % of the gradient is not balanced by limits"
        )
        return "\n".join(lines + [f"warning: {warning}" for warning in self.warnings])


def _shown(value) -> str:
    return f"{value:.5g}" if np.ndim(value) == 0 else np.array2string(np.asarray(value), precision=5)


def _of_limit(limit: Limit, unit: str) -> str:
    sides = [
        f"{word} {bound:.5g}"
        for word, bound in (("at least", limit.lower), ("at most", limit.upper))
        if np.isfinite(bound)
    ]
    price = f"; each {limit.unit or 'unit'} more is worth {limit.price:.3g} {unit}" if limit.active else ""
    return f"{limit.name} = {limit.value:.5g} {limit.unit} ({', '.join(sides)}{price}), at the start {limit.start:.5g}"


def design_of(task: Constrained, searches: list[Search], interrupted: bool, allowed, seconds: float) -> Design:
    """The result of searches from all starts."""
    problem = task.problem
    seen = [one for search in searches for one in search.seen]
    best = task.best(seen)
    own = next(search for search in searches if any(one is best for one in search.seen))
    # The gradient at the last sharpness is that of the true peaks, nearly.
    sharpest = problem.evaluate(best.u, max(float(s) for s in _sharpnesses(problem)))
    prices, optimality = task.multipliers(sharpest)
    keeps = task.keeps_limits(best)
    status = "interrupted" if interrupted else "limits not kept" if not keeps else "stopped"
    if status == "stopped" and own.converged:
        status = "converged"
    ends = [float(s.end.true[0]) if s.message and task.keeps_limits(s.end) else float("nan") for s in searches]
    return Design(
        values=problem.values_of(best.u),
        start=problem.values_of(problem.u0),
        minimized=problem.measures[0].name,
        unit=problem.measures[0].unit,
        objective=float(best.true[0]),
        objective_at_start=float(task.first.true[0]),
        limits=_limits(task, allowed, best, prices),
        gradient=_gradient(problem, sharpest),
        optimality=optimality,
        ends=ends,
        status=status,
        warnings=_warnings(task, searches, own, ends, keeps, optimality),
        history=_history(task, seen),
        n_evaluations=problem.n_evaluations,
        n_iterations=sum(search.n_iterations for search in searches),
        seconds=seconds,
        problem=problem,
    )


def _sharpnesses(problem: DesignProblem):
    return [sharpness for _, sharpness in problem.remembered]


def _limits(task: Constrained, allowed, best: Measures, prices) -> list[Limit]:
    found = []
    for name, (low, high) in allowed.items():
        index = [each.name for each in task.problem.measures].index(name)
        own = [at for at, row in enumerate(task.rows) if row[0] == index]
        price = sum(prices[at] * task.objective_scale / task.rows[at][3] for at in own)
        value, start = float(best.true[index]), float(task.first.true[index])
        unit = task.problem.measures[index].unit
        found.append(Limit(name, low, high, value, start, bool(price > 0), float(price), unit))
    return found


def _gradient(problem: DesignProblem, one: Measures) -> dict[str, dict[str, float]]:
    """By the parameters themselves: dp/du = p for those by their logarithms, the scale for others."""
    values = problem.unknowns.flat_values_of(one.u)
    rates = np.where(problem.unknowns.each("is_relative"), values, problem.unknowns.each("scale"))
    slopes = corrections(problem, one)[:, None] * one.slopes / rates
    names = problem.unknowns.names
    return {
        each.name: dict(zip(names, map(float, row), strict=True))
        for each, row in zip(problem.measures, slopes, strict=True)
    }


def _history(task: Constrained, seen: list[Measures]) -> dict[str, np.ndarray]:
    problem = task.problem
    values = np.array([problem.unknowns.flat_values_of(one.u) for one in seen])
    measures = np.array([one.true for one in seen])
    return {
        **{each.name: measures[:, at] for at, each in enumerate(problem.measures)},
        **{name: values[:, at] for at, name in enumerate(problem.unknowns.names)},
        "keeps limits": np.array([task.keeps_limits(one) for one in seen]),
    }


def _warnings(task: Constrained, searches, own: Search, ends, keeps: bool, optimality: float) -> list[str]:
    found = []
    if not keeps:
        found.append(
            "no design that was tried keeps all limits; this one oversteps them least. Loosen a limit or a bound, or "
            "begin elsewhere (starts=)"
        )
    elif not own.converged:
        found.append(f"the search ended early: {own.message}; raise max_iterations, or begin with this design")
    elif optimality > NEAR_OPTIMAL:
        found.append(
            f"{100 * optimality:.2g} % of the gradient is not balanced by limits: peaks at several instants compete, "
            "or the samples do not resolve them"
        )
    finite = [end for end in ends if np.isfinite(end)]
    if finite and max(finite) - min(finite) > APART * abs(min(finite)):
        found.append(
            f"the searches ended apart, at {', '.join(f'{end:.5g}' for end in ends)}: there are several optima"
        )
    failed = sum(not one.succeeded for search in searches for one in search.seen)
    if failed:
        found.append(f"the runs of {failed} designs failed and were turned back from")
    return found
