"""The set of poses that clearances allow: by hand, by exact closures, by samples."""

import jax
import numpy as np
import pytest

import spherejax as sj
from spherejax.gallery.five_bar import BASE, CRANK, LEFT, RIGHT, ROD

CLEARANCE = 5e-5


def model(clearance=CLEARANCE):
    return sj.Dry(clearance=clearance, normal=sj.Hertz(stiffness=1e8, exponent=1.0))


@pytest.fixture(scope="module")
def play():
    return sj.studies.pose_play(sj.gallery.five_bar(model()), "left_rod.tip")


def rods():
    """Directions of both rods in the plane, from elbow to tip."""
    feet = np.array([[-BASE / 2, 0.0], [BASE / 2, 0.0]])
    elbows = feet + CRANK * np.array([[np.cos(a), np.sin(a)] for a in (LEFT, RIGHT)])
    way = elbows[1] - elbows[0]
    half = np.linalg.norm(way) / 2
    tip = elbows.mean(0) + np.sqrt(ROD**2 - half**2) * np.array([-way[1], way[0]]) / (2 * half)
    return (tip - elbows) / ROD


def test_the_extent_of_a_five_bar_by_hand(play):
    """The rods keep their lengths: n_1.p = n_1.e_1 and n_2.p = n_2.(e_2 - e_tip)."""
    for angle in np.linspace(0.0, np.pi, 7):
        d = np.array([np.cos(angle), np.sin(angle)])
        first, second = np.linalg.solve(rods().T, d)
        expected = CLEARANCE * (abs(first) + 2 * abs(second))
        assert float(play.reach((d[0], 0.0, d[1]))) == pytest.approx(expected, rel=1e-12)
    assert float(play.reach((0.0, 1.0, 0.0))) < 1e-12 * CLEARANCE
    assert "0.109" in repr(play)


def test_the_worst_eccentricities_reach_the_bound(play):
    for d in (np.eye(6)[0], np.eye(6)[2], np.eye(6)[4]):
        bound = sum(map(float, play.shares(d).values()))
        reached = float(play.change(play.worst(d)) @ d)
        assert reached == pytest.approx(bound, rel=2e-3)


def test_no_sample_lies_outside(play):
    rng = np.random.default_rng(1)
    samples = {}
    for joint in play.influence:
        angle = rng.uniform(0.0, 2 * np.pi, 2000)
        radius = CLEARANCE * np.sqrt(rng.uniform(0.0, 1.0, 2000))[:, None]
        samples[joint] = radius * np.stack([np.cos(angle), np.zeros(2000), np.sin(angle)], 1)
    moved = np.asarray(jax.jit(jax.vmap(play.change))(samples))
    for angle in np.linspace(0.0, 2 * np.pi, 25):
        d = np.array([np.cos(angle), 0.0, np.sin(angle)])
        extent = np.max(moved[:, :3] @ d)
        assert 0.6 < extent / float(play.reach(d)) < 1 + 2e-3


def test_balls_move_in_space():
    """A ball at the end of a driven arm: the next body hangs on it, and the point is the ball's center."""
    scene = sj.gallery.four_bar(sj.Dry(clearance=1e-4))
    joints = {**scene.joints, "motor": sj.RotationDriver(("ground", "crank"), (1, 0, 0), rate=0.0)}
    found = sj.studies.pose_play(sj.Scene(scene.bodies, joints), "rocker.coupler_end")
    # The rocker turns about y alone, with an arm of 0.074 m: by hand from the coupler's fixed length.
    places = {}
    for name, point in (("crank", "pin"), ("rocker", "coupler_end"), ("rocker", "pivot")):
        body = scene.bodies[name]
        w, x = body.quaternion[0], np.asarray(body.quaternion[1:])
        r = np.asarray(body.points[point])
        places[point] = np.asarray(body.position) + r + 2 * np.cross(x, np.cross(x, r) + w * r)
    rod = places["coupler_end"] - places["pin"]
    along = rod / np.linalg.norm(rod)
    arm = places["coupler_end"] - places["pivot"]
    path = np.cross([0.0, 1.0, 0.0], arm)
    # along.(path angle - e) = 0
    expected = 1e-4 / abs(along @ path)
    assert float(found.tilt((0.0, 1.0, 0.0))) == pytest.approx(expected, rel=1e-9)


def test_derivatives():
    def reach(clearance, angle):
        scene = sj.gallery.five_bar(model(clearance))
        motor = sj.RotationDriver(("ground", "left_crank"), (0.0, 1.0, 0.0), rate=0.0, start=angle)
        found = sj.studies.pose_play(sj.Scene(scene.bodies, {**scene.joints, "left_motor": motor}), "left_rod.tip")
        return 1e3 * found.reach((0.0, 0.0, 1.0))

    at = np.array([CLEARANCE, 0.1])
    exact = jax.jit(jax.grad(reach, (0, 1)))(*at)
    assert all(abs(float(one)) > 1e-5 for one in exact)
    for i, step in enumerate((1e-7, 1e-4)):
        by = step * np.eye(2)[i]
        difference = (reach(*(at + by)) - reach(*(at - by))) / (2 * step)
        assert float(exact[i]) == pytest.approx(float(difference), rel=1e-6, abs=1e-12)


def test_bad_requests(play):
    with pytest.raises(sj.SceneError, match="no joint has a clearance"):
        sj.studies.pose_play(sj.gallery.five_bar(), "left_rod")
    with pytest.raises(sj.SceneError, match="a degree of freedom is not held"):
        sj.studies.pose_play(sj.gallery.four_bar(sj.Dry(clearance=1e-4)), "rocker")
    with pytest.raises(sj.SceneError, match="no body 'rod'"):
        sj.studies.pose_play(sj.gallery.five_bar(model()), "rod")
    with pytest.raises(sj.SceneError, match="on the ground"):
        sj.studies.pose_play(sj.gallery.five_bar(model()), "ground")
    with pytest.raises(sj.SceneError, match="did you mean 'tip'"):
        play.change({"tipp": np.zeros(3)})


def test_what_has_no_answer_is_nan_where_numbers_are_traced():
    """An error names it where numbers are known; within a trace an answer would be taken for one."""

    def reach(clearance):
        return sj.studies.pose_play(sj.gallery.five_bar(model(clearance)), "left_rod.tip").reach((1, 0, 0))

    with pytest.raises(sj.SceneError, match="clearance"):
        reach(-1e-5)
    assert np.isfinite(jax.jit(reach)(1e-5))
    assert np.isnan(jax.jit(reach)(-1e-5))
