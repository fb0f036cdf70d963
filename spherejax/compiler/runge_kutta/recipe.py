"""Which scalar programs a step of `tableau` evaluates, when, and from what: for one run or many, with tangents or not.

A step is a list of parts. Each `LinePart` is a straight line, and says where each of its arguments comes from: from
the arguments of the call, or from what a stage or another part has made. In turn:

    once       the parts ahead: for a Rosenbrock method what its matrix needs, and its factors
    a stage    the rate f, and behind it the tangents of f
               of a Rosenbrock method: S; then the parts that give the matrix's tangents times k, and S for tangents

Tangents k' of the increments go along in rows below the state:

    explicit      k_i' = h f_i'
    Rosenbrock    k_i' = gamma S(h f_i' + sum_j C_ij k_j' + d_i (h^2 df/dt)' + gamma h J' k_i / gamma)

f_i' is linear in the tangents of x_i and of f's other arguments, with coefficients that f makes beside its value.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import compress, pairwise
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from spherejax.compiler.primitive import ActiveInputs, StraightLine
from spherejax.compiler.runge_kutta.tableau import Tableau

T, H, Y = 0, 1, 2
"""First arguments of the call: where the step begins, how long it is, the state there (with rows below it)."""

SLOPE = 3
"""Of a Rosenbrock step, behind them: h^2 df/dt, in the shape of the state. Other arguments follow."""

BEND, N_MADE = 3, 4
"""Of an explicit step: how time within it is stretched, and how many stages are evaluated. Other arguments follow."""

TIME, MOVED, RIGHT, SOLUTION = "time", "moved", "right", "solution"
"""Of a stage: the arguments of f, the right side, and what S gives."""

BEGIN_ROWS, MOVED_ROWS = "begin.rows", "moved.rows"
"""Tangents of the state at the start of a step, and of the argument of f; over lanes."""


def made(part: int, output: int) -> str:
    """The name of an output of one of the parts that are evaluated ahead of the stages."""
    return f"made{part}.{output}"


def made_by_rate(output: int) -> str:
    """The name of an output of f: the first one is its value."""
    return f"rate{output}"


class LinePart(NamedTuple):
    """A straight line that is evaluated in the call.

    Attributes:
        line: the line.
        sources: of each of its arguments: a number for an argument of the call, else a name: of what a stage makes
            (`TIME`, `MOVED`, `RIGHT`), or of what another part has made (`made`).
        lanes, axes: as of the operation `straight_line`.
        n_rows: how many rows its lanes are for, instead of `lanes`.
    """

    line: StraightLine
    sources: tuple[int | str, ...]
    lanes: tuple[int, ...] = ()
    axes: tuple[int, ...] = ()
    n_rows: int = 0


def over_lanes(line: StraightLine, sources: Sequence[int | str], wide: Sequence[bool], n_rows: int) -> LinePart:
    """A part some of whose arguments are over lanes, one for each row."""
    # The text of one row is that of a function without lanes.
    if n_rows == 1:
        return LinePart(line, tuple(sources))
    return LinePart(line, tuple(sources), axes=tuple(map(int, wide)), n_rows=n_rows)


class Rows(NamedTuple):
    """Tangents that go along with the state.

    Attributes:
        n: how many.
        arguments: places of arguments of the call that have an axis of rows.
        along: what makes the tangents of f.
        bends: of a Rosenbrock step: what is evaluated behind S, and what makes dJ/dy Y k of it, the last; empty where
            J is constant.
        solve: S for the tangents.
        gamma_h: place of gamma h among the arguments of the call.
    """

    n: int
    arguments: tuple[int, ...]
    along: LinePart
    bends: tuple[LinePart, ...] = ()
    solve: LinePart | None = None
    gamma_h: int = 0


class StepRecipe(NamedTuple):
    """What is done in a step.

    Attributes:
        ahead: evaluated once, in order.
        rate: f, with what its tangents are made of.
        solve: S; None for an explicit step.
        tableau: the coefficients; None while they are not known yet.
        rows: tangents; None without.
    """

    ahead: tuple[LinePart, ...]
    rate: LinePart
    solve: LinePart | None
    tableau: Tableau | None = None
    rows: Rows | None = None

    @property
    def parts(self) -> tuple[LinePart, ...]:
        """All of them."""
        of_rows = () if self.rows is None else (self.rows.along, *self.rows.bends, self.rows.solve)
        return tuple(part for part in (*self.ahead, self.rate, self.solve, *of_rows) if part is not None)

    @property
    def size(self) -> int:
        """Entries of a state without its rows."""
        return int(self.rate.line.outputs[0].size)

    @property
    def n_rows(self) -> int:
        """Rows of tangents."""
        return 0 if self.rows is None else self.rows.n


class Tangents:
    """Parts that make the tangents of what other parts make.

    Args:
        n: how many there are.
        moves: by argument of the call that has tangents, which entries of it do.
        begin: place of the first of these tangents among the arguments.
    """

    def __init__(self, n: int, moves: Mapping[int, ActiveInputs], begin: int):
        self.n = n
        self.moves: dict[int | str, ActiveInputs] = {**moves}
        # In the order of `moves`, in which the caller puts the tangents behind the other arguments.
        self.places: dict[int, int] = {argument: begin + i for i, argument in enumerate(moves)}

    @property
    def arguments(self) -> tuple[int, ...]:
        """Places of the tangents among the arguments of the call."""
        return tuple(self.places.values())

    def of_rate(self, rate: LinePart) -> tuple[LinePart, LinePart]:
        """f with the coefficients of its tangents, and what makes the tangents of them."""
        # Time has no tangent within a step (h and `bend` are the same for all rows); the state always has one.
        moves = [source == MOVED or self.moves.get(source, False) for source in rate.sources]
        derivative = rate.line.derivative(tuple(moves), reads_arguments=True)
        assert derivative.follows[0], "a rate that does not depend on the state"
        coefficients = [made_by_rate(i) for i in range(1, len(derivative.values.outputs))]
        read = [rate.sources[i] for i in derivative.read]
        along = self.part(derivative.slopes, compress(rate.sources, moves), [*read, *coefficients])
        return LinePart(derivative.values, rate.sources), along

    def part(self, line: StraightLine, moving: Iterable[int | str], coefficients: Sequence[int | str]) -> LinePart:
        """The tangents that a line makes of those of the arguments that move, with coefficients of its value.

        Coefficients are what its value makes, or arguments of it.
        """
        names: dict[int | str, int | str] = {**self.places, Y: BEGIN_ROWS, MOVED: MOVED_ROWS}
        tangents = [names[source] for source in moving]
        # Tangents are of each row; the coefficients are the same for all of them.
        wide = [*(True for _ in tangents), *(False for _ in coefficients)]
        # A row of a time or of a number that does not move is no argument at all, instead of zeros.
        return over_lanes(line, [*tangents, *coefficients], wide, self.n)


def entries_at(x: Array | None, some: ActiveInputs) -> Array | None:
    """Some entries of an array, by their numbers along its second axis; None for none.

    In pieces: a loop of machine code (`native.loops`) has no rule for any entries whatever.
    """
    if x is None or not some:
        return None
    if some is True:
        return x
    breaks = [0, *(i for i in range(1, len(some)) if some[i] != some[i - 1] + 1), len(some)]
    pieces = [x[:, some[begin] : some[end - 1] + 1] for begin, end in pairwise(breaks)]
    return pieces[0] if len(pieces) == 1 else jnp.concatenate(pieces, 1)
