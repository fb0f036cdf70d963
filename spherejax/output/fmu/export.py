"""`sj.export_fmu`: a scene as a Functional Mock-up Unit, for tools that know nothing of this package."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

import diffrax
import numpy as np

from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.terminals import waiting_for
from spherejax.model.scene import Scene
from spherejax.motion.runs.known_scenes import prepared
from spherejax.motion.runs.simulate import check_tolerances, choice_for
from spherejax.output.fmu.description import Experiment
from spherejax.output.fmu.native import tableau_of, write_native
from spherejax.output.fmu.ports import checked_step, ports_of, refuse_moving_inputs
from spherejax.output.io import make_folder, require_free
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
    """Write a scene as an FMU (FMI 3.0), for co-simulation and model exchange."""
    require_float64()
    check_tolerances(rtol, None)
    path = Path(path).expanduser()
    if path.suffix != ".fmu":
        raise SceneError(f"export_fmu: {str(path)!r} is no FMU; give it the ending .fmu")
    if kind not in KINDS:
        raise SceneError(f"export_fmu: there is no kind {kind!r}; {one_of(KINDS, str(kind))}")
    experiment = Experiment(checked_step("stop_time", stop_time), checked_step("step_size", step_size), float(rtol))
    require_free(path, overwrite=overwrite)
    ports = ports_of(scene, inputs, outputs, parameters)
    found = prepared(scene, False, None)
    choice = found.choice(rtol) if solver is None else choice_for(found.system(), rtol, solver)
    start = found.start(np.zeros(1))
    assert start is not None
    from spherejax.motion.integration.integrate import initial_state

    refuse_moving_inputs(scene, ports, 0.0, initial_state(found.system(), start.assembly))
    identifier = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    identifier = identifier if re.match(r"[A-Za-z_]", identifier) else f"m_{identifier}"
    make_folder(path.parent)
    words = description or f"{path.stem}: a mechanism of {len(scene.bodies)} bodies"
    with waiting_for("an FMU", program="an FMU"):
        write_native(scene, path, identifier, words, ports, choice, experiment)
    _ = tableau_of
    return path
