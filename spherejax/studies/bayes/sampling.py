"""Chains of the no-U-turn sampler (Hoffman and Gelman, 2014), by blackjax.

The chains move in z with u = center + factor z, where factor factor^T is the inverse of the Fisher information at the
estimate: a posterior that the fit describes well is a round normal distribution there, and only the length of the
steps is left to adapt.

A chain runs as one compiled loop over a few draws, one thread for each chain: simulations as native loops are faster
one by one than side by side in one vectorised program.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.foundations.errors import SceneError
from spherejax.studies.bayes.density import LogDensity

AT_ONCE = 25
"""Draws between two looks at the clock, and at Ctrl-C."""

FIRST_STEP = 0.5
"""Length of the first steps in z, where the posterior is about one wide."""

LARGEST_DOUBLINGS = 8
"""Of a trajectory; a draw takes at most 255 gradients."""


class Draws(NamedTuple):
    """What chains have drawn.

    Attributes:
        us: unknowns.
        log_density: of them.
        is_divergent: whether the energy error of the trajectory was beyond bounds.
        acceptance: mean probability of acceptance along the trajectory.
        n_gradients: of the trajectory.
    """

    us: Float[np.ndarray, "chains draws k"]
    log_density: Float[np.ndarray, "chains draws"]
    is_divergent: np.ndarray
    acceptance: Float[np.ndarray, "chains draws"]
    n_gradients: np.ndarray

    def first(self, n: int) -> "Draws":
        """The first draws."""
        return Draws(*(part[:, :n] for part in self))


class Drawn(NamedTuple):
    """Draws, and how they came about.

    Attributes:
        draws: after the warm-up.
        step_sizes: of the chains.
        interrupted: whether Ctrl-C ended them.
    """

    draws: Draws
    step_sizes: Float[np.ndarray, " chains"]
    interrupted: bool


def blackjax_or_error() -> Any:
    """The library.

    Raises:
        SceneError: where it is not installed.
    """
    try:
        import blackjax
    except ImportError as error:
        raise SceneError(f"sampling a posterior needs a library: pip install 'spherejax[bayes]' ({error})") from error
    return blackjax


def draw(
    log_density: LogDensity,
    center: Float[np.ndarray, " k"],
    factor: Float[np.ndarray, "k k"],
    *,
    n_chains: int,
    n_warmup: int,
    n_samples: int,
    target: float,
    seed: int,
    report: Callable[[int], None],
) -> Drawn:
    """Run the chains.

    Raises:
        SceneError: where the density is not finite at any start of a chain.
    """
    chains = _Chains(log_density, center, factor, target)
    keys = jax.random.split(jax.random.key(seed), n_chains)
    with ThreadPoolExecutor(min(n_chains, _n_cores())) as pool:
        states = list(pool.map(chains.begun, keys))
        lost = [i for i, (state, _) in enumerate(states) if not np.isfinite(state.logdensity)]
        if lost:
            raise SceneError(
                f"the posterior has no finite density where chain {lost[0] + 1} begins: a run fails there, or a prior "
                "forbids it. Fit first and give the fit, or give priors that allow the estimate"
            )
        n_before = -(-n_warmup // AT_ONCE)
        parts: list[list[Draws]] = []
        interrupted = False
        try:
            for number in range(n_before + -(-n_samples // AT_ONCE)):
                found = list(
                    pool.map(partial(chains.advanced, number=number, adapting=number < n_before), keys, states)
                )
                states = [state for state, _ in found]
                if number >= n_before:
                    parts.append([part for _, part in found])
                report(min((number + 1) * AT_ONCE, n_warmup + n_samples))
        except KeyboardInterrupt:
            interrupted = True
    if not parts:
        raise KeyboardInterrupt
    sizes = np.array([float(chains.step_size(adaptation)) for _, adaptation in states])
    return Drawn(_joined(parts).first(n_samples), sizes, interrupted)


class _Chains:
    """What the chains share: one compiled program."""

    def __init__(self, log_density: LogDensity, center, factor, target: float):
        blackjax = blackjax_or_error()
        from blackjax.adaptation.step_size import dual_averaging_adaptation

        self.first_adaptation, update, self.step_size = dual_averaging_adaptation(target)
        center, factor = jnp.asarray(center), jnp.asarray(factor)

        def density(z):
            return log_density(center + factor @ z)

        def one(carry, key, adapting):
            state, adaptation = carry
            size = jnp.where(adapting, jnp.exp(adaptation.log_step_size), self.step_size(adaptation))
            sampler = blackjax.nuts(density, size, jnp.ones(center.size), max_num_doublings=LARGEST_DOUBLINGS)
            state, info = sampler.step(key, state)
            updated = update(adaptation, info.acceptance_rate)
            adaptation = jax.tree.map(lambda new, old: jnp.where(adapting, new, old), updated, adaptation)
            drawn = (
                center + factor @ state.position,
                state.logdensity,
                info.is_divergent,
                info.acceptance_rate,
                info.num_integration_steps,
            )
            return (state, adaptation), drawn

        def several(state, adaptation, key, adapting):
            keys = jax.random.split(key, AT_ONCE)
            return jax.lax.scan(lambda carry, key: one(carry, key, adapting), (state, adaptation), keys)

        self._several = jax.jit(several)
        self._init = jax.jit(lambda z: blackjax.nuts.init(z, density))
        self._size = center.size

    def begun(self, key) -> tuple[Any, Any]:
        """A chain at a place drawn from the normal distribution that the fit describes."""
        return self._init(jax.random.normal(key, (self._size,))), self.first_adaptation(FIRST_STEP)

    def advanced(self, key, state, *, number: int, adapting: bool) -> tuple[Any, Draws]:
        """The chain after some more draws."""
        after, drawn = self._several(*state, jax.random.fold_in(key, number), adapting)
        return after, Draws(*(np.asarray(part)[None] for part in drawn))


def _joined(parts: list[list[Draws]]) -> Draws:
    """Chains below each other, draws side by side."""
    rows = [Draws(*(np.concatenate(each) for each in zip(*part, strict=True))) for part in parts]
    return Draws(*(np.concatenate(each, 1) for each in zip(*rows, strict=True)))


def _n_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def whitening(jacobian: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k k"]:
    """A factor of (J^T J + I)^-1: of the inverse Fisher information, and one wide in u where nothing is determined."""
    return np.linalg.inv(np.linalg.cholesky(jacobian.T @ jacobian + np.eye(jacobian.shape[1]))).T
