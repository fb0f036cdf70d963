"""How far a whole run is from the exact motion: estimated from a companion run at a tighter tolerance.

`rtol` bounds the error of a step. What becomes of it by the end depends on the motion: it fades where there is damping,
adds up in a pendulum, and is multiplied at each impact without friction. The estimate is the difference of the run and
a companion: the same scene from the same start by the same method, at a hundredth of the tolerance.

`benchmarks/global_error.py` compares the choices on ten scenes with references at 1e-13: 143 runs at tolerances from
1e-4 to 1e-11. The largest estimate was, as a share of the largest error, with a companion at

    a third of the tolerance     0 to 47, within a factor of three in 91 %, for 1.1 times the steps of the run
    a tenth                      0 to 1.7, in 97 %, for 1.3 times
    a hundredth                  0.53 to 1.4, in all, for 1.7 times
    a thousandth                 0.96 to 1.2, in all, for 2.2 times
    a hundredth, another method  0.06 to 22, in 95 %, for 2.1 times, and another program to compile

Forward sensitivities would cost more: a motion and its derivative by one number take about four plain runs, and the
errors of all steps need one for each entry of the state.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d

from spherejax.foundations.checks import is_concrete, is_tracing
from spherejax.foundations.errors import SceneError
from spherejax.model.system import System, flatten_by_factor
from spherejax.motion.equations.quantities import quantity
from spherejax.motion.integration.one_run import run_of
from spherejax.motion.integration.problem import Plan, RunInputs, RunMethod
from spherejax.motion.integration.status import Status
from spherejax.motion.results.accuracy import POSITIONS
from spherejax.motion.settings import RunSettings
from spherejax.motion.solvers.dop853 import Dop853
from spherejax.motion.solvers.rosenbrock import Rodas4P, Rodas5P
from spherejax.motion.start.tolerances import length_scale, rounding_floor, tolerances_of

TIGHTER = 100.0
"""A companion's tolerance is this many times tighter; see the table above."""

AT_ROUNDING = math.sqrt(10.0)
"""Where a run's tolerance is at its rounding floor already, the companion's is this many times *looser*. Errors in
proportion to the tolerance then differ by 2.2 of the run's error, independent errors of rounding by 1.4 of it."""

OTHER_STEPS = 1.05
"""A companion with less than 5 % more steps was not made by its tolerance: the longest step or stability set its steps,
and it may share the run's errors. It is made again at a still tighter tolerance, and by another method at the last."""

ROOM = 50
"""A companion may make this many times the steps of the run. Order 8 takes 1.8 times the steps for a hundredth of the
tolerance, Rodas5P 2.5 times, order 3 ten times."""

SHARE_OF_CLEARANCE, SHARE_OF_LENGTH = 1e-2, 1e-3
"""What `determined_until` asks of positions where nothing else is asked: a hundredth of the smallest clearance, or a
thousandth of the mechanism's length where there is none."""

Repeat = Callable[[float], Any]
"""Makes a run, a `Trajectory`, at a relative tolerance."""

REFINED = 200
"""`determined_until` is told to this share of the motion, also where samples are coarser."""

SHARE_OF_NEIGHBORS, NEIGHBORS = 0.1, 40
"""An error that passes through zero is known there to the error of the companion only. So no estimate is below a tenth
of the largest within n / 40 of n samples on either side: with it no sample of the ten scenes has an error above ten
times its estimate, in 310 histories at tolerances from 1e-4 to 3e-11, and without it 29 histories have some."""

SAME_START = 1e-9
"""A repeated run starts where the run did, to this share of each entry of the state, or it is of another motion."""


class AccuracyWarning(UserWarning):
    """The error of a run is known in part only; the message says until when, and why."""


def repeated(run: Any, rtol: float, *, solver: diffrax.AbstractSolver | None = None, ts=None) -> Any:
    """The same motion from the same start at another tolerance, as a `Trajectory`.

    Args:
        run: a `Trajectory`, a single run of numbers.
        rtol: relative tolerance of a step; an absolute one that was asked for is scaled alike.

    Other args:
        solver: another method; that of the run when None.
        ts: sample times [s] from the start on; those of the run that it reached when None.

    Raises:
        SceneError: for a run that cannot be repeated.
    """
    settings = repeatable(run)
    method: Any = settings.solver if solver is None else solver
    atol = None if settings.atol is None else settings.atol * rtol / settings.rtol
    structure, theta = flatten_by_factor(run.system)
    tolerances = tolerances_of(run.system, rtol, atol)
    max_steps = min(max(settings.max_steps, 1000 + ROOM * int(run.stats.n_steps)), int(np.iinfo(np.int64).max))
    how = RunMethod.by_tolerances(structure, method, tolerances, rtol, max_steps)
    times = _reached(run) if ts is None else np.asarray(ts, np.float64)
    plan = Plan(structure, (), run.scalar)
    theta = np.asarray(theta, np.float64)
    inputs = RunInputs(np.zeros(0), theta, jnp.asarray(times), run.assembly, np.array(True))
    outcome = run_of(plan, how, inputs)
    return replace(
        run,
        ts=jnp.asarray(times),
        ys=outcome.ys,
        stats=replace(outcome.stats, explanation=tolerances.description),
        ended=outcome.status,
        t_reached=outcome.t_reached,
        y_reached=outcome.y_reached,
        settings=settings.replaced(solver=method, rtol=rtol, atol=atol, max_steps=max_steps),
        accuracy=None,
    )


def repeatable(run: Any) -> RunSettings:
    """How the run was asked for; `SceneError` where it cannot be made once more."""
    if is_tracing() or not (is_concrete(run.ys) and is_concrete(run.ended)):
        raise SceneError(
            "the error of a run is estimated by runs at other tolerances, which a trace cannot make: ask outside of "
            "jit, vmap and grad, of the run that they return"
        )
    if np.ndim(run.ended):
        raise SceneError(
            "the error is estimated of a single run; take one lane of the batch first, e.g. "
            "jax.tree.map(lambda leaf: leaf[0], runs)"
        )
    if run.settings is None:
        raise SceneError(
            "the error of this run cannot be estimated: its tolerances were traced, or a step-size controller of its "
            "own judged its steps. Simulate it once more with rtol= as a number and without stepsize_controller="
        )
    if len(run.ts) < 2:
        raise SceneError("a run of one instant has no error to estimate; give ts an end")
    return run.settings


def _reached(run: Any) -> np.ndarray:
    """The sample times that a run has reached, and one more where that is the start alone."""
    ts, reached = np.asarray(run.ts, np.float64), float(run.t_reached)
    there = ts[ts <= reached]
    return there if len(there) > 1 else np.array([ts[0], max(reached, np.nextafter(ts[0], np.inf))])


def floor_of(system: System) -> float:
    """The relative tolerance below which a run follows rounding."""
    return float(np.asarray(rounding_floor(system)))


def companion_of(run: Any) -> Any:
    """The run that another one is compared with; see the module's docstring."""
    rtol = repeatable(run).rtol
    return companion_by(run, rtol, lambda tighter: repeated(run, tighter), lambda same: _by_other_method(run, same))


def companion_by(run: Any, rtol: float, repeat: Repeat, by_other_method: Repeat) -> Any:
    """The same with runs by other means than `repeated`: a study has programs of its own.

    Args:
        run: the `Trajectory` whose error is estimated.
        rtol: its relative tolerance.
        repeat: the same motion at another tolerance.
        by_other_method: the same motion by another method, at a given tolerance; None where there is none.
    """
    # Tolerances of diffrax's own implicit methods are not lifted to the floor, and below it they follow rounding, too.
    floor = floor_of(run.system)
    rtol, n_steps = max(rtol, floor), int(run.stats.n_steps)
    if rtol < AT_ROUNDING * floor:
        found = repeat(AT_ROUNDING * rtol)
        return found if OTHER_STEPS * int(found.stats.n_steps) <= n_steps else by_other_method(rtol) or found
    found, tighter = None, rtol
    while tighter > floor:
        tighter = max(tighter / TIGHTER, floor)
        made = repeat(tighter)
        if int(made.ended) != Status.SUCCEEDED:
            return repeat(rtol / AT_ROUNDING**2) if found is None else found
        found = made
        if int(made.stats.n_steps) >= OTHER_STEPS * n_steps:
            return made
    return by_other_method(max(rtol / TIGHTER, floor)) or found


def _by_other_method(run: Any, rtol: float) -> Any:
    """The same at the same tolerance by a method with other errors; None where there is none."""
    solver: Any = run.settings.solver
    if isinstance(solver, Dop853):
        other: Any = diffrax.Dopri8()
    elif isinstance(solver, Rodas5P):
        other = Rodas4P()
    elif isinstance(solver, Rodas4P):
        other = Rodas5P()
    elif isinstance(solver, diffrax.Dopri8 | diffrax.Tsit5 | diffrax.Dopri5 | diffrax.Bosh3):
        other = Dop853()
    else:
        return None
    found = repeated(run, rtol, solver=other)
    return found if int(found.ended) == Status.SUCCEEDED else None


@dataclass(frozen=True, eq=False)
class GlobalError:
    """What is known of the error of a run; prints as a sentence with what it cost.

    Attributes:
        run: the run.
        companion: what it is compared with, sampled at the same times as far as the run came.
    """

    run: Any
    companion: Any

    @classmethod
    def of_run(cls, run: Any) -> "GlobalError":
        """By a companion that is made now.

        Raises:
            SceneError: for a run that cannot be repeated.
        """
        companion = companion_of(run)
        first, again = np.asarray(run.ys)[0], np.asarray(companion.ys)[0]
        n = run.system.layout.n_bodies * 13  # memory begins where the ball is found
        if not np.allclose(first[:n], again[:n], rtol=SAME_START, atol=SAME_START):
            raise SceneError(
                "the error of this run cannot be estimated: repeated, it starts elsewhere. Its first sample must be "
                "its start; simulate the scene once more"
            )
        if int(companion.ended) != Status.SUCCEEDED:
            warnings.warn(
                f"the error of the run is known until t = {float(companion.t_reached):.6g} s only; the run at rtol "
                f"{companion.settings.rtol:.0e} that it is compared with {companion.diagnosis}",
                AccuracyWarning,
                stacklevel=4,
            )
        return cls(run, companion)

    def __str__(self) -> str:
        mine, other = self.run, self.companion
        share = int(other.stats.n_steps) / max(1, int(mine.stats.n_steps))
        largest = float(np.nanmax(self.positions, initial=0.0))
        return (
            f"estimated error of positions up to {largest:.1e} m, by comparison with "
            f"{type(other.settings.solver).__name__} at rtol {other.settings.rtol:.0e}, which took {share:.1f} times "
            f"the steps of the run"
        )

    def of(self, name: str) -> np.ndarray:
        """Estimated error of a quantity at the samples, in its unit and of its shape; NaN where nothing is known.

        Args:
            name: a quantity as `sj.sweep` records it, e.g. "position.rocker", "reaction.elbow.x", "kinetic_energy".
        """
        what = quantity(name, self.run.system)
        return self._estimate(np.asarray(what.of(self.run)), np.asarray(what.of(self.companion)))

    def size_of(self, name: str) -> Float[np.ndarray, " n"]:
        """As `of`, one number a sample: the norm of a vector's error; of `POSITIONS` the largest of all bodies [m]."""
        if name == POSITIONS:
            return np.max(self.positions, axis=1, initial=0.0)
        error = self.of(name)
        return np.sqrt(np.sum(error**2, axis=tuple(range(1, error.ndim)))) if error.ndim > 1 else error

    @cached_property
    def positions(self) -> Float[np.ndarray, "n n_bodies"]:
        """Estimated error of each body's position [m]: of its center, and of any point where a joint holds it.

        It is the distance of the centers, and the angle between the orientations times the distance of the farthest
        joint from the center (the radius of gyration where no joint holds the body).
        """
        run, apart = self.run, self._apart
        n = len(run.ts)
        full = np.full((n, apart.shape[1]), np.nan)
        full[: len(apart)] = apart
        return self._held(full)

    @cached_property
    def _apart(self) -> Float[np.ndarray, "m n_bodies"]:
        """How far the bodies of the two runs are apart at the samples of the companion."""
        return bodies_apart(self.run.system, self.run.state, self.companion.state)

    @cached_property
    def _lost(self) -> int:
        """The first sample at which positions are not determined; their number where all are."""
        limit = usual_limit(self.run.system)
        far = np.flatnonzero(np.max(self._apart, axis=1, initial=0.0) > limit)
        return int(far[0]) if far.size else len(self.run.ts)

    def _estimate(self, mine: np.ndarray, other: np.ndarray) -> np.ndarray:
        error = np.full(mine.shape, np.nan)
        m = min(len(other), len(mine))
        error[:m] = np.abs(mine[:m] - other[:m])
        return self._held(error)

    def _held(self, error: np.ndarray) -> np.ndarray:
        """The estimate from the differences: no less than a share of those around, and from where the motion is lost on
        the largest so far.

        Two motions that have parted cross each other now and then; the error of one is not small there.
        """
        first = np.array(error[0])  # the start is the same
        near = max(3, len(error) // NEIGHBORS)
        around = maximum_filter1d(np.nan_to_num(error), 2 * near + 1, axis=0, mode="nearest")
        error = np.where(np.isnan(error), error, np.maximum(error, SHARE_OF_NEIGHBORS * around))
        error[0] = first
        largest = np.fmax.accumulate(error, axis=0)
        late = np.arange(len(error)) >= self._lost
        late = late.reshape(-1, *[1] * (error.ndim - 1)) & np.isfinite(error)
        return np.where(late, largest, error)

    def first_beyond(self, limits: tuple[tuple[str, float], ...]) -> int:
        """The first sample at which an estimate is above its limit, or not known; their number where all hold."""
        holds = np.ones(len(self.run.ts), bool)
        for name, limit in limits:
            holds &= self.size_of(name) <= limit
        return len(holds) if holds.all() else int(np.argmin(holds))

    def until(self, limits: tuple[tuple[str, float], ...]) -> float:
        """The time [s] until which the estimates are within their limits.

        Between samples that are far apart both runs are made once more, up to the first that is beyond.
        """
        ts = np.asarray(self.run.ts)
        at = self.first_beyond(limits)
        if at == 0:
            return float(ts[0])
        if at == len(ts):
            return float(ts[-1])
        begin, end = ts[at - 1], ts[at]
        is_known = at < len(np.asarray(self.companion.ts))
        if not is_known or end - begin <= (ts[-1] - ts[0]) / REFINED:
            return float(begin)
        n = math.ceil(REFINED * (end - begin) / (ts[-1] - ts[0]))
        finer = np.concatenate([ts[:at], np.linspace(begin, end, n + 1)[1:]])
        rtol = self.run.settings.rtol
        mine = repeated(self.run, rtol, ts=finer)
        other = repeated(self.companion, self.companion.settings.rtol, ts=finer)
        closer = GlobalError(mine, other).first_beyond(limits)
        return float(finer[max(closer, at) - 1])


def usual_limit(system: System) -> float:
    """What is asked of positions where nothing else is [m]; see `SHARE_OF_CLEARANCE`."""
    models: list[Any] = [getattr(joint, "model", None) for joint in system.joints.values()]
    gaps = [float(model.clearance) for model in models if getattr(model, "has_surfaces", False)]
    return min([SHARE_OF_LENGTH * float(length_scale(system)), *(SHARE_OF_CLEARANCE * gap for gap in gaps)])


def bodies_apart(system: System, mine: Any, other: Any) -> Float[np.ndarray, "m n_bodies"]:
    """How far bodies in two states are apart [m], with what their orientations move at their joints.

    Args:
        system: of both.
        mine, other: states at samples; as many as the second has.
    """
    m = len(np.asarray(other.position))
    apart = np.linalg.norm(np.asarray(mine.position)[:m] - np.asarray(other.position), axis=-1)
    first, second = (np.asarray(each)[:m] for each in (mine.quaternion, other.quaternion))
    # Of two unit quaternions the shorter of q - p and q + p: both signs are the same orientation.
    chord = np.minimum(np.linalg.norm(first - second, axis=-1), np.linalg.norm(first + second, axis=-1))
    return apart + 2 * chord * _levers(system)


def _levers(system: System) -> Float[np.ndarray, " n_bodies"]:
    """How far from its center a joint holds each body [m]; its radius of gyration where none does."""
    far = dict.fromkeys(system.bodies, 0.0)
    for joint in system.joints.values():
        for name, place in zip(joint.bodies, joint.points, strict=False):
            if name in far:
                far[name] = max(far[name], float(np.linalg.norm(np.asarray(place))))
    for name, body in system.bodies.items():
        if not far[name]:
            far[name] = math.sqrt(float(np.max(np.abs(np.asarray(body.inertia)))) / float(body.mass))
    return np.array(list(far.values()))
