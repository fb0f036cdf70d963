"""Compliance and stiffness of a point at rest: closed forms, loaded equilibria, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj

K, KR = np.diag([3e4, 5e4, 7e4]), np.diag([40.0, 60.0, 90.0])
NO_GRAVITY = {"gravity": (0.0, 0.0, 0.0)}


def mounted(scale=1.0, **more):
    """A body on one bushing at the origin; the tool is 0.3 m aside and 0.1 m above."""
    body = sj.Body(2.0, (0.02, 0.03, 0.04), points={"tool": (0.3, 0.0, 0.1), "mount": (0.0, 0.0, 0.0)})
    law = sj.laws.MatrixElastomer(scale * K, 1e-3 * K, scale * KR, 1e-3 * KR)
    return sj.Scene({"hand": body}, {"mount": sj.Fixed(("ground", "hand"), "hand.mount", sj.Bushing(law=law))}, **more)


def about(arm):
    """Twist of the tool by that of the mount."""
    x, y, z = arm
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[np.eye(3), -cross], [np.zeros((3, 3)), np.eye(3)]])


def test_a_body_on_a_bushing_is_the_closed_form():
    result = sj.studies.end_compliance(mounted(**NO_GRAVITY), "hand.tool")
    A = about((0.3, 0.0, 0.1))
    stiffness = np.linalg.inv(A).T @ np.block([[K, np.zeros((3, 3))], [np.zeros((3, 3)), KR]]) @ np.linalg.inv(A)
    np.testing.assert_allclose(result.stiffness, stiffness, rtol=1e-9, atol=1e-9 * np.abs(stiffness).max())
    np.testing.assert_allclose(result.compliance, result.compliance.T, atol=1e-12 * np.abs(result.compliance).max())


def test_a_pendulum_gives_way_by_its_weight():
    """m g l against rotation, and rigid in all other directions."""
    body = sj.Body(2.0, (0.1, 0.1, 0.1), position=(0.0, 0.0, -0.5), points={"end": (0.0, 0.0, -0.3)})
    scene = sj.Scene({"rod": body}, {"pivot": sj.Revolute(("ground", "rod"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))})
    result = sj.studies.end_compliance(scene, "rod.end")
    weight = 2.0 * 9.81 * 0.5
    # A force along x at the end, 0.8 m below the pivot, turns it by 0.8/weight against the right hand.
    expected = np.zeros((6, 6))
    way = np.array([-0.8, 0.0, 0.0, 0.0, 1.0, 0.0])
    expected = np.outer(way, way) / weight
    np.testing.assert_allclose(result.compliance, expected, atol=1e-12)
    with pytest.raises(sj.SceneError, match="does not give way in 5 of 6 directions"):
        result.stiffness  # noqa: B018


@pytest.mark.slow
def test_the_compliance_of_a_linkage_against_equilibria_under_loads():
    model = sj.Bushing(law=sj.laws.MatrixElastomer(1e6 * np.eye(3), 1e2 * np.eye(3), 50 * np.eye(3), np.eye(3)))
    axis = (0.0, 1.0, 0.0)
    scene = sj.gallery.five_bar()
    tip = sj.Revolute(("left_rod", "right_rod"), "left_rod.tip", axis)
    elastic = {name: sj.Fixed(scene.joints[name].bodies, scene.joints[name].point, model) for name in ("left", "right")}
    joints = {name: joint for name, joint in scene.joints.items() if not name.endswith("motor") and name not in elastic}
    robot = sj.Scene(scene.bodies, {**joints, "tip": tip, **elastic})
    result = sj.studies.end_compliance(robot, "left_rod.tip")

    def tip_under(load):
        push = {"push": sj.AppliedWrench("left_rod.tip", force=tuple(load[:3]), moment=tuple(load[3:]))}
        body = sj.equilibrium(sj.Scene(robot.bodies, robot.joints, push)).scene.bodies["left_rod"]
        r = np.asarray(robot.bodies["left_rod"].points["tip"])
        w, x = float(body.quaternion[0]), np.asarray(body.quaternion[1:])
        return np.asarray(body.position) + r + 2 * np.cross(x, np.cross(x, r) + w * r)

    size = np.abs(result.compliance).max()
    for i, load in ((0, 0.1), (2, 0.1), (4, 0.01)):
        by = load * np.eye(6)[i]
        difference = (tip_under(by) - tip_under(-by)) / (2 * load)
        np.testing.assert_allclose(result.compliance[:3, i], difference, atol=1e-5 * size)


@pytest.mark.slow
def test_derivative_by_a_stiffness():
    def at(scale):
        return sj.studies.end_compliance(mounted(scale), "hand.tool").compliance[2, 2]

    exact = float(jax.grad(at)(1.0))
    assert exact == pytest.approx(float((at(1.001) - at(0.999)) / 0.002), rel=1e-4)
    assert exact == pytest.approx(-float(at(1.0)), rel=1e-2)


def test_a_point_that_nothing_holds_is_told():
    free = sj.Scene(
        {"rotor": sj.Body(1.0, (0.1, 0.1, 0.1), points={"rim": (0.2, 0.0, 0.0)})},
        {"axle": sj.Revolute(("ground", "rotor"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))},
    )
    with pytest.raises(sj.SceneError, match="can move without resistance"):
        sj.studies.end_compliance(free, "rotor.rim")
    with pytest.raises(sj.SceneError, match="clearance"):
        sj.studies.end_compliance(sj.gallery.four_bar(sj.Dry(clearance=1e-4)), "rocker")
    with pytest.raises(sj.SceneError, match="no body 'hook'"):
        sj.studies.end_compliance(mounted(), "hook")
    assert jnp.all(jnp.isfinite(sj.studies.end_compliance(mounted(), "hand").stiffness))


def test_a_bad_value_that_is_traced_has_no_compliance():
    def entry(mass):
        body = sj.Body(mass, (0.02, 0.03, 0.04), points={"mount": (0.0, 0.0, 0.0)})
        law = sj.laws.MatrixElastomer(K, 1e-3 * K, KR, 1e-3 * KR)
        joints = {"mount": sj.Fixed(("ground", "hand"), "hand.mount", sj.Bushing(law=law))}
        return sj.studies.end_compliance(sj.Scene({"hand": body}, joints), "hand").compliance[0, 0]

    assert float(jax.jit(entry)(2.0)) == pytest.approx(1 / K[0, 0], rel=1e-6)
    assert np.isnan(jax.jit(entry)(-2.0))
