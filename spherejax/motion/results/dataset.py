"""A run as an `xarray.Dataset`: every quantity labelled, with its unit."""

import importlib.metadata
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np

from spherejax.foundations.errors import SceneError
from spherejax.motion.integration.status import Status
from spherejax.motion.results.impacts import COLUMNS
from spherejax.physics.forces.base import UNITS
from spherejax.physics.joints.base import PART_UNITS

if TYPE_CHECKING:
    import xarray

AXES = ("x", "y", "z")
Column = tuple[tuple[str, ...], object, str, str]
"""Dimensions, values, unit, long name."""

NOT_UNIQUE = (
    "Redundant constraints: the motion does not determine the share of each joint in not_unique_for; the values are "
    "one of many possible answers. Their sum on a body is unique."
)
"""Comment of a table whose reactions are not unique."""

COMPONENTS = ("w", "x", "y", "z")


def to_dataset(run: Any, *, every: int = 1) -> "xarray.Dataset":
    """A run as a labelled data set.

    Dimensions: `time`; `body` (all moving bodies); `joint` (all joints); `spherical_joint` (those with an
    eccentricity); `clearance_joint` (those with a clearance); `force_joint` (those that answer with a force, or have
    friction); `contact_joint`; `axis` (x, y, z of the world); `component` (w, x, y, z of a quaternion); `memory`. The
    results of a force element and the parts of a joint's answer are variables of their own: `shock.length`,
    `tyre.load`, `elbow.normal_force`, `elbow.film_pressure`, ...

    Args:
        run: a `Trajectory`, a single run; of a batch, take a lane first.
        every: keep every so many samples.

    Returns:
        The data set; a quantity that no joint of the scene has is left out. Units and names are in the
        variables' attributes; `reaction` and `reaction_moment` name in `not_unique_for` the joints whose share the
        motion does not determine; statistics, status, method and versions in the data set's.

    Raises:
        SceneError: for a batch of runs.
    """
    import xarray

    if np.ndim(run.ts) != 1 or np.ndim(run.status) != 0:
        raise SceneError(
            "to_dataset takes a single run; take one lane of the batch first, e.g. jax.tree.map(lambda x: x[0], runs)"
        )
    run = run if every == 1 else _thinned(run, every)
    columns = {**_of_bodies(run), **_of_joints(run), **_of_forces(run), **_of_the_whole(run)}
    variables = {
        name: (dims, np.asarray(values), {"units": unit, "long_name": long_name})
        for name, (dims, values, unit, long_name) in columns.items()
    }
    coordinates = {
        "time": ("time", np.asarray(run.ts), {"units": "s", "long_name": "time"}),
        "body": list(run.system.bodies),
        "joint": list(run.system.joints),
        "axis": list(AXES),
        "component": list(COMPONENTS),
        **_joint_coordinates(run),
    }
    found = xarray.Dataset(variables, coordinates, _attributes(run))
    for variable, part in (("reaction", "force"), ("reaction_moment", "moment")):
        if names := [name for name, parts in run.undetermined_reactions.items() if part in parts]:
            found[variable].attrs["not_unique_for"] = ", ".join(names)
            found[variable].attrs["comment"] = NOT_UNIQUE
    return found


def _thinned(run: Any, every: int) -> Any:
    """The run at one of `every` samples. What has been observed at all of them is not evaluated again."""
    few = eqx.tree_at(lambda each: (each.ts, each.ys), run, (np.asarray(run.ts)[::every], np.asarray(run.ys)[::every]))
    if "observation" in vars(run):
        vars(few)["observation"] = jax.tree.map(lambda values: np.asarray(values)[::every], run.observation)
    return few


def _spherical(run: Any) -> list[str]:
    return [name for name in run.system.joints if name in run.observation.eccentricity]


def _with_clearance(run: Any) -> list[str]:
    return [name for name in _spherical(run) if run.system.spherical(name).model.has_surfaces]


def _joint_coordinates(run: Any) -> dict:
    memory = [f"{slot.joint}.{name}" for slot in run.system.memory_slots for name in slot.names]
    candidates = {
        "spherical_joint": _spherical(run),
        "clearance_joint": _with_clearance(run),
        "force_joint": list(run.system.resisting_joints),
        "contact_joint": list(run.system.contact_joints),
        "memory": memory,
    }
    return {name: values for name, values in candidates.items() if values}


def _of_bodies(run: Any) -> dict[str, Column]:
    # By name, never by place: the order of the state is the core's own business.
    def of_all(quantity):
        return _stack(quantity(body) for body in run.system.bodies)

    vector, turned = ("time", "body", "axis"), ("time", "body", "component")
    return {
        "position": (vector, of_all(run.position), "m", "center of mass, world axes"),
        "quaternion": (turned, of_all(run.quaternion), "1", "orientation, unit quaternion, scalar first"),
        "velocity": (vector, of_all(run.velocity), "m/s", "velocity of the center of mass, world axes"),
        "angular_velocity": (vector, of_all(run.angular_velocity), "rad/s", "angular velocity, world axes"),
        "acceleration": (
            vector,
            of_all(run.acceleration),
            "m/s^2",
            "acceleration of the center of mass, world axes",
        ),
        "angular_acceleration": (
            vector,
            of_all(run.angular_acceleration),
            "rad/s^2",
            "angular acceleration, world axes",
        ),
    }


def _of_joints(run: Any) -> dict[str, Column]:
    seen, system = run.observation, run.system
    if not system.joints:
        return {}
    joints, spherical = ("time", "joint", "axis"), ("time", "spherical_joint", "axis")
    gap = ("time", "clearance_joint")
    columns: dict[str, Column] = {
        "reaction": (joints, _stack(run.reaction(name) for name in system.joints), "N",
                     "force on the joint's second body, of a spherical joint the ball's, world axes"),
        "reaction_moment": (joints, _stack(run.reaction_moment(name) for name in system.joints), "N m",
                            "moment on the joint's second body about the joint's point, world axes"),
    }  # fmt: skip
    for name in seen.driving_effort:
        effort = run.driving_effort(name)
        dims = ("time", "axis") if effort.ndim == 2 else ("time",)
        unit = system.joints[name].effort_unit
        what = "torque" if unit == "N m" else "force"
        columns[f"driving_effort_{name}"] = (dims, effort, unit, f"{what} of the driver {name}")
        power = run.driving_power(name)
        columns[f"driving_power_{name}"] = (("time",), power, "W", f"power that the driver {name} puts in")
    if seen.eccentricity:
        columns["eccentricity"] = (
            spherical, _stack(run.eccentricity(name) for name in _spherical(run)), "m",
            "from the socket's center to the ball's, world axes"
        )  # fmt: skip
        columns["eccentricity_rate"] = (
            spherical, _stack(run.eccentricity_rate(name) for name in _spherical(run)), "m/s",
            "time derivative of the eccentricity, world axes"
        )  # fmt: skip
    if names := _with_clearance(run):
        columns["penetration"] = (
            gap, _stack(run.penetration(name) for name in names), "m", "|e| - clearance, negative in flight"
        )  # fmt: skip
        columns["clearance"] = (
            gap[1:], [float(run.clearance(name)) for name in names], "m", "radial clearance of the joint"
        )  # fmt: skip
    for name in seen.parts:
        own = {part: values for part, values in run.parts(name).items() if part not in columns}
        columns |= _named_parts(name, own, "joint", PART_UNITS | UNITS)
    if seen.elastic_energy:
        columns["elastic_energy"] = (
            ("time", "force_joint"), _stack(seen.elastic_energy[name] for name in system.resisting_joints), "J",
            "energy stored in the joint"
        )  # fmt: skip
    if system.tracks_work and system.resisting_joints:
        dims = ("time", "force_joint")
        columns["absorbed_work"] = (
            dims,
            run.state.work[..., : len(system.resisting_joints)],
            "J",
            "work that the joint has taken from the bodies",
        )
        dissipated = _stack(run.dissipated_energy(name) for name in system.resisting_joints)
        columns["dissipated_energy"] = (dims, dissipated, "J", "energy that the joint has dissipated")
    if n_memory := sum(len(slot.contents) for slot in run.system.memory_slots):
        columns["joint_memory"] = (
            ("time", "memory"),
            run.state.memory[..., :n_memory],
            "m/s or m",
            "what contact and friction laws remember",
        )
    return columns


def _of_forces(run: Any) -> dict[str, Column]:
    columns: dict[str, Column] = {}
    for name in run.system.forces:
        columns |= _named_parts(name, run.force(name), "force element", run.system.forces[name].part_units)
    for slot in run.system.force_slots:
        for i, entry in enumerate(slot.contents):
            values = run.state.memory[..., slot.start + i]
            what = f"{entry.name} that force element {slot.joint} remembers"
            columns.setdefault(f"{slot.joint}.{entry.name}", (("time",), values, entry.unit, what))
    return columns


def table_of(columns: dict[str, Any], joint: str) -> "xarray.Dataset":
    """The contacts of a joint, `impacts.COLUMNS`, as a data set with the dimension `contact`."""
    xarray = importlib.import_module("xarray")
    found = {}
    for name, (unit, what) in COLUMNS.items():
        values = np.asarray(columns[name])
        found[name] = (("contact", "axis")[: values.ndim], values, {"units": unit, "long_name": what})
    n = len(np.asarray(columns["onset"]))
    return xarray.Dataset(found, {"contact": np.arange(n), "axis": list(AXES)}, {"joint": joint})


def _named_parts(name: str, parts: dict[str, Any], what: str, units: Mapping[str, str]) -> dict[str, Column]:
    """Numbers and vectors over time, as `name.part`."""
    columns: dict[str, Column] = {}
    for part, values in parts.items():
        vector = np.ndim(values) == 2 and np.shape(values)[1] == len(AXES)
        if np.ndim(values) == 1 or vector:
            dims = ("time", "axis") if vector else ("time",)
            columns[f"{name}.{part}"] = dims, values, units.get(part, ""), f"{part} of {what} {name}"
    return columns


def _of_the_whole(run: Any) -> dict[str, Column]:
    columns: dict[str, Column] = {
        "kinetic_energy": (("time",), run.kinetic_energy, "J", "kinetic energy of all bodies"),
        "potential_energy": (("time",), run.potential_energy, "J", "energy of weight and force elements"),
        "mechanical_energy": (("time",), run.mechanical_energy, "J", "kinetic, potential and elastic energy"),
        "supplied_work": (("time",), run.supplied_work, "J", "work put in by drivers and others that may add energy"),
        "constraint_violation": (("time",), run.constraint_violation, "m or 1", "largest entry of |Phi|"),
        "velocity_violation": (("time",), run.velocity_violation, "m/s or 1/s", "largest entry of |Phi_dot|"),
    }
    if run.system.contact_joints:
        columns["n_onsets"] = (("contact_joint",), run.stats.n_onsets, "1", "contact onsets of the joint")
    return columns


def _attributes(run: Any) -> dict:
    """Only strings and numbers: netCDF knows no others."""
    versions = {name: importlib.metadata.version(name) for name in ("spherejax", "jax", "diffrax")}
    return {
        "status": Status(int(run.status)).name.lower(),
        "diagnosis": run.diagnosis or "none: the run reached its end",
        "t_reached": float(run.t_reached),
        "method": run.choice,
        "n_steps": int(run.stats.n_steps),
        "n_accepted_steps": int(run.stats.n_accepted),
        "n_rejected_steps": int(run.stats.n_rejected),
        "n_evaluations": int(run.stats.n_evaluations),
        "start_moved_by": float(np.max(np.abs(np.asarray(run.assembly.residual_before)))),
        **{f"{name}_version": version for name, version in versions.items()},
    }


def _stack(values) -> np.ndarray:
    """Columns of the joints side by side, shape (n, n_joints, ...)."""
    return np.stack([np.asarray(value) for value in values], axis=1)
