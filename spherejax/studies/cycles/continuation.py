"""`sj.studies.continuation`: how a cycle changes with a number, round folds, with what happens to its stability."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import diffrax
import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import real_number, whole_number
from spherejax.foundations.terminals import waiting_for
from spherejax.model.numbers import number_at
from spherejax.model.scene import Scene
from spherejax.motion.equations.quantities import quantity
from spherejax.motion.runs.traced_functions import built
from spherejax.studies.cycles.branch_result import Branch, Event
from spherejax.studies.cycles.branch_steps import FEW, GENTLE, MANY, SMALLEST_STEP, BranchPoint, Stepper
from spherejax.studies.cycles.family import Family
from spherejax.studies.cycles.shooting import CandidateState, Shooting, search, settled, stacked_places
from spherejax.studies.cycles.study import (
    TOLERANCE,
    CycleWarning,
    Request,
    asked,
    made,
    refuse_time,
    start_of,
)

Build = Callable[..., Scene]


def continuation(
    what: Scene | Build,
    number: str,
    span: tuple[float, float],
    *,
    period: float | Callable[[float], float] | None = None,
    near: float | None = None,
    values: Mapping[str, float] | None = None,
    outputs: Sequence[str] = (),
    at: str = "start",
    settle: int | None = None,
    first_step: float = 0.02,
    largest_step: float = 0.1,
    most_points: int = 400,
    samples: int = 256,
    t: float = 0.0,
    rtol: float = 1e-8,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = 20_000_000,
) -> Branch:
    """The cycles of a mechanism along one of its numbers: stable and unstable ones, with folds and what lies behind.

    The first cycle is found as by `sj.steady_cycle`; from there the branch is followed in state and number together, so
    that it may turn back. Told and located are folds, where it does, and where its stability changes: by period
    doubling (a multiplier of -1), a Neimark-Sacker bifurcation (a pair of modulus 1: the motion becomes
    quasiperiodic), or where another branch crosses (a multiplier of 1 without a fold).

    Args:
        what: a scene; or a function that makes one from numbers, given by keyword, which is traced.
        number: of a scene the path of a number, e.g. `"bodies.bob.mass"`; of a function the name of an argument.
        span: where the number begins, and where to; the branch ends where it leaves this span.

    Other args:
        period: of what drives the mechanism [s], or a function of the number that gives it, such as
            `lambda frequency: 1 / frequency`.
        near: instead, where nothing depends on time: about how long the first cycle takes [s].
        values: other arguments of the function, which stay.
        outputs: quantities whose largest and least values, means and harmonics are kept, e.g. `"position.bob.x"`.
        at, settle, t, samples: of the first cycle, as in `steady_cycle`; `samples` are also those of the outputs.
        first_step: as a share of the span.
        largest_step: as a share of the span, and of the size of the cycle.
        most_points: after which the branch is not followed farther.
        rtol, solver, max_steps: as in `simulate`.

    Returns:
        The branch: `.to_xarray()`, `.events`, `.cycle(k)`, `.figure(name)`; prints what happens along it. A branch
        that could not be followed to the end of the span says why in `.diagnosis`.

    Raises:
        SceneError: for a request that makes no sense.

    Warns:
        CycleWarning: where the first cycle is not found, or the branch could not be followed to an end.
    """
    begin, end = _span(number, span)
    period_of = _period_of(period, number, begin)
    build, fixed, scene = _family_of(what, number, values, begin)
    request = asked(
        scene, None if period_of is None else period_of(begin), near, at, settle, samples, t, "continuation"
    )
    _check_steps(first_step, largest_step)
    most_points = whole_number("most_points", most_points, "Leave it out for 400.")
    with waiting_for("cycles", program="over_spans"):
        family = Family(build, {**fixed, number: begin}, rtol=rtol, solver=solver, max_steps=max_steps)
        names = _outputs(outputs, family)
        refuse_time(family, request, "continuation")
        walk = _BranchWalk(family, request, number, (begin, end), period_of)
        walk.followed(start_of(scene, family, request), first_step, largest_step, most_points)
        branch = Branch.of(walk.points, walk.events, number, (begin, end), names, family, request, walk.why)
    if walk.why:
        warnings.warn(f"continuation: {walk.why}", CycleWarning, stacklevel=2)
    return branch


def _span(number: str, span: Any) -> tuple[float, float]:
    if not isinstance(span, tuple | list) or len(span) != 2:
        raise SceneError(f"continuation: span = {span!r} must be two numbers, where {number!r} begins and where to")
    for each in span:
        real_number("span", each)
    begin, end = (float(each) for each in span)
    if not (np.isfinite(begin) and np.isfinite(end) and begin != end):
        raise SceneError(f"continuation: span = {span!r} must be two different finite numbers")
    return begin, end


def _check_steps(first_step: float, largest_step: float) -> None:
    for name, value in (("first_step", first_step), ("largest_step", largest_step)):
        real_number(name, value)
        if not SMALLEST_STEP < float(value) <= 1:
            raise SceneError(f"continuation: {name} = {value!r} must be a share, above {SMALLEST_STEP:g} and up to 1")


def _period_of(period: Any, number: str, begin: float) -> Callable[[float], float] | None:
    if period is None:
        return None
    if not callable(period):
        return lambda _: period
    given: Any = period
    try:
        first = float(given(begin))
    except Exception as error:
        raise SceneError(
            f"continuation: period must be a time [s], or a function of {number!r} that gives it; at {begin:.6g} it "
            f"failed: {error}"
        ) from error
    if not (np.isfinite(first) and first > 0):
        raise SceneError(f"continuation: the period at {number} = {begin:.6g} is {first!r}; it must be positive [s]")
    return lambda value: float(given(value))


def _family_of(what: Any, number: str, values, begin: float) -> tuple[Build, dict[str, float], Scene]:
    """A builder of the number and what stays, and the scene at the begin of the span."""
    if isinstance(what, Scene):
        if values:
            raise SceneError("continuation: values= belongs to a function that makes scenes; a scene has its numbers")
        place = number_at(what, number)

        def build(**given) -> Scene:
            return place.changed(what, given[number])

        return build, {}, build(**{number: begin})
    if not callable(what):
        raise SceneError(
            f"continuation: {type(what).__name__} is no scene, and no function that makes one from numbers by keyword"
        )
    fixed = {} if values is None else {str(name): float(value) for name, value in values.items()}
    if number in fixed:
        raise SceneError(f"continuation: values= fixes {number!r}, along which the branch is followed")
    try:
        build_of: Any = what
        return build_of, fixed, built(build_of, {**fixed, number: begin})
    except TypeError as error:
        raise SceneError(f"continuation: build cannot be called with {', '.join([*fixed, number])}: {error}") from error


def _outputs(names: Sequence[str] | str, family: Family) -> tuple[str, ...]:
    names = (names,) if isinstance(names, str) else tuple(names)
    for name in names:
        if quantity(name, family.example).dims:
            raise SceneError(f"continuation: outputs= {name!r} is a vector; name one component, e.g. {name + '.x'!r}")
    return names


class _BranchWalk:
    """Along a branch, from its first cycle to its end."""

    def __init__(self, family: Family, request: Request, number: str, span, period_of):
        self.family, self.request, self.number, self.span = family, request, number, span
        self.by = np.array([span[1] - span[0] if name == number else 0.0 for name in family.names])
        at = self._at
        of_values = None if period_of is None else (lambda values: period_of(float(values[at])))
        shooting = Shooting(family, request.t, self.by, of_values)
        self.stepper = Stepper(shooting, TOLERANCE * family.rtol, not request.is_driven, family.knows_time)
        self.points: list[BranchPoint] = []
        self.events: list[Event] = []
        self.why = ""

    @property
    def _at(self) -> int:
        return self.family.names.index(self.number)

    def share(self, point: BranchPoint) -> float:
        """How far in the span a point is."""
        return (float(point.shot.place.values[self._at]) - self.span[0]) / (self.span[1] - self.span[0])

    def followed(self, start: np.ndarray, first_step: float, largest_step: float, most: int) -> None:
        """Find the first cycle and go on from it."""
        request, stepper = self.request, self.stepper
        values = np.array([self._values[name] for name in self.family.names])
        place = stacked_places([CandidateState(start, np.asarray(request.period), values)])
        if request.settle:
            place = place._replace(y=settled(self.family, place, request.t, request.settle)[0])
        found = search(
            stepper.shooting, place, tolerance=stepper.tolerance, unknown_period=stepper.unknown_period
        )[0]  # fmt: skip
        first = made(self.family, found, request)
        if not first.succeeded:
            self.why = f"no cycle was found at {self.number} = {self.span[0]:.6g}: {first.diagnosis}"
            return
        self.points.append(stepper.point(found.shot, None))
        step = first_step
        while True:
            if len(self.points) >= most:
                self.why = (
                    f"{most} points reach to {self.number} = {self._value(self.points[-1]):.6g}; give most_points= "
                    "more, or a larger largest_step="
                )
                return
            last = self.points[-1]
            point, n_steps, why = self._next(last, step)
            if point is None:
                step /= 2
                if step < SMALLEST_STEP:
                    self.why = f"the branch could not be followed beyond {self.number} = {self._value(last):.6g}: {why}"
                    return
                continue
            if self._ended(last, point, step):
                return
            self._look_between(last, point, step)
            self.points.append(point)
            if self._is_closed():
                return
            if n_steps <= FEW:
                step = min(1.4 * step, largest_step)
            elif n_steps > MANY:
                step = step / 2

    def _next(self, last: BranchPoint, step: float) -> tuple[BranchPoint | None, int, str]:
        """The next point, or why a step as long leads to none."""
        found = self.stepper.corrected(self.stepper.predicted(last, step))
        if not found.is_cycle:
            return None, found.n_steps, found.why
        point = self.stepper.point(found.shot, last)
        if self.stepper.turned(last, point) < GENTLE:
            return None, found.n_steps, "it turns too sharply there (an impact that begins, a corner)"
        return point, found.n_steps, ""

    def _ended(self, last: BranchPoint, point: BranchPoint, step: float) -> bool:
        """Whether a point is outside of the span; then the branch ends with the one on its border."""
        share = self.share(point)
        if 0 <= share <= 1 or (share < 0 and len(self.points) == 1 and self.share(last) <= 0):
            return False
        border = 1.0 if share > 1 else 0.0
        part = (border - self.share(last)) / (share - self.share(last))
        place = self.stepper.predicted(last, part * step)
        values = np.array(place.values)
        values[self._at] = self.span[1] if border else self.span[0]
        place = self.stepper.shooting.timed(place._replace(values=values))
        found = self.stepper.corrected(place, by_number=False)
        if found.is_cycle:
            end = self.stepper.point(found.shot, last)
            self._look_between(last, end, part * step)
            self.points.append(end)
        return True

    def _is_closed(self) -> bool:
        """Whether the branch has come back to where it began."""
        first, last = self.points[0], self.points[-1]
        if len(self.points) < 10 or abs(self.share(first) - self.share(last)) > 1e-3:
            return False
        apart = np.linalg.norm(first.shot.seen(self.family, last.shot.place.y)) / first.shot.size
        return bool(apart < 1e-2 and self.stepper.turned(first, last) > GENTLE)

    def _value(self, point: BranchPoint) -> float:
        return float(point.shot.place.values[self._at])

    def _look_between(self, last: BranchPoint, point: BranchPoint, step: float) -> None:
        """Events between two points."""
        if last.slope * point.slope < 0:
            at = self.stepper.located(last, step, lambda p: p.slope, (last.slope, point.slope))
            self._told("fold", at, point)
        before, after = last.multipliers.n_unstable, point.multipliers.n_unstable
        if before == after:
            return
        n = min(before, after)

        def value(p: BranchPoint) -> float:
            sizes = np.sort(np.abs(p.multipliers.judged))[::-1]
            return float(sizes[n] - 1) if n < len(sizes) else -1.0

        ends = value(last), value(point)
        at = point if ends[0] * ends[1] >= 0 else self.stepper.located(last, step, value, ends)
        judged = at.multipliers.judged
        crossing = judged[np.argsort(-np.abs(judged))[min(n, len(judged) - 1)]]
        kind = _kind(complex(crossing))
        if kind == "branch point" and last.slope * point.slope < 0:
            return  # the fold says it already
        self._told(kind, at, point)

    def _told(self, kind: str, at: BranchPoint, after: BranchPoint) -> None:
        place = at.shot.place
        self.events.append(
            Event(kind, self._value(at), float(place.period), len(self.points), after.multipliers.is_stable, at)
        )

    @property
    def _values(self) -> dict[str, float]:
        return {**self.family.values, self.number: self.span[0]}


def _kind(multiplier: complex) -> str:
    """What happens where a multiplier crosses the unit circle."""
    if abs(multiplier.imag) > 1e-3 * abs(multiplier):
        return "Neimark-Sacker"
    return "period doubling" if multiplier.real < 0 else "branch point"
