"""Drivers that fight are refused before anything is computed, with the names of both; those that agree are not."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.start.assembly import CLOSING_TOLERANCE, as_ideal, assemble
from spherejax.motion.start.start_now import known_start

TS = np.linspace(0.0, 1.0, 11)
Y = (0.0, 1.0, 0.0)


def turned(*angles, pairs=(("ground", "bob"), ("ground", "bob"))):
    """A body on a pivot whose angle is prescribed by several functions."""
    bob = sj.Body(1.0, (0.1, 0.1, 0.1), position=(0.5, 0.0, 0.0))
    joints: dict = {"pivot": sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), Y)}
    for number, (angle, pair) in enumerate(zip(angles, pairs, strict=True)):
        joints[f"motor_{number}"] = sj.RotationDriver(pair, Y, angle)
    return sj.Scene({"bob": bob}, joints)


def slid(*travels):
    """A body on a straight guide whose travel is prescribed by several functions."""
    block = sj.Body(1.0, (0.1, 0.1, 0.1))
    joints: dict = {"guide": sj.Prismatic(("ground", "block"), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))}
    for number, travel in enumerate(travels):
        joints[f"piston_{number}"] = sj.TranslationDriver(("ground", "block"), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), travel)
    return sj.Scene({"block": block}, joints)


def started(scene, ts=TS):
    return known_start(compile_scene(scene).system, ts)


def cubic(*changes):
    """Numbers of a cubic in time, some of them changed; none is 0 or 1, so that all make one program."""
    return sj.functions.Polynomial(
        [changes[k] if k < len(changes) and changes[k] else a for k, a in enumerate((0.2, 0.7, 0.3, 0.4))]
    )


MOTORS, PISTONS = "drivers 'motor_0' and 'motor_1' fight", "drivers 'piston_0' and 'piston_1' fight"
OTHER_ORDER = (("ground", "bob"), ("bob", "ground"))
CASES = {
    "angles": (turned(cubic(), cubic(0.5)), f"{MOTORS}: at t = 0 s they ask for positions that"),
    "speeds": (turned(cubic(), cubic(None, 0.8)), f"{MOTORS}: at t = 0 s they ask for velocities that"),
    "accelerations": (turned(cubic(), cubic(None, None, 0.2)), f"{MOTORS}: at t = 0 s they ask for accelerations that"),
    "later": (turned(cubic(), cubic(None, None, None, 0.5)), f"{MOTORS}: they prescribe the same coordinate and part"),
    "the other order": (
        turned(cubic(), cubic(), pairs=OTHER_ORDER),
        f"{MOTORS}: at t = 0 s they ask for positions",
    ),
    "places": (slid(cubic(), cubic(0.5)), f"{PISTONS}: at t = 0 s they ask for positions"),
    "travel": (slid(cubic(), cubic(None, -0.7)), f"{PISTONS}: at t = 0 s they ask for velocities"),
    "travel, later": (slid(cubic(), cubic(None, None, None, 0.3)), f"{PISTONS}: they prescribe the same coordinate"),
}


@pytest.mark.parametrize("name", CASES)
def test_drivers_that_fight_are_both_named(name):
    scene, message = CASES[name]
    with pytest.raises(sj.SceneError, match=re.escape(message)) as caught:
        started(scene)
    assert str(caught.value).endswith("Remove one of them, or make their functions of time agree.")


def test_a_run_is_refused_before_it_begins():
    with pytest.raises(sj.SceneError, match=MOTORS):
        sj.simulate(turned(cubic(), cubic(None, 0.8)), TS)


AGREEING = {
    "alike": turned(cubic(), cubic()),
    "after turns": turned(cubic(None, 20.0), cubic(0.2 + 2 * np.pi, 20.0)),
    "the other order": turned(cubic(), sj.functions.Polynomial([-0.2, -0.7, -0.3, -0.4]), pairs=OTHER_ORDER),
    "travel": slid(cubic(), cubic()),
}


@pytest.mark.parametrize("name", AGREEING)
def test_drivers_that_agree_are_redundant_but_no_error(name):
    """Also after several turns, and between the bodies in the other order."""
    assert started(AGREEING[name]) is not None


def crank_and_rocker(crank_speed, rocker_speed):
    """A parallelogram, whose crank and rocker turn alike, with a driver on each."""
    y, span = Y, 1.0
    bar = (0.1, 0.1, 0.1)
    bodies = {
        "crank": sj.Body(1.0, bar, position=(0.0, 0.0, 0.25)),
        "coupler": sj.Body(1.0, bar, position=(span / 2, 0.0, 0.5)),
        "rocker": sj.Body(1.0, bar, position=(span, 0.0, 0.25)),
    }
    joints = {
        "crank_pivot": sj.Revolute(("ground", "crank"), (0.0, 0.0, 0.0), y),
        "rocker_pivot": sj.Revolute(("ground", "rocker"), (span, 0.0, 0.0), y),
        "left": sj.Revolute(("crank", "coupler"), (0.0, 0.0, 0.5), y),
        "right": sj.Revolute(("coupler", "rocker"), (span, 0.0, 0.5), y),
        "first": sj.RotationDriver(("ground", "crank"), y, sj.functions.Linear(crank_speed, 0.0)),
        "second": sj.RotationDriver(("ground", "rocker"), y, sj.functions.Linear(rocker_speed, 0.0)),
    }
    return sj.Scene(bodies, joints)


def test_drivers_of_bodies_that_joints_connect():
    """They fight through the mechanism; what is known at the start is said, what agrees passes."""
    with pytest.raises(sj.SceneError, match="drivers 'first' and 'second' fight: at t = 0 s they ask for velocities"):
        started(crank_and_rocker(0.9, 1.1))
    assert started(crank_and_rocker(0.9, 0.9)) is not None


def test_a_driver_that_the_joints_do_not_allow_is_named_with_them():
    """A body on a pivot, driven in a direction that the pivot holds."""
    scene = turned(sj.functions.Linear(1.0, 0.0), pairs=(("ground", "bob"),))
    push = sj.TranslationDriver(("ground", "bob"), (0.5, 0.0, 0.0), (0.0, 1.0, 0.0), sj.functions.Linear(1.0, 0.0))
    scene = sj.Scene(scene.bodies, {"pivot": scene.joints["pivot"], "push": push})
    with pytest.raises(sj.SceneError, match=r"driver 'push' asks at t = 0 s for velocities that 'pivot' do not allow"):
        started(scene)


def test_lanes_whose_drivers_fight_do_not_start():
    """What is traced has no name to give: the lane's start counts as not closed."""

    def residual(speed, curvature):
        scene = turned(cubic(), sj.functions.Polynomial([0.2, speed, curvature, 0.4]))
        return assemble(*flatten_system(as_ideal(compile_scene(scene).system)), 0.0).residual_after

    found = jax.jit(jax.vmap(residual))(jnp.array([0.7, 0.8, 0.7]), jnp.array([0.3, 0.3, 0.2]))
    assert (np.asarray(found) < CLOSING_TOLERANCE).tolist() == [True, False, False]
