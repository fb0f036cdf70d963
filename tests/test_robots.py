"""Robots as vendors write them: what URDF leaves open, one feature at a time, against closed forms."""

from pathlib import Path

import diffrax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spherejax as sj

BOX = '<inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/></inertial>'
MASS, IZZ = 2.0, 2.5
NO_GRAVITY = {"gravity": (0.0, 0.0, 0.0)}


def link(name: str, inertial: str = BOX) -> str:
    return f'<link name="{name}">{inertial}</link>'


def joint(
    name: str, kind: str, parent: str, child: str, more: str = "", axis: str = "0 0 1", origin: str = "0 0 0"
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin}"/><axis xyz="{axis}"/>{more}</joint>'
    )


@pytest.fixture
def written(tmp_path):
    """Writes links and joints to a file."""

    def write(*parts: str) -> Path:
        path = tmp_path / "robot.urdf"
        path.write_text(f'<robot name="r">{"".join(parts)}</robot>')
        return path

    return write


def one_joint(kind: str, more: str = "") -> tuple[str, ...]:
    """A link on the ground and one that moves along or about z."""
    return link("base", ""), link("arm"), joint("j", kind, "base", "arm", more)


def run_of(scene: sj.Scene, t1: float, n: int = 41, **how) -> sj.Trajectory:
    return sj.simulate(scene, jnp.linspace(0.0, t1, n), rtol=1e-10, atol=1e-12, **how)


def turned_by(run: sj.Trajectory, body: str) -> np.ndarray:
    """Angle about z."""
    return np.asarray([Rotation.from_quat(q, scalar_first=True).as_rotvec()[2] for q in run.quaternion(body)])


def test_the_axis_of_a_joint_that_has_none_is_not_read(written):
    parts = (*one_joint("continuous"), link("tool"), joint("mount", "fixed", "arm", "tool", axis="0 0 0"))
    scene = sj.load_urdf(written(*parts))
    assert list(scene.bodies) == ["arm"]
    assert scene.bodies["arm"].mass == 2 * MASS
    alone = link("base", ""), link("chaser"), joint("loose", "floating", "base", "chaser", axis="0 0 0")
    assert list(sj.load_urdf(written(*alone)).bodies) == ["chaser"]


def test_dots_become_underscores(written, tmp_path):
    parts = (link("base.link", ""), link("arm.2"), joint("joint.0", "revolute", "base.link", "arm.2", origin="1 0 0"))
    path = written(*parts)
    scene = sj.load_urdf(path, positions={"joint.0": 0.5}, velocities={"joint_0": 2.0})
    assert list(scene.bodies) == ["arm_2"]
    assert list(scene.joints) == ["joint_0"]
    assert sorted(scene.ground_points) == ["base_link", "joint_0"]
    np.testing.assert_allclose(scene.bodies["arm_2"].angular_velocity, [0.0, 0.0, 2.0])
    again = sj.load_scene(sj.save_scene(scene, tmp_path / "robot.toml"))
    np.testing.assert_array_equal(again.bodies["arm_2"].quaternion, scene.bodies["arm_2"].quaternion)
    with pytest.raises(sj.SceneError, match=r"two links 'arm_2' \(written 'arm.2' and 'arm_2'\); rename one"):
        sj.load_urdf(written(*parts, link("arm_2")))


def test_a_link_called_ground_is_another_than_the_ground(written):
    scene = sj.load_urdf(written(link("ground"), link("arm"), joint("j", "revolute", "ground", "arm")), base="free")
    assert sorted(scene.bodies) == ["arm", "ground_link"]
    assert scene.joints["j"].bodies == ("ground_link", "arm")


def test_a_continuous_joint_has_no_stops_whatever_is_written(written):
    limit = '<limit lower="-0.1" upper="0.1"/>'
    assert not sj.load_urdf(written(*one_joint("continuous", limit)), stops={"turning": 1e3}).forces
    assert set(sj.load_urdf(written(*one_joint("revolute", limit)), stops={"turning": 1e3}).forces) == {"j_stop"}


def test_limits_without_effort_and_velocity_are_read_and_left_out_without_stops(written):
    path = written(*one_joint("revolute", '<limit lower="-1" upper="1"/>'))
    assert not sj.load_urdf(path).forces


@pytest.mark.parametrize(("kind", "inertia"), [("revolute", IZZ), ("prismatic", MASS)])
def test_a_stop_throws_back_after_half_a_swing_of_its_spring(written, kind, inertia):
    """At speed v from 0.2 before the limit: pressed in by v sqrt(I/k) at most, and back with -v."""
    k, v, start, limit = 400.0, 2.0, 0.1, 0.3
    path = written(*one_joint(kind, f'<limit lower="-0.4" upper="{limit}" effort="1" velocity="1"/>'))
    how = {"positions": {"j": start}, "velocities": {"j": v}, **NO_GRAVITY}
    scene = sj.load_urdf(path, stops={"turning": k, "sliding": k}, **how)
    assert set(scene.forces) == {"j_stop"}
    omega = np.sqrt(k / inertia)
    t1 = (limit - start) / v + np.pi / omega + 0.05
    run = run_of(scene, t1, 201)
    moved = turned_by(run, "arm") if kind == "revolute" else np.asarray(run.position("arm"))[:, 2]
    t = np.linspace(0.0, t1, 201)
    s = t - (limit - start) / v
    pressed = limit + v / omega * np.sin(omega * np.clip(s, 0.0, np.pi / omega))
    expected = np.where(s < 0, start + v * t, pressed - v * np.clip(s - np.pi / omega, 0.0, None))
    np.testing.assert_allclose(moved, expected, atol=2e-7)


def test_a_stop_throws_back_after_two_turns(written):
    """As a whole turn before: the angle of a joint is known through any number of them."""
    path = written(*one_joint("revolute", '<limit lower="-13" upper="13" effort="1" velocity="1"/>'))
    scene = sj.load_urdf(path, stops={"turning": 400.0}, velocities={"j": 20.0}, **NO_GRAVITY)
    run = run_of(scene, 1.0, 11)
    half = np.pi / np.sqrt(400.0 / IZZ)
    assert run.force("j_stop")["angle"][-1] == pytest.approx(13.0 - 20.0 * (1.0 - 0.65 - half), abs=1e-4)
    assert run.angular_velocity("arm")[-1, 2] == pytest.approx(-20.0, rel=1e-5)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_stop_with_a_restitution_throws_back_slower(written, kind):
    path = written(*one_joint(kind, '<limit lower="-0.4" upper="0.3" effort="1" velocity="1"/>'))
    lossy = {"stiffness": 4000.0, "restitution": 0.6}
    how = {"positions": {"j": 0.1}, "velocities": {"j": 2.0}, **NO_GRAVITY}
    scene = sj.load_urdf(path, stops={"turning": lossy, "sliding": lossy}, **how)
    run = run_of(scene, 0.35, 11)
    moves = run.angular_velocity("arm")[:, 2] if kind == "revolute" else run.velocity("arm")[:, 2]
    assert moves[-1] == pytest.approx(-1.2, rel=1e-4)


def test_stops_are_told_by_joint_and_refused_where_they_cannot_be(written):
    path = written(*one_joint("revolute", '<limit lower="-6.2832" upper="6.2832"/>'))
    assert not sj.load_urdf(path, stops={"turning": 1e3, "j": None}).forces
    path = written(*one_joint("revolute", '<limit lower="0.5" upper="1"/>'))
    with pytest.raises(sj.SceneError, match=r"'j' starts at 0.0, beyond its limits 0.5 and 1.0; start it between"):
        sj.load_urdf(path, stops={"turning": 1e3})
    with pytest.raises(sj.SceneError, match="stops: no joint 'k' turns or slides"):
        sj.load_urdf(path, stops={"k": 1e3})
    for bad in (-1.0, "stiff", {"restitution": 0.5}, {"stiffness": 1e3, "spring": 1.0}):
        with pytest.raises(sj.SceneError, match=r"stops\['j'\] = .* must be a stiffness above zero"):
            sj.load_urdf(path, stops={"j": bad})
    path = written(*one_joint("prismatic", "<limit effort='1' velocity='1'/>"))
    with pytest.raises(sj.SceneError, match=r"limits 0.0 and 0.0, between which nothing is"):
        sj.load_urdf(path, stops={"sliding": 1e3})


@pytest.mark.parametrize(("kind", "inertia"), [("continuous", IZZ), ("prismatic", MASS)])
def test_friction_of_constant_size_slows_evenly(written, kind, inertia):
    """While the rate is far above the law's threshold: rate = v - F t/I."""
    path = written(*one_joint(kind, '<dynamics friction="0.4"/>'))
    with pytest.raises(sj.SceneError, match=r"'j' has friction.*friction=sj\.Threlfall.*ignore=\(\"friction\",\)"):
        sj.load_urdf(path)
    law = sj.Threlfall(mu=0.3, v1=1e-3)
    scene = sj.load_urdf(path, friction=law, velocities={"j": 1.0}, **NO_GRAVITY)
    run = run_of(scene, 1.0, 11)
    rate = run.angular_velocity("arm") if kind == "continuous" else run.velocity("arm")
    np.testing.assert_allclose(rate[:, 2], 1.0 - 0.4 / inertia * np.linspace(0.0, 1.0, 11), rtol=1e-8)
    assert sj.load_urdf(path, ignore=("friction",)).joints["j"].model.friction is None


@pytest.mark.parametrize(("kind", "inertia"), [("continuous", IZZ), ("prismatic", MASS)])
def test_damping_is_an_exponential(written, kind, inertia):
    path = written(*one_joint(kind, '<dynamics damping="1.5"/>'))
    run = run_of(sj.load_urdf(path, velocities={"j": 1.0}, **NO_GRAVITY), 1.0, 11)
    rate = run.angular_velocity("arm") if kind == "continuous" else run.velocity("arm")
    np.testing.assert_allclose(rate[:, 2], np.exp(-1.5 / inertia * np.linspace(0.0, 1.0, 11)), rtol=1e-8)


def gripper(
    first: str = "continuous", second: str = "continuous", mimic: str = 'multiplier="-2" offset="0.1"'
) -> tuple:
    """Two joints on the ground, the second following the first."""
    limit = '<limit lower="-1" upper="1"/>'
    return (
        link("base", ""),
        link("a"),
        link("b"),
        joint("lead", first, "base", "a", limit),
        joint("follow", second, "base", "b", f'<mimic joint="lead" {mimic}/>{limit}', origin="1 0 0"),
    )


STIFF = {word: {"stiffness": 300.0} for word in ("turning", "sliding")}


@pytest.mark.parametrize(("first", "second"), [("continuous", "continuous"), ("continuous", "prismatic")])
def test_a_joint_that_mimics_starts_where_it_follows_and_is_coupled(written, first, second):
    """With the lag u = x_2 - m x_1: u'' = -k (1/I_2 + m^2/I_1) u, here started with a rate of its own."""
    path = written(*gripper(first, second))
    scene = sj.load_urdf(path, positions={"lead": 0.2}, velocities={"lead": 0.5}, mimic=STIFF, **NO_GRAVITY)
    assert set(scene.forces) == {"follow_mimic"}
    m, i_2 = -2.0, IZZ if second == "continuous" else MASS
    run = run_of(scene, 0.5)
    np.testing.assert_allclose(run.force("follow_mimic")["lag"], 0.0, atol=1e-10)
    x_1 = turned_by(run, "a")
    x_2 = turned_by(run, "b") if second == "continuous" else np.asarray(run.position("b"))[:, 2]
    np.testing.assert_allclose(x_2, m * x_1 + 0.1, atol=1e-9)
    kicked = sj.load_urdf(path, velocities={"lead": 0.5}, ignore=("mimic",), **NO_GRAVITY)
    kicked = sj.Scene(kicked.bodies, kicked.joints, scene.forces, gravity=(0, 0, 0), ground_points=scene.ground_points)
    omega = np.sqrt(300.0 * (1 / i_2 + m**2 / IZZ))
    lag = run_of(kicked, 1.0).force("follow_mimic")["lag"]
    np.testing.assert_allclose(lag, -m * 0.5 / omega * np.sin(omega * np.linspace(0.0, 1.0, 41)), atol=1e-7)


def test_what_a_mimic_needs_is_asked_for(written):
    path = written(*gripper())
    with pytest.raises(sj.SceneError, match=r"'follow' has mimic.*mimic=.*fixed=.*ignore=\(\"mimic\",\)"):
        sj.load_urdf(path)
    with pytest.raises(
        sj.SceneError, match=r"joint 'follow' mimics 'lead' and has -0.3.* there, not 0.5; leave it out"
    ):
        sj.load_urdf(path, positions={"lead": 0.2, "follow": 0.5}, mimic=STIFF)
    with pytest.raises(sj.SceneError, match="'follow' mimics 'lead', and nothing says how stiff"):
        sj.load_urdf(path, mimic={"sliding": {"stiffness": 1.0}})
    with pytest.raises(sj.SceneError, match=r"mimic\['turning'\] = 3.0 must hold a stiffness"):
        sj.load_urdf(path, mimic={"turning": 3.0})
    with pytest.raises(sj.SceneError, match="'follow' mimics 'lead', which is fixed; hold it too"):
        sj.load_urdf(path, mimic=STIFF, fixed=["lead"])
    with pytest.raises(sj.SceneError, match=r"'follow' mimics 'leed', which is no joint; did you mean 'lead'"):
        sj.load_urdf(written(*(part.replace('mimic joint="lead"', 'mimic joint="leed"') for part in gripper())))
    with pytest.raises(sj.SceneError, match="joints follow mimic each other in a circle"):
        sj.load_urdf(written(*(part.replace('mimic joint="lead"', 'mimic joint="follow"') for part in gripper())))


def test_joints_can_be_held_where_they_are(written):
    chain = (
        *one_joint("continuous"),
        link("hand"),
        joint("wrist", "revolute", "arm", "hand", origin="0.5 0 0", axis="0 1 0"),
        link("finger"),
        joint("grip", "prismatic", "hand", "finger", origin="0 0 0.2", axis="0 0 1"),
    )
    path = written(*chain)
    at = {"positions": {"j": 0.3, "wrist": 0.7, "grip": 0.05}, "velocities": {"j": 1.0}}
    whole, held = sj.load_urdf(path, **at), sj.load_urdf(path, fixed=["wrist", "grip"], **at)
    assert list(held.bodies) == ["arm"]
    parts = [whole.bodies[name] for name in ("arm", "hand", "finger")]
    np.testing.assert_allclose(held.bodies["arm"].mass, sum(one.mass for one in parts))
    center = sum(one.mass * one.position for one in parts) / held.bodies["arm"].mass
    np.testing.assert_allclose(held.bodies["arm"].position, center, atol=1e-15)
    momentum = sum(one.mass * one.velocity for one in parts)
    np.testing.assert_allclose(held.bodies["arm"].mass * held.bodies["arm"].velocity, momentum, atol=1e-14)
    with pytest.raises(sj.SceneError, match="fixed: there is no joint 'wrst'; did you mean 'wrist'"):
        sj.load_urdf(path, fixed=["wrst"])
    with pytest.raises(sj.SceneError, match="joint 'j' is held by fixed= and has no velocity"):
        sj.load_urdf(path, fixed=["j"], velocities={"j": 1.0})


def test_a_base_stands_or_flies_where_it_is_put(written):
    path = written(link("base"), link("arm"), joint("j", "revolute", "base", "arm", origin="0.5 0 0"))
    place, turn = np.array([1.0, 2.0, 3.0]), Rotation.from_rotvec([0.3, -0.4, 0.5])
    where = {"base_position": place, "base_quaternion": turn}
    velocity, spin = np.array([0.1, 0.2, 0.3]), np.array([1.0, -1.0, 2.0])
    free = sj.load_urdf(path, base="free", **where, base_velocity=velocity, base_angular_velocity=spin)
    arm = turn.apply([0.5, 0.0, 0.0])
    np.testing.assert_allclose(free.bodies["base"].position, place)
    np.testing.assert_allclose(free.bodies["arm"].position, place + arm)
    np.testing.assert_allclose(free.bodies["arm"].velocity, velocity + np.cross(spin, arm))
    standing = sj.load_urdf(path, **where)
    np.testing.assert_allclose(standing.bodies["arm"].position, place + arm)
    np.testing.assert_allclose(standing.ground_points["j"], place + arm)
    np.testing.assert_allclose(standing.joints["j"].axis, turn.apply([0.0, 0.0, 1.0]), atol=1e-15)
    with pytest.raises(sj.SceneError, match=r"base_velocity = .* the base stands on the ground"):
        sj.load_urdf(path, base_velocity=velocity)
    with pytest.raises(sj.SceneError, match=r"base_position = .* must be 3 finite numbers"):
        sj.load_urdf(path, base_position=(1.0, 2.0))
    with pytest.raises(sj.SceneError, match=r"base_quaternion = .* must have unit norm"):
        sj.load_urdf(path, base_quaternion=(1.0, 1.0, 0.0, 0.0))


def test_links_without_mass_or_moments_get_the_least(written):
    thin = '<inertial><mass value="1"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'
    chain = (link("base", ""), link("a", ""), link("b", thin), link("c"))
    joints = [joint(*words) for words in (("j", "revolute", "base", "a"), ("k", "revolute", "a", "b"))]
    path = written(*chain, *joints, joint("l", "revolute", "b", "c"))
    with pytest.raises(sj.SceneError, match=r"link 'a' moves by joint 'j' and has no mass.*least_mass=1e-3"):
        sj.load_urdf(path)
    with pytest.raises(sj.SceneError, match=r"link 'b' moves by joint 'k' and has no moments of inertia"):
        sj.load_urdf(path, fixed=["j"])
    scene = sj.load_urdf(path, least_mass=0.1, least_moment=0.01)
    assert scene.bodies["a"].mass == 0.1
    np.testing.assert_allclose(scene.bodies["b"].inertia, 0.01)
    np.testing.assert_array_equal(scene.bodies["c"].inertia, [1.0, 2.0, 2.5])
    with pytest.raises(sj.SceneError, match=r"least_mass = -1 must be a number, not negative"):
        sj.load_urdf(path, least_mass=-1)
    end = written(*one_joint("revolute"), link("tip", ""), joint("m", "revolute", "arm", "tip"))
    with pytest.raises(sj.SceneError, match=r"'tip' moves by joint 'm'.*fixed=\['m'\]\) holds all that carry no mass"):
        sj.load_urdf(end)


def test_moments_that_no_body_has_can_be_balanced(written):
    odd = BOX.replace('izz="2.5"', 'izz="6"')
    path = written(link("base", ""), link("arm", odd), joint("j", "revolute", "base", "arm"))
    with pytest.raises(sj.SceneError, match=r"triangle rule.*balance_inertia=True"):
        sj.load_urdf(path)
    np.testing.assert_allclose(sj.load_urdf(path, balance_inertia=True).bodies["arm"].inertia, 3.0)


@pytest.mark.slow
def test_a_whole_arm_runs_with_friction_stops_and_a_gripper(written):
    """All at once: the audit of the energy knows every part."""
    limit = '<limit lower="-0.4" upper="0.4"/><dynamics damping="0.1" friction="0.2"/>'
    arm = (link("base", ""), link("arm"), joint("j", "revolute", "base", "arm", limit, axis="0 1 0"))
    fingers = [
        (link(name), joint(f"grip_{name}", "prismatic", "arm", name, more, "1 0 0", "0 0 -0.5"))
        for name, more in (("l", ""), ("r", '<mimic joint="grip_l" multiplier="-1"/>'))
    ]
    path = written(*arm, *(part for finger in fingers for part in finger))
    ways = {"friction": sj.Threlfall(mu=1.0, v1=1e-2), "stops": {"turning": 500.0}, "mimic": STIFF}
    run = run_of(sj.load_urdf(path, velocities={"j": 2.0}, **ways), 1.0, solver=diffrax.Dopri8())
    assert run.succeeded
    assert run.mechanical_energy[-1] < run.mechanical_energy[0]
