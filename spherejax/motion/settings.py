"""How a run is integrated: one record, made where a run is asked for, and handed on whole."""

from functools import lru_cache
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import real_number, whole_number
from spherejax.foundations.remembering.same import Same

SMALLEST_TOLERANCE = 1e-14
"""Relative tolerances below this ask for digits that float64 does not carry (its resolution is 2.2e-16)."""

DEFAULT_MAX_STEPS = 20_000_000
"""Steps of a run where nothing else is said."""

NO_LIMIT = int(np.iinfo(np.int64).max)
"""Steps that no run makes."""

ENOUGH_STEPS = "Leave it out for 20,000,000."
"""What to do about a number of steps that cannot be."""


class RunSettings(eqx.Module):
    """How a run is integrated; the arguments of `simulate`, as they are explained there.

    A run that can be made once more holds the settings that it was made with (`run.settings`): all of their numbers are
    known then, and `solver` is the method that integrated it. They are compared by value.

    Attributes:
        rtol: relative tolerance of a step.
        atol: absolute tolerance; None for one by kind of component.
        solver: a diffrax solver; None for one by the scene.
        is_solver_named: whether the caller named the solver; otherwise it was chosen by the scene.
        stepsize_controller: a diffrax controller; None for that of this package.
        adjoint: a diffrax adjoint; None for derivatives that are integrated beside the motion.
        derivative_rtol: relative tolerance of these; None for what the method has.
        max_steps: largest number of steps.
        track_work: whether the work of each joint is integrated.
        scalar: whether on scalar programs; None by their size.
    """

    rtol: Any = 1e-8
    atol: Any = None
    solver: Any = None
    stepsize_controller: Any = None
    adjoint: Any = None
    derivative_rtol: Any = None
    max_steps: Any = DEFAULT_MAX_STEPS
    track_work: bool = False
    scalar: bool | None = None
    is_solver_named: bool = True

    @property
    def has_traced_budget(self) -> bool:
        """Whether the largest number of steps is traced."""
        return not is_concrete(self.max_steps)

    def checked(self) -> "RunSettings":
        """The same, with a whole number of steps.

        Raises:
            SceneError: for tolerances that no integration can keep, or that ask for none; for a number of steps that
                cannot be.
        """
        return _checked(Same(self)) if self._is_plain else _checked_now(self)

    def replaced(self, **fields: Any) -> "RunSettings":
        """The same with other values of some fields."""
        return RunSettings(**{**vars(self), **fields})

    def traced_conditions(self) -> list:
        """What `checked` asks, of tolerances that are traced: a lane that violates it has the status of a bad value."""
        rtol, atol, derivative_rtol = self.rtol, self.atol, self.derivative_rtol
        conditions = []
        if not is_concrete(rtol):
            conditions.append((rtol >= SMALLEST_TOLERANCE) & (rtol < 1))
        if atol is not None and not is_concrete(atol):
            conditions.append((atol > 0) & (atol < np.inf))
        if derivative_rtol is not None and not is_concrete(derivative_rtol):
            conditions.append(derivative_rtol > 0)
        return conditions

    def tangent_tolerance_factor(self) -> Float[Array, ""] | None:
        """How much larger the errors of derivatives may be than the state's; None for what the method has."""
        if self.derivative_rtol is None:
            return None
        return jnp.asarray(self.derivative_rtol / self.rtol, jnp.float64)

    def of_run(self, solver: diffrax.AbstractSolver) -> "RunSettings | None":
        """The settings by which a run that this solver integrated can be made once more.

        None where it cannot: a controller of the user's judged its steps, or a number is traced.
        """
        return _of_run(Same(self), Same(solver)) if self._is_plain else _of_run_now(self, solver)

    @property
    def _is_plain(self) -> bool:
        """Whether nothing in it can be changed, or is traced: what follows from it is remembered."""
        return _PLAIN.issuperset(map(type, vars(self).values()))

    def __eq__(self, other: Any) -> bool:
        """Whether all values are the same."""
        return isinstance(other, RunSettings) and self._key == other._key and bool(eqx.tree_equal(self, other))

    def __hash__(self) -> int:
        """By the numbers, and by the class of the solver."""
        return hash(self._key)

    @property
    def _key(self) -> tuple:
        numbers = self.rtol, self.atol, self.max_steps, self.track_work, self.scalar, self.is_solver_named
        return type(self.solver), numbers


_PLAIN = frozenset((float, int, bool, type(None)))


def settings_from(*fields: Any) -> RunSettings:
    """The record of fields in their order; of plain numbers the same object each time: to make it, and what follows
    from it, takes longer than to ask for it."""
    return _recorded(_PlainFields(fields)) if _PLAIN.issuperset(map(type, fields)) else RunSettings(*fields)


class _PlainFields:
    """Plain values as the key of a table: to Python 1, 1.0 and True are equal, and NaN is not equal to itself."""

    __slots__ = ("_key", "values")

    def __init__(self, values: tuple):
        self.values = values
        self._key = *map(type, values), *[repr(value) if type(value) is float else value for value in values]

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _PlainFields) and self._key == other._key


@lru_cache(maxsize=64)
def _recorded(fields: _PlainFields) -> RunSettings:
    return RunSettings(*fields.values)


@lru_cache(maxsize=64)
def _checked(settings: Same) -> RunSettings:
    return _checked_now(settings.value)


def _checked_now(settings: RunSettings) -> RunSettings:
    check_tolerances(settings.rtol, settings.atol, settings.derivative_rtol)
    if not is_concrete(settings.max_steps):
        return settings
    steps = whole_number("max_steps", settings.max_steps, ENOUGH_STEPS)
    return RunSettings(**{**vars(settings), "max_steps": steps})


@lru_cache(maxsize=64)
def _of_run(settings: Same, solver: Same) -> RunSettings | None:
    return _of_run_now(settings.value, solver.value)


def _of_run_now(settings: RunSettings, solver: diffrax.AbstractSolver) -> RunSettings | None:
    numbers = filter(eqx.is_array, jax.tree.leaves((solver, settings.rtol, settings.atol)))
    has_traced_budget = not is_concrete(settings.max_steps)
    if settings.stepsize_controller is not None or has_traced_budget or not all(map(is_concrete, numbers)):
        return None
    atol = None if settings.atol is None else float(settings.atol)
    named = settings.solver is not None and settings.is_solver_named
    return RunSettings(
        float(settings.rtol), atol, solver, max_steps=int(settings.max_steps), track_work=settings.track_work,
        scalar=settings.scalar, is_solver_named=named,
    )  # fmt: skip


def check_tolerances(rtol, atol, derivative_rtol=None) -> None:
    """Raise `SceneError` for tolerances that no integration can keep, or that ask for none."""
    real_number("rtol", rtol)
    if atol is not None:
        real_number("atol", atol)
    if is_concrete(rtol) and float(rtol) >= 1:
        raise SceneError(
            f"rtol = {float(rtol):.3g} allows errors as large as the motion itself; use less than 1, e.g. 1e-8"
        )
    if is_concrete(rtol) and not float(rtol) >= SMALLEST_TOLERANCE:
        raise SceneError(
            f"rtol = {float(rtol):.3g} asks for digits that float64 does not carry; use at least "
            f"{SMALLEST_TOLERANCE:.0e}"
        )
    if atol is not None and is_concrete(atol) and not float(atol) > 0:
        raise SceneError(f"atol = {float(atol):.3g} must be positive; entries of the state pass through zero")
    if atol is not None and is_concrete(atol) and not float(atol) < np.inf:
        raise SceneError(f"atol = {float(atol):.3g} allows any error; give a number, or leave it out")
    if derivative_rtol is None:
        return
    real_number("derivative_rtol", derivative_rtol)
    if is_concrete(derivative_rtol) and not float(derivative_rtol) > 0:
        raise SceneError(
            f"derivative_rtol = {float(derivative_rtol):.3g} must be positive; use e.g. 1e-6, or leave it out"
        )
