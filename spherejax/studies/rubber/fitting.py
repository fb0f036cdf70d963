"""`sj.studies.fit_stiffness`: identification of a bushing from its measured dynamic stiffness.

The residuals are those of log(K/K_measured): of ln |K|, and of the loss angle in radians, each as a share of its noise.
The method is that of `sj.fit`, Levenberg-Marquardt, and so is what the estimates are said to be worth.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.physics.joints.bushing import Bushing
from spherejax.physics.joints.harmonic import complex_stiffness
from spherejax.physics.laws.elastomer import AbstractElastomer
from spherejax.studies.fit.levenberg_marquardt import LevenbergMarquardt
from spherejax.studies.fit.methods import Course, Ending
from spherejax.studies.fit.parameters import FitUnknowns, unknowns_from
from spherejax.studies.fit.problem import Evaluation
from spherejax.studies.fit.statistics import Knowledge, Undetermined
from spherejax.studies.random_numbers import Rng, generator, rng_was_seed
from spherejax.studies.rubber.measured import MeasuredStiffness, measured_stiffness
from spherejax.studies.rubber.stiffness import DynamicStiffness, checked, dynamic_stiffness, unit_vector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPREAD = np.log(10.0)
"""Further starts lie within a factor of ten of the first."""


@rng_was_seed
def fit_stiffness(
    build: Callable[..., Bushing | AbstractElastomer],
    start: Mapping[str, Any],
    measured: Any,
    *,
    direction: Any = (1.0, 0.0, 0.0),
    rotation: bool = False,
    mean: float = 0.0,
    noise: float | Mapping[str, float] | None = None,
    method: LevenbergMarquardt | None = None,
    starts: int = 1,
    determined_within: float = 0.1,
    rng: Rng = 0,
) -> "StiffnessFit":
    """Estimate numbers of a bushing from its measured dynamic stiffness and loss angle.

    Args:
        build: makes the bushing, or its elastomer, from the parameters, given by keyword. It is traced.
        start: where to begin, by parameter: numbers, arrays, or `sj.Parameter` with bounds; as in `sj.fit`. Branches
            begin best with relaxation times spread over the measured frequencies: 1/(2 pi f).
        measured: `frequency` [Hz], `amplitude` [m], `stiffness` [N/m] and `loss_angle` [rad], of rotation [rad] and
            [N m/rad], one entry for each measurement: a dict of numbers and arrays, an `xarray.Dataset`, a
            `DynamicStiffness`, the path of a netCDF file, or of a CSV file whose heads name them, with units like
            `stiffness [N/mm]` if they are others. One of stiffness and loss angle may be missing; NaN is left out.

    Other args:
        direction, rotation, mean: how it was moved, as in `dynamic_stiffness`.
        noise: standard deviation of the errors of measurement: of the stiffness as a share of it, and of the loss angle
            [rad]: a number for both, or `{"stiffness": 0.02, "loss_angle": 0.01}`. With None one number for both is
            estimated from the residuals.
        method: `sj.studies.LevenbergMarquardt()`, with numbers of your own.
        starts: how many starts; the first is `start`, the others lie around it, up to a factor of ten away.
        determined_within: a combination of parameters that the data leave with a larger relative standard deviation
            is named as undetermined.
        rng: of the further starts, a whole number or a generator.

    Returns:
        The estimates, and how far they can be trusted; prints as a report.

    Raises:
        SceneError: for a request that makes no sense, before anything is computed.
    """
    unknowns, values = unknowns_from(start)
    data = measured_stiffness(measured, rotation=rotation)
    along = unit_vector(direction)
    checked(build(**{name: np.asarray(value) for name, value in values.items()}), rotation)
    weights, is_known = _weights(noise)
    moved = _Moved(along, rotation, mean)
    problem = _Problem(build, unknowns, data, moved, weights)
    n = int(problem.is_measured.sum())
    if n < unknowns.size:
        raise SceneError(f"{n} measured values cannot determine {unknowns.size} parameters")
    if starts < 1:
        raise SceneError(f"starts = {starts} must be at least 1")
    u0 = unknowns.unknowns_of(values)
    away = generator(rng).uniform(-SPREAD, SPREAD, (starts - 1, u0.size))
    us = u0 + np.concatenate([np.zeros((1, u0.size)), away])
    method = LevenbergMarquardt() if method is None else method
    courses = method.minimize(problem, us, noise_is_known=is_known)
    return StiffnessFit(problem, courses, is_known, determined_within)


@dataclass(frozen=True)
class _Moved:
    """How the bushing was moved."""

    direction: jax.Array
    rotation: bool
    mean: float


def _weights(noise: Any) -> tuple[tuple[float, float], bool]:
    """Standard deviations of ln |K| and of the loss angle, and whether they were stated."""
    if noise is None:
        return (1.0, 1.0), False
    given = noise if isinstance(noise, Mapping) else {"stiffness": noise, "loss_angle": noise}
    if set(given) != {"stiffness", "loss_angle"}:
        raise SceneError(f'noise = {noise!r} must be a number, or {{"stiffness": 0.02, "loss_angle": 0.01}}')
    try:
        found = float(given["stiffness"]), float(given["loss_angle"])
    except (TypeError, ValueError) as error:
        raise SceneError(f"noise = {noise!r} must be numbers above zero") from error
    if not all(0 < one < np.inf for one in found):
        raise SceneError(f"noise = {noise!r} must be above zero and finite: it is a standard deviation")
    return found, True


class _Problem:
    """Residuals as functions of unknowns; what `LevenbergMarquardt` minimises."""

    def __init__(self, build, unknowns: FitUnknowns, data: MeasuredStiffness, moved: _Moved, weights):
        self.build, self.unknowns, self.data, self.moved, self.weights = build, unknowns, data, moved, weights
        self.is_measured = np.concatenate([~np.isnan(data.stiffness), ~np.isnan(data.loss_angle)])
        self._compute = jax.jit(lambda u: (self._residuals(u), jax.jacfwd(self._residuals)(u)))

    def predicted(self, u) -> jax.Array:
        """K of each measurement."""
        model = self.build(**self.unknowns.values_of(u))
        model = Bushing(law=model) if isinstance(model, AbstractElastomer) else model

        def one(frequency, amplitude):
            moved = self.moved
            return complex_stiffness(model, frequency, amplitude, moved.direction, moved.mean, rotation=moved.rotation)

        return jax.vmap(one)(jnp.asarray(self.data.frequency), jnp.asarray(self.data.amplitude))

    def _residuals(self, u) -> jax.Array:
        logarithm = jnp.log(self.predicted(u))
        parts = [
            (jnp.real(logarithm) - np.log(self.data.stiffness)) / self.weights[0],
            (jnp.imag(logarithm) - self.data.loss_angle) / self.weights[1],
        ]
        return jnp.concatenate(parts)[np.nonzero(self.is_measured)[0]]

    def evaluate(self, us: np.ndarray) -> Evaluation:
        """Residuals and Jacobians of some sets of unknowns."""
        found = [self._compute(jnp.asarray(u)) for u in us]
        residuals, jacobians = (np.stack([np.asarray(one[i]) for one in found]) for i in (0, 1))
        failed = ~(np.all(np.isfinite(residuals), 1) & np.all(np.isfinite(jacobians), (1, 2)))
        told = ["its dynamic stiffness is not finite" if one else "" for one in failed]
        return Evaluation(residuals, jacobians, failed, told, np.zeros(len(us), int))


@dataclass(frozen=True, repr=False)
class StiffnessFit:
    """A bushing estimated from its dynamic stiffness; prints as a report.

    Attributes:
        problem: what was minimised.
        courses: where each start went.
        noise_is_known: whether the noise was stated.
        determined_within: relative standard deviation from which on a combination of parameters counts as undetermined.
    """

    problem: _Problem
    courses: list[Course]
    noise_is_known: bool
    determined_within: float

    @property
    def names(self) -> list[str]:
        """Of all numbers that were fitted, arrays flattened as `name[0]`, ..."""
        return self.problem.unknowns.names

    @cached_property
    def best(self) -> Course:
        """The start that reached the smallest cost."""
        return min(self.courses, key=lambda course: course.cost)

    @property
    def estimates(self) -> dict[str, Any]:
        """Parameters by name, numbers or arrays."""
        values = self.problem.unknowns.values_of(jnp.asarray(self._u))
        return {
            name: np.asarray(value).item() if value.ndim == 0 else np.asarray(value) for name, value in values.items()
        }

    @property
    def model(self) -> Bushing | AbstractElastomer:
        """The bushing, or the elastomer, at the estimates."""
        return self.problem.build(**self.estimates)

    @property
    def _u(self) -> np.ndarray:
        if not self.best.us:
            raise SceneError(f"nothing was estimated: {self.status}: {self.best.diagnosis}")
        return self.best.u

    @cached_property
    def knowledge(self) -> Knowledge:
        """What the data say about the parameters near the estimates."""
        freedom = np.inf if self.noise_is_known else self._freedom
        variance = 1.0 if self.noise_is_known else 2 * self.best.cost / self._freedom
        return Knowledge(self.problem.unknowns, self._u, self.best.jacobian, variance, freedom)

    @property
    def _freedom(self) -> int:
        return max(self.best.residuals.size - self.problem.unknowns.size, 1)

    @property
    def standard_deviations(self) -> dict[str, float]:
        """Of the estimates, by name."""
        return dict(zip(self.names, self.knowledge.standard_deviations.tolist(), strict=True))

    def interval(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Confidence intervals by name; those of positive parameters are symmetric in the logarithm."""
        bounds = self.knowledge.intervals(level)
        return {name: (float(low), float(high)) for name, (low, high) in zip(self.names, bounds, strict=True)}

    @property
    def noise(self) -> tuple[float, float]:
        """Standard deviations of |K| as a share of it, and of the loss angle [rad]: stated, or estimated."""
        size = 1.0 if self.noise_is_known else np.sqrt(self.knowledge.variance)
        return self.problem.weights[0] * size, self.problem.weights[1] * size

    @property
    def undetermined(self) -> list[Undetermined]:
        """Directions that the data do not determine, the worst first."""
        return self.knowledge.undetermined(self.determined_within)

    @property
    def succeeded(self) -> bool:
        """Whether a minimum was found."""
        return self.best.ending is not None and self.best.ending.succeeded

    @property
    def status(self) -> str:
        """How it ended."""
        return (self.best.ending or Ending.FAILED_START).value

    def predicted(self, frequencies: Any, amplitudes: Any) -> DynamicStiffness:
        """Dynamic stiffness at the estimates, moved as it was measured."""
        moved = self.problem.moved
        return dynamic_stiffness(
            self.model, frequencies, amplitudes, direction=moved.direction, rotation=moved.rotation, mean=moved.mean
        )

    def figure(self, title: str = "") -> "Figure":
        """Measurements as dots and the fit as curves over frequency, a colour for each amplitude."""
        from spherejax.output.plot.stiffness import fitted_stiffness

        data = self.problem.data
        low, high = np.min(data.frequency), np.max(data.frequency)
        curves = self.predicted(np.geomspace(low / 1.1, 1.1 * high, 121), np.unique(data.amplitude)).to_xarray()
        return fitted_stiffness(curves, np.stack(data, 1), title or f"Fit of {', '.join(self.names)}")

    def __repr__(self) -> str:
        if not self.best.us:
            return f"StiffnessFit({self.status})"
        pairs = zip(self.names, self.knowledge.values, self.knowledge.standard_deviations, strict=True)
        return f"StiffnessFit({', '.join(f'{n} = {v:.6g} +- {s:.2g}' for n, v, s in pairs)}; {self.status})"

    def __str__(self) -> str:
        n = self.best.residuals.size
        lines = [f"Fit of {', '.join(self.names)} to {n} values: {self.status} ({self.best.n_iterations} iterations)"]
        if not self.best.us:
            return f"{lines[0]}: {self.best.diagnosis}"
        of_stiffness, of_angle = self.noise
        what = "stated" if self.noise_is_known else "estimated"
        lines.append(f"{what} noise: {100 * of_stiffness:.2g} % of the stiffness, {np.degrees(of_angle):.2g} deg")
        for name, value, (low, high) in zip(
            self.names, self.knowledge.values, self.knowledge.intervals(0.95), strict=True
        ):
            lines.append(f"  {name} = {value:.6g}, 95 % interval {low:.6g} to {high:.6g}")
        lines += [f"not determined: {each.explanation}" for each in self.undetermined]
        return "\n".join(lines)
