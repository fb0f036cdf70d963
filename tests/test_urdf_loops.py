"""URDF: loops close, names of a namespace are read, and nothing of a file is dropped in silence."""

import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spherejax as sj

ROD = (
    '<link name="{}"><inertial><origin xyz="0 0 -0.25"/><mass value="1"/>'
    '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.001"/></inertial></link>'
)

BODY = """
  <link name="base"/>
  {a}{b}
  <link name="c"><inertial><origin xyz="0.4 0 0"/><mass value="2"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial></link>
  <joint name="j1" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/></joint>
  <joint name="j2" type="continuous"><parent link="base"/><child link="b"/><origin xyz="0.8 0 0"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="j3" type="continuous"><parent link="a"/><child link="c"/><origin xyz="0 0 -0.5"/>
    <axis xyz="0 1 0"/></joint>
""".format(a=ROD.format("a"), b=ROD.format("b"))

LOOP = (
    '<{p}loop_joint name="loop" type="{kind}"><{p}link1 link="c" xyz="0.8 0 0" rpy="0 0 0"/>'
    '<{p}link2 link="b" xyz="0 0 -0.5" rpy="0 0 0"/><axis xyz="0 1 0"/></{p}loop_joint>'
)


@pytest.fixture
def written(tmp_path):
    def write(more: str, attributes: str = "", body: str = BODY) -> Path:
        path = tmp_path / "robot.urdf"
        path.write_text(f'<robot name="four_bar" {attributes}>{body}{more}</robot>')
        return path

    return write


def loop(kind: str = "continuous", prefix: str = "") -> str:
    return LOOP.format(kind=kind, p=prefix)


CLOSED = {"j1": 0.5, "j2": 0.5, "j3": -0.5}
"""A parallelogram: the coupler stays level."""


def angle(ts: np.ndarray) -> np.ndarray:
    """Of its cranks: two rods about their ends and a mass that goes round with them, 0.5 m from the pivots."""
    inertia = 2 * (0.02 + 0.25**2) + 2 * 0.5**2
    weight = 9.81 * (2 * 0.25 + 2 * 0.5)
    found = solve_ivp(
        lambda _, y: [y[1], -weight / inertia * np.sin(y[0])],
        (0, ts[-1]),
        [0.5, 0.0],
        rtol=1e-11,
        atol=1e-12,
        t_eval=ts,
    )
    return found.y[0]


# Loops ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["continuous", "spherical", "cylindrical"])
def test_a_loop_leaves_one_degree_of_freedom(written, kind):
    """It was dropped in silence: three degrees of freedom for one."""
    scene = sj.load_urdf(written(loop(kind)), positions=CLOSED)
    assert set(scene.joints) == {"j1", "j2", "j3", "loop"}
    assert sj.constraint_report(scene).degrees_of_freedom == 1


@pytest.mark.parametrize(("kind", "free"), [("fixed", 0), ("prismatic", 1)])
def test_loops_that_hold_orientations(written, kind, free):
    """The axes of the second end are turned, so that they are those of the first where the loop is closed."""
    element = loop(kind).replace('link="b" xyz="0 0 -0.5" rpy="0 0 0"', 'link="b" xyz="0 0 -0.5" rpy="0 -0.5 0"')
    element = element.replace('<axis xyz="0 1 0"/>', '<axis xyz="1 0 0"/>')
    scene = sj.load_urdf(written(element), positions=CLOSED)
    assert sj.constraint_report(scene).degrees_of_freedom == free
    with pytest.raises(sj.SceneError, match="loop joint 'loop' cannot be closed"):
        sj.load_urdf(written(element), positions={**CLOSED, "j3": 0.0})


def test_a_four_bar_moves_as_its_equation_says(written):
    ts = np.linspace(0.0, 1.0, 11)
    run = sj.simulate(sj.load_urdf(written(loop()), positions=CLOSED), jnp.asarray(ts), throw=True)
    np.testing.assert_allclose(run.position("a")[:, 0], -0.25 * np.sin(angle(ts)), rtol=0, atol=1e-8)


def test_joints_that_are_not_named_close_the_loop_and_it_is_told(written):
    with pytest.warns(sj.errors.RobotWarning, match=r"moved to close them: positions=\{'j2': 0\.5, 'j3': -0\.5\}"):
        scene = sj.load_urdf(written(loop()), positions={"j1": 0.5})
    same = sj.load_urdf(written(loop()), positions=CLOSED)
    for name in "abc":
        np.testing.assert_allclose(scene.bodies[name].position, same.bodies[name].position, rtol=0, atol=1e-9)


def test_ends_in_axes_of_their_own_meet(written):
    """The joint's axes are turned on both links: the axis, x there, is y of the links."""
    turned = (
        '<loop_joint name="loop" type="revolute"><link1 link="c" xyz="0.8 0 0" rpy="0 0 1.5707963267948966"/>'
        '<link2 link="b" xyz="0 0 -0.5" rpy="0 0 1.5707963267948966"/><axis xyz="1 0 0"/></loop_joint>'
    )
    scene = sj.load_urdf(written(turned), positions=CLOSED)
    made = scene.joints["loop"]
    assert isinstance(made, sj.Revolute)
    np.testing.assert_allclose(made.axis, (0, 1, 0), atol=1e-12)
    across = turned.replace('xyz="0 0 -0.5" rpy="0 0 1.57', 'xyz="0 0 -0.5" rpy="0 0 0.57')
    with pytest.raises(sj.SceneError, match="loop joint 'loop' cannot be closed"):
        sj.load_urdf(written(across), positions={"j1": 0.5})


def test_an_exporter_that_writes_its_first_end_twice_is_read(written):
    twice = loop().replace("link2", "link1")
    assert "loop" in sj.load_urdf(written(twice), positions=CLOSED).joints


@pytest.mark.parametrize(
    ("element", "words"),
    [
        (loop("screw"), r"robot\.urdf:\d+: loop_joint 'loop': its type is 'screw'; .*ignore=\(\"loops\",\)"),
        (loop().replace('link="b"', 'link="d"'), "loop joint 'loop': there is no link 'd'"),
        (loop().replace('link="b"', ""), "needs a <link1"),
        (loop().replace('"0.8 0 0"', '"0.8 0"'), "three numbers each"),
        (loop().replace('"0.8 0 0"', '"0.8 0 zero"'), "zero"),
        (loop() * 2, "there are two loop joints 'loop'"),
        (loop().replace('name="loop"', 'name="j1"'), "has the name of a joint"),
        (loop().replace('link="b"', 'link="c"'), "which fixed joints hold together|cannot be closed"),
        (loop().replace("</loop_joint>", "<limit/></loop_joint>"), "URDF has no <limit> of loop_joint 'loop'"),
    ],
)
def test_what_a_loop_lacks_is_told(written, element, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.load_urdf(written(element), positions=CLOSED)


def test_loops_can_be_left_out(written):
    scene = sj.load_urdf(written(loop("screw")), positions=CLOSED, ignore=("loops",))
    assert set(scene.joints) == {"j1", "j2", "j3"}


# Names of namespaces --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("attributes", "prefix"),
    [
        ('xmlns="http://drake.mit.edu"', ""),
        ('xmlns:drake="http://drake.mit.edu"', "drake:"),
        ("", "drake:"),  # declared nowhere: others, who know nothing of namespaces, read it
    ],
)
def test_namespaces_change_no_name(written, attributes, prefix):
    scene = sj.load_urdf(written(loop(prefix=prefix), attributes), positions=CLOSED)
    assert set(scene.joints) == {"j1", "j2", "j3", "loop"}


def test_another_file_in_a_namespace_is_none(written, tmp_path):
    path = tmp_path / "other.urdf"
    path.write_text('<x:robot xmlns:x="http://www.ros.org/wiki/xacro" name="a"/>')
    with pytest.raises(sj.SceneError, match=r"begins with <x:robot>.*xacro first"):
        sj.load_urdf(path)


# What is left out -----------------------------------------------------------------------------------------------------

ACCEPTED = {"positions": CLOSED, "ignore": ("extensions",)}


@pytest.mark.parametrize(
    ("element", "words"),
    [
        (
            '<gazebo reference="a"><mu1>0.2</mu1><kp>9</kp></gazebo>',
            r"left out .*: <gazebo> of 'a' with mu1, kp \(line \d+\)",
        ),
        ('<ros2_control name="x"/>', "<ros2_control> of 'x'"),
        ('<link name="d"><sensor/></link>', "<sensor> of link 'd'"),
        ('<drake:declare_convex xmlns:drake="d"/>', "<drake:declare_convex>"),
    ],
)
def test_elements_of_other_programs_are_warned_of(written, element, words):
    body = BODY.replace('<link name="base"/>', '<link name="base"/><joint name="k" type="fixed"><parent link="base"/>'
                        '<child link="d"/></joint>') if "<link" in element else BODY  # fmt: skip
    with pytest.warns(sj.errors.RobotWarning, match=words):
        sj.load_urdf(written(element, body=body), positions=CLOSED)
    sj.load_urdf(written(element, body=body), **ACCEPTED)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name="j1"', 'name="j1" drake_ignore="true"', "attribute 'drake_ignore' of <joint> of joint 'j1'"),
        ('<origin xyz="0.8 0 0"/>', '<origin xzy="0.8 0 0"/>', "attribute 'xzy' of <origin> of joint 'j2'"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><dynamics stiffness="5"/>', "attribute 'stiffness' of <dynamics>"),
        ('<mass value="2"/>', '<mass value="2"/><density value="2"/>', "<density> of link 'c'"),
    ],
)
def test_what_would_move_otherwise_is_refused(written, old, new, words):
    path = written("", body=BODY.replace(old, new, 1))
    with pytest.raises(sj.SceneError, match=rf"robot\.urdf:\d+: URDF has no .*{re.escape(words)}"):
        sj.load_urdf(path, positions=CLOSED)
    sj.load_urdf(path, **ACCEPTED)


@pytest.mark.parametrize("element", ["<force_element/>", '<drake:joint xmlns:drake="d" name="x" type="ball"/>'])
def test_elements_with_mechanics_are_refused(written, element):
    with pytest.raises(sj.SceneError, match=r"URDF has no <.*would move otherwise.*ignore=\(\"extensions\",\)"):
        sj.load_urdf(written(element), positions=CLOSED)


def test_parts_of_urdf_without_mechanics_are_not_told(written):
    parts = '<material name="blue"/><transmission name="t"><type>simple</type></transmission>'
    body = BODY.replace("<inertial>", "<visual/><collision/><inertial>").replace(
        '<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><calibration rising="0"/><limit effort="1" velocity="2"/>'
    )
    sj.load_urdf(written(parts, 'version="1.0"', body), positions=CLOSED)
