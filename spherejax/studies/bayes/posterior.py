"""`sj.posterior`: draws from the posterior distribution of a fit's parameters."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.foundations.terminals import console, is_watched
from spherejax.studies.bayes.bayes_result import Posterior
from spherejax.studies.bayes.density import log_density_of, priors_for
from spherejax.studies.bayes.priors import Prior
from spherejax.studies.bayes.sampling import blackjax_or_error, draw, whitening
from spherejax.studies.fit.fit_result import Fit
from spherejax.studies.fit.problem import NO_LIKELIHOOD, Problem
from spherejax.studies.random_numbers import Rng, generator, rng_was_seed


@rng_was_seed
def posterior(
    fitted: Fit | Problem,
    *,
    priors: Mapping[str, Prior] | None = None,
    n_samples: int = 500,
    n_chains: int = 4,
    n_warmup: int = 200,
    target_acceptance: float = 0.8,
    rng: Rng = 0,
    progress: bool | Callable[[int], None] = True,
) -> Posterior:
    """Draw from the posterior distribution of the parameters of a fit.

    The density is the likelihood of the measurements, for independent normal errors of the stated noise, times the
    priors, within the bounds. Chains of the no-U-turn sampler begin around the estimates, with the Fisher information
    as their metric.

    Args:
        fitted: a fit; or its problem, which is then taken to begin at the estimates.

    Other args:
        priors: log densities by parameter: those of `sj.priors`, e.g. `sj.priors.Normal(1e5, 1e4)`, or functions of the
            parameter. Without one a parameter in an interval, or without bounds, is uniform; a positive one is uniform
            in its logarithm.
        n_samples: draws that are kept, of each chain.
        n_chains: chains; they run on all cores.
        n_warmup: draws before, in which the length of the steps adapts.
        target_acceptance: probability of acceptance that the steps adapt to; larger means shorter steps.
        rng: of all random numbers, a whole number or a generator; None: others each time.
        progress: shown in terminals and notebooks (True), not at all (False), or a function of the draws made.

    Returns:
        The draws and what they say. Ctrl-C after the warm-up ends the chains with what they have.

    Raises:
        SceneError: for a request that makes no sense, for noise that is not known, or where the extra `bayes` is not
            installed.

    Limits: chains explore one maximum. Several, as dry contact has them, show by their starts in `sj.fit`.
    """
    began = time.monotonic()
    for name, value, least in (("n_samples", n_samples, 4), ("n_chains", n_chains, 1), ("n_warmup", n_warmup, 0)):
        if not value >= least:
            raise SceneError(f"{name} = {value} must be at least {least}")
    if not 0 < target_acceptance < 1:
        raise SceneError(f"target_acceptance = {target_acceptance} must lie between 0 and 1")
    fit = fitted if isinstance(fitted, Fit) else None
    problem = fit.problem if fit is not None else fitted
    assert isinstance(problem, Problem)
    if problem.loss is not None:
        raise SceneError(f"the posterior needs a likelihood: {NO_LIKELIHOOD.format(loss=problem.loss)}")
    notes = []
    if not problem.noise_is_known:
        if fit is None:
            raise SceneError("the posterior needs the noise of the measurements: give noise= to the problem")
        problem = problem.with_noise(fit.noise, is_known=True)
        notes.append("the noise was estimated by the fit, and is taken as known")
    chosen = priors_for(problem.unknowns, priors)
    blackjax_or_error()
    center = problem.u0 if fit is None else fit.u
    found = problem.evaluate(center[None])
    if found.failed[0]:
        raise SceneError(f"the run at the estimates failed: {found.diagnoses[0]}")
    with _reporting(progress, n_warmup + n_samples) as report:
        drawn = draw(
            log_density_of(problem, chosen),
            center,
            whitening(found.jacobians[0]),
            n_chains=n_chains,
            n_warmup=n_warmup,
            n_samples=n_samples,
            target=target_acceptance,
            seed=rng if isinstance(rng, int) else int(generator(rng).integers(2**31)),
            report=report,
        )
    return Posterior(
        problem=problem,
        fit=fit,
        priors=chosen,
        us=drawn.draws.us,
        log_density=drawn.draws.log_density,
        is_divergent=drawn.draws.is_divergent,
        acceptance=drawn.draws.acceptance,
        n_gradients=int(np.sum(drawn.draws.n_gradients)),
        step_sizes=drawn.step_sizes,
        interrupted=drawn.interrupted,
        notes=tuple(notes),
        seconds=time.monotonic() - began,
    )


@contextmanager
def _reporting(progress: bool | Callable[[int], None], n_draws: int) -> Iterator[Callable[[int], None]]:
    if callable(progress):
        yield progress
        return
    if not progress or not is_watched():
        yield lambda n: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("posterior"), BarColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with Progress(*columns, console=console()) as bar:
        task = bar.add_task("compiling", total=n_draws)
        yield lambda n: bar.update(task, completed=n, description=f"{n} of {n_draws} draws of each chain")
