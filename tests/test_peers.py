"""Robots of `example-robot-data` against Pinocchio's articulated body algorithm; with the extra `peers`.

Both get the same joint angles and rates, drawn at random, and of a free base the same pose and velocity. Compared are
accelerations of all bodies, at their centers of mass.
"""

import importlib.metadata
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.motion.equations.dynamics import evaluate
from spherejax.physics.state import State, pack

# What a file lacks or holds that no body can have; the inertia of Pinocchio's model is then set to that of the scene.
MENDED: dict[str, dict[str, Any]] = {
    "human.urdf": {"least_mass": 1e-3, "least_moment": 1e-6},
    "icub.urdf": {"least_moment": 1e-5},
    "icub_reduced.urdf": {"least_moment": 1e-5},
    "romeo.urdf": {"least_mass": 1e-3, "least_moment": 1e-6},
    "romeo_small.urdf": {"balance_inertia": True},
    "romeo_laas_small.urdf": {"least_mass": 1e-3, "least_moment": 1e-6, "balance_inertia": True},
}
EMPTY = ("ur3.urdf",)  # a comment without links
ONE_BODY = ("quadrotor_base.urdf", "iris_simple.urdf")
QUICK = ("ur5_robot.urdf", "solo12.urdf")


def files() -> list[Path]:
    """The robots that are installed."""
    try:
        found = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return sorted(Path(str(one.locate())).resolve() for one in found if one.suffix == ".urdf")


def cases():
    robots = [path for path in files() if path.name not in EMPTY]
    for path in robots or [Path("none")]:
        for base in ("ground", "free"):
            if base == "ground" and path.name in ONE_BODY:
                continue
            marks = () if path.name in QUICK or not robots else pytest.mark.slow
            yield pytest.param(path, base, id=f"{path.stem}-{base}", marks=marks)


def random_state(pin, model, free: bool, rng):
    """Pinocchio's q and v, and the same as arguments of `load_urdf`."""
    q, v = pin.neutral(model), np.zeros(model.nv)
    positions, velocities, base = {}, {}, {}
    for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:
        if free and joint.nq == 7:
            place, turn, velocity, spin = rng.normal(size=3), rng.normal(size=4), rng.normal(size=3), rng.normal(size=3)
            turn /= np.linalg.norm(turn)
            rotation = pin.Quaternion(turn).toRotationMatrix()
            q[joint.idx_q : joint.idx_q + 7] = [*place, *turn]
            v[joint.idx_v : joint.idx_v + 6] = [*velocity, *spin]
            base = {
                "base_position": place,
                "base_quaternion": rotation,
                "base_velocity": rotation @ velocity,
                "base_angular_velocity": rotation @ spin,
            }
            continue
        angle, rate = rng.uniform(-1, 1), rng.normal()
        # Of a continuous joint Pinocchio keeps cosine and sine.
        q[joint.idx_q : joint.idx_q + joint.nq] = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
        v[joint.idx_v] = rate
        positions[name], velocities[name] = angle, rate
    return q, v, {"positions": positions, "velocities": velocities, **base}


def frames_by_body(pin, model) -> dict[str, int]:
    return {frame.name.replace(".", "_"): k for k, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY}


def accelerations(scene: sj.Scene) -> dict[str, np.ndarray]:
    """Linear and angular acceleration of each body at the start."""
    system = sj.equations.compile_scene(scene).system
    bodies = system.bodies.values()
    by_field = (
        jnp.stack([jnp.asarray(getattr(body, field)) for body in bodies])
        for field in ("position", "quaternion", "velocity", "angular_velocity")
    )
    y = pack(State(*by_field, jnp.zeros(0), jnp.zeros(0)))
    found = jax.jit(lambda y: evaluate(system, jnp.zeros(()), y).solution.accelerations)(y)
    return dict(zip(system.bodies, np.asarray(found), strict=True))


@pytest.mark.parametrize(("path", "base"), cases())
def test_accelerations_are_those_of_the_articulated_body_algorithm(path, base):
    pin = pytest.importorskip("pinocchio")
    if path.name == "none":
        pytest.skip("example-robot-data is not installed")
    free = base == "free"
    model = pin.buildModelFromUrdf(str(path), *([pin.JointModelFreeFlyer()] if free else []))
    q, v, start = random_state(pin, model, free, np.random.default_rng(0))
    mended = MENDED.get(path.name, {})
    left_out = ("friction", "mimic", "extensions")
    scene = sj.load_urdf(path, base=base, ignore=left_out, drift=sj.solvers.NoDriftControl(), **start, **mended)
    frames = frames_by_body(pin, model)
    for name, body in scene.bodies.items() if mended else ():
        inertia = body.inertia if body.inertia.ndim == 2 else np.diag(body.inertia)
        center = -np.asarray(body.points[name])
        model.inertias[model.frames[frames[name]].parentJoint] = pin.Inertia(float(body.mass), center, inertia)

    data = model.createData()
    # Pinocchio reads damping and leaves it to its user.
    pin.forwardKinematics(model, data, q, v, pin.aba(model, data, q, v, -np.asarray(model.damping) * v))
    pin.updateFramePlacements(model, data)
    expected, found, size = [], [], 0.0
    for name, both in accelerations(scene).items():
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        at_origin = pin.getFrameClassicalAcceleration(model, data, frames[name], world)
        spin = pin.getFrameVelocity(model, data, frames[name], world).angular
        arm = np.asarray(scene.bodies[name].position) - data.oMf[frames[name]].translation
        turning = at_origin.angular
        linear = at_origin.linear + np.cross(turning, arm) + np.cross(spin, np.cross(spin, arm))
        expected.append([*linear, *turning])
        found.append(both)
        size = max(size, np.abs(linear).max(), np.abs(turning).max() * np.linalg.norm(arm))
    expected, found = np.array(expected), np.array(found)
    assert len(expected) == len(scene.bodies) > 0
    # Light fingers at random rates turn with up to 1e6 rad/s^2: the scale is the largest of a body's points.
    np.testing.assert_allclose(found[:, :3], expected[:, :3], rtol=0, atol=1e-12 * max(size, 9.81))
    scale = max(np.abs(expected[:, 3:]).max(), 1.0)
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:], rtol=0, atol=1e-12 * scale)
