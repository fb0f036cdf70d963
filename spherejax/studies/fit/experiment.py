"""One experiment as a compiled program: predictions of what was measured and their derivatives, from one integration.

What is compiled is kept for the structure of the scene and the shapes of the data, not for the builder or the numbers:
a second fit of the same structure compiles nothing but the builder.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Flag
from spherejax.model.system import compile_scene, flatten_system, split
from spherejax.motion.derivatives.adjoint import KeptRun, gradients, kept_run
from spherejax.motion.derivatives.sensitivities import integrate_along
from spherejax.motion.derivatives.through_touches import check_derivatives
from spherejax.motion.equations.programs import path_of
from spherejax.motion.integration.integrate import Options, Outcome, Plan
from spherejax.motion.integration.one_run import run_of
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.integration.status import Status, diagnosis
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.many import Build, built
from spherejax.motion.runs.simulate import choice_for, tolerances_of
from spherejax.motion.solvers.automatic import SolverChoice
from spherejax.motion.solvers.root_finder import with_converging_root_finder
from spherejax.motion.start.assembly import Assembly
from spherejax.motion.start.start_now import start_now
from spherejax.motion.start.tolerances import controller_for
from spherejax.program_cache import cached_jit
from spherejax.studies.fit.measured import Measured
from spherejax.studies.fit.observables import Observable, observable
from spherejax.studies.fit.parameters import FitUnknowns


class Frame(NamedTuple):
    """What the predictions of an experiment are compiled for (static).

    Attributes:
        plan: what the run is compiled for.
        observables: what is predicted.
        choice: which method is used, and why.
    """

    plan: Plan
    observables: tuple[Observable, ...]
    choice: str


class Setting(eqx.Module):
    """What the runs of an experiment share.

    Attributes:
        options: how to integrate.
        known: numbers of the system that the unknowns do not touch, with zeros elsewhere.
        ts: the start of the motion, then the sample times [s]; the last may be repeated.
        start: the consistent start, where the unknowns do not move it.
    """

    options: Options
    known: Float[Array, " p"]
    ts: Float[Array, " n+1"]
    start: Assembly | None


class TracedNumbers(NamedTuple):
    """The traced numbers of a system, as they follow from the unknowns.

    Attributes:
        values: the numbers.
        directions: their derivatives by each unknown.
        are_legal: whether the scene's conditions hold.
    """

    values: Float[Array, " p"]
    directions: Float[Array, "k p"]
    are_legal: Flag


class Prediction(NamedTuple):
    """What an experiment should have measured.

    Attributes:
        values: of all observables, components side by side.
        slopes: derivatives by the unknowns, the last axis; of none where they were not asked for.
        status: integer of `Status`.
        t_reached: time reached [s].
        n_steps: steps tried.
    """

    values: Float[Array, "n m"]
    slopes: Float[Array, "n m k"]
    status: Int[Array, ""]
    t_reached: Float[Array, ""]
    n_steps: Int[Array, ""]


class CostAndGradient(NamedTuple):
    """What an experiment adds to a fit's cost.

    Attributes:
        cost: half the sum of squares of weighted residuals; NaN where the run failed.
        gradient: its derivatives by the unknowns.
        diagnosis: why the run failed, or nothing.
    """

    cost: float
    gradient: Float[np.ndarray, " k"]
    diagnosis: str = ""


class Integration(NamedTuple):
    """How the runs of a fit are made.

    Attributes:
        rtol, atol, solver, max_steps: as in `simulate`.
    """

    rtol: float
    atol: float | None
    solver: diffrax.AbstractSolver | None
    max_steps: int


class Experiment(eqx.Module):
    """One experiment, ready to be predicted.

    Attributes:
        frame: what is compiled for (static).
        setting: what the runs share.
        numbers: from unknowns to the numbers of the system (static).
        measured: what was measured (static).
        data: measured values, components side by side, 0 where nothing was measured.
        is_measured: where something was measured.
    """

    frame: Frame = eqx.field(static=True)
    setting: Setting
    numbers: Callable[[Array], TracedNumbers] = eqx.field(static=True)
    measured: Measured = eqx.field(static=True)
    data: Float[np.ndarray, "n m"]
    is_measured: Bool[np.ndarray, "n m"]

    def predict(self, u: Float[Array, " k"]) -> Prediction:
        """Predictions and their derivatives at some unknowns."""
        return self._cut(_predicted_with_slopes(self.frame, self.setting, self.numbers(u)))

    def predict_alone(self, u: Float[Array, " k"]) -> Prediction:
        """Predictions without derivatives."""
        return self._cut(_predicted_alone(self.frame, self.setting, self.numbers(u)))

    def predict_lanes(self, us: Float[Array, "lanes k"]) -> Prediction:
        """As `predict`, for many sets of unknowns side by side."""
        return self._cut(_predicted_in_lanes(self.frame, self.setting, jax.vmap(self.numbers)(us)))

    def cost_and_gradient(self, u: Float[Array, " k"], weights: Float[np.ndarray, "n m"]) -> CostAndGradient:
        """Half the sum of squares of weighted residuals, and its gradient in reverse; computed now."""
        frame, setting, numbers = self.frame, self.setting, self.numbers(u)
        common = frame.plan, setting.options, numbers.values
        run = kept_run(*common, numbers.directions, setting.known, setting.ts, setting.start, numbers.are_legal)
        if int(run.status) != Status.SUCCEEDED:
            why = diagnosis(run.status, run.t_reached, float(setting.ts[-1]))
            return CostAndGradient(np.nan, np.full(u.size, np.nan), why)
        n = setting.ts.size - 1
        data, padded = np.zeros((2, n, self.data.shape[1]))
        data[: len(self.data)], padded[: len(self.data)] = self.data, weights
        cost, (by_values, by_ys) = _cost_and_slopes(frame, setting, numbers.values, run, data, padded)
        along_run, by_start = gradients(*common, setting.known, setting.ts, run, by_ys)
        gradient = numbers.directions @ (by_values + along_run) + run.start_slopes @ by_start
        return CostAndGradient(float(cost), np.asarray(gradient))

    def until(self, t: float) -> "Experiment":
        """The experiment as if it had ended at t [s]; nothing is compiled for it."""
        setting = eqx.tree_at(lambda s: s.ts, self.setting, jnp.minimum(self.setting.ts, t))
        return eqx.tree_at(
            lambda e: (e.setting, e.is_measured), self, (setting, self.is_measured & (self.measured.ts <= t)[:, None])
        )

    def _cut(self, prediction: Prediction) -> Prediction:
        """Without the start of the motion and the repeated samples."""
        n = self.measured.ts.size
        values, slopes = prediction.values[..., 1 : n + 1, :], prediction.slopes[..., 1 : n + 1, :, :]
        return prediction._replace(values=values, slopes=slopes)


def experiment_of(
    build: Build,
    unknowns: FitUnknowns,
    start: dict[str, np.ndarray],
    measured: Measured,
    integration: Integration,
    n_samples: int,
) -> Experiment:
    """Prepare one experiment.

    Args:
        build: from parameters to the scene.
        unknowns: what is fitted.
        start: where the fit begins.
        measured: what was measured.
        integration: how to integrate.
        n_samples: how many samples the program is compiled for; the last is repeated.

    Raises:
        SceneError: for a scene that cannot be simulated at the start, or an unknown observable.
    """
    build = measured.build or build
    example = compile_scene(built(build, start)).system
    observables = tuple(observable(name, example, measured.functions) for name in measured.values)
    track_work = any(each.needs_work for each in observables)
    times = np.concatenate([[measured.t0], measured.ts, np.full(n_samples - measured.ts.size, measured.ts[-1])])
    reach = _reach(build, unknowns, start, track_work, integration, times)
    plan, choice = reach.plan, reach.choice
    if not plan.unknown:
        raise SceneError(
            f"the scene does not depend on {', '.join(repr(part.name) for part in unknowns.parts)}: nothing to fit"
        )
    if track_work:
        example = compile_scene(built(build, start), track_work=True).system
    tolerances = tolerances_of(example, choice.solver, integration.rtol, integration.atol)
    controller = controller_for(plan.structure, tolerances.rtol, tolerances.atol)
    solver = with_converging_root_finder(choice.solver, integration.rtol)
    options = Options(solver, controller, diffrax.ForwardMode(), integration.max_steps)
    setting = Setting(options, jnp.asarray(reach.known), jnp.asarray(times), reach.start)
    data = np.concatenate([value.reshape(measured.ts.size, -1) for value in measured.values.values()], 1)
    frame = Frame(plan, observables, choice.reason)
    numbers = _numbers_for(build, unknowns, track_work, plan.unknown)
    made = Experiment(frame, setting, numbers, measured, np.nan_to_num(data), ~np.isnan(data))
    _check_shapes(made)
    return made


class _Reach(NamedTuple):
    """How far the unknowns reach into the system.

    Attributes:
        plan: with the numbers that depend on them.
        known: the other numbers, with zeros for these.
        choice: which method is used, and why.
        start: the consistent start, where it does not depend on them.
    """

    plan: Plan
    known: np.ndarray
    choice: SolverChoice
    start: Assembly | None


def _reach(build: Build, unknowns: FitUnknowns, start, track_work: bool, integration: Integration, times) -> _Reach:
    """Trace the builder without staging it: what does not depend on the unknowns stays known."""
    found: list[_Reach] = []

    def traced(u):
        system = compile_scene(built(build, unknowns.values_of(u)), track_work=track_work).system
        structure, _ = flatten_system(system)
        known, unknown = split(system)
        path = path_of(structure)
        choice = choice_for(system, integration.rtol, integration.solver, explicit_only=path.scalar is False)
        check_derivatives(system, choice.solver)
        plan = Plan(structure, unknown, path.scalar)
        found.append(_Reach(plan, np.asarray(known), choice, start_now(system, times)))
        return u

    u0 = jnp.asarray(unknowns.unknowns_of(start))
    jax.jvp(traced, (u0,), (jnp.ones_like(u0),))
    return found[0]


@lru_cache(maxsize=64)
def _numbers_for(build: Build, unknowns: FitUnknowns, track_work: bool, unknown: tuple[int, ...]):
    """The traced numbers of a builder's system and their derivatives, compiled; kept for fits to come."""

    def numbers(u):
        compiled = compile_scene(built(build, unknowns.values_of(u)), track_work=track_work)
        values = jnp.asarray(flatten_system(compiled.system)[1])[np.array(unknown, int)]
        return values, (values, jnp.all(jnp.stack([jnp.array(True), *compiled.conditions])))

    @jax.jit
    def with_directions(u):
        slopes, (values, legal) = jax.jacfwd(numbers, has_aux=True)(u)
        finite = jnp.all(jnp.isfinite(values)) & jnp.all(jnp.isfinite(slopes))
        return TracedNumbers(values, slopes.T, legal & finite)

    return with_directions


# The programs -------------------------------------------------------------------------------------------------------


def _with_slopes(frame: Frame, setting: Setting, numbers: TracedNumbers) -> Prediction:
    found = integrate_along(
        frame.plan, setting.options, numbers.values, numbers.directions, setting.known, setting.ts, setting.start,
        numbers.are_legal,
    )  # fmt: skip

    def predictions(values, ys):
        return _observed(frame, setting, values, ys, found.assembly)

    def along(direction, slope):
        return jax.jvp(predictions, (numbers.values, found.ys), (direction, slope))

    values, slopes = jax.vmap(along, out_axes=(None, -1))(numbers.directions, found.slopes)
    return Prediction(values, slopes, found.status, found.t_reached, found.n_steps)


def _observed(frame: Frame, setting: Setting, values, ys, assembly) -> Float[Array, "n m"]:
    """All observables of a run, components side by side."""
    run = _run_of(frame, setting, values, ys, assembly)
    return jnp.concatenate([each.of(run) for each in frame.observables], 1)


def _run_of(frame: Frame, setting: Setting, values, ys, assembly) -> Trajectory:
    """A run as observables see it."""
    theta = frame.plan.theta(values, setting.known)
    nothing = jnp.zeros((), jnp.int64)
    return Trajectory(
        ts=setting.ts,
        ys=ys,
        system=frame.plan.structure.system(theta),
        stats=Statistics(nothing, nothing, nothing, nothing, jnp.zeros(0, jnp.int64), jnp.zeros(4)),
        ended=nothing,
        t_reached=setting.ts[-1],
        y_reached=ys[-1],
        assembly=assembly,
        choice=frame.choice,
        scalar=frame.plan.scalar,
    )


_predicted_with_slopes = cached_jit(_with_slopes, what="the predictions of a fit")


@cached_jit(what="the predictions of a fit")
def _predicted_in_lanes(frame: Frame, setting: Setting, numbers: TracedNumbers) -> Prediction:
    return jax.vmap(lambda each: _with_slopes(frame, setting, each))(numbers)


@cached_jit(what="a prediction of a fit")
def _predicted_alone(frame: Frame, setting: Setting, numbers: TracedNumbers) -> Prediction:
    outcome: Outcome = run_of(
        frame.plan, setting.options, numbers.values, setting.known, setting.ts, setting.start, numbers.are_legal
    )
    values = _observed(frame, setting, numbers.values, outcome.ys, outcome.assembly)
    none = jnp.zeros((*values.shape, 0))
    return Prediction(values, none, outcome.status, outcome.t_reached, outcome.stats.n_steps)


@cached_jit(what="the gradient of a fit")
def _cost_and_slopes(frame: Frame, setting: Setting, values, run: KeptRun, data, weights):
    """Half the sum of squares of a run, and its derivatives by the traced numbers and by the sampled states."""

    def cost(values, ys):
        errors = (_observed(frame, setting, values, ys, run.assembly)[1:] - data) * weights
        return jnp.sum(jnp.where(weights > 0, errors, 0.0) ** 2) / 2

    return jax.value_and_grad(cost, (0, 1))(values, run.ys)


def _check_shapes(made: Experiment) -> None:
    """Compare the shapes of measurements with those of predictions, without computing anything."""
    plan, setting = made.frame.plan, made.setting

    def shapes_of(values):
        size = plan.structure.system(plan.theta(values, setting.known)).layout.size
        run = _run_of(made.frame, setting, values, jnp.zeros((setting.ts.shape[0], size)), None)
        return [each.of(run) for each in made.frame.observables]

    shapes = jax.eval_shape(shapes_of, jnp.zeros(len(plan.unknown)))
    for each, shape in zip(made.frame.observables, shapes, strict=True):
        given = made.measured.values[each.name]
        columns = given.reshape(given.shape[0], -1).shape[1]
        if columns != shape.shape[1]:
            raise SceneError(
                f"measured {each.name!r} has {columns} component{'s' * (columns != 1)}, and {shape.shape[1]} are "
                f"predicted; name a component, e.g. '{each.name}.z', or give an array of shape (n, {shape.shape[1]})"
            )
