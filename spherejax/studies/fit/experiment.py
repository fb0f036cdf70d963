"""One experiment as a compiled program: predictions of what was measured and their derivatives, from one integration.

What is compiled is kept for the structure of the scene and the shapes of the data, not for the builder or the numbers:
a second fit of the same structure compiles nothing but the builder.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Flag
from spherejax.model.system import compile_scene, flatten_system, split
from spherejax.motion.derivatives.pullback import gradient_of
from spherejax.motion.derivatives.through_touches import check_derivatives
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import path_of, program_for
from spherejax.motion.integration.one_run import RunAndSlopes, run_and_slopes, run_of
from spherejax.motion.integration.problem import Outcome, Plan, RunInputs, RunMethod
from spherejax.motion.integration.statistics import Statistics
from spherejax.motion.integration.status import Status, diagnosis
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.many import Build, built
from spherejax.motion.runs.simulate import choice_for
from spherejax.motion.settings import RunSettings
from spherejax.motion.solvers.automatic import SolverChoice
from spherejax.motion.start.assembly import Assembly
from spherejax.motion.start.start_now import start_now
from spherejax.program_cache import cached_jit
from spherejax.studies.fit.arguments import Arguments, OwnBuild, arguments_of
from spherejax.studies.fit.losses import Loss
from spherejax.studies.fit.measured import Measured
from spherejax.studies.fit.observables import Observable, observable
from spherejax.studies.fit.parameters import FitUnknowns
from spherejax.studies.fit.sensing import (
    Samples,
    Sensing,
    SensorNumbers,
    channels_of,
    filter_errors,
    is_filtered,
    readings,
    samples_for,
)


class Frame(NamedTuple):
    """What the predictions of an experiment are compiled for (static).

    Attributes:
        plan: what the run is compiled for.
        observables: what is predicted, in the order of the channels.
        choice: which method is used, and why.
        n_unknowns: count of what is fitted.
        moved: places of the unknowns on which the scene depends; None: all.
        sensing: how channels are read; None where all show their observables as they are.
    """

    plan: Plan
    observables: tuple[Observable, ...]
    choice: str
    n_unknowns: int
    moved: tuple[int, ...] | None = None
    sensing: Sensing | None = None


class Setting(eqx.Module):
    """What the runs of an experiment share.

    Attributes:
        method: how to integrate.
        known: numbers of the system that the unknowns do not touch, with zeros elsewhere.
        ts: the start of the motion, then the instants of the record [s]; the last may be repeated.
        start: the consistent start, where the unknowns do not move it.
    """

    method: RunMethod
    known: Float[Array, " p"]
    ts: Float[Array, " n+1"]
    start: Assembly | None


class TracedNumbers(NamedTuple):
    """The traced numbers of a system, and those of its sensors, as they follow from the k unknowns.

    Attributes:
        values: the numbers of the system.
        directions: their derivatives by each unknown that moves them.
        are_legal: whether the scene's conditions, and those of the sensors, hold.
        of_sensors: the numbers of the sensors; None without: arrays of nothing, in lanes, end XLA's compiler.
        sensor_directions: their derivatives by each unknown; None without.
    """

    values: Float[Array, " p"]
    directions: Float[Array, "moved p"]
    are_legal: Flag
    of_sensors: Float[Array, " q"] | None
    sensor_directions: Float[Array, "k q"] | None


class Prediction(NamedTuple):
    """What an experiment should have measured.

    Attributes:
        values: of all observables, components side by side.
        slopes: derivatives by the unknowns, the last axis; of none where they were not asked for.
        status: integer of `Status`.
        t_reached: time reached [s].
        n_steps: steps tried.
        filter_errors: largest change of each channel with a filter, where its intervals are twice as long; None without
            filters, or where derivatives were not asked for.
    """

    values: Float[Array, "n m"]
    slopes: Float[Array, "n m k"]
    status: Int[Array, ""]
    t_reached: Float[Array, ""]
    n_steps: Int[Array, ""]
    filter_errors: Float[Array, " filters"] | None


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


class Experiment(eqx.Module):
    """One experiment, ready to be predicted.

    Attributes:
        frame: what is compiled for (static).
        setting: what the runs share.
        numbers: from unknowns to the numbers of the system and its sensors (static).
        measured: what was measured (static).
        build: from all parameters of the fit to the scene (static).
        sensors: the sensors' numbers as functions of the parameters of this experiment; None without (static).
        arguments: which these are (static).
        data: measured values, components side by side, 0 where nothing was measured.
        is_measured: where something was measured.
    """

    frame: Frame = eqx.field(static=True)
    setting: Setting
    numbers: Callable[[Array], TracedNumbers] = eqx.field(static=True)
    measured: Measured = eqx.field(static=True)
    build: Build = eqx.field(static=True)
    sensors: SensorNumbers | None = eqx.field(static=True)
    arguments: Arguments = eqx.field(static=True)
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

    def cost_and_gradient(
        self, u: Float[Array, " k"], weights: Float[np.ndarray, "n m"], loss: Loss | None = None
    ) -> CostAndGradient:
        """Half the sum of squares of weighted residuals, or of their losses, and its gradient in reverse; now."""
        if self.frame.moved == ():  # only sensors are fitted: there is nothing to go back along
            return self._cost_and_gradient_forward(u, weights, loss)
        frame, setting, numbers = self.frame, self.setting, self.numbers(u)
        ts = _sample_times(frame, setting, numbers.of_sensors)
        inputs = RunInputs(numbers.values, setting.known, ts, setting.start, numbers.are_legal)
        run: Outcome = run_of(frame.plan, setting.method, inputs)
        if int(run.status) != Status.SUCCEEDED:
            return CostAndGradient(np.nan, np.full(u.size, np.nan), self.diagnosis(run.status, run.t_reached, u))
        n = setting.ts.size - 1
        data, padded = np.zeros((2, n, self.data.shape[1]))
        data[: len(self.data)], padded[: len(self.data)] = self.data, weights
        slopes = _cost_and_slopes(frame, setting, loss, numbers.values, numbers.of_sensors, run, data, padded)
        along_run = gradient_of(frame.plan, setting.method, inputs, numbers.directions, slopes.by_ys)
        by_scene = numbers.directions @ (slopes.by_values + along_run)
        gradient = np.zeros(u.size)
        if numbers.sensor_directions is not None and slopes.by_sensors is not None:
            gradient += np.asarray(numbers.sensor_directions @ slopes.by_sensors)
        gradient[slice(None) if frame.moved is None else list(frame.moved)] += np.asarray(by_scene)
        return CostAndGradient(float(slopes.cost), gradient)

    def _cost_and_gradient_forward(self, u, weights, loss: Loss | None) -> CostAndGradient:
        prediction = self.predict(u)
        if int(prediction.status) != Status.SUCCEEDED:
            why = self.diagnosis(prediction.status, prediction.t_reached, u)
            return CostAndGradient(np.nan, np.full(u.size, np.nan), why)
        errors = np.where(weights > 0, (np.asarray(prediction.values) - self.data) * weights, 0.0)
        slopes = errors if loss is None else np.asarray(loss.slope(errors))
        gradient = np.einsum("nm,nmk->k", slopes * weights, np.asarray(prediction.slopes))
        return CostAndGradient(float(jnp.sum(_costs(loss, errors))), gradient)

    def diagnosis(self, status, t_reached, u) -> str:
        """Why a run has failed; empty after success."""
        if int(status) == Status.BAD_VALUE and self.sensors is not None:
            reasons = self.sensors.refusals(np.asarray(self.numbers(jnp.asarray(u)).of_sensors))
            if reasons:
                return "; ".join(reasons)
        return diagnosis(status, t_reached, float(self.setting.ts[-1]))

    def filter_errors(self, u: Float[Array, " k"]) -> dict[str, float]:
        """Largest changes of the readings where the intervals of filters are twice as long, by channel with a filter.

        Computed now.
        """
        if self.frame.sensing is None or not self.frame.sensing.has_filters:
            return {}
        channels = zip(self.measured.values, self.frame.sensing.channels, strict=True)
        names = [name for name, channel in channels if is_filtered(channel)]
        return dict(zip(names, np.asarray(self.predict(u).filter_errors).tolist(), strict=True))

    @property
    def depends_on_unknowns(self) -> bool:
        """Whether its scene or a sensor depends on what is fitted."""
        return bool(self.frame.plan.unknown) or self.sensors is not None

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
    settings: RunSettings,
    n_samples: int,
    common: Sequence[str],
) -> Experiment:
    """Prepare one experiment.

    Args:
        build: from parameters to the scene.
        unknowns: what is fitted.
        start: where the fit begins.
        measured: what was measured.
        integration: how to integrate.
        n_samples: how many samples the program is compiled for; the last is repeated.
        common: parameters that all experiments share.

    Raises:
        SceneError: for a scene that cannot be simulated at the start, or an unknown observable.
    """
    build, arguments = build_of(build, measured, list(common))
    example = compile_scene(built(build, start)).system
    observables = {
        channel: observable(name, example, measured.functions) for channel, name in measured.observables.items()
    }
    first = {
        channel: float(measured.ts[int(np.argmax(~np.isnan(values.reshape(len(values), -1)).all(1)))])
        for channel, values in measured.values.items()
    }
    track_work = any(one.needs_work for one in observables.values())
    times = np.concatenate([[measured.t0], measured.ts, np.full(n_samples - measured.ts.size, measured.ts[-1])])
    moved = _moved(unknowns, arguments)
    reach = _reach(build, unknowns, start, track_work, settings, times)
    plan, choice = reach.plan, reach.choice
    try:
        sensing, sensors = channels_of(measured.sensors, observables, first, measured.t0, arguments.of(start))
    except SceneError as error:
        raise SceneError(f"{measured.name}: {error}") from error
    moved = moved if plan.unknown else ()
    if track_work:
        example = compile_scene(built(build, start), track_work=True).system
    method = RunMethod.of_settings(example, plan.structure, settings.replaced(solver=choice.solver))
    setting = Setting(method, jnp.asarray(reach.known), jnp.asarray(times), reach.start)
    data = np.concatenate([value.reshape(measured.ts.size, -1) for value in measured.values.values()], 1)
    frame = Frame(plan, tuple(observables.values()), choice.reason, unknowns.size, moved, sensing)
    numbers = _numbers_for(build, unknowns, track_work, plan.unknown, moved, sensors, arguments)
    made = Experiment(
        frame, setting, numbers, measured, build, sensors, arguments, np.nan_to_num(data), ~np.isnan(data)
    )
    _check_shapes(made)
    return made


def build_of(build: Build, measured: Measured, common: Sequence[str]) -> tuple[Build, Arguments]:
    """The builder of an experiment as a function of all parameters of the fit, and which of them it has.

    Args:
        build: the builder of experiments that have none of their own.
        measured: what was measured.
        common: parameters that all experiments share.
    """
    build = measured.build or build
    arguments = arguments_of(build, measured, common)
    return OwnBuild(build, arguments), arguments


def _moved(unknowns: FitUnknowns, arguments: Arguments) -> tuple[int, ...] | None:
    """Places of the unknowns that the builder takes; None for all of them."""
    is_taken = np.concatenate([np.full(part.size, part.name in arguments.moving) for part in unknowns.parts])
    return None if is_taken.all() else tuple(np.flatnonzero(is_taken).tolist())


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


def _reach(build: Build, unknowns: FitUnknowns, start, track_work: bool, settings: RunSettings, times) -> _Reach:
    """Trace the builder without staging it: what does not depend on the unknowns stays known."""
    found: list[_Reach] = []

    def traced(u):
        system = compile_scene(built(build, unknowns.values_of(u)), track_work=track_work).system
        structure, _ = flatten_system(system)
        known, unknown = split(system)
        path = path_of(structure)
        choice = choice_for(system, settings.rtol, settings.solver, explicit_only=path.scalar is False)
        check_derivatives(system, choice.solver)
        plan = Plan(structure, unknown, path.scalar)
        found.append(_Reach(plan, np.asarray(known), choice, start_now(system, times)))
        return u

    u0 = jnp.asarray(unknowns.unknowns_of(start))
    jax.jvp(traced, (u0,), (jnp.ones_like(u0),))
    return found[0]


@lru_cache(maxsize=64)
def _numbers_for(
    build: Build,
    unknowns: FitUnknowns,
    track_work: bool,
    unknown: tuple[int, ...],
    moved: tuple[int, ...] | None,
    sensors: SensorNumbers | None,
    arguments: Arguments,
):
    """The traced numbers of a builder's system and their derivatives, compiled; kept for fits to come."""
    places = np.arange(unknowns.size) if moved is None else np.array(moved, int)
    # Products, no scatter: XLA's compiler for CPUs aborts on one that is mapped over lanes and differentiated.
    others, into = np.ones(unknowns.size), np.eye(unknowns.size)[places]
    others[places] = 0.0

    def of_scene(own, u):
        whole = own if moved is None else others * u + own @ into
        compiled = compile_scene(built(build, unknowns.values_of(whole)), track_work=track_work)
        values = jnp.asarray(flatten_system(compiled.system)[1])[np.array(unknown, int)]
        return values, (values, jnp.all(jnp.stack([jnp.array(True), *compiled.conditions])))

    def of_sensors(u):
        assert sensors is not None
        vector = sensors(arguments.of(unknowns.values_of(u)))
        return vector, vector

    @jax.jit
    def with_directions(u):
        if places.size:
            slopes, (values, legal) = jax.jacfwd(of_scene, has_aux=True)(u if moved is None else into @ u, u)
        else:  # JAX maps over no directions where there are none
            values, (_, legal) = of_scene(into @ u, u)
            slopes = jnp.zeros((values.size, 0))
        legal = legal & jnp.all(jnp.isfinite(values)) & jnp.all(jnp.isfinite(slopes))
        if sensors is None:
            return TracedNumbers(values, slopes.T, legal, None, None)
        sensor_slopes, vector = jax.jacfwd(of_sensors, has_aux=True)(u)
        legal = legal & sensors.are_legal(vector) & jnp.all(jnp.isfinite(sensor_slopes))
        return TracedNumbers(values, slopes.T, legal, vector, sensor_slopes.T)

    return with_directions


# The programs -------------------------------------------------------------------------------------------------------


def _of_all(frame: Frame, rows: Array) -> Array:
    """Rows of derivatives by all unknowns, from those by the unknowns that move the scene."""
    if frame.moved is None:
        return rows
    if not frame.moved:
        return jnp.zeros((frame.n_unknowns, *rows.shape[1:]))
    return jnp.tensordot(np.eye(frame.n_unknowns)[:, np.array(frame.moved, int)], rows, 1)


def _samples(frame: Frame, setting: Setting, of_sensors) -> Samples:
    """When the run is sampled; without sensors at the instants of the record."""
    if frame.sensing is None:
        return Samples(setting.ts, ())
    return samples_for(frame.sensing, of_sensors, setting.ts)


@cached_jit(what="the sample times of a fit")
def _sample_times(frame: Frame, setting: Setting, of_sensors) -> Float[Array, " n"]:
    return _samples(frame, setting, of_sensors).ts


def _run_with_slopes(frame: Frame, setting: Setting, numbers: TracedNumbers, ts) -> RunAndSlopes:
    """A run and its derivatives by the unknowns that move the scene."""
    inputs = RunInputs(numbers.values, setting.known, ts, setting.start, numbers.are_legal)
    if frame.moved != ():
        return run_and_slopes(frame.plan, setting.method, inputs, numbers.directions)
    run: Outcome = run_of(frame.plan, setting.method, inputs)
    none = jax.tree.map(lambda leaf: jnp.zeros((0, *jnp.shape(leaf))), (run.ys, run.assembly))
    return RunAndSlopes(run, *none)


def _with_slopes(frame: Frame, setting: Setting, numbers: TracedNumbers) -> Prediction:
    samples = _samples(frame, setting, numbers.of_sensors)
    outcome, run_slopes, _ = _run_with_slopes(frame, setting, numbers, samples.ts)
    directions, slopes = _of_all(frame, numbers.directions), _of_all(frame, run_slopes)

    def predictions(values, ys, of_sensors):
        return _observed(frame, setting, values, ys, of_sensors, outcome.assembly)

    if frame.sensing is not None:
        # The state at a sample time that moves: its own derivative, and its rate times the move.
        rates = _rates(frame, setting, numbers.values, samples.ts, outcome.ys)
        moves = jax.vmap(
            lambda dot: jax.jvp(lambda x: _samples(frame, setting, x).ts, (numbers.of_sensors,), (dot,))[1]
        )(numbers.sensor_directions)
        slopes = slopes + moves[:, :, None] * rates

    def along(direction, slope, dot):
        return jax.jvp(predictions, (numbers.values, outcome.ys, numbers.of_sensors), (direction, slope, dot))

    values, slopes = jax.vmap(along, out_axes=(None, -1))(directions, slopes, numbers.sensor_directions)
    changes = None
    of_sensors = numbers.of_sensors
    if frame.sensing is not None and frame.sensing.has_filters and of_sensors is not None:
        seen = _seen(frame, setting, numbers.values, outcome.ys, of_sensors, outcome.assembly)
        changes = filter_errors(*seen)
    return Prediction(values, slopes, outcome.status, outcome.t_reached, outcome.stats.n_steps, changes)


def _rates(frame: Frame, setting: Setting, values, ts, ys) -> Float[Array, "n size"]:
    """Time derivatives of the flat states at the samples."""
    rate = program_for(state_rate, frame.plan.structure, frame.plan.scalar)
    theta = frame.plan.theta(values, setting.known)
    ahead = rate.ahead(theta)
    # A loop: mapped, the right-hand side of a large system would have temporaries for all samples at once.
    return jax.lax.map(lambda sample: rate.inside(theta, ahead, *sample), (ts, ys))


def _observed(frame: Frame, setting: Setting, values, ys, of_sensors, assembly) -> Float[Array, "n m"]:
    """What all channels read, components side by side."""
    if frame.sensing is None:
        run = _run_of(frame, setting, setting.ts, values, ys, assembly)
        return jnp.concatenate([one.of(run) for one in frame.observables], 1)
    return jnp.concatenate(readings(*_seen(frame, setting, values, ys, of_sensors, assembly)), 1)


def _seen(frame: Frame, setting: Setting, values, ys, of_sensors, assembly):
    """What sensors see of a run: the arguments of `readings`."""
    assert frame.sensing is not None
    samples = _samples(frame, setting, of_sensors)
    rates = _rates(frame, setting, values, samples.ts, ys) if frame.sensing.has_filters else None

    def run_at(ts, ys):
        return _run_of(frame, setting, ts, values, ys, assembly)

    return frame.sensing, of_sensors, samples, run_at, ys, rates


def _run_of(frame: Frame, setting: Setting, ts, values, ys, assembly) -> Trajectory:
    """A run as observables see it."""
    theta = frame.plan.theta(values, setting.known)
    nothing = jnp.zeros((), jnp.int64)
    return Trajectory(
        ts=ts,
        ys=ys,
        system=frame.plan.structure.system(theta),
        stats=Statistics(nothing, nothing, nothing, nothing, jnp.zeros(0, jnp.int64), jnp.zeros(4)),
        ended=nothing,
        t_reached=ts[-1],
        y_reached=ys[-1],
        assembly=assembly,
        choice=frame.choice,
        scalar=frame.plan.scalar,
    )


_predicted_with_slopes = cached_jit(_with_slopes, what="the predictions of a fit")


@cached_jit(what="the predictions of a fit")
def _predicted_in_lanes(frame: Frame, setting: Setting, numbers: TracedNumbers) -> Prediction:
    return jax.vmap(lambda lane: _with_slopes(frame, setting, lane))(numbers)


@cached_jit(what="a prediction of a fit")
def _predicted_alone(frame: Frame, setting: Setting, numbers: TracedNumbers) -> Prediction:
    ts = _samples(frame, setting, numbers.of_sensors).ts
    inputs = RunInputs(numbers.values, setting.known, ts, setting.start, numbers.are_legal)
    outcome: Outcome = run_of(frame.plan, setting.method, inputs)
    values = _observed(frame, setting, numbers.values, outcome.ys, numbers.of_sensors, outcome.assembly)
    none = jnp.zeros((*values.shape, 0))
    return Prediction(values, none, outcome.status, outcome.t_reached, outcome.stats.n_steps, None)


class _CostSlopes(NamedTuple):
    """Half the sum of squares of a run, and its derivatives.

    Attributes:
        cost: half the sum of squares.
        by_values: derivatives by the traced numbers, the states held.
        by_ys: by the sampled states.
        by_sensors: by the numbers of the sensors, sample times and the states at them included.
    """

    cost: Float[Array, ""]
    by_values: Float[Array, " p"]
    by_ys: Float[Array, "n size"]
    by_sensors: Float[Array, " q"] | None


def _costs(loss: Loss | None, errors):
    """What each weighted residual costs."""
    return errors**2 / 2 if loss is None else loss.cost(errors)


@cached_jit(what="the gradient of a fit")
def _cost_and_slopes(
    frame: Frame, setting: Setting, loss: Loss | None, values, of_sensors, run: Outcome, data, weights
) -> _CostSlopes:
    def cost(values, ys, of_sensors):
        errors = (_observed(frame, setting, values, ys, of_sensors, run.assembly)[1:] - data) * weights
        return jnp.sum(_costs(loss, jnp.where(weights > 0, errors, 0.0)))

    size, (by_values, by_ys, by_sensors) = jax.value_and_grad(cost, (0, 1, 2))(values, run.ys, of_sensors)
    if frame.sensing is not None:
        ts, to_sensors = jax.vjp(lambda x: _samples(frame, setting, x).ts, of_sensors)
        by_sensors = by_sensors + to_sensors(jnp.sum(by_ys * _rates(frame, setting, values, ts, run.ys), 1))[0]
    return _CostSlopes(size, by_values, by_ys, by_sensors)


def _check_shapes(made: Experiment) -> None:
    """Compare the shapes of measurements with those of predictions, without computing anything."""
    plan, setting = made.frame.plan, made.setting

    def shapes_of(values):
        size = plan.structure.system(plan.theta(values, setting.known)).layout.size
        n = setting.ts.shape[0]
        run = _run_of(made.frame, setting, jnp.zeros(n), values, jnp.zeros((n, size)), None)
        return [one.of(run) for one in made.frame.observables]

    shapes = jax.eval_shape(shapes_of, jnp.zeros(len(plan.unknown)))
    for name, one, shape in zip(made.measured.values, made.frame.observables, shapes, strict=True):
        values = made.measured.values[name]
        columns = values.reshape(values.shape[0], -1).shape[1]
        if columns != shape.shape[1]:
            raise SceneError(
                f"measured {name!r} has {columns} component{'s' * (columns != 1)}, and {shape.shape[1]} are "
                f"predicted; name a component, e.g. '{one.name}.z', or give an array of shape (n, {shape.shape[1]})"
            )
        if made.frame.sensing is not None:
            channel = made.frame.sensing.channels[list(made.measured.values).index(name)]
            for what, (begin, end) in (("gain", channel.gain), ("bias", channel.bias)):
                if end - begin not in (1, columns):
                    raise SceneError(
                        f"the {what} of the sensor of {name!r} has {end - begin} numbers; it must be one, or one for "
                        f"each of the {columns} component{'s' * (columns != 1)}"
                    )
