"""The efficient runs among many, what an accuracy costs, and the sentence that says so."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np


class FrontierPoint(NamedTuple):
    """A run in the plane of error and time.

    Attributes:
        solver: its name.
        rtol: relative tolerance.
        error: achieved error; at least what the reference resolves.
        seconds: time of a run [s].
    """

    solver: str
    rtol: float
    error: float
    seconds: float


class Price(NamedTuple):
    """What an error costs.

    Attributes:
        solver: the solver that gets there first.
        rtol: its tolerance, interpolated.
        error: the error.
        seconds: time of a run, interpolated [s].
    """

    solver: str
    rtol: float
    error: float
    seconds: float


def efficient(points: Sequence[FrontierPoint]) -> list[FrontierPoint]:
    """The points that no other beats in both error and time, from the largest error to the smallest."""
    kept: list[FrontierPoint] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error)):
        if not kept or point.error < kept[-1].error:
            kept.append(point)
    return kept


def price(points: Sequence[FrontierPoint], error: float) -> Price | None:
    """The shortest time in which one of the solvers reaches an error; None where none does.

    Along the efficient points of one solver, log(seconds) and log(rtol) are interpolated linearly in log(error). A
    solver whose loosest run is better than asked for costs what that run costs.
    """
    offers = []
    for solver in dict.fromkeys(point.solver for point in points):
        curve = efficient([point for point in points if point.solver == solver])
        if curve[-1].error > error * (1 + 1e-9):
            continue
        logs = np.log([(p.error, p.seconds, p.rtol) for p in curve])[::-1].T  # np.interp needs increasing errors
        seconds, rtol = (float(np.exp(np.interp(np.log(error), logs[0], logs[i]))) for i in (1, 2))
        offers.append(Price(solver, rtol, error, seconds))
    return min(offers, key=lambda offer: offer.seconds) if offers else None


def usual_target(points: Sequence[FrontierPoint]) -> float:
    """The power of ten that is asked for when nothing else is said: 1e-6, or the nearest that the runs bracket.

    Between the largest and the smallest error of the efficient points, with a digit to spare where there is one.
    """
    curve = efficient(points)
    exponents = np.log10([curve[0].error, curve[-1].error])
    highest, lowest = int(np.floor(exponents[0])), int(np.ceil(exponents[1]))
    if highest > lowest:
        lowest += 1
    return float(f"1e{min(max(-6, lowest), highest)}") if highest >= lowest else float(curve[-1].error)


def advice(points: Sequence[FrontierPoint], *, floor: float = 0.0, unit: str = "m", target: float | None = None) -> str:
    """What an accuracy costs, in a sentence or two.

    Args:
        points: the runs that finished.
        floor: error below which the reference says nothing.
        unit: of the errors.
        target: error to be priced; chosen from the data when None.
    """
    if not points:
        return "No run reached its end within its budget."
    if all(point.error <= floor for point in points):
        best = min(points, key=lambda point: point.seconds)
        return (
            f"Every run is as good as the reference resolves ({floor:.0e} {unit}); the quickest is "
            f"{best.solver} at rtol {best.rtol:.0e}: {duration(best.seconds)}."
        )
    target_error = usual_target(points) if target is None else target
    now = price(points, target_error)
    if now is None:
        best = efficient(points)[-1]
        return (
            f"No run reaches {target_error:.0e} {unit}; the nearest is {best.solver} at rtol {best.rtol:.0e}: "
            f"{best.error:.1e} {unit} in {duration(best.seconds)}."
        )
    sentence = f"{target_error:.0e} {unit} costs {duration(now.seconds)} with {now.solver} at rtol {now.rtol:.0e}"
    finer = price(points, target_error / 10)
    if finer is None:
        return f"{sentence}; no run shows what one more digit costs."
    with_other = "" if finer.solver == now.solver else f" (with {finer.solver})"
    return f"{sentence}; one more digit costs {finer.seconds / now.seconds:.2g} times as much{with_other}."


def duration(seconds: float) -> str:
    """A time for people, e.g. `0.83 ms`."""
    for unit, size in {"s": 1.0, "ms": 1e-3}.items():
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"


def spreads(values: Mapping[str, float], members: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """How far statistics lie from the mean of an ensemble, in its standard deviations.

    A statistic in which all members agree counts in units of the rounding of its mean.
    """
    found = {}
    for name, value in values.items():
        known = np.array([member[name] for member in members])
        mean, deviation = float(np.mean(known)), float(np.std(known, ddof=1))
        found[name] = abs(value - mean) / max(deviation, 1e-12 * abs(mean), 1e-300)
    return found
