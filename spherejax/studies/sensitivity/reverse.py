"""The gradient of one number by many parameters, back along the steps of the run."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.motion.derivatives.pullback import gradient_of
from spherejax.motion.integration.one_run import run_of
from spherejax.motion.integration.problem import RunInputs
from spherejax.motion.integration.status import Status
from spherejax.motion.settings import RunSettings
from spherejax.program_cache import cached_jit
from spherejax.studies.sensitivity.forward import (
    PreparedStudy,
    RunWithSlopes,
    WantedObservables,
    observable_run,
    prepare,
    traced_numbers,
)
from spherejax.studies.sensitivity.unknowns import FlatBuild

ERRORS = "the errors of the derivatives are controlled along a mixture of all parameters, not one by one"


def reverse(
    flat: FlatBuild, numbers, times, wanted: tuple[WantedObservables, ...], settings: RunSettings
) -> RunWithSlopes:
    """The run, and the gradient of the one number that is wanted of it; see
    `motion.derivatives.pullback`.

    The start follows from the parameters in forward mode, which is cheap; the run is gone back along its steps. The
    derivatives of a run that failed are NaN.
    """
    (number,) = wanted
    prepared = prepare(flat, numbers, times, settings)
    plan, known = prepared.plan, prepared.known
    numbers = jnp.asarray(numbers)
    scale = flat.unknowns.scales(numbers)
    values, directions, are_legal = traced_numbers(flat, plan, numbers, scale, settings.track_work)
    inputs = RunInputs(values, known, prepared.ts, prepared.start, are_legal)
    made = run_of(plan, prepared.method, inputs)
    value, (by_values, by_ys) = _value_and_slopes(prepared, number, values, made.ys)
    slopes = np.full(numbers.size, np.nan)
    if int(made.status) == Status.SUCCEEDED:
        by_run = gradient_of(plan, prepared.method, inputs, directions, by_ys)
        slopes = np.asarray(directions @ (by_values + by_run) / scale)
    run = observable_run(prepared, plan.theta(values, known), made.ys)
    stats = replace(run.stats, n_steps=made.stats.n_steps)
    run = replace(run, stats=stats, ended=made.status, t_reached=made.t_reached)
    return RunWithSlopes(run, [(np.asarray(value).reshape(1, 1), slopes.reshape(1, 1, -1))], ERRORS)


@cached_jit(what="the gradient of what is observed")
def _value_and_slopes(prepared: PreparedStudy, wanted: WantedObservables, values, ys):
    """The number, and its derivatives by the numbers of the system and by the sampled states."""

    def number(values, ys):
        return wanted.of(observable_run(prepared, prepared.plan.theta(values, prepared.known), ys))[0, 0]

    return jax.value_and_grad(number, (0, 1))(values, ys)
