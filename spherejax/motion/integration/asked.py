"""How a run was asked for, so that it can be made once more."""

from dataclasses import dataclass
from typing import Any

import diffrax
import equinox as eqx


@dataclass(frozen=True, eq=False)
class Asked:
    """How a run was integrated; numbers that are known (static: it is hashed and compared by value).

    Attributes:
        solver: a diffrax solver.
        rtol: relative tolerance.
        atol: absolute tolerance; None for one by kind of component.
        max_steps: largest number of steps.
        by_name: whether the caller named the method; otherwise it was chosen by the scene.
        scalar: what the caller said of scalar programs; None: nothing.
    """

    solver: diffrax.AbstractSolver
    rtol: float
    atol: float | None
    max_steps: int
    by_name: bool = False
    scalar: bool | None = None

    def __eq__(self, other: Any) -> bool:
        return (
            isinstance(other, Asked)
            and self._numbers == other._numbers
            and type(self.solver) is type(other.solver)
            and bool(eqx.tree_equal(self.solver, other.solver))
        )

    def __hash__(self) -> int:
        return hash((type(self.solver), self._numbers))

    @property
    def _numbers(self) -> tuple:
        return self.rtol, self.atol, self.max_steps, self.by_name, self.scalar
