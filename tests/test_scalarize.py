"""The scalar program: agreement with the array code for every case, folding, elimination, and falling back."""

import re
import warnings
from typing import ClassVar

import cases
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.compiler.graph import Graph
from spherejax.compiler.linear_algebra.symmetric import symmetric_solve
from spherejax.compiler.linear_algebra.unrolled import _minimum_degree_order
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.operations import FLOAT
from spherejax.compiler.program import scalarize
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.contacts import crossings, memory_after_step, onset_slopes, relative_motions
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.observables import observe
from spherejax.motion.equations.programs import program_for
from spherejax.motion.equations.projection import corrected
from spherejax.motion.integration.problem import initial_state
from spherejax.motion.start.assembly import as_ideal, assemble_now
from spherejax.motion.start.start_now import start_now

AGREEMENT = 1e-12  # of the largest component
SCALAR = jax.ShapeDtypeStruct((), jnp.float64)
VECTOR = jax.ShapeDtypeStruct((3,), jnp.float64)


def prepared(scene, track_work=True):
    """System, structure, numbers and assembled start of a scene."""
    system = sj.equations.compile_scene(scene, track_work=track_work).system
    structure, theta = flatten_system(system)
    return system, structure, theta, start_now(system, np.zeros(1))


def assert_agree(scalar, array, largest=None):
    """Leaf by leaf, against the largest component of the leaf."""
    for ours, theirs in zip(jax.tree.leaves(scalar), jax.tree.leaves(array), strict=True):
        assert ours.shape == theirs.shape
        assert ours.dtype == theirs.dtype
        scale = np.abs(theirs).max(initial=0.0) if largest is None else largest
        assert np.abs(np.asarray(ours) - np.asarray(theirs)).max(initial=0.0) <= AGREEMENT * scale


def compare(function, structure, theta, t, y, y_size=None):
    y = jax.tree.map(jnp.asarray, y)
    program = program_for(function, structure, True, y_size)
    assert program.scalar is not None
    expected = function(structure.system(jnp.asarray(theta)), t, y)
    with jax.disable_jit():  # operation by operation, without compiling each case
        assert_agree(program.inside(theta, program.ahead(theta), t, y), expected)


@pytest.mark.parametrize("case", cases.CASES, ids=lambda case: case.name)
def test_right_hand_side_agrees(case):
    system, structure, theta, start = prepared(case.build())
    # Near the start, in flight or film; and beyond the surface, in contact.
    for seed, distance in enumerate((0.2 * cases.C, 2 * cases.C)):
        t, y = 0.1, cases.displaced_state(system, start, seed, distance)
        if case.is_overconstrained:
            t = 0.0  # a driver is near its place at the start only
            for _ in range(3):
                y = corrected(system, t, jnp.asarray(y))
            depth = system.spherical(case.studied).model.penetration(relative_motions(system, y)[case.studied])
            assert (depth > 0) == (distance > cases.C), depth
        compare(state_rate, structure, theta, t, y)


@pytest.mark.parametrize("name", ["ideal", "friction", "dry_lugre", "lubricated", "bushing_matrix"])
def test_observables_agree(name):
    system, structure, theta, start = prepared(sj.gallery.four_bar(cases.MODELS[name]))
    y = jnp.asarray(cases.displaced_state(system, start, 3, 2 * cases.C))
    expected = observe(structure.system(jnp.asarray(theta)), 0.1, y)
    program = program_for(observe, structure)
    with jax.disable_jit():
        found = program.inside(theta, program.ahead(theta), 0.1, y)
    for joint, reaction in expected.reactions.items():
        # A moment is judged against the force on an arm of a decimeter: that of an ideal pivot is zero.
        force = np.abs(reaction.force).max()
        assert_agree(found.reactions[joint].force, reaction.force)
        assert_agree(found.reactions[joint].moment, reaction.moment, max(0.1 * force, np.abs(reaction.moment).max()))
    rest = {"reactions": {}}
    assert_agree(found._replace(**rest), expected._replace(**rest))


@pytest.mark.parametrize("name", ["dry", "dry_hertz", "dry_lugre", "lubricated", "lubricated_lugre"])
def test_events_agree(name):
    system, structure, theta, start = prepared(sj.gallery.four_bar(cases.MODELS[name]))
    if not system.contact_joints:
        assert name == "dry_hertz"
        return
    y = cases.displaced_state(system, start, 4, 2 * cases.C)
    compare(crossings, structure, theta, 0.1, y)
    flight = y.copy()
    flight[system.layout.memory_start] = 0.0
    compare(onset_slopes, structure, theta, 0.1, y)
    for start, end in ((flight, y), (y, flight), (y, y)):
        step = tuple(map(jnp.asarray, (start, end, np.full(len(system.contact_joints), 3.0))))
        compare(memory_after_step, structure, theta, 0.1, step, tuple(map(len, step)))


@pytest.mark.parametrize(
    "name", ["friction", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ideal", "lubricated"))]
)
def test_compiled_program_and_its_derivative_agree(name):
    system, structure, theta, start = prepared(sj.gallery.four_bar(cases.MODELS[name]))
    y = jnp.asarray(cases.displaced_state(system, start, 5, 0.2 * cases.C))
    program = program_for(state_rate, structure)
    array = jax.jit(lambda theta, t, y: state_rate(structure.system(theta), t, y))
    assert_agree(jax.jit(program)(theta, 0.1, y), array(theta, 0.1, y))
    direction = jnp.asarray(np.random.default_rng(1).standard_normal(y.shape))
    ours = jax.jit(lambda y: jax.jvp(lambda y: program(theta, 0.1, y), (y,), (direction,))[1])(y)
    theirs = jax.jvp(lambda y: state_rate(structure.system(jnp.asarray(theta)), 0.1, y), (y,), (direction,))[1]
    assert np.abs(ours - theirs).max() <= 1e-11 * np.abs(theirs).max()
    batch = jnp.stack([y, y + 1e-5])
    assert_agree(jax.vmap(program, (None, None, 0))(theta, 0.1, batch)[1], program(theta, 0.1, batch[1]))


def test_array_path_gives_the_same_motion():
    scene = sj.gallery.four_bar()
    fast = sj.simulate(scene, cases.times(0.05), rtol=1e-10)
    slow = sj.simulate(scene, cases.times(0.05), rtol=1e-10, scalar=False)
    assert np.abs(fast.ys - slow.ys)[:, :21].max() < 1e-11


# A user's own laws ---------------------------------------------------------------------------------------------------


class Spring(sj.forces.AbstractForce):
    """A spring between the rocker and the world's origin that stiffens with its length, written by a user."""

    stiffness: float

    def wrenches(self, t, motions):
        r = motions["rocker"].position
        length = jnp.linalg.norm(r)
        return {
            "rocker": sj.forces.Wrench(-self.stiffness * length**2.5 * jnp.cos(t) * r, jnp.cross(r, jnp.ones(3)) * 1e-3)
        }


class PlainHertz(sj.laws.AbstractNormalLaw):
    """Hertz's law as a user would write it: without any of the package's guards."""

    stiffness: float | None = None
    exponent: float = 1.5
    remembers_onset: ClassVar[bool] = False

    def force(self, penetration, penetration_rate, onset_rate, stiffness):
        return stiffness * jnp.maximum(penetration, 0.0) ** 1.5

    def requirements(self):
        return []


class StiffRubber(sj.laws.AbstractHysteresisLaw):
    """A hysteresis factor of the user's own."""

    restitution: float
    stiffness: float | None = None
    exponent: float = 1.5

    def hysteresis_factor(self):
        return jnp.exp(1 - self.restitution) - jnp.sum(jnp.array([0.5, 0.5])) * self.restitution**jnp.pi


@pytest.mark.parametrize("law", [PlainHertz(), StiffRubber(restitution=0.8)], ids=["plain", "hysteresis"])
def test_normal_law_of_the_user_agrees(law):
    scene = sj.gallery.four_bar(sj.Dry(clearance=cases.C, normal=law))
    scene = sj.Scene(scene.bodies, scene.joints, {"spring": Spring(10.0)}, gravity=scene.gravity)
    system, structure, theta, start = prepared(scene)
    for seed, distance in enumerate((0.2 * cases.C, 2 * cases.C)):
        compare(state_rate, structure, theta, 0.3, cases.displaced_state(system, start, seed, distance))


def test_derivative_of_an_unguarded_law_is_finite_in_flight():
    # max(delta, 0)**1.5 has the derivative 0 in flight, on the array path and on the scalar one.
    system, structure, theta, start = prepared(sj.gallery.four_bar(sj.Dry(clearance=cases.C, normal=PlainHertz())))
    y = jnp.asarray(cases.displaced_state(system, start, 0, 0.01 * cases.C))
    assert (
        np.linalg.norm(observe(structure.system(jnp.asarray(theta)), 0.0, y).eccentricity["coupler_rocker"]) < cases.C
    )
    program = program_for(state_rate, structure)
    direction = jnp.ones_like(y)
    expected = jax.jvp(lambda y: state_rate(structure.system(jnp.asarray(theta)), 0.0, y), (y,), (direction,))[1]
    with jax.disable_jit():
        found = jax.jvp(lambda y: program(theta, 0.0, y), (y,), (direction,))[1]
    assert np.isfinite(expected).all()
    assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize("exponent", [1.5, 2.5, 3.5])
def test_powers_keep_their_derivative_at_zero(exponent):
    def power(x):
        return jnp.maximum(x, 0.0) ** exponent

    program = sj.compiler.scalarize(power, SCALAR)
    for x in (-1.0, 0.0, 4.0):
        assert float(program(x)) == pytest.approx(float(power(x)), rel=1e-15)
        assert float(jax.grad(program)(x)) == pytest.approx(float(jax.grad(power)(x)), rel=1e-14)


# Derivative rules of a user's own -------------------------------------------------------------------------------------


@jax.custom_jvp
def _ramp(x):
    return jnp.maximum(x, 0.0)


_ramp.defjvp(lambda primals, tangents: (_ramp(*primals), jnp.where(primals[0] > 0, 1.0, 0.5) * tangents[0]))


@jax.custom_jvp
def _root(x):
    """The derivative of what it is made of is not finite at 0, and so is the second one behind a rule that guards."""
    return jnp.sqrt(jnp.maximum(x, 0.0))


_root.defjvp(
    lambda primals, tangents: (
        _root(*primals),
        jnp.where(primals[0] > 0, 0.5 / jnp.where(primals[0] > 0, _root(primals[0]), 1.0), 0.0) * tangents[0],
    )
)


@jax.custom_jvp
def _both(x, y):
    return x * y, x


_both.defjvp(lambda primals, tangents: (_both(*primals), (7.0 * tangents[1] * primals[0], 2.0 * tangents[0])))

WITH_RULES = {
    "a slope of its own": lambda v: _ramp(v) @ v,
    "a guarded root": lambda v: _root(v[0] * v[0] - v[1]) + _root(v[2]) ** 3,
    "two results": lambda v: _both(v[0], v[1] * v[2])[0] * jnp.sin(_both(v[1], 2.0)[1]),
    "relu": lambda v: jax.nn.relu(v) @ jnp.array([1.0, 2.0, 3.0]) * v[0],
    "softplus": lambda v: jax.nn.softplus(v).sum(),
    "one in the other": lambda v: _ramp(_root(v)).sum(),
    "as it is": lambda v: _both(v[0], v[1])[1] * v[0],
}


@pytest.mark.parametrize("name", WITH_RULES)
def test_derivative_rules_are_followed(name):
    function = WITH_RULES[name]
    program = sj.compiler.scalarize(function, VECTOR)
    for way in (lambda f: f, jax.jacfwd, jax.jacrev, jax.hessian, lambda f: jax.jacfwd(jax.hessian(f))):
        for v in map(jnp.array, ((0.3, -1.2, 2.1), (0.0, 0.0, 0.0), (1.0, 1.0, -1.0))):
            assert_agree(way(program)(v), way(function)(v))


def test_derivative_rule_of_too_high_an_order_is_refused():
    function = sj.compiler.scalarize(_root, SCALAR)
    for _ in range(3):
        function = jax.grad(function)
    assert float(function(4.0)) == pytest.approx(0.375 / 32, rel=1e-14)
    with pytest.raises(sj.compiler.NotScalarizable, match="custom_jvp"):
        jax.grad(function)(4.0)


# Operations without a rule -------------------------------------------------------------------------------------------


@jax.custom_vjp
def _turned(x):
    return x


_turned.defvjp(lambda x: (x, None), lambda _, along: (-along,))

UNKNOWN = {
    "sort": (lambda v: jnp.sort(v), "."),
    "qr": (lambda v: jnp.linalg.qr(jnp.outer(v, v) + jnp.eye(3))[1] @ v, "qr"),
    "eigh": (lambda v: jnp.linalg.eigh(jnp.outer(v, v) + jnp.eye(3) * v)[0], "eigh|triangular|tril|custom"),
    "custom_vjp": (lambda v: _turned(v), "custom_vjp"),
    "while": (lambda v: jax.lax.while_loop(lambda c: c[0] < 3, lambda c: c + 1, v), "while"),
    "cumsum": (lambda v: jnp.cumsum(v), "."),
    "argmax": (lambda v: v * jnp.argmax(v), "."),
    "computed index": (lambda v: v[jnp.floor(jnp.abs(v[0])).astype(int) % 3], "."),
    "scatter-add": (lambda v: v.at[1].add(2.0), "."),
    "complex": (lambda v: jnp.abs(v + 1j), "complex"),
    "random": (lambda v: v + jax.random.uniform(jax.random.key(0)), "."),
    "checkpoint": (lambda v: jax.checkpoint(jnp.sin)(v), "."),
    "fill outside": (lambda v: jnp.take(v, np.array([7]), mode="fill", fill_value=7.0), "."),
    "single precision": (lambda v: v.astype(jnp.float32), "."),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_unknown_operation_is_refused_or_right(name):
    function, reason = UNKNOWN[name]
    v = jnp.array([0.3, -1.2, 2.1])
    try:
        program = sj.compiler.scalarize(function, VECTOR)
    except sj.compiler.NotScalarizable as refusal:
        said = str(refusal)
    else:
        said = None
        assert_agree(program(v), function(v))
    assert said is None or re.search(reason, said)


class Odd(sj.forces.AbstractForce):
    """A force with an operation that has no scalar rule."""

    kind: str = eqx.field(static=True)

    def wrenches(self, t, motions):
        r = UNKNOWN[self.kind][0](motions["rocker"].position)
        return {"rocker": sj.forces.Wrench(0.01 * r, jnp.zeros(3))}


@pytest.mark.parametrize("kind", ["qr", "eigh", "custom_vjp"])
def test_unknown_operation_falls_back_with_a_warning_and_right_values(kind):
    scene = sj.gallery.four_bar()
    scene = sj.Scene(scene.bodies, scene.joints, {"odd": Odd(kind)}, gravity=scene.gravity)
    system, structure, theta, start = prepared(scene, track_work=False)
    y = cases.displaced_state(system, start, 1, 1e-3)
    with pytest.warns(sj.errors.ArrayPathWarning, match=f"state_rate runs as array code.*{UNKNOWN[kind][1]}"):
        program = program_for(state_rate, structure)
    assert program.scalar is None
    assert_agree(program(theta, 0.0, y), state_rate(structure.system(jnp.asarray(theta)), 0.0, y))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        program_for(state_rate, structure, False)  # asked for: no warning


def test_fallback_simulates():
    body = sj.Body(1.0, (1.0, 1.0, 1.0))

    class Factored(sj.forces.AbstractForce):
        def wrenches(self, t, motions):
            matrix = jnp.diag(jnp.array([1.0, 2.0, 3.0]) + 0 * motions["body"].position)
            return {"body": sj.forces.Wrench(jnp.abs(jnp.diag(jnp.linalg.qr(matrix)[1])), jnp.zeros(3))}

    scene = sj.Scene({"body": body}, {}, {"push": Factored()}, gravity=(0.0, 0.0, 0.0))
    with pytest.warns(sj.errors.ArrayPathWarning, match="qr"):
        run = sj.simulate(scene, cases.times(2.0))
    assert np.asarray(run.position("body")[-1]) == pytest.approx([2.0, 4.0, 6.0], abs=1e-9)


def test_force_as_a_function_of_time():
    body = sj.Body(2.0, (1.0, 1.0, 1.0))
    push = sj.AppliedWrench("body", force=lambda t: jnp.array([jnp.cos(t), 0.0, 0.0]))
    run = sj.simulate(sj.Scene({"body": body}, {}, {"push": push}, gravity=(0.0, 0.0, 0.0)), cases.times(1.0))
    assert float(run.position("body")[-1, 0]) == pytest.approx((1 - np.cos(1.0)) / 2, abs=1e-9)


def test_wrong_shapes_are_named():
    program = sj.compiler.scalarize(lambda v: 2 * v, VECTOR)
    with pytest.raises(ValueError, match=r"made for shapes \[\(3,\)\], got \[\(4,\)\]"):
        program(jnp.zeros(4))
    with pytest.raises(ValueError, match="made for shapes"):
        program(jnp.zeros(3), jnp.zeros(3))


def test_programs_that_are_too_long_are_refused():
    with pytest.raises(sj.compiler.NotScalarizable, match="more than 10 scalar operations"):
        sj.compiler.scalarize(
            lambda v: jnp.sum(jnp.sin(jnp.outer(v, v)) @ jnp.outer(v, jnp.cos(v))), VECTOR, maximum_operations=10
        )


def two_layers(v):
    """A network of 20 x 20 and 1 x 20 weights of its own argument."""
    return jnp.tanh(v[:400].reshape(20, 20) @ v[420:440]) @ v[400:420]


def test_long_sums_of_products_are_counted_apart():
    """Machine code has them in loops: 840 of 860 operations of a network."""
    numbers = jnp.asarray(np.random.default_rng(0).standard_normal(440))
    with pytest.raises(sj.compiler.NotScalarizable, match="more than 100 scalar operations"):
        sj.compiler.scalarize(two_layers, numbers, maximum_operations=100)
    with pytest.raises(sj.compiler.NotScalarizable, match="more than 500 scalar operations in sums of products"):
        sj.compiler.scalarize(two_layers, numbers, maximum_operations=100, maximum_in_sums=500)
    program = sj.compiler.scalarize(two_layers, numbers, maximum_operations=100, maximum_in_sums=1000)
    assert program.n_operations - program.n_in_sums < 100
    np.testing.assert_allclose(program(numbers), two_layers(numbers), rtol=1e-12)


def test_products_of_numbers_that_are_spread_out_are_no_sums_for_loops():
    """The second factor is computed entry by entry, and the first one is every other number."""

    def function(v):
        return jnp.sum((v[::2].reshape(20, 20) * jnp.cos(v[1::2]).reshape(20, 20)).T @ jnp.sin(v[:20]))

    numbers = jnp.asarray(np.random.default_rng(0).standard_normal(800))
    with pytest.raises(sj.compiler.NotScalarizable, match="more than 500 scalar operations"):
        sj.compiler.scalarize(function, numbers, maximum_operations=500, maximum_in_sums=1000)


# Folding -------------------------------------------------------------------------------------------------------------


def operations(function, *shapes, **options):
    return dict(sj.compiler.scalarize(function, *shapes, **options).operations)


def test_structural_zeros_and_ones_fold():
    assert operations(lambda v: jnp.eye(3) @ v, VECTOR) == {}
    assert operations(lambda v: v * 0.0 + v - 0.0, VECTOR) == {}
    assert operations(lambda v: -(0.0 - v) * 1.0 / 1.0, VECTOR) == {}
    assert operations(lambda v: jnp.zeros((3, 3)) @ v, VECTOR) == {}
    assert operations(lambda v: np.diag([2.0, 0.0, 1.0]) @ v, VECTOR) == {"mul": 1}
    assert operations(lambda v: v - v, VECTOR) == {}


def test_equal_subexpressions_are_computed_once():
    assert operations(lambda v: jnp.sin(v[0]) + jnp.sin(v[0]) * v[1], VECTOR) == {"sin": 1, "mul": 1, "add": 1}
    assert operations(lambda v: v[0] * v[1] - v[1] * v[0], VECTOR) == {}


def test_powers_become_products():
    assert operations(lambda x: x**2, SCALAR) == {"mul": 1}
    assert operations(lambda x: x**3, SCALAR) == {"mul": 2}
    assert "pow" in operations(lambda x: x**1.3, SCALAR)


def test_fixed_entries_are_folded_and_not_read():
    def function(v):
        return v[0] * v[1] + v[2]

    assert operations(function, VECTOR, fixed={(0, 0): 0.0}) == {}
    assert operations(function, VECTOR, fixed={(0, 0): 1.0}) == {"add": 1}
    program = sj.compiler.scalarize(function, VECTOR, fixed={(0, 0): 1.0})
    assert float(program(jnp.array([np.nan, 2.0, 3.0]))) == 5.0


ORDER = np.argsort(np.random.default_rng(0).normal(size=(4, 5, 3)), axis=1)

MOVES = {
    "rows": lambda x: x[np.array([0, 2])],
    "entries": lambda x: x[np.array([0, 2]), :, np.array([1, 2])],
    "entries of the middle": lambda x: x[:, np.array([[0, 1], [3, 4]])],
    "twice": lambda x: x[np.array([0, 2])][:, np.array([1, 1, 0])],
    "taken": lambda x: jnp.take(x, np.array([2, 0]), axis=1),
    "in an order": lambda x: jnp.take_along_axis(x, ORDER, axis=1),
    "clipped": lambda x: x.at[np.array([0, 9]), 2].get(mode="clip"),
    "mapped": lambda x: jax.vmap(lambda row, i: row[i])(x, np.array([0, 1, 4, 2])),
    "last": lambda x: x[..., -1],
    "a part": lambda x: jax.lax.dynamic_slice(x, (1, 2, 0), (2, 2, 3)),
    "set": lambda x: x.at[1, 2].set(x[0, 0]),
}


@pytest.mark.parametrize("name", MOVES)
def test_entries_are_moved_as_jax_moves_them(name):
    x = jnp.asarray(np.random.default_rng(1).normal(size=(4, 5, 3)))
    np.testing.assert_array_equal(scalarize(MOVES[name], x).compute(x), MOVES[name](x))


def test_an_entry_that_is_not_there_is_filled_as_jax_fills_it():
    x = jnp.array([0.3, -1.2, 2.1])
    for filling in (7.0, None):

        def function(x, filling=filling):
            return x.at[np.array([0, 9])].get(mode="fill", fill_value=filling)

        np.testing.assert_array_equal(scalarize(function, x).compute(x), function(x))


def test_known_branches_are_taken_and_unknown_ones_selected():
    def function(x):
        return jax.lax.cond(x > 0, lambda x: 2 * x, lambda x: -x, x)

    for x in (-1.5, 1.5):
        assert float(function(x)) == abs(x) * (2 if x > 0 else 1)
    program = sj.compiler.scalarize(function, SCALAR)
    for x in (-1.5, 1.5):
        assert float(program(x)) == float(function(x))
    assert operations(lambda x: jax.lax.cond(np.bool_(True), lambda x: 2 * x, lambda x: jnp.sin(x), x), SCALAR) == {
        "mul": 1
    }


def test_loops_of_known_length_unroll():
    def function(v):
        return jax.lax.scan(lambda c, x: (c * x, c + x), 1.0, v, reverse=True)

    v = jnp.array([0.3, -1.2, 2.1])
    assert_agree(sj.compiler.scalarize(function, VECTOR)(v), function(v))


def test_what_is_constant_moves_ahead_of_the_loop():
    program = sj.compiler.scalarize(lambda v, x: jnp.sin(v[0]) * jnp.cos(v[1]) * x, VECTOR, SCALAR)
    assert program.n_operations == 4
    assert program.n_operations_inside == 1
    v = jnp.array([0.3, -1.2, 2.1])
    assert float(program.inside(program.ahead(v), v, 2.0)) == pytest.approx(float(program(v, 2.0)), rel=1e-15)


def test_graph_keeps_negation_in_order():
    graph = Graph()
    a, b = graph.input((0, 0)), graph.input((0, 1))
    assert graph.neg(graph.sub(a, b)) == graph.sub(b, a)
    assert graph.add(a, graph.neg(b)) == graph.sub(a, b)
    assert graph.mul(graph.neg(a), graph.neg(b)) == graph.mul(a, b)
    assert graph.value(graph.mul(graph.constant(2, FLOAT), graph.constant(3, FLOAT))) == 6


# The symmetric solve -------------------------------------------------------------------------------------------------


def spd(seed, n=5):
    a = np.random.default_rng(seed).standard_normal((n, n))
    return jnp.asarray(a @ a.T + n * np.eye(n))


def test_symmetric_solve_solves_in_every_form():
    S, b = spd(0), jnp.arange(5.0)
    B = jnp.stack([b, b**2], 1)
    assert np.asarray(symmetric_solve(S, b)) == pytest.approx(np.linalg.solve(S, b), rel=1e-12)
    assert np.asarray(symmetric_solve(S, B)) == pytest.approx(np.linalg.solve(S, B), rel=1e-12)
    matrix, right = jax.ShapeDtypeStruct((5, 5), jnp.float64), jax.ShapeDtypeStruct((5,), jnp.float64)
    program = sj.compiler.scalarize(symmetric_solve, matrix, right)
    assert np.asarray(program(S, b)) == pytest.approx(np.linalg.solve(S, b), rel=1e-12)
    assert symmetric_solve(jnp.zeros((0, 0)), jnp.zeros(0)).shape == (0,)
    assert not np.isfinite(symmetric_solve(-S, b)).all()


def test_symmetric_solve_differentiates():
    S, T, b, d = spd(0), spd(1), jnp.arange(5.0), jnp.ones(5)
    x = np.linalg.solve(S, b)
    tangent = jax.jvp(symmetric_solve, (S, b), (T, d))[1]
    assert np.asarray(tangent) == pytest.approx(np.linalg.solve(S, d - T @ x), rel=1e-11)
    S_bar, b_bar = jax.grad(lambda S, b: d @ symmetric_solve(S, b), (0, 1))(S, b)
    y = np.linalg.solve(S, d)
    assert np.asarray(b_bar) == pytest.approx(y, rel=1e-11)
    assert np.asarray(S_bar) == pytest.approx(-np.outer(y, x), rel=1e-11, abs=1e-15)
    h = 1e-5
    second = jax.jvp(lambda e: jax.grad(lambda e: d @ symmetric_solve(S + e * T, b))(e), (0.0,), (1.0,))[1]
    slope = jax.grad(lambda e: d @ symmetric_solve(S + e * T, b))
    assert float(second) == pytest.approx(float((slope(h) - slope(-h)) / (2 * h)), rel=1e-6)


@pytest.mark.parametrize("axes", [(0, 0), (0, None), (None, 0), (None, 1), (2, 1)])
def test_symmetric_solve_batches(axes):
    S = jnp.stack([spd(k) for k in range(3)])
    b = jnp.asarray(np.random.default_rng(5).standard_normal((3, 5)))
    expected = np.stack(
        [np.linalg.solve(S[0 if axes[0] is None else k], b[0 if axes[1] is None else k]) for k in range(3)]
    )
    matrices = S[0] if axes[0] is None else jnp.moveaxis(S, 0, axes[0])
    sides = b[0] if axes[1] is None else jnp.moveaxis(b, 0, axes[1])
    assert np.asarray(jax.vmap(symmetric_solve, axes)(matrices, sides)) == pytest.approx(expected, rel=1e-10)
    gradient = jax.grad(lambda s: jnp.sum(jax.vmap(symmetric_solve, axes)(matrices, s) ** 2))(sides)
    assert np.isfinite(gradient).all()


def test_elimination_order_keeps_an_arrow_sparse():
    # An arrow matrix: taken from the tip it fills completely, from the tail not at all.
    n = 7
    nonzero = np.eye(n, dtype=bool)
    nonzero[0] = nonzero[:, 0] = True
    order = _minimum_degree_order(nonzero)
    assert sorted(order) == list(range(n))
    assert 0 in order[-2:]

    def solve(diagonal, edge, b):
        S = (jnp.eye(n) * diagonal).at[0, 1:].set(edge).at[1:, 0].set(edge)
        return symmetric_solve(S, b)

    shapes = [jax.ShapeDtypeStruct((k,), jnp.float64) for k in (n, n - 1, n)]
    program = sj.compiler.scalarize(solve, *shapes)
    assert program.n_operations < 10 * n  # about 150 when it fills
    diagonal, edge, b = jnp.full(n, 5.0), jnp.linspace(0.1, 0.6, n - 1), jnp.arange(1.0, n + 1)
    assert np.asarray(program(diagonal, edge, b)) == pytest.approx(np.asarray(solve(diagonal, edge, b)), rel=1e-13)


def test_sums_over_nothing():
    def function(x):
        nothing = x[:0]
        return jnp.sum(nothing) + nothing @ nothing + x @ jnp.zeros((3, 0)) @ jnp.zeros(0) + x[0]

    x = jnp.array([2.0, 3.0, 4.0])
    assert float(sj.compiler.scalarize(function, x)(x)) == function(x) == 2.0


QUICK = "four_bar_ideal", "four_bar_friction", "four_bar_bushing", "pendulum", "heavy_top"
SCENES = {case.name: case.build for case in cases.CASES} | {
    name: getattr(sj.gallery, name)
    for name in (
        "andrews", "bricard", "car_axis", "double_pendulum", "double_wishbone", "governor", "heavy_top", "hip",
        "mcpherson", "slider_crank", "suspension",
    )
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in SCENES]
)
def test_the_derivative_of_what_remains_in_a_loop_is_that_of_the_array_code(name):
    """By every number: what is evaluated ahead of a loop may hide what only a derivative rule reads, a weight say."""
    system = compile_scene(SCENES[name]()).system
    structure, theta = flatten_system(system)
    y = initial_state(system, jax.tree.map(jnp.asarray, assemble_now(*flatten_system(as_ideal(system)))))
    moving = np.delete(np.arange(len(theta)), [i for i, _ in structure.special])  # the others are folded
    along = np.zeros(len(theta))
    along[moving] = np.asarray(theta)[moving] * np.cos(moving)
    scalar, array = (program_for(state_rate, structure, path) for path in (True, False))
    primals = jnp.asarray(theta), y
    tangents = jnp.asarray(along), 1e-5 * jnp.cos(jnp.arange(1.0, 1.0 + y.size))

    def inside(theta, y):
        return scalar.inside(theta, scalar.ahead(theta), 0.1, y)

    expected = np.asarray(jax.jvp(lambda theta, y: array(theta, 0.1, y), primals, tangents)[1])
    with machine_code.native_code():
        found = jax.jit(lambda *tangents: jax.jvp(inside, primals, tangents)[1])(*tangents)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11 * np.max(np.abs(expected)))


def test_a_constant_that_is_put_on_a_device_stays_what_it_is():
    """As `jnp` does with constants of a function in some versions of JAX, in films among them."""
    x = jnp.array([0.3, -1.2])
    made = scalarize(lambda x: jax.device_put(x) * jax.device_put(jnp.array([2.0, 3.0])), x)
    np.testing.assert_allclose(made(x), [0.6, -3.6], rtol=1e-15)
