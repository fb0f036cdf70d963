"""What a reader wants to know about a sweep: scene, tolerances, method, versions, commit."""

import hashlib
import re
from pathlib import Path
from typing import Any

import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.integration.widths import platform_of_runs
from spherejax.motion.runs.batch_setup import BatchSettings
from spherejax.motion.runs.traced_functions import Build, built
from spherejax.studies.sweep.commit import commit_of
from spherejax.studies.sweep.grids import Grid
from spherejax.studies.sweep.records import Record
from spherejax.studies.sweep.store import times_fingerprint


def example_of(build: Build, grid: Grid) -> Scene:
    """The scene of the first run that can be built; the others' errors become their status.

    Raises:
        SceneError: when none can be built.
    """
    problem: SceneError | None = None
    for run in sorted({0, grid.n_runs // 2, grid.n_runs - 1}):
        try:
            scene = built(build, grid.row(run))
            compile_scene(scene)
            return scene
        except SceneError as error:
            problem = problem or error
        except TypeError as error:
            raise SceneError(f"build cannot be called with the parameters {', '.join(grid.names)}: {error}") from error
    assert problem is not None
    raise problem


def provenance(scene: Scene, grid: Grid, settings: BatchSettings, ts: np.ndarray, wanted: Record) -> dict[str, Any]:
    """Scene, tolerances, method, versions, commit."""
    from importlib.metadata import version

    runs = settings.runs
    structure, theta = flatten_system(compile_scene(scene).system)
    # A function in the scene is printed with its address, which is another one in each process.
    described = re.sub(r" at 0x[0-9a-f]+", "", repr((structure.tree, structure.shapes)))
    return {
        "scene": f"bodies {', '.join(scene.bodies)}; joints {', '.join(scene.joints)}",
        "structure": _digest(described),
        "numbers": _digest(np.asarray(theta).tobytes().hex()),
        "grid_kind": grid.kind,
        "record": wanted.described,
        "times": times_fingerprint(ts),
        "rtol": float(runs.rtol),
        "atol": "by component" if runs.atol is None else float(runs.atol),
        **({} if runs.derivative_rtol is None else {"derivative_rtol": float(runs.derivative_rtol)}),
        "method": settings.reason,
        "max_steps": runs.max_steps,
        "lanes": settings.block.in_words,
        "platform": platform_of_runs(),
        **{f"{name}_version": version(name) for name in ("spherejax", "jax", "diffrax")},
        "commit": commit_of(Path.cwd()),
    }


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
