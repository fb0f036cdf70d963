"""EMPS: a prismatic drive with dry friction in closed loop, simulated with the measured reference.

The motor's force is `FORCE` times its voltage, and the voltage is that of the two loops,

    voltage = SPEED_GAIN (POSITION_GAIN (reference - position) - speed),

in continuous time, or held for a millisecond from each sample on.
"""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt

import spherejax as sj
from measured.comparing import BLUE, GRAY, ORANGE, Part, fitted, number_rows, predicted, root_mean_squares
from measured.records import Record, read, state_at

FORCE, POSITION_GAIN, SPEED_GAIN = 35.15065, 160.18, 243.45
"""Force of the motor by its voltage [N/V], gains of the loops [1/s, V s/m]."""

PUBLISHED = {"mass": 95.1089, "viscous": 203.5034, "coulomb": 20.3935, "offset": -3.1648}
SPEED = 1e-4
"""Sliding speed at which three quarters of the dry friction act [m/s]."""

SPEEDS = (0.02, 0.0415, 0.083, 0.125)
"""Where a table of friction has its points [m/s]: the last three are the speeds at which the carriage is driven."""

AXIS = (1.0, 0.0, 0.0)


def reference_of(times, positions, tolerance=1e-6):
    """The reference as the integral of a speed that goes in straight lines between few instants.

    The longest pieces that a parabola follows to `tolerance` [m]; instants where the speeds of neighbours are equal;
    one least-squares fit of the speeds there. 24,000 points in a `Table` would be 24,000 comparisons in each evaluation
    of the equations.

    Returns:
        Instants [s], speeds there [m/s], the position at the first [m], and the positions at `times`.
    """
    ends = [0]
    while ends[-1] < len(times) - 1:
        ends.append(_longest(times, positions, ends[-1], tolerance))
    # The borders of the pieces are late by the samples that the tolerance lets pass: the lines are of the interiors.
    interiors = [(a + (b - a) // 8, b - (b - a) // 8) for a, b in pairwise(ends)]
    lines = [
        np.polynomial.Polynomial.fit(times[a : b + 1], positions[a : b + 1], 2).convert().deriv() for a, b in interiors
    ]
    crossings = [(right - left).roots()[0] for left, right in pairwise(lines)]
    knots = np.array([times[0], *crossings, times[-1]])
    grid = np.union1d(times, knots)
    hats = np.stack([np.interp(grid, knots, row) for row in np.eye(len(knots))], 1)
    integrals = np.zeros_like(hats)
    integrals[1:] = np.cumsum(np.diff(grid)[:, None] * (hats[1:] + hats[:-1]) / 2, 0)
    columns = np.column_stack([integrals[np.searchsorted(grid, times)], np.ones(len(times))])
    fitted = np.linalg.lstsq(columns, positions, rcond=None)[0]
    return knots, fitted[:-1], fitted[-1], columns @ fitted


def _longest(times, positions, first, tolerance):
    """The last sample of the longest piece from `first` on: its length is doubled, then bisected."""
    most, n = len(times) - 1 - first, 4
    while n < most and _is_parabola(times, positions, first, n, tolerance):
        n *= 2
    low, high = min(n // 2, most), min(n, most)
    if _is_parabola(times, positions, first, high, tolerance):
        return first + high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if _is_parabola(times, positions, first, middle, tolerance) else (low, middle)
    return first + max(low, 1)


def _is_parabola(times, positions, first, n, tolerance):
    """Whether a parabola follows a piece of n samples; at most 60 of them are looked at."""
    chosen = first + np.unique(np.linspace(0, n, min(n + 1, 60)).astype(int))
    columns, y = np.vander((times[chosen] - times[first]) / (times[first + n] - times[first]), 3), positions[chosen]
    return np.max(np.abs(columns @ np.linalg.lstsq(columns, y, rcond=None)[0] - y)) < tolerance


def loop(travel, wanted, gain, period, first_sample, of_rate=False):
    """A loop with one gain: in continuous time, or one that samples and holds."""
    if period is None:
        return sj.PID(travel, wanted, proportional=gain, of_rate=of_rate)
    return sj.forces.SampledPID(travel, period, wanted, proportional=gain, of_rate=of_rate, first_sample=first_sample)


def drive(
    reference, start, rate, *, mass, viscous=0.0, coulomb, offset=0.0, period=None, first_sample=0.0, by_speed=None,
):  # fmt: skip
    """The carriage between its two loops.

    Args:
        reference: instants [s], speeds [m/s], and the position at the first [m].
        start, rate: position [m] and speed [m/s] at the start.
        mass, viscous, coulomb, offset: [kg, N s/m, N, N].
        period: of the digital loops [s]; None for loops in continuous time.
        first_sample: of the digital loops [s].
        by_speed: friction beside the dry one at `SPEEDS` [N], the same in both directions.
    """
    knots, speeds, begin = reference
    travel = sj.Travel(("ground", "carriage"), AXIS)
    stiffness = FORCE * SPEED_GAIN * POSITION_GAIN
    wanted = sj.functions.Integral(sj.functions.Table(knots, speeds), begin - start, origin=knots[0])
    carriage = sj.Body(mass, (1.0, 1.0, 1.0), (start, 0.0, 0.0), velocity=(rate, 0.0, 0.0))
    forces = {
        "position_loop": loop(travel, wanted, stiffness, period, first_sample),
        "speed_loop": loop(travel, 0.0, FORCE * SPEED_GAIN, period, first_sample, of_rate=True),
        "resistance": sj.PID(travel, 0.0, proportional=viscous, offset=-offset, of_rate=True),
    }
    # The gain of a controlled rate of 0 is a viscous resistance.
    ends = "ground", "carriage"
    if by_speed is not None:
        table = sj.functions.SmoothTable([-x for x in reversed(SPEEDS)] + [0.0, *SPEEDS], _odd(jnp.asarray(by_speed)))
        forces["friction_by_speed"] = sj.SpringDamper(ends, damper=table, direction=AXIS)
    law = sj.Threlfall(mu=1.0, v1=SPEED)
    model = sj.Ideal(friction=law, pressure=sj.laws.PreloadAlone(), preload_force=coulomb)
    rails = {"rail": sj.Prismatic(ends, (0.0, 0.0, 0.0), AXIS, model)}
    return sj.Scene({"carriage": carriage}, rails, forces, gravity=(0.0, 0.0, 0.0))


def _odd(values):
    return jnp.concatenate([-values[::-1], jnp.zeros(1), values])


def position(run):
    """Of the carriage [m]."""
    return run.position("carriage")[:, 0]


def voltage(run):
    """Of the motor [V]."""
    return (run.force("position_loop")["effort"] + run.force("speed_loop")["effort"]) / FORCE


FUNCTIONS = {"position": position, "voltage": voltage}
UNITS = {"mass": "kg", "viscous": "N s/m", "coulomb": "N", "offset": "N"}
NOISE = {"position": 3e-6, "voltage": 0.08}
"""What the published numbers leave unexplained [m, V]."""

MIDDLE = 12.42
"""Where the record is divided [s]: two of its four repetitions on either side."""

PERIOD = 1e-3
"""Of the loops, as the record is sampled [s]."""

EVERY = 10
BODY = {"mass": 80.0, "coulomb": 15.0}
OFFSET = {"offset": sj.Parameter(-1.0, scale=1.0)}
TABLE = {"by_speed": sj.Parameter([4.0, 8.0, 16.0, 24.0], scale=5.0, positive=False)}
FOUR = "Coulomb, viscous"
MODELS: dict[str, dict[str, Any]] = {
    FOUR: {**BODY, "viscous": 150.0, **OFFSET},
    "table by speed": {**BODY, **OFFSET, **TABLE},
}
"""What is fitted with each friction, and where the fit begins."""


def half_of(record: Record, number: int) -> Record:
    """The first or the second half, every tenth sample."""
    return record.part(*((0.0, MIDDLE - 1e-3), (MIDDLE, record.times[-1]))[number], every=EVERY)


def build_for(record: Record, reference, number: int, period):
    """From the four numbers to the drive at the beginning of a half."""
    begin = half_of(record, number).times[0]
    values, rates = state_at(record, begin, 0.012)
    start, rate = float(values[0]), float(rates[0])

    def build(**numbers):
        return drive(reference, start, rate, **numbers, period=period, first_sample=begin)

    return build


def study(folder: Path) -> Iterator[Part]:
    """The other half of the record as each half predicts it, by several friction laws, and by the published numbers."""
    record = read(folder, "emps_estimation.csv")
    *reference, _ = reference_of(record.times, record.values[:, 1])
    halves = [half_of(record, number) for number in (0, 1)]
    measured = [half.values[:, [0, 2]] for half in halves]
    predictions, errors = [], {}
    for kind, period in (("published, continuous loops", None), ("published, digital loops", PERIOD)):
        for number, name in enumerate(HALVES):
            build = build_for(record, tuple(reference), number, period)
            run = predicted(build(**PUBLISHED), halves[number].times, FUNCTIONS, rtol=1e-6)
            errors[kind, number] = run - measured[number]
            predictions.append(_row(kind, "the whole", name, errors[kind, number], measured[number]))
    experiments = [
        sj.Measured(
            half.times,
            dict(zip(FUNCTIONS, values.T, strict=True)),
            functions=FUNCTIONS,
            build=build_for(record, tuple(reference), number, PERIOD),
            t0=half.times[0],
            name=HALVES[number],
        )
        for number, (half, values) in enumerate(zip(halves, measured, strict=True))
    ]
    numbers, laws = [], []
    for model, start in MODELS.items():
        for number, other in ((0, 1), (1, 0)):
            fit, search = fitted(
                experiments[number].build,
                start,
                experiments[number],
                validate=experiments[other],
                noise=NOISE,
                rtol=1e-6,
            )
            validation = fit.validation
            assert validation is not None
            seen = fit.tables[0] * np.array([*NOISE.values()])
            errors[model, other] = np.stack([*validation.differences[HALVES[other]].values()], 1)
            for place, these in ((number, seen), (other, errors[model, other])):
                predictions.append(_row(f"own, {model}", HALVES[number], HALVES[place], these, measured[place]))
            if model == FOUR:
                numbers += number_rows(f"{HALVES[number]}, {search.runs} runs", fit, UNITS, PUBLISHED)
            laws.append(_law_row(model, HALVES[number], start, fit, search))
        # Written after each model, for they take minutes.
        yield "numbers", numbers
        yield "predictions", predictions
        yield "friction", laws
        if model == FOUR:
            yield "figure", _figure(halves[1], measured[1], errors)


HALVES = ("first half", "second half")


def _law_row(model, half, start, fit, search) -> dict[str, object]:
    texts = []
    for name in start:
        values = np.atleast_1d(np.asarray(fit.estimates[name]))
        texts.append(f"{name} {' '.join(f'{value:.4g}' for value in values)}")
    return {
        "model": model,
        "fitted_to": half,
        "estimates": "; ".join(texts),
        "runs": search.runs,
        "processor_seconds": f"{search.seconds:.1f}",
    }


def _row(model, fitted_to, predicted_part, errors, values) -> dict[str, object]:
    sizes = root_mean_squares(errors)
    relative = 100 * np.linalg.norm(errors, axis=0) / np.linalg.norm(values, axis=0)
    return {
        "model": model,
        "fitted_to": fitted_to,
        "simulated": predicted_part,
        "position_um": f"{1e6 * float(sizes[0]):.2f}",
        "voltage_V": sizes[1],
        "position_percent": f"{relative[0]:.2g}",
        "voltage_percent": f"{relative[1]:.3g}",
    }


def _figure(half, values, errors):
    """The second half as the first predicts it: voltage of one repetition, and errors."""
    figure, (voltages, ahead, wrong) = plt.subplots(3, 1, figsize=(9, 8), sharex=True, layout="constrained")
    times = half.times
    inside = (times > 12.5) & (times < 18.7)
    own = values + errors[FOUR, 1]
    voltages.plot(times[inside], values[inside, 1], color=GRAY, linewidth=1.5, label="record")
    voltages.plot(
        times[inside], own[inside, 1], color=BLUE, linewidth=0.8, label="predicted by a fit to the first half"
    )
    voltages.set_title("motor voltage [V]", loc="left")
    voltages.legend(loc="lower right", ncols=2, fontsize=8, bbox_to_anchor=(1.0, 1.0))
    for name, kind, color in (
        ("published numbers, continuous loops", "published, continuous loops", ORANGE),
        ("own numbers of the first half, digital loops", FOUR, BLUE),
    ):
        these = errors[kind, 1][inside]
        ahead.plot(times[inside], these[:, 1], color=color, linewidth=0.7, label=name)
        wrong.plot(times[inside], 1e6 * these[:, 0], color=color, linewidth=0.7, label=name)
    ahead.set_title("error of the voltage [V]", loc="left")
    ahead.legend(loc="lower right", ncols=2, fontsize=8, bbox_to_anchor=(1.0, 1.0))
    wrong.set_title("error of the position [um]", loc="left")
    wrong.set(xlabel="t [s]")
    return figure
