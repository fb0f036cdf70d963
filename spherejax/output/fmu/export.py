"""`sj.export_fmu`: a scene as a Functional Mock-up Unit, for tools that know nothing of this package."""

import os
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import diffrax
import numpy as np

from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.terminals import waiting_for
from spherejax.model.scene import Scene
from spherejax.motion.runs.preparation import chosen_method, closed_start, prepared
from spherejax.motion.runs.simulate import choice_for
from spherejax.motion.settings import check_tolerances
from spherejax.motion.solvers.automatic import SolverChoice
from spherejax.motion.start.start_now import StartWarning
from spherejax.output.fmu.description import DefaultExperiment
from spherejax.output.fmu.in_python import write_python
from spherejax.output.fmu.native import write_native
from spherejax.output.fmu.ports import Ports, checked_step, ports_of, refuse_moving_inputs
from spherejax.output.paths import make_folder, require_free
from spherejax.runtime import require_float64

KINDS = ("c", "python")


def export_fmu(
    scene: Scene,
    path: str | os.PathLike[str],
    *,
    outputs: Sequence[str] | str,
    inputs: Sequence[str] | str = (),
    parameters: Sequence[str] | str = (),
    kind: str = "c",
    rtol: float = 1e-8,
    solver: diffrax.AbstractSolver | None = None,
    stop_time: float = 1.0,
    step_size: float = 1e-3,
    description: str = "",
    overwrite: bool = False,
) -> Path:
    """Write a scene as an FMU (Functional Mock-up Unit, FMI 3.0), which simulation tools of other kinds can run.

    `kind="c"`: the equations as C source, and compiled for this machine. It needs nothing where it runs, no Python
    either, and other machines can compile the source in it. It serves model exchange (the tool integrates; contacts are
    event indicators) of any scene whose laws have a scalar program; and co-simulation (it steps by itself, with the
    explicit method that `simulate` would take, landing on contacts, audited) where that method is an explicit one.

    `kind="python"`: the scene as a scene file, run by this package in the tool's own Python with pythonfmu3 (the extra
    `fmu`): co-simulation of any scene that a file can hold, with the stiff methods too, in tools that are Python, such
    as FMPy. No code of yours is put into it.

    Inputs hold their values over a communication step, so that results differ from those of a continuous input by
    the order of that step, 1. Without inputs, results are those of `simulate` to its tolerance.

    Args:
        scene: the mechanism.
        path: the file, `.fmu`. Its name is that of the model.

    Other args:
        outputs: quantities of one instant, e.g. `"position.rocker.z"`, `"reaction.elbow"`, `"shock.length"`; a vector
            counts as its entries.
        inputs: paths of numbers of the scene that may change during a run, e.g. `"forces.push.force.z"`,
            `"gravity.z"`; as of `sj.linearize`. A number must not move a constraint.
        parameters: paths of numbers that may be set before the start, e.g. `"joints.elbow.model.clearance"`,
            `"bodies.rocker.mass"`. The start is assembled with them.
        kind: "c" or "python".
        rtol: relative tolerance of a step of co-simulation; fixed.
        solver: an explicit diffrax method for co-simulation in C; chosen by the scene when None.
        stop_time, step_size: what the FMU suggests [s].
        description: what the model is, for the tool that loads it.
        overwrite: replace an existing file.

    Returns:
        The path.

    Warns:
        StartWarning: where the joints do not allow the positions or velocities of the scene. The FMU itself compares
            them at each start, with the parameters that are set then: its log says what was changed, and
            fmi3ExitInitializationMode returns fmi3Warning.

    Raises:
        SceneError: for names that lead nowhere, with the nearest ones; for inputs that move a constraint; for a scene
            that this kind cannot hold; without a C compiler or without pythonfmu3; each with the remedy.

    Source: FMI 3.0.2, https://fmi-standard.org/docs/3.0.2/.
    """
    require_float64()
    check_tolerances(rtol, None)
    path = _checked(path, kind)
    experiment = DefaultExperiment(
        checked_step("stop_time", stop_time), checked_step("step_size", step_size), float(rtol)
    )
    require_free(path, overwrite=overwrite)
    ports = ports_of(scene, inputs, outputs, parameters)
    choice = _choice(scene, kind, rtol, solver)
    refuse_moving_inputs(scene, ports)
    make_folder(path.parent)
    words = description or f"{path.stem}: a mechanism of {len(scene.bodies)} bodies"
    with waiting_for("an FMU", program="an FMU"):
        if kind == "c":
            write_native(scene, path, _identifier(path), words, ports, choice, experiment)
        else:
            write_python(scene, path, _identifier(path), words, ports, experiment, _asked(ports))
    return path


def _checked(path: str | os.PathLike[str], kind: str) -> Path:
    path = Path(path).expanduser()
    if path.suffix != ".fmu":
        raise SceneError(f"export_fmu: {str(path)!r} is no FMU; give it the ending .fmu")
    if kind not in KINDS:
        raise SceneError(f"export_fmu: there is no kind {kind!r}; {one_of(KINDS, str(kind))}")
    return path


def _choice(scene: Scene, kind: str, rtol: float, solver: diffrax.AbstractSolver | None) -> SolverChoice:
    """The method, of a scene whose start was found to close."""
    found = prepared(scene, False, None)
    if solver is not None and (kind == "python" or not isinstance(solver, diffrax.AbstractERK)):
        raise SceneError(
            f"export_fmu: solver = {type(solver).__name__}() cannot be taken along: in C steps are those of an "
            "explicit Runge-Kutta method, e.g. diffrax.Dopri8(), and in Python the scene chooses; leave it out"
        )
    sampled = found.system().sampled_forces if kind == "c" else ()
    if sampled:
        raise SceneError(
            f"export_fmu: force element {sampled[0]!r} samples at instants of its own, which an FMU in C has not; "
            "leave it out and give its effort as an input, which the importer samples"
        )
    choice = chosen_method(found, rtol) if solver is None else choice_for(None, rtol, solver)
    start = closed_start(found, np.zeros(1))
    for change in start.changes if start is not None else ():
        warnings.warn(change, StartWarning, stacklevel=3)
    return choice


def _identifier(path: Path) -> str:
    """The name of the file as a name of C."""
    word = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    return word if re.match(r"[A-Za-z_]", word) else f"m_{word}"


def _asked(ports: Ports) -> dict[str, list[str]]:
    """Names of what is asked for, with nothing left out."""
    return {
        "inputs": [port.name for port in ports.inputs],
        "parameters": [port.name for port in ports.parameters],
        "outputs": list(ports.quantities),
    }
