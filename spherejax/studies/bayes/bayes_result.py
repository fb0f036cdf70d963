"""Draws from a posterior, and what they say."""

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.studies.bayes.priors import Prior
from spherejax.studies.fit.fit_result import Fit
from spherejax.studies.fit.problem import Problem

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

LARGEST_R_HAT = 1.01
"""Chains that agree stay below; Vehtari et al. (2021), Bayesian Analysis 16:667-718."""

FEWEST_EFFECTIVE = 100
"""Effective draws below which means and intervals are rough."""


@dataclass(frozen=True)
class Posterior:
    """Draws from the posterior distribution of parameters; prints as a summary.

    Attributes:
        problem: residuals and unknowns.
        fit: the fit that it began with, or None.
        priors: by parameter.
        us: draws of the unknowns without bounds, (n_chains, n_draws, k).
        log_density: of each draw, up to a constant.
        is_divergent: draws whose trajectory lost its energy: the posterior is too curved for the steps there.
        acceptance: mean probability of acceptance of each draw.
        n_gradients: runs with derivatives.
        step_sizes: of the chains, in standard deviations of the fit.
        interrupted: whether Ctrl-C ended the chains.
        notes: what else is to be said, sentences.
        seconds: how long it took [s], compilation included.
    """

    problem: Problem = field(repr=False)
    fit: Fit | None = field(repr=False)
    priors: dict[str, Prior]
    us: np.ndarray = field(repr=False)
    log_density: np.ndarray = field(repr=False)
    is_divergent: np.ndarray = field(repr=False)
    acceptance: np.ndarray = field(repr=False)
    n_gradients: int
    step_sizes: np.ndarray
    interrupted: bool
    notes: tuple[str, ...]
    seconds: float

    @property
    def names(self) -> list[str]:
        """Of all numbers, arrays flattened as `name[0]`, ..."""
        return self.problem.names

    @cached_property
    def draws(self) -> Float[np.ndarray, "chains draws k"]:
        """Of all numbers in the order of `names`, in the parameters' units."""
        values = jax.vmap(jax.vmap(lambda u: _flat(self.problem.values_of(u))))(jnp.asarray(self.us))
        return np.asarray(values)

    @property
    def samples(self) -> dict[str, np.ndarray]:
        """Draws by parameter, (n_chains, n_draws, ...)."""
        return self._by_name(np.moveaxis(self.draws, -1, 0), self.us.shape[:2])

    @property
    def mean(self) -> dict[str, Any]:
        """Means by parameter."""
        return self._by_name(self.draws.mean((0, 1)))

    @property
    def standard_deviations(self) -> dict[str, Any]:
        """By parameter."""
        return self._by_name(self._all.std(0, ddof=1))

    @property
    def covariance(self) -> np.ndarray:
        """In the order of `names`."""
        return np.atleast_2d(np.cov(self._all.T))

    def interval(self, level: float = 0.95) -> dict[str, Any]:
        """Intervals that hold a share of the draws, with as many below as above: (low, high) by parameter."""
        low, high = np.quantile(self._all, [(1 - level) / 2, (1 + level) / 2], axis=0)
        lows, highs = self._by_name(low), self._by_name(high)
        return {
            name: (lows[name], highs[name]) if np.ndim(lows[name]) == 0 else np.stack([lows[name], highs[name]], -1)
            for name in lows
        }

    @cached_property
    def r_hat(self) -> dict[str, Any]:
        """How far the chains disagree, by parameter: 1 where they do not (rank-normalised, split chains)."""
        from blackjax.diagnostics import rhat

        return self._by_name(np.asarray(rhat(jnp.asarray(self.us))))

    @cached_property
    def effective_samples(self) -> dict[str, Any]:
        """How many independent draws say as much about the bulk, by parameter."""
        from blackjax.diagnostics import ess_bulk

        return self._by_name(np.asarray(ess_bulk(jnp.asarray(self.us))))

    @property
    def errors_of_means(self) -> dict[str, Any]:
        """Standard deviations of the means for the finite number of draws, by parameter."""
        return {
            name: deviation / np.sqrt(self.effective_samples[name])
            for name, deviation in self.standard_deviations.items()
        }

    @property
    def n_divergences(self) -> int:
        """Count of divergent draws."""
        return int(np.sum(self.is_divergent))

    @property
    def succeeded(self) -> bool:
        """Whether chains agree, none diverged, and there are enough effective draws."""
        return not self.warnings

    @cached_property
    def warnings(self) -> list[str]:
        """What to think about before the draws are used."""
        found = []
        worst = max(float(np.max(value)) for value in self.r_hat.values())
        fewest = min(float(np.min(value)) for value in self.effective_samples.values())
        if not worst <= LARGEST_R_HAT:
            found.append(f"the chains disagree (R-hat {worst:.3g} > {LARGEST_R_HAT}): draw more, or look at the traces")
        if not fewest >= FEWEST_EFFECTIVE:
            found.append(f"only {fewest:.0f} effective draws: draw more (n_samples=)")
        if self.n_divergences:
            found.append(
                f"{self.n_divergences} divergent draws: raise target_acceptance=, or give priors or bounds that keep "
                "the chains where runs succeed"
            )
        if self.interrupted:
            found.append(f"interrupted after {self.us.shape[1]} draws of each chain")
        return found

    def __str__(self) -> str:
        n_chains, n_draws, _ = self.us.shape
        low, high = np.quantile(self._all, [0.025, 0.975], axis=0)
        fewest = np.concatenate([np.ravel(value) for value in self.effective_samples.values()])
        worst = np.concatenate([np.ravel(value) for value in self.r_hat.values()])
        heads = ("parameter", "mean", "deviation", "95 % from", "to", "effective", "R-hat")
        rows = [
            (name, *(f"{value:.6g}" for value in values[:4]), f"{values[4]:.0f}", f"{values[5]:.4f}")
            for name, values in zip(
                self.names,
                np.stack([self._all.mean(0), self._all.std(0, ddof=1), low, high, fewest, worst], -1),
                strict=True,
            )
        ]
        widths = [max(len(row[i]) for row in (heads, *rows)) for i in range(len(heads))]
        lines = ["  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in (heads, *rows)]
        lines.append(
            f"{n_chains} chains of {n_draws} draws, {self.n_gradients} runs with derivatives, {self.seconds:.3g} s; "
            f"{self.n_divergences} divergent, acceptance {np.mean(self.acceptance):.2f}"
        )
        return "\n".join([*lines, *self.notes, *(f"warning: {warning}" for warning in self.warnings)])

    def figures(self, title: str = "") -> "dict[str, Figure]":
        """`pairs`: draws of each pair of numbers, beside the normal distribution of the fit; `traces`: along chains."""
        from spherejax.output.plot.posterior import pairs_figure, traces_figure

        normal = None if self.fit is None else (self.fit.knowledge.values, self.fit.covariance)
        title = title or "Draws from the posterior"
        return {
            "pairs": pairs_figure(self.draws, self.names, normal, title),
            "traces": traces_figure(self.draws, self.names, title),
        }

    def to_xarray(self) -> "xarray.Dataset":
        """Draws by parameter over `chain` and `draw`, with the sampler's own numbers; as ArviZ names them."""
        import xarray

        n_chains, n_draws, _ = self.us.shape
        both = ("chain", "draw")
        variables: dict[str, Any] = {
            name: ((*both, *(f"{name}_{i}" for i in range(values.ndim - 2))), values)
            for name, values in self.samples.items()
        }
        variables["lp"] = (both, self.log_density, {"long_name": "log density of the unknowns, up to a constant"})
        variables["diverging"] = (both, self.is_divergent.astype(np.int8))
        variables["acceptance_rate"] = (both, self.acceptance)
        return xarray.Dataset(variables, {"chain": np.arange(n_chains), "draw": np.arange(n_draws)})

    def save(self, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
        """Write `to_xarray()` to a netCDF file (.nc)."""
        from spherejax.output.io import save

        return save(self.to_xarray(), path, overwrite=overwrite)

    @property
    def _all(self) -> Float[np.ndarray, "n k"]:
        return self.draws.reshape(-1, self.draws.shape[-1])

    def _by_name(self, flat: np.ndarray, trailing: tuple[int, ...] = ()) -> dict[str, Any]:
        """Numbers by parameter; `trailing` axes of `flat` come first in the arrays."""
        found, at = {}, 0
        for part in self.problem.unknowns.parts:
            own = np.reshape(flat[at : at + part.size], (*part.shape, *trailing))
            own = np.moveaxis(own, range(len(part.shape)), range(len(trailing), own.ndim)) if trailing else own
            found[part.name] = own.item() if own.ndim == 0 else own
            at += part.size
        return found


def _flat(values: dict[str, Any]):
    return jnp.concatenate([jnp.ravel(value) for value in values.values()])
