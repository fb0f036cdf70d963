"""The log density of the posterior as a function of unknowns without bounds.

With the fit's map p(u), the density of u is that of p times the volume that du covers,

    log density(u) = -|r(u)|^2 / 2 + sum_i log prior_i(p_i) + sum_i log |dp_i/du_i|,

r being the residuals over the noise. Value and gradient -J^T r come from one integration.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Scalar
from spherejax.studies.bayes.priors import LogUniform, Prior, Uniform
from spherejax.studies.fit.parameters import FitUnknowns, Unknown
from spherejax.studies.fit.problem import Problem

LogDensity = Callable[[Float[Array, " k"]], Scalar]


def log_density_of(problem: Problem, priors: Mapping[str, Prior]) -> LogDensity:
    """The logarithm of the posterior's density by unknowns, up to a constant; minus infinity where a run fails."""

    @jax.custom_jvp
    def log_likelihood(u):
        return _value(problem.residuals_and_jacobian(u)[0])

    @log_likelihood.defjvp
    def log_likelihood_jvp(primals, tangents):
        residuals, jacobian = problem.residuals_and_jacobian(*primals)
        there = jnp.all(jnp.isfinite(residuals)) & jnp.all(jnp.isfinite(jacobian))
        residuals, jacobian = (jnp.where(there, part, 0.0) for part in (residuals, jacobian))
        value = jnp.where(there, _value(residuals), -jnp.inf)
        return value, -(residuals @ jacobian) @ tangents[0]

    def log_density(u):
        values = problem.unknowns.values_of(u)
        before = sum(jnp.sum(priors[name](value)) for name, value in values.items())
        return log_likelihood(u) + before + log_volume(problem.unknowns, u)

    return log_density


def _value(residuals) -> Scalar:
    fits = jnp.all(jnp.isfinite(residuals))
    return jnp.where(fits, -jnp.sum(jnp.where(fits, residuals, 0.0) ** 2) / 2, -jnp.inf)


def log_volume(unknowns: FitUnknowns, u: Float[Array, " k"]) -> Scalar:
    """sum_i log |dp_i/du_i|, up to a constant."""
    total, at = jnp.zeros(()), 0
    for part in unknowns.parts:
        own = u[at : at + part.size]
        low, high = np.isfinite(part.lower), np.isfinite(part.upper)
        if low and high:
            total = total + jnp.sum(jax.nn.log_sigmoid(own) + jax.nn.log_sigmoid(-own))
        elif low or high:
            total = total + jnp.sum(own)
        at += part.size
    return total


def priors_for(unknowns: FitUnknowns, given: Mapping[str, Prior] | None) -> dict[str, Prior]:
    """A prior for each parameter.

    Raises:
        SceneError: for a name that is no parameter, or what is no prior.
    """
    names = [part.name for part in unknowns.parts]
    for name, prior in (given or {}).items():
        if name not in names:
            raise SceneError(f"priors names {name!r}, which is not fitted; the parameters are {', '.join(names)}")
        if not callable(prior):
            raise SceneError(
                f"the prior of {name!r} must be a function from the parameter to its log density, such as "
                f"sj.priors.Normal(mean, deviation); it is {prior!r}"
            )
    chosen = {part.name: (given or {}).get(part.name, _default(part)) for part in unknowns.parts}
    for part in unknowns.parts:
        _check_shape(part, chosen[part.name])
    return chosen


def _default(part: Unknown) -> Prior:
    """Uniform within an interval or without bounds; in the logarithm for a positive number."""
    return LogUniform() if part.is_relative and not np.isfinite(part.upper) and part.lower == 0 else Uniform()


def _check_shape(part: Unknown, prior: Prior) -> None:
    value: Any = jax.ShapeDtypeStruct(part.shape, jnp.float64)
    found = jax.eval_shape(lambda x: jnp.asarray(prior(x)), value)
    if found.shape not in ((), part.shape):
        raise SceneError(
            f"the prior of {part.name!r} gives an array of shape {found.shape}; it must give one number, or one for "
            f"each of shape {part.shape}"
        )
