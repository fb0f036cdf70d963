"""What a MuJoCo model has that no scene has, or not without being told how; nothing of it is dropped in silence."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from spherejax.files.robots.mjcf_actuators import unread
from spherejax.files.robots.mjcf_model import CompiledFile, library
from spherejax.files.robots.robot_joints import Ways
from spherejax.foundations.errors import SceneError

_MANY = 4
"""Names that an error lists of each sort."""


def check_left_out(file: CompiledFile, ways: Ways) -> None:
    """Refuse what would be lost.

    Raises:
        SceneError: naming all that is, and the argument that leaves it out.
    """
    lost = {word: names for word, find in FINDERS.items() if word not in ways.ignore and (names := list(find(file)))}
    hints = []
    if "friction" in lost and ways.friction is not None:
        del lost["friction"]
    elif "friction" in lost:
        hints.append("friction=sj.Threlfall(mu=1.0, v1=1e-2) says how friction changes with the rate")
    if "limits" in lost:
        lost["limits"] = [name for name in lost["limits"] if not _has_stop(file, name, ways)]
        hints.append('stops={"turning": ..., "sliding": ...} [N m/rad, N/m] says how stiff limits are')
        if not lost["limits"]:
            del lost["limits"]
            hints.pop()
    if "mimic" in lost and ways.mimic:
        del lost["mimic"]
    elif "mimic" in lost:
        hints.append(
            'mimic={"turning": {"stiffness": ...}, "sliding": {"stiffness": ...}} says how stiff couplings are'
        )
    if not lost:
        return
    what = "; ".join(f"{word}: {_listed(names)}" for word, names in lost.items())
    words = ", ".join(repr(word) for word in [*ways.ignore, *lost])
    comma = "," if len(ways.ignore) + len(lost) == 1 else ""
    told = f" ({'; '.join(hints)})" if hints else ""
    raise SceneError(
        f"{file.path}: has what is not modelled here or not said in full: {what}. Leave it out with "
        f"load_mjcf(..., ignore=({words}{comma})){told}"
    )


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _MANY} more" if len(names) > _MANY else ""
    return ", ".join(names[:_MANY]) + more


def _has_stop(file: CompiledFile, name: str, ways: Ways) -> bool:
    kind = file.kind(file.joints.index(name))
    word = {"revolute": "turning", "prismatic": "sliding"}.get(kind)
    return word is not None and (name in ways.stops or word in ways.stops)


def _named(file: CompiledFile, kind: str, number: int) -> str:
    mujoco = library()
    return mujoco.mj_id2name(file.model, getattr(mujoco.mjtObj, f"mjOBJ_{kind}"), number) or f"{kind.lower()} {number}"


def _joints_where(file: CompiledFile, field: str, kinds: tuple[str, ...]) -> Iterator[str]:
    """Joints of some kinds with a number in a field of their degrees of freedom."""
    values = np.asarray(getattr(file.model, field))
    for joint, name in enumerate(file.joints):
        if file.kind(joint) in kinds and np.any(file.of_joint(joint, values, rates=True)):
            yield name


_ALL, _ONE_WAY, _OTHERS = (
    ("floating", "spherical", "prismatic", "revolute"),
    ("prismatic", "revolute"),
    ("floating", "spherical"),
)


def _armature(file: CompiledFile) -> Iterator[str]:
    return _joints_where(file, "dof_armature", _ALL)


def _friction(file: CompiledFile) -> Iterator[str]:
    return _joints_where(file, "dof_frictionloss", _ONE_WAY) if file.has_constraints("FRICTIONLOSS") else iter(())


def _friction_of_balls(file: CompiledFile) -> Iterator[str]:
    return _joints_where(file, "dof_frictionloss", _OTHERS) if file.has_constraints("FRICTIONLOSS") else iter(())


def _damping_of_balls(file: CompiledFile) -> Iterator[str]:
    return _joints_where(file, "dof_damping", _OTHERS) if file.has("DAMPER") else iter(())


def _springs_of_balls(file: CompiledFile) -> Iterator[str]:
    for joint, name in enumerate(file.joints):
        if file.kind(joint) in _OTHERS and np.any(file.model.jnt_stiffness[joint]) and file.has("SPRING"):
            yield name


def _curves(file: CompiledFile) -> Iterator[str]:
    """Springs and dampers that are no straight lines, and springs that yield, which MuJoCo has since 3.5 and 4."""
    model = file.model
    for joint, name in enumerate(file.joints):
        for field in ("jnt_stiffnesspoly", "jnt_springyield"):
            if np.any(np.asarray(getattr(model, field, np.zeros(model.njnt)))[joint]):
                yield f"{name} ({field.removeprefix('jnt_')})"
    damping = np.asarray(getattr(model, "dof_dampingpoly", np.zeros((model.nv, 1))))
    for dof in np.flatnonzero(np.any(damping.reshape(model.nv, -1), axis=1) if model.nv else []):
        yield f"{file.joints[model.dof_jntid[dof]]} (dampingpoly)"


def _limits(file: CompiledFile) -> Iterator[str]:
    for joint, name in enumerate(file.joints):
        if file.model.jnt_limited[joint] and file.has_constraints("LIMIT"):
            yield name


def _tendons(file: CompiledFile) -> Iterator[str]:
    """Tendons that pull, rub or carry mass; others measure lengths for actuators."""
    model = file.model
    fields = ("stiffness", "damping", "frictionloss", "limited", "armature", "stiffnesspoly", "dampingpoly")
    for tendon in range(model.ntendon):
        if any(np.any(np.asarray(getattr(model, f"tendon_{one}", np.zeros(model.ntendon)))[tendon]) for one in fields):
            yield _named(file, "TENDON", tendon)


def _equalities(file: CompiledFile, kinds: Callable[[str], bool]) -> Iterator[str]:
    mujoco = library()
    if not file.has_constraints("EQUALITY"):
        return
    for number in range(file.model.neq):
        kind = mujoco.mjtEq(int(file.model.eq_type[number])).name.removeprefix("mjEQ_").lower()
        if file.model.eq_active0[number] and kinds(kind):
            yield f"{_named(file, 'EQUALITY', number)} ({kind})"


def _other_equalities(file: CompiledFile) -> Iterator[str]:
    return _equalities(file, lambda kind: kind not in ("connect", "weld", "joint"))


def _mimics(file: CompiledFile) -> Iterator[str]:
    return _equalities(file, lambda kind: kind == "joint")


def _fluid(file: CompiledFile) -> Iterator[str]:
    options = file.model.opt
    if options.density or options.viscosity:
        yield f"density {options.density:g} kg/m^3, viscosity {options.viscosity:g} Pa s"


def _gravity_compensation(file: CompiledFile) -> Iterator[str]:
    for body in np.flatnonzero(file.model.body_gravcomp):
        yield file.bodies[body]


def _mocap(file: CompiledFile) -> Iterator[str]:
    for body in np.flatnonzero(np.asarray(file.model.body_mocapid) >= 0):
        yield file.bodies[body]


def _plugins(file: CompiledFile) -> Iterator[str]:
    return iter([_named(file, "PLUGIN", i) for i in range(file.model.nplugin)])


def _flexes(file: CompiledFile) -> Iterator[str]:
    return iter([_named(file, "FLEX", i) for i in range(file.model.nflex)])


def _contacts(file: CompiledFile) -> Iterator[str]:
    """Pairs of geoms that MuJoCo lets touch: by their masks, on bodies that move against each other, not excluded."""
    model: Any = file.model
    if not file.has_constraints("CONTACT"):
        return
    for pair in range(model.npair):
        yield _pair(file, model.pair_geom1[pair], model.pair_geom2[pair])
    excluded = {int(one) for one in model.exclude_signature}
    filters_parents = file.has("FILTERPARENT")
    for first in range(model.ngeom):
        for second in range(first + 1, model.ngeom):
            if not (
                model.geom_contype[first] & model.geom_conaffinity[second]
                or model.geom_contype[second] & model.geom_conaffinity[first]
            ):
                continue
            bodies = sorted(int(model.geom_bodyid[geom]) for geom in (first, second))
            welded = [int(model.body_weldid[body]) for body in bodies]
            parents = [int(model.body_weldid[model.body_parentid[one]]) for one in welded]
            apart = welded[0] != welded[1] and (bodies[0] << 16) + bodies[1] not in excluded
            related = welded[0] == parents[1] or welded[1] == parents[0]
            if apart and not (filters_parents and related and all(welded)):
                yield _pair(file, first, second)


def _pair(file: CompiledFile, first: int, second: int) -> str:
    return " on ".join(_named(file, "GEOM", int(one)) for one in (first, second))


FINDERS: dict[str, Callable[[CompiledFile], Iterator[str]]] = {
    "actuators": unread,
    "armature": _armature,
    "contacts": _contacts,
    "curves": _curves,
    "ball damping": _damping_of_balls,
    "ball friction": _friction_of_balls,
    "ball springs": _springs_of_balls,
    "equalities": _other_equalities,
    "flexes": _flexes,
    "fluid": _fluid,
    "friction": _friction,
    "gravcomp": _gravity_compensation,
    "limits": _limits,
    "mimic": _mimics,
    "mocap": _mocap,
    "plugins": _plugins,
    "tendons": _tendons,
}
"""What can be left out, by the word for it, and what a file has of it."""
