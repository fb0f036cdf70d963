"""The problem under a fit: noise-weighted residuals of all experiments as functions of unknowns without bounds.

r_i(u) = (prediction_i(p(u)) - measured_i) / noise_i,    cost = sum r_i^2 / 2,    log likelihood = -cost + const.

With a robust loss L the residuals that a method sees are s_i = sign(r_i) sqrt(2 L(r_i)); see `losses`.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible
from spherejax.foundations.types import Scalar
from spherejax.motion.integration.status import Status
from spherejax.motion.runs.many import Build
from spherejax.motion.settings import RunSettings
from spherejax.runtime import require_float64
from spherejax.studies.fit.arguments import refuse_unused, with_own_parameters
from spherejax.studies.fit.experiment import CostAndGradient, Experiment, Prediction, experiment_of
from spherejax.studies.fit.losses import Loss, check_loss, rooted
from spherejax.studies.fit.measured import Measured
from spherejax.studies.fit.parameters import FitUnknowns, unknowns_from
from spherejax.studies.fit.side_by_side import in_threads, on_accelerator, padded

MAX_STEPS = 1_000_000
"""Steps after which a run of a fit is given up: an iterate may be far stiffer than the solution."""


NO_LIKELIHOOD = (
    "the likelihood is that of normal errors, and the fit has loss={loss}; leave the loss out, and outliers too (NaN)"
)


class Evaluation(NamedTuple):
    """Residuals and their derivatives at some sets of unknowns, the lanes.

    Attributes:
        residuals: weighted by the noise; NaN in lanes that failed.
        jacobians: their derivatives by the unknowns; NaN in lanes that failed.
        failed: runs that did not reach their end.
        diagnoses: of each lane why, or nothing.
        n_steps: steps of the runs.
    """

    residuals: Float[np.ndarray, "lanes n"]
    jacobians: Float[np.ndarray, "lanes n k"]
    failed: Bool[np.ndarray, " lanes"]
    diagnoses: list[str]
    n_steps: Int[np.ndarray, " lanes"]


class Problem:
    """Residuals of experiments as functions of unknowns u.

    Attributes:
        unknowns: what is fitted, and how u stands for it.
        start: where the fit begins, by name.
        experiments: what was done.
        noise: standard deviations of the errors, one array (n, m) for each experiment; all of them ones where the
            noise is not known.
        noise_is_known: whether the noise was stated.
        loss: how much large residuals count; None: least squares.
    """

    def __init__(
        self,
        unknowns: FitUnknowns,
        start: dict[str, np.ndarray],
        experiments: Sequence[Experiment],
        noise: Sequence[np.ndarray],
        noise_is_known: bool,
        loss: Loss | None = None,
    ):
        self.unknowns, self.start = unknowns, start
        self.experiments, self.noise = tuple(experiments), tuple(noise)
        self.noise_is_known, self.loss = noise_is_known, loss
        self._remembered: dict[bytes, _Lane] = {}

    @property
    def u0(self) -> np.ndarray:
        """Where the fit begins."""
        return self.unknowns.unknowns_of(self.start)

    @property
    def names(self) -> list[str]:
        """Of all numbers that are fitted."""
        return self.unknowns.names

    @cached_property
    def n_residuals(self) -> int:
        """Count of measured values."""
        return sum(int(np.sum(experiment.is_measured)) for experiment in self.experiments)

    def values_of(self, u: Float[Any, " k"]) -> dict[str, Array]:
        """Parameters by name."""
        return self.unknowns.values_of(jnp.asarray(u))

    # As functions that transform --------------------------------------------------------------------------------

    def residuals(self, u: Float[Array, " k"]) -> Float[Array, " n"]:
        """Weighted residuals; NaN where a run fails. Works under `jit`, forward and reverse differentiation."""
        return self._residuals(u)

    def jacobian(self, u: Float[Array, " k"]) -> Float[Array, "n k"]:
        """Derivatives of the residuals by the unknowns: forward sensitivities."""
        return self.residuals_and_jacobian(u)[1]

    def residuals_and_jacobian(self, u: Float[Array, " k"]) -> tuple[Float[Array, " n"], Float[Array, "n k"]]:
        """Both, from one integration for each experiment."""
        found = [self._weighted(i, experiment.predict(u)) for i, experiment in enumerate(self.experiments)]
        return jnp.concatenate([r for r, _ in found]), jnp.concatenate([j for _, j in found])

    def log_likelihood(self, u: Float[Array, " k"]) -> Scalar:
        """Logarithm of the probability density of the measurements, for independent normal errors.

        Minus infinity where a run fails.

        Raises:
            SceneError: where the noise was not stated.
        """
        if not self.noise_is_known:
            raise SceneError("the likelihood needs the noise of the measurements: give noise=")
        if self.loss is not None:
            raise SceneError(NO_LIKELIHOOD.format(loss=self.loss))
        residuals = self.residuals(u)
        fits = jnp.all(jnp.isfinite(residuals))
        spread = sum(
            float(np.sum(np.log(noise[experiment.is_measured])))
            for noise, experiment in zip(self.noise, self.experiments, strict=True)
        )
        constant = -spread - self.n_residuals * np.log(2 * np.pi) / 2
        return jnp.where(fits, constant - jnp.sum(jnp.where(fits, residuals, 0.0) ** 2) / 2, -jnp.inf)

    @cached_property
    def _residuals(self):
        @jax.custom_jvp
        def residuals(u):
            found = [self._weighted(i, each.predict_alone(u))[0] for i, each in enumerate(self.experiments)]
            return jnp.concatenate(found)

        @residuals.defjvp
        def residuals_jvp(primals, tangents):
            values, jacobian = self.residuals_and_jacobian(*primals)
            return values, jnp.where(jnp.isfinite(jacobian), jacobian, 0.0) @ tangents[0]

        return residuals

    def _weighted(self, i: int, prediction) -> tuple[Array, Array]:
        """Residuals of an experiment where something was measured, with a leading axis of lanes if there is one."""
        experiment, noise = self.experiments[i], self.noise[i]
        where = np.nonzero(experiment.is_measured)
        weights = 1 / noise[where]
        residuals = (prediction.values[..., where[0], where[1]] - experiment.data[where]) * weights
        jacobian = prediction.slopes[..., where[0], where[1], :] * weights[:, None]
        failed = (prediction.status != Status.SUCCEEDED)[..., None]
        if self.loss is not None:
            residuals, slopes = rooted(self.loss, residuals)
            jacobian = slopes[..., None] * jacobian
        residuals = jnp.where(failed, jnp.nan, residuals)
        return residuals, jnp.where(failed[..., None], jnp.nan, jacobian)

    # On the host -------------------------------------------------------------------------------------------------

    def evaluate(self, us: Float[np.ndarray, "lanes k"]) -> Evaluation:
        """Residuals and Jacobians of many sets of unknowns, computed now; those of the last call are remembered."""
        us = np.asarray(us, np.float64)
        new = {u.tobytes(): u for u in us if u.tobytes() not in self._remembered}
        known = {**self._remembered, **dict(zip(new, self._evaluated(list(new.values())), strict=True))}
        lanes = [known[u.tobytes()] for u in us]
        self._remembered = {u.tobytes(): lane for u, lane in zip(us, lanes, strict=True)}
        return Evaluation(
            np.stack([lane.residuals for lane in lanes]),
            np.stack([lane.jacobian for lane in lanes]),
            np.array([lane.failed for lane in lanes]),
            [lane.diagnosis for lane in lanes],
            np.array([lane.n_steps for lane in lanes]),
        )

    def _evaluated(self, us: list[np.ndarray]) -> list["_Lane"]:
        if len(us) > 1 and on_accelerator():
            predictions = [experiment.predict_lanes(jnp.asarray(padded(us))) for experiment in self.experiments]
            return [self._lane(u, jax.tree.map(lambda x, i=i: x[i], predictions)) for i, u in enumerate(us)]
        return in_threads(lambda u: self._lane(u, [one.predict(jnp.asarray(u)) for one in self.experiments]), us)

    def _lane(self, u: np.ndarray, predictions: list[Prediction]) -> "_Lane":
        """What the predictions of all experiments come to."""
        weighted = [self._weighted(i, prediction) for i, prediction in enumerate(predictions)]
        residuals = np.concatenate([np.asarray(r) for r, _ in weighted])
        jacobian = np.concatenate([np.asarray(j) for _, j in weighted])
        is_finite = bool(np.all(np.isfinite(residuals)) and np.all(np.isfinite(jacobian)))
        diagnoses = [
            experiment.diagnosis(prediction.status, prediction.t_reached, u)
            for experiment, prediction in zip(self.experiments, predictions, strict=True)
        ]
        n_steps = sum(int(prediction.n_steps) for prediction in predictions)
        return _Lane(residuals, jacobian, not is_finite, self._said(diagnoses, is_finite), n_steps)

    def cost_and_gradient(self, u: Float[np.ndarray, " k"]) -> CostAndGradient:
        """Half the sum of squares and its gradient in reverse mode, for many unknowns; NaN where a run fails.

        Each experiment's run is gone back along its steps: see `motion.derivatives.pullback`.
        """
        found = []
        for experiment, noise in zip(self.experiments, self.noise, strict=True):
            weights = np.where(experiment.is_measured, 1 / noise, 0.0)
            found.append(experiment.cost_and_gradient(jnp.asarray(u), weights, self.loss))
        cost, gradient = sum(each.cost for each in found), np.sum([each.gradient for each in found], 0)
        is_finite = np.isfinite(cost) and bool(np.all(np.isfinite(gradient)))
        why = self._said([each.diagnosis for each in found], is_finite)
        return CostAndGradient(float(cost), gradient, why)

    def _said(self, diagnoses: Sequence[str], is_finite: bool) -> str:
        """Why an evaluation failed, with the names of experiments where there are several; or nothing."""
        several = len(self.experiments) > 1
        said = [
            f"{experiment.measured.name}: {why}" if several else why
            for experiment, why in zip(self.experiments, diagnoses, strict=True)
            if why
        ]
        return "; ".join(said) or ("" if is_finite else "the residuals or their derivatives are not finite")

    def until(self, t: float) -> "Problem":
        """The problem with what was measured up to t [s]; nothing is compiled for it.

        Experiments that begin later drop out.
        """
        kept = [
            (each.until(t), noise)
            for each, noise in zip(self.experiments, self.noise, strict=True)
            if each.until(t).is_measured.any()
        ]
        if not kept:
            raise SceneError(f"nothing was measured up to t = {t:.6g} s")
        experiments, noise = zip(*kept, strict=True)
        return Problem(self.unknowns, self.start, experiments, noise, self.noise_is_known, self.loss)

    def raw(self, residuals: np.ndarray) -> np.ndarray:
        """Prediction minus measurement over the noise, from the residuals that a method sees."""
        return residuals if self.loss is None else np.asarray(self.loss.residual(residuals))

    def raw_jacobian(self, residuals: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
        """Derivatives of `raw` residuals, from residuals and derivatives that a method sees."""
        if self.loss is None:
            return jacobian
        return jacobian / np.asarray(rooted(self.loss, self.raw(residuals))[1])[:, None]

    def with_noise(self, noise: Sequence[np.ndarray], *, is_known: bool) -> "Problem":
        """The same problem with other weights."""
        return Problem(self.unknowns, self.start, self.experiments, noise, is_known, self.loss)

    def with_data(self, data: Sequence[np.ndarray]) -> "Problem":
        """The same problem with other measured values, one array (n, m) for each experiment; missing ones stay so."""
        import equinox as eqx

        experiments = [
            eqx.tree_at(lambda e: e.data, experiment, np.asarray(values))
            for experiment, values in zip(self.experiments, data, strict=True)
        ]
        return Problem(self.unknowns, self.start, experiments, self.noise, self.noise_is_known, self.loss)


class _Lane(NamedTuple):
    """One set of unknowns of an `Evaluation`."""

    residuals: np.ndarray
    jacobian: np.ndarray
    failed: bool
    diagnosis: str
    n_steps: int


def problem_of(
    build: Build,
    start: Mapping[str, Any],
    experiments: Sequence[Measured],
    noise: Any = None,
    *,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = MAX_STEPS,
    n_samples: int = 1,
    is_held_out: bool = False,
    loss: Loss | None = None,
) -> Problem:
    """The problem of a fit; arguments as for `sj.fit`, experiments as `Measured`.

    Programs are compiled for the longest experiment, or for `n_samples` instants where that is more. Records that are
    held out (`is_held_out`) are predicted only: they need not determine, or depend on, all parameters.

    Raises:
        SceneError: for a request that makes no sense, before anything is simulated.
    """
    require_float64()
    check_loss(loss)
    settings = RunSettings(rtol, atol, solver, max_steps=max_steps).checked()
    experiments = _named(experiments)
    if not isinstance(start, Mapping):
        unknowns_from(start)  # refuses it
    common = list(start)
    unknowns, values = unknowns_from(with_own_parameters(start, experiments))
    n_samples = max(n_samples, *(one.ts.size for one in experiments))
    made = [experiment_of(build, unknowns, values, one, settings, n_samples, common) for one in experiments]
    if not is_held_out:
        refuse_unused(common, experiments, [one.arguments for one in made])
        if not all(one.depends_on_unknowns for one in made):
            names = ", ".join(repr(part.name) for part in unknowns.parts)
            raise SceneError(f"the scene does not depend on {names}: nothing to fit")
    stated = [noise_of(each, noise) for each in made]
    if len({each is None for each in stated}) == 2:
        unsaid = [str(each.measured.name) for each, given in zip(made, stated, strict=True) if given is None]
        raise SceneError(f"state the noise of all measurements or of none; it is missing for {', '.join(unsaid)}")
    is_known = stated[0] is not None
    weights = [_scales(each) if given is None else given for each, given in zip(made, stated, strict=True)]
    problem = Problem(unknowns, values, made, weights, is_known, loss)
    if problem.n_residuals < unknowns.size and not is_held_out:
        raise SceneError(f"{problem.n_residuals} measured values cannot determine {unknowns.size} parameters")
    return problem


def _named(experiments: Sequence[Measured]) -> list[Measured]:
    """Experiments with names, all of them different."""
    named, seen = [], set()
    for i, experiment in enumerate(experiments):
        experiment = experiment.named(f"experiment {i + 1}")
        name, n = str(experiment.name), 1
        while experiment.name in seen:
            n += 1
            experiment = experiment.replaced(name=f"{name} ({n})")
        seen.add(experiment.name)
        named.append(experiment)
    return named


def noise_of(experiment: Experiment, noise: Any) -> np.ndarray | None:
    """Standard deviations of the errors of an experiment, shape (n, m); None where they are not stated.

    Raises:
        SceneError: for noise that is not positive, has another shape, or is missing for an observable.
    """
    measured = experiment.measured
    noise = measured.noise if measured.noise is not None else noise
    if noise is None:
        return None
    columns = []
    for name, values in measured.values.items():
        if isinstance(noise, Mapping):
            if name not in noise:
                raise SceneError(f"noise of {name!r} is missing; noise= has {', '.join(map(repr, noise)) or 'nothing'}")
            given = noise[name]
        else:
            given = noise
        try:
            deviation = np.broadcast_to(np.asarray(visible(given), np.float64), values.shape)
        except (TypeError, ValueError) as error:
            raise SceneError(
                f"noise of {name!r} must be a number or an array of shape {values.shape}; it is {given!r}"
            ) from error
        if not np.all(deviation[~np.isnan(values)] > 0) or not np.all(np.isfinite(deviation[~np.isnan(values)])):
            raise SceneError(f"noise of {name!r} must be positive and finite: it is a standard deviation")
        columns.append(np.where(np.isnan(values), 1.0, deviation).reshape(values.shape[0], -1))
    if isinstance(noise, Mapping) and (unknown := [name for name in noise if name not in measured.values]):
        others = ", ".join(map(repr, measured.values))
        if measured.noise is not None:
            raise SceneError(f"noise= names {unknown[0]!r}, which was not measured; measured are {others}")
    return np.concatenate(columns, 1)


def _scales(experiment: Experiment) -> np.ndarray:
    """Weights before the noise has been estimated: how much each observable varies."""
    columns = []
    for values in experiment.measured.values.values():
        there = values[~np.isnan(values)]
        size = (np.std(there) or np.max(np.abs(there)) or 1.0) if there.size else 1.0
        columns.append(np.full(values.shape, size).reshape(values.shape[0], -1))
    return np.concatenate(columns, 1)
