"""`modelDescription.xml` after FMI 3.0: variables with units by their SI exponents, start values, structure."""

import datetime
import importlib.metadata
from collections.abc import Iterable, Sequence
from typing import NamedTuple
from xml.etree import ElementTree

from spherejax.foundations.units.units import PURE, si_exponents
from spherejax.output.fmu.ports import Port, Ports


class Kinds(NamedTuple):
    """What an FMU can do.

    Attributes:
        model_exchange: whether the importer may integrate.
        co_simulation: whether the FMU steps by itself.
        needs_python: whether it runs in the importer's Python.
    """

    model_exchange: bool
    co_simulation: bool
    needs_python: bool = False


class DefaultExperiment(NamedTuple):
    """How it is meant to be run.

    Attributes:
        stop_time: [s].
        step_size: communication step [s].
        rtol: relative tolerance.
    """

    stop_time: float
    step_size: float
    rtol: float


def description(
    identifier: str,
    token: str,
    words: str,
    kinds: Kinds,
    experiment: DefaultExperiment,
    ports: Ports,
    states: Sequence[Port] = (),
    indicators: Sequence[str] = (),
) -> bytes:
    """The text of the file.

    Args:
        identifier: of the model, a name of C.
        token: what an instance is asked with.
        words: what the model is.
        kinds: what it can do.
        experiment: how it is meant to be run.
        ports: inputs, parameters and outputs.
        states: of model exchange.
        indicators: names of event indicators.
    """
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=identifier,
        instantiationToken=token,
        description=words,
        generationTool=f"spherejax {importlib.metadata.version('spherejax')}",
        generationDateAndTime=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        variableNamingConvention="flat",
    )
    able = {
        "modelIdentifier": identifier, "canGetAndSetFMUState": "true", "canSerializeFMUState": "true",
        **({"needsExecutionTool": "true"} if kinds.needs_python else {}),
    }  # fmt: skip
    if kinds.model_exchange:
        ElementTree.SubElement(root, "ModelExchange", able, needsCompletedIntegratorStep="true")
    if kinds.co_simulation:
        ElementTree.SubElement(root, "CoSimulation", able, canHandleVariableCommunicationStepSize="true")
    rates = [Port(f"der({state.name})", _per_second(state.unit)) for state in states]
    marks = [Port(name, PURE) for name in indicators]
    _units(root, [*ports.values, *ports.outputs, *states, *rates])
    categories = ElementTree.SubElement(root, "LogCategories")
    for word in ("Warning", "Discard", "Error", "Fatal"):
        ElementTree.SubElement(categories, "Category", name=f"logStatus{word}", description=f"Messages: fmi3{word}.")
    ElementTree.SubElement(
        root,
        "DefaultExperiment",
        startTime="0.0",
        stopTime=repr(experiment.stop_time),
        tolerance=repr(experiment.rtol),
        stepSize=repr(experiment.step_size),
    )
    variables = ElementTree.SubElement(root, "ModelVariables")
    ElementTree.SubElement(
        variables, "Float64", name="time", valueReference="0", causality="independent", variability="continuous",
        description="time [s]",
    )  # fmt: skip
    first = 1
    places = []
    for kind, group in (
        ({"causality": "input", "variability": "continuous"}, ports.inputs),
        ({"causality": "parameter", "variability": "fixed", "initial": "exact"}, ports.parameters),
        ({"causality": "output", "variability": "continuous", "initial": "calculated"}, ports.outputs),
        ({"causality": "local", "variability": "continuous", "initial": "calculated"}, states),
        ({"causality": "local", "variability": "continuous", "initial": "calculated"}, rates),
        ({"causality": "local", "variability": "continuous", "initial": "calculated"}, marks),
    ):
        places.append(range(first, first + len(group)))
        for reference, port in zip(places[-1], group, strict=True):
            more = {"derivative": str(places[3][reference - places[-1].start])} if group is rates else {}
            _variable(variables, reference, port, {**kind, **more})
        first += len(group)
    _structure(root, *places[2:])
    ElementTree.indent(root)
    return ElementTree.tostring(root, "utf-8", xml_declaration=True)


def _variable(variables, reference: int, port: Port, attributes: dict[str, str]) -> None:
    start = {} if port.start is None else {"start": repr(port.start)}
    unit = {"unit": port.unit} if _is_unit(port.unit) else {}
    said = f"{port.name} [{port.unit}]" if port.unit else port.name
    named = {"name": port.name, "valueReference": str(reference), "description": said}
    ElementTree.SubElement(variables, "Float64", {**named, **attributes, **unit, **start})


def _structure(root, outputs: range, states: range, rates: range, marks: range) -> None:
    structure = ElementTree.SubElement(root, "ModelStructure")
    groups: tuple[tuple[str, Iterable[int]], ...] = (
        ("Output", outputs), ("ContinuousStateDerivative", rates), ("InitialUnknown", [*outputs, *states, *rates]),
        ("EventIndicator", marks),
    )  # fmt: skip
    for word, references in groups:
        for reference in references:
            ElementTree.SubElement(structure, word, valueReference=str(reference))


def _units(root, ports: Sequence[Port]) -> None:
    names = dict.fromkeys(port.unit for port in ports if _is_unit(port.unit))
    if not names:
        return
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for name in names:
        unit = ElementTree.SubElement(definitions, "Unit", name=name)
        factor, powers = si_exponents(name)
        # The schema knows whole powers only: N/m^1.5, of Hertz, is a name without a dimension there.
        if all(power == int(power) for power in powers.values()):
            scale = {} if factor == 1 else {"factor": repr(factor)}
            ElementTree.SubElement(unit, "BaseUnit", {**scale, **{base: str(int(p)) for base, p in powers.items()}})


def _is_unit(unit: str) -> bool:
    return bool(unit) and unit != PURE and " or " not in unit


def _per_second(unit: str) -> str:
    """The unit of a rate."""
    known = {"m": "m/s", "m/s": "m/s^2", "rad/s": "rad/s^2", PURE: "1/s", "J": "W"}
    return known.get(unit, "")
