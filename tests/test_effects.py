"""Only the effects that a scene calls for are in its program."""

import cases
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.model.system import flatten_system
from spherejax.motion.equations import programs
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for


def program_of(scene):
    system = sj.equations.compile_scene(scene).system
    structure, theta = flatten_system(system)
    return system, program_for(state_rate, structure), theta


def of_model(model):
    return program_of(sj.gallery.four_bar(model))


def jaxpr_of(scene) -> str:
    """The whole right-hand side as text."""
    system, program, theta = program_of(scene)
    return str(jax.make_jaxpr(program)(theta, 0.0, jnp.zeros(system.layout.size)))


def primitives(scene) -> set[str]:
    """Names of all operations in the right-hand side."""
    return set(program_of(scene)[1].scalar.operations)


def primitives_inside(scene) -> set[str]:
    """Of those that each evaluation makes; the roots of moments of inertia are taken once."""
    line = program_of(scene)[1].scalar._line("rest")
    return set(line.graph.count(line._flat, line.flat_residuals))


FRICTION_OPERATIONS = {"tanh", "exp"}


def test_frictionless_program_has_no_friction_operation():
    frictionless = primitives(sj.gallery.four_bar(cases.FOUR_BAR_MODELS["dry"]))
    assert not FRICTION_OPERATIONS & frictionless
    assert "tanh" in primitives(sj.gallery.four_bar(cases.FOUR_BAR_MODELS["friction"]))  # the check can fail
    assert "exp" in primitives(sj.gallery.four_bar(cases.MODELS["dry_lugre"]))
    # Fewer operations, and no moment on the ball at all.
    with_friction = of_model(cases.FOUR_BAR_MODELS["friction"])[1].scalar.n_operations_inside
    assert of_model(cases.FOUR_BAR_MODELS["dry"])[1].scalar.n_operations_inside < with_friction


def test_every_contact_remembers_that_it_touches_and_no_more():
    for name in ("dry_hertz", "dry_flores"):
        system, _, _ = of_model(cases.MODELS[name])
        assert system.layout.size - system.layout.n_work == 40
        assert system.contact_joints == ("coupler_rocker",)
    # Hertz's force does not read how fast the onset was.
    assert "div" in primitives(sj.gallery.four_bar(cases.MODELS["dry_flores"]))
    hertz, flores = (of_model(cases.MODELS[name])[1].scalar.n_operations_inside for name in ("dry_hertz", "dry_flores"))
    assert hertz < flores


@pytest.mark.parametrize(
    ("name", "n_memory", "n_constraints"),
    [
        ("ideal", 0, 16),
        ("dry", 1, 13),
        ("dry_lugre", 4, 13),
        ("lubricated", 1, 13),
        ("lubricated_hertz", 1, 13),
        ("bushing", 0, 13),
    ],
)
def test_states_and_rows_are_those_of_the_effects(name, n_memory, n_constraints):
    system, _, _ = of_model(cases.MODELS[name])
    # Bristles may add energy: what they put in is counted. Where others dissipate the work of constraint forces is.
    assert system.layout.n_work == (name != "ideal")
    assert (system.tracks_supply, system.tracks_constraint_work) == (
        name == "dry_lugre",
        name not in ("ideal", "dry_lugre"),
    )
    assert system.layout.size == 39 + n_memory + system.layout.n_work
    assert system.n_constraints == n_constraints
    tracked = sj.equations.compile_scene(sj.gallery.four_bar(cases.MODELS[name]), track_work=True).system
    assert tracked.layout.size - system.layout.size == (0 if name == "ideal" else 1)


def test_ideal_scene_has_no_eccentricity():
    # The length of the eccentricity needs a root and a comparison; ideal joints need neither.
    ideal = primitives_inside(sj.gallery.four_bar())
    assert not {"sqrt", "gt", "lt", "log1p", "log", "tanh", "exp", "pow"} & ideal
    assert {"sqrt", "select"} <= primitives_inside(sj.gallery.four_bar(cases.FOUR_BAR_MODELS["dry"]))


def test_film_operations_only_with_a_film():
    film = {"log1p"}
    assert film <= primitives(sj.gallery.four_bar(cases.FOUR_BAR_MODELS["lubricated"]))
    for name in ("ideal", "dry", "friction", "bushing"):
        assert not film & primitives(sj.gallery.four_bar(cases.FOUR_BAR_MODELS[name])), name


def test_bushing_that_turns_freely_has_no_rotation_operation():
    assert not {"atan2", "sin", "cos", "tan"} & primitives(sj.gallery.four_bar(cases.FOUR_BAR_MODELS["bushing"]))
    assert "atan2" in primitives(sj.gallery.four_bar(cases.MODELS["bushing_matrix"]))


# Effects that exist but are not used ---------------------------------------------------------------------------------


class NewFriction(sj.laws.AbstractStaticFriction):
    """A law that some program defines, and no scene uses."""

    mu: float = 0.1
    simulable = True

    def secant(self, speed):
        return self.mu * jnp.arctan(1e3 * speed)

    def requirements(self):
        return []


@pytest.mark.parametrize("name", cases.FOUR_BAR_MODELS)
def test_what_is_not_used_leaves_the_program_identical(name):
    scene = sj.gallery.four_bar(cases.FOUR_BAR_MODELS[name])
    before = jaxpr_of(scene)
    NewFriction()
    crank = scene.bodies["crank"]
    with_point = sj.Body(
        crank.mass, crank.inertia, crank.position, crank.quaternion, points={**crank.points, "unused": (0.1, 0.2, 0.3)}
    )
    unused = sj.Scene(
        {**scene.bodies, "crank": with_point},
        scene.joints,
        gravity=scene.gravity,
        ground_points={"unused": (1.0, 2.0, 3.0)},
        drift=scene.drift,
    )
    assert jaxpr_of(unused) == before
    # Other numbers, same program: a parameter study compiles once.
    heavier = eqx.tree_at(lambda s: s.bodies["coupler"].mass, scene, 0.2)
    assert jaxpr_of(heavier) == before
    assert program_of(heavier)[1] is program_of(scene)[1]


def test_friction_of_zero_is_still_right():
    # A coefficient that is known to be zero folds the friction away; the motion is the frictionless one.
    nothing = sj.gallery.four_bar(sj.Dry(clearance=cases.C, friction=sj.Threlfall(mu=0.0)))
    assert "tanh" not in primitives(nothing)


def test_an_effect_adds_and_takes_nothing_from_the_others():
    dry = of_model(cases.FOUR_BAR_MODELS["dry"])
    friction = of_model(cases.FOUR_BAR_MODELS["friction"])
    y = cases.displaced_state(dry[0], _start(dry[0]), 0, 0.2 * cases.C)
    y[dry[0].layout.memory_start] = 0.0  # flight: no contact force, the same motion with and without friction
    ours, theirs = (np.asarray(program(theta, 0.0, y)) for _, program, theta in (dry, friction))
    assert np.abs(ours - theirs).max() <= 1e-13 * np.abs(theirs).max()


def _start(system):
    from spherejax.motion.start.assembly import as_ideal, assemble_now

    return assemble_now(*flatten_system(as_ideal(system)))


def test_effects_say_that_a_scene_runs_on_array_code_and_what_helps(monkeypatch):
    scene = sj.gallery.chain(3)
    assert sj.effects(scene, timed=False).note == ""
    for limit in ("LARGEST_SCALAR_PROGRAM", "LARGEST_IN_MACHINE_CODE"):
        monkeypatch.setattr(programs, limit, 500)
    programs.made_program.cache_clear()
    told = sj.effects(scene, timed=False)
    programs.made_program.cache_clear()
    assert "give scalar=True" in str(told).splitlines()[-1]
    assert told.rows[0].n_operations == 0
    assert str(told).splitlines()[2].split()[-4:] == ["-"] * 4


def test_effects_say_that_a_single_run_is_on_array_code_and_many_are_not():
    told = sj.effects(sj.gallery.chain(20), timed=False)
    assert str(told).splitlines()[-1].startswith("The scene runs on array code")
    assert "for a single run" in told.note
    (row,) = told.rows
    assert f"{row.n_operations + row.n_operations_ahead:,} operations" in told.note
