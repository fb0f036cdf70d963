"""Functions of one variable: values, derivatives, integrals, both programs, kinks, bad input."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.physics.functions.base import as_function

X, Y = [-0.5, 0.0, 0.2, 0.9], [-1.0, -0.5, 2.0, 3.0]

FUNCTIONS = {
    "constant": sj.functions.Constant(2.0),
    "linear": sj.functions.Linear(3.0, 1.0),
    "polynomial": sj.functions.Polynomial([1.0, 2.0, -3.0, 0.5], center=0.2),
    "sine": sj.functions.Sine(2.0, 0.7, phase=0.3, offset=0.1),
    "step": sj.functions.Step(0.41),
    "smooth step": sj.functions.SmoothStep(-0.2, 0.8, before=1.0, after=3.0),
    "bump": sj.functions.Bump(0.2, -0.3, 0.9),
    "piecewise": sj.functions.Piecewise(
        [-0.2, 0.3], [sj.functions.Linear(1.0), sj.functions.Polynomial([-0.3, 0.0, 1.0]), jnp.sin]
    ),
    "integrable pieces": sj.functions.Piecewise(
        [-0.2, 0.3], [sj.functions.Linear(1.0), sj.functions.Sine(1.0, 0.5), sj.functions.Constant(4.0)]
    ),
    "table": sj.functions.Table(X, Y),
    "smooth table": sj.functions.SmoothTable(X, Y),
    "two points": sj.functions.SmoothTable(X[:2], Y[:2]),
    "one line": sj.functions.Table(X[:2], Y[:2]),
    "sum": sj.functions.Sum(sj.functions.Linear(1.0), sj.functions.Sine(1.0, 1.0)),
    "integral": sj.functions.Integral(sj.functions.Table(X, Y), 0.3, origin=0.1),
    "user's": as_function(lambda x: x**2 * jnp.cos(x)),
}
BREAKS = {
    "step": [0.41],
    "smooth step": [-0.2, 0.8],
    "bump": [-0.3, 0.6],
    "piecewise": [-0.2, 0.3],
    "integrable pieces": [-0.2, 0.3],
    "table": X,
    "smooth table": X,
    "two points": X[:2],
    "one line": X[:2],
}
SMOOTH = ["smooth step", "bump", "smooth table"]
EVERYWHERE = np.linspace(-1.3, 1.4, 37)
BESIDE = 1e-7
"""Distance from a break at which both sides are compared."""


def points(name: str) -> np.ndarray:
    """Points everywhere, and the breaks themselves; as many for each function, so that they share what is compiled."""
    return np.concatenate([EVERYWHERE, np.resize(BREAKS.get(name, [0.0]), 4)])


def at(function, xs) -> np.ndarray:
    """Values at points, by the scalar program: nothing is compiled."""
    program = sj.compiler.scalarize(function, jnp.zeros(()))
    return np.array([program.compute(x) for x in np.asarray(xs, float)])


def jump(function, places) -> float:
    """Largest jump at some places."""
    return np.abs(at(function, np.add(places, BESIDE)) - at(function, np.subtract(places, BESIDE))).max()


@pytest.mark.parametrize("name", FUNCTIONS)
def test_scalar_program_is_the_array_code(name):
    function, xs = FUNCTIONS[name], points(name)
    np.testing.assert_allclose(at(function, xs), jax.vmap(function)(xs), rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_are_finite_everywhere_and_right_beside_the_breaks(name):
    function, h = FUNCTIONS[name], 1e-6
    assert np.isfinite(at(function.derivative, points(name))).all()
    assert np.isfinite(at(function.second_derivative, points(name))).all()
    xs = points(name) + 4 * h
    difference = (at(function, xs + h) - at(function, xs - h)) / (2 * h)
    np.testing.assert_allclose(at(function.derivative, xs), difference, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name != "user's"])
def test_derivatives_by_the_numbers_are_finite_at_the_breaks(name):
    numbers, structure = jax.tree.flatten(FUNCTIONS[name])

    def slopes(numbers, x):
        return jax.jacfwd(lambda numbers: jax.tree.unflatten(structure, numbers)(x))(numbers)

    program = sj.compiler.scalarize(slopes, [jnp.asarray(number, float) for number in numbers], jnp.zeros(()))
    for x in points(name):
        assert all(np.isfinite(slope).all() for slope in program.compute(numbers, x)), x


@pytest.mark.parametrize("name", [name for name, function in FUNCTIONS.items() if function.knows_primitive])
def test_primitive_is_the_integral(name):
    function = FUNCTIONS[name]
    edges = np.unique(np.concatenate([[-1.3, 1.4], BREAKS.get(name, [])]))
    nodes, weights = np.polynomial.legendre.leggauss(20)
    for low, high in itertools.pairwise(edges):
        xs = low + (high - low) * (nodes + 1) / 2
        integral = (high - low) / 2 * weights @ at(function, xs)
        assert np.diff(at(function.primitive, [low, high])) == pytest.approx(integral, rel=1e-12, abs=1e-13)
        np.testing.assert_allclose(at(jax.grad(function.primitive), xs), at(function, xs), rtol=1e-12, atol=1e-12)


def test_an_integral_that_is_not_known_is_refused():
    assert not FUNCTIONS["user's"].knows_primitive
    assert not FUNCTIONS["piecewise"].knows_primitive
    with pytest.raises(TypeError, match="UserFunction does not know its primitive"):
        FUNCTIONS["user's"].primitive(1.0)


@pytest.mark.parametrize("name", SMOOTH)
def test_slope_is_continuous_at_the_breaks(name):
    function = FUNCTIONS[name]
    for f in (function, function.derivative):
        assert jump(f, BREAKS[name]) < 1e-4


def test_second_derivative_of_a_smooth_step_is_continuous():
    step = FUNCTIONS["smooth step"]
    assert jump(step.second_derivative, BREAKS["smooth step"]) < 1e-4
    assert jump(FUNCTIONS["bump"].second_derivative, BREAKS["bump"]) > 1


@pytest.mark.parametrize("kind", [sj.functions.Table, sj.functions.SmoothTable])
def test_tables_pass_their_points_and_go_on_straight(kind):
    table = kind(X, Y)
    np.testing.assert_allclose(at(table, X), Y, atol=1e-15)
    for end, way in ((X[0], -1.0), (X[-1], 1.0)):
        beyond = at(table, end + way * np.array([1.0, 2.0]))
        slope = at(table.derivative, [end + way])
        np.testing.assert_allclose(beyond, at(table, [end]) + way * slope * np.array([1.0, 2.0]), rtol=1e-14)


def test_table_is_linear_between_points():
    assert sj.functions.Table(X, Y)(0.1) == pytest.approx(0.75)
    assert sj.functions.Table(X, Y)(1.9) == pytest.approx(3.0 + 1.0 / 0.7)


def test_smooth_table_does_not_overshoot():
    table = sj.functions.SmoothTable([0.0, 1.0, 1.1, 2.0, 3.0], [0.0, 0.0, 5.0, 5.0, 4.0])
    values = at(table, np.linspace(0.0, 3.0, 601))
    assert values.min() >= 0
    assert values.max() <= 5 + 1e-12
    rising = at(sj.functions.SmoothTable(X, Y), np.linspace(-1.0, 2.0, 601))
    assert (np.diff(rising) > 0).all()


def test_smooth_table_reproduces_a_straight_line():
    table = sj.functions.SmoothTable([-1.0, 0.3, 0.5, 2.0], np.array([-1.0, 0.3, 0.5, 2.0]) * 3 - 1)
    np.testing.assert_allclose(at(table, EVERYWHERE), 3 * EVERYWHERE - 1, rtol=1e-13)


def test_bump_of_the_paper():
    road = sj.functions.Bump(height=0.2, start=15.0, length=5.0)
    for x in (15.7, 17.5, 19.9):
        assert road(x) == pytest.approx(0.1 * (1 - np.cos(2 * np.pi * (x - 15) / 5)), rel=1e-14)
    assert road(14.0) == 0
    assert road(21.0) == 0


def test_damper_of_the_paper_is_smooth():
    damper = sj.functions.Piecewise(
        [-0.20, 0.21],
        [
            sj.functions.Linear(1844.3, -416.42),
            sj.functions.Polynomial([0.0, 9945.627, 33955.72, -59832.25, -395651.0]),
            sj.functions.Linear(1634.727, 1919.1638),
        ],
    )
    assert jump(damper, (-0.20, 0.21)) < 0.1  # of 785 and 2262 N: to the digits printed
    assert jump(damper.derivative, (-0.20, 0.21)) < 10  # of 1844 and 1635 N s/m


def test_a_piece_is_evaluated_on_its_own_interval_only():
    function = sj.functions.Piecewise([1.0], [sj.functions.Constant(0.0), lambda x: jnp.sqrt(x - 1.0 + 1e-3)])
    for x in (-5.0, 0.0, 1.0, 2.0):
        assert np.isfinite(jax.grad(function)(x)), x


def test_numbers_are_leaves():
    ys = jnp.linspace(0.0, 1.0, 5)
    values = jax.vmap(lambda y: sj.functions.Table([0.0, 1.0], jnp.stack([jnp.zeros(()), y]))(0.5))(ys)
    np.testing.assert_allclose(values, ys / 2)
    assert jax.grad(lambda h: sj.functions.Bump(h, 0.0, 1.0)(0.5))(2.0) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (sj.functions.Table([0.0, 2.0, 1.0], [0.0, 1.0, 2.0]), r"spring.x = \[0. 2. 1.\] must increase"),
        (sj.functions.SmoothTable([0.0, 0.0, 1.0], [0.0, 1.0, 2.0]), "leave out doubles"),
        (sj.functions.Table([0.0, 1.0], [0.0, 1.0, 2.0]), "as many as y"),
        (sj.functions.Table([0.0], [0.0]), "two or more"),
        (sj.functions.Table([0.0, 1.0], [0.0, np.nan]), "spring.y"),
        (sj.functions.Polynomial([]), "spring.coefficients"),
        (sj.functions.Polynomial([np.inf]), "spring.coefficients"),
        (sj.functions.Sine(1.0, 0.0), "spring.frequency = 0 must be positive"),
        (sj.functions.Bump(1.0, 0.0, -1.0), "spring.length = -1 must be positive"),
        (sj.functions.SmoothStep(1.0, 1.0), "spring.end = 1 must be above start"),
        (sj.functions.Piecewise([1.0, 0.0], [jnp.sin] * 3), "spring.breaks"),
        (sj.functions.Piecewise([1.0], [jnp.sin] * 3), "be a list of 2 numbers"),
        (sj.functions.Piecewise([1.0], [jnp.sin, sj.functions.Bump(1.0, 0.0, 0.0)]), r"spring.pieces\[1\].length"),
        (sj.functions.Sum(sj.functions.Constant(np.nan)), r"spring.terms\[0\].value"),
    ],
)
def test_bad_numbers_are_refused_by_name(function, message):
    spring = sj.SpringDamper(("ground", "ball"), spring=function)
    with pytest.raises(sj.SceneError, match=message):
        sj.equations.compile_scene(sj.Scene({"ball": sj.Body(1.0, [1.0, 1.0, 1.0])}, forces={"spring": spring}))


def test_what_is_no_function_is_refused():
    with pytest.raises(sj.SceneError, match=r"5.0 is no function; give e.g. Linear"):
        sj.SpringDamper(("ground", "ball"), spring=5.0)  # pyright: ignore[reportArgumentType]
