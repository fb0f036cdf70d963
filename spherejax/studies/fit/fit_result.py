"""The result of a fit."""

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.motion.integration.status import SimulationError
from spherejax.motion.results.reported import Reported
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.many import built
from spherejax.motion.runs.simulate import simulate
from spherejax.studies.fit.columns import columns_of, tables_of
from spherejax.studies.fit.correlation import ChannelResiduals, correlated_errors
from spherejax.studies.fit.dataset import to_dataset
from spherejax.studies.fit.figures import figures_of
from spherejax.studies.fit.growth import Growth, growth_of
from spherejax.studies.fit.judgement import diagnosis_of, warnings_of
from spherejax.studies.fit.losses import pseudo_errors, robust_scale
from spherejax.studies.fit.methods import Course, Ending
from spherejax.studies.fit.page import page_of
from spherejax.studies.fit.problem import Problem
from spherejax.studies.fit.report import report
from spherejax.studies.fit.statistics import Knowledge, Undetermined
from spherejax.studies.fit.validation import Validation

if TYPE_CHECKING:
    import matplotlib.figure
    import xarray

    from spherejax.output.report.page import Page


@dataclass(frozen=True, repr=False)
class Fit(Reported):
    """Estimated parameters, and how far they can be trusted; prints as a report.

    Attributes:
        problem: what was minimised.
        courses: where each start went.
        level: of the confidence intervals in the report.
        determined_within: standard deviation (relative, of positive parameters) from which on a combination of
            parameters counts as undetermined.
        seconds: how long it took [s], compilation included.
        build: from parameters to the scene.
        notes: what else is to be said about it, sentences.
        validation: prediction of the records of `validate=`, prints as a table; None without, or after a failed start.
    """

    problem: Problem
    courses: list[Course]
    level: float
    determined_within: float
    seconds: float
    build: Any
    notes: tuple[str, ...] = ()
    validation: Validation | None = None

    # The estimates ------------------------------------------------------------------------------------------------

    @property
    def names(self) -> list[str]:
        """Of all numbers that were fitted, arrays flattened as `name[0]`, ..."""
        return self.problem.names

    @cached_property
    def best(self) -> Course:
        """The start that reached the smallest cost."""
        return min(self.courses, key=lambda course: course.cost)

    @property
    def estimates(self) -> dict[str, Any]:
        """Parameters by name, numbers or arrays."""
        return {name: _plain(value) for name, value in self.problem.values_of(self.u).items()}

    @property
    def u(self) -> np.ndarray:
        """The estimates as the method's unknowns."""
        return self.best.u if self.best.us else self.problem.u0

    @property
    def standard_deviations(self) -> dict[str, Any]:
        """Of the estimates, by name."""
        return self._by_name(self.knowledge.standard_deviations)

    @property
    def best_possible(self) -> dict[str, Any]:
        """The smallest standard deviations that an unbiased estimate can have (Cramer-Rao), for the stated noise.

        Where the noise was not stated, for that which was estimated. Errors are taken for independent.
        """
        independent = replace(self.knowledge, variance=self._stated_variance, correlated=None)
        return self._by_name(independent.standard_deviations)

    def interval(self, level: float = 0.95) -> dict[str, Any]:
        """Confidence intervals by name: (low, high) of numbers, arrays (..., 2) of arrays.

        Those of positive parameters are symmetric in the logarithm.
        """
        low, high = self.knowledge.intervals(level).T
        lows, highs = self._by_name(low), self._by_name(high)
        return {
            name: (lows[name], highs[name]) if np.ndim(lows[name]) == 0 else np.stack([lows[name], highs[name]], -1)
            for name in lows
        }

    @property
    def covariance(self) -> np.ndarray:
        """Of the estimates in the order of `names`, in their units."""
        return self.knowledge.covariance

    @property
    def correlation(self) -> np.ndarray:
        """Of the estimates in the order of `names`."""
        return self.knowledge.correlation

    @property
    def singular_values(self) -> np.ndarray:
        """Of the noise-weighted Jacobian by the parameters in units of their scales, falling."""
        return self.knowledge.singular_values / np.sqrt(self.knowledge.variance)

    @cached_property
    def undetermined(self) -> list[Undetermined]:
        """Directions that the data do not determine, the worst first."""
        return self.knowledge.undetermined(self.determined_within)

    @cached_property
    def knowledge(self) -> Knowledge:
        """What the data say about the parameters near the estimates.

        Raises:
            SimulationError: for a fit whose start failed.
        """
        if not self.best.us:
            raise SimulationError(f"nothing was estimated: {self.diagnosis}")
        jacobian = self.problem.raw_jacobian(self.best.residuals, self.best.jacobian)
        pseudo = pseudo_errors(self.problem.loss, self._errors, self.problem.unknowns.size)
        freedom, variance = float(max(self.degrees_of_freedom, 1)), self._stated_variance
        is_stated = self.problem.noise_is_known and self.problem.loss is None
        if self.problem.loss is not None:
            variance = float(pseudo.errors @ pseudo.errors) / freedom * pseudo.factor
        correlated = correlated_errors(
            pseudo.errors * np.sqrt(pseudo.factor), jacobian, self._channels, variance, is_known=is_stated
        )
        if correlated is not None:
            freedom = correlated.degrees_of_freedom
        elif is_stated:
            freedom = np.inf
        return Knowledge(self.problem.unknowns, self.u, jacobian, variance, freedom, correlated)

    @property
    def _channels(self) -> list[ChannelResiduals]:
        """Which residuals are consecutive values of one component."""
        several = len(self.problem.experiments) > 1
        channels, first = [], 0
        for i, experiment in enumerate(self.problem.experiments):
            is_measured = experiment.is_measured
            numbers = np.zeros(is_measured.shape, int)
            numbers[is_measured] = first + np.arange(int(is_measured.sum()))
            first += int(is_measured.sum())
            for column, name in enumerate(columns_of(experiment)):
                there = is_measured[:, column]
                whole = f"{name} of {experiment.measured.name}" if several else name
                channels.append(ChannelResiduals(whole, numbers[there, column], (i, there.tobytes())))
        return channels

    @property
    def _stated_variance(self) -> float:
        return 1.0 if self.problem.noise_is_known else self.reduced_chi_square

    @cached_property
    def _errors(self) -> np.ndarray:
        """Prediction minus measurement over the noise of the problem."""
        return self.problem.raw(self.best.residuals)

    # How it went ----------------------------------------------------------------------------------------------------

    @property
    def cost(self) -> float:
        """Half the sum of squares of the weighted residuals, or the sum of their robust losses."""
        return self.best.cost

    @property
    def degrees_of_freedom(self) -> int:
        """Measured values minus fitted numbers."""
        return self.problem.n_residuals - self.problem.unknowns.size

    @property
    def reduced_chi_square(self) -> float:
        """Sum of squares of the weighted residuals over the degrees of freedom: about 1 where all is as stated.

        With a robust loss the square of the standard deviation that normal errors with their median magnitude have.
        """
        freedom = max(self.degrees_of_freedom, 1)
        if self.problem.loss is not None and self.best.us:
            return robust_scale(self._errors, freedom / max(self.problem.n_residuals, 1)) ** 2
        return 2 * self.cost / freedom

    @property
    def succeeded(self) -> bool:
        """Whether a minimum was found."""
        return self.best.ending is not None and self.best.ending.succeeded

    @property
    def status(self) -> str:
        """How it ended."""
        assert self.best.ending is not None
        return self.best.ending.value

    @property
    def diagnosis(self) -> str:
        """Why it did not succeed, and what to do; empty after success."""
        return diagnosis_of(self.best, self.problem)

    @cached_property
    def warnings(self) -> list[str]:
        """What to think about before the estimates are used."""
        return warnings_of(self)

    @property
    def n_iterations(self) -> int:
        """Steps tried by the best start."""
        return self.best.n_iterations

    @property
    def starts(self) -> list[dict[str, Any]]:
        """Of each start: where it began and ended (dicts), its cost, status and number of iterations."""
        return [
            {
                "start": self._flat_by_name(course.us[0]) if course.us else None,
                "end": self._flat_by_name(course.u) if course.us else None,
                "cost": course.cost,
                "status": Ending.FAILED_START.value if course.ending is None else course.ending.value,
                "n_iterations": course.n_iterations,
            }
            for course in self.courses
        ]

    @cached_property
    def history(self) -> "xarray.Dataset":
        """Cost and parameters of the accepted steps of the best start.

        `until` is the end of the record that a cost is of [s]; infinite for the whole.
        """
        import xarray

        steps = ("step",)
        values = [self.problem.unknowns.flat_values_of(u) for u in self.best.us]
        table = np.reshape(values, (-1, len(self.names)))
        return xarray.Dataset(
            {
                "cost": (steps, np.array(self.best.costs)),
                "until": (steps, np.array(self.best.ends), {"units": "s"}),
                "value": ((*steps, "parameter"), table),
            },
            {"parameter": self.names},
        )

    @cached_property
    def growth(self) -> Growth:
        """How the sensitivities grow along the record, and how far the gradient means anything.

        Raises:
            SceneError: for a fit whose run at the start failed: there are no sensitivities.
        """
        if not self.best.us:
            raise SceneError(f"there are no sensitivities: {self.diagnosis}")
        return growth_of(self.problem, self.knowledge, self.best)

    # Residuals and runs ---------------------------------------------------------------------------------------------

    @cached_property
    def tables(self) -> list[np.ndarray]:
        """Prediction minus measurement over the noise of the problem, (n, m) by experiment; NaN: not measured."""
        return tables_of(self.problem.experiments, self._errors)

    @cached_property
    def noise(self) -> list[np.ndarray]:
        """Standard deviations of the errors as stated or estimated, (n, m) by experiment, in the observables' units."""
        return [noise * np.sqrt(self._stated_variance) for noise in self.problem.noise]

    @cached_property
    def residuals(self) -> dict[str, dict[str, np.ndarray]]:
        """Prediction minus measurement over the noise, by experiment and component; NaN where nothing was measured."""
        size = np.sqrt(self._stated_variance)
        return {
            str(experiment.measured.name): dict(zip(columns_of(experiment), table.T / size, strict=True))
            for experiment, table in zip(self.problem.experiments, self.tables, strict=True)
        }

    @cached_property
    def runs(self) -> dict[str, Trajectory]:
        """A run of each experiment at the estimates, sampled when it was measured; made on first use."""
        found = {}
        for experiment in self.problem.experiments:
            measured = experiment.measured
            scene = built(experiment.build, self.estimates)
            first = [] if measured.ts[0] == measured.t0 else [measured.t0]
            found[str(measured.name)] = simulate(scene, jnp.asarray(np.concatenate([first, measured.ts])))
        return found

    # Out --------------------------------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        if not self.best.us:
            return f"Fit({self.status})"
        pairs = zip(self.names, self.knowledge.values, self.knowledge.standard_deviations, strict=True)
        estimates = ", ".join(f"{name} = {value:.6g} +- {deviation:.2g}" for name, value, deviation in pairs)
        return f"Fit({estimates}; {self.status})"

    def __str__(self) -> str:
        return report(self)

    def figures(self, title: str = "") -> "dict[str, matplotlib.figure.Figure]":
        """Pictures by name: `"fit"`, `"residuals"`, `"correlation"`, `"history"`, `"validation"` (with `validate=`)."""
        return figures_of(self, title)

    def report_page(self, title: str, scene: Scene | None) -> "Page":
        """The page that `report` writes."""
        return page_of(self, title, scene)

    def to_xarray(self) -> "xarray.Dataset":
        """Estimates, statistics, measurements, predictions and history, labelled."""
        return to_dataset(self)

    def save(self, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
        """Write `to_xarray()` to a netCDF file (.nc)."""
        from spherejax.output.io import save

        return save(self.to_xarray(), path, overwrite=overwrite)

    def _by_name(self, flat: np.ndarray) -> dict[str, Any]:
        found, at = {}, 0
        for part in self.problem.unknowns.parts:
            found[part.name] = _plain(np.reshape(flat[at : at + part.size], part.shape))
            at += part.size
        return found

    def _flat_by_name(self, u: np.ndarray) -> dict[str, float]:
        return dict(zip(self.names, self.problem.unknowns.flat_values_of(u).tolist(), strict=True))


def _plain(value: Any) -> Any:
    array = np.asarray(value)
    return array.item() if array.ndim == 0 else array
