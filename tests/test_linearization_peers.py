"""Linearizations against other codes: matrices of MuJoCo, eigenvalues of Exudyn (the extra `peers`)."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from mujoco_models import random_state, random_tree

import spherejax as sj

sys.path.append(str(Path(__file__).parent.parent / "benchmarks"))

from peers import exudyn_scene

# MuJoCo --------------------------------------------------------------------------------------------------------------


def per_second(mujoco, model, data, n_sensors):
    """A, B, C, D of MuJoCo's joint coordinates, in continuous time: those of a step, as the step tends to nothing.

    (A_d - 1) / h and B_d / h have errors in h, h^2, ...; three steps take out two of them. C and D are of the state
    itself. Differences are central ones.
    """
    n, nu = model.nv, model.nu
    found = []
    for h in (4e-4, 2e-4, 1e-4):
        model.opt.timestep = h
        A, B = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, nu))
        C, D = np.zeros((n_sensors, 2 * n)), np.zeros((n_sensors, nu))
        mujoco.mjd_transitionFD(model, data, 1e-4, True, A, B, C, D)
        found.append(np.hstack([(A - np.eye(2 * n)) / h, B / h]))
    mujoco.mj_forward(model, data)  # places of the last difference are left behind
    first, second, third = found
    both = (8 * third - 6 * second + first) / 3
    return both[:, : 2 * n], both[:, 2 * n :], C, D


def test_matrices_are_those_of_mujocos_differences(tmp_path):
    """A tree that is let go at an arbitrary position: hinges, a slider, a ball, springs, dampers, weight.

    Changes of joint coordinates q move bodies by J dq, and at v = 0 those of the speeds move velocities by J dv: our
    states are x = T (dq, dv). Out of equilibrium T changes, as J does with q: MuJoCo's matrices must be
    T^-1 (A T - T'), T^-1 B and C T.
    """
    mujoco = pytest.importorskip("mujoco")
    text = random_tree(np.random.default_rng(5), ["hinge", "slide", "ball", "hinge", "hinge"])
    path = tmp_path / "tree.xml"
    path.write_text(text)
    watched = (
        '<actuator><motor joint="j0"/></actuator><sensor>'
        '<framepos objtype="body" objname="b4"/><framelinvel objtype="body" objname="b4"/></sensor></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text.replace("</mujoco>", watched))
    data = mujoco.MjData(model)
    data.qpos[:], _, start = random_state(model, np.random.default_rng(5))
    mujoco.mj_forward(model, data)
    axis = np.array(data.xaxis[0])
    A, B, C, D = per_second(mujoco, model, data, 6)

    scene = sj.load_mjcf(path, positions=start["positions"], drift=sj.solvers.NoDriftControl())
    scene = replace(scene, forces={**scene.forces, "motor": sj.AppliedWrench("b0")})
    moments = [f"forces.motor.moment.{letter}" for letter in "xyz"]
    lin = sj.linearize(scene, inputs=moments, outputs=["position.b4", "velocity.b4"])
    assert len(lin.A) == 2 * model.nv == 14

    J, acceleration = jacobians(mujoco, model, data, lin.point.system.bodies), np.array(data.qacc)
    inverse = lin.inverse[:, : 2 * len(J)]  # behind them the springs count their turns, which moves nothing
    T, T_rate = inverse @ scipy.linalg.block_diag(J, J), np.zeros_like(lin.A)
    for k in range(model.nv):
        data.qvel[:] = np.eye(model.nv)[k]
        mujoco.mj_forward(model, data)
        turning = jacobians(mujoco, model, data, lin.point.system.bodies, mujoco.mj_jacDot) @ acceleration
        T_rate[:, k] = inverse[:, len(turning) :] @ turning
    ours = np.linalg.solve(T, np.hstack([lin.A @ T - T_rate, (lin.B @ axis)[:, None]]))
    theirs = np.hstack([A, B])
    columns = np.maximum(np.abs(theirs).max(0), 1.0)
    np.testing.assert_allclose(ours / columns, theirs / columns, rtol=0, atol=1e-6)
    np.testing.assert_allclose(lin.C @ T, C, rtol=0, atol=1e-8 * np.abs(C).max())
    np.testing.assert_allclose(lin.D @ axis, D[:, 0], atol=1e-8)


def jacobians(mujoco, model, data, bodies, function=None):
    """Of the bodies' centers of mass and rotations by joint coordinates, or of another function their rates."""
    found = []
    for name in bodies:
        linear, turning = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        (function or mujoco.mj_jac)(model, data, linear, turning, data.xipos[body], body)
        found += [linear, turning]
    return np.vstack(found)


# Exudyn --------------------------------------------------------------------------------------------------------------


def rubber(damping: float) -> sj.Bushing:
    return sj.Bushing(law=sj.laws.VectorElastomer(2e4, damping))


def mounted() -> sj.Scene:
    """A block on three mounts, a second one hung from it on three more, weight: loaded rubber, no constraint.

    Between two bodies without damping: Exudyn's damper acts in two points, so that force and reaction turn a loaded
    pair; ours in one. At the ground both are the same.
    """
    corners = {"a": (0.2, 0.1, 0.0), "b": (-0.2, 0.15, 0.05), "c": (0.05, -0.2, 0.0)}
    upper = {f"top_{name}": place for name, place in corners.items()}
    lower = {f"low_{name}": (x, y, z - 0.1) for name, (x, y, z) in corners.items()}
    hung = {name: (x, y, z + 0.1) for name, (x, y, z) in corners.items()}
    return sj.Scene(
        {
            "block": sj.Body(8.0, (0.1, 0.12, 0.2), (0.0, 0.0, 0.0), points=upper | lower),
            "load": sj.Body(3.0, (0.03, 0.05, 0.04), (0.0, 0.0, -0.2), points=hung),
        },
        {f"mount_{name}": sj.Spherical(f"ground.{name}", f"block.top_{name}", rubber(1e-3)) for name in corners}
        | {f"hanger_{name}": sj.Spherical(f"block.low_{name}", f"load.{name}", rubber(0.0)) for name in corners},
        ground_points=corners,
    )


def held() -> sj.Scene:
    """A chain of a hinge, a ball and a slider, held by springs that nothing loads."""
    ground = {"up": (1.0, 0.3, 0.5), "side": (1.5, -0.2, 0.1), "near": (0.5, 0.5, 0.2)}
    eye, hook = (0.9, 0.05, 0.1), (1.0, 0.1, 0.22)

    def spring(start, end, place, stiffness, damping):
        return sj.SpringDamper((f"ground.{start}", end), stiffness, damping, math.dist(ground[start], place))

    return sj.Scene(
        {
            "arm": sj.Body(1.0, (0.01, 0.02, 0.02), (0.3, 0.0, 0.0), points={"end": (0.3, 0.0, 0.0)}),
            "rod": sj.Body(
                0.5, (0.005, 0.01, 0.01), (0.8, 0.0, 0.1), points={"root": (-0.2, 0.0, -0.1), "eye": (0.1, 0.05, 0.0)}
            ),
            "nut": sj.Body(0.2, (1e-3, 1e-3, 1e-3), (1.0, 0.1, 0.2), points={"hook": (0.0, 0.0, 0.02)}),
        },
        {
            "hinge": sj.Revolute(("ground", "arm"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.2)),
            "ball": sj.Spherical("arm.end", "rod.root"),
            "slide": sj.Prismatic(("rod", "nut"), (1.0, 0.1, 0.2), (1.0, 0.0, 0.3)),
        },
        {
            "coil": spring("up", "rod.eye", eye, 800.0, 3.0),
            "side": spring("side", "nut.hook", hook, 500.0, 1.0),
            "stay": spring("near", "rod.eye", eye, 300.0, 2.0),
        },
        gravity=(0.0, 0.0, 0.0),
        ground_points=ground,
    )  # fmt: skip


@pytest.mark.parametrize("build", [mounted, held])
def test_eigenvalues_are_those_of_exudyn(build):
    """Where constraints carry no load: it leaves out what the change of their forces does to the stiffness."""
    pytest.importorskip("exudyn")
    scene = sj.equilibrium(build()).scene
    found = sj.linearize(scene).modes().eigenvalues
    theirs = exudyn_scene.eigenvalues(scene)
    oscillating, expected = (np.sort_complex(each[each.imag > 1e-3]) for each in (found, theirs))
    np.testing.assert_allclose(oscillating, expected, rtol=1e-9)
