"""Times that a user gives, as seconds."""

import datetime
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import is_concrete, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible


def seconds_of(ts: Any, name: str = "ts") -> np.ndarray:
    """Times in seconds, float64.

    Durations with a unit of their own are converted: `timedelta64` of NumPy, pandas and xarray (which makes them of
    times with the unit "s" when it reads a file), and `datetime.timedelta`.

    Raises:
        SceneError: for what is no time: complex numbers, texts, truth values, dates.
    """
    if visible(ts) is not ts:
        raise SceneError(f"{name} = {shown(ts)} has masked entries; leave them out")
    try:
        times = np.asarray(ts)
    except ValueError:
        raise SceneError(f"{name} = {shown(ts)} has rows of different lengths; give a list of times [s]") from None
    if times.dtype.kind == "O":
        times = _of_objects(times, name)
    if times.dtype.kind == "m":
        if np.datetime_data(times.dtype)[0] == "generic":
            raise SceneError(f"{name} holds timedelta64 without a unit; give seconds, or timedelta64 in e.g. 'ms'")
        return np.where(np.isnat(times), np.nan, times / np.timedelta64(1, "s"))
    remedies = {
        "c": "holds complex numbers; give real times [s]",
        "M": "holds dates; give durations since the start, e.g. ts - ts[0]",
        "b": "holds truth values; give times [s]",
        "U": "is text; give numbers [s]",
        "S": "is text; give numbers [s]",
    }
    if times.dtype.kind in remedies:
        raise SceneError(f"{name} = {shown(ts)} {remedies[times.dtype.kind]}")
    if times.dtype.kind not in "fiu":
        raise SceneError(f"{name} = {shown(ts)} is no list of times; give numbers [s]")
    return times.astype(np.float64)


def _of_objects(times: np.ndarray, name: str) -> np.ndarray:
    """Python's durations, and numbers that NumPy has no type for."""
    entries = [t.total_seconds() if isinstance(t, datetime.timedelta) else t for t in times.ravel()]
    if any(isinstance(t, str | bytes | bool | complex | datetime.date) or t is None for t in entries):
        raise SceneError(f"{name} holds what is no time; give numbers [s]")
    try:
        return np.array([float(t) for t in entries]).reshape(times.shape)
    except (TypeError, ValueError, OverflowError):
        raise SceneError(f"{name} holds what is no time of 64 bits; give numbers [s]") from None


SAVED = "The states of a run are those at its sample times, at its start and at its end"

STEPS = (
    f"{SAVED}; steps are not kept. run.at(t) has the state at any time, run.peak and run.impacts look at every step, "
    "and stepsize_controller=diffrax.StepTo(times) makes steps end where you want them"
)

NOT_HERE = {
    "solver_state": "sj.continue_from(run, ts) continues from the end of a run",
    "controller_state": "sj.continue_from(run, ts) continues from the end of a run",
    "made_jump": "sj.continue_from(run, ts) continues from the end of a run",
}
"""What else diffrax saves, and what there is in its place."""


def sample_times(ts: Any, saveat: Any) -> Any:
    """The sample times of a run for which the user gives a `diffrax.SaveAt`, in order.

    Args:
        ts: start and end of the run [s], and more sample times where there are some.
        saveat: as for `diffrax.diffeqsolve`.

    Raises:
        SceneError: for what is no `SaveAt`, and for one that saves other things than states at times.
    """
    if not isinstance(saveat, diffrax.SaveAt):
        raise SceneError(f"saveat = {shown(saveat)} is no diffrax.SaveAt; give the sample times themselves as ts")
    for name, remedy in NOT_HERE.items():
        if getattr(saveat, name):
            raise SceneError(f"saveat: {name}=True has no counterpart. {remedy}")
    subs = jax.tree.leaves(saveat.subs, is_leaf=lambda leaf: isinstance(leaf, diffrax.SubSaveAt))
    if len(subs) > 1:
        raise SceneError(f"saveat: subs= of {len(subs)} kinds have no counterpart. {SAVED}: give all times as one ts")
    times = [ts]
    for sub in subs:
        if sub.steps:
            raise SceneError(f"saveat: steps={sub.steps} has no counterpart. {STEPS}")
        if sub.fn is not diffrax.SubSaveAt(t1=True).fn:
            raise SceneError(
                f"saveat: fn= has no counterpart. {SAVED}, and are observed behind it: run.position(...), "
                "run.observation, or jax.vmap(fn, (0, 0, None))(run.ts, run.ys, run.system)"
            )
        if sub.ts is not None:
            times.append(sub.ts)
    # t0, t1: a run has its start and its end among its samples; dense: `run.at` needs nothing that is kept.
    if all(map(is_concrete, times)):
        known = [seconds_of(part).ravel() for part in times]
        begin, end = (known[0].min(), known[0].max()) if known[0].size else (np.nan, np.nan)
        outside = [time for part in known[1:] for time in part if not begin <= time <= end]
        if outside:
            raise SceneError(
                f"saveat: t = {outside[0]:.9g} s is outside of the run, which ts says goes from {begin:.9g} s to "
                f"{end:.9g} s"
            )
        return np.unique(np.concatenate(known))
    return jnp.sort(jnp.concatenate([jnp.ravel(jnp.asarray(part, jnp.float64)) for part in times]))
