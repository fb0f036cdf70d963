"""What every method of a fit keeps and reports: its path, the best so far, and how it ended."""

import enum
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from spherejax.studies.fit.problem import Evaluation


class Ending(enum.Enum):
    """How a start of a fit ended."""

    CONVERGED = "converged"
    NO_FURTHER_DECREASE = "converged: no step of any length decreases the cost, which is as small as its errors allow"
    TOO_MANY_ITERATIONS = "stopped after the largest number of iterations; the estimates may still move"
    INTERRUPTED = "interrupted; these are the best estimates so far"
    FAILED_START = "failed: the run at the start did not reach its end"

    @property
    def succeeded(self) -> bool:
        """Whether the estimates are those of a minimum."""
        return self in (Ending.CONVERGED, Ending.NO_FURTHER_DECREASE)


class Residuals(Protocol):
    """What a method minimises: a sum of squares of residuals."""

    def evaluate(self, us: Float[np.ndarray, "lanes k"]) -> Evaluation:
        """Residuals and Jacobians of many sets of unknowns."""
        ...


@dataclass
class Course:
    """Where one start has gone.

    Attributes:
        us: accepted unknowns, one entry for each accepted step, the start first.
        costs: half the sums of squares there.
        ends: the end of the record that these are of [s], where it grows; infinite for the whole.
        residuals, jacobian: at the last of them.
        ending: how it ended; None while it goes on.
        n_iterations: steps tried.
        n_failed: runs that did not reach their end.
        diagnosis: why the last of these failed.
        was_rejected: whether the last step was taken back.
        others: unknowns elsewhere that were looked at with the whole record, and half the sums of squares there.
    """

    us: list[np.ndarray] = field(default_factory=list)
    costs: list[float] = field(default_factory=list)
    ends: list[float] = field(default_factory=list)
    residuals: np.ndarray = field(default_factory=lambda: np.zeros(0))
    jacobian: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    ending: Ending | None = None
    n_iterations: int = 0
    n_failed: int = 0
    diagnosis: str = ""
    was_rejected: bool = False
    others: list[tuple[np.ndarray, float]] = field(default_factory=list)

    @property
    def u(self) -> np.ndarray:
        """The best unknowns so far."""
        return self.us[-1]

    @property
    def cost(self) -> float:
        """Half the sum of squares there; infinite for a start that failed."""
        return self.costs[-1] if self.costs else np.inf

    def accept(self, u: np.ndarray, residuals: np.ndarray, jacobian: np.ndarray) -> None:
        """Go on to new unknowns."""
        self.us.append(np.array(u))
        self.costs.append(cost_of(residuals))
        self.ends.append(np.inf)
        self.residuals, self.jacobian = np.array(residuals), np.array(jacobian)

    def after(self, earlier: "Course | None", end: float) -> "Course":
        """This course as the continuation of an earlier one, with a record that ends at `end` [s].

        Of one whose start failed nothing but its failure goes on.
        """
        self.ends = [end] * len(self.us)
        if earlier is None:
            return self
        if not self.us:
            return replace(
                earlier,
                n_iterations=earlier.n_iterations + self.n_iterations,
                n_failed=earlier.n_failed + self.n_failed,
                diagnosis=self.diagnosis,
            )
        return Course(
            earlier.us + self.us,
            earlier.costs + self.costs,
            earlier.ends + self.ends,
            self.residuals,
            self.jacobian,
            self.ending,
            earlier.n_iterations + self.n_iterations,
            earlier.n_failed + self.n_failed,
            self.diagnosis or earlier.diagnosis,
        )


class Method(Protocol):
    """What minimises: `LevenbergMarquardt`, `Descent`."""

    @property
    def max_iterations(self) -> int:
        """Steps tried by each start at most."""
        ...

    def roughly(self) -> "Method":
        """The same for a fit whose result is only a start."""
        ...

    def minimize(
        self, problem: Any, us: np.ndarray, *, noise_is_known: bool, watch: Callable[[list[Course]], None]
    ) -> list[Course]:
        """Minimise half a sum of squares from one or more starts."""
        ...


def cost_of(residuals: np.ndarray) -> float:
    """Half the sum of squares."""
    return float(residuals @ residuals) / 2


@dataclass(frozen=True)
class FitProgress:
    """How far a fit is.

    Attributes:
        iteration: steps tried by the start that has tried most.
        n_iterations: steps that may be tried.
        cost: the smallest so far, half a sum of squares.
        n_residuals: count of measured values.
        values: parameters at the smallest cost, in the order of their names.
        n_going: starts that are not done.
        seconds: since the beginning.
    """

    iteration: int
    n_iterations: int
    cost: float
    n_residuals: int
    values: np.ndarray
    n_going: int
    seconds: float


class FitWatch:
    """Turns the courses of a fit into reports of how far it is."""

    def __init__(self, report: Callable[[FitProgress], None], problem, n_iterations: int):
        self.report, self.problem, self.n_iterations = report, problem, n_iterations
        self.began = time.monotonic()

    def __call__(self, courses: list[Course]) -> None:
        """Report."""
        best = min(courses, key=lambda course: course.cost)
        if not best.us:
            return
        self.report(
            FitProgress(
                max(course.n_iterations for course in courses),
                self.n_iterations,
                best.cost,
                best.residuals.size,
                self.problem.unknowns.flat_values_of(best.u[: self.problem.unknowns.size]),
                sum(course.ending is None for course in courses),
                time.monotonic() - self.began,
            )
        )
