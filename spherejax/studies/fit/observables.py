"""What is compared with measurements: observables of a run by name."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.model.system import System
from spherejax.motion.quantities import AXIS, COMPONENT, OF_BODIES, OF_JOINTS, OF_THE_WHOLE, Quantity, quantity
from spherejax.motion.trajectory import Trajectory
from spherejax.physics.forces import UNITS
from spherejax.studies.fit.measured import Function

LETTERS: dict[tuple[str, ...], str] = {AXIS: "xyz", COMPONENT: "wxyz"}
"""Components of a vector, and of a quaternion."""


class Observable(NamedTuple):
    """An observable as it was asked for (static).

    Attributes:
        name: as it was asked for.
        unit: of its values; empty where it is not known.
        quantity: a quantity of a run, or None.
        component: which component of it is meant; None: all.
        force: name of a force element and of its result, or None.
        function: a user's function of a run, or None.
    """

    name: str
    unit: str
    quantity: Quantity | None = None
    component: int | None = None
    force: tuple[str, str] | None = None
    function: Function | None = None

    @property
    def needs_work(self) -> bool:
        """Whether the run must integrate the work of its joints."""
        return self.quantity is not None and self.quantity.needs_work()

    def of(self, run: Trajectory) -> Float[Array, "n components"]:
        """Its values at the samples."""
        if self.function is not None:
            found: Any = jnp.asarray(self.function(run), jnp.float64)
        elif self.force is not None:
            found = run.force(self.force[0])[self.force[1]]
        else:
            assert self.quantity is not None
            found = self.quantity.of(run)
        if self.component is not None:
            found = found[:, self.component]
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
    element, _, part = name.rpartition(".")
    if element in system.forces:
        return Observable(name, UNITS.get(part, ""), force=(element, part))
    try:
        found = quantity(name, system)
    except SceneError as problem:
        whole, _, letter = name.rpartition(".")
        found = _or_none(whole, system)
        if found is None:
            raise _explained(name, problem, system) from None
        letters = LETTERS.get(found.dims, "")
        if letter not in letters or len(letter) != 1:
            known = ", ".join(f"'{whole}.{each}'" for each in letters) or "it has none"
            raise SceneError(f"{name!r}: {whole!r} has no component {letter!r}; its components are {known}") from None
        return Observable(name, found.unit, found, letters.index(letter))
    return Observable(name, found.unit, found)


def _or_none(name: str, system: System) -> Quantity | None:
    try:
        return quantity(name, system)
    except SceneError:
        return None


def _explained(name: str, problem: SceneError, system: System) -> SceneError:
    kind = name.partition(".")[0]
    if kind in OF_BODIES or kind in OF_JOINTS or kind in OF_THE_WHOLE:
        return SceneError(f"measured {problem}")
    forces = f"; results of force elements are {', '.join(f'{f}.NAME' for f in system.forces)}" if system.forces else ""
    return SceneError(f"measured {problem}{forces}")


def labels_of(name: str, components: int) -> list[str]:
    """Names of the columns of an observable."""
    letters = {3: "xyz", 4: "wxyz"}.get(components)
    if components == 1:
        return [name]
    return [f"{name}.{letter}" for letter in letters] if letters else [f"{name}[{i}]" for i in np.arange(components)]
