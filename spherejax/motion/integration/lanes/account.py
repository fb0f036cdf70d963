"""What runs report besides their samples: a row of numbers each, which a loop writes down when a run has ended."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from spherejax.foundations.lanes import in_lanes, with_rows_at
from spherejax.motion.integration.audit import CHECKS
from spherejax.motion.integration.lanes.lane import Lane, LaneOutcome
from spherejax.motion.integration.status import Status, end_status

_STATUS = 1
"""Place of the status in a row."""


class AccountLayout(NamedTuple):
    """Where a row has what (static).

    Attributes:
        n_contacts: contacts whose onsets are counted.
        n_checks: of the audit.
        n_watched: numbers whose largest values are kept.
        shape: of a state.
    """

    n_contacts: int
    n_checks: int
    n_watched: int
    shape: tuple[int, ...]

    @classmethod
    def of(cls, lanes: Lane) -> "AccountLayout":
        """That of runs in lanes."""
        n_checks = 0 if lanes.watch is None else len(CHECKS)
        return cls(lanes.n_onsets.shape[0], n_checks, lanes.peaks.shape[0], lanes.y.shape[:-1])

    def rows(self, n_jobs: int) -> Float[Array, "n_jobs k"]:
        """Those of a queue at its start. One that nobody writes is of no run that succeeded."""
        # Time, status and two counts of steps stand first.
        size = 4 + 2 * self.n_contacts + self.n_watched + self.n_checks + math.prod(self.shape)
        return jnp.zeros((n_jobs, size)).at[:, _STATUS].set(Status.SOLVER_FAILED)

    def outcome(
        self, rows: Float[Array, "n_jobs k"], ys: Array, samples_are_finite: Array, n_lane_steps: Array, t_end
    ) -> LaneOutcome:
        """What became of the runs, out of their rows, their samples, and when they should have ended [s]."""
        n = 4 + self.n_contacts
        watched = n + self.n_contacts + self.n_watched
        ends = [_STATUS, n, n + self.n_contacts, watched, watched + self.n_checks]
        t_reached, counts, touching, peaks, audit, y_reached = jnp.split(rows, ends, axis=1)
        status, n_accepted, n_rejected = counts[:, :3].astype(jnp.int64).T
        are_finite = samples_are_finite & jnp.all(jnp.isfinite(y_reached), axis=1)
        # Also of a run whose lane succeeded: samples that are not finite, or an end that was not reached, make it a
        # failure.
        status = jax.vmap(end_status, (0, 0, None, 0))(status, t_reached[:, 0], t_end, are_finite)
        return LaneOutcome(
            ys=ys,
            t_reached=t_reached[:, 0],
            status=status,
            n_accepted=n_accepted,
            n_rejected=n_rejected,
            n_onsets=counts[:, 3:].astype(jnp.int64),
            touching=touching,
            peaks=peaks,
            y_reached=y_reached.reshape(-1, *self.shape),
            audit=audit,
            n_lane_steps=n_lane_steps,
        )


def samples_are_finite(ys: Float[Array, "n_jobs n ..."], ts: Float[Array, " n"], t_last) -> Bool[Array, " n_jobs"]:
    """Whether all samples of each run up to a time [s] are finite."""
    # Samples behind the end were never written, and stay NaN.
    is_due = (ts <= t_last).reshape(-1, *(1 for _ in ys.shape[2:]))
    return jnp.all(jnp.isfinite(ys) | ~is_due, axis=tuple(range(1, ys.ndim)))


def written(rows: Float[Array, "n_jobs k"], at: Array, lanes: Lane) -> Float[Array, "n_jobs k"]:
    """The rows with those of lanes written down; a lane whose place is behind the last row is not."""
    return with_rows_at(rows, at, in_lanes(_row)(lanes).T)


def _row(lane: Lane) -> Float[Array, " k"]:
    # One row of one type: all that a run reports is written down by one operation.
    counts = jnp.stack([lane.status, lane.n_accepted, lane.n_rejected])
    audit = jnp.zeros(0) if lane.watch is None else lane.watch.worst
    numbers = [lane.t[None], counts, lane.n_onsets, lane.touching, lane.peaks, audit, lane.y.ravel()]
    return jnp.concatenate([each.astype(jnp.float64) for each in numbers])
