"""What is fitted: numbers with bounds and scales, and smooth maps from unknowns without bounds to them.

A method sees a vector u of unknowns, of order one and free to take any value. A number p that is positive is
p = exp(u); one in an interval is p = l + (h - l) / (1 + exp(-u)); one with a single bound is p = l + exp(u) or
p = h - exp(u); any other is p = s u with its scale s. Whatever a method tries is legal.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible

FARTHEST = 30.0
"""A number with bounds stays this far from them: exp(-30) of the interval."""


@dataclass(frozen=True, init=False)
class Parameter:
    """A number, or an array of numbers, that is fitted.

    Attributes:
        start: where the fit begins.
        lower, upper: bounds, which no iterate reaches.
        scale: what counts as a large change of it, in its own unit; its size when None.
        positive: fit its logarithm, so that it stays positive; None: where its start is positive and a lower bound,
            if there is one, is not negative.
    """

    start: Any
    lower: float
    upper: float
    scale: float | None
    positive: bool | None

    def __init__(
        self,
        start: Any,
        *,
        lower: float = -np.inf,
        upper: float = np.inf,
        scale: float | None = None,
        positive: bool | None = None,
    ):
        for name, value in (
            ("start", start), ("lower", lower), ("upper", upper), ("scale", scale), ("positive", positive)
        ):  # fmt: skip
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Unknown:
    """One parameter as a method sees it (static).

    Attributes:
        name: of the parameter.
        shape: of the parameter.
        lower, upper: bounds; infinite where there is none.
        scale: of a number without bounds.
    """

    name: str
    shape: tuple[int, ...]
    lower: float
    upper: float
    scale: float

    @property
    def size(self) -> int:
        """Count of its numbers."""
        return int(np.prod(self.shape))

    @property
    def names(self) -> list[str]:
        """Of its numbers."""
        if not self.shape:
            return [self.name]
        return [f"{self.name}[{', '.join(map(str, index))}]" for index in np.ndindex(*self.shape)]

    @property
    def is_relative(self) -> bool:
        """Whether changes of it are counted relative to its size."""
        return self.lower >= 0

    def value_of(self, u: Float[Array, " n"]) -> Array:
        """Numbers from unknowns."""
        low, high = np.isfinite(self.lower), np.isfinite(self.upper)
        if low and high:
            value = self.lower + (self.upper - self.lower) / (1 + jnp.exp(-jnp.clip(u, -FARTHEST, FARTHEST)))
        elif low or high:
            away = jnp.exp(jnp.clip(u, -300.0, 300.0))
            value = self.lower + away if low else self.upper - away
        else:
            value = self.scale * u
        return value.reshape(self.shape)

    def unknown_of(self, value: np.ndarray) -> np.ndarray:
        """Unknowns from numbers within the bounds."""
        low, high = np.isfinite(self.lower), np.isfinite(self.upper)
        value = np.asarray(value, np.float64).ravel()
        if low and high:
            share = (value - self.lower) / (self.upper - self.lower)
            return np.log(share) - np.log1p(-share)
        if low or high:
            return np.log(value - self.lower if low else self.upper - value)
        return value / self.scale


@dataclass(frozen=True)
class FitUnknowns:
    """All parameters as a method sees them (static)."""

    parts: tuple[Unknown, ...]

    @property
    def names(self) -> list[str]:
        """Of all numbers, arrays flattened as `name[0]`, ..."""
        return [name for part in self.parts for name in part.names]

    @property
    def size(self) -> int:
        """Count of all numbers."""
        return sum(part.size for part in self.parts)

    def each(self, attribute: str) -> np.ndarray:
        """An attribute of `Unknown` for each number."""
        return np.concatenate([np.repeat(getattr(part, attribute), part.size) for part in self.parts])

    def values_of(self, u: Float[Array, " k"]) -> dict[str, Array]:
        """Parameters by name, from unknowns."""
        values, at = {}, 0
        for part in self.parts:
            values[part.name] = part.value_of(u[at : at + part.size])
            at += part.size
        return values

    def flat_values_of(self, u) -> np.ndarray:
        """All numbers in the order of `names`."""
        return np.concatenate([np.ravel(value) for value in self.values_of(jnp.asarray(u)).values()])

    def unknowns_of(self, values: Mapping[str, Any]) -> np.ndarray:
        """Unknowns from parameters by name."""
        return np.concatenate([part.unknown_of(values[part.name]) for part in self.parts])

    def scales(self, values: np.ndarray) -> np.ndarray:
        """What counts as a large change of each number: its size, or its scale."""
        return np.where(self.each("is_relative"), np.abs(values), self.each("scale"))


def unknowns_from(start: Mapping[str, Any]) -> tuple[FitUnknowns, dict[str, np.ndarray]]:
    """The parameters that are fitted, and where the fit begins.

    Raises:
        SceneError: for a start that is no number, is not finite, or lies outside its bounds.
    """
    if not isinstance(start, Mapping) or not start:
        raise SceneError(f"start must be a dict of the parameters to fit, {{name: number}}; it is {start!r}")
    parts, values = [], {}
    for name, given in start.items():
        parameter = given if isinstance(given, Parameter) else Parameter(given)
        values[name] = _start_of(name, parameter)
        parts.append(_unknown(name, parameter, values[name]))
    return FitUnknowns(tuple(parts)), values


def _start_of(name: str, parameter: Parameter) -> np.ndarray:
    try:
        value = np.asarray(visible(parameter.start), np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"start of {name!r} must be a number or an array; it is {parameter.start!r}") from error
    if value.size == 0 or not np.all(np.isfinite(value)):
        raise SceneError(f"start of {name!r} must be finite; it is {parameter.start!r}")
    low, high = parameter.lower, parameter.upper
    if not low < high:
        raise SceneError(f"bounds of {name!r}: lower = {low:.6g} must be below upper = {high:.6g}")
    if not np.all((value > low) & (value < high)):
        raise SceneError(
            f"start of {name!r} = {_shown(value)} must lie between its bounds, {low:.6g} and {high:.6g}, on neither"
        )
    if parameter.positive and np.any(value <= 0):
        raise SceneError(f"start of {name!r} = {_shown(value)} must be positive (positive=True)")
    if parameter.scale is not None and not (np.isfinite(parameter.scale) and parameter.scale > 0):
        raise SceneError(f"scale of {name!r} = {parameter.scale:.6g} must be positive")
    return value


def _unknown(name: str, parameter: Parameter, value: np.ndarray) -> Unknown:
    positive = parameter.positive
    if positive is None:
        positive = bool(np.all(value > 0)) and (parameter.lower >= 0 or np.isneginf(parameter.lower))
        # Who gives a scale thinks of differences, not of ratios.
        positive = positive and parameter.scale is None
    lower = max(float(parameter.lower), 0.0) if positive else float(parameter.lower)
    size = float(np.max(np.abs(value)))
    scale = parameter.scale if parameter.scale is not None else (size or 1.0)
    return Unknown(name, value.shape, lower, float(parameter.upper), float(scale))


def _shown(value: np.ndarray) -> str:
    return f"{value.item():.6g}" if value.ndim == 0 else np.array2string(value, precision=6, threshold=12)
