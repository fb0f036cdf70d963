"""Parameters of a builder as a flat list of named numbers."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import visible
from spherejax.model.scene import Scene
from spherejax.motion.integration.sensitivity_rows import scales_of


@dataclass(frozen=True)
class Unknowns:
    """Names of the parameters and what they are made of (static).

    Attributes:
        shapes: name and shape of each parameter.
    """

    shapes: tuple[tuple[str, tuple[int, ...]], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number: `"mass"`, or `"gravity[2]"` of an array, `"inertia[0, 1]"` of a matrix."""
        found = []
        for name, shape in self.shapes:
            entries = np.ndindex(shape)
            found += [f"{name}[{', '.join(map(str, entry))}]" if shape else name for entry in entries]
        return tuple(found)

    def scales(self, numbers) -> Any:
        """Scales of the sensitivities by all numbers, in their order, see `scales_of`."""
        return scales_of(
            numbers, np.repeat(np.arange(len(self.shapes)), [math.prod(shape) for _, shape in self.shapes])
        )

    def by_name(self, numbers) -> dict[str, Any]:
        """The parameters as the builder takes them, from all numbers in order."""
        parameters, start = {}, 0
        for name, shape in self.shapes:
            size = int(np.prod(shape))
            part = numbers[start : start + size]
            parameters[name] = jnp.stack(list(part)).reshape(shape) if shape else part[0]
            start += size
        return parameters


@dataclass(frozen=True)
class FlatBuild:
    """A builder of numbers by their names: as hashable as the one that it wraps, so that programs are found again.

    Attributes:
        build: takes the parameters by keyword.
        unknowns: the parameters.
    """

    build: Callable[..., Scene]
    unknowns: Unknowns

    def __call__(self, **numbers) -> Scene:
        """The scene."""
        return self.build(**self.unknowns.by_name([numbers[name] for name in self.unknowns.names]))


def unknowns_of(parameters: Mapping[str, Any]) -> tuple[Unknowns, Float[np.ndarray, " p"]]:
    """The parameters as numbers with names.

    Raises:
        SceneError: where there is none, or one that is not a finite number.
    """
    if not isinstance(parameters, Mapping) or not parameters:
        raise SceneError('sensitivity needs parameters by name, e.g. {"stiffness": 1e6, "damping": 1e-3}')
    shapes, numbers = [], []
    for name, given in parameters.items():
        value = getattr(given, "start", given)
        try:
            array = np.asarray(visible(value), np.float64) if is_concrete(value) else None
        except (TypeError, ValueError):
            array = None
        if array is None:
            raise SceneError(f"parameter {name!r} must be a number or an array of numbers; it is {value!r}")
        if not np.all(np.isfinite(array)):
            raise SceneError(f"parameter {name!r} must be finite; it is {value!r}")
        shapes.append((str(name), array.shape))
        numbers.append(array.ravel())
    return Unknowns(tuple(shapes)), np.concatenate(numbers)
