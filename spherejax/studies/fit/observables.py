"""What is compared with measurements: observables of a run by name."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.model.system import System
from spherejax.motion.equations.quantities import Quantity, quantity
from spherejax.motion.results.trajectory import Trajectory
from spherejax.studies.fit.measured import Function


class Observable(NamedTuple):
    """An observable by name (static).

    Attributes:
        name: of the observable.
        unit: of its values; empty where it is not known.
        quantity: a quantity of a run, or None.
        function: a user's function of a run, or None.
    """

    name: str
    unit: str
    quantity: Quantity | None = None
    function: Function | None = None

    @property
    def needs_work(self) -> bool:
        """Whether the run must integrate the work of its joints."""
        return self.quantity is not None and self.quantity.needs_work()

    def of(self, run: Trajectory) -> Float[Array, "n components"]:
        """Its values at the samples."""
        if self.function is not None:
            found: Any = jnp.asarray(self.function(run), jnp.float64)
        else:
            assert self.quantity is not None
            found = self.quantity.of(run)
        if found.ndim not in (1, 2) or found.shape[0] != run.ts.shape[0]:
            raise SceneError(
                f"observable {self.name!r} has shape {found.shape}; it must have one row for each sample, "
                f"({run.ts.shape[0]},) or ({run.ts.shape[0]}, components)"
            )
        return found.reshape(found.shape[0], -1)


def observable(name: str, system: System, functions: dict[str, Function]) -> Observable:
    """An observable of a system by name.

    Raises:
        SceneError: for a name that means nothing, naming what exists.
    """
    if name in functions:
        return Observable(name, "", function=functions[name])
    try:
        found = quantity(name, system)
    except SceneError as problem:
        raise SceneError(f"measured {problem}") from None
    return Observable(name, found.unit, found)


def labels_of(name: str, components: int) -> list[str]:
    """Names of the columns of an observable."""
    letters = {3: "xyz", 4: "wxyz"}.get(components)
    if components == 1:
        return [name]
    return [f"{name}.{letter}" for letter in letters] if letters else [f"{name}[{i}]" for i in np.arange(components)]
