"""The Rosenbrock step of a scalar program: its recipe and its arguments, with and without sensitivities.

What is called, one after the other: what the matrix follows from, and its factors; then, for each stage, the right-hand
side and the solution of the linear system. Of sensitivities, each of these that depends on the state has its derivative
beside it, over lanes; the derivative of the matrix times k is

    (dJ/dy Y + dJ/dp) k = S(c', k),

bilinear in k and in the derivatives c' of the coefficients that J k is linear in k with: these are the same in all
stages, and are evaluated once.
"""

from dataclasses import dataclass
from itertools import compress
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.primitive import ActiveInputs, StraightLine
from spherejax.compiler.program import ScalarProgram
from spherejax.compiler.runge_kutta.call import all_stages, can_be_called
from spherejax.compiler.runge_kutta.recipe import (
    MOVED,
    RIGHT,
    SLOPE,
    SOLUTION,
    TIME,
    LinePart,
    Rows,
    StepRecipe,
    T,
    Tangents,
    Y,
    entries_at,
    made,
    over_lanes,
)
from spherejax.compiler.runge_kutta.tableau import Tableau

THETA, GAMMA_H, OTHER = SLOPE + 1, SLOPE + 2, SLOPE + 3
"""Arguments of the call behind those of every step: theta, gamma h, others, what the right-hand side has evaluated
ahead; then what has an axis of rows."""


class CalledStep(NamedTuple):
    """What is called in a step, and its arguments besides the caller's numbers.

    Attributes:
        step: what is called.
        rate: the right-hand side.
        others: arguments that are the same for all steps.
        moving: of a step with sensitivities, which entries of theta and of what is evaluated ahead have tangents.
    """

    step: StepRecipe
    rate: ScalarProgram
    others: tuple[Float[np.ndarray, " n"], ...]
    moving: tuple[ActiveInputs, ...] = ()

    def __call__(self, tableau: Any, theta, ahead, gamma_h, start: tuple, slopes: Any = None) -> Array:
        """All stages, from (t, h, h, y, slope)."""
        t, h, _, y, slope = start
        scalar = self.rate
        arguments = [theta, gamma_h, *map(jnp.asarray, self.others), *scalar.line_inside(ahead)[1]]
        if slopes is not None:
            along = slopes.theta, *scalar.slopes_inside(ahead, slopes.ahead)
            active = zip(along, self.moving, strict=True)
            arguments += [entries_at(x, some) for x, some in active if x is not None and some]
        (k,) = all_stages(self.step._replace(tableau=Tableau.rosenbrock(tableau)), t, h, y, slope, *arguments)
        return k


@dataclass(frozen=True)
class RosenbrockSystems:
    """How a step's linear systems are made and solved by calls.

    Attributes:
        stage: what solves one of them.
        ahead: what is evaluated before it.
        read: names of those results of it that `stage` reads.
        others: further arguments of the call, the same for all steps.
        product: what J k is the derivative of, and places of its arguments; None for the right-hand side.
        place: of its argument that k is a tangent of.
    """

    stage: ScalarProgram | None
    ahead: tuple[tuple[ScalarProgram | None, tuple[int | str, ...], int], ...]
    read: tuple[str, ...]
    others: tuple[Float[np.ndarray, " n"], ...]
    product: tuple[ScalarProgram | None, tuple[int, ...]] | None
    place: int

    @classmethod
    def exact(
        cls,
        stage: ScalarProgram | None,
        frozen: ScalarProgram | None,
        change: ScalarProgram | None,
        seeds: Float[np.ndarray, "k n"],
    ) -> "RosenbrockSystems":
        """With a matrix that follows from derivatives along seeds.

        Args:
            stage: of (theta, t, y, gamma h, those derivatives, right side): the solution of a linear system.
            frozen: of (theta, t, y): two results, at which the derivatives are taken.
            change: of (theta, t, y, both results, seed): the derivative along a seed; over lanes, one for each.
            seeds: one in each row.
        """
        wide = len(seeds) if len(seeds) > 1 else 0
        along = THETA, T, Y, made(0, 0), made(0, 1), OTHER
        ahead = (frozen, (THETA, T, Y), 0), (change, along, wide)
        # Lanes are last in machine code. One seed is no lane: its text is that of a function without them.
        return cls(stage, ahead, (made(1, 0),), (np.ascontiguousarray(seeds.T) if wide else seeds[0],), None, 2)

    @classmethod
    def inexact(cls, stage: ScalarProgram | None, product: ScalarProgram | None) -> "RosenbrockSystems":
        """With a matrix that a program multiplies by.

        Args:
            stage: of (theta, t, y, gamma h, right side): the solution of a linear system.
            product: of (theta, t, y, v): J v.
        """
        # What it is multiplied with does not matter to what follows from the rest; a vector of its size is at hand.
        return cls(stage, (), (), (), (product, (THETA, T, Y, Y)), 3)

    def step(
        self, rate: ScalarProgram | None, ahead: Any, size: int, slopes: Any = None, by: tuple[int, ...] | None = None
    ) -> CalledStep | None:
        """What is called in a step of a state of a size; None where it cannot be.

        Args:
            rate: the right-hand side.
            ahead: what it has evaluated ahead.
            size: of the state.
            slopes: derivatives of its numbers, of `ahead` too, for a step of sensitivities.
            by: the numbers that these are by; None for all.
        """
        # Each of them may have no scalar program (an operation without a rule, or too many): then the step has none.
        programs = [rate, self.stage, *(program for program, *_ in self.ahead)]
        programs += [] if self.product is None else [self.product[0]]
        if not machine_code.native_code_enabled() or any(program is None for program in programs):
            return None
        assert rate is not None
        assert self.stage is not None
        evaluated_ahead = ahead
        line, ahead = rate.line_inside(evaluated_ahead)
        parts = [
            LinePart(
                program.line_called(),
                sources,
                (wide,) if wide else (),
                (*(0 for _ in sources[1:]), 1) if wide else (),
            )
            for program, sources, wide in self.ahead
            if program is not None
        ]
        first, rest = self.stage.lines_ahead_and_inside()
        leading = THETA, T, Y, GAMMA_H, *self.read
        factors = []
        # The factors of the matrix are evaluated ahead of the stages, in the same call: all stages have one matrix.
        if first is not None:
            factors = [made(len(parts), i) for i in range(len(first.outputs))]
            parts.append(LinePart(first, leading))
        begin = OTHER + len(self.others)
        of_rate = tuple(range(begin, begin + len(ahead)))
        solve = LinePart(rest, (*leading, RIGHT, *factors))
        step = StepRecipe(tuple(parts), LinePart(line, (THETA, TIME, MOVED, *of_rate)), solve)
        moving: tuple[ActiveInputs, ...] = ()
        if slopes is not None:
            n, n_numbers = slopes.theta.shape
            moving = rate.moving_inside(evaluated_ahead, range(n_numbers) if by is None else by)
            # Truths have no tangents (False), nor has what none of the numbers moves (an empty tuple).
            moves = {
                place: some
                for place, some in zip((THETA, *of_rate), moving, strict=True)
                if isinstance(some, tuple) and some
            }
            product = (line, (THETA, T, Y, *of_rate)) if self.product is None else self._product()
            step = _with_rows(step, Tangents(n, moves, begin + len(ahead)), *product, self.place)
        return CalledStep(step, rate, self.others, moving) if can_be_called(step, size) else None

    def _product(self) -> tuple[StraightLine, tuple[int, ...]]:
        assert self.product is not None
        program, sources = self.product
        assert program is not None
        return program.line_called(), sources


def _with_rows(
    step: StepRecipe, tangents: Tangents, product: StraightLine, sources: tuple[int, ...], place: int
) -> StepRecipe:
    """A step with sensitivities.

    Args:
        step: without.
        tangents: of the arguments of the call.
        product: what J k is the derivative of.
        sources: of its arguments.
        place: of the one that k is a tangent of.
    """
    assert step.solve is not None
    rate, along = tangents.of_rate(step.rate)
    ahead, bends = _change_of_product(tangents, product, sources, place, len(step.ahead))
    again = [f"{RIGHT}.rows" if source == RIGHT else source for source in step.solve.sources]
    wide = [source == RIGHT for source in step.solve.sources]
    solve = over_lanes(step.solve.line, again, wide, tangents.n)
    rows = Rows(tangents.n, tangents.arguments, along, bends, solve, GAMMA_H)
    return step._replace(ahead=(*step.ahead, *ahead), rate=rate, rows=rows)


def _change_of_product(
    tangents: Tangents, line: StraightLine, sources: tuple[int, ...], place: int, at: int
) -> tuple[tuple[LinePart, ...], tuple[LinePart, ...]]:
    """What is evaluated ahead, as parts from `at` on, and in each stage, of the derivative of J k at fixed k."""
    # J k is linear in k with coefficients that follow from the numbers and the state: these and their tangents...
    linear = line.derivative(tuple(i == place for i in range(len(sources))))
    state = sources.index(Y)  # another one stands for the vector
    moves = [i == state or tangents.moves.get(source, False) for i, source in enumerate(sources)]
    bent = linear.values.derivative(tuple(moves))
    n_own, n_values = len(line.outputs), len(linear.values.outputs)
    coefficients = [made(at, i) for i in range(n_values, len(bent.values.outputs))]
    slopes = tangents.part(bent.slopes, compress(sources, moves), coefficients)
    follow = bent.follows[n_own:]
    if not any(follow):  # J depends on nothing that moves, as in a linear system
        return (), ()
    # ... and it is linear in the coefficients too. k is inactive here: its own tangent is solved for.
    product = linear.slopes.derivative((False, *follow))
    order = [*compress(range(n_values), bent.follows)]
    changes = [made(at + 1, order.index(i)) for i in range(n_own, n_values) if bent.follows[i]]
    coefficients = [f"bend0.{i}" for i in range(1, len(product.values.outputs))]
    wide = [*(True for _ in changes), *(False for _ in coefficients)]
    change = over_lanes(product.slopes, [*changes, *coefficients], wide, tangents.n)
    values = LinePart(product.values, (SOLUTION, *(made(at, i) for i in range(n_own, n_values))))
    return (LinePart(bent.values, sources), slopes), (values, change)
