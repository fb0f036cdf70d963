"""What is to be minded of each run of a sweep, as bits of an integer: that it failed, or left the range of a law."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from spherejax.motion.integration.audit import FINDINGS, N_FATAL, WARNINGS
from spherejax.motion.integration.status import REMEDIES, Status

if TYPE_CHECKING:
    import xarray

FLAGS = ("failed", *WARNINGS)
"""Bit k of `warnings` stands for the k-th of these. Runs that a store does not hold yet have -1, and never 0."""

MASKS = {flag: 1 << k for k, flag in enumerate(FLAGS)}


def flags_of(status: Int[np.ndarray, " n"], audit: Float[np.ndarray, "n n_checks"]) -> Int[np.ndarray, " n"]:
    """The bits of each run.

    Args:
        status: integers of `Status`.
        audit: the worst of each of `audit.CHECKS` as a share of its limit.
    """
    is_set = np.concatenate([(status != Status.SUCCEEDED)[:, None], audit[:, N_FATAL:] > 1], axis=1)
    return is_set @ np.array(list(MASKS.values()), np.int64)


class FlaggedRuns(NamedTuple):
    """Runs of which the same is to be minded.

    Attributes:
        what: how they failed, or the check whose range they left, in words.
        n: their number.
        is_so: which runs, with the axes of the sweep.
        t_reached: least and largest time reached [s].
        text: what happened and what to do.
    """

    what: str
    n: int
    is_so: np.ndarray
    t_reached: tuple[float, float]
    text: str

    def ranges(self, swept: "xarray.Dataset") -> dict[str, tuple[float, float]]:
        """Least and largest value of each parameter among these runs, in its unit."""
        status = swept["status"]
        among = {}
        for name in map(str, status.coords):
            if name != "run":
                values = np.asarray(swept[name].broadcast_like(status).transpose(*status.dims))[self.is_so]
                among[name] = (float(values.min()), float(values.max()))
        return among


def flagged_runs(swept: "xarray.Dataset") -> list[FlaggedRuns]:
    """Which runs of a sweep failed or left the range of a law, sorted by the cause; empty for a sweep without any.

    Args:
        swept: the result of `sj.sweep` or `sj.open_sweep`. Stores of earlier versions have no warnings, but failures.
    """
    status = np.asarray(swept["status"])
    causes: list[tuple[str, Any, str]] = [
        (kind.name.lower().replace("_", " "), status == kind, REMEDIES[kind])
        for kind in Status
        if kind != Status.SUCCEEDED
    ]
    if "warnings" in swept:
        flags = np.asarray(swept["warnings"])
        causes += [(flag, (flags > 0) & (flags & MASKS[flag] > 0), FINDINGS[flag]) for flag in WARNINGS]
    reached = np.asarray(swept["t_reached"])
    return [
        FlaggedRuns(what, int(is_so.sum()), is_so, (float(reached[is_so].min()), float(reached[is_so].max())), text)
        for what, is_so, text in causes
        if is_so.any()
    ]
