"""`sj.vehicle.rig_samples`: the rig of many corners whose numbers differ, in one program, for tolerances of them."""

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.terminals import waiting_for
from spherejax.foundations.types import Numeric
from spherejax.model.system import compile_scene
from spherejax.motion.runs.many import Build
from spherejax.motion.runs.traced_functions import built
from spherejax.studies.rig.bench import Corner
from spherejax.studies.rig.dataset import dataset_of
from spherejax.studies.rig.rig_result import Rig
from spherejax.studies.rig.shown import REASONS, RigStatus, RigWarning
from spherejax.studies.rig.study import PART, WheelLoads, rig
from spherejax.studies.sweep.grids import Grid, as_grid

if TYPE_CHECKING:
    import xarray


def rig_samples(
    build: Build,
    samples: Grid | Mapping[str, Any],
    travel: Numeric = 0.0,
    *,
    steer: Numeric = 0.0,
    loads: WheelLoads | None = None,
    corner: Corner | None = None,
    part: float = PART,
) -> "xarray.Dataset":
    """The rig of many corners whose numbers differ: what tolerances do to toe, camber and the rest.

        spreads = {"height": sj.studies.Tolerance(0.235, 1e-3)}
        found = sj.vehicle.rig_samples(build, sj.studies.random_samples(spreads, 10_000), np.linspace(-0.08, 0.08, 9))
        found["toe"].std("run")

    One program for all of them; ten thousand samples then take seconds. It is kept: a further call with as many samples
    and travels traces it again, and compiles nothing.

    Args:
        build: makes a scene from the numbers, given by keyword. It is traced.
        samples: of `sj.studies.random_samples`, `sj.studies.sobol_samples`, `sj.studies.zipped`, or a list for each
            number, for all combinations.

    Other args:
        travel, steer, loads, corner, part: as of `sj.vehicle.rig`, the same for all samples.

    Returns:
        Curves in SI units with the names of `sj.vehicle.Rig`, over `run` (or the numbers, where all are combined) and
        travel, with the numbers of each run; `status` as there.

    Raises:
        SceneError: as `sj.vehicle.rig`, also for a sample whose number is not legal.

    Warns:
        RigWarning: where positions were not found; their curves are NaN.
    """
    grid = as_grid(samples)
    numbers = {name: jnp.asarray(values) for name, values in grid.rows(0, grid.n_runs).items()}

    def is_legal(numbers):
        conditions = compile_scene(built(build, numbers)).conditions
        return jnp.all(jnp.stack([jnp.array(True), *(jnp.all(jnp.asarray(each)) for each in conditions)]))

    for run in np.flatnonzero(~np.asarray(jax.jit(jax.vmap(is_legal))(numbers))):
        compile_scene(built(build, grid.row(int(run))))  # says what is wrong with it

    def rig_of_samples(numbers):
        def one(numbers):
            return rig(built(build, numbers), travel, steer=steer, loads=loads, corner=corner, part=part)

        # One after the other: in lanes the program compiles four times as long, and runs in half of the time.
        return jax.lax.map(one, numbers)

    with waiting_for("samples of a suspension rig", program="rig_of_samples"):
        found: Rig = jax.tree.map(np.asarray, jax.jit(rig_of_samples)(numbers))
    _warn_of_failures(found, grid)
    return _dataset(found, grid)


def _dataset(found: Rig, grid: Grid) -> "xarray.Dataset":
    one = dataset_of(jax.tree.map(lambda each: each[0], found))
    data: dict[str, Any] = {}
    for name, each in one.data_vars.items():
        values = getattr(found, str(name))
        data[str(name)] = ((*grid.dims, *each.dims), values.reshape(*grid.shape, *values.shape[1:]), each.attrs)
    known = grid.axes or {name: ("run", values) for name, values in grid.rows(0, grid.n_runs).items()}
    return one.drop_vars(list(one.data_vars)).assign_coords(known).assign(data)


def _warn_of_failures(found: Rig, grid: Grid) -> None:
    is_missing = found.status != RigStatus.FOUND
    missing = np.flatnonzero(np.any(is_missing, axis=1))
    if not missing.size:
        return
    run = int(missing[0])
    at = int(np.argmax(is_missing[run]))
    numbers = ", ".join(f"{name} = {value:.6g}" for name, value in grid.row(run).items())
    warnings.warn(
        f"rig_samples: {missing.size} of {grid.n_runs} samples have positions without a result (NaN), the first run "
        f"{run} ({numbers}) at travel = {float(found.travel[run, at]):.6g} m: "
        f"{REASONS[RigStatus(int(found.status[run, at]))]}",
        RigWarning,
        stacklevel=3,
    )
