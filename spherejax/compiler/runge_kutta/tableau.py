"""The equations of a Runge-Kutta step, explicit or of Rosenbrock's kind, and their evaluation as array code.

A step of length h from (t, y) makes increments k_1 ... k_s, each from those before it (sums over j < i):

    x_i = y + sum_j A_ij k_j                                                          the argument of f
    k_i = h f(t + c_i h, x_i)                                                         explicit
    k_i = gamma S(h f(t + c_i h, x_i) + sum_j C_ij k_j + d_i h^2 df/dt)               Rosenbrock

S solves (I - gamma h J) x = b. The end of the step, estimates of its error and states inside it are sums of the
increments. Time within an explicit step may be stretched; with `bend` from -1 to 1 (0: not at all)

    k_i = h (1 - bend (1 - 2 c_i)) f(t + c_i (1 - bend (1 - c_i)) h, x_i)

A `Tableau` has the coefficients. `Tableau.stages` evaluates these lines as array code. `recipe` says which scalar
programs evaluate f and S; `text` writes the same lines in LLVM's language.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

Row = tuple[float, ...]


class Tableau(NamedTuple):
    """The coefficients of a method, in the letters above; hashable, because machine code is kept by it.

    Attributes:
        A: strictly lower, one row for each stage.
        c: instants.
        sums: weights of what is summed over the stages.
        C, d, gamma: of a Rosenbrock method.
    """

    A: tuple[Row, ...]
    c: Row
    sums: tuple[Row, ...] = ()
    C: tuple[Row, ...] = ()
    d: Row = ()
    gamma: float = 0.0

    @classmethod
    def explicit(cls, A: np.ndarray, c: np.ndarray, sums: Sequence[np.ndarray]) -> "Tableau":
        """Of the first stages of an explicit method; weights of stages that are not among them do not count."""
        n = len(c)
        weights = (tuple(np.asarray(row)[:n].tolist()) + (0.0,) * (n - len(row)) for row in sums)
        return cls(_rows(A), _row(c), tuple(weights))

    @classmethod
    def rosenbrock(cls, method: Any) -> "Tableau":
        """Of a Rosenbrock method that has attributes with these letters."""
        return cls(_rows(method.A), _row(method.c), (), _rows(method.C), _row(method.d), float(method.gamma))

    def stages(
        self,
        rate: Callable[[Array, Array], Array],
        t: Array,
        dt: Array,
        h: Array,
        y: Array,
        *,
        solve: Callable[[Array], Array] | None = None,
        slope: Array | float = 0.0,
        bend: Array | None = None,
        n_made: Any = None,
        in_lanes: bool = False,
    ) -> Array:
        """The increments k, shape (s, *y.shape), as array code: one loop, which holds f and S once.

        Args:
            rate: f(t, x).
            t: start of the step.
            dt: its length in the time that f gets.
            h: its length, negative where a run goes back in time.
            y: state at the start.

        Other args:
            solve: S of a Rosenbrock method.
            slope: h dt df/dt of a Rosenbrock method.
            bend: how time within the step is stretched; None for not at all.
            n_made: how many stages are evaluated, the first ones; increments of the others are zero. None for all, and
                then the loop has a derivative in reverse.
            in_lanes: whether the last axis are many runs.
        """
        A, C, c, d = (jnp.asarray(numbers) for numbers in (self.A, self.C, self.c, self.d))
        # For many runs each stage reads only the increments that it has weights for. For one run the branches of the
        # switch would cost more than zeros that are added, in compilation and in reverse.
        arguments = [partial(_moved, row) for row in self.A]

        def with_stage(i, k):
            x = jax.lax.switch(i, arguments, y, k) if in_lanes else y + combined(A[i], k)
            increment = _increment(rate, t, dt, h, c[i], x, bend)
            if solve is not None:
                # Of a state of 32 bits the loop has to carry 32 bits.
                increment = self.gamma * solve(increment + combined(C[i], k) + d[i].astype(y.dtype) * slope)
            return jax.lax.dynamic_update_index_in_dim(k, increment, i, 0)

        n = len(self.c)
        # From zeros: a sum over a whole row of A then reads stages to come, whose weights are zero, as 0 times 0.
        return jax.lax.fori_loop(0, n if n_made is None else n_made, with_stage, jnp.zeros((n, *y.shape), y.dtype))

    def unrolled_stages(
        self,
        rate: Callable[[Array, Array], Array],
        t: Array,
        h: Array,
        y: Array,
        bend: Array | None,
        known: Sequence[Array] = (),
    ) -> list[Array]:
        """The increments of an explicit step of one run, as `stages` returns them, with the loop over stages unrolled.

        Each stage reads the increments with non-zero weights alone. In reverse mode their cotangents are accumulated
        one by one; in the loop of `stages` each stage passes through the cotangents of all increments.

        Args:
            rate, t, h, y, bend: as of `stages`.
            known: the first increments, if they have been evaluated.
        """
        k = [*known]
        for row, instant in zip(self.A[len(k) :], self.c[len(k) :], strict=True):
            k.append(_increment(rate, t, h, h, instant, _moved(row, y, k), bend))
        return k

    def sums_of(self, k: Array | Sequence[Array]) -> list[Array]:
        """The wanted sums of the increments."""
        return [_weighted(weights, k) for weights in self.sums]


def combined(weights: Any, k: Array) -> Array:
    """sum_j weights_j k_j, without a `dot`: one could keep the time loop from being one function."""
    wide = jnp.asarray(weights, k.dtype).reshape(-1, *(1 for _ in k.shape[1:]))
    return jnp.sum(wide * k, axis=0)


def _increment(rate: Callable, t: Array, dt: Array, h: Array, c: Any, x: Array, bend: Array | None) -> Array:
    if bend is None:
        return h * rate(t + c * dt, x)
    instant, speed = c * (1 - bend * (1 - c)), 1 - bend * (1 - 2 * c)
    return h * speed * rate(t + instant * dt, x)


def _moved(row: Row, y: Array, k: Array | Sequence[Array]) -> Array:
    return y + _weighted(row, k)


def _weighted(weights: Row, k: Array | Sequence[Array]) -> Array:
    # A product of matrices is far slower over lanes, and would make 0 times infinity of a stage without weight.
    return sum(w * k[j] for j, w in enumerate(weights) if w)  # pyright: ignore[reportReturnType]


def _row(numbers: Any) -> Row:
    return tuple(np.asarray(numbers).tolist())


def _rows(matrix: Any) -> tuple[Row, ...]:
    return tuple(map(tuple, np.asarray(matrix).tolist()))
