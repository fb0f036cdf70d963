"""The measures of a design and their derivatives, as functions of scaled unknowns."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.integration.status import Status, diagnosis
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.simulate import checked_times, simulate
from spherejax.motion.settings import RunSettings
from spherejax.runtime import require_float64
from spherejax.studies.design.measures import Function, Measure, measure
from spherejax.studies.fit.parameters import FitUnknowns, unknowns_from

Build = Callable[..., Scene]
"""Makes a scene from the parameters, by keyword."""


class Measures(NamedTuple):
    """Measures of one design.

    Attributes:
        u: the scaled unknowns.
        smooth: what gradients are taken of.
        true: what they stand for.
        slopes: derivatives of `smooth` by u.
        diagnosis: why the run failed; empty after success.
    """

    u: Float[np.ndarray, " k"]
    smooth: Float[np.ndarray, " m"]
    true: Float[np.ndarray, " m"]
    slopes: Float[np.ndarray, "m k"]
    diagnosis: str

    @property
    def succeeded(self) -> bool:
        """Whether the run reached its end, and all is finite."""
        return not self.diagnosis


class DesignProblem:
    """Measures of a run as functions of scaled unknowns u: u = log p for positive numbers, u = p / scale for others.

    Attributes:
        unknowns: the parameters, and how u stands for them.
        start: where the search begins, by name.
        bounds: of u, shape (k, 2); infinite where there is none.
        measures: what is measured.
        ts: sample times [s].
        remembered: evaluations by the bytes of u and the sharpness.
        n_evaluations: runs with derivatives so far.
    """

    def __init__(
        self,
        build: Build,
        start: Mapping[str, Any],
        ts: Float[Array, " n"],
        names: Sequence[str],
        functions: Mapping[str, Function],
        *,
        rtol: float,
        atol: float | None,
        solver: diffrax.AbstractSolver | None,
        max_steps: int,
    ):
        require_float64()
        max_steps = RunSettings(rtol, atol, max_steps=max_steps).checked().max_steps
        self.build, self.ts = build, checked_times(ts)
        given, self.start = unknowns_from(start)
        self.bounds = _scaled_bounds(given)
        self.unknowns = _without_bounds(given)
        example = build(**{name: jnp.asarray(value) for name, value in self.start.items()})
        system = compile_scene(example, track_work=True).system
        self.measures: tuple[Measure, ...] = tuple(measure(name, system, functions) for name in names)
        needs_work = any(each.needs_work for each in self.measures)
        self._options = {
            "rtol": rtol, "atol": atol, "solver": solver, "max_steps": max_steps, "track_work": needs_work
        }  # fmt: skip
        self._derivatives = jax.jit(jax.jacfwd(self._measured, has_aux=True))
        self.remembered: dict[tuple[bytes, float], Measures] = {}
        self.n_evaluations = 0

    @property
    def u0(self) -> Float[np.ndarray, " k"]:
        """Where the search begins."""
        return self.unknowns.unknowns_of(self.start)

    def run(self, values: Mapping[str, Any]) -> Trajectory:
        """The motion of one design."""
        return simulate(self.build(**values), self.ts, **self._options)

    def values_of(self, u: Float[np.ndarray, " k"]) -> dict[str, Any]:
        """Parameters by name."""
        values = {name: np.asarray(value) for name, value in self.unknowns.values_of(jnp.asarray(u)).items()}
        return {name: value.item() if value.ndim == 0 else value for name, value in values.items()}

    def evaluate(self, u: Float[np.ndarray, " k"], sharpness: float) -> Measures:
        """Measures and derivatives; remembered, for a method asks for values and slopes separately."""
        key = np.asarray(u, np.float64).tobytes(), float(sharpness)
        if key not in self.remembered:
            self.remembered[key] = self._evaluated(np.array(u, np.float64), sharpness)
        return self.remembered[key]

    def _evaluated(self, u, sharpness: float) -> Measures:
        slopes, (smooth, true, status, t_reached) = self._derivatives(jnp.asarray(u), jnp.asarray(sharpness))
        self.n_evaluations += 1
        why = ""
        if int(status) != Status.SUCCEEDED:
            why = diagnosis(status, t_reached, float(self.ts[-1]))
        elif not (np.all(np.isfinite(slopes)) and np.all(np.isfinite(smooth))):
            why = "a measure or its derivative is not finite"
        return Measures(u, np.asarray(smooth), np.asarray(true), np.asarray(slopes), why)

    def _measured(self, u, sharpness):
        run = simulate(self.build(**self.unknowns.values_of(u)), self.ts, **self._options)
        found = [each.of(run, sharpness) for each in self.measures]
        smooth, true = (jnp.stack(values) for values in zip(*found, strict=True))
        return smooth, (smooth, true, run.status, run.t_reached)


def _without_bounds(unknowns: FitUnknowns) -> FitUnknowns:
    """The same numbers by their logarithms where they are positive, and in their scales elsewhere.

    A fit maps an interval to all numbers. The best design often lies on a bound, which such a map never reaches.
    """
    parts = [replace(p, lower=0.0 if p.is_relative else -np.inf, upper=np.inf) for p in unknowns.parts]
    return FitUnknowns(tuple(parts))


def _scaled_bounds(unknowns: FitUnknowns) -> Float[np.ndarray, "k 2"]:
    rows = []
    for part in unknowns.parts:
        bounds = np.array([part.lower, part.upper])
        with np.errstate(divide="ignore"):
            scaled = np.log(bounds) if part.is_relative else bounds / part.scale
        rows += [scaled] * part.size
    return np.array(rows)


def checked_limits(limits: Mapping[str, Any] | None) -> dict[str, tuple[float, float]]:
    """Limits as pairs (lower, upper).

    Raises:
        SceneError: for a limit that is no number or an empty interval.
    """
    found = {}
    for name, given in (limits or {}).items():
        pair = given if isinstance(given, tuple) else (-np.inf, given)
        try:
            low, high = (float(value) for value in pair)
        except (TypeError, ValueError) as error:
            raise SceneError(
                f"limits[{name!r}] must be the largest value allowed, or a pair (lower, upper); it is {given!r}"
            ) from error
        if not low < high or (np.isinf(low) and np.isinf(high)):
            raise SceneError(
                f"limits[{name!r}]: lower = {low:.6g} must be below upper = {high:.6g}, one of them finite"
            )
        found[name] = (low, high)
    return found
