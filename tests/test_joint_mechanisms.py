"""Mechanisms of all kinds of joints: what they conserve, and that equivalent ones move alike."""

from itertools import pairwise

import cases
import diffrax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import assembled

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix
from spherejax.model.system import flatten_system
from spherejax.motion.equations.observables import Observation, observe
from spherejax.motion.equations.programs import program_for

# Bodies are given general velocities, and those that the joints allow are left to them.
pytestmark = pytest.mark.filterwarnings("ignore::spherejax.errors.StartWarning")

Y, Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
DOPRI8 = diffrax.Dopri8()


def block(x=0.0, z=0.0, mass=1.0, **options):
    """A block at (x, 0, z), with named points around it."""
    points = {"left": (-0.1, 0.0, 0.0), "right": (0.1, 0.0, 0.0), "center": (0.0, 0.0, 0.0)}
    return sj.Body(mass, mass * np.array([0.002, 0.004, 0.005]), position=(x, 0.0, z), points=points, **options)


def run_of(scene, t_end=0.3, rtol=1e-9, **options):
    return sj.simulate(scene, cases.times(t_end, 13), rtol=rtol, solver=DOPRI8, **options).require_success()


# A mechanism with every kind of joint --------------------------------------------------------------------------------


def everything():
    """A chain from the ground with each kind of joint that is not driven, closed by rods and curves."""
    names = "abcdefg"
    bodies = {name: block(0.1 + 0.2 * i) for i, name in enumerate(names)}
    at = {f"{a}{b}": (0.2 * (i + 1), 0.0, 0.0) for i, (a, b) in enumerate(pairwise(names))}
    joints = {
        "revolute": sj.Revolute(("ground", "a"), (0.0, 0.0, 0.0), (0.3, 1.0, 0.0)),
        "universal": sj.Universal(("a", "b"), at["ab"], Y, Z),
        "cylindrical": sj.Cylindrical(("b", "c"), "b.right", (1.0, 0.5, 0.2)),
        "prismatic": sj.Prismatic(("c", "d"), at["cd"], (1.0, 0.0, 1.0)),
        "fixed": sj.Fixed(("d", "e"), at["de"]),
        "spherical": sj.Spherical("e.right", "f.left"),
        "plane": sj.joints.PointOnPlane("f.right", at["fg"], (0.2, 1.0, 0.1)),
        "circle": sj.joints.PointOnCurve("g.right", sj.joints.Circle((1.4, 0.0, 0.5), Y, 0.5)),
        "rod": sj.joints.Distance("f.left", "g.right"),
    }
    return sj.Scene(bodies, joints, drift=sj.solvers.Projection())


@pytest.mark.slow
def test_every_joint_in_one_mechanism():
    scene = everything()
    report = sj.constraint_report(scene)
    assert (report.n_equations, report.rank, report.degrees_of_freedom) == (31, 31, 11)
    run = run_of(scene)
    energy = np.asarray(run.mechanical_energy)
    assert np.ptp(np.asarray(run.kinetic_energy)) > 1.0
    assert np.abs(energy - energy[0]).max() < 1e-7
    assert np.asarray(run.constraint_violation).max() < 1e-12
    assert np.asarray(run.velocity_violation).max() < 1e-12
    # The pin of the revolute stays, the prismatic pair does not turn, the fixed one is one body.
    assert np.asarray(run.quaternion("c")) == pytest.approx(np.asarray(run.quaternion("d")), abs=1e-12)
    apart = np.asarray(run.position("e") - run.position("d"))
    assert np.linalg.norm(apart, axis=1) == pytest.approx(0.2, abs=1e-12)


# Equivalent mechanisms -----------------------------------------------------------------------------------------------


def seen(scene) -> tuple[sj.equations.System, Observation]:
    """Accelerations, reactions and energies at the start, computed without compiling anything."""
    system = sj.equations.compile_scene(scene).system
    structure, theta = flatten_system(system)
    return system, program_for(observe, structure).compute(theta, 0.0, assembled(system))


def accelerations(scene, body="body"):
    """Linear and angular acceleration of a body at the start."""
    system, found = seen(scene)
    i = list(system.bodies).index(body)
    return np.concatenate([found.acceleration[i], found.angular_acceleration[i]])


TURNED = np.array([0.8, -0.3, 0.4, 0.2]) / 0.93**0.5


def spun(joints, **bodies):
    """A body in general position that falls and turns on its joints with the ground."""
    points = {"left": (-0.1, 0.03, 0.0), "post": (-0.05, 0.1, 0.02), "over": (0.0, 0.2, 0.1)}
    body = sj.Body(
        1.3,
        (0.002, 0.004, 0.005),
        position=(0.1, 0.02, -0.03),
        quaternion=TURNED,
        velocity=(0.1, 0.2, 0.3),
        angular_velocity=(1.0, 2.0, 3.0),
        points=points,
    )
    return sj.Scene({"body": body, **bodies}, joints, drift=sj.solvers.Projection())


PAIR, AT, ALONG = ("ground", "body"), (0.0, 0.05, 0.0), (1.0, 1.0, 0.5)
STILL = sj.functions.Linear(0.0)
LEFT = np.array([0.1, 0.02, -0.03]) + rotation_matrix(jnp.array(TURNED)) @ np.array([-0.1, 0.03, 0.0])
EQUIVALENT = {
    "revolute": (
        {"r": sj.Revolute(PAIR, AT, ALONG)},
        {"c": sj.Cylindrical(PAIR, AT, ALONG), "stop": sj.TranslationDriver(PAIR, AT, ALONG, STILL)},
    ),
    "prismatic": (
        {"p": sj.Prismatic(PAIR, AT, ALONG)},
        {"c": sj.Cylindrical(PAIR, AT, ALONG), "stop": sj.RotationDriver(PAIR, ALONG, STILL)},
    ),
    "fixed": (
        {"f": sj.Fixed(PAIR, AT)},
        {"r": sj.Revolute(PAIR, AT, ALONG), "stop": sj.RotationDriver(PAIR, ALONG, STILL)},
    ),
    "orientation and place": (
        {"o": sj.joints.SameOrientation(PAIR, AT), "s": sj.Spherical("ground.left", "body.left")},
        {"f": sj.Fixed(PAIR, LEFT)},
    ),
    "parallel axes and place": (
        {"p": sj.joints.ParallelAxes(PAIR, AT, ALONG), "s": sj.Spherical("ground.left", "body.left")},
        {"r": sj.Revolute(PAIR, LEFT, ALONG)},
    ),
    "perpendicular axes and place": (
        {
            "p": sj.joints.PerpendicularAxes(PAIR, AT, ALONG, (1.0, -1.0, 0.0)),
            "s": sj.Spherical("ground.left", "body.left"),
        },
        {"u": sj.Universal(PAIR, LEFT, ALONG, (1.0, -1.0, 0.0))},
    ),
    "line": (
        {"l": sj.joints.PointOnCurve("body.left", sj.joints.Line(AT, ALONG))},
        {
            "one": sj.joints.PointOnPlane("body.left", AT, (1.0, -1.0, 0.0)),
            "other": sj.joints.PointOnPlane("body.left", AT, (1.0, 1.0, -4.0)),
        },
    ),
    "circle": (
        {"c": sj.joints.PointOnCurve("body.left", sj.joints.Circle(AT, ALONG, 0.2))},
        {"r": sj.joints.PointOnPlane("body.left", AT, ALONG), "d": sj.joints.Distance("ground.at", "body.left", 0.2)},
    ),
    "three drivers": (
        {
            "p": sj.joints.PositionDriver(
                "body.left", lambda t: jnp.asarray(LEFT) + jnp.stack([t * t, jnp.sin(t), jnp.expm1(t)])
            )
        },
        {
            "x": sj.TranslationDriver(PAIR, "body.left", (1.0, 0.0, 0.0), lambda t: t * t),
            "y": sj.TranslationDriver(PAIR, "body.left", Y, jnp.sin),
            "z": sj.TranslationDriver(PAIR, "body.left", Z, jnp.expm1),
        },
    ),
}


@pytest.mark.parametrize("name", EQUIVALENT)
def test_equivalent_joints_move_alike(name):
    """The same accelerations at the same state: the same motion."""
    points = {"at": AT, "left": LEFT}
    first, second = (
        accelerations(sj.Scene(spun(joints).bodies, joints, ground_points=points)) for joints in EQUIVALENT[name]
    )
    assert np.abs(first).max() > 1.0 or name in ("fixed", "orientation and place")
    assert first == pytest.approx(second, abs=1e-9)


def test_universal_joint_is_a_cross_without_mass():
    """Two revolutes on a cross: the difference is of the size of the cross."""

    def with_cross(mass):
        cross = sj.Body(mass, mass * 1e-3 * np.ones(3), position=AT)
        joints = {"first": sj.Revolute(("ground", "cross"), AT, Y), "second": sj.Revolute(("cross", "body"), AT, Z)}
        return accelerations(spun(joints, cross=cross))

    limit = accelerations(spun({"u": sj.Universal(PAIR, AT, Y, Z)}))
    errors = [np.abs(with_cross(mass) - limit).max() for mass in (1e-2, 1e-3, 1e-4)]
    assert 1e-4 < errors[1] < 1.0
    assert errors[0] / errors[1] == pytest.approx(10.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(10.0, rel=0.02)


def test_fixed_bodies_are_one():
    """Two halves that are fixed to each other move like the whole."""
    spin = np.array([0.3, 3.0, 0.6])
    pivot = sj.Revolute(PAIR, (0.0, 0.0, 0.0), spin)

    def moving(x):
        return {"angular_velocity": spin, "velocity": np.cross(spin, [x, 0.0, 0.0])}

    halves = {name: block(x, **moving(x)) for name, x in (("body", 0.1), ("other", 0.3))}
    system, found = seen(sj.Scene(halves, {"pivot": pivot, "weld": sj.Fixed(("body", "other"), "body.right")}))
    inertia = 2 * np.array([0.002, 0.004 + 0.01, 0.005 + 0.01])
    whole = sj.Scene({"body": sj.Body(2.0, inertia, position=(0.2, 0.0, 0.0), **moving(0.2))}, {"pivot": pivot})
    assert found.acceleration.mean(0) == pytest.approx(accelerations(whole)[:3], abs=1e-9)
    # The weld carries the far half: its force is what the half's motion asks for.
    asked = found.acceleration[list(system.bodies).index("other")] + np.array([0.0, 0.0, 9.81])
    assert found.reactions["weld"].force == pytest.approx(asked, abs=1e-9)


# Massless parts ------------------------------------------------------------------------------------------------------


def hanging(link_joints, **bodies):
    """A block that hangs by its left end from a link of 0.3 m, and slides with its right end on a wall."""
    joints = {"wall": sj.joints.PointOnPlane("body.right", (0.5, 0.0, 0.0), (1.0, 0.2, 0.0)), **link_joints}
    body = block(0.4, velocity=(0.0, 0.3, 0.4))
    pegs = {"peg": (0.0, 0.0, 0.0)}
    return sj.Scene({"body": body, **bodies}, joints, ground_points=pegs, drift=sj.solvers.Projection())


def link(mass):
    """A slender link from the peg to the block, 0.3 m."""
    ends = {"start": (-0.15, 0.0, 0.0), "end": (0.15, 0.0, 0.0)}
    across = mass * 0.09 / 12
    return sj.Body(mass, (across / 10, across, across), position=(0.15, 0.0, 0.0), points=ends)


MASSLESS = {
    "rod": (
        {"link": sj.joints.Distance("ground.peg", "body.left")},
        {"one": sj.Spherical("ground.peg", "link.start"), "link": sj.Spherical("link.end", "body.left")},
    ),
    "arm": (
        {"link": sj.joints.PointOnCurve("body.left", sj.joints.Circle((0.0, 0.0, 0.0), Y, 0.3))},
        {"one": sj.Revolute(("ground", "link"), "ground.peg", Y), "link": sj.Spherical("link.end", "body.left")},
    ),
}


@pytest.mark.parametrize("name", MASSLESS)
def test_massless_link_is_the_limit_of_a_light_one(name):
    massless, light = MASSLESS[name]
    limit = accelerations(hanging(massless))
    force = seen(hanging(massless))[1].reactions["link"].force
    errors, force_errors = [], []
    for mass in (1e-2, 1e-3):
        scene = hanging(light, link=link(mass))
        errors.append(np.abs(accelerations(scene) - limit).max())
        force_errors.append(np.abs(seen(scene)[1].reactions["link"].force - force).max())
    assert np.abs(force).max() > 1.0
    assert 1e-4 < errors[1] < 1.0
    assert errors[0] / errors[1] == pytest.approx(10.0, rel=0.2)
    assert force_errors[0] / force_errors[1] == pytest.approx(10.0, rel=0.2)


def test_motion_of_a_massless_rod_is_the_limit_of_a_light_one():
    massless, light = MASSLESS["rod"]
    limit = np.asarray(run_of(hanging(massless)).position("body"))
    runs = [run_of(hanging(light, link=link(mass))) for mass in (1e-2, 1e-3)]
    errors = [np.abs(np.asarray(run.position("body")) - limit).max() for run in runs]
    assert np.ptp(limit, axis=0).max() > 0.04
    assert 1e-7 < errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(10.0, rel=0.2)


def test_a_massless_body_is_refused_with_remedies():
    with pytest.raises(sj.SceneError, match=r"mass = 0.*Distance.*PointOnCurve.*Circle.*small mass"):
        sj.equations.compile_scene(sj.Scene({"rod": sj.Body(0.0, (1.0, 1.0, 1.0))}))
