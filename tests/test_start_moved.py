"""Starts that are assembled far from where the scene puts the bodies say so; printed digits are closed in silence."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.cli import main
from spherejax.foundations.checks import is_concrete
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.start.assembly import as_ideal, assemble_now
from spherejax.motion.start.start_now import changed_starts, known_start

TS = np.array([0.0, 1e-3])
PRINTED = {
    "coupler": {"position": (-0.03746, -0.04250, 0.04262), "quaternion": (0.9186, -0.1764, 0.06747, -0.3472)},
    "rocker": {"position": (-0.05746, -0.08500, 0.03262), "quaternion": (0.3634, -0.6066, -0.6066, 0.3634)},
}
"""The paper's Table 1."""


def changed(scene, **bodies):
    """A scene with other numbers of its bodies."""
    for name, fields in bodies.items():
        for field, value in fields.items():
            scene = eqx.tree_at(lambda s, at=(name, field): getattr(s.bodies[at[0]], at[1]), scene, jnp.asarray(value))
    return scene


def shifted(scene, name, shift):
    """A scene in which a body is put elsewhere [m]."""
    return eqx.tree_at(lambda s: s.bodies[name].position, scene, scene.bodies[name].position + np.asarray(shift))


def said(scene, ts=TS):
    """What a start says."""
    start = known_start(compile_scene(scene).system, ts)
    assert start is not None
    return " ".join(start.changes)


def test_the_four_bar_of_the_gallery_is_closed_to_rounding():
    """Before: a gap of 2.2e-10 m and quaternions of length 1 + 8e-9."""
    scene = sj.gallery.four_bar()
    start = assemble_now(*flatten_system(as_ideal(compile_scene(scene).system)))
    assert float(start.residual_before) < 3e-17
    assert np.all(np.asarray(start.y[:21]) == _described(scene)[:21])
    for body in scene.bodies.values():
        assert abs(np.linalg.norm(body.quaternion) - 1) < 2e-16


def _described(scene):
    return np.concatenate([np.r_[body.position, body.quaternion] for _, body in sorted(scene.bodies.items())])


@pytest.mark.parametrize("clearance", [1e-3, 1e-4, 2e-5, 1e-6])
def test_printed_digits_are_closed_without_a_word(clearance):
    """They leave a gap of 6e-6 m, more than the smallest of the clearances; the start is concentric all the same."""
    scene = changed(sj.gallery.four_bar(sj.Dry(clearance)), **PRINTED)
    assert said(scene) == ""
    assert 5e-6 < float(known_start(compile_scene(scene).system, TS).assembly.residual_before) < 8e-6


@pytest.mark.parametrize("name", sj.gallery.__all__)
def test_no_scene_of_the_gallery_is_moved(name):
    made = getattr(sj.gallery, name)()
    start = assemble_now(*flatten_system(as_ideal(compile_scene(made).system)))
    assert float(start.residual_before) < 1e-15


def test_a_misplaced_body_is_named_with_how_far_all_were_moved():
    scene = shifted(sj.gallery.four_bar(), "rocker", (0.05, 0.0, 0.0))
    start = known_start(compile_scene(scene).system, TS)
    assert start is not None
    (message,), found = start.changes, start.assembly
    for body, moved, turned in zip(sorted(scene.bodies), found.displacement, found.rotation, strict=True):
        assert f"{body!r} by {f'{moved:.2g}' if moved > 1e-12 else '0'} m and {turned:.2g} rad" in message
    assert "Joint 'coupler_rocker' gapes most there (0.05 m or rad)" in message
    assert "run.position(body)[0] and run.quaternion(body)[0]" in message
    # What was taken is what is proposed, and is silent.
    poses = dict(zip(sorted(scene.bodies), np.asarray(found.y[:21]).reshape(3, 7), strict=True))
    taken = {name: {"position": pose[:3], "quaternion": pose[3:]} for name, pose in poses.items()}
    assert said(changed(scene, **taken)) == ""


def test_another_branch_is_said():
    """Two bars whose elbow is described on the other side: it folds over by more than a radian."""
    scene = sj.gallery.double_pendulum()
    half = 1.3
    folded = changed(scene, lower={"quaternion": (np.cos(half), 0.0, np.sin(half), 0.0)})
    message = said(folded)
    assert "'lower' by 0." in message
    assert "'upper' by 0." in message


def bar(gap, place=0.0):
    """A bar of 1 m, from its center to the hook that it hangs on, which it misses by a gap [m]."""
    body = sj.Body(1.0, (0.1,) * 3, position=jnp.stack([place, 0.0, -1.0 - gap]), points={"top": (0.0, 0.0, 1.0)})
    joint = sj.Spherical("ground.hook", "bar.top")
    return sj.Scene({"bar": body}, {"joint": joint}, ground_points={"hook": (place, 0.0, 0.0)})


def test_a_run_says_so_where_it_is_called():
    with pytest.warns(sj.errors.StartWarning, match=r"'bar' by 0\.05 m and 0 rad\. Joint 'joint' gapes") as given:
        sj.simulate(bar(0.05), TS)
    assert [each.filename for each in given] == [__file__]


def test_the_clearance_and_the_size_decide_what_is_far():
    """A ball that is 0.3 and 0.7 clearances off; a gap of 0.1 % and of 1 % of a body; the same far from the origin."""

    def ball(offset, **options):
        body = sj.Body(0.2, (1e-5,) * 3, position=(offset, 0.0, 0.0), points={"center": (0.0, 0.0, 0.0)})
        joint = sj.Spherical("ground.socket", "ball.center", sj.Dry(1e-4), **options)
        return sj.Scene({"ball": body}, {"joint": joint}, ground_points={"socket": (0.0, 0.0, 0.0)})

    assert said(ball(3e-5)) == ""
    assert "'ball' by 7e-05 m" in said(ball(7e-5))
    assert "starts_concentric=False" in said(ball(7e-5))
    assert said(ball(7e-5, starts_concentric=False)) == ""

    for place in (0.0, 1000.0):
        assert said(bar(1e-3, place)) == ""
        assert "'bar' by 0.01 m and 0 rad" in said(bar(1e-2, place))


def test_drivers_put_a_mechanism_where_its_motion_begins_without_a_word():
    """But a body that is misplaced is named there too."""

    def driven(shift):
        body = sj.Body(1.0, (0.1,) * 3, position=(0.5 + shift, 0.0, 0.0))
        pivot = sj.Revolute(("ground", "bar"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        motor = sj.RotationDriver(("ground", "bar"), (0.0, 1.0, 0.0), sj.functions.Linear(1.0, 0.5))
        scene = sj.Scene({"bar": sj.Body(1.0, (0.1,) * 3, position=(0.5, 0.0, 0.0))}, {"pivot": pivot, "motor": motor})
        # Where joints are described the bodies are; what is misplaced is described elsewhere.
        reference = sj.Body(body.mass, body.inertia, body.position, reference_position=(0.5, 0.0, 0.0),
                            reference_quaternion=(1.0, 0.0, 0.0, 0.0))  # fmt: skip
        return sj.Scene({"bar": reference}, scene.joints)

    assert said(driven(0.0)) == ""
    assert "'bar' by " in said(driven(0.05))


def test_sweeps_and_many_runs_say_how_many_and_describe_one():
    """Also where the first and the last run are as described."""
    gaps = {"gap": np.array([0.0, 0.05, 0.0])}
    expected = (
        r"^1 of 3 runs that were looked at do not start as they are described; of run 1: where the bodies .*"
        r"'bar' by 0\.05 m and 0 rad.*\(its parameters: gap = 0\.05\)$"
    )
    with pytest.warns(sj.errors.StartWarning, match=expected) as given:
        sj.simulate_many(bar, gaps, TS, rtol=1e-4)
    with pytest.warns(sj.errors.StartWarning, match=expected) as given_by_sweep:
        sj.sweep(bar, sj.studies.zipped(gaps), TS, record=["final position.bar"], rtol=1e-4, progress=False, workers=1)
    assert [each.filename for each in [*given, *given_by_sweep]] == [__file__, __file__]


def test_one_start_is_looked_at_where_no_parameter_touches_it():
    """And sixteen of a thousand, the first and the last among them, where one does."""
    built = []

    def dry(numbers):
        if is_concrete(numbers["clearance"]):
            built.append(float(numbers["clearance"]))
        return shifted(sj.gallery.four_bar(sj.Dry(numbers["clearance"])), "rocker", (0.05, 0.0, 0.0))

    message, _ = changed_starts(dry, {"clearance": np.linspace(1e-4, 1e-3, 1000)}, TS)
    assert message.startswith("the runs do not start as they are described; of run 0: where the bodies")
    assert built == [1e-4]
    message, numbers = changed_starts(lambda numbers: bar(numbers["gap"]), {"gap": np.linspace(0.0, 0.05, 1000)}, TS)
    assert message.startswith("15 of 16 runs that were looked at")
    assert numbers["gap"] == pytest.approx(0.05 / 15, rel=1e-2)


def test_scene_files_and_the_command_line_say_so(tmp_path):
    path = tmp_path / "misplaced.toml"
    sj.save_scene(bar(0.05), path)
    with pytest.warns(sj.errors.StartWarning, match=r"'bar' by 0\.05 m and 0 rad"):
        assert main(["run", str(path), "--t1", "0.001", "--samples", "2"]) == 0
    sj.save_scene(bar(1e-3), path, overwrite=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error", sj.errors.StartWarning)
        assert main(["run", str(path), "--t1", "0.001", "--samples", "2"]) == 0


def test_a_run_goes_on_from_the_end_of_another():
    """A scene at the end of a run, with a ball off its center: exactly, where it is asked to start as described.

    Otherwise the ball is put back into the middle, and the assembly says so under `jit` too.
    """

    def bob(concentric, position=(0.0, 0.0, -0.2), velocity=(0.3, 0.0, 0.0), spin=(0.0, -1.5, 0.0), q=(1.0, 0, 0, 0)):
        body = sj.Body(0.5, (1e-3, 2e-3, 1e-3), position, q, velocity, spin, {"pin": (0.0, 0.0, 0.2)})
        joint = sj.Spherical(
            "ground.o", "bob.pin", sj.Dry(2e-5, normal=sj.Hertz(stiffness=1e9)), starts_concentric=concentric
        )
        return sj.Scene({"bob": body}, {"pin": joint}, ground_points={"o": (0.0, 0.0, 0.0)})

    def end(run, sample):
        whole = run.position, run.velocity, run.angular_velocity, run.quaternion
        return [each("bob")[sample] for each in whole]

    whole = sj.simulate(bob(False), jnp.linspace(0.0, 0.04, 5), rtol=1e-10)
    parts = end(whole, 2)
    off_center = float(jnp.linalg.norm(whole.eccentricity("pin")[2]))
    assert off_center > 1e-6
    ts = jnp.linspace(0.0, 0.02, 3)
    on = sj.simulate(bob(False, *parts), ts, rtol=1e-10)
    np.testing.assert_array_equal(on.position("bob")[0], parts[0])
    np.testing.assert_allclose(on.position("bob")[-1], whole.position("bob")[-1], atol=1e-11)
    moved = jax.jit(lambda parts: sj.simulate(bob(True, *parts), ts, rtol=1e-10).assembly.displacement)(parts)
    assert 0.1 * off_center < float(moved[0]) < 2 * off_center
