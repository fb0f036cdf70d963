"""What a period makes of small deviations: integrated beside the motion, or from starts that are disturbed.

Of an explicit method the deviations are rows below the state, and their errors are controlled. Of an implicit one they
would be the derivatives of its steps, which hold second derivatives of all forces: the slider-crank on rubber took four
minutes to compile with one of them, and a thousand times as long to run as without. There each deviation v is the
difference of runs in lanes, from starts that are disturbed along it to both sides by h and 2 h,

    D(h) = (S(x + h v) - S(x - h v)) / 2h,    dS/dx v = (4 D(h) - D(2h)) / 3,

and 4 |D(h) - D(2h)| / 3 is taken for the error of the result: four times that of D(h), more than enough where all is
smooth; where runs depart by steps that are repeated, or contacts that come and go, D(h) is off by something like the
difference itself, and has a weight of 4/3 in the result.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.motion.integration.spans import Jobs
from spherejax.motion.integration.status import Status
from spherejax.motion.solvers.traits import is_linearly_implicit
from spherejax.studies.cycles.changes import between, changes_of, displaced, slopes_of
from spherejax.studies.cycles.family import Family

DISTURBANCE = 1e-6
"""h, as a share of the mechanism's length (for a number, of the change that is asked about): a thousandth or so of a
clearance, and so long that rounding leaves eight digits. Runs that differ as little take the same steps, so that what
is differenced is as smooth as the motion."""

SIDES = (1.0, -1.0, 2.0, -2.0)
"""Multiples of h by which a start is disturbed."""


class Deviations(NamedTuple):
    """What is disturbed, of one state.

    Attributes:
        states: changes of the state, as columns, world axes.
        by_number: change of the start with the number.
        numbers: change of all numbers of the system with it.
    """

    states: Float[np.ndarray, "n_z k"]
    by_number: Float[np.ndarray, " n_z"]
    numbers: Float[np.ndarray, " t"]


class Period(NamedTuple):
    """What a period makes of one state.

    Attributes:
        ys: flat states on the way.
        end: the last one.
        changes: of it, by the deviations of the state, then by that of the number.
        doubt: their errors, as far as is known; zero where they are integrated.
        status: integer of `Status`.
        t_reached: share of the period that was reached.
    """

    ys: Float[np.ndarray, "n size"]
    end: Float[np.ndarray, " size"]
    changes: Float[np.ndarray, "n_z k+1"]
    doubt: Float[np.ndarray, "n_z k+1"]
    status: int
    t_reached: float


def periods(
    family: Family, places, deviations: list[Deviations], *, begin: float, scale: float, by, made, shares: np.ndarray
) -> list[Period]:
    """Integrate over a period, with what becomes of deviations.

    Args:
        family: the scenes.
        places: states on the constraints, several.
        deviations: of each of them.

    Other args:
        begin: when the period begins [s].
        scale: a length of the mechanism in the unit of the deviations.
        by: change of the numbers of the family; None for none.
        made: which of the states are wanted.
        shares: of the period at which states are kept.
    """
    run = _disturbed if is_linearly_implicit(family.choice.solver) else _integrated
    return run(family, places, deviations, begin=begin, scale=scale, by=by, made=made, shares=shares)


def _integrated(family: Family, places, deviations, *, begin, scale, by, made, shares) -> list[Period]:
    """As rows below the state."""
    del scale, by
    layout, n = family.layout, len(places.y)
    theta = _known(family, places.values)
    width = max(each.states.shape[1] for each in deviations)
    # Where constraints leave different numbers of directions free, rows of nothing fill up.
    rows = np.zeros((n, width + 2, layout.size))
    directions = np.zeros((n, width + 1, theta.shape[1]))
    for k, each in enumerate(deviations):
        own = slopes_of(layout, places.y[k], each.states)
        rows[k, 0], rows[k, 1 : 1 + len(own)] = places.y[k], own
        rows[k, -1] = slopes_of(layout, places.y[k], each.by_number[:, None])[0]
        directions[k, -1] = each.numbers
    rows[:, 0, layout.work_start :] = 0.0
    jobs = Jobs(theta, rows, directions, np.full(n, begin), places.period, made)
    found = family.flown(jobs, shares, with_rows=True)
    ends = np.where(np.isfinite(found.ys[:, -1]), found.ys[:, -1], rows)
    periods = []
    for k, each in enumerate(deviations):
        chosen = [*range(each.states.shape[1]), width]
        changes = changes_of(layout, ends[k, 0], ends[k, 1:][chosen])
        status, reached = int(found.status[k]), float(found.t_reached[k])
        periods.append(
            Period(np.asarray(found.ys[k, :, 0]), ends[k, 0], changes, np.zeros(changes.shape), status, reached)
        )
    return periods


def _disturbed(family: Family, places, deviations, *, begin, scale, by, made, shares) -> list[Period]:
    """From starts to both sides; all of them at once."""
    layout = family.layout
    y0, values, owner, first = [], [], [], []
    for k, each in enumerate(deviations):
        here, numbers = np.array(places.y[k]), np.asarray(places.values[k])
        here[layout.work_start :] = 0.0
        first.append(len(y0))
        y0.append(here)
        values.append(numbers)
        for h in DISTURBANCE * np.array(SIDES):
            y0 += [displaced(layout, here, scale * h * column) for column in each.states.T]
            values += [numbers] * each.states.shape[1]
            if by is not None:
                y0.append(displaced(layout, here, h * each.by_number))
                values.append(numbers + h * by)
        owner += [k] * (len(y0) - len(owner))
    n, wanted = len(y0), np.asarray(made)[owner]
    theta = _known(family, np.stack(values))
    jobs = Jobs(
        theta,
        np.stack(y0),
        np.zeros((n, 0, theta.shape[1])),
        np.full(n, begin),
        np.asarray(places.period)[owner],
        wanted,
    )
    found = family.flown(jobs, shares, with_rows=False)
    lasts = np.where(np.isfinite(found.ys[:, -1]), found.ys[:, -1], np.stack(y0))
    periods = []
    for k, each in enumerate(deviations):
        at, width = first[k], each.states.shape[1] + (by is not None)
        lanes = slice(at, at + 1 + len(SIDES) * width)
        steps = np.full(width, DISTURBANCE * scale)
        if by is not None:
            steps[-1] = DISTURBANCE
        ends = between(layout, lasts[at], lasts[lanes][1:]).reshape(len(SIDES), width, -1)
        near, far = ((ends[i] - ends[i + 1]).T / (2 * abs(SIDES[i]) * steps) for i in (0, 2))
        changes, doubt = (4 * near - far) / 3, 4 * (near - far) / 3
        if by is None:
            nothing = np.zeros((len(changes), 1))
            changes, doubt = (np.concatenate([each, nothing], 1) for each in (changes, doubt))
        worst = at + int(np.argmax(found.status[lanes] != Status.SUCCEEDED))
        status, reached = int(found.status[worst]), float(found.t_reached[worst])
        periods.append(Period(np.asarray(found.ys[at]), lasts[at], changes, doubt, status, reached))
    return periods


def _known(family: Family, values) -> np.ndarray:
    """All numbers of the systems, with something in place of those that are not finite: such runs are not made."""
    theta = family.theta(np.asarray(values))
    return np.where(np.isfinite(theta), theta, 1.0)
