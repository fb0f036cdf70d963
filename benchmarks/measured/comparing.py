"""What all mechanisms share: predictions of a model, Nelder and Mead's method for comparison, rows of tables."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import least_squares, minimize

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


class CountedErrors:
    """Errors of a model as a function of the logarithms of its positive parameters, without derivatives.

    Attributes:
        runs: how often it was asked.
    """

    def __init__(self, build: Callable[..., sj.Scene], names: Sequence[str], ts, values, functions: Functions, rtol):
        self.names, self.runs = list(names), 0

        @jax.jit
        def errors(logarithms):
            scene = build(**dict(zip(self.names, jnp.exp(logarithms), strict=True)))
            run = sj.simulate(scene, jnp.asarray(ts), rtol=rtol)
            return (jnp.stack([function(run) for function in functions.values()], 1) - values).ravel()

        self._errors = errors

    def __call__(self, logarithms) -> np.ndarray:
        """Of all samples."""
        self.runs += 1
        return np.asarray(self._errors(jnp.asarray(logarithms)))

    def search(self, logarithms, began: float) -> Search:
        """How a method went that ended here."""
        cost, runs = float(np.sum(self(logarithms) ** 2)), self.runs - 1
        numbers = dict(zip(self.names, map(float, np.exp(logarithms)), strict=True))
        return Search(numbers, cost, runs, time.process_time() - began)


def nelder_mead(
    build: Callable[..., sj.Scene],
    start: Mapping[str, float],
    ts: np.ndarray,
    values: np.ndarray,
    functions: Functions,
    rtol: float = 1e-8,
) -> Search:
    """SciPy's Nelder-Mead on the logarithms of positive parameters, with SciPy's tolerances."""
    began = time.process_time()
    errors = CountedErrors(build, [*start], ts, values, functions, rtol)
    ended: Any = minimize(lambda u: float(np.sum(errors(u) ** 2)), np.log(list(start.values())), method="Nelder-Mead")
    return errors.search(ended.x, began)


def least_squares_by_differences(
    build: Callable[..., sj.Scene],
    start: Mapping[str, float],
    ts: np.ndarray,
    values: np.ndarray,
    functions: Functions,
    rtol: float = 1e-8,
    diff_step: float | None = None,
) -> Search:
    """SciPy's `least_squares` with derivatives by differences, as `nelder_mead`; `diff_step` is SciPy's."""
    began = time.process_time()
    errors = CountedErrors(build, [*start], ts, values, functions, rtol)
    ended = least_squares(errors, np.log(list(start.values())), diff_step=diff_step)
    return errors.search(ended.x, began)


def fitted(build: Any, start: Mapping[str, Any], measured: Any, **options) -> tuple[sj.studies.Fit, Search]:
    """`sj.fit`, on the whole record unless a `horizon` says otherwise, and how it went."""
    began = time.process_time()
    fit = sj.fit(build, start, measured, progress=False, **{"horizon": sj.studies.Whole(), **options})
    squares = [np.nansum((table * noise) ** 2) for table, noise in zip(fit.tables, fit.problem.noise, strict=True)]
    runs = sum(course.n_iterations for course in fit.courses) * len(fit.problem.experiments)
    numbers = {name: float(value) for name, value in fit.estimates.items() if np.ndim(value) == 0}
    return fit, Search(numbers, float(sum(squares)), runs, time.process_time() - began)


def number_rows(model: str, fit: sj.studies.Fit, units: Mapping[str, str], published: Mapping[str, float]) -> Rows:
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
