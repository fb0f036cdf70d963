"""`sj.steady_cycle`: the motion of a mechanism that repeats itself, and whether it lasts."""

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import diffrax
import numpy as np

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import real_number, whole_number
from spherejax.foundations.terminals import waiting_for
from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene
from spherejax.motion.integration.problem import initial_state
from spherejax.motion.integration.status import SimulationWarning, Status
from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.start.equilibrium import equilibrium
from spherejax.motion.start.start_now import start_now
from spherejax.studies.cycles.cycle_result import Cycle, Multipliers, motions
from spherejax.studies.cycles.family import Family
from spherejax.studies.cycles.shooting import CandidateState, SearchOutcome, Shooting, search, settled, stacked_places

TOLERANCE = 100.0
"""A cycle closes to so many relative tolerances of its size: errors of the steps of a period add up."""


class CycleWarning(SimulationWarning):
    """No cycle was found, or one that is not what was asked for; the message says why and what to do."""


def steady_cycle(
    what: Scene | Trajectory,
    *,
    period: float | None = None,
    near: float | None = None,
    at: str = "start",
    settle: int | None = None,
    samples: int = 256,
    t: float = 0.0,
    rtol: float = 1e-8,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = 20_000_000,
    throw: bool = False,
) -> Cycle:
    """The motion that repeats itself after a period, by shooting: driven, or of a mechanism left to itself.

    Any joint, force and driver; redundant constraints too. The state after a period is compared with the first in
    independent coordinates and in what joints remember, and Newton's method makes them equal, with derivatives that are
    integrated beside the motion, through impacts too; of a stiff method they come from disturbed starts, and
    `.multipliers.doubt` says how good they are. Their eigenvalues, the Floquet multipliers, say whether the
    cycle is stable: they are found for unstable ones as well, which no simulation settles on. A rotation by whole turns
    counts as none.

    Args:
        what: a scene; or a run, whose last state is where the search begins and whose last instant the cycle.

    Other args:
        period: of what drives the mechanism [s], or a multiple of it for subharmonic motions.
        near: instead of `period`, where nothing depends on time: about how long the cycle takes [s]; its length is
            found with it. Of a conservative mechanism, which has a cycle for each energy, the nearest one.
        at: of a scene, where the search begins: "start", as assembled, or "rest", its rest position.
        settle: cycles that are simulated before, so that the search begins near a motion that lasts; 10 with `period`,
            none without.
        samples: instants of the cycle that is returned.
        t: of a scene, when the cycle begins [s].
        rtol, solver, max_steps: as in `simulate`; explicit and Rosenbrock methods.
        throw: raise `SimulationError` where no cycle is found.

    Returns:
        The cycle: `.run`, a `Trajectory` over one period, `.period`, `.multipliers`, `.is_stable`, `.harmonics(name)`,
        `.to_xarray()`, `.figure(...)`; prints what it is. Where none is found `.succeeded` is False and `.diagnosis`
        says why.

    Raises:
        SceneError: for a request that makes no sense.

    Warns:
        CycleWarning: where none is found.
    """
    request = asked(what, period, near, at, settle, samples, t)
    with waiting_for("a cycle", program="over_spans"):
        family, start = begun(what, {}, request, rtol=rtol, solver=solver, max_steps=max_steps)
        refuse_time(family, request, "steady_cycle")
        found = cycle_from(family, start, request)
    if not found.succeeded:
        if throw:
            found.require_success()
        warnings.warn(f"steady_cycle: {found.diagnosis}", CycleWarning, stacklevel=2)
    return found


class Request(NamedTuple):
    """What is asked for, checked.

    Attributes:
        period: known, or about [s].
        is_driven: whether it is known.
        at: where the search begins.
        settle: cycles that are simulated before.
        samples: of the cycle.
        t: when the cycle begins [s].
    """

    period: float
    is_driven: bool
    at: str
    settle: int
    samples: int
    t: float


def asked(what: Any, period, near, at: str, settle, samples, t, name: str = "steady_cycle") -> Request:
    """The request, checked; `SceneError` says what is wrong."""
    if not isinstance(what, Scene | Trajectory):
        raise SceneError(f"{name}: {type(what).__name__} is no scene and no run; give a Scene or a Trajectory")
    if (period is None) == (near is None):
        raise SceneError(
            f"{name} needs period=, of what drives the mechanism [s], or near=, about how long a cycle of a mechanism "
            "that is left to itself takes [s]; one of both"
        )
    length = period if near is None else near
    real_number("period" if near is None else "near", length)
    if not (is_concrete(length) and 0 < float(length) < np.inf):
        raise SceneError(f"{name}: {'period' if near is None else 'near'} = {length!r} must be a positive time [s]")
    if at not in ("start", "rest"):
        raise SceneError(f"{name}: at={at!r}: the search begins at 'start' or at 'rest'; or give a run, for its end")
    settle = (10 if near is None else 0) if settle is None else settle
    if isinstance(settle, bool) or not isinstance(settle, int | np.integer) or settle < 0:
        raise SceneError(f"{name}: settle = {settle!r} must be a number of cycles, 0 or more")
    samples = whole_number("samples", samples, "Leave it out for 256.")
    if samples < 8:
        raise SceneError(f"{name}: samples = {samples} are too few to see a cycle by; take 8 or more, e.g. 256")
    real_number("t", t)
    begin = float(t)
    if isinstance(what, Trajectory):
        if not is_concrete(what.ys) or np.ndim(what.ys) != 2:
            raise SceneError(f"{name} takes a single run outside of jit, vmap and grad; take one lane of the batch")
        if int(what.ended) != Status.SUCCEEDED:
            raise SceneError(f"{name}: the run did not reach its end: {what.diagnosis}")
        begin = float(what.ts[-1])
    return Request(float(length), near is None, at, int(settle), samples, begin)


def begun(
    what: Scene | Trajectory, values: Mapping[str, float], request: Request, *, build=None, rtol, solver, max_steps
) -> tuple[Family, np.ndarray]:
    """The family of scenes, and the flat state at which a search begins."""
    if isinstance(what, Trajectory):
        family = Family(_Of(what), values, rtol=rtol, solver=solver, max_steps=max_steps)
        return family, np.asarray(what.ys[-1])
    family = Family(build or _Of(what), values, rtol=rtol, solver=solver, max_steps=max_steps)
    return family, start_of(what, family, request)


class _Of:
    """A builder of one scene, or of what a run is of."""

    def __init__(self, what: Any):
        self.what = what

    def __call__(self) -> Any:
        return self.what


def start_of(scene: Scene, family: Family, request: Request) -> np.ndarray:
    """The flat state where a scene starts, or rests."""
    whole = equilibrium(scene, t=request.t).scene if request.at == "rest" else scene
    system = compile_scene(whole).system
    assembly = start_now(system, np.array([request.t, request.t + request.period]), stacklevel=5)
    assert assembly is not None
    return np.asarray(initial_state(system, assembly))


def refuse_time(family: Family, request: Request, name: str) -> None:
    """Refuse to look for the period of something that prescribes one."""
    if not request.is_driven and family.knows_time:
        raise SceneError(
            f"{name}: near= looks for the period of a mechanism that is left to itself, and here something depends on "
            "time (a driver, a force, a road). Give its period="
        )


def cycle_from(family: Family, start: np.ndarray, request: Request, values: np.ndarray | None = None) -> Cycle:
    """The cycle that is found from a state."""
    numbers = np.zeros((1, 0)) if values is None else values[None]
    place = CandidateState(start[None], np.array([request.period]), numbers)
    if request.settle:
        ends, _ = settled(family, place, request.t, request.settle)
        place = place._replace(y=ends)
    shooting = Shooting(family, request.t)
    found = search(
        shooting, place, tolerance=TOLERANCE * family.rtol, unknown_period=not request.is_driven
    )[0]  # fmt: skip
    return made(family, found, request)


LOOKED_AT = 5
"""Instants of a cycle at which it is tested that a period later the equations are the same."""

ALIKE = 1e-7
"""By how much they may differ, as a share of the largest accelerations, and of the mechanism."""


def why_not_periodic(family: Family, place: CandidateState, run: Trajectory, begin: float) -> str:
    """Why the equations of motion are others a period later; empty where they are the same."""
    if not family.knows_time:
        return ""
    theta = np.repeat(family.theta(place.values), LOOKED_AT, 0)
    chosen = np.linspace(0, len(run.ts) - 1, LOOKED_AT + 2).round().astype(int)[1:-1]
    ts, ys = np.asarray(run.ts)[chosen], np.asarray(run.ys)[chosen]
    period = float(place.period[0])
    now, then = (family.looked_at(theta, times, ys) for times in (ts, ts + period))
    largest = np.abs(now.rate).max(initial=0.0) or 1.0
    apart = max(np.abs(then.rate - now.rate).max() / largest, np.abs(then.y - now.y).max() / max(1.0, np.abs(ys).max()))
    if apart <= ALIKE:
        return ""
    return (
        f"what drives the mechanism does not repeat itself after {period:.9g} s: a period later the equations of "
        f"motion are others (by {apart:.2g} of the largest rate). Give the period of all drivers, forces and "
        "roads together"
    )


def made(family: Family, found: SearchOutcome, request: Request) -> Cycle:
    """The cycle of what a search has found."""
    shot = found.shot
    place = stacked_places([shot.place])
    run = motions(family, place, request.t, request.samples)[0]
    why = found.why or why_not_periodic(family, place, run, request.t)
    if found.is_cycle and not request.is_driven and shot.size <= 2e-7 * Shooting(family, request.t).scale:
        why = (
            "the mechanism rests there, and a rest repeats itself after any time; begin farther from it, on the motion "
            "that is looked for"
        )
    return Cycle(
        run=run,
        period=float(shot.place.period),
        multipliers=Multipliers.of(shot.monodromy, family.knows_time, family.rtol, shot.doubt),
        succeeded=not why,
        diagnosis=why,
        error=shot.error,
        n_steps=found.n_steps,
        is_driven=request.is_driven,
        values=dict(zip(family.names, map(float, shot.place.values), strict=True)),
    )
