"""Bad input: one readable error each, that names the thing, the value and the remedy."""

import datetime
import os
import subprocess
import sys

import cases
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj

TS = cases.times(0.01, 3)
FOUR_BAR = sj.gallery.four_bar
NAN = float("nan")


def with_body(name="rocker", **changes):
    """The four-bar with some fields of a body replaced."""
    scene = FOUR_BAR()
    for field, value in changes.items():
        scene = eqx.tree_at(lambda s, field=field: getattr(s.bodies[name], field), scene, np.asarray(value, float))
    return scene


def with_joint(name, joint):
    scene = FOUR_BAR()
    return sj.Scene(scene.bodies, {**scene.joints, name: joint}, gravity=scene.gravity)


def apart():
    body = sj.Body(1.0, (1.0, 1.0, 1.0), points={"p": (0.0, 0.0, 0.0)})
    bodies = dict.fromkeys(("one", "two", "three", "four"), body)
    return sj.Scene(bodies, {"left": sj.Spherical("one.p", "two.p"), "right": sj.Spherical("three.p", "four.p")})


def loose():
    body = sj.Body(1.0, (1.0, 1.0, 1.0), points={"p": (0.0, 0.0, 0.0)})
    return sj.Scene(dict.fromkeys(("one", "two", "wanderer"), body), {"left": sj.Spherical("one.p", "two.p")})


def sprung(function):
    """A body on a spring."""
    body = sj.Body(1.0, (1.0, 1.0, 1.0), position=(0.0, 0.0, 1.0))
    return sj.Scene({"bob": body}, {}, {"hook": sj.SpringDamper(("ground", "bob"), spring=function)})


LINER = sj.laws.WinklerLiner(1e8, 0.4, 1e-3)


def unclosable():
    scene = FOUR_BAR()
    return eqx.tree_at(lambda s: s.bodies["crank"].points["pin"], scene, np.array([0.0, 0.0, 1.0]))


def alone(**changes):
    return sj.Scene({"ball": sj.Body(**{"mass": 1.0, "inertia": (1.0, 1.0, 1.0), **changes})})


def pinned(joint):
    body = sj.Body(1.0, (1.0, 1.0, 1.0), points={"pin": (0.0, 0.0, 0.0)})
    return sj.Scene({"arm": body}, {"hinge": joint}, ground_points={"pin": (0.0, 0.0, 0.0)})


def pushed(force):
    return sj.Scene({"ball": sj.Body(1.0, (1.0, 1.0, 1.0))}, {}, {"push": force})


def hinge(bodies=("ground", "arm"), point=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0), **others):
    return pinned(sj.Revolute(bodies, point, axis, **others))


FORMS = {
    "mass as text": (lambda: alone(mass="0.8"), "body 'ball': mass = '0.8' must be one number", "without quotes"),
    "mass with a unit": (lambda: alone(mass="0.8 kg"), "body 'ball': mass = '0.8 kg'", "scene files"),
    "mass as a list": (lambda: alone(mass=[0.8]), "body 'ball': mass = [0.8] must be one number, not of shape (1,)"),
    "mass of shape (1,)": (lambda: alone(mass=np.array([1.0])), "mass = [1.] must be one number, not of shape (1,)"),
    "mass as a truth value": (lambda: alone(mass=True), "mass = True must be one number", "truth value"),
    "complex mass": (lambda: alone(mass=1 + 1j), "mass = (1+1j)", "real part"),
    "mass None": (lambda: alone(mass=None), "mass = None must be one number", "Give the number"),
    "mass of 400 digits": (lambda: alone(mass=10**400), "mass = 1000", "64 bits"),
    "mass of 6,000 digits": (lambda: alone(mass=10**6000), "mass = a number of thousands of digits", "64 bits"),
    "inertia of two": (lambda: alone(inertia=(1.0, 1.0)), "body 'ball': inertia = [1. 1.]", "three", "(2,)"),
    "inertia of one": (lambda: alone(inertia=1.0), "body 'ball': inertia = 1 must", "three"),
    "inertia as texts": (lambda: alone(inertia=("1", "1", "1")), "inertia = ('1', '1', '1')", "without quotes"),
    "ragged inertia": (lambda: alone(inertia=[[1, 2], [3]]), "inertia = [[1, 2], [3]]", "different lengths"),
    "velocity of two": (
        lambda: alone(velocity=(1.0, 0.0)), "velocity = [1. 0.] must be three numbers, not of shape (2,)"
    ),
    "velocity of one": (
        lambda: alone(velocity=1.0), "velocity = 1 must be three numbers", "Write e.g. (0.0, 0.0, 1.0)"
    ),
    "spin of one": (lambda: alone(angular_velocity=[1.0]), "angular_velocity = [1.] must be three numbers"),
    "complex velocity": (lambda: alone(velocity=np.array([1j, 0, 0])), "velocity = array(", "real part"),
    "velocity in time": (lambda: alone(velocity=np.array([1, 2, 3], "m8[s]")), "velocity = array(", "seconds"),
    "position of four": (lambda: alone(position=(1, 2, 3, 4)), "position = [1. 2. 3. 4.] must be three numbers"),
    "quaternion of three": (
        lambda: alone(quaternion=(1.0, 0.0, 0.0)), "quaternion = [1. 0. 0.]", "four", "scalar part"
    ),
    "point of two": (
        lambda: alone(points={"tip": (1, 2)}), "body 'ball': points['tip'] = [1. 2.] must be three numbers"
    ),
    "points as a list": (lambda: alone(points=[(1, 2, 3)]), "points = [[1 2 3]] must be a dict by name", "Write"),
    "scalar gravity": (
        lambda: sj.Scene(alone().bodies, gravity=9.81), "scene: gravity = 9.81 must be three numbers", "Write e.g."
    ),
    "ground point of two": (lambda: sj.Scene(alone().bodies, ground_points={"hook": (0, 0)}), "ground_points['hook']"),
    "the class of a model": (lambda: FOUR_BAR(sj.Ideal), "joint 'coupler_rocker': model = <class", "Ideal(...)"),
    "the class of a law": (
        lambda: FOUR_BAR(sj.Dry(1e-4, normal=sj.Hertz)), "model.normal = <class", "must be a normal law", "Hertz(...)"
    ),
    "a law as text": (
        lambda: FOUR_BAR(sj.Dry(1e-4, friction="threlfall")), "model.friction = 'threlfall'", "LuGre(...)"
    ),
    "a law as a number": (lambda: FOUR_BAR(sj.Dry(1e-4, friction=0.1)), "model.friction = 0.1 must be a friction law"),
    "clearance as text": (
        lambda: FOUR_BAR(sj.Dry("0.1 mm")), "'coupler_rocker': model.clearance = '0.1 mm' must be one"
    ),
    "ball radius as text": (lambda: sj.Dry(ball_radius="0.0099"), "ball_radius = '0.0099' must be one number"),
    "a law's number as text": (
        lambda: FOUR_BAR(sj.Dry(1e-4, friction=sj.Threlfall(mu="0.1"))), "model.friction.mu = '0.1' must be one number"
    ),
    "axis as a letter": (lambda: hinge(axis="z"), "joint 'hinge': axis = 'z' must be three numbers", "(0.0, 0.0, 1.0)"),
    "axis of two": (lambda: hinge(axis=(0, 1)), "joint 'hinge': axis = [0. 1.] must be three numbers"),
    "place of two": (lambda: hinge(point=(0, 0)), "joint 'hinge': point = [0. 0.] must be three numbers"),
    "bodies as text": (lambda: hinge(bodies="ground"), "bodies = 'ground' must be two names", '("ground", "arm")'),
    "three bodies": (lambda: hinge(bodies=("ground", "arm", "rod")), "must be two names"),
    "joint as text": (lambda: pinned("revolute"), "joint 'hinge' = 'revolute' is no joint", "sj.Revolute(...)"),
    "joint as a class": (lambda: pinned(sj.Revolute), "joint 'hinge' = <class", "is no joint"),
    "a model as joint": (lambda: pinned(sj.Ideal()), "joint 'hinge' = Ideal() is no joint", "sj.Spherical("),
    "joints as a list": (lambda: sj.Scene(alone().bodies, ["hinge"]), "joints = ['hinge'] must be a dict by name"),
    "socket as a number": (lambda: pinned(sj.Spherical(3, "arm.pin")), "joint 'hinge': socket = 3 must be a name"),
    "a word for a truth value": (
        lambda: pinned(sj.Spherical("ground.pin", "arm.pin", sj.Dry(1e-4), starts_concentric="no")),
        "joint 'hinge': starts_concentric = 'no' must be True or False",
    ),
    "body as text": (lambda: sj.Scene({"ball": "box"}), "body 'ball' = 'box' is no body", "sj.Body(mass, inertia)"),
    "force as text": (lambda: pushed("gravity"), "force 'push' = 'gravity' is no force", "SpringDamper"),
    "force of two": (
        lambda: pushed(sj.AppliedWrench("ball", force=(1.0, 2.0))), "force 'push': force = [1. 2.]", "three"
    ),
    "stiffness as text": (
        lambda: pushed(sj.SpringDamper(("ground", "ball"), stiffness="1e3")), "'push': stiffness = '1e3'", "quotes"
    ),
    "a function's number": (
        lambda: pinned(sj.RotationDriver(("ground", "arm"), (0, 0, 1), sj.functions.Linear("1"))),
        "angle.slope = '1' must be one"
    ),
    "the class of a function": (
        lambda: pushed(sj.SpringDamper(("ground", "ball"), spring=sj.functions.Linear)),
        "Linear alone is no function", "Linear("
    ),
}  # fmt: skip
"""What has another form than its field: NumPy reads numbers into many of these."""


@pytest.mark.parametrize("name", FORMS)
def test_what_has_another_form_is_named_with_its_place_and_a_remedy(name):
    build, *words = FORMS[name]
    with pytest.raises(sj.SceneError) as caught:
        sj.equations.compile_scene(build())
    for word in words:
        assert word in str(caught.value), (word, str(caught.value))


def test_a_form_is_judged_where_numbers_are_traced_too():
    with pytest.raises(sj.SceneError, match=r"body 'ball': velocity = \(traced\) must be three numbers"):
        jax.jit(lambda v: sj.simulate(alone(velocity=v), TS).ys)(jnp.ones(2))


def test_what_python_has_for_numbers_is_taken():
    from decimal import Decimal
    from fractions import Fraction

    scene = alone(mass=Fraction(1, 2), inertia=[Decimal("1"), np.float32(1), np.int8(1)], velocity=range(3))
    body = sj.equations.compile_scene(scene).system.bodies["ball"]
    assert (float(body.mass), *np.asarray(body.velocity)) == (0.5, 0.0, 1.0, 2.0)


SCENES = {
    "negative clearance": (
        lambda: FOUR_BAR(sj.Dry(clearance=-1e-4)),
        "coupler_rocker",
        "clearance = -0.0001",
        "positive",
    ),
    "zero clearance": (lambda: FOUR_BAR(sj.Lubricated(clearance=0.0)), "coupler_rocker", "clearance = 0", "positive"),
    "clearance beyond the socket": (
        lambda: FOUR_BAR(sj.Dry(clearance=0.02)),
        "coupler_rocker",
        "clearance = 0.02",
        "socket",
    ),
    "ball larger than socket": (
        lambda: FOUR_BAR(sj.Dry(ball_radius=0.011, socket_radius=0.010)),
        "coupler_rocker",
        "ball_radius = 0.011",
        "larger than its socket",
        "exchange",
    ),
    "ball larger, lubricated": (
        lambda: FOUR_BAR(sj.Lubricated(ball_radius=0.011)),
        "coupler_rocker",
        "ball_radius = 0.011",
        "exchange",
    ),
    **{
        f"restitution {value} in {law.__name__}": (
            lambda law=law, value=value: FOUR_BAR(sj.Dry(clearance=1e-4, normal=law(restitution=value))),
            "coupler_rocker",
            law.__name__,
            f"restitution = {value:g}",
            "(0, 1]",
            "small positive number",
        )
        for law in (sj.HuntCrossley, sj.LankaraniNikravesh, sj.Gonthier, sj.Flores, sj.ExactRestitution)
        for value in (0.0, 1.01, -0.5)
    },
    "Coulomb": (
        lambda: FOUR_BAR(sj.Dry(clearance=1e-4, friction=sj.Coulomb(mu=0.1))),
        "coupler_rocker",
        ": friction = Coulomb(mu=0.1) must be a law",
        "jumps at zero sliding",
        "Threlfall",
        "BengisuAkay",
        "Ambrosio",
        "BrownMcPhee",
        "LuGre",
    ),
    "unknown body": (
        lambda: with_joint("extra", sj.Revolute(("ground", "crnk"), (0, 0, 0), (1, 0, 0))),
        "extra",
        "'crnk'",
        "'crank'",
    ),
    "unknown body of a point": (
        lambda: with_joint("extra", sj.Spherical("crnk.pin", "rocker.pivot")),
        "crnk.pin",
        "'crnk'",
        "'crank'",
    ),
    "unknown body of a force": (
        lambda: sj.Scene(FOUR_BAR().bodies, FOUR_BAR().joints, {"push": sj.AppliedWrench("crnk")}),
        "push",
        "'crnk'",
        "'crank'",
    ),
    "unknown point": (
        lambda: with_joint("extra", sj.Spherical("crank.pim", "rocker.pivot")),
        "'crank'",
        "'pim'",
        "'pin'",
        "Add",
    ),
    "no point": (lambda: with_joint("extra", sj.Spherical("crank", "rocker.pivot")), "'crank'", "body.point"),
    "unknown ground point": (
        lambda: with_joint("extra", sj.Spherical("ground.nail", "rocker.pivot")),
        "'ground'",
        "'nail'",
        "none",
    ),
    "joint to itself": (
        lambda: with_joint("extra", sj.Spherical("crank.pin", "crank.pivot")),
        "extra",
        "'crank'",
        "itself",
        "two different",
    ),
    "ground to itself": (
        lambda: with_joint("extra", sj.Revolute(("ground", "ground"), (0, 0, 0), (1, 0, 0))),
        "extra",
        "'ground'",
        "itself",
    ),
    "disconnected groups": (apart, "'three'", "'one'", "add a joint"),
    "loose body": (loose, "'wanderer'", "add a joint", "remove"),
    "no body": (lambda: sj.Scene({}), "no body", "Body"),
    "a body called ground": (lambda: sj.Scene({"ground": sj.Body(1.0, (1.0, 1.0, 1.0))}), "'ground'", "another name"),
    "cannot close": (unclosable, "cannot be closed", "crank_coupler|coupler_rocker", "residual", "Check"),
    "quaternion": (
        lambda: with_body(quaternion=(1.0, 1.0, 0.0, 0.0)),
        "'rocker'",
        "quaternion",
        "unit norm",
        "Divide",
    ),
    "zero mass": (lambda: with_body(mass=0.0), "'rocker'", "mass = 0", "positive", "small mass"),
    "negative inertia": (
        lambda: with_body(inertia=(1e-4, -1e-6, 1e-4)),
        "'rocker'",
        "inertia",
        "-1.*e-06",
        "positive",
        "principal",
    ),
    "indefinite inertia": (
        lambda: sj.Scene({"plate": sj.Body(1.0, np.diag([1.0, 1.0, -1.0]))}),
        "'plate'",
        "inertia",
        "positive",
        "symmetric",
    ),
    "zero axis": (
        lambda: with_joint("extra", sj.Revolute(("ground", "crank"), (0, 0, 0), (0, 0, 0))),
        "extra",
        "axis",
        "direction",
    ),
    "negative viscosity": (
        lambda: FOUR_BAR(sj.Lubricated(clearance=1e-4, viscosity=-1.0)),
        "coupler_rocker",
        "viscosity = -1",
        "positive",
    ),
    "negative stiffness": (
        lambda: FOUR_BAR(sj.Bushing(stiffness=-1.0, damping=0.0)),
        "coupler_rocker",
        "stiffness = -1",
        "Give",
    ),
    "negative Baumgarte": (lambda: FOUR_BAR(drift=sj.solvers.Baumgarte(-1.0, 5.0)), "drift", "alpha = -1", "zero"),
    # NaN anywhere
    "NaN mass": (lambda: with_body(mass=NAN), "'rocker'", "mass = nan", "positive"),
    "NaN inertia": (lambda: with_body(inertia=(1.0, NAN, 1.0)), "'rocker'", "inertia", "nan"),
    "NaN position": (lambda: with_body(position=(0.0, NAN, 1.0)), "'rocker'", "position", "nan", "finite"),
    "NaN quaternion": (lambda: with_body(quaternion=(NAN, 0, 0, 1)), "'rocker'", "quaternion", "nan"),
    "NaN velocity": (lambda: with_body(velocity=(0.0, NAN, 1.0)), "'rocker'", "velocity", "nan", "finite"),
    "NaN spin": (lambda: with_body(angular_velocity=(0.0, NAN, 1.0)), "'rocker'", "angular_velocity", "nan"),
    "NaN point": (
        lambda: eqx.tree_at(lambda s: s.bodies["rocker"].points["pivot"], FOUR_BAR(), np.array([NAN, 0, 0])),
        "'rocker'",
        "pivot",
        "nan",
    ),
    "NaN ground point": (
        lambda: eqx.tree_at(
            lambda s: s.ground_points["socket"], cases.ball_in_socket(sj.Dry(clearance=1e-4)), np.array([NAN, 0, 0])
        ),
        "ground",
        "socket",
        "nan",
    ),
    "NaN gravity": (
        lambda: sj.Scene(FOUR_BAR().bodies, FOUR_BAR().joints, gravity=(0.0, 0.0, NAN)),
        "gravity",
        "nan",
        "finite",
    ),
    "NaN axis": (
        lambda: with_joint("extra", sj.Revolute(("ground", "crank"), (0, 0, 0), (NAN, 0, 0))),
        "extra",
        "axis",
        "nan",
    ),
    "NaN clearance": (lambda: FOUR_BAR(sj.Dry(clearance=NAN)), "coupler_rocker", "clearance = nan"),
    "NaN ball radius": (lambda: FOUR_BAR(sj.Dry(ball_radius=NAN)), "coupler_rocker", "ball_radius = nan"),
    "NaN restitution": (
        lambda: FOUR_BAR(sj.Dry(clearance=1e-4, normal=sj.Flores(restitution=NAN))),
        "coupler_rocker",
        "restitution = nan",
    ),
    "NaN friction": (
        lambda: FOUR_BAR(sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=NAN))),
        "coupler_rocker",
        "mu = nan",
    ),
    "NaN film": (lambda: FOUR_BAR(sj.Lubricated(clearance=1e-4, e_h1=NAN)), "coupler_rocker", "e_h1 = nan"),
    "NaN elastomer": (lambda: FOUR_BAR(sj.Bushing(1e6, NAN)), "coupler_rocker", "damping = nan"),
    "NaN material": (
        lambda: FOUR_BAR(sj.Dry(clearance=1e-4, ball_material=sj.Material(youngs_modulus=NAN))),
        "coupler_rocker",
        "youngs_modulus = nan",
    ),
    "NaN force": (
        lambda: sj.Scene(FOUR_BAR().bodies, FOUR_BAR().joints, {"push": sj.AppliedWrench("rocker", force=(NAN, 0, 0))}),
        "push",
        "force",
        "nan",
    ),
    "NaN Baumgarte": (lambda: FOUR_BAR(drift=sj.solvers.Baumgarte(5.0, NAN)), "drift", "beta = nan"),
    "Baumgarte by axes": (
        lambda: FOUR_BAR(drift=sj.solvers.Baumgarte(np.ones(2), 5.0)),
        "drift",
        "alpha",
        "one number",
    ),
    "texts for coefficients": (
        lambda: sprung(sj.functions.Polynomial(["a", 1.0])),
        "hook",
        "coefficients = ['a', 1.0]",
    ),
    "texts in a table": (lambda: sprung(sj.functions.Table([0, 1], ["a", "b"])), "hook", "y = ['a', 'b']"),
    "texts for depths": (
        lambda: FOUR_BAR(sj.Dry(1e-4, socket_depth=sj.laws.HarmonicDepth(["a"]))),
        "coupler_rocker",
        "socket_depth.coefficients = ['a']",
    ),
    "complex coefficients": (lambda: sprung(sj.functions.Polynomial(np.array([1j, 2.0]))), "hook", "coefficients"),
    "truth values for coefficients": (lambda: sprung(sj.functions.Polynomial([True, 2.0])), "hook", "coefficients"),
    "truth value within pieces": (
        lambda: sprung(sj.functions.Piecewise([0.0], [sj.functions.Linear(True), sj.functions.Linear(1.0)])),
        "hook",
        "pieces[0].slope = True must be one number",
    ),
    "three slopes within a sum": (
        lambda: sprung(sj.functions.Sum(sj.functions.Linear(1.0), sj.functions.Linear(np.ones(3)))),
        "hook",
        "terms[1].slope",
        "must be one number",
    ),
    "None for a point": (
        lambda: sj.Revolute(("ground", "rod"), None, (0.0, 1.0, 0.0)),
        "None is no point",
        "three numbers",
    ),
    "a cup along no direction": (
        lambda: FOUR_BAR(sj.Lubricated(1e-4, film=sj.laws.LinedSocket(LINER, axis=(NAN, 0.0, 1.0)))),
        "coupler_rocker",
        "film.axis|axis",
        "direction in space",
    ),
    "Baumgarte in words": (lambda: FOUR_BAR(drift=sj.solvers.Baumgarte(5.0, "5")), "drift", "beta", "one number"),
}


@pytest.mark.parametrize("name", SCENES)
def test_bad_scene_is_named(name):
    build, *words = SCENES[name]
    with pytest.raises(sj.SceneError) as caught:
        sj.simulate(build(), TS)
    message = str(caught.value)
    for word in words:
        assert any(part.lower() in message.lower() for part in word.split("|")) or _matches(word, message), (
            word,
            message,
        )


def _matches(pattern, message):
    import re

    return re.search(pattern, message) is not None


REQUESTS = {
    "times that repeat": ({"ts": jnp.array([0.0, 0.1, 0.1])}, "ts", "increase", "0.1", "remove repeated"),
    "times that fall": ({"ts": jnp.array([0.0, 0.2, 0.1])}, "ts[2]", "increase", "Sort"),
    "NaN times": ({"ts": jnp.array([0.0, NAN])}, "ts", "finite"),
    "no times": ({"ts": jnp.zeros(0)}, "ts", "shape (0,)"),
    "times as a matrix": ({"ts": jnp.zeros((2, 2))}, "ts", "shape (2, 2)"),
    "rtol below float64": ({"rtol": 1e-17}, "rtol = 1e-17", "float64", "1e-14"),
    "rtol NaN": ({"rtol": NAN}, "rtol = nan", "float64"),
    "negative rtol": ({"rtol": -1e-6}, "rtol = -1e-06", "at least"),
    "atol zero": ({"atol": 0.0}, "atol = 0", "positive"),
    "atol negative": ({"atol": -1.0}, "atol = -1", "positive"),
    "atol NaN": ({"atol": NAN}, "atol = nan", "positive"),
    "atol infinite": ({"atol": np.inf}, "atol = inf", "any error"),
    "atol as a list": ({"atol": [1e-8, 1e-9]}, "atol = ", "must be one number"),
    "rtol too large": ({"rtol": 10}, "rtol = 10", "less than 1"),
    "rtol as text": ({"rtol": "1e-8"}, "rtol = '1e-8'", "without quotes"),
    "negative max_steps": ({"max_steps": -1}, "max_steps = -1 must be a whole number, at least 1", "Leave it out"),
    "max_steps as float": ({"max_steps": 1e5}, "max_steps = 100000 must be a whole number"),
    "a solver's name": ({"solver": "dopri8"}, "solver = 'dopri8' is no solver", "diffrax.Dopri8()"),
    "a solver's class": ({"solver": diffrax.Dopri8}, "is no solver", "diffrax.Dopri8()"),
    "complex times": ({"ts": np.array([0, 1j])}, "ts = ", "holds complex numbers", "real times"),
    "a list of complex times": ({"ts": [0, 1j]}, "holds complex numbers"),
    "complex times of JAX": ({"ts": jnp.array([0, 1j])}, "holds complex numbers"),
    "dates": ({"ts": np.array([0, 5], "M8[ms]")}, "holds dates", "ts - ts[0]"),
    "times as texts": ({"ts": ["0", "1"]}, "is text", "give numbers"),
    "truth values as times": ({"ts": [False, True]}, "truth values"),
    "durations without a unit": ({"ts": np.array([0, 5], "m8")}, "timedelta64 without a unit"),
    "not a time": ({"ts": np.array(["NaT", 5], "m8[ms]")}, "ts must hold finite times"),
    "ragged times": ({"ts": [[0], [1, 2]]}, "rows of different lengths"),
    "times of 400 digits": ({"ts": [0, 10**400]}, "64 bits"),
}


@pytest.mark.parametrize("name", REQUESTS)
def test_bad_request_is_named(name):
    options, *words = REQUESTS[name]
    with pytest.raises(sj.SceneError) as caught:
        sj.simulate(FOUR_BAR(), **{"ts": TS, **options})
    for word in words:
        assert word in str(caught.value), (word, str(caught.value))


def test_durations_are_converted_to_seconds():
    """NumPy would take 5 ms for 5 s, and xarray makes such durations of times with the unit "s"."""
    run = sj.simulate(alone(), np.array([0, 5, 10], "timedelta64[ms]"))
    np.testing.assert_allclose(run.ts, [0.0, 0.005, 0.01], rtol=1e-15)
    again = sj.simulate(alone(), [datetime.timedelta(milliseconds=t) for t in (0, 5, 10)])
    np.testing.assert_array_equal(again.ts, run.ts)
    measured = sj.Measured(np.array([0, 5, 10], "timedelta64[ms]"), {"position.ball.z": np.zeros(3)})
    np.testing.assert_array_equal(measured.ts, run.ts)


@pytest.mark.parametrize("option", ["chunk", "workers", "max_steps"])
@pytest.mark.parametrize("value", [-1, 0, 1.5, "2", True])
def test_a_count_of_a_sweep_is_a_count(option, value):
    with pytest.raises(sj.SceneError, match=rf"{option} = .* must be a whole number, at least 1\. Leave it out"):
        sj.sweep(lambda m: alone(mass=m), {"m": [1.0, 2.0]}, TS, record=["final position.ball"], **{option: value})


def test_values_of_a_sweep_are_numbers():
    for given in (["1", "2"], [True, False], np.array([1, 2], "m8[s]")):
        with pytest.raises(sj.SceneError, match="parameter 'm' must be a list of numbers"):
            sj.studies.product({"m": given})


def test_unknown_names_of_results_are_named():
    run = sj.simulate(FOUR_BAR(), TS)
    with pytest.raises(sj.SceneError, match=r"no body 'rockr'.*'rocker'"):
        run.position("rockr")
    with pytest.raises(sj.SceneError, match=r"no joint 'coupler_rockr'.*'coupler_rocker'"):
        run.reaction("coupler_rockr")
    with pytest.raises(sj.SceneError, match=r"'coupler_rocker' has no clearance.*Ideal"):
        run.penetration("coupler_rocker")
    with pytest.raises(sj.SceneError, match="'crank_pivot' is not spherical"):
        run.eccentricity("crank_pivot")
    with pytest.raises(sj.SceneError, match=r"'coupler_rocker' is ideal"):
        run.absorbed_work("coupler_rocker")


def test_two_radii_or_none_are_refused():
    with pytest.raises(TypeError, match=r"clearance.*ball_radius"):
        sj.Dry(clearance=1e-4, ball_radius=0.0099)
    with pytest.raises(TypeError, match=r"clearance.*ball_radius"):
        sj.Lubricated()
    with pytest.raises(TypeError, match=r"stiffness.*law"):
        sj.Bushing()


def test_32_bit_mode_is_refused():
    code = "import spherejax as sj, numpy as np\nsj.simulate(sj.gallery.four_bar(), np.array([0.0, 1.0]))\n"
    environment = {**os.environ, "SPHEREJAX_CONFIGURE": "0", "JAX_ENABLE_X64": "0"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode != 0
    for word in ("PrecisionError", "32-bit", "jax_enable_x64", "configure()"):
        assert word in done.stderr


# Traced values: a status instead of an error ------------------------------------------------------------------------


def test_bad_lane_is_diagnosed_and_spoils_nothing():
    @jax.jit
    @jax.vmap
    def positions(clearance):
        run = sj.simulate(FOUR_BAR(sj.Dry(clearance=clearance)), TS)
        return run.position("rocker"), run.status

    lanes, status = positions(jnp.array([1e-4, -1e-4, 2e-4, jnp.nan]))
    assert list(map(sj.Status, status.tolist())) == [
        sj.Status.SUCCEEDED,
        sj.Status.BAD_VALUE,
        sj.Status.SUCCEEDED,
        sj.Status.BAD_VALUE,
    ]
    good_company, _ = positions(jnp.array([1e-4, 1.5e-4, 2e-4, 3e-4]))
    np.testing.assert_array_equal(lanes[0], good_company[0])
    np.testing.assert_array_equal(lanes[2], good_company[2])
    assert not np.isfinite(np.asarray(lanes[1])[1:]).any()
    for lane, clearance in ((0, 1e-4), (2, 2e-4)):
        alone = sj.simulate(FOUR_BAR(sj.Dry(clearance=clearance)), TS).position("rocker")
        # Another batch size is another machine program: equal to rounding, amplified by the impacts.
        np.testing.assert_allclose(lanes[lane], alone, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("option", "values"), [("rtol", [1e-6, -1e-6, 10.0, np.nan]), ("atol", [1e-8, -1.0, np.inf])])
def test_a_traced_tolerance_that_cannot_be_is_the_status_of_its_lane(option, values):
    status = jax.jit(jax.vmap(lambda tol: sj.simulate(alone(), TS, **{option: tol}).status))(jnp.array(values))
    assert list(map(sj.Status, status.tolist())) == [sj.Status.SUCCEEDED] + [sj.Status.BAD_VALUE] * (len(values) - 1)


def test_diagnosis_names_the_lane_and_the_remedy():
    runs = jax.jit(jax.vmap(lambda c: sj.simulate(FOUR_BAR(sj.Dry(clearance=c)), TS)))(jnp.array([1e-4, -1e-4]))
    assert list(np.asarray(runs.succeeded)) == [True, False]
    for word in ("lane 1", "not valid", "clearance", "alone"):
        assert word in runs.diagnosis
    assert "lane 0" not in runs.diagnosis
    with pytest.raises(sj.SimulationError, match="lane 1"):
        runs.require_success()


def test_start_that_cannot_close_is_a_status_under_trace():
    def run(height):
        scene = eqx.tree_at(lambda s: s.bodies["crank"].points["pin"], FOUR_BAR(), jnp.array([0.0, 0.0, 1.0]) * height)
        done = sj.simulate(scene, TS)
        return done.status, done.position("rocker")

    status, positions = jax.jit(jax.vmap(run))(jnp.array([0.020, 1.0]))
    assert list(map(sj.Status, status.tolist())) == [sj.Status.SUCCEEDED, sj.Status.START_NOT_CLOSED]
    assert np.isfinite(np.asarray(positions[0])).all()


def test_too_few_steps_is_a_warning_with_a_remedy_and_an_error_on_request():
    with pytest.warns(sj.SimulationWarning, match=r"max_steps.*Raise max_steps"):
        run = sj.simulate(FOUR_BAR(), cases.times(2.0, 5), max_steps=3)
    assert run.status == sj.Status.TOO_MANY_STEPS
    assert np.isnan(np.asarray(run.ys[-1])).all()
    assert np.isfinite(np.asarray(run.ys[0])).all()
    with pytest.raises(sj.SimulationError, match="max_steps"):
        sj.simulate(FOUR_BAR(), cases.times(2.0, 5), max_steps=3, throw=True)


def test_a_traced_number_of_steps_lays_out_no_memory():
    def end(n):
        return sj.simulate(FOUR_BAR(), cases.times(2.0, 5), max_steps=n, adjoint=diffrax.DirectAdjoint()).ys

    with pytest.raises(sj.SceneError, match=r"max_steps is traced, and DirectAdjoint .*leave adjoint= out"):
        jax.jit(end)(100)
