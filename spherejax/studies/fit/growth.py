"""How sensitivities grow along the record, and how far the gradient means anything.

Behind every impact a small difference of the parameters becomes a larger difference of the motion. The size of the
sensitivities at an instant is

    S(t) = |d prediction(t) / d(p / s)| / noise,

how many standard deviations of the noise the prediction moves, at its most, for a change of the parameters by their
own size s. The derivative is the right one however large S is; but the motion follows its tangent only over changes
that become ever smaller. A step `d` of the parameters is *followed* until t when up to t

    |prediction(p + d) - prediction(p) - J d|  <=  max(|prediction(p + d) - prediction(p)|, |J d|) / 2

in the noise-weighted norm of all instants so far. A gradient at a start that far away means nothing behind t.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from spherejax.studies.fit.horizon import instants_of
from spherejax.studies.fit.methods import Course
from spherejax.studies.fit.problem import Problem
from spherejax.studies.fit.statistics import Knowledge

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEPS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
"""Changes of the parameters that are tried, as shares of their sizes, until one is followed to the end."""

VISIBLE = 3.0
"""Differences of less than this many standard deviations of the noise, all instants together, are not seen."""

EXPONENTIAL = 3.0
"""From this many e-folds on in the second half of the record, growth is called exponential."""


@dataclass(frozen=True)
class SensitivityHistory:
    """Size of the sensitivities of one experiment along time.

    Attributes:
        ts: instants of measurement [s], shape (n,).
        by_parameter: of each parameter, shape (n, k).
        sizes: largest over all directions of the parameters, S, shape (n,).
    """

    ts: np.ndarray
    by_parameter: np.ndarray
    sizes: np.ndarray


@dataclass(frozen=True)
class Followed:
    """A change of the parameters, and how long the motion follows its tangent.

    Attributes:
        change: largest change of a parameter, as a share of its size.
        until: time until which it is followed [s].
        to_the_end: whether this is the end of the record.
    """

    change: float
    until: float
    to_the_end: bool


@dataclass(frozen=True)
class Growth:
    """Growth of the sensitivities along time, and how far the gradient means anything; prints as its explanation.

    Attributes:
        sensitivities: by experiment.
        names: of the parameters.
        steps: changes along the most sensitive direction of the parameters, from the largest down to the first that is
            followed to the end, or that the data cannot see.
        start: the change from where the fit began to the estimates, with the gradient of where it began; None where
            the run there failed.
        end: of the record [s].
        has_grown: whether the fit let the record grow.
    """

    sensitivities: dict[str, SensitivityHistory]
    names: list[str]
    steps: list[Followed]
    start: Followed | None
    end: float
    has_grown: bool = False

    @property
    def factor(self) -> float:
        """By which the sensitivities grow from the second quarter of the record to its last."""
        return max(_quarters(each)[1] / _quarters(each)[0] for each in self.sensitivities.values())

    @property
    def e_folding_time(self) -> float:
        """In which the sensitivities grow by e in the second half of the record [s]; infinite where they do not."""
        return min(_e_folding_time(each) for each in self.sensitivities.values())

    @property
    def reach(self) -> float:
        """Changes up to this share of the parameters' sizes are followed to the end; 0 where none is that is seen."""
        return next((each.change for each in self.steps if each.to_the_end), 0.0)

    @property
    def is_meaningful(self) -> bool:
        """Whether the gradient at the start of the fit meant something over the whole record."""
        return self.start is not None and self.start.to_the_end

    @cached_property
    def explanation(self) -> str:
        """What the growth means for the fit, and what to do."""
        return " ".join(filter(None, [_how_they_grow(self), _how_far(self), _of_the_start(self)]))

    def __str__(self) -> str:
        return self.explanation

    def figure(self, title: str = "Growth of the sensitivities") -> "Figure":
        """Sensitivities along time, and how long changes of the parameters are followed."""
        from spherejax.output.plot.growth import growth_figure

        begin = min(float(each.ts[0]) for each in self.sensitivities.values())
        followed = [(each.change, each.until) for each in self.steps]
        sizes = {name: (each.ts, each.by_parameter) for name, each in self.sensitivities.items()}
        return growth_figure(sizes, self.names, followed, (begin, self.end), title)


def growth_of(problem: Problem, knowledge: Knowledge, best: Course) -> Growth:
    """Growth of the sensitivities at the estimates of a fit. Costs some evaluations of its Jacobian.

    Args:
        problem: what was minimised.
        knowledge: what the data tell at the estimates.
        best: where the fit went.
    """
    return Growth(
        _sensitivities(problem, knowledge),
        problem.names,
        _steps(problem, knowledge, _estimates(best)),
        start_of(problem, knowledge, best),
        _end(problem),
        bool(np.any(np.isfinite(best.ends))),
    )


def start_of(problem: Problem, knowledge: Knowledge, best: Course) -> Followed | None:
    """How far the gradient where the fit began means something on the way to the estimates; None if the run failed."""
    u, at = best.us[0], _estimates(best)
    start = problem.evaluate(u[None])
    if start.failed[0]:
        return None
    values = problem.unknowns.flat_values_of(u)
    change = float(np.max(np.abs(values - knowledge.values) / knowledge.scales))
    until = _followed_to(problem, _Point(u, start.residuals[0], start.jacobians[0]), at.u, at.residuals)
    return Followed(change, until, until >= _end(problem))


@dataclass(frozen=True)
class _Point:
    """Residuals and their derivatives at some unknowns."""

    u: np.ndarray
    residuals: np.ndarray
    jacobian: np.ndarray


def _estimates(best: Course) -> _Point:
    return _Point(best.u, best.residuals, best.jacobian)


def _end(problem: Problem) -> float:
    return max(float(each.measured.ts[-1]) for each in problem.experiments)


def _sensitivities(problem: Problem, knowledge: Knowledge) -> dict[str, SensitivityHistory]:
    found, at = {}, 0
    for experiment in problem.experiments:
        instants = instants_of(experiment)
        rows = knowledge.scaled_jacobian[at : at + instants.size]
        at += instants.size
        ts = np.unique(instants)
        by_instant = [rows[instants == t] for t in ts]
        found[str(experiment.measured.name)] = SensitivityHistory(
            ts,
            np.stack([np.linalg.norm(each, axis=0) for each in by_instant]),
            np.array([np.linalg.norm(each, 2) for each in by_instant]),
        )
    return found


def _steps(problem: Problem, knowledge: Knowledge, at: _Point) -> list[Followed]:
    """Changes to both sides along the most sensitive direction; how long the worse of the two is followed."""
    direction = knowledge.most_sensitive
    direction = direction / np.max(np.abs(direction))
    per_unit = direction * knowledge.unknowns_per_scale
    found = []
    for change in STEPS:
        until = min(_followed(problem, at, at.u + side * change * per_unit) for side in (1, -1))
        found.append(Followed(change, until, until >= _end(problem)))
        if found[-1].to_the_end:
            break
    return found


def _followed(problem: Problem, at: _Point, u: np.ndarray) -> float:
    there = problem.evaluate(u[None])
    return _begin(problem) if there.failed[0] else _followed_to(problem, at, u, there.residuals[0])


def _followed_to(problem: Problem, at: _Point, u: np.ndarray, residuals: np.ndarray) -> float:
    """Until when the motion at one point is followed by its tangent to another [s]."""
    instants = np.concatenate([instants_of(each) for each in problem.experiments])
    order = np.argsort(instants, kind="stable")

    def gathered(differences):
        return np.sqrt(np.cumsum(differences[order] ** 2))

    actual, linear = residuals - at.residuals, at.jacobian @ (u - at.u)
    size = np.maximum(gathered(actual), gathered(linear))
    lost = (gathered(actual - linear) > size / 2) & (size > VISIBLE)
    if not lost.any():
        return _end(problem)
    first = instants[order][np.argmax(lost)]
    earlier = instants[instants < first]
    return float(np.max(earlier)) if earlier.size else _begin(problem)


def _begin(problem: Problem) -> float:
    return min(each.measured.t0 for each in problem.experiments)


def _quarters(sensitivity: SensitivityHistory) -> tuple[float, float]:
    """Medians of the sizes in the second and in the last quarter of the record: a start at rest shows nothing.

    An instant within a contact is far more sensitive than its neighbors: medians pass over it.
    """
    ts, sizes = sensitivity.ts, sensitivity.sizes
    share = (ts - ts[0]) / max(ts[-1] - ts[0], 1e-300)
    early, late = sizes[(share >= 0.25) & (share < 0.5)], sizes[share >= 0.75]
    early = max(float(np.median(early)) if early.size else 0.0, 1e-300)
    return early, float(np.median(late)) if late.size else 0.0


def _e_folding_time(sensitivity: SensitivityHistory) -> float:
    """From the median of the slopes between all instants (Theil and Sen), for the same reason."""
    ts, sizes = sensitivity.ts, sensitivity.sizes
    later = (ts >= (ts[0] + ts[-1]) / 2) & (sizes > 0)
    if np.sum(later) < 3:
        return np.inf
    from scipy import stats  # half a second, which not every process has to spend

    rate = float(np.asarray(stats.theilslopes(np.log(sizes[later]), ts[later]))[0])
    return 1 / rate if rate > 0 else np.inf


def _how_they_grow(growth: Growth) -> str:
    text = f"Sensitivities in the last quarter of the record are {growth.factor:.3g} times those in the second"
    time = growth.e_folding_time
    begin = min(float(each.ts[0]) for each in growth.sensitivities.values())
    if (growth.end - begin) / 2 > EXPONENTIAL * time:
        return f"{text}; they grow by e within {time:.3g} s: the motion is chaotic."
    return f"{text}."


def _how_far(growth: Growth) -> str:
    if growth.steps[0].to_the_end:
        return f"The motion follows its tangent to the end for changes of the parameters by {_percent(growth.reach)}."
    shown = ", ".join(
        f"by {_percent(each.change)} until t = {each.until:.3g} s" for each in growth.steps if not each.to_the_end
    )
    text = f"The motion follows its tangent for changes of the parameters {shown}"
    if growth.reach == 0:
        return (
            f"{text}, and to the end for none that the data can see: over the whole record the gradient means nothing, "
            "nor do the standard deviations. Fit a shorter record."
        )
    return f"{text}, by {_percent(growth.reach)} to the end at {growth.end:.3g} s."


def _of_the_start(growth: Growth) -> str:
    start = growth.start
    if start is None or start.to_the_end:
        return ""
    text = lost_at(start)
    return f"{text}: the record had to grow with the fit." if growth.has_grown else f"{text}. {REMEDY}"


def lost_at(start: Followed) -> str:
    """Where the gradient at the start of a fit has lost its meaning, a sentence without its end."""
    return (
        f"The fit began {_percent(start.change)} away, where the gradient leads to the estimates only until "
        f"t = {start.until:.3g} s; what was measured later misleads it"
    )


REMEDY = "Let the record grow (horizon=sj.studies.GrowingHorizon()), shorten the record, or start nearer."


def _percent(share: float) -> str:
    return f"{100 * share:.3g} percent"
