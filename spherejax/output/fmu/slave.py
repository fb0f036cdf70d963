"""What runs inside an FMU in Python: a scene file, stepped by `motion/runs/pieces.py` under pythonfmu3.

An FMU holds a module of four lines that derives its model from `SceneSlave`; pythonfmu3's library runs it in the
importer's Python.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from pythonfmu3 import CoSimulation, Float64, Fmi3Causality, Fmi3SlaveBase, Fmi3Status, Fmi3StepResult

from spherejax.files.scenes.reading import load_scene
from spherejax.foundations.errors import SceneError
from spherejax.motion.equations.programs import program_for
from spherejax.motion.runs.pieces import Pieces
from spherejax.output.fmu.ports import ports_of
from spherejax.output.fmu.programs import outputs_of

SETTINGS, SCENE = "settings.json", "scene.toml"
"""Files among the FMU's resources."""


class SceneSlave(Fmi3SlaveBase, CoSimulation):
    """A scene as the model of an FMU."""

    def __init__(self, **kwargs: Any):
        super().__init__(**kwargs)
        folder = Path(kwargs["resources"])
        said = json.loads((folder / SETTINGS).read_text(encoding="utf-8"))
        self.modelName = said["identifier"]
        self.scene = load_scene(folder / SCENE)
        self.ports = ports_of(self.scene, said["inputs"], said["outputs"], said["parameters"])
        self.rtol = said["rtol"]
        self.values = [float(port.start or 0.0) for port in self.ports.values]
        self.time, self.y = 0.0, None
        self._pieces: Pieces | None = None
        self._has_begun = self._has_stepped = False
        self.register_variable(Float64("time", causality=Fmi3Causality.independent, getter=lambda: self.time))
        n_inputs = len(self.ports.inputs)
        for k, port in enumerate(self.ports.values):
            kind = Fmi3Causality.input if k < n_inputs else Fmi3Causality.parameter
            self._register(port.name, kind, lambda k=k: self.values[k], lambda value, k=k: self._set(k, value))
        for k, port in enumerate(self.ports.outputs):
            self._register(port.name, Fmi3Causality.output, lambda k=k: self._outputs()[k], None)

    def _register(self, name: str, causality, getter, setter) -> None:
        self.register_variable(Float64(name, causality=causality, getter=getter, setter=setter), nested=False)

    @property
    def pieces(self) -> Pieces:
        """Made when it is needed: its preparation takes a second."""
        if self._pieces is None:
            scene, ports = self.scene, self.ports
            self._pieces = Pieces(lambda values: ports.scene_with(scene, values), np.array(self.values), rtol=self.rtol)
        return self._pieces

    def _set(self, k: int, value: float) -> None:
        if self._has_begun and k >= len(self.ports.inputs) and value != self.values[k]:
            raise SceneError(f"{self.ports.values[k].name} is a parameter: it can be set before the start only")
        self.values[k] = float(value)
        if not self._has_begun:
            self.y = None

    def _outputs(self) -> np.ndarray:
        """At the state reached, with the values that hold now."""
        if self.y is None:
            self.y = self.pieces.start(self.time, np.array(self.values))
        structure = self.pieces.plan.structure
        program = program_for(outputs_of(self.ports.quantities), structure, None, is_quiet=True)
        theta, _ = self.pieces.theta_at(np.array(self.values))
        return np.asarray(program.compute(np.asarray(theta), self.time, self.y))

    def _start(self) -> None:
        self.y = self.pieces.start(self.time, np.array(self.values))
        for change in self.pieces.changes:
            self.log(change, Fmi3Status.warning)

    def exit_initialization_mode(self) -> None:
        """Close the joints; errors say which cannot be, and which number is not legal."""
        self._start()
        self._has_begun = True

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """Go on with the values that were set; a step that fails leaves the state as it was."""
        if not self._has_stepped and current_time != self.time:
            # pythonfmu3 does not hand on the start time: it is that of the first step.
            self.time = current_time
            self._start()
        if abs(current_time - self.time) > 1e-9 * max(step_size, abs(current_time)):
            self.log(f"the FMU stands at {self.time!r} s, not at {current_time!r} s", Fmi3Status.error)
            return Fmi3StepResult(status=Fmi3Status.error)
        self.pieces.system_with(np.array(self.values))  # names a number that is not legal
        made = self.pieces.go_on(self.time, np.asarray(self.y), current_time + step_size, np.array(self.values))
        if made.diagnosis:
            self.log(made.diagnosis, Fmi3Status.discard)
            return Fmi3StepResult(status=Fmi3Status.discard)
        self.time, self.y, self._has_stepped = current_time + step_size, made.y, True
        return Fmi3StepResult(status=Fmi3Status.ok)

    def _get_fmu_state(self) -> dict[str, Any]:
        y = None if self.y is None else [float(each) for each in self.y]
        return {
            "time": self.time, "y": y, "values": list(self.values), "begun": self._has_begun,
            "stepped": self._has_stepped,
        }  # fmt: skip

    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        self.time, self.values = state["time"], list(state["values"])
        self.y = None if state["y"] is None else np.array(state["y"])
        self._has_begun, self._has_stepped = state["begun"], state["stepped"]
