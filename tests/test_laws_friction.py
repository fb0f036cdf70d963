"""Friction laws: their curves, zero sliding, and LuGre's memory."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from spherejax.foundations.checks import enforce
from spherejax.foundations.errors import SceneError
from spherejax.physics.laws.friction import (
    Ambrosio,
    BengisuAkay,
    BrownMcPhee,
    Coulomb,
    LuGre,
    Threlfall,
)

LAWS = [Threlfall(), BengisuAkay(), Ambrosio(), BrownMcPhee()]
MU_K, MU_S, V0, V1, VS, KAPPA = 0.1, 0.15, 1e-4, 1e-3, 1e-3, 1000.0  # Table 3 of the paper
SLOPES = [MU_K / V1, 2 * MU_S / V0, 0.0, (4 * MU_K + 16 / 9 * (MU_S - MU_K)) / VS]
SPEEDS = np.concatenate([np.geomspace(1e-9, 1.0, 60), [V0, V1, 0.5 * V0, 3e-4]])
NORMAL_FORCE = 20e3
pairs = pytest.mark.parametrize(
    ("law", "slope"), list(zip(LAWS, SLOPES, strict=True)), ids=[type(law).__name__ for law in LAWS]
)


def printed(law, v):
    """The paper's Eqs. 32, 33, 35 and 36, per newton, as printed."""
    match law:
        case Threlfall():
            return MU_K * np.tanh(v / V1)
        case BengisuAkay():
            rise = -MU_S / V0**2 * (v - V0) ** 2 + MU_S
            return np.where(v < V0, rise, MU_K + (MU_S - MU_K) * np.exp(-KAPPA * (v - V0)))
        case Ambrosio():
            return MU_K * np.clip((v - V0) / (V1 - V0), 0, 1)
        case BrownMcPhee():
            x = v / VS
            return MU_K * np.tanh(4 * x) + (MU_S - MU_K) * x / (x**2 / 4 + 3 / 4) ** 2


@pairs
def test_curves_as_printed(law, slope):
    np.testing.assert_allclose(jax.vmap(law.coefficient)(SPEEDS), printed(law, SPEEDS), rtol=1e-9, atol=1e-14 * MU_K)
    assert law.simulable
    assert law.bristle_size == 0


@pairs
def test_zero_sliding(law, slope):
    """The derivative at rest is the true one, forward, reverse and by differences in every direction."""
    zero = jnp.zeros(3)

    def traction(v):
        return law.traction(v, NORMAL_FORCE)

    np.testing.assert_array_equal(traction(zero), 0.0)
    scale = NORMAL_FORCE * MU_S / V0
    expected = -NORMAL_FORCE * slope * np.eye(3)
    np.testing.assert_allclose(jax.jacfwd(traction)(zero), expected, atol=1e-14 * scale)
    np.testing.assert_allclose(jax.jacrev(traction)(zero), expected, atol=1e-14 * scale)
    step = 1e-6 * V0
    for direction in np.array([[1.0, 0, 0], [0.6, -0.8, 0]]):
        np.testing.assert_allclose(traction(step * direction) / step, expected @ direction, atol=1e-6 * scale)
    np.testing.assert_allclose(law.secant(0.0), slope, rtol=1e-15)
    assert np.isfinite(jax.hessian(lambda v: traction(v).sum())(zero)).all()


@pairs
@pytest.mark.parametrize("speed", [1e-12, 5e-5, 3e-4, 5e-3, 1.0, 1e3])
def test_derivatives_agree(law, slope, speed):
    v = speed * jnp.array([2.0, -3.0, 6.0]) / 7

    def traction(v):
        return law.traction(v, NORMAL_FORCE)

    forward, reverse = jax.jacfwd(traction)(v), jax.jacrev(traction)(v)
    step = 1e-5 * speed
    differences = np.array([(traction(v + h) - traction(v - h)) / (2 * step) for h in step * np.eye(3)]).T
    scale = max(np.abs(forward).max(), NORMAL_FORCE * MU_S / max(speed, V0))
    np.testing.assert_allclose(forward, reverse, atol=1e-14 * scale)
    np.testing.assert_allclose(forward, differences, atol=1e-7 * scale)
    parameters = jax.grad(lambda law: law.traction(v, NORMAL_FORCE)[0])(law)
    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(parameters))


@pairs
def test_opposes_sliding(law, slope):
    v = jnp.array([2.0, -3.0, 6.0]) * 1e-3
    f = law.traction(v, NORMAL_FORCE)
    np.testing.assert_allclose(f / np.linalg.norm(f), -v / np.linalg.norm(v), rtol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(f), NORMAL_FORCE * law.coefficient(7e-3), rtol=1e-14)


def test_kinks_and_shape():
    law = BengisuAkay()
    assert jax.grad(law.coefficient)(V0 * (1 - 1e-9)) == pytest.approx(0.0, abs=1e-6 * MU_S / V0)
    assert jax.grad(law.coefficient)(V0) == pytest.approx(-KAPPA * (MU_S - MU_K), rel=1e-12)
    steep = BengisuAkay(kappa=1e9)
    assert np.isfinite(jax.grad(steep.coefficient)(1e-9))  # exp(1e5) in the branch not taken
    assert jax.grad(Ambrosio().coefficient)(V0) == 0.0
    assert jax.grad(Ambrosio().coefficient)(V1) == pytest.approx(0.0, abs=1e-12 * MU_K / V1)
    stribeck = BrownMcPhee(mu_kinetic=0.0)  # its second term alone
    assert stribeck.coefficient(VS) == pytest.approx(MU_S, rel=1e-14)
    assert jax.grad(stribeck.coefficient)(VS) == pytest.approx(0.0, abs=1e-12 * MU_S / VS)
    assert Threlfall().coefficient(V1) == pytest.approx(0.76 * MU_K, rel=3e-3)


def test_coulomb_is_a_curve_and_no_joint_law():
    law = Coulomb(0.1)
    np.testing.assert_allclose(jax.vmap(law.coefficient)(SPEEDS), 0.1, rtol=1e-15)
    assert law.coefficient(0.0) == 0.0
    assert not Coulomb.simulable
    with pytest.raises(
        SceneError, match=r"jumps at zero sliding.*Threlfall.*BengisuAkay, Ambrosio, BrownMcPhee or LuGre"
    ):
        enforce("joint 'a'", law.requirements())


def test_requirements():
    for law in (*LAWS, LuGre(), Threlfall(mu=0.0), BrownMcPhee(0.1, 0.1)):
        assert enforce("here", law.requirements()) == []
    for law, field in (
        (Threlfall(mu=-0.1), "mu"),
        (Threlfall(mu=np.nan), "mu"),
        (Threlfall(v1=0.0), "v1"),
        (BengisuAkay(mu_static=0.05), "mu_static"),
        (BengisuAkay(v0=0.0), "v0"),
        (BengisuAkay(kappa=np.inf), "kappa"),
        (Ambrosio(v0=1e-3, v1=1e-3), "v1"),
        (Ambrosio(v0=0.0), "v0"),
        (BrownMcPhee(mu_static=np.nan), "mu_static"),
        (BrownMcPhee(stribeck_velocity=-1.0), "stribeck_velocity"),
        (LuGre(mu_kinetic=0.0), "mu_kinetic"),
        (LuGre(bristle_stiffness=0.0), "bristle_stiffness"),
        (LuGre(bristle_damping=-1.0), "bristle_damping"),
        (LuGre(viscous=np.inf), "viscous"),
    ):
        with pytest.raises(SceneError, match=rf": {field} = "):
            enforce("here", law.requirements())


def test_lugre_steady_state_is_the_stribeck_curve():
    law = LuGre(viscous=0.3)
    direction = jnp.array([0.6, -0.8, 0.0])
    for speed in (1e-5, 1e-3, 3e-3, 0.1):
        g = MU_K + (MU_S - MU_K) * np.exp(-((speed / VS) ** 2))
        bristle = g / law.bristle_stiffness * direction
        np.testing.assert_allclose(law.bristle_rate(bristle, speed * direction), 0.0, atol=1e-15 * speed * 10)
        f = law.bristle_traction(bristle, speed * direction, NORMAL_FORCE)
        np.testing.assert_allclose(f, -NORMAL_FORCE * (g + 0.3 * speed) * direction, rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(law.coefficient(speed), g + 0.3 * speed, rtol=1e-13)
    assert law.coefficient(0.0) == 0.0


def test_lugre_reaches_the_steady_state_from_rest():
    law, v = LuGre(), jnp.array([0.01, 0.0, 0.0])
    rate = jax.jit(lambda z: law.bristle_rate(z, v))
    run = solve_ivp(lambda t, z: rate(z), (0, 1e-2), np.zeros(3), "Radau", rtol=1e-10, atol=1e-18)
    f = law.bristle_traction(run.y[:, -1], v, NORMAL_FORCE)
    np.testing.assert_allclose(f[0], -NORMAL_FORCE * law.coefficient(0.01), rtol=1e-8)


def test_lugre_is_a_spring_before_it_slips():
    law = LuGre(bristle_damping=0.0)
    np.testing.assert_allclose(law.bristle_traction(jnp.array([1e-8, 0, 0]), jnp.zeros(3), 2.0)[0], -2e-3)


def test_lugre_at_rest_and_derivatives():
    law = LuGre()
    z = jnp.array([3e-7, -2e-7, 1e-7])
    zero = jnp.zeros(3)
    np.testing.assert_array_equal(law.bristle_rate(z, zero), 0.0)
    for jacobian in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(jacobian(law.bristle_rate, 1)(z, zero), np.eye(3), atol=1e-15)
        assert np.isfinite(jacobian(law.bristle_traction, 1)(z, zero, NORMAL_FORCE)).all()
    step = 1e-9
    one_sided = (law.bristle_rate(z, jnp.array([step, 0, 0])) - law.bristle_rate(z, zero)) / step
    expected = np.array([1.0, 0, 0]) - law.bristle_stiffness / MU_S * z
    np.testing.assert_allclose(one_sided, expected, atol=1e-5)
    v = jnp.array([5e-4, 2e-4, -3e-4])
    forward = jax.jacfwd(law.bristle_traction, (0, 1))(z, v, NORMAL_FORCE)
    reverse = jax.jacrev(law.bristle_traction, (0, 1))(z, v, NORMAL_FORCE)
    for a, b, index, step in zip(forward, reverse, (0, 1), (1e-12, 1e-9), strict=True):

        def shifted(h, index=index):
            return law.bristle_traction(*(x + h * (i == index) for i, x in enumerate((z, v))), NORMAL_FORCE)

        differences = np.array([(shifted(h) - shifted(-h)) / (2 * step) for h in step * np.eye(3)]).T
        np.testing.assert_allclose(a, b, atol=1e-13 * np.abs(a).max())
        np.testing.assert_allclose(a, differences, atol=1e-6 * np.abs(a).max())


def test_lugre_never_feeds_energy():
    """Dissipated minus stored power is not negative for any state, which a constant damping violates."""
    law = LuGre()
    key = np.random.default_rng(0)
    z = key.normal(size=(4000, 3)) * 1e-6
    v = key.normal(size=(4000, 3)) * np.geomspace(1e-6, 1.0, 4000)[:, None]

    def dissipation(law, z, v):
        stored = law.bristle_stiffness * z @ law.bristle_rate(z, v)
        return -law.bristle_traction(z, v, 1.0) @ v - stored

    assert jax.vmap(lambda z, v: dissipation(law, z, v))(z, v).min() >= 0
    assert law.bristle_damping * VS <= 9 * MU_K
    excessive = LuGre(bristle_damping=100 * 9 * MU_K / VS)
    assert jax.vmap(lambda z, v: dissipation(excessive, z, v))(z, v).min() < 0


ALONG = np.array([1.0, 0.0, 0.0])


@pytest.mark.parametrize("static_over_kinetic", [1.2, 1.5, 3.0])
@pytest.mark.parametrize("viscous", [0.0, 3.0])
def test_lugre_is_refused_where_it_feeds_energy(static_over_kinetic, viscous):
    """The bound is sharp: at reachable states, found by brute force, the power changes its sign where it says."""

    def law(damping):
        return LuGre(MU_K, static_over_kinetic * MU_K, VS, bristle_damping=damping, viscous=viscous)

    bound = brentq(lambda damping: float(law(damping).passivity_margin()), 1.0, 1e6)
    assert bound > 9 * MU_K / VS
    for share, feeds in ((0.99, False), (1.01, True)):
        friction = law(share * bound)
        speed, stretch = np.meshgrid(np.linspace(0.01, 4.0, 400) * VS, np.linspace(0.0, 1.0, 401))
        z = stretch.ravel() * static_over_kinetic * MU_K / friction.bristle_stiffness

        def power(z, v, friction=friction):
            rate = friction.bristle_rate(z * ALONG, v * ALONG)
            stored = friction.bristle_stiffness * z * rate[0]
            return -friction.bristle_traction(z * ALONG, v * ALONG, 1.0)[0] * v - stored

        lowest = jax.vmap(power)(z, speed.ravel()).min()
        assert (lowest < -1e-9 * MU_K * VS) == feeds
    enforce("here", law(0.99 * bound).requirements())
    with pytest.raises(SceneError, match=r"bristle_damping = .*never feeds energy.*9 mu_kinetic"):
        enforce("here", law(1.01 * bound).requirements())


def test_lugre_without_stribeck_effect_is_passive_whatever_its_damping():
    assert LuGre(0.1, 0.1, bristle_damping=1e9).passivity_margin() >= 0


def test_lugre_is_judged_under_jit():
    margin = jax.jit(lambda damping: LuGre(bristle_damping=damping).passivity_margin())
    assert margin(316.0) > 0 > margin(1e5)


def test_a_rising_normal_force_feeds_lugre_no_more_than_documented():
    """Stretch bristles under a small load, press, release: the work of friction by quadrature of the law itself."""
    law = LuGre(bristle_damping=0.0)
    small, large, speed = 10.0, 100.0, 1e-7
    taken, z = 0.0, jnp.zeros(3)
    step, advance = 2.5e-9 / speed, jax.jit(lambda z, v, h: z + h * law.bristle_rate(z, v))
    for force, sign in ((small, 1.0), (large, -1.0)):
        for _ in range(400):
            v = jnp.array([sign * speed, 0.0, 0.0])
            taken -= float(law.bristle_traction(z, v, force) @ v) * step
            z = advance(z, v, step)
    fed = float(law.bristle_energy(z, large)) - taken
    allowed = (large - small) * MU_S**2 / (2 * law.bristle_stiffness)
    assert 0.05 * allowed < fed < allowed
