"""What an FMU shows: inputs and parameters by the paths of numbers of the scene, outputs by names of quantities."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.files.fields.number_units import unit_at
from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import real_number
from spherejax.model.numbers import Number, full_path, numbers_at
from spherejax.model.scene import Scene
from spherejax.model.system import System, compile_scene
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set, velocity_violation
from spherejax.motion.equations.programs import dependence
from spherejax.motion.equations.quantities import LETTERS, Quantity, quantity
from spherejax.physics.state import unpack

NOT_AT_AN_INSTANT = ("penetration", "absorbed_work", "dissipated_energy", "elastic_energy", "mechanical_energy")
"""Kinds of quantities that are made of a whole run, or of several others."""


class Port(NamedTuple):
    """A variable of the FMU.

    Attributes:
        name: path of a number, or name of a quantity.
        unit: SI unit; empty where it is not known, "1" of pure numbers.
        start: its value in the scene; None of an output.
    """

    name: str
    unit: str
    start: float | None = None


class Ports(NamedTuple):
    """All variables of an FMU.

    Attributes:
        inputs: numbers that may change while it runs.
        parameters: numbers that are set before the start.
        outputs: quantities.
        numbers: places of inputs, then parameters.
        quantities: of the outputs, whole vectors where vectors were asked for.
    """

    inputs: tuple[Port, ...]
    parameters: tuple[Port, ...]
    outputs: tuple[Port, ...]
    numbers: tuple[Number, ...]
    quantities: tuple[str, ...]

    @property
    def values(self) -> tuple[Port, ...]:
        """What can be set, in order."""
        return self.inputs + self.parameters

    def scene_with(self, scene: Scene, values) -> Scene:
        """The scene with values of inputs and parameters; they may be traced."""
        for number, value in zip(self.numbers, values, strict=True):
            scene = number.changed(scene, value)
        return scene


def ports_of(
    scene: Scene, inputs: Sequence[str] | str, outputs: Sequence[str] | str, parameters: Sequence[str] | str
) -> Ports:
    """Find what is asked for in a scene.

    Raises:
        SceneError: for names that lead nowhere, with the nearest that do; for one that is given twice; for no output.
    """
    system = compile_scene(scene).system
    found_inputs = _numbers(scene, "inputs", inputs)
    found_parameters = _numbers(scene, "parameters", parameters)
    numbers = [*found_inputs, *found_parameters]
    quantities = _quantities(system, outputs)
    made = [
        Port(f"{each.name}.{letter}" if letter else each.name, each.unit)
        for each in quantities
        for letter in (LETTERS[each.dims] if each.dims else ("",))
    ]
    _require_distinct([number.name for number in numbers], "inputs= and parameters= ask")
    _require_distinct([port.name for port in made], "outputs= asks")
    values = [Port(number.name, unit_at(scene, number.steps) or "", number.value(scene)) for number in numbers]
    n = len(found_inputs)
    return Ports(tuple(values[:n]), tuple(values[n:]), tuple(made), tuple(numbers), tuple(q.name for q in quantities))


def refuse_moving_inputs(scene: Scene, ports: Ports) -> None:
    """Refuse inputs that constraints know: a jump of theirs would tear the joints apart."""

    def held(values, y):
        system = compile_scene(ports.scene_with(scene, values)).system
        motions = body_motions(system, unpack(system.layout, y))
        constraints = constraint_set(system, jnp.zeros(()), motions)
        return jnp.concatenate([jnp.zeros(1), constraints.residual, velocity_violation(constraints, motions)])

    if not ports.inputs:
        return
    size = compile_scene(scene).system.layout.size
    shapes = [jax.ShapeDtypeStruct((n,), jnp.float64) for n in (len(ports.values), size)]
    moved = np.any(dependence(held, *shapes), axis=0)
    for port, moves in zip(ports.inputs, moved[: len(ports.inputs)], strict=True):
        if moves:
            raise SceneError(
                f"export_fmu: input {port.name!r} moves a constraint, and a jump of it would tear the joint apart. "
                "Take a force or a number of a law, give it to parameters=, or let what a driver prescribes act "
                "through a stiff bushing or spring"
            )


def _numbers(scene: Scene, what: str, names: Sequence[str] | str) -> list[Number]:
    names = [names] if isinstance(names, str) else list(names)
    try:
        return [number for name in names for number in numbers_at(scene, full_path(scene, name))]
    except SceneError as error:
        raise SceneError(f"export_fmu: {what}: {error}") from None


def _quantities(system: System, names: Sequence[str] | str) -> list[Quantity]:
    try:
        found = [quantity(name, system) for name in ([names] if isinstance(names, str) else names)]
    except SceneError as error:
        raise SceneError(f"export_fmu: outputs: {error}") from None
    if not found:
        raise SceneError('export_fmu: outputs= names nothing; ask for a quantity, e.g. outputs=["position.rocker.z"]')
    for each in found:
        if each.kind in NOT_AT_AN_INSTANT and not each.of_element and not each.of_answer:
            raise SceneError(f"export_fmu: outputs: {each.name!r} is no quantity of one instant")
    return found


def _require_distinct(names: list[str], what: str) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise SceneError(f"export_fmu: {what} for {twice!r} twice")


def checked_step(name: str, value: float) -> float:
    """A positive finite number of seconds."""
    real_number(name, value)
    number = float(value)
    if not 0 < number < np.inf:
        raise SceneError(f"export_fmu: {name} = {number:g} must be a positive time [s]")
    return number
