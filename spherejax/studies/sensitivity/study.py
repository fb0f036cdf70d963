"""`sj.sensitivity`: derivatives of observables by parameters, forward or in reverse by what costs less."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.model.system import System, compile_scene
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.many import Build, built
from spherejax.motion.runs.simulate import checked_times
from spherejax.motion.settings import RunSettings
from spherejax.studies.fit.observables import Observable, labels_of, observable
from spherejax.studies.sensitivity.forward import forward
from spherejax.studies.sensitivity.reverse import reverse
from spherejax.studies.sensitivity.sensitivity_result import Sensitivities, SlopesColumn
from spherejax.studies.sensitivity.unknowns import FlatBuild, unknowns_of

REVERSE_FROM = 60
"""Parameters from which the gradient of one number is computed in reverse where nobody says. A run in reverse takes
about as long as a few sensitivities; forward mode controls the errors of all derivatives one by one."""

Wanted = str | Sequence[Any] | Mapping[str, Callable[[Trajectory], Any]]


def sensitivity(
    build: Build,
    parameters: Mapping[str, Any],
    ts: Float[Array, " n"],
    *,
    observables: Wanted | None = None,
    of: Callable[[Trajectory], Any] | None = None,
    mode: Literal["forward", "reverse"] | None = None,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = 20_000_000,
) -> Sensitivities:
    """Derivatives of what is observed of a run by every parameter.

    Args:
        build: makes a `Scene` from the parameters, given by keyword. It is traced.
        parameters: values by name, where the derivatives are taken: numbers, or arrays, each of whose entries counts.
        ts: sample times [s], increasing.

    Other args:
        observables: names such as `"position.rocker"`, `"position.rocker.z"`, `"reaction.hinge"`, `"shock.length"`,
            or functions from a `Trajectory` to an array with a row for each sample; a list, or functions by name.
        of: a function from a `Trajectory` to one number instead, e.g. a peak or a mean: its gradient is found.
        mode: "forward" integrates the derivatives by each parameter beside the state, with their errors controlled,
            through contact onsets too; it costs in proportion to the parameters. "reverse" goes back along the steps of
            the run, through contact onsets too: it costs the same for any number of parameters, serves one number
            (`of=`) alone, and controls the errors of the derivatives along a mixture of all parameters, not one by
            one. Chosen by the counts when None.
        rtol, atol, solver, max_steps: as in `simulate`.

    Returns:
        The derivatives along time, as a table (`to_xarray()`, `save()`), as pictures (`figures()`), and ranked by
        what 1 % of each parameter changes (`ranking`, `print`).

    Raises:
        SceneError: for a request that cannot be answered, before anything is computed.
    """
    begin = time.perf_counter()
    times = np.asarray(checked_times(ts))
    unknowns, numbers = unknowns_of(parameters)
    flat = FlatBuild(build, unknowns)
    try:
        scene = built(flat, dict(zip(unknowns.names, numbers, strict=True)))
    except TypeError as error:
        raise SceneError(f"build cannot be called with the parameters {', '.join(parameters)}: {error}") from error
    wanted = _observables(observables, of, compile_scene(scene).system)
    settings = RunSettings(rtol, atol, solver, max_steps=max_steps, track_work=_needs_work(wanted))
    chosen, why = _mode(mode, of is not None, len(numbers))
    compute = forward if chosen == "forward" else reverse
    found = compute(flat, numbers, times, wanted, settings)
    columns = tuple(_column(each, *its) for each, its in zip(wanted, found.observed, strict=True))
    run = found.run
    return Sensitivities(
        ts=times if of is None else times[-1:],
        parameters={name: float(number) for name, number in zip(unknowns.names, numbers, strict=True)},
        columns=columns,
        mode=chosen,
        reason=f"{why}; {found.errors}",
        method=run.choice,
        diagnosis=run.diagnosis,
        n_steps=int(run.stats.n_steps),
        seconds=time.perf_counter() - begin,
    )


class RunNumber(NamedTuple):
    """A number that is made of a whole run.

    Attributes:
        name: of the function.
        function: from a `Trajectory` to a number.
        unit: not known.
    """

    name: str
    function: Callable[[Trajectory], Any]
    unit: str = ""

    def of(self, run: Trajectory) -> Float[Array, "1 1"]:
        """The number, as the one sample of one component."""
        found = jnp.asarray(self.function(run), jnp.float64)
        if found.size != 1:
            raise SceneError(
                f"of={self.name}: it must make one number of a run; it makes an array of shape {found.shape}"
            )
        return found.reshape(1, 1)


Seen = Observable | RunNumber


def _observables(wanted: Wanted | None, of: Callable | None, system: System) -> tuple[Seen, ...]:
    """What is asked for, checked against a system."""
    if (wanted is None) == (of is None):
        raise SceneError(
            'sensitivity needs observables=, e.g. ["position.rocker.z"], or of=, a function from a run to one number'
        )
    if of is not None:
        return (RunNumber(getattr(of, "__name__", "function"), of),)
    items = list(wanted.items()) if isinstance(wanted, Mapping) else _listed(wanted)
    if not items:
        raise SceneError('observables= asks for nothing; name a quantity, e.g. observables=["position.rocker.z"]')
    names = [name for name, _ in items]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise SceneError(f"observables= asks for {twice!r} twice")
    return tuple(_observable(name, item, system) for name, item in items)


def _listed(wanted: Any) -> list[tuple[str, Any]]:
    items = [wanted] if isinstance(wanted, str) or callable(wanted) else list(wanted)
    return [(item if isinstance(item, str) else getattr(item, "__name__", "function"), item) for item in items]


def _observable(name: str, item: Any, system: System) -> Observable:
    if callable(item):
        return Observable(name, "", function=item)
    if not isinstance(item, str):
        raise SceneError(f"observables= takes names and functions; {item!r} is neither")
    try:
        found = observable(item, system, {})
    except SceneError as error:
        raise SceneError(str(error).removeprefix("measured ")) from None
    return found._replace(name=name)


def _mode(mode: str | None, is_number: bool, n_parameters: int) -> tuple[str, str]:
    """The mode, and the reason in words."""
    if mode not in (None, "forward", "reverse"):
        raise SceneError(f"mode={mode!r}: it is 'forward', 'reverse', or None for the cheaper of both")
    if mode == "reverse" and not is_number:
        raise SceneError("mode='reverse' serves one number alone: pass of=, a function from a run to a number")
    count = f"{n_parameters} parameters"
    if mode is not None:
        reason = "as asked for"
    elif not is_number:
        mode, reason = "forward", f"histories have more outputs than their {count}"
    elif n_parameters < REVERSE_FROM:
        mode, reason = "forward", f"one number, but no more than {REVERSE_FROM - 1} parameters ({n_parameters})"
    else:
        mode, reason = "reverse", f"one number and {count}"
    return mode, reason


def _needs_work(wanted: tuple[Seen, ...]) -> bool:
    """Whether the work of the joints must be integrated: functions may ask for it."""
    return any(each.function is not None or (isinstance(each, Observable) and each.needs_work) for each in wanted)


def _column(seen: Seen, values, slopes) -> SlopesColumn:
    labels = (seen.name,) if isinstance(seen, RunNumber) else tuple(labels_of(seen.name, values.shape[1]))
    return SlopesColumn(seen.name, seen.unit, labels, values, slopes)
