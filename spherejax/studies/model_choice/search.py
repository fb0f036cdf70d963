"""Draws over the ranges of the parameters: where local fits begin.

The cost of a clearance or a viscosity has several minima over their decades, and a local fit goes to the nearest. So
parameters are drawn by a Latin hypercube (McKay, Beckman and Conover 1979), one run is made for each draw, without
derivatives, and fits begin from the best of them: of the whole record, and of its first parts, over which a motion
through impacts is still in step.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from spherejax.studies.fit.parameters import FitUnknowns, Unknown
from spherejax.studies.fit.problem import Problem
from spherejax.studies.fit.side_by_side import in_threads

AROUND = np.log(10.0)
"""A parameter without bounds on both sides is drawn within this of its start, as the further starts of `sj.fit` are."""

DECADE = 10.0
"""A positive range that is wider than this is drawn by its logarithm."""

PARTS = (0.125, 0.25, 0.5, 1.0)
"""Shares of the record over which draws are compared."""


class RangeDraws(NamedTuple):
    """Unknowns that were tried.

    Attributes:
        us: unknowns, the start first.
        costs: half the sums of squares over the `PARTS` of the record; infinite where a run failed.
        n_failed: runs that did not reach their end.
    """

    us: np.ndarray
    costs: np.ndarray
    n_failed: int

    def best(self, n: int) -> np.ndarray:
        """Unknowns of n draws: the best of the whole record, of its parts from the longest on, then the second best."""
        order = np.argsort(self.costs, axis=0)
        chosen: list[int] = []
        for rank in range(len(self.us)):
            for part in range(self.costs.shape[1])[::-1]:
                draw = int(order[rank, part])
                if draw not in chosen and np.isfinite(self.costs[draw, -1]):
                    chosen.append(draw)
                if len(chosen) == n:
                    return self.us[chosen]
        return self.us[chosen or [0]]


def draws_over_ranges(unknowns: FitUnknowns, u0: np.ndarray, n: int, random: np.random.Generator) -> np.ndarray:
    """Unknowns of n draws over the ranges, the first at the start."""
    shares = [(random.permutation(n) + random.uniform(size=n)) / n for _ in range(unknowns.size)]
    us, at = [], 0
    for part in unknowns.parts:
        for _ in range(part.size):
            us.append(_drawn(part, shares[at], u0[at]))
            at += 1
    drawn = np.stack(us, 1)
    drawn[0] = u0
    return drawn


def _drawn(part: Unknown, shares: np.ndarray, start: float) -> np.ndarray:
    lower, upper = part.lower, part.upper
    if not (np.isfinite(lower) and np.isfinite(upper)):
        return start + AROUND * (2 * shares - 1)
    if lower > 0 and upper > DECADE * lower:
        values = lower * (upper / lower) ** shares
    else:
        values = lower + (upper - lower) * shares
    inside = 1e-9 * (upper - lower)
    return part.unknown_of(np.clip(values, lower + inside, upper - inside))


def searched(problem: Problem, us: np.ndarray, tell: Callable[[int], None]) -> RangeDraws:
    """Costs of draws; their runs are made side by side on all cores."""
    times = np.concatenate([_share_of_record(one)[np.nonzero(one.is_measured)[0]] for one in problem.experiments])
    is_in = np.stack([times <= part for part in PARTS], 1)
    n_done = 0

    def costs_of(u: np.ndarray) -> np.ndarray:
        nonlocal n_done
        squares = np.asarray(problem.residuals(jnp.asarray(u))) ** 2 / 2
        n_done += 1
        tell(n_done)
        return squares @ is_in if np.all(np.isfinite(squares)) else np.full(len(PARTS), np.inf)

    costs = np.stack(in_threads(costs_of, list(us)))
    return RangeDraws(us, costs, int(np.sum(np.isinf(costs[:, -1]))))


def _share_of_record(experiment) -> np.ndarray:
    """Of each instant, how much of what was measured lies up to it: 0 at the start of the motion, 1 at the last."""
    ts, begin = experiment.measured.ts, experiment.measured.t0
    last = float(ts[experiment.is_measured.any(1)][-1])
    return (ts - begin) / (last - begin) if last > begin else np.ones(ts.size)
