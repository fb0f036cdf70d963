"""EMPS: a prismatic drive with dry friction in closed loop, simulated with the measured reference.

The motor's force is `FORCE` times its voltage, and the voltage is that of the two loops,

    voltage = SPEED_GAIN (POSITION_GAIN (reference - position) - speed),

in continuous time, or held for a millisecond from each sample on.
"""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

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
    return sj.SampledPID(travel, period, wanted, proportional=gain, of_rate=of_rate, first_sample=first_sample)


def drive(reference, start, rate, *, mass, viscous, coulomb, offset, period=None, first_sample=0.0):
    """The carriage between its two loops.

    Args:
        reference: instants [s], speeds [m/s], and the position at the first [m].
        start, rate: position [m] and speed [m/s] at the start.
        mass, viscous, coulomb, offset: [kg, N s/m, N, N].
        period: of the digital loops [s]; None for loops in continuous time.
        first_sample: of the digital loops [s].
    """
    knots, speeds, begin = reference
    travel = sj.Travel(("ground", "carriage"), AXIS)
    stiffness = FORCE * SPEED_GAIN * POSITION_GAIN
    wanted = sj.Integral(sj.Table(knots, speeds), begin - start, origin=knots[0])
    carriage = sj.Body(mass, (1.0, 1.0, 1.0), (start, 0.0, 0.0), velocity=(rate, 0.0, 0.0))
    forces = {
        "position_loop": loop(travel, wanted, stiffness, period, first_sample),
        "speed_loop": loop(travel, 0.0, FORCE * SPEED_GAIN, period, first_sample, of_rate=True),
        "resistance": sj.PID(travel, 0.0, proportional=viscous, offset=-offset, of_rate=True),
    }
    # The gain of a controlled rate of 0 is a viscous resistance.
    rails = {"rail": sj.Prismatic(("ground", "carriage"), (0.0, 0.0, 0.0), AXIS, rail_with(coulomb))}
    return sj.Scene({"carriage": carriage}, rails, forces, gravity=(0.0, 0.0, 0.0))


def rail_with(coulomb):
    """A rail with constant dry friction [N]."""
    return sj.Ideal(friction=sj.Threlfall(mu=1.0, v1=SPEED), pressure=sj.PreloadAlone(), preload_force=coulomb)


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
START = {"mass": 80.0, "viscous": 150.0, "coulomb": 15.0, "offset": sj.Parameter(-1.0, scale=1.0)}


def half_of(record: Record, number: int) -> Record:
    """The first or the second half, every tenth sample."""
    return record.part(*((0.0, MIDDLE - 1e-3), (MIDDLE, record.times[-1]))[number], every=EVERY)


def build_for(record: Record, reference, number: int, period):
    """From the four numbers to the drive at the beginning of a half."""
    begin = half_of(record, number).times[0]
    values, rates = state_at(record, begin, 0.012)
    start, rate = float(values[0]), float(rates[0])

    def build(mass, viscous, coulomb, offset):
        friction = {"viscous": viscous, "coulomb": coulomb, "offset": offset}
        return drive(reference, start, rate, mass=mass, **friction, period=period, first_sample=begin)

    return build


def study(folder: Path) -> Iterator[Part]:
    """Four numbers from each half of the record, and the other half predicted by them and by the published ones."""
    record = read(folder, "emps_estimation.csv")
    *reference, _ = reference_of(record.times, record.values[:, 1])
    halves = [half_of(record, number) for number in (0, 1)]
    measured = [half.values[:, [0, 2]] for half in halves]
    continuous = [build_for(record, tuple(reference), number, None) for number in (0, 1)]
    builds = [build_for(record, tuple(reference), number, PERIOD) for number in (0, 1)]
    numbers, predictions, shown = [], [], {}
    for number, name in enumerate(("first half", "second half")):
        for kind, those in (("published, continuous loops", continuous), ("published, digital loops", builds)):
            run = predicted(those[number](**PUBLISHED), halves[number].times, FUNCTIONS, rtol=1e-6)
            predictions.append(_row(kind, "the whole", name, run - measured[number], measured[number]))
            shown[kind, number] = run
    for number, other, name, other_name in ((0, 1, "first half", "second half"), (1, 0, "second half", "first half")):
        times = halves[number].times
        values = dict(zip(FUNCTIONS, measured[number].T, strict=True))
        experiment = sj.Measured(times, values, functions=FUNCTIONS, noise=NOISE, t0=times[0])
        fit, search = fitted(builds[number], START, experiment, rtol=1e-6)
        numbers += number_rows(f"{name}, {search.runs} runs", fit, UNITS, PUBLISHED)
        for place, where in ((number, name), (other, other_name)):
            run = predicted(builds[place](**fit.estimates), halves[place].times, FUNCTIONS, rtol=1e-6)
            predictions.append(_row("own, digital loops", name, where, run - measured[place], measured[place]))
            shown[name, place] = run
    yield "numbers", numbers
    yield "predictions", predictions
    yield "figure", _figure(halves[1], measured[1], shown)


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


def _figure(half, values, shown):
    """The second half as the first predicts it: voltage of one repetition, and errors."""
    figure, (voltages, ahead, wrong) = plt.subplots(3, 1, figsize=(9, 8), sharex=True, layout="constrained")
    own, times = shown["first half", 1], half.times
    inside = (times > 12.5) & (times < 18.7)
    voltages.plot(times[inside], values[inside, 1], color=GRAY, linewidth=1.5, label="record")
    voltages.plot(
        times[inside], own[inside, 1], color=BLUE, linewidth=0.8, label="predicted by a fit to the first half"
    )
    voltages.set_title("motor voltage [V]", loc="left")
    voltages.legend(loc="lower right", ncols=2, fontsize=8, bbox_to_anchor=(1.0, 1.0))
    for name, run, color in (
        ("published numbers, continuous loops", shown["published, continuous loops", 1], ORANGE),
        ("own numbers of the first half, digital loops", own, BLUE),
    ):
        errors = (run - values)[inside]
        ahead.plot(times[inside], errors[:, 1], color=color, linewidth=0.7, label=name)
        wrong.plot(times[inside], 1e6 * errors[:, 0], color=color, linewidth=0.7, label=name)
    ahead.set_title("error of the voltage [V]", loc="left")
    ahead.legend(loc="lower right", ncols=2, fontsize=8, bbox_to_anchor=(1.0, 1.0))
    wrong.set_title("error of the position [um]", loc="left")
    wrong.set(xlabel="t [s]")
    return figure
