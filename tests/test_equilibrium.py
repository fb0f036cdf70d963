"""Static equilibrium: check values of the suspension, closed forms, derivatives, and what has no rest."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj


def hanging(stiffness, x=0.0, starts_concentric=False, **options):
    """2 kg on a bushing."""
    body = sj.Body(2.0, (1e-2,) * 3, position=(x, 0.0, 0.0), points={"ball": (0.0, 0.0, 0.0)})
    model = sj.Bushing(law=sj.VectorElastomer(stiffness, 1e-3))
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
