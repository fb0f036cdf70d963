"""Runs to an accuracy: the tolerance is made tighter until the estimated error of a whole run is small enough."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from spherejax.motion.integration.status import Status
from spherejax.motion.results.accuracy import Accuracy, Limits, unit_of
from spherejax.motion.results.global_error import AT_ROUNDING, GlobalError, floor_of, repeated

MARGIN = 0.5
"""Estimates may be this share of what is allowed: the largest was 0.53 to 1.6 of the error (see `global_error`), so
that the error itself stays below what is allowed."""

LEAST, MOST = 1e-2, 0.3
"""By how much a tolerance is made tighter at once. Errors fall about in proportion to it; less than a factor of three
is too little to pay for another run, and a hundredth is where the companion is already."""


def accurate(run: Any, limits: Limits) -> Any:
    """The run itself, or the same motion at a tighter tolerance, with errors that are within limits by the estimate.

    Args:
        run: a `Trajectory` at the loosest tolerance.
        limits: what is asked for.

    Returns:
        A `Trajectory` with its `accuracy`; where no tolerance gives it the run that holds it for longest, with
        `Status.INACCURATE`. A run that fails keeps its own status.
    """
    floor, n_steps, best = floor_of(run.system), 0, None
    max_steps = run.settings.max_steps
    while int(run.ended) == Status.SUCCEEDED and int(run.stats.n_steps) <= max_steps:
        # Companions may make more steps than the caller allows for a run; the run that is returned may not.
        run = replace(run, settings=replace(run.settings, max_steps=max_steps))
        known = run.global_error
        errors = _largest(known, limits)
        excess = float(np.max(errors / [limit for _, limit in limits]))
        n_steps += int(run.stats.n_steps) + int(known.companion.stats.n_steps)
        found = replace(run, accuracy=_accuracy(run, limits, errors, known.until(limits), n_steps))
        vars(found)["global_error"] = known  # of the same run: it is not estimated again
        if excess <= MARGIN:
            return _told(found)
        if best is None or float(found.accuracy.until) >= float(best.accuracy.until):
            best = found
        rtol = run.settings.rtol
        if rtol <= floor * (1 + 1e-9):
            break
        # An error that is not known, or as large as the motion, says nothing but that it is too large.
        factor = float(np.clip(MARGIN * MOST / excess, LEAST, MOST)) if np.isfinite(excess) else LEAST
        target = max(rtol * factor, floor)
        # Close to the floor a companion has little room below its run: then the floor itself is next.
        target = floor if target < AT_ROUNDING * floor else target
        run = known.companion if _is_next(known.companion, target, run) else repeated(run, target, ts=run.ts)
    if best is None:
        return run
    return _told(replace(best, ended=jnp.asarray(int(Status.INACCURATE), jnp.asarray(best.ended).dtype)), best)


def _largest(known: GlobalError, limits: Limits) -> np.ndarray:
    """The largest estimate of each quantity; infinite where one is not known."""
    largest = [np.max(known.size_of(name)) for name, _ in limits]
    return np.where(np.isnan(largest), np.inf, largest)


def _is_next(companion: Any, target: float, run: Any) -> bool:
    """Whether the companion is the run that is to be made."""
    same = type(companion.settings.solver) is type(run.settings.solver) and len(companion.ts) == len(run.ts)
    return same and int(companion.ended) == Status.SUCCEEDED and abs(companion.settings.rtol / target - 1) < 1e-6


def _accuracy(run: Any, limits: Limits, errors: np.ndarray, until: float, n_steps: int) -> Accuracy:
    names = tuple(name for name, _ in limits)
    units = tuple(unit_of(name, run.system) for name in names)
    allowed = np.array([limit for _, limit in limits])
    return Accuracy(
        names, units, allowed, errors, np.asarray(until), np.asarray(run.settings.rtol), np.asarray(n_steps)
    )


def _told(run: Any, known: Any = None) -> Any:
    """The run, with what its tolerance was chosen for among its explanations."""
    explanation = f"{run.stats.explanation}; tolerance by accuracy=: {run.accuracy}"
    found = replace(run, stats=replace(run.stats, explanation=explanation))
    vars(found)["global_error"] = vars(run if known is None else known)["global_error"]
    return found
