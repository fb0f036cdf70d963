"""Static equilibrium: check values of the suspension, closed forms, derivatives, and what has no rest."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.system import flatten_system
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration.problem import initial_state
from spherejax.motion.start.equilibrium import rest_conditions
from spherejax.motion.start.start_now import start_now


def hanging(stiffness, x=0.0, starts_concentric=False, **options):
    """2 kg on a bushing."""
    body = sj.Body(2.0, (1e-2,) * 3, position=(x, 0.0, 0.0), points={"ball": (0.0, 0.0, 0.0)})
    model = sj.Bushing(law=sj.laws.VectorElastomer(stiffness, 1e-3))
    joint = sj.Spherical("ground.socket", "body.ball", model, starts_concentric)
    return sj.Scene({"body": body}, {"joint": joint}, ground_points={"socket": (0.0, 0.0, 0.0)}, **options)


def pendulum(angle):
    place = (0.5 * np.sin(angle), 0.0, -0.5 * np.cos(angle))
    body = sj.Body(1.0, (1e-2,) * 3, position=place)
    return sj.Scene({"bob": body}, {"pivot": sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))})


def test_the_suspension_at_rest():
    found = sj.equilibrium(sj.gallery.suspension())
    assert found.residual < 1e-12
    run = sj.simulate(found.scene, jnp.array([0.0, 1.0, 2.9]), throw=True)
    assert np.ptp(run.position("wheel")[:, 2]) < 1e-12
    assert run.position("wheel")[0, 2] == pytest.approx(0.355937, abs=5e-7)
    assert run.force("tyre")["load"][0] == pytest.approx(3363.8, abs=0.05)
    assert run.force("leaf")["force"][0] == pytest.approx(2726.2, abs=0.05)
    assert run.force("shock")["length"][0] == pytest.approx(0.440594, abs=5e-7)
    assert float(jnp.linalg.norm(run.reaction("wheel_a_arm")[0])) == pytest.approx(1242, abs=0.5)


def test_a_bushing_yields_by_weight_over_stiffness():
    found = sj.equilibrium(hanging(1e4, x=0.3))
    np.testing.assert_allclose(found.scene.bodies["body"].position, [0.0, 0.0, -2.0 * 9.81 / 1e4], atol=1e-12)


def test_a_bushing_that_is_pressed_stays_so():
    found = sj.equilibrium(hanging(1e4, x=0.3, starts_concentric=True))
    run = sj.simulate(found.scene, jnp.linspace(0.0, 0.1, 3)).require_success()
    np.testing.assert_allclose(run.position("body"), np.tile(found.scene.bodies["body"].position, (3, 1)), atol=1e-10)
    np.testing.assert_allclose(np.abs(run.reaction("joint"))[:, 2], 2.0 * 9.81, rtol=1e-6)


def test_higher_derivatives_by_a_number():
    """z = -m g / k: its second and third derivatives are -2 m g / k^3 and 6 m g / k^4; they were zero, or half."""

    def rest(k):
        return sj.equilibrium(hanging(k)).scene.bodies["body"].position[2]

    second = jax.jit(jax.jacfwd(jax.jacfwd(rest)))(1e4)
    assert second == pytest.approx(-2 * 2.0 * 9.81 / 1e12, rel=1e-8)
    third = jax.jit(jax.jacfwd(jax.jacfwd(jax.jacfwd(rest))))(1e4)
    assert third == pytest.approx(6 * 2.0 * 9.81 / 1e16, rel=1e-6)


@pytest.mark.parametrize("transform", [jax.grad, jax.jacfwd])
def test_the_derivative_by_a_number(transform):
    """z = -m g / k, dz/dk = m g / k^2."""
    slope = transform(lambda k: sj.equilibrium(hanging(k)).scene.bodies["body"].position[2])(1e4)
    assert slope == pytest.approx(2.0 * 9.81 / 1e8, rel=1e-9)


def test_a_pendulum_comes_to_hang():
    found = sj.equilibrium(pendulum(1.0))
    np.testing.assert_allclose(found.scene.bodies["bob"].position, [0.0, 0.0, -0.5], atol=1e-9)


def test_a_falling_body_has_no_rest():
    with pytest.raises(sj.SceneError, match="no rest position was found"):
        sj.equilibrium(sj.Scene({"stone": sj.Body(1.0, (1e-2,) * 3)}))


def test_a_ball_in_a_clearance_has_no_place():
    with pytest.raises(sj.SceneError, match="'wheel_a_arm' has a clearance"):
        sj.equilibrium(sj.gallery.suspension(sj.Dry(1e-4)))


# Starting from rest --------------------------------------------------------------------------------------------------

Y, Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
RUBBER = {"radial_stiffness": 4e3, "axial_stiffness": 3e3, "damping": 1e-3}
SIX = sj.Bushing(law=sj.laws.MatrixElastomer.cylindrical(Y, **RUBBER, conical_stiffness=80.0, torsional_stiffness=40.0))
HINGE = sj.Bushing(law=sj.laws.HingeElastomer.symmetric(**RUBBER, conical_stiffness=80.0))
SLIDING = sj.Bushing(law=sj.laws.HingeElastomer.symmetric(**{**RUBBER, "axial_stiffness": 0.0}, conical_stiffness=80.0))
CROSS = sj.Bushing(law=sj.laws.CrossElastomer(4e3 * np.eye(3), 4.0 * np.eye(3), 80.0))
PAIR, AT = ("ground", "body"), (0.0, 0.0, 0.0)
LOADED = {
    "mount": lambda: sj.Spherical("ground.pivot", "body.pivot", SIX),
    "revolute": lambda: sj.Revolute(PAIR, AT, Y, HINGE),
    "cylindrical": lambda: sj.Cylindrical(PAIR, AT, Y, SLIDING),
    "prismatic": lambda: sj.Prismatic(PAIR, AT, Y, SIX),
    "universal": lambda: sj.Universal(PAIR, AT, Y, (1.0, 0.0, 0.0), CROSS),
    "fixed": lambda: sj.Fixed(PAIR, AT, SIX),
    "fixed by name": lambda: sj.Fixed(PAIR, "body.pivot", SIX),
    "ideal": lambda: sj.Revolute(PAIR, AT, Y),
}


def loaded(joint):
    """An arm on a joint, and a weight that hangs askew from its end: points and axes are given in the world."""
    place = (0.02, 0.05, -0.1)
    arm = sj.Body(1.0, (1e-2,) * 3, position=place, points={"pivot": tuple(-x for x in place)})
    weight = sj.Body(0.5, (1e-3,) * 3, position=(0.07, 0.05, -0.28))
    joints = {"joint": joint, "hinge": sj.Revolute(("body", "weight"), (0.05, 0.05, -0.2), (0.1, 1.0, 0.0))}
    spring = sj.TorsionalSpring(("body", "weight"), (0.1, 1.0, 0.0), 2.0, 0.1)
    return sj.Scene({"body": arm, "weight": weight}, joints, {"coil": spring}, ground_points={"pivot": AT})


def accelerations(scene):
    """With which a run of the scene begins."""
    system = sj.equations.compile_scene(scene).system
    start = start_now(system, np.zeros(1))
    assert start is not None
    y = initial_state(system, start)
    structure, numbers = flatten_system(system)
    return program_for(rest_conditions, structure).compute(numbers, 0.0, y)[0]


@pytest.mark.parametrize("name", LOADED)
def test_what_is_found_is_at_rest_whatever_the_joint(name, tmp_path):
    scene = loaded(LOADED[name]())
    assert np.abs(accelerations(scene)).max() > 1.0
    found = sj.equilibrium(scene)
    assert np.abs(found.scene.bodies["weight"].position - scene.bodies["weight"].position).max() > 1e-3
    assert np.abs(accelerations(found.scene)).max() < 1e-8
    again = sj.equilibrium(found.scene).scene
    np.testing.assert_allclose(again.bodies["weight"].position, found.scene.bodies["weight"].position, atol=1e-12)
    # A file keeps it.
    read = sj.load_scene(sj.save_scene(found.scene, tmp_path / "rest.toml"))
    assert np.array_equal(accelerations(read), accelerations(found.scene))


def test_rest_is_kept_in_time():
    found = sj.equilibrium(loaded(LOADED["revolute"]()))
    run = sj.simulate(found.scene, jnp.linspace(0.0, 0.1, 3), solver=diffrax.Dopri8()).require_success()
    for name in ("body", "weight"):
        assert np.abs(run.position(name) - found.scene.bodies[name].position).max() < 1e-9
