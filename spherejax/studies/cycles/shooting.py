"""Shooting: a state that comes back to itself after a period, found by Newton's method on independent coordinates.

With S(x; T, p) the flow over a period T in the independent coordinates x = (x, u, memory) of `linear.coordinates`, a
cycle is a root of r = S(x) - x. One integration gives S with its derivative M (the monodromy matrix) and those by a
number p, beside it or from disturbed starts (`disturbed`). Where the period is unknown, it is one unknown more, with
the column T f. Each step

    [M - 1, T f, dS/dp] (dx, dT/T, dp) = -r

is the least one that solves it, by singular values: it moves across the orbit and along no direction that is free, and
so serves a period that is unknown, conservative oscillators (two multipliers of 1), neutral positions, and the
corrector of a continuation alike. A step that makes r larger is halved.

Source: R. Seydel, Practical Bifurcation and Stability Analysis, 3rd ed. (2010), sections 7.3 to 7.5; the least step is
the Gauss-Newton corrector of E. Allgower and K. Georg, Numerical Continuation Methods (1990), chapter 3.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from spherejax.motion.integration.spans import Jobs
from spherejax.motion.integration.status import REMEDIES, Status
from spherejax.motion.start.tolerances import ABSOLUTE_SHARE, length_scale
from spherejax.studies.cycles.changes import between, changes_of, displaced
from spherejax.studies.cycles.disturbed import Deviations, Period, periods
from spherejax.studies.cycles.family import Family
from spherejax.studies.linear.coordinates import Coordinates, coordinates_of
from spherejax.studies.linear.following import yielding
from spherejax.studies.linear.tangent import Geometry

MOST_STEPS = 30
"""Newton steps, those that are halved included."""

LARGEST_GROWTH = 1.2
"""A step is taken back, and half of it tried, where r becomes larger than this times what it was."""

SINGULAR = 1e-6
"""Singular values below this share of the largest of 1 and |M| are zero: derivatives of a run are good to that."""

CLOSED = 1e-3
"""Newton's method ends where a cycle closes to this share of the tolerance: the next step would be rounding."""

UNLIKE = 1e-6
"""Rates that differ by more than this share of the largest: something depends on how often an angle has gone round."""

SEEN = 16
"""Instants of a cycle at which its size is looked at."""

RESTING = 1e-7
"""A cycle that is smaller than this share of the mechanism is a rest."""


class CandidateState(NamedTuple):
    """A state that may be one of a cycle (of several: a leading axis).

    Attributes:
        y: flat state.
        period: [s].
        values: of the numbers of the family.
    """

    y: Float[np.ndarray, "*n size"]
    period: Float[np.ndarray, "*n"]
    values: Float[np.ndarray, "*n p"]


def stacked_places(places: "list[CandidateState]") -> CandidateState:
    """Several as one."""
    return CandidateState(*(np.stack([np.asarray(each) for each in column]) for column in zip(*places, strict=True)))


class Shot(NamedTuple):
    """What one period makes of a state.

    Attributes:
        place: the state, on the constraints.
        end: flat state after the period.
        coordinates: independent ones about the state, in which all below is, each in its own unit.
        units: of the coordinates.
        chosen: which of the coordinates are unknowns.
        residual: r.
        monodromy: M.
        by_period: T f, by dT/T.
        by_number: derivative of r along the change of numbers asked for.
        start_by_number: derivative of the start's flat state along it, which the constraints ask for.
        size: of the cycle, the largest distance of a state from the first.
        status: integer of `Status`.
        t_reached: share of the period that was reached.
        doubt: error of M (the root of the sum of its squares), where it was found by differences; else 0.
    """

    place: CandidateState
    end: np.ndarray
    coordinates: Coordinates
    units: Float[np.ndarray, " n_x"]
    chosen: np.ndarray
    residual: Float[np.ndarray, " n_x"]
    monodromy: Float[np.ndarray, "n_x n_x"]
    by_period: Float[np.ndarray, " n_x"]
    by_number: Float[np.ndarray, " n_x"]
    start_by_number: Float[np.ndarray, " n_z"]
    size: float
    status: int
    t_reached: float
    doubt: float

    @property
    def error(self) -> float:
        """|r| as a share of the size of the cycle."""
        return float(np.linalg.norm(self.residual)) / self.size if self.status == Status.SUCCEEDED else np.inf

    def moved(self, family: Family, step: Float[np.ndarray, " n_x"], number: float = 0.0) -> np.ndarray:
        """The flat state after a step of the unknowns, and of the number."""
        basis = self.coordinates.basis[:, self.chosen] * self.units
        change = basis @ step + self.start_by_number * number
        return displaced(family.layout, self.place.y, change)

    def seen(self, family: Family, y: np.ndarray) -> Float[np.ndarray, " n_x"]:
        """Coordinates of other states from here."""
        changes = between(family.layout, self.place.y, y)
        return changes @ (self.coordinates.inverse[self.chosen] / self.units[:, None]).T


class Shooting:
    """Shoots from many states at once.

    Args:
        family: the scenes.
        begin: time at which a cycle begins [s].
        by: a change of the numbers along which derivatives are taken; None for none.
        period_of: the period that belongs to the numbers; None where it is the same for all, or free.
    """

    def __init__(
        self,
        family: Family,
        begin: float,
        by: np.ndarray | None = None,
        period_of: Callable[[np.ndarray], float] | None = None,
    ):
        self.family, self.begin, self.by, self.period_of = family, begin, by, period_of
        self.length = float(np.asarray(length_scale(family.example)))
        self.mass = float(sum(np.asarray(body.mass) for body in family.example.bodies.values()))
        layout, entries = family.layout, slice(family.layout.memory_start, family.layout.work_start)
        atol = np.broadcast_to(np.asarray(family.tolerances.atol), (layout.size,))[entries]
        # What counts as one in each entry of the memory, as the tolerances have it.
        memory = atol / (ABSOLUTE_SHARE * family.rtol)
        self.memory_units = np.where(memory > 0, memory, 1.0)
        self.onsets = _onset_entries(family)
        self.turns = _turn_entries(family)

    @property
    def scale(self) -> float:
        """A length of the mechanism in the unit of the coordinates [sqrt(kg) m]."""
        return self.mass**0.5 * self.length

    def shots(self, places: CandidateState, wanted: np.ndarray | None = None) -> list[Shot]:
        """What one period makes of states, with derivatives."""
        family, layout, n = self.family, self.family.layout, len(places.y)
        asked = np.ones(n, bool) if wanted is None else wanted
        theta = family.theta(places.values)
        made = asked & np.all(np.isfinite(theta), axis=1) & np.all(np.isfinite(places.y), axis=1)
        theta = np.where(np.isfinite(theta), theta, 1.0)
        times = np.full(n, self.begin)
        looked = family.looked_at(theta, times, np.nan_to_num(places.y))
        places = places._replace(y=looked.y)
        about: list[tuple[Coordinates, np.ndarray, np.ndarray]] = []
        deviations: list[Deviations] = []
        for k in range(n):
            geometry = Geometry(*(each[k] for each in looked.geometry))
            coordinates = coordinates_of(geometry, layout.n_memory)
            units, chosen = self._units(coordinates, places.y[k], places.period[k])
            number, start = self._number(places.values[k], geometry, coordinates, theta[k], places.y[k])
            about.append((coordinates, units, chosen))
            deviations.append(Deviations(coordinates.basis[:, chosen] * units, start, number))
        shares = np.linspace(0.0, 1.0, SEEN + 1)
        found = periods(
            family, places, deviations, begin=self.begin, scale=self.scale, by=self.by, made=made, shares=shares
        )
        ends = np.stack([one.end for one in found])
        rates = family.looked_at(theta, times + places.period, ends).rate
        wound = self._are_wound(theta, times + places.period, places.y, ends, rates)
        return [
            self._shot(places, k, *about[k], deviations[k], found[k], rates[k], bool(made[k]), bool(wound[k]))
            for k in range(n)
        ]

    def _are_wound(self, theta, times, starts: np.ndarray, ends: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Whether an angle went round within the period, and something depends on how often: a spring is wound up.

        A wheel that its motor drives round and round is where it was, and so is a pair of gears.
        """
        turns = np.round((ends[:, self.turns] - starts[:, self.turns]) / (2 * np.pi))
        went = np.any(np.nan_to_num(turns) != 0, axis=1)
        if not np.any(went):
            return went
        unwound = np.array(ends)
        unwound[:, self.turns] -= 2 * np.pi * turns
        others = self.family.looked_at(theta, times, np.nan_to_num(unwound)).rate
        size = np.max(np.abs(rates), axis=1, initial=1e-300)
        return went & (np.max(np.abs(others - rates), axis=1) > UNLIKE * size)

    def _shot(
        self, places: CandidateState, k: int, coordinates, units, chosen, deviations, found: Period, rate, wanted, wound
    ) -> Shot:
        layout = self.family.layout
        start, last = deviations.by_number, found.end
        place = CandidateState(*(each[k] for each in places))
        inverse = coordinates.inverse[chosen] / units[:, None]
        residual = inverse @ between(layout, place.y, last)
        columns, doubt = inverse @ found.changes, inverse @ found.doubt
        by_period = inverse @ changes_of(layout, last, rate[None])[:, 0] * place.period
        by_number = columns[:, -1] - inverse @ start
        by_number = by_number + by_period * self._period_slope(place.values) / place.period
        size = self._size(coordinates, between(layout, place.y, found.ys), float(place.period))
        status = found.status if wanted else int(Status.BAD_VALUE)
        touching = self.onsets
        if status == Status.SUCCEEDED and np.any((place.y[touching] > 0) != (last[touching] > 0)):
            residual = residual + np.inf  # a ball that touches after the period, and did not before
        if status == Status.SUCCEEDED and wound:
            residual = residual + np.inf
        return Shot(
            place, last, coordinates, units, chosen, residual, columns[:, :-1], by_period, by_number, start, size,
            status, found.t_reached, float(np.linalg.norm(doubt[:, :-1])),
        )  # fmt: skip

    def _size(self, coordinates: Coordinates, changes: np.ndarray, period: float) -> float:
        """The largest of changes, what drivers move included: by the masses, velocities over a turn of the phase."""
        n_v = self.family.layout.n_velocity
        q, v = changes[:, :n_v], changes[:, n_v : 2 * n_v] * period / (2 * np.pi)
        m = changes[:, 2 * n_v :] / self.memory_units * self.scale
        m[:, [entry - self.family.layout.memory_start for entry in self.turns]] = 0.0
        square = sum(np.sum((each @ coordinates.mass) * each, 1) for each in (q, v)) + np.sum(m * m, 1)
        return max(float(np.nan_to_num(np.sqrt(square)).max()), RESTING * self.scale)

    def timed(self, place: CandidateState) -> CandidateState:
        """With the period that belongs to its numbers."""
        return place if self.period_of is None else place._replace(period=np.asarray(self.period_of(place.values)))

    def _period_slope(self, values: np.ndarray) -> float:
        """Derivative of the period along the change, by a central difference: it steers Newton's steps alone."""
        if self.period_of is None or self.by is None:
            return 0.0
        h = 1e-6
        return (self.period_of(values + h * self.by) - self.period_of(values - h * self.by)) / (2 * h)

    def _units(self, coordinates: Coordinates, y: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
        """Of each coordinate what counts as one length of x; and which are unknowns.

        Not the onset of a ball in flight, and not what counts turns: it follows from the orientations.
        """
        f, layout = coordinates.degrees_of_freedom, self.family.layout
        units = np.concatenate([np.ones(f), np.full(f, 2 * np.pi / period), self.memory_units / self.scale])
        chosen = np.ones(len(units), bool)
        for entry in self.onsets:
            chosen[2 * f + entry - layout.memory_start] = y[entry] > 0
        for entry in self.turns:
            chosen[2 * f + entry - layout.memory_start] = False
        return units[chosen], np.flatnonzero(chosen)

    def _number(self, values, geometry, coordinates, theta, y) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all numbers and of the start, which the constraints ask for, along the change asked for."""
        layout = self.family.layout
        none = np.zeros(2 * layout.n_velocity + layout.n_memory)
        if self.by is None or not self.family.names:
            return np.zeros(theta.shape), none
        slope = self.family.theta_slope(values, self.by)
        still = np.zeros(layout.n_velocity)
        held = self.family.held_slope(theta, self.begin, y, slope)
        dq, dv = yielding(geometry, coordinates.least, held, still, still)
        return slope, np.concatenate([dq, dv, np.zeros(layout.n_memory)])


def _onset_entries(family: Family) -> list[int]:
    """Entries of the flat state that say whether a ball touches."""
    system = family.example
    return [family.layout.memory_start + system.memory_of(name).start for name in system.contact_joints]


def _turn_entries(family: Family) -> list[int]:
    """Entries of the flat state that say in which turn an angle is."""
    slots = family.example.all_slots
    entries = [(slot.start + i, entry) for slot in slots for i, entry in enumerate(slot.contents)]
    return [family.layout.memory_start + i for i, entry in entries if entry.counts_turns]


class SearchOutcome(NamedTuple):
    """What became of a search.

    Attributes:
        shot: the last one.
        is_cycle: whether it closes.
        n_steps: Newton steps.
        why: it does not, in words; empty where it does.
    """

    shot: Shot
    is_cycle: bool
    n_steps: int
    why: str


class _CycleSearch:
    """One search, between shots."""

    def __init__(self, place: CandidateState):
        self.place, self.share, self.n, self.is_over = place, 1.0, 0, False
        self.best: Shot | None = None
        self.step: np.ndarray | None = None
        self.last: Shot | None = None


def search(
    shooting: Shooting,
    places: CandidateState,
    *,
    tolerance: float,
    unknown_period: bool = False,
    by_number: bool = False,
) -> list[SearchOutcome]:
    """Newton's method from many states at once.

    Args:
        shooting: what shoots.
        places: where to begin.

    Other args:
        tolerance: |r| as a share of the size of the cycle, below which it counts as one.
        unknown_period: whether the period is found with it.
        by_number: whether the number is an unknown too, as in a corrector.
    """
    searches = [_CycleSearch(CandidateState(*(each[k] for each in places))) for k in range(len(places.y))]
    for _ in range(MOST_STEPS):
        busy = np.array([not each.is_over for each in searches])
        if not busy.any():
            break
        stacked = stacked_places([one.place for one in searches])
        for one, shot, is_busy in zip(searches, shooting.shots(stacked, busy), busy, strict=True):
            if is_busy:
                _advanced(shooting, one, shot, tolerance, unknown_period, by_number)
    return [_judged(shooting, one, tolerance) for one in searches]


def _advanced(shooting: Shooting, one: _CycleSearch, shot: Shot, tolerance: float, unknown_period, by_number) -> None:
    """After a shot: go on from it, or take half of the step."""
    one.n += 1
    one.last = shot
    best: Shot | None = one.best
    if best is not None and not shot.error <= LARGEST_GROWTH * best.error:
        if best.error <= tolerance or one.share < 1e-3:
            one.is_over = True
            return
        one.share /= 4
    elif shot.error <= CLOSED * tolerance or (
        best is not None and best.error <= tolerance and shot.error > 0.3 * best.error
    ):
        # As close as the integration has it.
        one.best, one.is_over = (shot if best is None or shot.error < best.error else best), True
        return
    else:
        if not np.isfinite(shot.error) and best is None:
            one.is_over = True
            return
        one.share = 1.0 if best is None else min(1.0, 2 * one.share)
        one.best, one.step = shot, newton_step(shot, unknown_period, by_number)
    best, step = one.best, one.step
    assert best is not None
    assert step is not None
    n = len(best.residual)
    step = one.share * step
    number = float(step[n + unknown_period]) if by_number else 0.0
    period = best.place.period * np.exp(np.clip(step[n], -0.5, 0.5)) if unknown_period else best.place.period
    values = best.place.values if shooting.by is None else best.place.values + number * shooting.by
    one.place = shooting.timed(CandidateState(best.moved(shooting.family, step[:n], number), period, values))


def newton_step(shot: Shot, unknown_period: bool, by_number: bool) -> np.ndarray:
    """The least step of the unknowns: coordinates, then dT/T, then the number, in the unit of its change."""
    J, units = matrix(shot, unknown_period, by_number)
    left, sizes, right = np.linalg.svd(J, full_matrices=False)
    kept = sizes > max(SINGULAR * max(1.0, sizes[0] if len(sizes) else 1.0), shot.doubt)
    return units * (right[kept].T @ ((left[:, kept].T @ -shot.residual) / sizes[kept]))


def matrix(shot: Shot, unknown_period: bool, by_number: bool) -> tuple[np.ndarray, np.ndarray]:
    """[M - 1, T f, dr/dp] for unknowns that count alike, and their units."""
    # A period longer by its own length, and a number changed by one, count as the size of the cycle.
    more = [shot.by_period] * unknown_period + [shot.by_number] * by_number
    own = shot.monodromy - np.eye(len(shot.residual))
    J = np.concatenate([own, *(column[:, None] / shot.size for column in more)], 1)
    return J, np.concatenate([np.ones(len(own)), np.full(len(more), 1 / shot.size)])


def _judged(shooting: Shooting, one: _CycleSearch, tolerance: float) -> SearchOutcome:
    shot: Shot | None = one.best or one.last
    assert shot is not None
    if shot.error <= tolerance:
        return SearchOutcome(shot, True, one.n, "")
    failed = one.last if one.best is None else None
    if failed is not None and failed.status != Status.SUCCEEDED:
        at = shooting.begin + failed.t_reached * float(failed.place.period)
        remedy = REMEDIES.get(Status(failed.status), "it did not end well")
        return SearchOutcome(shot, False, one.n, f"the integration of a cycle stopped at t = {at:.6g} s: {remedy}")
    if not np.isfinite(shot.error):
        turned = np.abs(shot.end - shot.place.y)[shooting.turns] > np.pi
        return SearchOutcome(shot, False, one.n, WOUND_UP if np.any(turned) else TOUCHES)
    return SearchOutcome(
        shot,
        False,
        one.n,
        f"after {one.n} Newton steps the state after a period is still off by {shot.error:.2g} of the size of the "
        "cycle. Start nearer to it (settle= more cycles, or from a run), or tighten rtol; a motion with impacts may "
        "repeat itself after several periods only, or never",
    )


WOUND_UP = (
    "an angle goes round within the period, and a force depends on how often it has (a spring is wound up): such a "
    "motion does not repeat itself"
)

TOUCHES = (
    "a ball touches its socket after the period and did not before, or the other way round: let the cycle begin at "
    "another time (t=), or settle= for more cycles"
)


def settled(family: Family, places: CandidateState, begin: float, cycles: int) -> tuple[np.ndarray, np.ndarray]:
    """States after so many cycles, and the status of each run."""
    n = len(places.y)
    theta = family.theta(places.values)
    wanted = np.all(np.isfinite(theta), axis=1)
    y0 = np.array(places.y)
    y0[:, family.layout.work_start :] = 0.0
    jobs = Jobs(
        np.where(np.isfinite(theta), theta, 1.0),
        y0,
        np.zeros((n, 0, theta.shape[1])),
        np.full(n, begin),
        places.period * cycles,
        wanted,
    )
    # Whatever repeats itself after a period does not care how many have gone.
    found = family.flown(jobs, np.array([0.0, 1.0]), with_rows=False, cycles=cycles)
    ends = np.where(np.isfinite(found.ys[:, -1]), found.ys[:, -1], found.y_reached)
    return jax.tree.map(np.asarray, (ends, np.where(wanted, found.status, int(Status.BAD_VALUE))))
