"""Elastomers: linear limits, energy, axes, and the nonlinear curve against SciPy's PCHIP."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import PchipInterpolator
from scipy.linalg import expm

from spherejax.foundations.checks import enforce
from spherejax.foundations.errors import SceneError
from spherejax.physics.laws.elastomer import RadialElastomer, VectorElastomer
from spherejax.physics.laws.elastomer_curve import CurveElastomer
from spherejax.physics.laws.elastomer_matrix import MatrixElastomer

K, B = 1e6, 1e-2  # N/m, s: the paper's bushing
POINTS = np.array([0.2e-3, 0.5e-3, 0.6e-3, 1.2e-3])  # m
FORCES = np.array([150.0, 600.0, 900.0, 3000.0])  # N
CURVE = CurveElastomer(POINTS, FORCES, B)
CYLINDER = MatrixElastomer.cylindrical(
    jnp.array([1.0, 2.0, 2.0]),
    radial_stiffness=1e6,
    axial_stiffness=3e5,
    conical_stiffness=80.0,
    torsional_stiffness=20.0,
    damping=1e-3,
)
ISOTROPIC = MatrixElastomer(K * np.eye(3), K * B * np.eye(3), 50.0 * np.eye(3), 0.2 * np.eye(3))
ALL = [RadialElastomer(K, B), VectorElastomer(K, B), ISOTROPIC, CYLINDER, CURVE]
names = pytest.mark.parametrize("law", ALL, ids=["radial", "vector", "isotropic", "cylinder", "curve"])

E = 7e-4 * jnp.array([2.0, -3.0, 6.0]) / 7
RATE = jnp.array([0.02, -0.01, 0.03])
ZERO = jnp.zeros(3)


@names
def test_elastic_force_derives_from_the_energy(law):
    gradient = jax.grad(law.elastic_energy)(E, ZERO)
    force = law.force(E, ZERO)
    np.testing.assert_allclose(force, -gradient, atol=1e-12 * np.abs(force).max())
    assert law.elastic_energy(ZERO, ZERO) == 0.0
    np.testing.assert_array_equal(jax.grad(law.elastic_energy)(ZERO, ZERO), 0.0)


@names
@pytest.mark.parametrize("length", [1e-12, 1e-6, 1e-4, 3e-4, 2e-3])
def test_derivatives_agree(law, length):
    e = length * jnp.array([2.0, -3.0, 6.0]) / 7
    forward = jax.jacfwd(law.force, (0, 1))(e, RATE)
    reverse = jax.jacrev(law.force, (0, 1))(e, RATE)
    step = 1e-5 * length
    differences = np.array([(law.force(e + h, RATE) - law.force(e - h, RATE)) / (2 * step) for h in step * np.eye(3)])
    scale = np.abs(forward[0]).max()
    for a, b in zip(forward, reverse, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-13 * np.abs(a).max())
    rounding = 1e-15 * np.abs(law.force(e, RATE)).max() / step
    np.testing.assert_allclose(forward[0], differences.T, atol=1e-7 * scale + rounding)


@names
def test_concentric(law):
    np.testing.assert_array_equal(law.force(ZERO, ZERO), 0.0)
    for jacobian in (jax.jacfwd, jax.jacrev):
        by_e, by_rate = jacobian(law.force, (0, 1))(ZERO, RATE)
        assert np.isfinite(by_e).all()
        assert np.isfinite(by_rate).all()
    stiffness = {RadialElastomer: K, VectorElastomer: K, CurveElastomer: FORCES[0] / POINTS[0]}.get(type(law))
    if stiffness is not None:
        np.testing.assert_allclose(law.force(ZERO, RATE), -stiffness * B * RATE, rtol=1e-13)
        by_e = jax.jacfwd(law.force)(ZERO, ZERO)
        np.testing.assert_allclose(by_e, -stiffness * np.eye(3), atol=1e-12 * stiffness)


@names
def test_damping_never_feeds_energy(law):
    key = np.random.default_rng(2)
    e, rate, theta, omega = key.normal(size=(4, 300, 3)) * np.array([1e-3, 0.1, 1.0, 3.0])[:, None, None]
    damped = jax.vmap(law.force)(e, rate) - jax.vmap(law.force)(e, np.zeros_like(e))
    assert np.einsum("ij,ij->i", damped, rate).max() <= 0
    damped = jax.vmap(law.moment)(theta, omega) - jax.vmap(law.moment)(theta, np.zeros_like(theta))
    assert np.einsum("ij,ij->i", damped, omega).max() <= 0


def test_radial_law_as_printed():
    law = RadialElastomer(K, B)
    n = E / jnp.linalg.norm(E)
    expected = -K * (np.linalg.norm(E) + B * (n @ RATE)) * n
    np.testing.assert_allclose(law.force(E, RATE), expected, atol=1e-12 * np.abs(expected).max())
    across = jnp.cross(n, RATE)
    np.testing.assert_allclose(law.force(E, across), -K * E, atol=1e-10 * K * 7e-4)


def test_linear_laws_agree_for_radial_motion():
    radial_rate = 30.0 * E
    expected = RadialElastomer(K, B).force(E, radial_rate)
    line = CurveElastomer(np.array([1e-3]), np.array([1e-3 * K]), B)
    for law in (VectorElastomer(K, B), ISOTROPIC, line):
        np.testing.assert_allclose(law.force(E, radial_rate), expected, rtol=1e-11)
    for rate in (RATE, ZERO):
        np.testing.assert_allclose(line.force(3 * E, rate), VectorElastomer(K, B).force(3 * E, rate), rtol=1e-11)


def test_matrix_as_written():
    m = np.array([[3.0, 1.0, 0.5], [1.0, 4.0, 0.2], [0.5, 0.2, 5.0]])
    law = MatrixElastomer(1e5 * m, 10.0 * m)
    np.testing.assert_allclose(law.force(E, RATE), -(1e5 * m @ E + 10 * m @ RATE), rtol=1e-13)
    assert not law.resists_rotation
    np.testing.assert_array_equal(law.moment(E, RATE), 0.0)
    nested = MatrixElastomer((1e5 * m).tolist(), (10 * m).tolist())
    np.testing.assert_allclose(nested.force(E, RATE), law.force(E, RATE), rtol=1e-13)
    assert enforce("here", nested.requirements()) == []


def test_cylinder_has_four_stiffnesses():
    axis = jnp.array([1.0, 2.0, 2.0]) / 3
    across = jnp.array([2.0, -1.0, 0.0]) / np.sqrt(5)
    for direction, k, k_r in ((axis, 3e5, 20.0), (across, 1e6, 80.0)):
        np.testing.assert_allclose(CYLINDER.force(1e-3 * direction, ZERO), -k * 1e-3 * direction, atol=1e-10 * k)
        np.testing.assert_allclose(CYLINDER.force(ZERO, direction), -1e-3 * k * direction, atol=1e-12 * k)
        np.testing.assert_allclose(CYLINDER.moment(0.1 * direction, ZERO), -k_r * 0.1 * direction, atol=1e-13 * k_r)
        np.testing.assert_allclose(CYLINDER.moment(ZERO, direction), -1e-3 * k_r * direction, atol=1e-14 * k_r)
    assert CYLINDER.resists_rotation
    assert not CYLINDER.isotropic


def rotation_vector_rate(theta, omega, step=1e-4):
    """Rate of the rotation vector of R(t), dR/dt = [omega]R, by differences of logarithms."""

    def cross(a):
        return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])

    def logarithm(rotation):
        skew = rotation - rotation.T
        vector = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
        sine = np.linalg.norm(vector) / 2
        return vector / (2 * sine) * np.arctan2(sine, (np.trace(rotation) - 1) / 2)

    rotation = expm(cross(theta))
    at = lambda s: logarithm(expm(s * step * cross(omega)) @ rotation)  # noqa: E731
    return (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * step)


@pytest.mark.parametrize("angle", [1e-3, 0.3, 0.99, 1.01, 2.0, 3.0])
def test_moment_derives_from_the_energy_at_any_angle(angle):
    theta = angle * jnp.array([2.0, -3.0, 6.0]) / 7
    omega = np.array([0.5, 1.0, -0.7])
    power = CYLINDER.moment(theta, ZERO) @ omega
    energy_rate = jax.grad(CYLINDER.elastic_energy, 1)(ZERO, theta) @ rotation_vector_rate(np.array(theta), omega)
    np.testing.assert_allclose(power, -energy_rate, atol=1e-9 * 80.0 * angle)
    forward, reverse = (jacobian(CYLINDER.moment)(theta, ZERO) for jacobian in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, atol=1e-12 * 80.0)
    step = 1e-5
    differences = [
        (CYLINDER.moment(theta + h, ZERO) - CYLINDER.moment(theta - h, ZERO)) / (2 * step) for h in step * np.eye(3)
    ]
    np.testing.assert_allclose(forward, np.array(differences).T, atol=1e-7 * 80.0)


def test_moment_at_zero_and_pi_and_isotropic():
    np.testing.assert_allclose(
        jax.jacfwd(CYLINDER.moment)(ZERO, ZERO),
        -np.asarray(CYLINDER.rotational_stiffness),
        rtol=1e-13,
        atol=1e-13,
    )
    assert np.isfinite(jax.hessian(CYLINDER.moment)(ZERO, ZERO)).all()
    theta = np.pi * jnp.array([2.0, -3.0, 6.0]) / 7
    assert np.isfinite(jax.jacfwd(CYLINDER.moment)(theta, ZERO)).all()
    np.testing.assert_allclose(ISOTROPIC.moment(theta, RATE), -50 * theta - 0.2 * RATE, rtol=1e-13)


@jax.jit
def radial_force(length):
    return -CURVE.force(jnp.array([0.0, length, 0.0]), ZERO)[1]


def test_curve_is_scipys_pchip_of_the_odd_continuation():
    x = np.concatenate([-POINTS[::-1], [0.0], POINTS])
    reference = PchipInterpolator(x, np.concatenate([-FORCES[::-1], [0.0], FORCES]))
    lengths = np.linspace(0, POINTS[-1], 173)
    np.testing.assert_allclose(jax.vmap(radial_force)(lengths), reference(lengths), atol=1e-12 * FORCES[-1])
    np.testing.assert_allclose(jax.vmap(radial_force)(POINTS), FORCES, rtol=1e-12)
    slope = float(reference.derivative()(POINTS[-1]))
    np.testing.assert_allclose(radial_force(2e-3), FORCES[-1] + slope * (2e-3 - POINTS[-1]), rtol=1e-12)
    slopes = jax.vmap(jax.grad(radial_force))(lengths[1:-1])
    np.testing.assert_allclose(slopes, reference.derivative()(lengths[1:-1]), atol=1e-9 * slope)


def test_curve_energy_is_its_integral_and_it_is_isotropic():
    for length in (1e-4, 5.5e-4, 2e-3):
        knots = [p for p in POINTS if p < length] or None
        work = quad(lambda s: float(radial_force(s)), 0, length, points=knots, epsrel=1e-10)[0]
        direction = jnp.array([2.0, -3.0, 6.0]) / 7
        np.testing.assert_allclose(CURVE.elastic_energy(length * direction, ZERO), work, rtol=1e-9)
        np.testing.assert_allclose(CURVE.force(length * direction, ZERO), -radial_force(length) * direction, rtol=1e-12)


def test_curve_damping_is_the_rate_of_the_elastic_force():
    elastic_rate = jax.jvp(lambda e: CURVE.force(e, ZERO), (E,), (RATE,))[1]
    damped = CURVE.force(E, RATE) - CURVE.force(E, ZERO)
    np.testing.assert_allclose(damped, B * elastic_rate, atol=1e-10 * np.abs(damped).max())


def test_curve_is_differentiable_by_its_points_and_stays_monotone():
    @jax.jit
    def force(curve):
        return curve.force(E, RATE)[0]

    gradient = jax.grad(force)(CURVE)
    for field, step in (("forces", 1e-3), ("deflections", 1e-10)):
        values = getattr(CURVE, field)
        differences = []
        for h in step * np.eye(4):
            moved = [CurveElastomer(**(vars(CURVE) | {field: values + s * h})) for s in (1, -1)]
            differences.append((force(moved[0]) - force(moved[1])) / (2 * step))
        np.testing.assert_allclose(getattr(gradient, field), differences, atol=1e-6 * np.abs(differences).max())
    flat = CurveElastomer(np.array([1e-3, 2e-3, 3e-3]), np.array([5.0, 5.0, 100.0]), 0.0)
    values = jax.vmap(lambda s: -flat.force(jnp.array([s, 0, 0]), ZERO)[0])(np.linspace(0, 4e-3, 400))
    assert (np.diff(values) >= -1e-12).all()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(jax.grad(force)(flat)))
    softening = CurveElastomer(np.array([1e-3, 1.1e-3]), np.array([100.0, 100.1]), 0.0)
    beyond = -softening.force(jnp.array([5e-3, 0, 0]), ZERO)[0]
    assert beyond >= 100.0  # an end slope without limiter would be negative


def test_requirements():
    for law in ALL:
        assert enforce("here", law.requirements()) == []
    eye = np.eye(3)
    for law, field in (
        (RadialElastomer(-1.0, B), "stiffness"),
        (RadialElastomer(K, np.nan), "damping"),
        (VectorElastomer(np.inf, B), "stiffness"),
        (MatrixElastomer(eye + np.triu(np.ones((3, 3)), 1), eye), "stiffness"),
        (MatrixElastomer(-eye, eye), "stiffness"),
        (MatrixElastomer(eye, np.nan * eye), "damping"),
        (MatrixElastomer(eye, eye, np.eye(2)), "rotational_stiffness"),
        (MatrixElastomer(eye, eye, eye, np.diag([1.0, -1.0, 1.0])), "rotational_damping"),
        (CurveElastomer(np.array([0.0, 1e-3]), np.array([0.0, 5.0]), B), "deflections"),
        (CurveElastomer(np.array([2e-3, 1e-3]), np.array([1.0, 5.0]), B), "deflections"),
        (CurveElastomer(np.array([1e-3]), np.array([1.0, 5.0]), B), "deflections"),
        (CurveElastomer(np.array([1e-3, 2e-3]), np.array([5.0, 1.0]), B), "forces"),
        (CurveElastomer(POINTS, FORCES, -1.0), "damping"),
    ):
        with pytest.raises(SceneError, match=f": {field} = "):
            enforce("here", law.requirements())


ALLOWED = set(
    """add sub mul div neg max min sqrt exp log log1p tanh sin cos abs sign pow integer_pow square dot_general
    reduce_sum select_n eq ne lt le gt ge and or not concatenate stack slice squeeze reshape broadcast_in_dim
    convert_element_type transpose jit pjit expand_dims split""".split()  # noqa: SIM905
)


def primitives(jaxpr):
    found = set()
    for equation in jaxpr.eqns:
        found.add(equation.primitive.name)
        for value in equation.params.values():
            if hasattr(value, "jaxpr"):
                found |= primitives(value.jaxpr)
    return found


@names
def test_program_is_straight_line(law):
    """No gather, no loop, no branch: the law can be rewritten as a scalar program."""

    def everything(law, e, rate):
        return law.force(e, rate), law.moment(e, rate), law.elastic_energy(e, rate)

    assert primitives(jax.make_jaxpr(everything)(law, E, RATE).jaxpr) <= ALLOWED
