"""The gradient of one number by many parameters, back along the steps of the run."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.motion.derivatives.adjoint import gradients, kept_run
from spherejax.motion.integration.sensitivity_rows import scales_of
from spherejax.motion.integration.status import Status
from spherejax.program_cache import cached_jit
from spherejax.studies.sensitivity.forward import (
    PreparedStudy,
    RunMethod,
    RunWithSlopes,
    WantedObservables,
    observable_run,
    prepare,
    traced_numbers,
)
from spherejax.studies.sensitivity.unknowns import FlatBuild

ERRORS = "the errors of the derivatives are controlled along a mixture of all parameters, not one by one"


def reverse(flat: FlatBuild, numbers, times, wanted: tuple[WantedObservables, ...], method: RunMethod) -> RunWithSlopes:
    """The run, and the gradient of the one number that is wanted of it; see `motion.adjoint`.

    The start follows from the parameters in forward mode, which is cheap; the run is gone back along its steps. The
    derivatives of a run that failed are NaN.
    """
    (number,) = wanted
    prepared = prepare(flat, numbers, times, method)
    plan, options, known, ts = prepared.plan, prepared.options, prepared.known, prepared.ts
    numbers = jnp.asarray(numbers)
    scale = scales_of(numbers)
    values, directions, are_legal = traced_numbers(flat, plan, numbers, scale, method.track_work)
    kept = kept_run(plan, options, values, directions, known, ts, prepared.start, are_legal)
    value, (by_values, by_ys) = _value_and_slopes(prepared, number, values, kept.ys)
    slopes = np.full(numbers.size, np.nan)
    if int(kept.status) == Status.SUCCEEDED:
        along_run, by_start = gradients(plan, options, values, known, ts, kept, by_ys)
        slopes = np.asarray((directions @ (by_values + along_run) + kept.start_slopes @ by_start) / scale)
    run = observable_run(prepared, plan.theta(values, known), kept.ys)
    stats = replace(run.stats, n_steps=kept.n_steps)
    run = replace(run, stats=stats, ended=kept.status, t_reached=kept.t_reached)
    return RunWithSlopes(run, [(np.asarray(value).reshape(1, 1), slopes.reshape(1, 1, -1))], ERRORS)


@cached_jit(what="the gradient of what is observed")
def _value_and_slopes(prepared: PreparedStudy, wanted: WantedObservables, values, ys):
    """The number, and its derivatives by the numbers of the system and by the sampled states."""

    def number(values, ys):
        return wanted.of(observable_run(prepared, prepared.plan.theta(values, prepared.known), ys))[0, 0]

    return jax.value_and_grad(number, (0, 1))(values, ys)
