"""Where friction holds a mechanism: closed forms of a pendulum and a block; a loop, by simulation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import spherejax as sj

RADIUS, MU, ARM = 0.05, 0.4, 0.3
COSINE = 4 / np.pi
"""Friction of a journal by its pressure, which falls as a cosine, over that of a point: the pressure of a Revolute."""
TURN = sj.Turn(("ground", "arm"), axis=(0, 1, 0))


def dry(mu=MU, radius=RADIUS, **preload):
    return sj.Ideal(friction=sj.BrownMcPhee(mu_kinetic=0.8 * mu, mu_static=mu), radius=radius, **preload)


def pendulum(model):
    arm = sj.Body(2.0, (0.02, 0.02, 0.001), position=(0.0, 0.0, -ARM))
    hinge = sj.Revolute(("ground", "arm"), point=(0, 0, 0), axis=(0, 1, 0), model=model)
    return sj.Scene({"arm": arm}, {"hinge": hinge})


def block(mu, stiffness, slope=0.3):
    """On a plane that is inclined about y, on a spring along it that is slack at 0."""
    axis = np.array([np.cos(slope), 0.0, -np.sin(slope)])
    body = sj.Body(2.0, (0.1, 0.1, 0.1), points={"middle": (0, 0, 0)})
    guide = sj.Prismatic(("ground", "block"), point=(0, 0, 0), axis=axis, model=dry(mu, radius=None))
    spring = sj.SpringDamper(("ground.anchor", "block.middle"), stiffness, free_length=1.0)
    points = {"anchor": -axis}
    return sj.Scene({"block": body}, {"guide": guide}, {"spring": spring}, ground_points=points), axis


def slider_crank(angle, mu=0.3, v1=1e-5):
    """A crank, a rod and a slider on a spring; dry pins and a dry guide, none redundant. Closed at a crank angle."""
    crank, rod = 0.1, 0.25
    joint = np.array([crank * np.cos(angle), 0.0, crank * np.sin(angle)])
    end = np.array([joint[0] + np.sqrt(rod**2 - joint[2] ** 2), 0.0, 0.0])
    law = sj.Threlfall(mu=mu, v1=v1)
    pin, tilt = sj.Ideal(friction=law, radius=0.02), np.arctan2(end[2] - joint[2], end[0] - joint[0])

    def turned(a):
        return (np.cos(a / 2), 0.0, -np.sin(a / 2), 0.0)

    bodies = {
        "crank": sj.Body(0.4, (1e-3, 1e-3, 1e-3), position=joint / 2, quaternion=turned(angle)),
        "rod": sj.Body(
            0.5,
            (3e-3, 3e-3, 3e-3),
            position=(joint + end) / 2,
            quaternion=turned(tilt),
            points={"wrist": (rod / 2, 0, 0)},
        ),
        "slider": sj.Body(0.6, (1e-3, 1e-3, 1e-3), position=end, points={"middle": (0, 0, 0)}),
    }
    joints = {
        "bearing": sj.Revolute(("ground", "crank"), point=(0, 0, 0), axis=(0, 1, 0), model=pin),
        "crank_pin": sj.Cylindrical(("crank", "rod"), point=joint, axis=(0, 1, 0), model=pin),
        "wrist": sj.Spherical("rod.wrist", "slider.middle", pin),
        "guide": sj.Prismatic(("ground", "slider"), point=end, axis=(1, 0, 0), model=sj.Ideal(friction=law)),
    }
    spring = sj.SpringDamper(("ground.anchor", "slider.middle"), 60.0, free_length=0.25)
    return sj.Scene(bodies, joints, {"spring": spring}, ground_points={"anchor": (0.6, 0, 0)})


CRANK = sj.Turn(("ground", "crank"), axis=(0, -1, 0))


@pytest.mark.slow
def test_a_pendulum_stays_within_its_friction():
    """sin(angle) = (4/pi) mu_s R / l; efforts m g l sin(angle) +- (4/pi) mu_s R m g."""
    found = sj.studies.friction_band(pendulum(dry()), TURN, (-0.5, 0.5), samples=21)
    limit = np.arcsin(COSINE * MU * RADIUS / ARM)
    assert found.bands == [(pytest.approx(-limit, rel=1e-9), pytest.approx(limit, rel=1e-9))]
    weight, rubbing = 2 * 9.81 * ARM * np.sin(found.positions), 2 * 9.81 * COSINE * MU * RADIUS
    np.testing.assert_allclose(found.forward, weight + rubbing, rtol=1e-9)
    np.testing.assert_allclose(found.backward, weight - rubbing, rtol=1e-9)
    assert repr(found) == "stays from -0.08498 to 0.08498 rad, of 21 positions from -0.5 to 0.5 rad"
    with pytest.raises(sj.SceneError, match=r"does not stay at 0\.4 rad; it stays from -0\.08498 to 0\.08498 rad"):
        found.band(0.4)
    assert not np.isfinite(sj.studies.friction_band(pendulum(dry()), TURN, (0.0, 0.05), samples=3).band(0.02)).any()


@pytest.mark.slow
def test_the_ends_have_derivatives():
    def ends(mu, moment):
        found = sj.studies.friction_band(pendulum(dry(mu, preload=moment)), TURN, (-0.5, 0.5), samples=11)
        return jnp.stack(found.band(0.0))

    mu, moment = 0.4, 0.1
    # The preload is a moment of fast sliding: its static limit is larger by mu_s/mu_k.
    sine = COSINE * mu * RADIUS / ARM + moment / 0.8 / (2 * 9.81 * ARM)
    slopes = np.array([COSINE * RADIUS / ARM, 1 / 0.8 / (2 * 9.81 * ARM)]) / np.sqrt(1 - sine**2)
    values, (by_mu, by_moment) = jax.jit(lambda *x: (ends(*x), jax.jacfwd(ends, (0, 1))(*x)))(mu, moment)
    np.testing.assert_allclose(values, [-np.arcsin(sine), np.arcsin(sine)], rtol=1e-9)
    np.testing.assert_allclose(by_mu, [-slopes[0], slopes[0]], rtol=1e-8)
    np.testing.assert_allclose(by_moment, [-slopes[1], slopes[1]], rtol=1e-8)


@pytest.mark.slow
def test_a_block_on_a_spring_stays_between_two_places():
    """k x = m g (sin a -+ (4/pi) mu cos a): a guide presses as a journal does."""
    scene, axis = block(0.2, 40.0)
    found = sj.studies.friction_band(scene, sj.Travel(("ground", "block"), axis), (0.0, 0.3), samples=7)
    weight = 2 * 9.81 / 40
    expected = [weight * (np.sin(0.3) + side * COSINE * 0.2 * np.cos(0.3)) for side in (-1, 1)]
    np.testing.assert_allclose(found.band(0.15), expected, rtol=1e-9)
    assert (found.unit, found.coordinate_unit) == ("N", "m")


@pytest.mark.slow
def test_a_mechanism_with_a_loop_stays_where_a_simulation_stays():
    """A law that creeps, at 1e-5 m/s: within the band it creeps on, and outside of it it falls."""
    found = sj.studies.friction_band(slider_crank(1.0), CRANK, (0.3, 2.2), samples=39)
    ((first, last),) = found.bands
    ts = np.linspace(0.0, 0.2, 3)
    for end, inwards in ((first, 1), (last, -1)):
        for step, stays in ((0.05, True), (-0.05, False)):
            scene = slider_crank(1.0 + end + inwards * step)  # the coordinate is 0 in the scene that was described
            run = sj.simulate(scene, ts, rtol=1e-7)
            way = np.linalg.norm(run.position("slider")[-1] - run.position("slider")[0])
            assert (way < 2e-5) == stays, (end, step, way)


@pytest.mark.slow
def test_derivatives_through_a_loop_are_those_of_differences():
    def ends(mu):
        return jnp.stack(sj.studies.friction_band(slider_crank(1.0, mu), CRANK, (0.3, 2.2), samples=39).band(1.5))

    step = 1e-4
    slopes = jax.jit(jax.jacfwd(ends))(0.3)
    differences = (ends(0.3 + step) - ends(0.3 - step)) / (2 * step)
    assert np.all(np.abs(differences) > 1e-3)
    np.testing.assert_allclose(slopes, differences, rtol=1e-6)


@pytest.mark.slow
def test_the_gallerys_lamp_stays_by_itself_until_the_spring_is_too_weak():
    """Moments about the hinge, with the reaction of the arm's weight and of the spring: beyond 0.755 rad it sinks."""
    elevation = sj.Turn(("ground", "arm"), axis=(0, -1, 0))
    found = sj.studies.friction_band(sj.gallery.lamp(), elevation, (-1.2, 1.2))

    def excess(angle):
        hook = 0.15 * np.array([np.cos(angle), np.sin(angle)])
        away = np.array([0.0, 0.15]) - hook
        pull = 160.0 * (np.linalg.norm(away) - 0.03) * away / np.linalg.norm(away)
        weight = np.array([0.0, -1.5 * 9.81])
        moment = hook[0] * pull[1] - hook[1] * pull[0] + 0.2 * np.cos(angle) * weight[1]
        return moment + COSINE * 0.3 * 0.03 * np.linalg.norm(pull + weight)

    ((_, last),) = found.bands
    assert last == pytest.approx(brentq(excess, 0.3, 1.2), abs=2e-3)


def test_an_end_that_is_not_known_is_not_a_number():
    """Beyond its reach a mechanism has no efforts: where the band goes on to there, its end is not a root."""
    found = sj.studies.friction_band(pendulum(dry()), TURN, (-0.2, 0.2), samples=9)
    first, last = found.band(0.0)
    outside = found.positions > last
    assert np.any(outside)
    lost = eqx.tree_at(lambda f: f.forward, found, jnp.where(outside, jnp.nan, found.forward))
    assert lost.band(0.0)[0] == first
    assert np.isnan(lost.band(0.0)[1])


def test_what_has_no_band_is_answered_in_words():
    scene = pendulum(dry())
    play = sj.Dry(clearance=1e-4, friction=sj.Threlfall())
    driver = sj.RotationDriver(("ground", "arm"), (0, 1, 0), rate=0.0)
    driven = sj.Scene(scene.bodies, {**scene.joints, "motor": driver})
    place = {"origin": (0, 0, 0)}
    arm = sj.Body(2.0, (0.02, 0.02, 0.001), position=(0.0, 0.0, -ARM), points={"end": (0.0, 0.0, ARM)})
    ball = sj.Scene({"arm": arm}, {"ball": sj.Spherical("ground.origin", "arm.end", play)}, ground_points=place)
    for case, arguments, words in (
        (pendulum(sj.Ideal()), (TURN, (0, 1)), "no joint has friction"),
        (ball, (TURN, (0, 1)), r"joint 'ball' has friction in a Dry model.*Ideal\(friction"),
        (driven, (TURN, (0, 1)), "joint 'motor' is a driver"),
        (scene, ("arm", (0, 1)), "along = 'arm' must be a Turn"),
        (scene, (TURN, (1, 0)), "the first below the last"),
        (scene, (TURN, 1.0), "must be two positions"),
    ):
        with pytest.raises(sj.SceneError, match=words):
            sj.studies.friction_band(case, *arguments)
    with pytest.raises(sj.SceneError, match="samples = 1 must be a whole number"):
        sj.studies.friction_band(scene, TURN, (0, 1), samples=1)
