"""A motion as it was measured: samples of positions, orientations, joint angles and travels."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.foundations.checks import is_concrete, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Number
from spherejax.physics.forces.coupler import AbstractCoordinate

LEAST_SAMPLES = 4
"""A third derivative needs four."""

MOST_SAMPLES = 4000
"""The smoothing is a dense least-squares problem: more samples take minutes and gigabytes."""

NYQUIST = 0.5
"""Largest cutoff as a share of the sampling rate: above it there is nothing to filter."""


class SampledMotion(eqx.Module):
    """Samples of a motion, and how they are smoothed; for `inverse_dynamics`.

        motion = sj.studies.SampledMotion(
            ts, coordinates={"elbow": (sj.Turn(("upper", "lower"), (0, 0, 1)), angles)}, cutoff=6.0
        )

    What is measured may be more or less than the mechanism's degrees of freedom: at each instant the pose is the one
    that satisfies all joints exactly and comes nearest to the smoothed samples, in the least squares of lengths over
    the mechanism's length and of angles; so are velocities and accelerations.

    Attributes:
        ts: instants of the samples, increasing [s], shape (n,).
        positions: of centers of mass, world axes [m], shape (n, 3), by body.
        quaternions: orientations, scalar first, of either sign, shape (n, 4), by body.
        coordinates: by any name a `Turn`, `Travel` or `Extension` and its samples [rad or m], shape (n,); an angle may
            go through any number of turns.
        cutoff: frequency [Hz] at which the smoothing halves a signal; see `spherejax.studies.inverse.smoothing`. An
            acceleration contains the noise of positions times the square of the frequency: take the lowest cutoff that
            leaves the motion as it is.

    Limits: a quaternion that turns by more than half a turn between two samples is misread. Smoothing is by splines
    whose derivatives are least exact at both ends of the record.
    """

    ts: Any
    positions: dict[str, Array]
    quaternions: dict[str, Array]
    coordinates: dict[str, tuple[AbstractCoordinate, Array]]
    cutoff: Number

    def __init__(
        self,
        ts,
        *,
        positions: Mapping[str, Any] | None = None,
        quaternions: Mapping[str, Any] | None = None,
        coordinates: Mapping[str, tuple[AbstractCoordinate, Any]] | None = None,
        cutoff: Number,
    ):
        self.ts = _instants(ts)
        n = len(self.ts)
        self.positions = {name: _samples(f"positions[{name!r}]", x, (n, 3)) for name, x in (positions or {}).items()}
        self.quaternions = {
            name: _samples(f"quaternions[{name!r}]", x, (n, 4)) for name, x in (quaternions or {}).items()
        }
        self.coordinates = {}
        for name, pair in (coordinates or {}).items():
            is_pair = isinstance(pair, tuple | list) and len(pair) == 2
            if not is_pair or not isinstance(pair[0], AbstractCoordinate):
                raise SceneError(
                    f"coordinates[{name!r}] = {shown(pair)} must be a coordinate and its samples, e.g. "
                    "(sj.Turn(('upper', 'lower'), (0, 0, 1)), angles)"
                )
            self.coordinates[name] = (pair[0], _samples(f"coordinates[{name!r}]", pair[1], (n,)))
        if not (self.positions or self.quaternions or self.coordinates):
            raise SceneError("a sampled motion needs samples: give positions=, quaternions= or coordinates=")
        self.cutoff = _cutoff(cutoff, self.ts)

    @property
    def body_names(self) -> tuple[str, ...]:
        """Bodies whose positions or orientations were measured."""
        return tuple(dict.fromkeys([*self.positions, *self.quaternions]))


def _instants(ts) -> np.ndarray:
    if not is_concrete(ts):
        raise SceneError("ts of a sampled motion are traced; give known numbers: knots of the spline are placed there")
    ts = np.asarray(ts, np.float64)
    if ts.ndim != 1 or not np.all(np.isfinite(ts)) or not np.all(np.diff(ts) > 0):
        raise SceneError(f"ts of a sampled motion must be finite and increase, shape (n,); it is {shown(ts)}")
    if not LEAST_SAMPLES <= len(ts) <= MOST_SAMPLES:
        raise SceneError(
            f"a sampled motion of {len(ts)} samples: it needs {LEAST_SAMPLES} to {MOST_SAMPLES}. Split a longer "
            "record, or keep every second sample"
        )
    return ts


def _samples(what: str, values, shape: tuple[int, ...]) -> Array:
    values = jnp.asarray(values, jnp.float64)
    if values.shape != shape:
        raise SceneError(f"{what} must have the shape {shape}, one row for each of ts; it has {values.shape}")
    if is_concrete(values) and not np.all(np.isfinite(values)):
        raise SceneError(f"{what} has samples that are not finite; leave out instants at which something is missing")
    return values


def _cutoff(cutoff: Number, ts: np.ndarray) -> Number:
    if not is_concrete(cutoff):
        return cutoff
    rate = (len(ts) - 1) / (ts[-1] - ts[0])
    if np.ndim(cutoff) or not 0 < float(cutoff) <= NYQUIST * rate * (1 + 1e-9):
        raise SceneError(
            f"cutoff = {shown(cutoff)} Hz must lie above 0 and at or below half of the sampling rate, {rate:.6g} Hz: "
            "there it smoothes nothing but what two neighboring samples differ by"
        )
    return cutoff
