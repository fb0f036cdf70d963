"""MuJoCo models drawn at random, and accelerations of their bodies as MuJoCo finds them."""

from typing import Any

import numpy as np

import spherejax as sj

OFF = '<option gravity="0.3 -0.2 -9.81"><flag contact="disable" limit="disable"/></option>'


def numbers(values) -> str:
    return " ".join(repr(float(one)) for one in np.ravel(values))


def random_inertial(rng) -> str:
    """Mass and moments of some real body: a box, in axes of its own."""
    mass, edges = rng.uniform(0.5, 2.0), rng.uniform(0.1, 0.4, 3)
    moments = mass / 12 * (np.sum(edges**2) - edges**2)
    place, turn = rng.normal(scale=0.1, size=3), rng.normal(size=4)
    return f'<inertial pos="{numbers(place)}" quat="{numbers(turn)}" mass="{mass}" diaginertia="{numbers(moments)}"/>'


def random_joint(rng, name: str, kind: str) -> str:
    """A joint beside the body's origin, with a spring and a damper where it has one axis."""
    where = f'name="{name}" type="{kind}" pos="{numbers(rng.normal(scale=0.1, size=3))}"'
    if kind == "ball":
        return f"<joint {where}/>"
    spring = f'stiffness="{rng.uniform(1, 9)}" springref="{rng.uniform(-1, 1)}" damping="{rng.uniform(0.1, 0.5)}"'
    return f'<joint {where} axis="{numbers(rng.normal(size=3))}" ref="{rng.uniform(-0.3, 0.3)}" {spring}/>'


def random_tree(rng, kinds) -> str:
    """A tree with one joint of each kind, each on a body that was there before, or on the world."""
    texts: dict[str, list[str]] = {"world": []}
    parents = {}
    for k, kind in enumerate(kinds):
        name = f"b{k}"
        parents[name] = "world" if kind == "free" or k == 0 else f"b{rng.integers(k)}"
        joint = "<freejoint/>" if kind == "free" else random_joint(rng, f"j{k}", kind) if kind != "weld" else ""
        turn, place = rng.normal(size=4), rng.normal(scale=0.3, size=3)
        head = f'<body name="{name}" pos="{numbers(place)}" quat="{numbers(turn)}">{joint}{random_inertial(rng)}'
        texts[name] = [head]
    for name in reversed(parents):
        texts[parents[name]].append("".join(texts[name]) + "</body>")
    return f'<mujoco><compiler angle="radian"/>{OFF}<worldbody>{"".join(texts["world"])}</worldbody></mujoco>'


def random_state(model, rng) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """MuJoCo's positions and velocities, and the same as arguments of `load_mjcf`."""
    import mujoco

    q, v = np.array(model.qpos0), rng.normal(size=model.nv)
    positions, velocities = {}, {}
    for joint in range(model.njnt):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
        name = name or mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, model.jnt_bodyid[joint]) + "_joint"
        n_q, n_v = {0: (7, 6), 1: (4, 3)}.get(int(model.jnt_type[joint]), (1, 1))
        at_q, at_v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        q[at_q : at_q + n_q] += rng.uniform(-1, 1, n_q)
        if n_q > 1:
            quaternion = q[at_q + n_q - 4 : at_q + n_q]
            quaternion /= np.linalg.norm(quaternion)
        positions[name] = q[at_q] if n_q == 1 else q[at_q : at_q + n_q].copy()
        velocities[name] = v[at_v] if n_v == 1 else v[at_v : at_v + n_v].copy()
    return q, v, {"positions": positions, "velocities": velocities}


def body_accelerations(model, data, qacc=None) -> dict[str, np.ndarray]:
    """Linear and angular acceleration of each body at its center of mass, world axes, from MuJoCo's Jacobians.

    With a = J qacc + (dJ/dt) qvel; MuJoCo knows the second part, too.
    """
    import mujoco

    qacc = data.qacc if qacc is None else qacc
    found = {}
    for body in range(1, model.nbody):
        linear, turning = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, linear, turning, data.xipos[body], body)
        linear_rate, turning_rate = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacDot(model, data, linear_rate, turning_rate, data.xipos[body], body)
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body)
        found[name] = np.concatenate(
            [linear @ qacc + linear_rate @ data.qvel, turning @ qacc + turning_rate @ data.qvel]
        )
    return found


def scene_accelerations(scene: sj.Scene) -> dict[str, np.ndarray]:
    """The same as the right-hand side of a run has them at the start."""
    from spherejax.model.system import flatten_system
    from spherejax.motion.equations.dynamics import state_rate
    from spherejax.motion.equations.programs import program_for
    from spherejax.motion.integration.problem import initial_state
    from spherejax.motion.start.start_now import known_start

    system = sj.equations.compile_scene(scene).system
    structure, theta = flatten_system(system)
    start = known_start(system, np.zeros(1))
    assert start is not None
    y = np.asarray(initial_state(system, start.assembly))  # with what force elements remember, as turns of an angle
    rates = program_for(state_rate, structure).compute(np.asarray(theta), 0.0, y)
    n = len(system.bodies)
    return dict(zip(system.bodies, np.reshape(rates[7 * n : 13 * n], (n, 6)), strict=True))
