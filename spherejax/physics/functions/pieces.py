"""Functions made of functions: one after the other along x, or added up."""

from collections.abc import Sequence
from typing import Annotated

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric
from spherejax.foundations.types import Function, Listed, Number, Numeric, Scalar, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.functions.base import (
    AbstractFunction,
    as_function,
    distance_to_next,
    function_requirements,
    nearest_breakpoint,
)


class Piecewise(AbstractFunction):
    """Other functions on intervals side by side.

        f(x) = pieces[k](x) for breaks[k - 1] <= x < breaks[k]

    Attributes:
        breaks: where one piece ends and the next begins, increasing, shape (n,), n >= 1.
        pieces: n + 1 functions; any callable.

    Each piece is evaluated on its own interval only, so it may be undefined elsewhere. The function is as smooth at the
    breaks as the pieces make it; at a break value and derivative are those of the piece that begins there.
    """

    breaks: Numeric
    pieces: tuple[AbstractFunction, ...]

    def __init__(
        self,
        breaks: Annotated[Listed, Unit("{of_argument}")],
        pieces: Annotated[Sequence, Function("{of_argument}", "{of_value}")],
    ):
        self.breaks = numbers(breaks)
        functions = [as_function(piece) for piece in pieces]
        self.pieces = tuple(function for function in functions if function is not None)

    def __call__(self, x: Number) -> Scalar:
        """f(x)."""
        values = []
        for k, piece in enumerate(self.pieces):
            inside = self._is_inside(k, x)
            # Outside its interval a piece sees a point of it, so that no branch that is not taken is infinite.
            values.append(jnp.where(inside, piece(jnp.where(inside, x, self._a_point(k))), 0.0))
        return jnp.asarray(sum(values[1:], values[0]))

    @property
    def knows_primitive(self) -> bool:
        """Whether all pieces do."""
        return all(piece.knows_primitive for piece in self.pieces)

    def primitive(self, x: Number) -> Scalar:
        """F(x), continuous at the breaks."""
        total = jnp.zeros(())
        last = len(self.pieces) - 1
        for k, piece in enumerate(self.pieces):
            low = self.breaks[max(k - 1, 0)]
            upper = x if k == last else jnp.where(x < self.breaks[k], x, self.breaks[k])
            # The first piece is integrated backwards from the first break, the others forwards from their own.
            end = upper if k == 0 else jnp.where(upper > low, upper, low)
            total = total + piece.primitive(end) - piece.primitive(low)
        return total

    @property
    def is_unknown(self) -> bool:
        """Whether one of the pieces is."""
        return any(piece.is_unknown for piece in self.pieces)

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar | None:
        """To the next break, or less where a piece says so."""
        return nearest_breakpoint(
            [
                distance_to_next(self.breaks, x, is_forward),
                *(piece.distance_to_breakpoint(x, is_forward) for piece in self.pieces),
            ]
        )

    def requirements(self) -> list[Requirement]:
        """Increasing breaks, one piece more than breaks, and what the pieces require."""
        b = numeric(self.breaks)
        if b.ndim != 1 or len(b) + 1 != len(self.pieces) or len(b) == 0:
            expected = f"be a list of {len(self.pieces) - 1} numbers, one less than pieces"
            return [Requirement("breaks", self.breaks, False, expected, "Give one piece more than breaks.")]
        increasing = (b[1:] > b[:-1]).all() & (abs(b) < np.inf).all()
        rows = [Requirement("breaks", self.breaks, increasing, "increase and be finite", "Sort the breaks.")]
        for k, piece in enumerate(self.pieces):
            rows += function_requirements(f"pieces[{k}]", piece)
        return rows

    def _is_inside(self, k: int, x: Number):
        begun = jnp.ones((), bool) if k == 0 else x >= self.breaks[k - 1]
        return begun if k == len(self.pieces) - 1 else begun & ~jnp.asarray(x >= self.breaks[k])

    def _a_point(self, k: int):
        return self.breaks[max(k - 1, 0)]


class Sum(AbstractFunction):
    """The sum of other functions.

    Attributes:
        terms: the functions; any callable.
    """

    terms: tuple[AbstractFunction, ...]

    def __init__(self, *terms: Annotated[AbstractFunction, Function("{of_argument}", "{of_value}")]):
        functions = [as_function(term) for term in terms]
        self.terms = tuple(function for function in functions if function is not None)

    def __call__(self, x: Number) -> Scalar:
        """Sum of the terms at x."""
        return sum((term(x) for term in self.terms), jnp.zeros(()))

    @property
    def knows_primitive(self) -> bool:
        """Whether all terms do."""
        return all(term.knows_primitive for term in self.terms)

    def primitive(self, x: Number) -> Scalar:
        """Sum of the primitives."""
        return sum((term.primitive(x) for term in self.terms), jnp.zeros(()))

    @property
    def is_unknown(self) -> bool:
        """Whether one of the terms is."""
        return any(term.is_unknown for term in self.terms)

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar | None:
        """The least of the terms."""
        return nearest_breakpoint(term.distance_to_breakpoint(x, is_forward) for term in self.terms)

    @property
    def may_jump(self) -> bool:
        """Whether a term may."""
        return any(term.may_jump for term in self.terms)

    def requirements(self) -> list[Requirement]:
        """What the terms require."""
        return [row for k, term in enumerate(self.terms) for row in function_requirements(f"terms[{k}]", term)]
