"""A scene that was met before is not prepared again; one in which anything has changed is."""

import threading
import warnings
from dataclasses import replace

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.foundations.remembering.again import again
from spherejax.model import scene as scenes
from spherejax.model import system as systems
from spherejax.model.system import compile_scene, with_laws_by_factor
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.runs import preparation
from spherejax.motion.runs import simulate as simulating
from spherejax.motion.runs.preparation import prepared
from spherejax.program_cache.keys import LruCache, value_key

TS = jnp.array([0.0, 0.1, 0.2])
make = simulating.call_of


@pytest.fixture
def counted(monkeypatch):
    """How often scenes were compiled."""
    calls = []

    def compile_scene(scene, *, track_work=False):
        calls.append(scene)
        return original(scene, track_work=track_work)

    original = preparation.compile_scene
    monkeypatch.setattr(preparation, "compile_scene", compile_scene)
    for function in (preparation.prepared_from, simulating._call):
        monkeypatch.setattr(function, "table", LruCache(64))
    monkeypatch.setattr(preparation, "_lasts", LruCache(64))
    return calls


def pendulum(mass=1.0, **others):
    rod = sj.Body(mass, np.array([1e-2, 1e-2, 1e-3]), position=(0.3, 0.0, 0.0), points={"end": (-0.3, 0.0, 0.0)})
    joints = {"hinge": sj.Spherical("ground.pivot", "rod.end")}
    return sj.Scene({"rod": rod}, joints, forces={}, ground_points={"pivot": (0.0, 0.0, 0.0)}, **others)


def height(scene, **options):
    return float(sj.simulate(scene, TS, **options).position("rod")[-1, 2])


def test_equal_scenes_are_prepared_once(counted):
    scene = pendulum()
    first = height(scene)
    assert height(scene) == height(pendulum()) == first
    assert len(counted) == 1
    assert height(scene, rtol=1e-4) != first
    assert len(counted) == 1
    sj.simulate(scene, TS, track_work=True)
    assert len(counted) == 2


def test_whatever_changes_is_seen(counted):
    """By value: in a dictionary, within an array, in a number."""
    scene = pendulum()
    first = height(scene)
    assert height(pendulum(2.0)) < first - 1e-3
    assert len(counted) == 1  # renewed
    assert height(replace(scene, gravity=(0.0, 0.0, -1.0))) > first + 1e-3
    scene.bodies["rod"].inertia[:] = 0.2
    heavier = height(scene)
    assert heavier > first + 1e-3
    spinning = {"velocity": (0.0, 0.0, -0.3), "angular_velocity": (0.0, 1.0, 0.0)}
    scene.bodies["rod"] = replace(scene.bodies["rod"], **spinning)
    assert height(scene) != heavier
    scene.forces["pull"] = sj.AppliedWrench("rod", force=sj.functions.Constant((0.0, 0.0, 9.81)))
    assert height(scene) > heavier
    assert len(counted) == 2  # for the force


def test_what_is_changed_in_place_changes_no_other_run(counted):
    """Neither the scene that a run was made from, nor what a run hands out, is what is remembered."""
    first = height(pendulum())
    scene = pendulum()
    run = sj.simulate(scene, TS)
    scene.bodies["rod"].inertia[:] = 0.2
    for leaf in jax.tree.leaves((run.system, run.assembly)):
        if isinstance(leaf, np.ndarray) and leaf.ndim and leaf.flags.writeable:
            leaf[...] = 7.0
    for each in vars(run.system).values():
        if isinstance(each, dict):
            each.clear()
    repeated = sj.simulate(pendulum(), TS)
    assert float(repeated.position("rod")[-1, 2]) == first
    assert len(counted) == 1
    assert float(np.max(repeated.assembly.y)) < 1.1


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"rtol": 1e-5},
        {"atol": 1e-5},
        {"solver": diffrax.Tsit5()},
        {"max_steps": 2},
        {"track_work": True},
        {"stepsize_controller": diffrax.PIDController(1e-6, 1e-6, dtmax=0.05)},
    ],
    ids=str,
)
def test_a_call_that_was_made_before_is_decided_once_and_answers_alike(counted, monkeypatch, options):
    """Whatever is asked for, after a plain call of the same scene: a call is not taken for another one."""
    decided = []
    monkeypatch.setattr(simulating, "call_of", lambda *decisions: decided.append(decisions) or make(*decisions))
    scene = pendulum()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.SimulationWarning)
        height(scene)
        first, second = (sj.simulate(scene, TS, **options) for _ in range(2))
        simulating._call.table.clear()
        alone = sj.simulate(scene, TS, **options)
    # A controller holds functions, which are not compared: it is looked at each time.
    assert len(decided) == (4 if "stepsize_controller" in options else 3 if options else 2)
    for other in (second, alone):
        assert jax.tree.structure(other) == jax.tree.structure(first)
        assert all(map(same, jax.tree.leaves(other), jax.tree.leaves(first)))
        assert not [1 for one, two in zip(arrays(other), arrays(first), strict=True) if np.shares_memory(one, two)]
    if options.get("max_steps"):
        with pytest.raises(sj.SimulationError):
            sj.simulate(scene, TS, throw=True, **options)


def same(one, other):
    return np.array_equal(one, other, equal_nan=True)


def arrays(run):
    """What somebody could write into."""
    return [leaf for leaf in jax.tree.leaves(run) if isinstance(leaf, np.ndarray)]


def test_other_times_are_another_call(counted):
    times = np.array([0.0, 0.1, 0.2])
    scene = pendulum()
    first = sj.simulate(scene, times).ys[-1]
    times[-1] = 0.15
    assert np.abs(first - sj.simulate(scene, times).ys[-1]).max() > 0.1
    assert len(simulating._call.table) == 2
    with pytest.raises(sj.SceneError, match="increase"):
        sj.simulate(scene, times[::-1])
    sj.simulate(scene, list(times))  # not remembered: a list is slow to compare
    assert len(simulating._call.table) == 2


def test_only_so_many_calls_are_kept(monkeypatch, counted):
    monkeypatch.setattr(simulating._call.table, "size", 2)
    scene = pendulum()
    for rtol in (1e-4, 1e-5, 1e-6):
        height(scene, rtol=rtol)
    assert len(simulating._call.table) == 2
    sj.simulate(scene, jnp.linspace(0.0, 1e-3, simulating.MOST_TIMES + 1))
    assert len(simulating._call.table) == 2


@pytest.mark.parametrize(
    ("of", "is_remembered"),
    [
        (lambda a, b: {"b": b, "a": (a, None)}, True),
        (lambda a, b: {"b": b, "a": a, "more": 1}, False),  # a leaf of its own, which could be taken for a place
        (lambda a, b: {"b": b}, True),
        (lambda a, b: [a, a, b], True),
    ],
)
def test_leaves_go_straight_to_their_places_only_where_there_are_no_others(of, is_remembered):
    made = []
    function = again(lambda a, b: made.append(1) or of(a, b))
    for a, b in ((1.0, [2.0, 3.0]), (4.0, [5.0, 6.0]), (7.0, [8.0, 9.0]), (0.0, [1.0, 2.0])):
        assert function(a, b) == of(a, b)
    assert len(made) == (3 if is_remembered else 7)


def test_parts_that_are_equal_are_looked_at_once(monkeypatch):
    """Another number of one joint: the other parts are neither checked nor placed again."""
    for module, name in ((scenes, "_right"), (systems, "_parts")):
        monkeypatch.setattr(module, name, LruCache(1024))
    looked, placed = [], []
    original = sj.Spherical.requirements, sj.Spherical.placed
    monkeypatch.setattr(sj.Spherical, "requirements", lambda joint: looked.append(joint) or original[0](joint))
    monkeypatch.setattr(sj.Spherical, "placed", lambda joint, *of: placed.append(joint) or original[1](joint, *of))

    def compiled(stiffness, **others):
        scene = sj.gallery.four_bar(sj.Bushing(stiffness, 1e-4))
        scene.bodies["crank"] = replace(scene.bodies["crank"], **others)
        return compile_scene(scene).system

    first = compiled(1e6)
    n = len(looked)
    assert n == len(placed) == sum(isinstance(j, sj.Spherical) for j in sj.gallery.four_bar().joints.values())
    second = compiled(2e6)
    assert (len(looked), len(placed)) == (n + 1, n + 1)
    assert float(second.joints["coupler_rocker"].model.law.stiffness) == 2e6
    again = compiled(1e6)
    assert (len(looked), len(placed)) == (n + 1, n + 1)
    assert value_key(again) == value_key(first)
    assert float(compiled(1e6, mass=0.5).bodies["crank"].mass) == 0.5
    assert len(placed) == n + 1  # between bodies that are drawn as before
    compiled(1e6, position=(0.0, 0.0, 1e-6))
    assert len(placed) == 2 * n + 1  # between other bodies
    assert len(looked) == n + 1


def test_what_is_written_into_a_part_changes_no_other_scene():
    """Parts that are remembered belong to nobody: neither to the scene they were found in nor to a system."""

    def place():
        return np.array([-0.3, 0.0, 0.0])

    def system(end):
        rod = sj.Body(1.0, np.array([1e-2, 1e-2, 1e-3]), position=(0.3, 0.0, 0.0), points={"end": end})
        joints = {"hinge": sj.Spherical("ground.pivot", "rod.end")}
        return compile_scene(sj.Scene({"rod": rod}, joints, ground_points={"pivot": (0.0, 0.0, 0.0)})).system

    end = place()
    first, second = system(end), system(place())
    before = value_key(first)
    assert value_key(second) == before
    end[:] = 0.0
    for each in (first, second):
        each.joints["hinge"].ball_place[:] = 7.0
        each.bodies["rod"].inertia[:] = 7.0
    assert value_key(system(place())) == before
    assert value_key(system(end)) != before


def test_a_part_in_the_wrong_place_is_refused_where_it_is_right_elsewhere():
    body = pendulum().bodies["rod"]
    height(pendulum())
    with pytest.raises(sj.SceneError, match=r"(?s)joint 'hinge' = Body.* is no joint"):
        compile_scene(sj.Scene({"rod": body}, {"hinge": body}))


def test_a_scene_that_is_wrong_is_wrong_again(counted):
    for _ in range(2):
        with pytest.raises(sj.SceneError, match="mass"):
            height(pendulum(-1.0))
    assert len(counted) == 2


def test_warnings_are_given_each_time():
    scene = pendulum()
    scene.bodies["rod"] = replace(scene.bodies["rod"], velocity=(1.0, 0.0, 0.0))
    for _ in range(2):
        with pytest.warns(sj.errors.StartWarning, match="rod"):
            height(scene)


def test_traced_numbers_are_not_remembered_and_leave_nothing_behind(counted):
    def end(mass):
        scene = pendulum(gravity=(0.0, 0.0, -9.81 * mass))
        return sj.simulate(scene, TS).position("rod")[-1, 2]

    compiled = jax.jit(end)
    assert float(compiled(1.0)) == pytest.approx(height(pendulum()), abs=1e-9)
    assert all(
        not isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves([*preparation.prepared_from.table.values()])
    )

    @jax.jit
    def known(x):
        return x + sj.simulate(pendulum(3.0), TS).position("rod")[-1, 2]

    # Nothing that belongs to a trace is remembered.
    assert float(known(0.0)) == pytest.approx(height(pendulum(3.0)), abs=1e-12)
    assert float(jax.vmap(known)(jnp.zeros(2))[1]) == pytest.approx(height(pendulum(3.0)), abs=1e-12)


def test_a_driven_start_depends_on_its_time(counted):
    def scene():
        bodies, axis = ("ground", "rod"), (0.0, 1.0, 0.0)
        driver = sj.RotationDriver(bodies, axis, angle=sj.functions.Linear(slope=1.0))
        return replace(pendulum(), joints={"hinge": sj.Revolute(bodies, (0.0, 0.0, 0.0), axis), "motor": driver})

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.errors.StartWarning)
        early, late, twice = (
            np.asarray(sj.simulate(scene(), jnp.array(ts)).ys[0]) for ts in ([0.0, 0.1], [0.5, 0.6], [0.0, 0.1])
        )
    assert np.array_equal(early, twice)
    assert np.max(np.abs(early - late)) > 0.1
    assert len(counted) == 1


def test_only_so_many_are_kept(monkeypatch, counted):
    table = preparation.prepared_from.table
    monkeypatch.setattr(table, "size", 2)
    # Other places of a body: of other masses a scene is renewed from the one before.
    for height in (1.0, 2.0, 3.0, 1.0, 3.0):
        scene = pendulum()
        scene.ground_points["pivot"] = np.array([0.0, 0.0, height])
        prepared(scene, False, None)
    assert len(counted) == 4
    assert len(table) == 2


def test_threads_share_them(counted):
    found = []
    threads = [threading.Thread(target=lambda: found.append(prepared(pendulum(), False, None))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({one.structure for one in found}) == 1
    assert prepared(pendulum(), False, None) in found


def test_what_cannot_be_compared_is_not_remembered():
    assert value_key({"a": object()}) is None
    assert value_key({"a": np.array([None])}) is None
    assert value_key({"a": 1.0}) != value_key({"a": 1}) != value_key({"a": True})
    assert value_key({"a": np.nan}) == value_key({"a": np.nan})
    assert value_key({"a": 0.0}) != value_key({"a": -0.0})


def test_another_law_of_impact_needs_no_other_program():
    """Laws that differ in a factor alone are one program; what a run tells is still its own law."""
    laws = [law(restitution=0.9) for law in (sj.LankaraniNikravesh, sj.HuntCrossley, sj.Flores, sj.ExactRestitution)]
    scenes = [sj.gallery.four_bar(sj.Dry(1e-4, normal=law)) for law in laws]
    found = [prepared(scene, False, None) for scene in scenes]
    assert len({each.structure for each in found}) == 1
    assert len({each.known.tobytes() for each in found}) == len(laws)
    system = found[2].system()
    assert type(system.joints["coupler_rocker"].model.normal) is type(laws[2])
    assert float(system.joints["coupler_rocker"].model.normal.restitution) == 0.9
    other = sj.gallery.four_bar(sj.Dry(1e-4, normal=sj.Hertz()))  # which remembers no onset
    assert prepared(other, False, None).structure != found[0].structure


@pytest.mark.parametrize("law", [sj.LankaraniNikravesh, sj.ExactRestitution])
@pytest.mark.parametrize("given", [0.9, np.float64(0.9), jnp.array(0.9)], ids=["a float", "of NumPy", "of JAX"])
def test_the_factor_of_a_known_number_is_known_within_jit_too(law, given):
    unknown, law = [], law(restitution=given)
    factor = float(law.hysteresis_factor())

    def look(clearance):
        found = prepared(sj.gallery.four_bar(sj.Dry(clearance, normal=law)), False, None)
        unknown.append(found.unknown)
        return clearance

    jax.jit(look)(1e-4)
    alone = prepared(sj.gallery.four_bar(sj.Dry(1e-4, normal=law)), False, None)
    assert not alone.unknown
    (at,) = np.flatnonzero(np.abs(alone.known - factor) < 1e-15)
    assert unknown[0]
    assert at not in unknown[0]


def test_a_run_by_the_factor_is_that_by_the_law():
    """Against the array code, which sees the law itself; derivatives of the force are in `test_laws_normal.py`."""
    law = sj.Flores(restitution=0.6)
    scene = sj.gallery.four_bar(sj.Dry(1e-4, normal=law))
    run = sj.simulate(scene, jnp.linspace(0.0, 0.05, 11), rtol=1e-9)
    assert run.stats.n_onsets[0] > 0
    by_law = compile_scene(scene).system
    for i in (0, 5, 10):
        t, y = run.ts[i], run.ys[i]
        np.testing.assert_allclose(
            state_rate(with_laws_by_factor(by_law), t, y), state_rate(by_law, t, y), rtol=1e-12, atol=1e-12
        )
    assert type(run.system.joints["coupler_rocker"].model.normal) is type(law)
    assert float(run.system.joints["coupler_rocker"].model.normal.restitution) == 0.6
