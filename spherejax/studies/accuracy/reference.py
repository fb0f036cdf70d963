"""A reference with an error of its own: two runs at a far tighter tolerance, by different methods where possible."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.motion.integration.status import Status
from spherejax.motion.results.global_error import bodies_apart, usual_limit
from spherejax.motion.results.trajectory import Trajectory
from spherejax.studies.accuracy.runs import TimedProgram
from spherejax.studies.accuracy.samples import SampledRun, errors, samples_of, scales, statistics

METHODS = ("Dopri8", "Tsit5", "Rodas5P")
"""Methods of reference runs, in the order in which they are tried: an explicit method of high order is the most exact
where stability does not limit it, and its budget tells."""

STIFF_METHODS = ("Rodas5P", "Dopri8", "Rodas4P")
"""The same for a scene that `simulate` hands to a stiff method."""

TIGHTER = 100.0
"""A reference is asked for this many times the digits of the tightest tolerance; less when that takes too long."""

TIGHTEST = 1e-12
"""Smallest relative tolerance of a reference: below it the absolute tolerance meets rounding, and an explicit
method then needs thirty times the steps and errs more."""

FLOOR_FACTOR = 3.0
"""An error below this many times the reference's own is not resolved."""

AGREED = 1e-4
"""Two tight runs have parted where `run.determined_until` would end: bodies are apart by a hundredth of the smallest
clearance, or a thousandth of the length. Histories count while they agree to this share of that. With a clearance of
0.1 mm they agree to 1e-10 m, and have parted at 1e-6 m."""

FAST_GROWTH = 10.0
"""Runs that need less than this many times the time at which they still agree to part, part exponentially. A difference
that grows like t^p does so only for p > 4; else the reference is merely inexact."""

SHORTEST_HORIZON = 0.02
"""A horizon shorter than this share of the motion is none: the reference is merely inexact."""

N_MEMBERS = 8
"""Runs in the ensemble of a motion that does not repeat, the two reference runs among them."""


@dataclass(frozen=True)
class Reference:
    """What errors are measured against.

    Attributes:
        methods: the two methods.
        rtols: their relative tolerances.
        errors: largest difference of the two runs until the horizon, for each quantity in its unit.
        scales: peak of each quantity until the horizon, in its unit.
        t1: end of the motion [s].
        horizon: until when histories repeat [s]; None when that is the end.
        parted: when the two runs have parted [s]; None when they have not.
        members: statistics of the tight runs from `parted` on; empty for a motion that repeats.
        samples: the first run.
        limit: distance of bodies at which runs have parted [m], that of `run.determined_until`.
    """

    methods: tuple[str, str]
    rtols: tuple[float, float]
    errors: Mapping[str, float]
    scales: Mapping[str, float]
    t1: float
    horizon: float | None
    parted: float | None
    members: Sequence[Mapping[str, float]] = ()
    samples: SampledRun | None = field(default=None, repr=False)
    limit: float = float("nan")

    def floor(self, quantity: str) -> float:
        """Error of a quantity below which the reference says nothing, in the quantity's unit."""
        return FLOOR_FACTOR * self.errors[quantity]

    def __str__(self) -> str:
        runs = " and ".join(f"{name} at rtol {rtol:.0e}" for name, rtol in zip(self.methods, self.rtols, strict=True))
        known = f"Reference: {runs} differ by {self.errors['position']:.1e} m in position"
        if self.horizon is None:
            return f"{known}, {self.errors['acceleration']:.1e} m/s^2 in acceleration."
        return (
            f"This motion does not repeat: two tight runs ({runs}) agree to {AGREED * self.limit:.0e} m "
            f"until {self.horizon:.3g} s and to {self.limit:.0e} m until {self.parted:.3g} s. Errors of histories are "
            f"measured until {self.horizon:.3g} s; later, every history is one of many that are equally right, and "
            f"statistics from {self.parted:.3g} s on are compared with their spread over {len(self.members)} tight "
            "runs."
        )


def make_reference(
    program_by: Callable[[str], TimedProgram], methods: Sequence[str], tightest: float, seconds: float
) -> Reference:
    """Run the reference.

    Args:
        program_by: the measuring program of a method, by name.
        methods: methods to try, in order; the first two that finish are taken.
        tightest: the tightest tolerance of the runs that are to be judged.
        seconds: budget of a reference run [s].

    Raises:
        SceneError: when no method finishes a run at the tightest tolerance.
    """
    for rtol in _ladder(tightest):
        first = _first_finished(program_by, methods, rtol, seconds)
        if first is None:
            continue
        second = _first_finished(program_by, [name for name in methods if name != first[0]], rtol, seconds)
        if second is not None:
            return _compared(program_by, (first, second), (rtol, rtol))
        looser = _first_finished(program_by, [first[0]], 10 * rtol, seconds)
        if looser is not None:
            return _compared(program_by, (first, looser), (rtol, 10 * rtol))
    raise SceneError(
        f"no method finished a reference run at rtol {tightest / 3:.0e} within {seconds:.3g} s. Raise max_seconds, "
        "shorten t1, or ask for looser tolerances"
    )


def _ladder(tightest: float) -> list[float]:
    """Tolerances of the reference, from the best to the poorest that is still tighter than what it judges."""
    return list(dict.fromkeys(max(TIGHTEST, tightest / factor) for factor in (TIGHTER, TIGHTER / 10, 3.0)))


class Finished(NamedTuple):
    """A run that reached its end: its method, the run, its samples."""

    method: str
    run: Trajectory
    samples: SampledRun


def _first_finished(program_by, methods: Sequence[str], rtol: float, seconds: float) -> Finished | None:
    for name in methods:
        program = program_by(name)
        run = program.run(rtol, program.budget(rtol, seconds))
        if int(run.status) == Status.SUCCEEDED and (samples := samples_of(run)).is_finite:
            return Finished(name, run, samples)
    return None


def _compared(program_by, finished: tuple[Finished, Finished], rtols: tuple[float, float]) -> Reference:
    """The reference from its two runs; where they part, the ensemble is added."""
    methods, (first, second) = (finished[0].method, finished[1].method), (one.samples for one in finished)
    system = finished[0].run.system
    apart = bodies_apart(system, finished[0].run.state, finished[1].run.state)
    limit = usual_limit(system)
    horizon, parted = parting(first.ts, np.max(apart, axis=1, initial=0.0), limit)
    members: list[Mapping[str, float]] = []
    if horizon is not None and parted is not None:
        # Tolerances a little looser: other members of the same ensemble, by the program that is compiled already.
        others = (samples_of(program_by(methods[0]).run(rtols[0] * 1.3 ** (k + 1))) for k in range(N_MEMBERS - 2))
        members = [statistics(run, parted) for run in (first, second, *others)]
    return Reference(
        methods,
        rtols,
        errors(second, first, horizon),
        scales(first, horizon),
        float(first.ts[-1]),
        horizon,
        parted,
        tuple(members),
        first,
        limit,
    )


def parting(ts: np.ndarray, difference: np.ndarray, limit: float) -> tuple[float | None, float | None]:
    """Until when two tight runs agree, and have not parted [s]; (None, None) for a motion that repeats.

    Args:
        ts: sample times [s], shape (n,).
        difference: largest distance of the bodies at each sample [m], shape (n,).
        limit: at which they have parted [m]; they agree up to the share `AGREED` of it.
    """
    largest = np.maximum.accumulate(difference)
    if largest[-1] <= limit:
        return None, None
    agreed, parted = (float(ts[max(0, int(np.argmax(largest > level)) - 1)]) for level in (AGREED * limit, limit))
    duration = ts[-1] - ts[0]
    is_fast = parted - ts[0] < FAST_GROWTH * (agreed - ts[0])
    return (agreed, parted) if is_fast and agreed - ts[0] >= SHORTEST_HORIZON * duration else (None, None)
