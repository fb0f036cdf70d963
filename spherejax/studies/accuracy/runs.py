"""Compiled runs of one scene by one solver, for any tolerance, within a budget."""

import math
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.results.global_error import companion_by
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.simulate import simulate
from spherejax.motion.settings import NO_LIMIT
from spherejax.studies.accuracy.solvers import SolverOf, made

PROBE_STEPS = 400
"""Steps of a first run, from which the time of a step is learned."""

BURST_SECONDS, LONGEST_BURST = 0.02, 9
"""A repeat of a short run is a burst of runs of about this length [s], nine at most: a run of a millisecond is at the
mercy of whatever the machine does in it."""


class RunEnding(NamedTuple):
    """How a run ended: what a timed run returns, for every further array costs microseconds.

    Attributes:
        y: flat state at the end.
        stats: counts.
        status: integer of `Status`.
        t_reached: time reached [s].
    """

    y: Float[Array, " size"]
    stats: Statistics
    status: Array
    t_reached: Array


class TimedProgram:
    """One scene and one solver, compiled once; the tolerance and the budget are arguments.

    A program that measures returns the `Trajectory`, and integrates the absorbed work besides. That takes no part in
    the judgment of errors, so that the steps are those of a run without it. One that does not returns the `RunEnding`.

    Args:
        scene: the scene.
        solver: a diffrax solver, or a function from the tolerances to one.
        ts: sample times [s].
        atol_ratio: absolute tolerance as a share of the relative one.
        measures: see above.
    """

    def __init__(
        self,
        scene: Scene,
        solver: diffrax.AbstractSolver | SolverOf,
        ts: Float[Array, " n"],
        *,
        atol_ratio: float,
        measures: bool,
    ):
        self.seconds_a_step = 0.0
        system = compile_scene(scene).system

        def run(rtol, n_steps):
            atol = atol_ratio * rtol
            motion = simulate(
                scene,
                ts,
                rtol=rtol,
                atol=atol,
                solver=made(solver, rtol, atol),
                max_steps=n_steps,
                track_work=measures and bool(system.resisting_joints),
            )
            return motion if measures else RunEnding(motion.ys[-1], motion.stats, motion.status, motion.t_reached)

        begin = time.perf_counter()
        self._compiled = jax.jit(run).lower(*_arguments(1e-3, 1)).compile()
        self.compile_seconds = time.perf_counter() - begin

    def run(self, rtol: float, n_steps: int = NO_LIMIT) -> Any:
        """The `Trajectory` or `RunEnding` of a run, finished when this returns."""
        return self.call(_arguments(rtol, n_steps))

    def companion(self, run: Trajectory, rtol: float, seconds: float, known: Mapping[float, Trajectory]) -> Trajectory:
        """The run that `run.error` would compare a run of this program with; see `motion/results/global_error.py`.

        Args:
            run: a run of this program.
            rtol: its tolerance.
            seconds: budget of a run that must be made [s].
            known: runs that have been made already, by tolerance.
        """

        def repeat(tighter: float) -> Trajectory:
            made = [one for at, one in known.items() if math.isclose(at, tighter, rel_tol=1e-6)]
            return made[0] if made else self.run(tighter, self.budget(tighter, seconds))

        return companion_by(run, rtol, repeat, by_other_method=lambda same: None)

    def call(self, arguments) -> Any:
        """As `run`, for arguments that are made already."""
        return jax.block_until_ready(self._compiled(*arguments))

    def budget(self, rtol: float, seconds: float) -> int:
        """About how many steps can be made in a time [s], from a short run."""
        if not self.seconds_a_step:
            self.run(rtol, 1)
            begin = time.perf_counter()
            run = self.run(rtol, PROBE_STEPS)
            self.seconds_a_step = (time.perf_counter() - begin) / max(1, int(run.stats.n_steps))
        return max(1, int(seconds / self.seconds_a_step))


class TimedTrial:
    """A run that is timed again and again.

    Args:
        program: that of the run.
        rtol: its tolerance.
        max_seconds: budget of a run, and of all timed runs together [s].
    """

    def __init__(self, program: TimedProgram, rtol: float, max_seconds: float):
        self.program, self.max_seconds = program, max_seconds
        self.arguments = _arguments(rtol, program.budget(rtol, max_seconds))
        self.times: list[float] = []
        self.end, self.first = self._timed()

    def _timed(self) -> tuple[RunEnding, float]:
        begin = time.perf_counter()
        end = self.program.call(self.arguments)
        return end, time.perf_counter() - begin

    def repeat(self) -> None:
        """Time the run once more, unless the budget is spent; of a short run, the median of a burst counts."""
        if (len(self.times) + 2) * self.first <= self.max_seconds:
            n_calls = min(max(1, int(BURST_SECONDS / self.first)), LONGEST_BURST)
            self.times.append(float(np.median([self._timed()[1] for _ in range(n_calls)])))

    @property
    def n_repeats(self) -> int:
        """How many runs count."""
        return len(self.times) or 1

    @property
    def seconds(self) -> float:
        """The median of the repeats [s]; the first run counts only where there was no time for another."""
        return float(np.median(self.times or [self.first]))


def _arguments(rtol: float, n_steps: int):
    return jnp.asarray(rtol, jnp.float64), jnp.asarray(n_steps, jnp.int64)
