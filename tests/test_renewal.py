"""A scene that is renewed from the one before, of which a few numbers are others, is what it is from the start."""

import warnings

import cases
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.foundations.behind_tracers import known_behind
from spherejax.foundations.errors import SceneError
from spherejax.model.picking import picked
from spherejax.model.renewal import Compilation, Taken
from spherejax.model.system import (
    compile_scene,
    numbers_apart,
    numbers_renewed,
    structure_and_numbers,
    with_laws_by_factor,
)
from spherejax.motion.integration.problem import RunMethod
from spherejax.motion.runs import preparation
from spherejax.motion.runs import simulate as simulating
from spherejax.motion.settings import settings_from
from spherejax.motion.solvers.automatic import choice_by_structure, choose_solver
from spherejax.motion.start.doubts import doubts_of
from spherejax.motion.start.start_now import known_start, usual_start
from spherejax.motion.start.tolerances import component_tolerances, controller_for, known_tolerances
from spherejax.program_cache.keys import KeyedTree, LruCache


def two_arms(hinge, ball) -> sj.Scene:
    """A scene with parts of many kinds."""
    arm = sj.Body(1.0, (1e-2, 1e-2, 1e-3), (0.3, 0.0, 0.0), points={"end": (-0.3, 0.0, 0.0), "tip": (0.3, 0.0, 0.0)})
    rod = sj.Body(0.5, np.diag([2e-3, 1e-2, 1e-2]), (0.9, 0.0, 0.0), points={"end": (-0.3, 0.0, 0.0)})
    joints = {
        "hinge": sj.Revolute(("ground", "arm"), "arm.end", (0.0, 1.0, 0.0), hinge),
        "ball": sj.Spherical("arm.tip", "rod.end", ball),
    }
    forces = {
        "spring": sj.SpringDamper(("ground.hook", "rod.end"), 100.0, 1.0, 0.3),
        "control": sj.PID(sj.Turn(("ground", "arm"), axis=(0.0, 1.0, 0.0)), 0.1, proportional=3.0, integral=0.5),
    }
    return sj.Scene({"arm": arm, "rod": rod}, joints, forces, ground_points={"hook": (0.9, 0.0, 0.3)})


SCENES = {
    "dry": lambda: sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1, v1=1e-3))),
    "bushing": lambda: two_arms(sj.Ideal(), cases.MODELS["bushing"]),
    "film": lambda: two_arms(cases.JOURNALS["warm"], cases.MODELS["lubricated"]),
}
OTHERS = {f"ball {name}": lambda model=model: two_arms(sj.Ideal(), model) for name, model in cases.MODELS.items()} | {
    f"journal {name}": lambda model=model: two_arms(model, sj.Ideal()) for name, model in cases.JOURNALS.items()
}


def bits(leaves):
    return [(type(leaf), np.shape(leaf), np.asarray(leaf).tobytes()) for leaf in leaves]


def from_the_start(scene):
    system = Taken.apart(compile_scene(scene).system)
    return system, Taken.apart(with_laws_by_factor(system.whole()))


def with_leaf(scene, place, value):
    leaves, tree = jax.tree.flatten(scene)
    leaves[place] = value
    return jax.tree.unflatten(tree, leaves)


CHANGES_OF_A_NUMBER = (
    lambda x: x * 1.001 + 1e-6,
    lambda x: -x,
    lambda x: 0 * x,
    lambda x: 0 * x + 1,
    lambda x: x / 0.0,
)


@pytest.mark.parametrize(
    "build",
    [pytest.param(build, id=name) for name, build in SCENES.items()]
    + [pytest.param(build, id=name, marks=pytest.mark.slow) for name, build in OTHERS.items()],
)
@np.errstate(all="ignore")  # of infinity laws compute what is none
def test_each_number_that_changes_makes_what_it_makes_from_the_start(build):
    """Each leaf of a scene, made another number, a structural one, one that is refused, and none: a renewal is the
    same to the last bit, or there is none."""
    scene = build()
    reading = KeyedTree(scene)
    compilation = Compilation.of(reading, *from_the_start(scene))
    assert compilation is not None
    n_renewed, refused = 0, 0
    for place, leaf in enumerate(reading.leaves):
        for change in (
            lambda x: x * 1.001 + 1e-6,
            lambda x: -x,
            lambda x: 0 * x,
            lambda x: 0 * x + 1,
            lambda x: x / 0.0,
        ):
            other = with_leaf(scene, place, change(leaf))
            renewed = compilation.renewed(KeyedTree(other))
            try:
                system, seen = from_the_start(other)
            except SceneError:
                assert renewed is None
                refused += 1
                continue
            if renewed is None:
                continue
            n_renewed += 1
            assert renewed.conditions == []
            if renewed.doubts_remain:
                assert doubts_of(other, system.whole()) == doubts_of(scene, compilation.system.whole())
            for one, whole in ((renewed.system, system), (renewed.seen, seen)):
                assert one.tree == whole.tree
                assert bits(one.leaves) == bits(whole.leaves)
            mine, its = structure_and_numbers(*renewed.seen), structure_and_numbers(*seen)
            assert mine[0] == its[0]
            assert mine[1].tobytes() == its[1].tobytes()
            require_same_numbers(compilation, renewed)
    assert n_renewed > 50
    assert refused > 10


@pytest.mark.parametrize("build", [pytest.param(build, id=name) for name, build in SCENES.items()])
@np.errstate(all="ignore")
def test_two_numbers_that_change_make_what_they_make_from_the_start(build):
    """After each of them alone, and again with other numbers: what is done with one may depend on the other."""
    scene = build()
    reading = KeyedTree(scene)
    compilation = Compilation.of(reading, *from_the_start(scene))
    assert compilation is not None
    n_renewed = 0

    def require_same(changes):
        nonlocal n_renewed
        other = scene
        for place, factor in changes:
            other = with_leaf(other, place, reading.leaves[place] * factor + 1e-6)
        renewed = compilation.renewed(KeyedTree(other))
        if renewed is not None:
            n_renewed += len(changes) == 2
            for one, whole in zip((renewed.system, renewed.seen), from_the_start(other), strict=True):
                assert one.tree == whole.tree
                assert bits(one.leaves) == bits(whole.leaves)
            require_same_numbers(compilation, renewed)

    for place in range(len(reading.leaves) - 2):
        for beside in (place + 1, place + 2):
            for changes in ([(place, 1.01)], [(beside, 1.02)]):
                require_same(changes)
            for factor in (1.01, 1.03):
                require_same([(place, factor), (beside, 1.02)])
    assert n_renewed > 20


def require_same_numbers(compilation, renewed):
    """Taken over from those of before they are those of the renewed system, to the last bit."""
    structure, known, _ = numbers_apart(*compilation.seen)
    structure, known, unknown = numbers_renewed(structure, known, renewed.seen.leaves, renewed.changed)
    expected = numbers_apart(*renewed.seen)
    assert structure == expected[0]
    assert known.tobytes() == expected[1].tobytes()
    assert unknown == expected[2]


@pytest.mark.parametrize("build", [pytest.param(build, id=name) for name, build in SCENES.items()])
def test_a_number_that_is_traced_makes_what_it_made_of_a_known_one(build):
    """Each leaf of a scene traced by `jax.jvp`, twice: the second renewal goes the way that the first one has found."""
    scene = build()
    reading = KeyedTree(scene)
    compilation = Compilation.of(reading, *from_the_start(scene))
    assert compilation is not None
    n_renewed = 0

    def looked_at(leaf, place):
        nonlocal n_renewed
        other = with_leaf(scene, place, leaf)
        first, second = (compilation.renewed(KeyedTree(other)) for _ in range(2))
        assert (first is None) == (second is None)
        if first is not None:
            n_renewed += 1
            for one, another in ((first.system, second.system), (first.seen, second.seen)):
                assert one.tree == another.tree
                assert [type(leaf) for leaf in one.leaves] == [type(leaf) for leaf in another.leaves]
                mine, its = (map(np.asarray, known_behind(taken.leaves)[0]) for taken in (one, another))
                assert bits(mine) == bits(its)
            require_same_numbers(compilation, first)
            require_same_numbers(compilation, second)
        return leaf

    for place, leaf in enumerate(reading.leaves):
        jax.jvp(lambda x, place=place: looked_at(x, place), (np.asarray(leaf),), (np.ones_like(leaf),))
    assert n_renewed > 10


@pytest.fixture
def warm(monkeypatch):
    """Empty tables, and how often scenes were compiled from the start."""
    calls = []
    original = preparation.compile_scene
    monkeypatch.setattr(preparation, "compile_scene", lambda *a, **k: calls.append(a) or original(*a, **k))

    def forget():
        for function in (preparation.prepared_from, simulating._call):
            monkeypatch.setattr(function, "table", LruCache(64))
        monkeypatch.setattr(preparation, "_lasts", LruCache(64))

    forget()
    return calls, forget


TS = jnp.array([0.0, 0.01, 0.02])


def answer(scene):
    """What a call answers: the motion and all that is said, or the error."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            run = sj.simulate(scene, TS)
        except SceneError as error:
            return str(error), [str(one.message) for one in said]
    return np.asarray(run.ys).tobytes(), run.stats.explanation, [str(one.message) for one in said]


def clearance(scene, value):
    return eqx.tree_at(lambda s: s.joints["coupler_rocker"].model.clearance, scene, np.float64(value))


def mass(scene, value):
    return eqx.tree_at(lambda s: s.bodies["coupler"].mass, scene, np.float64(value))


def restitution(scene, value):
    return eqx.tree_at(lambda s: s.joints["coupler_rocker"].model.normal.restitution, scene, np.float64(value))


CHANGES = {
    "a negative mass": lambda s: mass(s, -0.1),
    "no mass": lambda s: mass(s, 0.0),
    "an infinite mass": lambda s: mass(s, np.inf),
    "a mass of one": lambda s: mass(s, 1.0),
    "masses far apart": lambda s: mass(s, 1e-7),
    "a negative clearance": lambda s: clearance(s, -1e-4),
    "a clearance that is none": lambda s: clearance(s, np.nan),
    "a clearance beyond the socket": lambda s: clearance(s, 0.02),
    "a restitution of one": lambda s: restitution(s, 1.0),
    "another restitution": lambda s: restitution(s, 0.7),
    "both": lambda s: mass(clearance(s, 2e-4), 0.2),
    "two errors": lambda s: mass(clearance(s, -2e-4), -0.2),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_warm_call_answers_as_a_first_one(warm, change):
    calls, forget = warm
    scene = sj.gallery.four_bar(sj.Dry(1e-4))
    answer(scene)
    answer(clearance(scene, 1.1e-4))
    assert len(calls) == 1
    changed = CHANGES[change](scene)
    second = answer(changed)
    forget()
    assert second == answer(changed)


def test_a_film_that_is_not_for_its_bearing_is_doubted_after_a_warm_call(warm):
    """With each scene that calls for it, and with no other."""
    calls, forget = warm
    scene = two_arms(cases.JOURNALS["short"], sj.Ideal())
    length = cases.JOURNALS["short"].film.length
    found = []
    for times in (2.0, 2.1, 0.4, 2.0):
        found.append(preparation.prepared(_with_radius(scene, times * length), False, False).doubts)
    assert len(calls) == 1
    assert found[0] == found[1] == found[3] == ()
    assert "ShortBearing" in found[2][0]
    forget()
    assert found[2] == preparation.prepared(_with_radius(scene, 0.4 * length), False, False).doubts


def _with_radius(scene, radius):
    return eqx.tree_at(lambda s: s.joints["hinge"].model.socket_radius, scene, np.float64(radius))


def test_a_start_that_is_moved_is_said_each_time(warm):
    """A `StartWarning` hangs on the clearance, too, and comes with each call."""
    del warm
    scene = sj.gallery.four_bar(sj.Dry(1e-4))
    moved = eqx.tree_at(lambda s: s.bodies["coupler"].velocity, scene, np.array([0.0, 1.0, 0.0]))
    assert not answer(scene)[-1]
    first, second = answer(moved)[-1], answer(moved)[-1]
    assert first == second != []
    assert not answer(clearance(scene, 2e-4))[-1]


def test_what_is_traced_is_renewed_with_its_conditions(warm):
    """Within a trace of a user's, after a warm call: a bad value is the status of that run."""
    calls, _ = warm
    scene = sj.gallery.four_bar(sj.Dry(1e-4))
    traced = jax.jit(lambda c: sj.simulate(_with_traced(scene, c), TS).ended)
    answer(scene)
    good, bad = traced(jnp.asarray(1e-4)), traced(jnp.asarray(-1e-4))
    assert len(calls) == 1
    assert int(good) == sj.Status.SUCCEEDED
    assert int(bad) == sj.Status.BAD_VALUE


def _with_traced(scene, value):
    return eqx.tree_at(lambda s: s.joints["coupler_rocker"].model.clearance, scene, value)


@pytest.mark.parametrize(
    "build",
    [pytest.param(build, id=name) for name, build in SCENES.items()]
    + [pytest.param(build, id=name, marks=pytest.mark.slow) for name, build in OTHERS.items()],
)
def test_what_is_read_off_the_numbers_is_what_the_system_says(build):
    """Tolerances, start and method by the vector of numbers, against those by the system, to the last bit."""
    scene = build()
    for other in (scene, mass_of_first(scene, 0.7), mass_of_first(scene, 2.0)):
        _, seen = from_the_start(other)
        structure, theta = structure_and_numbers(*seen)
        system = seen.whole()
        found, expected = known_tolerances(structure, theta, 1e-8), component_tolerances(system, 1e-8)
        scales = [entry.scale for slot in system.all_slots for entry in slot.contents]
        # A scale that is a number of its own has to be asked for.
        assert (found is not None) == all(isinstance(scale, str) for scale in scales)
        if found is not None:
            assert found.description == expected.description
            assert bits(found[:2]) == bits(expected[:2])
            control = controller_for(structure, expected.rtol, expected.atol)
            one = RunMethod.of_own_control(structure, diffrax.Dopri8(), found, 1000)
            another = RunMethod.of(structure, diffrax.Dopri8(), control, 1000)
            assert jax.tree.structure(one) == jax.tree.structure(another)
            # Of either kind of array: JAX takes both.
            assert bits(map(np.asarray, jax.tree.leaves(one))) == bits(map(np.asarray, jax.tree.leaves(another)))
        start, whole = usual_start(structure, theta), known_start(system, TS)
        assert whole is not None
        if start is not None:
            assert start.warnings == whole.warnings == ()
            assert bits(start.assembly) == bits(whole.assembly)


def mass_of_first(scene, times):
    name = min(scene.bodies)
    return eqx.tree_at(lambda s: s.bodies[name].mass, scene, np.float64(times * scene.bodies[name].mass))


def test_usual_starts_are_usual():
    """The short way is taken where it is meant to be, and not where the start has something to say."""
    for build, is_usual in ((SCENES["dry"], True), (SCENES["bushing"], False), (moving, False), (misplaced, False)):
        structure, theta = structure_and_numbers(*from_the_start(build())[1])
        assert (usual_start(structure, theta) is not None) == is_usual


def moving():
    return eqx.tree_at(lambda s: s.bodies["coupler"].velocity, SCENES["dry"](), np.array([0.0, 1.0, 0.0]))


def misplaced():
    scene = SCENES["dry"]()
    position = scene.bodies["coupler"].position
    return eqx.tree_at(lambda s: s.bodies["coupler"].position, scene, position + np.array([0.0, 0.0, 1e-3]))


def test_a_choice_by_structure_is_that_by_numbers():
    plain = sj.gallery.four_bar(sj.Dry(1e-4))
    for scene, is_decided in ((plain, True), (SCENES["dry"](), False), (SCENES["bushing"](), False)):
        structure, _ = structure_and_numbers(*from_the_start(scene)[1])
        by_structure = choice_by_structure(structure)
        assert (by_structure is not None) == is_decided
        if by_structure is not None:
            expected = choose_solver(compile_scene(scene).system, 1e-8)
            assert by_structure.reason == expected.reason
            assert type(by_structure.solver) is type(expected.solver)
            assert by_structure[2:] == expected[2:]


def test_a_function_that_computes_is_not_taken_for_one_that_picks():
    structure, theta = structure_and_numbers(*from_the_start(SCENES["dry"]())[1])
    bodies = picked(lambda s: [s.bodies["crank"].position, np.ones(2)], structure)
    crank = structure.system(theta).bodies["crank"]
    assert bodies.flat(theta).tolist() == [*crank.position, 1.0, 1.0]
    for function in (
        lambda s: 2 * s.gravity,
        lambda s: s.gravity if s.bodies["crank"].mass > 0 else s.bodies["crank"].position,
        lambda s: s.gravity if s.bodies["crank"].mass == 1.0 else s.bodies["crank"].position,
        lambda s: np.asarray(s.gravity),
        lambda s: jnp.sum(s.gravity),
        lambda s: s.gravity[0],
        lambda s: s.gravity or 1.0,
    ):
        assert picked(function, structure) is None


@pytest.mark.parametrize(
    "values", [(1e-8, 1e-9), (1, True), (True, 1), (1.0, 1), (0.0, -0.0), (np.nan, 1e-8), (None, 0.0)], ids=str
)
def test_settings_of_plain_numbers_are_not_mixed_up(values):
    for value in values:
        made = settings_from(value, value)
        assert type(made.rtol) is type(value)
        assert str(made.rtol) == str(made.atol) == str(value)
        assert settings_from(value, value) is made


@pytest.fixture(params=["clearance", pytest.param("mass", marks=pytest.mark.slow)])
def of_number(request):
    """A scene with another number, which may be traced."""
    base = sj.gallery.four_bar(sj.Dry(1e-4))
    if request.param == "clearance":
        return lambda c: _with_traced(base, c * 1e-4)
    return lambda m: eqx.tree_at(lambda s: s.bodies["coupler"].mass, base, m * 0.1)


def test_gradients_of_renewed_scenes_are_those_of_new_ones(warm, of_number):
    """Values and gradients in turns, each against empty tables; nothing that is traced is held."""
    calls, forget = warm

    def loss(x):
        return jnp.sum(sj.simulate(of_number(x), TS).position("rocker")[-1] ** 2)

    def both(x):
        return float(loss(np.float64(x))), float(jax.grad(loss)(x))

    found = [both(x) for x in (1.0, 1.1, 1.2)]
    assert len(calls) <= 2  # from the start, and the first one that is traced
    held = jax.tree.leaves([vars(entry[0]) for entry in preparation._lasts.values()], is_leaf=lambda x: x is None)
    assert not any(isinstance(leaf, jax.core.Tracer) for leaf in held)
    for x, mine in zip((1.0, 1.1, 1.2), found, strict=True):
        forget()
        assert both(x) == mine


def test_a_bad_value_behind_a_gradient_is_refused_each_time(warm):
    """After a good one too, and a good one after it is none the worse."""
    del warm
    scene = sj.gallery.four_bar(sj.Dry(1e-4))
    slope = jax.grad(lambda c: sj.simulate(_with_traced(scene, c), TS).position("rocker")[-1, 0])
    first = slope(1e-4)
    with pytest.raises(SceneError, match="'coupler_rocker': clearance"):
        slope(-1e-4)
    assert slope(1e-4) == first
