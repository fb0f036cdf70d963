"""What all mechanisms share: predictions of a model, Nelder and Mead's method for comparison, rows of tables."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import minimize

import spherejax as sj

Functions = Mapping[str, Callable]
"""From a run to an observable at its samples, by name."""

GRAY, BLUE, ORANGE = "#8a8a8a", "#0a7d91", "#c8791a"


Rows = list[dict[str, object]]
Part = tuple[str, Rows | Figure]
"""What a mechanism's case hands on as soon as it is ready: a table by its name, or `"figure"` and the figure."""


def predicted(scene: sj.Scene, ts: np.ndarray, functions: Functions, rtol: float = 1e-8) -> np.ndarray:
    """Observables at instants; the motion starts at the first. Shape (n, m)."""
    run = sj.simulate(scene, jnp.asarray(ts), rtol=rtol, throw=True)
    return np.stack([np.asarray(function(run)) for function in functions.values()], 1)


class Search(NamedTuple):
    """How a method went.

    Attributes:
        numbers: the parameters where it ended.
        cost: sum of squares there, in the units of the measurements.
        runs: simulations; those of a fit come with all derivatives.
        seconds: of processor time, with what had to be compiled.
    """

    numbers: dict[str, float]
    cost: float
    runs: int
    seconds: float


def nelder_mead(
    build: Callable[..., sj.Scene],
    start: Mapping[str, float],
    ts: np.ndarray,
    values: np.ndarray,
    functions: Functions,
    rtol: float = 1e-8,
) -> Search:
    """SciPy's Nelder-Mead on the logarithms of positive parameters, with SciPy's tolerances."""
    began, names, runs = time.process_time(), list(start), 0

    @jax.jit
    def sum_of_squares(logarithms):
        scene = build(**dict(zip(names, jnp.exp(logarithms), strict=True)))
        run = sj.simulate(scene, jnp.asarray(ts), rtol=rtol)
        return jnp.sum((jnp.stack([function(run) for function in functions.values()], 1) - values) ** 2)

    def cost(logarithms):
        nonlocal runs
        runs += 1
        return float(sum_of_squares(jnp.asarray(logarithms)))

    ended: Any = minimize(cost, np.log(list(start.values())), method="Nelder-Mead")
    numbers = dict(zip(names, map(float, np.exp(ended.x)), strict=True))
    return Search(numbers, float(ended.fun), runs, time.process_time() - began)


def fitted(build: Callable[..., sj.Scene], start: Mapping[str, Any], measured: Any, **options) -> tuple[sj.Fit, Search]:
    """`sj.fit` on the whole record, and how it went."""
    began = time.process_time()
    fit = sj.fit(build, start, measured, horizon=sj.Whole(), progress=False, **options)
    squares = [np.nansum((table * noise) ** 2) for table, noise in zip(fit.tables, fit.problem.noise, strict=True)]
    runs = sum(course.n_iterations for course in fit.courses) * len(fit.problem.experiments)
    numbers = {name: float(value) for name, value in fit.estimates.items()}
    return fit, Search(numbers, float(sum(squares)), runs, time.process_time() - began)


def number_rows(model: str, fit: sj.Fit, units: Mapping[str, str], published: Mapping[str, float]) -> Rows:
    """A row for each parameter: published and own value, and the 95 % interval of the fit."""
    intervals = fit.interval(0.95)
    return [
        {
            "model": model,
            "parameter": name,
            "unit": units.get(name, ""),
            "published": f"{published[name]:.6g}" if name in published else "",
            "own": f"{value:.5g}",
            "low_95": f"{intervals[name][0]:.5g}",
            "high_95": f"{intervals[name][1]:.5g}",
        }
        for name, value in fit.estimates.items()
    ]


def effort_row(method: str, search: Search) -> dict[str, object]:
    """A row for a method."""
    return {
        "method": method,
        "parameters": len(search.numbers),
        "sum_of_squares": f"{search.cost:.6g}",
        "runs": search.runs,
        "processor_seconds": f"{search.seconds:.1f}",
    }


def root_mean_squares(errors: np.ndarray) -> Sequence[str]:
    """Of each column, as text."""
    return [f"{value:.3g}" for value in np.sqrt(np.mean(np.square(errors), 0))]
