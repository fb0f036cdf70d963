"""Large systems: work that grows with the number of bodies, the array path, and the switch to it."""

import cases
import controlling
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.compiler.linear_algebra.block_pattern import BlockPattern
from spherejax.compiler.linear_algebra.blocks import block_solve
from spherejax.foundations.lanes import rows_at, sums_by_index
from spherejax.model.groups import stacks_from, stacks_of
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations import programs
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import made_program, path_of, program_for
from spherejax.motion.integration import compiling
from spherejax.motion.integration.jobs import JobKind
from spherejax.motion.integration.longest_step import longest_step
from spherejax.motion.integration.problem import Plan, initial_state
from spherejax.motion.solvers.automatic import choose_solver
from spherejax.motion.start.start_now import start_now

AGREEMENT = 1e-12  # of the largest component


def structure_of(scene):
    return flatten_system(compile_scene(scene).system)


def started(scene):
    """Structure, numbers and the assembled start."""
    system = compile_scene(scene, track_work=True).system
    start = start_now(system, np.zeros(1))
    return *flatten_system(system), np.array(initial_state(system, jax.tree.map(jnp.asarray, start)))


def spherical_chain(n):
    points = {"a": (-0.1, 0.0, 0.0), "b": (0.1, 0.0, 0.0)}
    bodies = {f"link{i}": sj.Body(0.1, (2e-4, 3e-4, 4e-4), (0.2 * i + 0.1, 0, 0), points=points) for i in range(n)}
    ends = ["ground.o", *(f"link{i}.b" for i in range(n - 1))]
    joints = {f"joint{i}": sj.Spherical(end, f"link{i}.a") for i, end in enumerate(ends)}
    joints["joint1"] = sj.Spherical(ends[1], "link1.a", sj.Bushing(1e4, 1e-3))
    return sj.Scene(bodies, joints, ground_points={"o": (0, 0, 0)})


# Operations ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("build", [sj.gallery.chain, sj.gallery.n_four_bar], ids=["chain", "n_four_bar"])
def test_operations_grow_with_the_number_of_bodies(build):
    """Not n log n nor n^2: what is added from 16 to 32 is twice what is added from 8 to 16."""
    counts = [program_for(state_rate, structure_of(build(n))[0], True).scalar.n_operations for n in (8, 16, 32)]
    assert (counts[2] - counts[1]) / (counts[1] - counts[0]) == pytest.approx(2, rel=0.02)


# The two paths -------------------------------------------------------------------------------------------------------

SCENES = {
    "chain": lambda: sj.gallery.chain(5),
    "loops_with_redundant_equations": lambda: sj.gallery.n_four_bar(3),
    "kinds_mixed": lambda: spherical_chain(5),
    "four_bar_friction": lambda: sj.gallery.four_bar(sj.Dry(cases.C, friction=sj.Threlfall())),
}


@pytest.mark.parametrize("name", SCENES)
def test_array_path_agrees_with_scalar_path(name):
    structure, theta, y = started(SCENES[name]())
    rng = np.random.default_rng(0)
    layout = compile_scene(SCENES[name](), track_work=True).system.layout
    if name != "loops_with_redundant_equations":  # inconsistent velocities have no unique answer there
        y[layout.n_position : layout.memory_start] += 0.1 * rng.standard_normal(layout.n_velocity)
    expected = program_for(state_rate, structure, True).compute(theta, 0.1, y)
    found = program_for(state_rate, structure, False).compute(theta, 0.1, y)
    assert np.abs(found - expected).max() <= AGREEMENT * np.abs(expected).max()
    assert np.abs(expected).max() > 1


def test_derivatives_of_the_array_path():
    """Forward, reverse, and differences of the scalar path."""
    structure, theta, y = started(sj.gallery.n_four_bar(2))
    array, scalar = (program_for(state_rate, structure, path) for path in (False, True))
    direction = np.random.default_rng(1).standard_normal(theta.shape) * theta
    weights = np.random.default_rng(2).standard_normal(y.shape)

    def weighted(theta):
        return weights @ array(theta, 0.0, y)

    forward = jax.jit(lambda th: jax.jvp(weighted, (th,), (jnp.asarray(direction),))[1])(theta)
    reverse = jax.jit(jax.grad(weighted))(theta) @ direction
    h = 1e-6
    above, below = (weights @ scalar.compute(theta + sign * h * direction, 0.0, y) for sign in (1, -1))
    assert reverse == pytest.approx(float(forward), rel=1e-9)
    assert forward == pytest.approx((above - below) / (2 * h), rel=1e-5)


@pytest.mark.slow
def test_a_run_and_its_gradient_on_both_paths(caplog):
    """The array code as machine code, in values, rows of sensitivities, drift's correction and the start."""
    ts = jnp.linspace(0.0, 0.3, 4)

    def end(mass, scalar):
        scene = eqx.tree_at(lambda scene: scene.bodies["link_03"].mass, sj.gallery.chain(5), mass)
        return sj.simulate(scene, ts, scalar=scalar, rtol=1e-8).ys[-1]

    with caplog.at_level("INFO", "spherejax.compiler"):
        found = jax.jvp(lambda mass: end(mass, False), (0.7,), (1.0,))
    assert not [record for record in caplog.records if record.name.endswith(("array_programs", "mapping"))]
    expected = jax.jvp(lambda mass: end(mass, True), (0.7,), (1.0,))
    for one, other, error in zip(found, expected, (1e-8, 1e-6), strict=True):
        np.testing.assert_allclose(one, other, atol=error * np.abs(other).max())
    assert np.abs(expected[1]).max() > 1e-3


def test_stacked_numbers_are_picked_from_the_flat_vector():
    structure, theta, _ = started(SCENES["kinds_mixed"]())
    direct, picked = stacks_of(structure.system(theta)), stacks_from(structure, theta)
    assert jax.tree.structure(direct) == jax.tree.structure(picked)
    for one, other in zip(jax.tree.leaves(direct), jax.tree.leaves(picked), strict=True):
        np.testing.assert_array_equal(one, other)
    assert sorted(len(group.names) for group in direct.joints) == [1, 4]


@pytest.mark.slow
def test_a_hundred_bodies_move_and_keep_their_energy():
    run = sj.simulate(sj.gallery.chain(100), jnp.array([0.0, 0.05, 0.1]), rtol=1e-7).require_success()
    assert "array code" in run.stats.explanation
    fallen = np.asarray(run.potential_energy)[0] - np.asarray(run.potential_energy)[-1]
    assert fallen > 1.0
    assert np.abs(np.asarray(run.mechanical_energy) - run.mechanical_energy[0]).max() < 1e-6 * fallen
    assert run.constraint_violation.max() < 1e-9


# The switch ----------------------------------------------------------------------------------------------------------


def test_the_path_follows_from_the_size():
    small, large = (structure_of(sj.gallery.chain(n))[0] for n in (4, 40))
    assert path_of(small) == (None, "", False)
    assert path_of(large).scalar is False
    assert f"{programs.largest_scalar_program()} scalar operations" in path_of(large).reason
    assert path_of(large, True) == (True, "scalar program: as asked for", False)
    assert path_of(small, False).scalar is False


@pytest.mark.skipif(not programs.native_code.is_available(), reason="no machine code with this jaxlib")
def test_a_network_of_many_weights_is_no_large_program(monkeypatch):
    """Its sums of products are loops of machine code: 2,112 of 2,330 operations of 1,185 weights."""
    network = sj.Network(eqx.nn.MLP(2, "scalar", 32, 2, activation=jnp.tanh, key=jax.random.key(1)))
    scene = sj.Scene(
        {"ball": sj.Body(1.0, (1, 1, 1), position=(0.5, 0, 0))}, forces={"law": controlling.NeuralForce(network)}
    )
    structure, _ = structure_of(scene)
    monkeypatch.setattr(programs, "LARGEST_IN_MACHINE_CODE", 1_000)
    for in_sums, scalar in ((10_000, None), (1_000, False)):
        monkeypatch.setattr(programs, "LARGEST_IN_SUMS", in_sums)
        made_program.cache_clear()
        assert path_of(structure).scalar is scalar
    made_program.cache_clear()


def test_large_scalar_programs_are_compiled_soon_and_a_four_bar_well(monkeypatch):
    def options(scene, scalar=None):
        return compiling.options_for(Plan(structure_of(scene)[0], (), scalar))

    four_bar = sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall()))
    assert options(four_bar) == {}
    monkeypatch.setattr(compiling, "LARGE", 1_000)
    assert options(four_bar)["xla_backend_optimization_level"] == 0
    assert options(four_bar, scalar=False) == {}, "array code needs the compiler"


def test_array_code_shows_whether_time_enters():
    """Else it takes a hundred steps for a motion of nine."""
    ts = np.linspace(0.0, 1.0, 3)
    for scalar in (True, False):
        assert longest_step(structure_of(sj.gallery.chain(3))[0], ts, scalar=scalar) is None
        driven = structure_of(sj.gallery.suspension())[0]
        assert longest_step(driven, ts, scalar=scalar) == pytest.approx(0.01)


def test_a_run_switches_by_itself_and_says_so(monkeypatch):
    """Warnings are errors here: none is given."""
    scene, ts = sj.gallery.chain(3, drift=sj.solvers.NoDriftControl()), jnp.array([0.0, 0.05])
    asked = sj.simulate(scene, ts, scalar=True)
    for limit in ("LARGEST_SCALAR_PROGRAM", "LARGEST_IN_MACHINE_CODE"):
        monkeypatch.setattr(programs, limit, 500)
    made_program.cache_clear()
    run = sj.simulate(scene, ts)
    made_program.cache_clear()
    assert run.scalar is False
    assert "array code" in run.stats.explanation
    assert "500" in run.stats.explanation
    assert "as asked for" in asked.stats.explanation
    np.testing.assert_allclose(run.ys, asked.ys, atol=1e-9)


def test_a_long_chain_alone_is_on_array_code_and_many_are_not(monkeypatch):
    """Closed loops, whose array code is slower, stay on the scalar program, and so does what is not alone."""
    chain, short, loops = (structure_of(s)[0] for s in (sj.gallery.chain(12), sj.gallery.chain(8), loops_of(25_000)))
    assert path_of(chain).scalar is None
    assert [path_of(structure).alone_on_arrays for structure in (chain, short, loops)] == [True, False, False]
    plan = Plan(chain, (), None)
    alone = compiling.for_one_run(plan, diffrax.Dopri8(), programs.MOST_ROWS_ALONE)
    assert (alone.scalar, alone.is_alone) == (False, True)
    assert compiling.for_one_run(plan, diffrax.Dopri8(), programs.MOST_ROWS_ALONE + 1) is plan
    assert compiling.for_one_run(plan, sj.solvers.Rodas5P()) is plan, "array code has no linear systems of its own"
    assert compiling.for_one_run(Plan(chain, (), True), diffrax.Dopri8()).scalar is True
    monkeypatch.setattr(programs.native_code, "is_available", staticmethod(lambda: False))
    assert path_of(chain).alone_on_arrays is False


def loops_of(n_operations):
    """The smallest chain of four-bars whose right-hand side has so many scalar operations."""
    scenes = (sj.gallery.n_four_bar(n) for n in range(5, 10))
    return next(s for s in scenes if program_for(state_rate, structure_of(s)[0]).scalar.n_operations >= n_operations)


@pytest.mark.slow
def test_a_run_alone_and_many_at_once_are_the_same_motion(monkeypatch):
    """Values and derivatives; single ones on array code, those of `jax.vmap` on the scalar program, wherever it is."""
    monkeypatch.setattr(programs, "SMALLEST_ALONE", 500)
    monkeypatch.setattr(programs, "ALIKE", 2)
    kinds, problem = [], JobKind.problem

    def noted(kind, ts, shared):
        kinds.append(kind.scalar)
        return problem(kind, ts, shared)

    monkeypatch.setattr(JobKind, "problem", noted)
    ts, masses = jnp.linspace(0.0, 0.3, 4), jnp.array([0.5, 0.7, 0.9])

    def end(mass):
        scene = eqx.tree_at(lambda scene: scene.bodies["link_03"].mass, sj.gallery.chain(4), mass)
        return sj.simulate(scene, ts).ys[-1]

    def taken(how, numbers):
        kinds.clear()
        return np.asarray(how(numbers)), set(kinds)

    alone, on_arrays = taken(lambda masses: np.stack([end(mass) for mass in masses]), masses)
    assert on_arrays == {False}
    for many in (jax.vmap(end), jax.vmap(jax.jit(end)), jax.jit(jax.vmap(end))):
        values, on = taken(many, masses)
        assert on == {None}
        np.testing.assert_allclose(values, alone, atol=1e-8 * np.abs(alone).max())
    slope, on_arrays = taken(jax.jacfwd(end), masses[1])
    slopes, on = taken(jax.vmap(jax.vmap(jax.jacfwd(end))), masses[None])
    assert (on_arrays, on) == ({False}, {None})
    np.testing.assert_allclose(slopes[0, 1], slope, atol=1e-6 * np.abs(slope).max())
    assert np.abs(slope).max() > 1e-3
    one, on_arrays = taken(jax.vmap(end), masses[:1])
    assert on_arrays == {False}, "one at once is alone"
    np.testing.assert_allclose(one[0], alone[0], atol=1e-8 * np.abs(alone).max())


def test_no_stiff_method_for_a_large_system():
    n = 40
    links = spherical_chain(n)
    run_choice = choose_solver(compile_scene(links).system, 1e-6, explicit_only=True)
    assert "Dopri8" in run_choice.reason
    assert "dense" in run_choice.reason


# The solve -----------------------------------------------------------------------------------------------------------

PATTERNS = {
    "alone": (3, ()),
    "chain": (7, tuple((i, i + 1) for i in range(6))),
    "ring": (6, (*((i, i + 1) for i in range(5)), (0, 5))),
    "hub": (9, tuple((0, i) for i in range(1, 9))),
    "all": (6, tuple((i, j) for i in range(6) for j in range(i + 1, 6))),
}
M = 3


def blocks_of(name, seed=0):
    """Pattern, blocks, and the whole matrix: positive definite."""
    n, pairs = PATTERNS[name]
    rng = np.random.default_rng(seed)
    S = np.zeros((n * M, n * M))
    for i, j in (*pairs, *((i, i) for i in range(n))):
        A = rng.standard_normal((2 * M, 2 * M))
        rows = np.r_[i * M : i * M + M, j * M : j * M + M]
        if i == j:
            rows, A = rows[:M], A[:M]
        S[np.ix_(rows, rows)] += A @ A.T
    cut = S.reshape(n, M, n, M)
    diagonal = np.stack([cut[i, :, i] for i in range(n)])
    off = np.array([cut[i, :, j] for i, j in pairs]).reshape(-1, M, M)
    return BlockPattern(n, pairs), jnp.asarray(diagonal), jnp.asarray(off), S


@pytest.mark.parametrize("name", PATTERNS)
def test_solves_blocks(name):
    pattern, diagonal, pairs, S = blocks_of(name)
    b = np.random.default_rng(1).standard_normal((pattern.n_blocks, M))
    expected = np.linalg.solve(S, b.ravel()).reshape(b.shape)
    np.testing.assert_allclose(block_solve(pattern, diagonal, pairs, b), expected, rtol=1e-9)
    program = sj.compiler.scalarize(lambda d, p, b: block_solve(pattern, d, p, b), diagonal, pairs, b)
    np.testing.assert_allclose(program.compute(diagonal, pairs, b), expected, rtol=1e-9)


def test_derivatives_of_the_block_solve():
    pattern, diagonal, pairs, _ = blocks_of("ring")
    rng = np.random.default_rng(3)
    b, weights = rng.standard_normal((2, pattern.n_blocks, M))
    turned = rng.standard_normal(diagonal.shape)
    directions = (jnp.asarray(turned + turned.transpose(0, 2, 1)), jnp.asarray(rng.standard_normal(pairs.shape)), b)

    def value(*inputs):
        return jnp.sum(weights * block_solve(pattern, *inputs))

    inputs = (diagonal, pairs, jnp.asarray(b))
    h = 1e-6
    moved = [value(*(x + sign * h * d for x, d in zip(inputs, directions, strict=True))) for sign in (1, -1)]
    difference = (moved[0] - moved[1]) / (2 * h)
    forward = jax.jvp(value, inputs, directions)[1]
    reverse = sum(jnp.sum(g * d) for g, d in zip(jax.grad(value, (0, 1, 2))(*inputs), directions, strict=True))
    assert forward == pytest.approx(float(difference), rel=1e-6)
    assert reverse == pytest.approx(float(forward), rel=1e-12)


def test_block_solve_over_lanes():
    pattern, diagonal, pairs, _ = blocks_of("chain")
    b = np.random.default_rng(4).standard_normal((5, pattern.n_blocks, M))
    alone = np.stack([block_solve(pattern, diagonal, pairs, one) for one in b])
    shared = jax.vmap(lambda one: block_solve(pattern, diagonal, pairs, one))(b)
    scaled = jax.vmap(lambda s, one: block_solve(pattern, s * diagonal, s * pairs, one))(jnp.arange(1.0, 6.0), b)
    np.testing.assert_allclose(shared, alone, rtol=1e-12)
    np.testing.assert_allclose(scaled, alone / np.arange(1.0, 6.0)[:, None, None], rtol=1e-12)


def test_redundant_rows_are_left_out_of_the_block_solve():
    pattern = BlockPattern(2, ((0, 1),))
    rows = np.random.default_rng(5).standard_normal((M, 8))
    S = np.concatenate([rows, 2 * rows]) @ np.concatenate([rows, 2 * rows]).T
    b = (S @ np.ones(2 * M)).reshape(2, M)
    cut = S.reshape(2, M, 2, M)
    x = block_solve(pattern, jnp.stack([cut[0, :, 0], cut[1, :, 1]]), jnp.asarray(cut[None, 0, :, 1]), b)
    np.testing.assert_allclose(S @ np.asarray(x).ravel(), b.ravel(), rtol=1e-10)
    assert np.count_nonzero(np.asarray(x)[0]) + np.count_nonzero(np.asarray(x)[1]) == M
    assert not np.isfinite(block_solve(pattern, -jnp.ones((2, M, M)), jnp.zeros((1, M, M)), b)).any()


def test_sums_by_index():
    rng = np.random.default_rng(6)
    values, index = rng.standard_normal((60, 2)), rng.integers(-1, 4, 60)
    expected = np.stack([values[index == i].sum(0) for i in range(5)])
    np.testing.assert_allclose(sums_by_index(jnp.asarray(values), index, 5), expected, atol=1e-13)
    np.testing.assert_array_equal(rows_at(jnp.asarray(values), [3, 1, 1]), values[[3, 1, 1]])
    np.testing.assert_array_equal(rows_at(jnp.asarray(values), [3, 4, 5]), values[3:6])
