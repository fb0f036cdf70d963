"""URDF import: robots move as the same mechanisms described by hand."""

import re
from functools import partial
from pathlib import Path

import diffrax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spherejax as sj
from spherejax import cli
from spherejax.files.fields.objects import same

LEAN = (0.3, -0.2, 0.5)
"""Roll, pitch and yaw of an inertial frame."""

ROBOT = """<?xml version="1.0"?>
<!-- a double pendulum on a slider, with a camera that has no mass and a load that has -->
<robot name="pendulum">
  <material name="blue"><color rgba="0 0 1 1"/></material>
  <link name="rail"><visual><geometry><mesh filename="package://none/rail.stl"/></geometry></visual></link>
  <link name="cart"><inertial><mass value="2.0"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.03"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0 0 -0.15" rpy="0.3 -0.2 0.5"/><mass value="1.2"/>
    <inertia ixx="0.012" ixy="0.001" ixz="0" iyy="0.011" iyz="-0.0005" izz="0.004"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 -0.1"/><mass value="0.8"/>
    <inertia ixx="0.006" ixy="0" ixz="0" iyy="0.006" iyz="0" izz="0.0003"/></inertial></link>
  <link name="load"><inertial><mass value="0.2"/>
    <inertia ixx="0.0001" ixy="0" ixz="0" iyy="0.0002" iyz="0" izz="0.0003"/></inertial></link>
  <link name="camera"/>
  <joint name="slide" type="prismatic"><parent link="rail"/><child link="cart"/>
    <origin xyz="0 0 1"/><axis xyz="2 0 0"/><dynamics damping="3.0"/><limit effort="1" velocity="1"/></joint>
  <joint name="shoulder" type="revolute"><parent link="cart"/><child link="upper"/>
    <origin xyz="0.1 0 0" rpy="0 0 0.4"/><axis xyz="0 1 0"/><limit effort="1" velocity="1"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 -0.3"/><axis xyz="0 1 0"/><dynamics damping="0.05" friction="0"/></joint>
  <joint name="grip" type="fixed"><parent link="lower"/><child link="load"/>
    <origin xyz="0.02 0 -0.2" rpy="0 1.5707963267948966 0"/></joint>
  <joint name="mount" type="fixed"><parent link="load"/><child link="camera"/><origin xyz="0 0 0.01"/></joint>
  <transmission name="t"><type>simple</type></transmission>
</robot>
"""

POSITIONS = {"slide": 0.05, "shoulder": 0.7, "elbow": -0.4}
VELOCITIES = {"slide": 0.3, "shoulder": 1.0, "elbow": -2.0}


def by_hand() -> sj.Scene:
    """The same robot: forward kinematics, the parallel axes theorem and the turned inertia by SciPy's rotations."""
    turn = Rotation.from_euler("z", 0.4)
    upper_turn = turn * Rotation.from_rotvec([0.0, 0.7, 0.0])
    lower_turn = upper_turn * Rotation.from_rotvec([0.0, -0.4, 0.0])
    axis = turn.apply([0.0, 1.0, 0.0])

    cart_place = np.array([0.05, 0.0, 1.0])
    shoulder = cart_place + np.array([0.1, 0.0, 0.0])
    upper_center = shoulder + upper_turn.apply([0.0, 0.0, -0.15])
    elbow = shoulder + upper_turn.apply([0.0, 0.0, -0.3])

    lean = Rotation.from_euler("xyz", LEAN).as_matrix()
    upper_inertia = lean @ np.array([[0.012, 0.001, 0], [0.001, 0.011, -0.0005], [0, -0.0005, 0.004]]) @ lean.T

    load_turn = Rotation.from_euler("y", np.pi / 2)
    centers, masses = np.array([[0.0, 0.0, -0.1], [0.02, 0.0, -0.2]]), np.array([0.8, 0.2])
    center = masses @ centers / masses.sum()
    load = load_turn.as_matrix() @ np.diag([1e-4, 2e-4, 3e-4]) @ load_turn.as_matrix().T
    lower_inertia = np.diag([0.006, 0.006, 0.0003]) + load
    for mass, at in zip(masses, centers - center, strict=True):
        lower_inertia = lower_inertia + mass * (at @ at * np.eye(3) - np.outer(at, at))
    camera = np.array([0.02, 0.0, -0.2]) + load_turn.apply([0.0, 0.0, 0.01])

    slip = np.array([0.3, 0.0, 0.0])
    upper_spin, lower_spin = 1.0 * axis, (1.0 - 2.0) * axis
    elbow_velocity = slip + np.cross(upper_spin, elbow - shoulder)
    arm = lower_turn.apply(center)
    quaternion = partial(Rotation.as_quat, scalar_first=True)
    bodies = {
        "cart": sj.Body(2.0, (0.01, 0.02, 0.03), cart_place, velocity=slip, points={"slide": (0.0, 0.0, 0.0)}),
        "upper": sj.Body(
            1.2, upper_inertia, upper_center, quaternion(upper_turn),
            slip + np.cross(upper_spin, upper_center - shoulder), upper_spin,
        ),
        "lower": sj.Body(
            1.0, lower_inertia, elbow + arm, quaternion(lower_turn),
            elbow_velocity + np.cross(lower_spin, arm), lower_spin, {"camera": camera - center},
        ),
    }  # fmt: skip
    joints = {
        "slide": sj.Prismatic(("ground", "cart"), cart_place, (1.0, 0.0, 0.0)),
        "shoulder": sj.Revolute(("cart", "upper"), shoulder, axis),
        "elbow": sj.Revolute(("upper", "lower"), elbow, axis),
    }
    forces = {
        "slide": sj.SpringDamper(("ground.rail", "cart.slide"), damping=3.0, direction=(1.0, 0.0, 0.0)),
        "elbow": sj.TorsionalSpring(("upper", "lower"), axis, damping=0.05),
    }
    return sj.Scene(bodies, joints, forces, ground_points={"rail": (0.0, 0.0, 1.0)})


@pytest.fixture
def written(tmp_path):
    """Writes a robot to a file, with replacements."""

    def write(text: str = ROBOT, *changes: tuple[str, str]) -> Path:
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "robot.urdf"
        path.write_text(text)
        return path

    return write


TS = jnp.linspace(0.0, 0.5, 11)
simulated = partial(sj.simulate, ts=TS, rtol=1e-9, solver=diffrax.Dopri8())


def test_a_robot_has_the_bodies_joints_and_forces_of_the_one_by_hand(written):
    robot, hand = sj.load_urdf(written(), positions=POSITIONS, velocities=VELOCITIES), by_hand()
    assert list(robot.bodies) == list(hand.bodies)
    for name, body in robot.bodies.items():
        other = hand.bodies[name]
        for field in ("mass", "inertia", "position", "velocity", "angular_velocity"):
            np.testing.assert_allclose(
                getattr(body, field), getattr(other, field), atol=1e-15, err_msg=f"{name} {field}"
            )
        turn = abs(body.quaternion @ other.quaternion)
        assert turn == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(
        robot.bodies["lower"].points["camera"], hand.bodies["lower"].points["camera"], atol=1e-15
    )
    assert {name: type(joint) for name, joint in robot.joints.items()} == {
        name: type(joint) for name, joint in hand.joints.items()
    }
    assert set(robot.forces) == {"slide", "elbow"}
    assert set(robot.ground_points) == {"rail", "slide"}


@pytest.mark.slow
def test_a_robot_moves_as_the_mechanism_by_hand(written):
    robot = simulated(sj.load_urdf(written(), positions=POSITIONS, velocities=VELOCITIES))
    hand = simulated(by_hand())
    for name in ("cart", "upper", "lower"):
        np.testing.assert_allclose(robot.position(name), hand.position(name), atol=1e-8)
        np.testing.assert_allclose(robot.velocity(name), hand.velocity(name), atol=1e-7)
    moved = np.ptp(np.asarray(robot.position("lower")), axis=0)
    assert moved.max() > 0.1
    lost = robot.mechanical_energy[0] - robot.mechanical_energy[-1]
    assert lost > 1e-2


def test_what_is_not_moved_stands_still_and_axes_have_any_length(written):
    scene = sj.load_urdf(written())
    np.testing.assert_allclose(scene.bodies["cart"].position, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(scene.joints["slide"].axis, [1.0, 0.0, 0.0])
    assert not any(np.any(np.asarray(body.velocity)) for body in scene.bodies.values())
    np.testing.assert_array_equal(scene.bodies["cart"].inertia, [0.01, 0.02, 0.03])
    assert scene.bodies["upper"].inertia.shape == (3, 3)


BOX = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/></inertial>'


def two_links(kind: str, more: str = "", first: str = BOX, second: str = BOX) -> str:
    return (
        f'<robot name="r"><link name="a">{first}</link><link name="b">{second}</link><joint name="j" type="{kind}">'
        f'<parent link="a"/><child link="b"/><origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>{more}</joint></robot>'
    )


def and_joint(parent: str, child: str) -> str:
    """Two links and a second joint."""
    joint = f"<joint name='k' type='fixed'><parent link='{parent}'/><child link='{child}'/></joint></robot>"
    return two_links("revolute").replace("</robot>", joint)


def test_a_free_base_falls_and_the_base_on_the_ground_does_not(written):
    path = written(two_links("revolute"))
    free, standing = sj.load_urdf(path, base="free"), sj.load_urdf(path)
    assert list(free.bodies) == ["a", "b"]
    assert free.joints["j"].bodies == ("a", "b")
    assert list(standing.bodies) == ["b"]
    assert standing.joints["j"].bodies == ("ground", "b")
    run = simulated(free, ts=jnp.array([0.0, 0.1]))
    np.testing.assert_allclose(run.position("a")[-1], [0.0, 0.0, -9.81 * 0.005], atol=1e-9)


def test_a_floating_link_is_free(written):
    scene = sj.load_urdf(written(two_links("floating")))
    assert not scene.joints
    run = simulated(scene, ts=jnp.array([0.0, 0.1]))
    np.testing.assert_allclose(run.position("b")[-1], [0.5, 0.0, -9.81 * 0.005], atol=1e-9)


def test_a_planar_joint_slides_and_turns_in_its_plane_alone(written):
    text = two_links("planar").replace('<axis xyz="0 0 1"/>', '<axis xyz="0 3 4"/>')
    scene = sj.load_urdf(written(text), gravity=(0.5, 0.0, -9.81))
    push = sj.AppliedWrench("b", moment=(0.0, 0.6, 0.8))
    planar = {"gravity": scene.gravity, "ground_points": scene.ground_points, "drift": sj.solvers.Projection()}
    scene = sj.Scene(scene.bodies, scene.joints, {"push": push}, **planar)
    run = simulated(scene, ts=jnp.array([0.0, 0.2]))
    normal = np.array([0.0, 0.6, 0.8])
    along = scene.gravity - (scene.gravity @ normal) * normal
    expected = np.array([0.5, 0.0, 0.0]) + 0.02 * along
    np.testing.assert_allclose(run.position("b")[-1], expected, atol=1e-9)
    spin = np.asarray(run.angular_velocity("b")[-1])
    np.testing.assert_allclose(np.cross(spin, normal), 0.0, atol=1e-9)
    inertia = normal @ np.diag([1.0, 2.0, 2.5]) @ normal
    assert spin @ normal == pytest.approx(0.2 / inertia, rel=1e-8)


def test_a_robot_can_be_written_as_a_scene_file_and_read_again(written, tmp_path):
    scene = sj.load_urdf(written(), positions=POSITIONS)
    assert same(sj.load_scene(sj.save_scene(scene, tmp_path / "robot.toml")), scene)


def test_what_cannot_be_simulated_can_be_left_out(written):
    changes = (('friction="0"', 'friction="0.1"'), ('<axis xyz="2 0 0"/>', '<axis xyz="2 0 0"/><mimic joint="elbow"/>'))
    path = written(ROBOT, *changes)
    with pytest.raises(sj.SceneError, match=r"joint 'slide' has mimic.*ignore=\(\"mimic\",\)"):
        sj.load_urdf(path)
    with pytest.raises(sj.SceneError, match=r"joint 'elbow' has friction.*ignore=\(\"friction\",\)"):
        sj.load_urdf(path, ignore=("mimic",))
    scene = sj.load_urdf(path, ignore=("mimic", "friction"))
    assert set(scene.joints) == {"slide", "shoulder", "elbow"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot name='r'><link name='a'/>", "is no XML: Premature end"),
        ("<sdf><model/></sdf>", "robot.urdf:1: begins with <sdf>, not with <robot>"),
        (two_links("weird"), "robot.urdf:1: joint 'j': ParseError in /joint[@name='j']: Invalid joint type: weird"),
        (
            two_links("revolute", second=""),
            "link 'b' moves by joint 'j' and has no mass; give it <inertial> with mass and "
            "inertia, or make the joint fixed",
        ),
        (
            two_links("revolute", second=BOX.replace('value="1"', 'value="x"')),
            "link 'b': mass value='x': 'x' is no number",
        ),
        (two_links("revolute", second=BOX.replace('iyy="2" ', "")), "link 'b': ParseError in"),
        (
            two_links("revolute", second=BOX.replace('iyy="2"', 'iyy="2,5"')),
            "inertia iyy='2,5': '2,5' is no number; wri",
        ),
        (
            two_links("revolute", second=BOX.replace('iyy="2"', 'iyy="2_5"')),
            "link 'b': inertia iyy='2_5': '2_5' is no nu",
        ),
        (two_links("revolute", second=BOX.replace('iyy="2"', 'iyy="-2"')), "body 'b': inertia = "),
        (
            two_links("revolute", second='<inertial><mass value="1"/></inertial>'),
            "link 'b': has a mass but no <inertia>",
        ),
        (two_links("fixed"), "robot.urdf: nothing moves on a base that stands on the ground; give base='free'"),
        (two_links("planar", '<dynamics damping="1"/>'), "joint 'j' has damping, which no planar joint here has"),
        (two_links("revolute").replace('xyz="0 0 1"', 'xyz="0 0 0"'), "joint 'j': <axis> must be a direction"),
        (two_links("revolute").replace('<parent link="a"/>', '<parent link="c"/>'), "joint 'j': there is no link 'c'"),
        (two_links("revolute").replace('<link name="b">', '<link name="a">'), "there are two links 'a'; rename one"),
        (two_links("revolute").replace("</robot>", "<link name='c'/></robot>"), "has 2 links without a parent (a, c)"),
        ("<robot/>", "has no link; a file that only includes others must be expanded with xacro first"),
        (and_joint("a", "b"), "link 'b' has two parents, joints 'j' and 'k': URDF is a tree"),
        (and_joint("b", "a"), "no link without a parent"),
        (
            "<robot name='r'><link name='a'/><link name='b'/><link name='c'/>"
            "<joint name='j' type='fixed'><parent link='b'/><child link='c'/></joint>"
            "<joint name='k' type='fixed'><parent link='c'/><child link='b'/></joint></robot>",
            "joints j, k go round in a circle; a robot is a tree that begins at 'a'",
        ),
    ],
)
def test_a_bad_robot_is_named_with_a_remedy(written, text, message):
    with pytest.raises(sj.SceneError, match=re.escape(message)) as error:
        sj.load_urdf(written(text))
    assert "robot.urdf" in str(error.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"positions": {"elbo": 1.0}}, "positions: no joint 'elbo' turns or slides; did you mean 'elbow'?"),
        ({"velocities": {"grip": 1.0}}, "velocities: no joint 'grip' turns or slides"),
        ({"base": "air"}, "base = 'air' is unknown"),
        ({"base": "free"}, "link 'rail' moves as a free base and has no mass"),
        ({"ignore": ("gravity",)}, "ignore: 'gravity' is unknown"),
    ],
)
def test_a_bad_request_is_named(written, options, message):
    with pytest.raises(sj.SceneError, match=re.escape(message)):
        sj.load_urdf(written(), **options)


def test_a_missing_file_and_a_missing_library_are_named(tmp_path, written, monkeypatch):
    with pytest.raises(sj.SceneError, match="cannot read"):
        sj.load_urdf(tmp_path / "none.urdf")
    monkeypatch.setitem(__import__("sys").modules, "urdf_parser_py", None)
    with pytest.raises(sj.SceneError, match=r"pip install 'spherejax\[urdf\]'"):
        sj.load_urdf(written())


def test_a_robot_runs_from_the_command_line(written, tmp_path, capsys):
    path, out = written(), tmp_path / "run.csv"
    words = ["--t1", "0.5", "--samples", "11", "--rtol", "1e-9", "--solver", "dopri8"]
    assert cli.main(["run", str(path), *words, "--out", str(out)]) == 0
    assert "robot.urdf, as described, 0.5 s" in capsys.readouterr().out
    table = np.genfromtxt(out, delimiter=",", names=True)
    expected = simulated(sj.load_urdf(path))
    column = next(name for name in table.dtype.names if name.startswith("position_lower_z"))
    np.testing.assert_allclose(table[column], np.asarray(expected.position("lower"))[:, 2], rtol=1e-12)
    toml = tmp_path / "robot.toml"
    assert cli.main(["write", str(path), "--out", str(toml)]) == 0
    assert same(sj.load_scene(toml), sj.load_urdf(path))
