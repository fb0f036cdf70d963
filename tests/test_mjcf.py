"""MuJoCo models as scenes, against MuJoCo: accelerations of bodies at states drawn at random, contacts off.

MuJoCo's trees are exact. Its loops give way by design, so they are compared with the accelerations that its own mass
matrix, forces and constraint Jacobian have where nothing gives way.
"""

from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from mujoco_models import (
    OFF,
    body_accelerations,
    random_inertial,
    random_state,
    random_tree,
    scene_accelerations,
)

import spherejax as sj

mujoco = pytest.importorskip("mujoco")

INERTIAL = '<inertial pos="0.1 0 0.05" mass="1.5" diaginertia="0.02 0.03 0.04"/>'
TREES = {
    "one of each": ["hinge", "slide", "ball", "hinge", "weld", "hinge"],
    "a free base": ["free", "hinge", "slide", "ball", "weld"],
    "balls": ["ball", "ball", "weld", "slide"],
}


@pytest.fixture
def written(tmp_path):
    """Writes a model to a file."""

    def write(text: str) -> Path:
        path = tmp_path / "model.xml"
        path.write_text(text)
        return path

    return write


def model_of(bodies: str, more: str = "", options: str = OFF) -> str:
    return f'<mujoco><compiler angle="radian"/>{options}<worldbody>{bodies}</worldbody>{more}</mujoco>'


def one_joint(joint: str, more: str = "", options: str = OFF) -> str:
    return model_of(f'<body name="arm" pos="0 0 1">{joint}{INERTIAL}</body>', more, options)


def at_state(path: Path, seed: int):
    """MuJoCo's model and data at a random state, and the arguments that say the same."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], start = random_state(model, np.random.default_rng(seed))
    mujoco.mj_forward(model, data)
    return model, data, start


def assert_same(scene: sj.Scene, expected: dict[str, np.ndarray], rtol: float = 1e-10) -> None:
    """Accelerations of all bodies, at their centers of mass."""
    found = scene_accelerations(scene)
    size = max(np.abs(one).max() for one in expected.values())
    for name, one in found.items():
        np.testing.assert_allclose(one, expected[name], rtol=0, atol=rtol * max(size, 9.81), err_msg=name)


@pytest.mark.parametrize("kinds", TREES.values(), ids=TREES)
@pytest.mark.parametrize("seed", [0, 1])
def test_a_tree_accelerates_as_in_mujoco(written, kinds, seed):
    path = written(random_tree(np.random.default_rng(seed), kinds))
    model, data, start = at_state(path, seed)
    scene = sj.load_mjcf(path, drift=sj.solvers.NoDriftControl(), **start)
    expected = body_accelerations(model, data)
    # A body of several is compared with the whole's center of mass, which moves with the first of them.
    welded = {f"b{k}" for k, kind in enumerate(kinds) if kind == "weld"}
    assert set(scene.bodies) == set(expected) - welded
    for child in welded:
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, child)
        head = int(model.body_weldid[body])
        if head:
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, head)
            expected[name] = _of_whole(model, data, name, np.asarray(scene.bodies[name].position))
    np.testing.assert_array_equal(scene.gravity, model.opt.gravity)
    assert_same(scene, expected)


def _of_whole(model, data, name: str, center: np.ndarray) -> np.ndarray:
    """Acceleration of a body at another place, by the field of accelerations of a rigid body."""
    expected = body_accelerations(model, data)[name]
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    spin = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, spin, 0)
    arm, turning = center - data.xipos[body], expected[3:]
    return np.concatenate(
        [expected[:3] + np.cross(turning, arm) + np.cross(spin[:3], np.cross(spin[:3], arm)), turning]
    )


STACKS = {
    "universal": (
        '<joint name="a" axis="1 0 0" pos="0 0 .2"/><joint name="b" axis="0 1 0" pos="0 0 .2"/>',
        "Universal",
    ),
    "ball of three hinges": (
        '<joint name="a" axis="1 0 0" pos="0 0 .2"/><joint name="b" axis="0 1 0" pos="0 0 .2"/>'
        '<joint name="c" axis="0 1 2" pos="0 0 .2"/>',
        "Spherical",
    ),
    "cylindrical": (
        '<joint name="a" type="slide" axis="1 0 1"/><joint name="b" axis="1 0 1" pos="0 0 .2"/>',
        "Cylindrical",
    ),
    "planar": (
        '<joint name="a" type="slide" axis="1 0 0"/><joint name="b" type="slide" axis="0 0 1"/>'
        '<joint name="c" axis="0 1 0" pos=".1 0 .2"/>',
        "PointOnPlane",
    ),
}


@pytest.mark.parametrize(("joints", "kind"), STACKS.values(), ids=STACKS)
def test_several_joints_of_a_body_are_one_where_there_is_one(written, joints, kind):
    path = written(
        model_of(
            f'<body name="base" pos="0 0 1"><joint name="j" axis="0 0 1"/>{INERTIAL}'
            f'<body name="arm" pos="0.3 0 0" quat="1 .2 .3 .1">{joints}{INERTIAL}</body></body>'
        )
    )
    model, data, start = at_state(path, 3)
    scene = sj.load_mjcf(path, drift=sj.solvers.NoDriftControl(), **start)
    assert set(scene.bodies) == {"base", "arm"}
    assert {type(joint).__name__ for name, joint in scene.joints.items() if name != "j"} == {kind}
    assert_same(scene, body_accelerations(model, data))


H, B = '<joint name="h" axis="0 1 0" pos=".1 0 .2" {}/>', '<joint name="h" type="ball" pos=".1 0 .2"/>'
X = '<joint name="x" type="slide" axis="1 0 0" {}/>'
Y = '<joint name="y" type="slide" axis="0 1 0" {}/>'
Z = '<joint name="z" type="slide" axis="0 0 1" {}/>'
OBLIQUE = '<joint name="o" type="slide" axis="1 2 .5"/>'
TWO = '<joint name="h" axis="0 1 0" pos=".1 0 .2"/><joint name="k" axis="1 0 1" pos=".1 0 .2"/>'
SLIDING = {
    "two slides": X + Z,
    "oblique slides": X + OBLIQUE,
    "three slides": X + Y + Z,
    "a slide and a ball": X + B,
    "two slides and a ball": X + Z + B,
    "a slide across a hinge": X + H,
    "a slide at an angle to a hinge": OBLIQUE + H,
    "two slides, one along a hinge": X + Y + H,
    "three slides and a hinge": X + Y + Z + H,
    "a slide and two hinges": Z + TWO,
    "a hinge, then a slide across": H + X,
    "a hinge, then slides, one along": H + Y + X,
    "two hinges, then a slide": TWO + X,
}
"""Stacks of slides and turns, which were refused."""


@pytest.mark.parametrize("joints", SLIDING.values(), ids=SLIDING)
def test_slides_and_turns_of_a_body_accelerate_as_in_mujoco(written, joints):
    joints = joints.replace("{}", "")
    path = written(
        model_of(
            f'<body name="base" pos="0 0 1"><joint name="j" axis="0 0 1"/>{INERTIAL}'
            f'<body name="arm" pos="0.3 0 0" quat="1 .2 .3 .1">{joints}{INERTIAL}</body></body>'
        )
    )
    model, data, start = at_state(path, 3)
    scene = sj.load_mjcf(path, drift=sj.solvers.NoDriftControl(), **start)
    assert set(scene.bodies) == {"base", "arm"}
    assert sj.constraint_report(scene).degrees_of_freedom == model.nv
    assert_same(scene, body_accelerations(model, data))


HINGES = {
    "parallel": '<joint name="a" axis="0 1 0"/><joint name="b" axis="0 1 0" pos=".1 .3 .2"/>',
    "crossing": '<joint name="a" axis="0 1 0" pos=".1 0 .2"/><joint name="b" axis="1 2 .5" pos=".1 0 .2"/>',
    "crossing elsewhere": '<joint name="a" axis="1 0 0" pos=".1 0 .2"/><joint name="b" axis="0 1 0" pos="0 .3 .2"/>',
    "skew": '<joint name="a" axis="1 0 .2"/><joint name="b" axis="0 1 -.3" pos=".1 .3 .2"/>',
    "skew at right angles": '<joint name="a" axis="1 0 0"/><joint name="b" axis="0 1 0" pos=".1 .3 .2"/>',
}
"""Two hinges of one body, in any position: the link between them has no mass."""


@pytest.mark.parametrize("joints", HINGES.values(), ids=HINGES)
def test_two_hinges_of_a_body_accelerate_as_in_mujoco(written, joints):
    path = written(
        model_of(
            f'<body name="base" pos="0 0 1"><joint name="j" axis="0 0 1"/>{INERTIAL}'
            f'<body name="arm" pos="0.3 0 0" quat="1 .2 .3 .1">{joints}{INERTIAL}</body></body>'
        )
    )
    model, data, start = at_state(path, 3)
    scene = sj.load_mjcf(path, drift=sj.solvers.NoDriftControl(), **start)
    assert set(scene.bodies) == {"base", "arm"}
    assert sj.constraint_report(scene).degrees_of_freedom == 3
    assert_same(scene, body_accelerations(model, data))


def test_two_hinges_about_one_axis_are_refused(written):
    joints = '<joint name="a" axis="0 1 0"/><joint name="b" axis="0 1 0" pos="0 .3 0"/>'
    with pytest.raises(sj.SceneError, match=r"joints a, b move one body, 'arm'"):
        sj.load_mjcf(written(one_joint(joints)))


FORCES = 'stiffness="{}" damping=".4" springref="{}"'
PUSHED = {
    "a carriage": X.format(FORCES.format(5, 0.2)) + Z.format(FORCES.format(9, -0.1)),
    "a planar body": X.format(FORCES.format(5, 0.2)) + Z.format("") + H.format(FORCES.format(2, 0.3)),
    "a planar body, turned first": H.format(FORCES.format(2, 0.3)) + X.format(FORCES.format(5, 0.2)) + Z.format(""),
    "a screw without a thread": Y.format(FORCES.format(5, 0.2)) + H.format(FORCES.format(2, 0.3)),
    "a pulled ball": X.format(FORCES.format(5, 0.2)) + B,
    "gantry and hinge": X.format(FORCES.format(5, 0.2))
    + Y.format(FORCES.format(3, 0.2))
    + H.format(FORCES.format(2, 1)),
}
"""Stacks with springs and dampers, on the ground and on a body that moves."""


@pytest.mark.parametrize("joints", PUSHED.values(), ids=PUSHED)
@pytest.mark.parametrize("carrier", ['<joint name="j" axis=".2 0 1"/>', ""], ids=["moving", "ground"])
def test_springs_of_stacks_push_as_in_mujoco(written, joints, carrier):
    arm = f'<body name="arm" pos="0.3 0 0" quat="1 .2 .3 .1">{joints}{INERTIAL}</body>'
    path = written(model_of(f'<body name="base" pos="0 0 1">{carrier}{INERTIAL}{arm}</body>' if carrier else arm))
    model, data, start = at_state(path, 3)
    scene = sj.load_mjcf(path, drift=sj.solvers.NoDriftControl(), **start)
    assert_same(scene, body_accelerations(model, data))


def moved(model, data, ts: np.ndarray) -> np.ndarray:
    """Where MuJoCo's Runge-Kutta method takes the second body's center of mass, shape (n, 3)."""
    model.opt.integrator, n = mujoco.mjtIntegrator.mjINT_RK4, 1000
    model.opt.timestep = (ts[1] - ts[0]) / n
    found = []
    for _ in ts:
        mujoco.mj_forward(model, data)
        found.append(np.array(data.xipos[model.nbody - 1]))
        for _ in range(n):
            mujoco.mj_step(model, data)
    return np.array(found)


FREE = {
    "slides and a ball": X + Y + Z + B,
    "slides and hinges": X + Y + Z + TWO + '<joint name="l" axis="0 0 1" pos=".1 0 .2"/>',
    "slides, two with springs, and a ball": X.format('stiffness="5"') + Y + Z.format('stiffness="9"') + B,
    "two slides with springs and a ball": X.format('stiffness="5"') + Z.format('stiffness="9"') + B,
    "a ball, then a slide": B + X.format('stiffness="5"'),
    "a ball, then two slides": B + X + OBLIQUE,
}
"""Stacks with a ball: MuJoCo's rate of Jacobians (mj_jacDot) is not that of its own motion there."""


@pytest.mark.parametrize("joints", FREE.values(), ids=FREE)
def test_slides_and_a_ball_move_as_in_mujoco(written, joints):
    path = written(model_of(f'<body name="arm" pos="0 0 1">{joints.replace("{}", "")}{INERTIAL}</body>'))
    model, data, start = at_state(path, 5)
    scene = sj.load_mjcf(path, **start)
    assert sj.constraint_report(scene).degrees_of_freedom == model.nv
    ts = np.linspace(0.0, 0.3, 4)
    run = sj.simulate(scene, jnp.asarray(ts), rtol=1e-10, throw=True)
    np.testing.assert_allclose(run.position("arm"), moved(model, data, ts), rtol=0, atol=1e-8)
    energy = np.asarray(run.mechanical_energy)
    np.testing.assert_allclose(energy, energy[0], rtol=0, atol=1e-7 * np.ptp(np.asarray(run.kinetic_energy)))


def test_a_limit_of_a_slide_in_a_stack_stops_it(written):
    path = written(
        one_joint(X.format("") + Z.format('range="-.1 .1" limited="true"'), options='<option gravity="0 0 -9.81"/>')
    )
    scene = sj.load_mjcf(path, stops={"sliding": 1e4})
    run = sj.simulate(scene, np.linspace(0.0, 0.5, 101), throw=True)
    height = np.asarray(run.position("arm"))[:, 2] - 1.05
    depth = 1.5 * 9.81 / 1e4  # at rest on the stop
    fall = depth + np.sqrt(depth**2 + 2 * depth * 0.1)  # m g (0.1 + x) = K x^2 / 2
    assert height.min() == pytest.approx(-0.1 - fall, abs=1e-4)


def test_a_stack_that_cannot_be_made_names_its_body(written):
    joints = X.format("") + H.format("") + Z.format("") + OBLIQUE
    with pytest.raises(sj.SceneError, match=r"joints x, h move one body, 'arm'.*least_mass=1e-3.*fixed="):
        sj.load_mjcf(written(one_joint(joints)))


def test_other_stacks_ask_for_mass_between_them_and_tend_to_mujoco(written):
    joints = '<joint name="a" axis="1 0 0" damping="0.3"/><joint name="b" axis="0 1 0" pos="0 0 .2" stiffness="4"/>'
    path = written(one_joint(joints))
    model, data, start = at_state(path, 1)
    with pytest.raises(sj.SceneError, match=r"joints a, b move one body.*least_mass=1e-3, least_moment=1e-6"):
        sj.load_mjcf(path, **start)
    scenes = [
        sj.load_mjcf(path, drift=sj.solvers.NoDriftControl(), least_mass=m, least_moment=m, **start)
        for m in (1e-5, 1e-6)
    ]
    assert set(scenes[0].bodies) == {"arm_1", "arm"}
    expected = body_accelerations(model, data)["arm"]
    errors = [np.abs(scene_accelerations(scene)["arm"] - expected).max() for scene in scenes]
    assert errors[0] < 1e-2
    assert errors[1] < 0.2 * errors[0]


LOOP = (
    '<body name="crank" pos="0 0 1"><joint name="a" axis="0 1 0"/>{0}'
    '<body name="rod" pos="0 0 -0.3"><joint name="b" axis="0 1 0"/>{1}</body></body>'
    '<body name="rocker" pos="0.5 0 1"><joint name="c" axis="0 1 0"/>{2}</body>'
)
SHUT = {
    "connect": '<connect name="shut" body1="rod" body2="rocker" anchor="0.5 0 0"/>',
    "connected sites": '<connect name="shut" site1="s" site2="t"/>',
}
SITES = ('<site name="s" pos="0.5 0 0"/>', '<site name="t" pos="0 0 -0.3"/>')


@pytest.mark.parametrize("shut", SHUT.values(), ids=SHUT)
def test_a_loop_accelerates_as_mujocos_equations_without_give(written, shut):
    rng = np.random.default_rng(5)
    inertials = [random_inertial(rng) for _ in range(3)]
    bodies = LOOP.format(inertials[0], SITES[0] + inertials[1], SITES[1] + inertials[2])
    path = written(model_of(bodies, f"<equality>{shut}</equality>"))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    # A parallelogram moves with b = -a and c = a.
    data.qpos[:] = angles = 0.4 * np.array([1.0, -1.0, 1.0])
    data.qvel[:] = rates = 2.0 * np.array([1.0, -1.0, 1.0])
    expected = _without_give(model, data)
    named = dict(zip("abc", angles, strict=True)), dict(zip("abc", rates, strict=True))
    scene = sj.load_mjcf(path, positions=named[0], velocities=named[1], drift=sj.solvers.NoDriftControl())
    assert isinstance(scene.joints["shut"], sj.Spherical)
    # The Jacobian's rate is a difference of MuJoCo's Jacobians, good to 1e-9.
    assert_same(scene, body_accelerations(model, data, expected), rtol=1e-8)
    # MuJoCo's own loop, made as stiff as it can be, is near.
    model.eq_solimp[:, :2], model.eq_solref[:] = 0.9999, (2 * model.opt.timestep, 1.0)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qacc, expected, rtol=2e-3)


def _without_give(model, data) -> np.ndarray:
    """Accelerations that keep J qacc = -(dJ/dt) qvel, of MuJoCo's own M, forces and J (its plane's rows alone)."""

    def jacobian(t: float) -> np.ndarray:
        moved = mujoco.MjData(model)
        moved.qpos[:] = data.qpos + t * data.qvel
        mujoco.mj_forward(model, moved)
        return moved.efc_J.reshape(-1, model.nv)[[0, 2]].copy()

    h = 1e-4
    mujoco.mj_forward(model, data)
    rate = (8 * (jacobian(h) - jacobian(-h)) - (jacobian(2 * h) - jacobian(-2 * h))) / (12 * h)
    mass = np.zeros((model.nv, model.nv))
    for row, unit in zip(mass, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    J = jacobian(0.0)
    whole = np.block([[mass, J.T], [J, np.zeros((len(J), len(J)))]])
    forces = data.qfrc_passive - data.qfrc_bias
    return np.linalg.solve(whole, np.concatenate([forces, -rate @ data.qvel]))[: model.nv]


def test_a_weld_holds_two_bodies_as_they_are_and_refuses_another_start(written):
    two = (
        f'<body name="a" pos="0 0 1"><joint name="j" axis="0 1 0"/>{INERTIAL}</body>'
        f'<body name="b" pos="0.4 0 1" quat="1 0 .3 0"><joint name="k" axis="0 1 0"/>{INERTIAL}'
        f'<body name="c" pos="0.1 0 0.2"><joint name="free" type="ball"/>{INERTIAL}</body></body>'
    )
    path = written(model_of(two, '<equality><weld name="glue" body1="a" body2="c"/></equality>'))
    scene = sj.load_mjcf(path)
    assert isinstance(scene.joints["glue"], sj.Fixed)
    with pytest.raises(sj.SceneError, match=r"weld 'glue' holds its bodies otherwise .* by 0\.\d+ m and 0\.2 rad"):
        sj.load_mjcf(path, positions={"j": 0.2})


def test_a_joint_that_follows_another_is_a_coupler_and_starts_where_that_puts_it(written):
    two = (
        f'<body name="a" pos="0 0 1"><joint name="j" axis="0 1 0" ref="0.1"/>{INERTIAL}</body>'
        f'<body name="b" pos="1 0 1"><joint name="k" axis="0 1 0"/>{INERTIAL}</body>'
    )
    follow = '<equality><joint joint1="k" joint2="j" polycoef="0.2 -2 0 0 0"/></equality>'
    path = written(model_of(two, follow))
    with pytest.raises(sj.SceneError, match=r"mimic: equality 0 \(joint\).*ignore=\('mimic',\).*mimic=\{"):
        sj.load_mjcf(path)
    scene = sj.load_mjcf(path, mimic={"turning": {"stiffness": 1e3}}, positions={"j": 0.4}, velocities={"j": 0.5})
    coupler = scene.forces["k_mimic"]
    assert isinstance(coupler, sj.forces.Coupler)
    assert coupler.ratio == -2.0
    # k = 0.2 - 2 (0.4 - 0.1), and its rate -2 0.5.
    np.testing.assert_allclose(scene.bodies["b"].quaternion, [np.cos(-0.2), 0, np.sin(-0.2), 0], atol=1e-15)
    np.testing.assert_allclose(scene.bodies["b"].angular_velocity, [0, -1.0, 0], atol=1e-15)
    assert not sj.load_mjcf(path, ignore=("mimic",)).forces
    bent = written(model_of(two, follow.replace("0 0 0", "1 0 0")))
    with pytest.raises(sj.SceneError, match="follows 'j' along a curve"):
        sj.load_mjcf(bent, mimic={"turning": {"stiffness": 1e3}})


def test_limits_and_friction_are_asked_for_and_made(written):
    path = written(
        one_joint('<joint name="j" axis="0 1 0" range="-0.5 0.8" frictionloss="0.3" ref="0.1"/>', options="")
    )
    with pytest.raises(sj.SceneError, match=r"friction: j; limits: j.*friction=sj\.Threlfall.*stops=\{"):
        sj.load_mjcf(path)
    scene = sj.load_mjcf(path, stops={"turning": 500.0}, friction=sj.Threlfall(mu=1.0, v1=1e-2), positions={"j": 0.3})
    spring = scene.forces["j_stop"].spring
    # 0.2 rad below the start at 0.3 the joint is at 0.1; the upper limit is 0.5 above it.
    torque = [float(spring(jnp.asarray(angle))) for angle in (-0.81, 0.0, 0.49, 0.51)]
    np.testing.assert_allclose(torque, [-5.0, 0.0, 0.0, 5.0], atol=1e-9)
    assert scene.joints["j"].model.preload == 0.3
    bare = sj.load_mjcf(path, stops={"j": None}, ignore=("friction",))
    assert not bare.forces
    assert bare.joints["j"].model.friction is None


LEFT_OUT = {
    "actuators": ("", '<actuator><intvelocity name="drive" joint="j" kp="1" actrange="-1 1"/></actuator>', "drive"),
    "armature": ('armature="0.1"', "", "armature: j"),
    "tendons": ("", '<tendon><fixed name="rope" stiffness="3"><joint joint="j" coef="1"/></fixed></tendon>', "rope"),
    "gravcomp": ("BODY gravcomp='1'", "", "gravcomp: arm"),
    "fluid": ("", '<option density="1.2"/>', "fluid: density 1.2"),
    "mocap": ("", '<worldbody><body name="hand" mocap="true"/></worldbody>', "mocap: hand"),
    "equalities": (
        "",
        '<tendon><fixed name="r"><joint joint="j" coef="1"/></fixed></tendon><equality><tendon name="t" tendon1="r"/>'
        "</equality>",
        r"equalities: t \(tendon\)",
    ),
    "contacts": ("GEOM", '<worldbody><geom name="floor" type="plane" size="1 1 1"/></worldbody>', "contacts: .*floor"),
}


ACTUATORS = {
    "motors": '<motor name="a" joint="j" gear="2.5"/><motor name="b" joint="s" gear="-3" ctrllimited="true" '
    'ctrlrange="-1 1"/>',
    "servos": '<position name="a" joint="j" kp="30" kv="2" gear="1.5"/><velocity name="b" joint="s" kv="7" gear="-2"/>',
    "general": '<general name="a" joint="j" gainprm="3" biastype="affine" biasprm="1 -20 -0.5" gear="0.5"/>'
    '<general name="b" jointinparent="s" gainprm="2" biastype="affine" biasprm="4 0 0"/>',
    "limits": '<position name="a" joint="j" kp="300" forcelimited="true" forcerange="-2 1" gear="-1"/>'
    '<motor name="b" joint="s" gear="30"/>',
}
CHAIN = (
    f'<body name="arm" pos="0 0 1" quat="1 .2 0 0"><joint name="j" axis="0 1 0" ref="0.3"/>{INERTIAL}'
    '<body name="hand" pos="0.3 0 0"><joint name="s" type="slide" axis="1 0 .2" ref="0.05" stiffness="40" '
    f'actuatorfrclimited="true" actuatorfrcrange="-9 9"/>{INERTIAL}</body></body>'
)


def driven(path: Path, start: dict, controls: dict[str, float]):
    """MuJoCo's model and data with these controls, and the scene."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = start["qpos"], start["qvel"], list(controls.values())
    mujoco.mj_forward(model, data)
    names = dict(zip(("positions", "velocities"), ("qpos", "qvel"), strict=True))
    given = {what: dict(zip(("j", "s"), start[values], strict=True)) for what, values in names.items()}
    return model, data, sj.load_mjcf(path, controls=controls, drift=sj.solvers.NoDriftControl(), **given)


@pytest.mark.parametrize("actuators", ACTUATORS.values(), ids=ACTUATORS)
@pytest.mark.parametrize("qpos", [(0.9, -0.1), (-0.4, 0.2)], ids=["up", "down"])
def test_actuators_push_as_in_mujoco(written, actuators, qpos):
    path = written(model_of(CHAIN, f"<actuator>{actuators}</actuator>"))
    model, data, scene = driven(path, {"qpos": qpos, "qvel": (0.7, -0.4)}, {"a": 1.3, "b": 1.7})
    assert set(scene.forces) == {"a", "b", "s"}
    assert_same(scene, body_accelerations(model, data))


def test_servos_move_a_chain_as_in_mujoco(written):
    actuators = ACTUATORS["servos"].replace('kv="2" gear="1.5"', 'kv="2" gear="1.5" forcerange="-9 9"')
    path = written(model_of(CHAIN, f"<actuator>{actuators}</actuator>"))
    start = {"qpos": (0.9, -0.1), "qvel": (0.7, -0.4)}
    model, data, scene = driven(path, start, {"a": 1.3, "b": 1.7})
    ts = np.linspace(0.0, 0.5, 6)
    run = sj.simulate(scene, ts, rtol=1e-9)
    np.testing.assert_allclose(run.position("hand"), moved(model, data, ts), rtol=0, atol=1e-6)


def test_controls_are_those_of_the_keyframe_and_names_are_checked(written):
    more = '<actuator><motor name="j" joint="j"/></actuator><keyframe><key name="k" qpos="0" ctrl="2"/></keyframe>'
    path = written(one_joint('<joint name="j" axis="0 1 0" damping="1"/>', more))
    assert float(sj.load_mjcf(path).forces["j_actuator"].effort(0.0)) == 0.0
    assert float(sj.load_mjcf(path, keyframe="k").forces["j_actuator"].effort(0.0)) == 2.0
    assert float(sj.load_mjcf(path, keyframe="k", controls={"j": 3}).forces["j_actuator"].effort(0.0)) == 3.0
    with pytest.raises(sj.SceneError, match="controls: there is no actuator 'motor'; there are: j"):
        sj.load_mjcf(path, controls={"motor": 1.0})
    with pytest.raises(sj.SceneError, match=r"controls\['j'\] = nan must be a finite number"):
        sj.load_mjcf(path, controls={"j": np.nan})
    with pytest.raises(sj.SceneError, match="controls= is of actuators, and ignore= leaves these out"):
        sj.load_mjcf(path, controls={"j": 1.0}, ignore=("actuators",))


@pytest.mark.parametrize(
    ("actuator", "said"),
    [
        ('<intvelocity name="x" joint="j" kp="1" actrange="-1 1"/>', "dyntype integrator"),
        ('<damper name="x" joint="j" kv="1" ctrlrange="0 1"/>', "gaintype affine"),
        ('<motor name="x" site="hand"/>', "trntype site"),
        ('<motor name="x" joint="j" armature="0.1"/>', "armature"),
    ],
)
def test_other_actuators_are_refused_by_name_and_reason(written, actuator, said):
    joint = '<joint name="j" axis="0 1 0"/><site name="hand" pos="0.1 0 0"/>'
    off = '<motor name="off" joint="j" group="3"/>'
    options = OFF + '<option actuatorgroupdisable="3"/>'
    try:
        path = written(one_joint(joint, f"<actuator>{off}{actuator}</actuator>", options))
        mujoco.MjModel.from_xml_path(str(path))
    except ValueError:
        pytest.skip("this MuJoCo has no such attribute")
    with pytest.raises(sj.SceneError, match=rf"actuators: x \({said}\).*ignore=\('actuators',\)"):
        sj.load_mjcf(path)
    assert not sj.load_mjcf(path, ignore=("actuators",)).forces


@pytest.mark.parametrize(("word", "case"), LEFT_OUT.items(), ids=LEFT_OUT)
def test_what_has_no_place_here_is_named_and_left_out_on_demand(written, word, case):
    attribute, more, said = case
    of_body = attribute.removeprefix("BODY") if attribute.startswith("BODY") else ""
    geom = "" if attribute != "GEOM" else '<geom name="ball" size="0.1"/>'
    of_joint = attribute if attribute.startswith("armature") else ""
    options = '<option><flag contact="enable"/></option>'
    bodies = f'<body name="arm" pos="0 0 1" {of_body}><joint name="j" axis="0 1 0" {of_joint}/>{geom}{INERTIAL}</body>'
    path = written(model_of(bodies, more, options))
    with pytest.raises(sj.SceneError, match=rf"{said}.*ignore=\('{word}',\)"):
        sj.load_mjcf(path)
    assert set(sj.load_mjcf(path, ignore=(word,)).bodies) == {"arm"}


def test_what_a_file_switches_off_is_not_there(written):
    words = ("gravity", "spring", "damper", "frictionloss", "limit")
    flags = "".join(f' {word}="disable"' for word in words)
    flags = f"<option><flag{flags}/></option>"
    joint = '<joint name="j" axis="0 1 0" stiffness="2" damping="1" frictionloss="0.1" range="-1 1"/>'
    scene = sj.load_mjcf(written(one_joint(joint, options=flags)))
    assert not scene.forces
    assert tuple(scene.gravity) == (0.0, 0.0, 0.0)
    off = '<equality><connect body1="arm" anchor="0 0 0.5" active="false"/></equality>'
    assert set(sj.load_mjcf(written(one_joint('<joint name="j"/>', off))).joints) == {"j"}


def test_joints_that_nobody_pushes_alone_are_refused_on_balls(written):
    joint = '<joint name="j" type="ball" damping="0.3" stiffness="2" frictionloss="0.1"/>'
    with pytest.raises(sj.SceneError, match="ball damping: j; ball friction: j; ball springs: j"):
        sj.load_mjcf(written(one_joint(joint, options='<option gravity="0 0 -9.81"/>')))


def test_a_keyframe_names_sites_fixed_joints_and_dots(written):
    bodies = (
        f'<body name="arm.1" pos="0 0 1"><joint name="j.1" axis="0 1 0"/>{INERTIAL}<site name="tip" pos="0.4 0 0"/>'
        f'<body name="hand" pos="0.4 0 0"><joint name="k" axis="0 1 0"/>{INERTIAL}</body></body>'
    )
    keys = '<keyframe><key name="home" qpos="0.5 0.25" qvel="1 2"/></keyframe>'
    path = written(model_of(bodies, keys))
    scene = sj.load_mjcf(path, keyframe="home")
    np.testing.assert_allclose(scene.bodies["hand"].angular_velocity, [0, 3.0, 0], atol=1e-15)
    center = np.asarray(scene.bodies["arm_1"].points["arm_1"])
    np.testing.assert_allclose(scene.bodies["arm_1"].points["tip"] - center, [0.4, 0, 0], atol=1e-15)
    held = sj.load_mjcf(path, keyframe="home", fixed=["k"])
    assert set(held.bodies) == {"arm_1"}
    assert held.bodies["arm_1"].mass == 3.0
    with pytest.raises(sj.SceneError, match="there is no keyframe 'hom'; did you mean 'home'"):
        sj.load_mjcf(path, keyframe="hom")
    with pytest.raises(sj.SceneError, match=r"positions: there is no joint 'j1'; did you mean 'j_1'"):
        sj.load_mjcf(path, positions={"j1": 0.1})
    with pytest.raises(sj.SceneError, match="must be a finite number"):
        sj.load_mjcf(path, positions={"k": (1.0, 2.0)})


def test_a_keyframe_puts_mocap_bodies_where_mujoco_does(written):
    """They stood where the file draws them."""
    bodies = (
        '<body name="goal" mocap="true" pos="0 0 1"><body name="mark" pos="1 0 0"/></body>'
        f'<body name="arm" pos="0 0 1"><joint name="j" axis="0 1 0"/>{INERTIAL}</body>'
    )
    path = written(model_of(bodies, '<keyframe><key name="k" qpos=".3" mpos="5 0 0" mquat="1 0 0 1"/></keyframe>'))
    points = sj.load_mjcf(path, ignore=("mocap",), keyframe="k").ground_points
    np.testing.assert_allclose(points["goal"], [5, 0, 0], atol=1e-15)
    np.testing.assert_allclose(points["mark"], [5, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(sj.load_mjcf(path, ignore=("mocap",)).ground_points["goal"], [0, 0, 1])


def test_what_the_compiler_refuses_is_told_in_its_words(written, tmp_path):
    with pytest.raises(sj.SceneError, match=r"model\.xml: MuJoCo's compiler: .*mass and inertia"):
        sj.load_mjcf(written(model_of('<body name="a"><joint/></body>')))
    with pytest.raises(sj.SceneError, match=r"cannot read .*none\.xml"):
        sj.load_mjcf(tmp_path / "none.xml")
    with pytest.raises(sj.SceneError, match="ignore: 'actuator' is unknown; did you mean 'actuators'"):
        sj.load_mjcf(written(one_joint("<joint/>")), ignore=("actuator",))


def test_a_file_on_which_the_compiler_fails_is_named(written, monkeypatch):
    """As on an empty `anchor`. MuJoCo 4.0 then waits forever in the next file, so it is not made to here."""

    def fail(path):
        raise RuntimeError("Caught an unknown exception!")

    failing = SimpleNamespace(MjModel=SimpleNamespace(from_xml_path=fail))
    monkeypatch.setattr("spherejax.files.robots.mjcf_model.library", lambda: failing)
    with pytest.raises(
        sj.SceneError, match=r"model\.xml: MuJoCo's compiler failed: Caught an unknown.*empty attributes"
    ):
        sj.load_mjcf(written(one_joint("<joint/>")))


def test_a_model_is_saved_and_read_to_the_last_bit(written, tmp_path):
    path = written(random_tree(np.random.default_rng(2), TREES["one of each"]))
    scene = sj.load_mjcf(path)
    again = sj.load_scene(sj.save_scene(scene, tmp_path / "model.toml"))
    for name, one in scene_accelerations(scene).items():
        np.testing.assert_array_equal(one, scene_accelerations(again)[name])
