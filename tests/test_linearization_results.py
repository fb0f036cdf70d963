"""What is made of a linearization: derivatives of modes, responses, tables, files, figures, the command; bad input."""

import csv
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from PIL import Image
from scipy.spatial.transform import Rotation
from test_equilibrium import LOADED, loaded
from test_linearization import G, double_pendulum, on_rubber, pendulum, top

import spherejax as sj
from spherejax import cli
from spherejax.model.numbers import full_path, number_at, numbers_at
from spherejax.output.plot.modes import swing
from spherejax.studies.linear.eigen import eigen

W = np.sqrt(G * 0.5 / 0.26)
"""Rate of the pendulum."""


@pytest.fixture(scope="module")
def hanging():
    """A pendulum that was found at rest."""
    return sj.linearize(pendulum(0.3), at="rest")


@pytest.fixture(scope="module")
def rubber():
    """A body on a bushing, a force on it."""
    return sj.linearize(on_rubber(), inputs="forces.push.force.x", outputs=["position.body.x", "reaction.mount.x"])


# Derivatives of eigenvalues ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "wanted"),
    [
        ("bodies.bob.mass", W * (1 - 0.25 / 0.26) / 2),
        ("bodies.bob.inertia.y", -W / 2 / 0.26),
        ("bodies.bob.inertia.x", 0.0),
        ("gravity.z", -W / 2 / G),
    ],
)
def test_derivatives_of_a_pendulum(hanging, number, wanted):
    """Of w = sqrt(m g l / (J + m l^2)), by m, J and g."""
    modes = hanging.modes()
    np.testing.assert_allclose(modes.eigenvalue_sensitivity(number), [1j * wanted], rtol=1e-9, atol=1e-12)
    slope = modes.sensitivity(0, number)
    assert slope.frequency == pytest.approx(wanted / (2 * np.pi), rel=1e-9, abs=1e-12)
    assert abs(slope.damping_ratio) < 1e-12


def test_the_derivative_by_a_length(hanging):
    """The hinge stays where it is, so that the drawn height of the body is its arm: l^2 = x^2 + z^2."""
    arm = W * (1 / 0.5 - 2 * 0.5 / 0.26) / 2
    slope = hanging.eigenvalue_sensitivity("bodies.bob.position.z")
    np.testing.assert_allclose(slope, [1j * arm * -np.cos(0.3)], rtol=1e-9)


def test_the_derivative_of_damping(rubber):
    """z = c / (2 sqrt(m k)) of the slowest translation."""
    k, c, m = 1e4, 10.0, 2.0
    modes = rubber.modes()
    mode = int(np.argmin(np.abs(modes.frequency - np.sqrt(k / m) / (2 * np.pi))))
    ratio = c / (2 * np.sqrt(m * k))
    assert modes.damping_ratio[mode] == pytest.approx(ratio, rel=1e-8)
    assert modes.damped_frequency[mode] == pytest.approx(np.sqrt((1 - ratio**2) * k / m) / (2 * np.pi), rel=1e-9)
    slope = modes.sensitivity(mode, "joints.mount.model.law.damping.0.0")
    assert slope.damping_ratio == pytest.approx(1 / (2 * np.sqrt(m * k)), rel=1e-8)
    assert abs(slope.frequency) < 1e-9
    slope = modes.sensitivity(mode, "joints.mount.model.law.stiffness.0.0")
    assert slope.damping_ratio == pytest.approx(-c / (4 * np.sqrt(m) * k**1.5), rel=1e-8)
    assert slope.frequency == pytest.approx(np.sqrt(k / m) / (4 * np.pi * k), rel=1e-8)


def by_differences(build, number, at, share=1e-5, **options):
    scene = build()
    where = number_at(scene, number)
    value = where.value(scene)
    step = share * max(abs(value), 1e-2)
    found = [
        sj.linearize(where.changed(scene, value + sign * step), at=at, **options).modes().eigenvalues
        for sign in (1, -1)
    ]
    return (found[0] - found[1]) / (2 * step)


@pytest.mark.parametrize(
    "number",
    [
        "bodies.weight.position.z",
        pytest.param("bodies.body.points.pivot.x", marks=pytest.mark.slow),
        pytest.param("forces.coil.stiffness", marks=pytest.mark.slow),
    ],
)
def test_derivatives_follow_the_rest_position(number):
    """An arm on rubber that sags under a weight: against differences of rest positions that are found anew."""

    def build():
        return loaded(LOADED["mount"]())

    slopes = sj.linearize(build(), at="rest").eigenvalue_sensitivity(number)
    np.testing.assert_allclose(slopes, by_differences(build, number, "rest"), rtol=1e-6, atol=1e-6 * abs(slopes).max())


def test_derivatives_follow_the_start():
    """A double pendulum with a coil, by where its rod is drawn, and by the coil."""

    def build():
        places = {"upper": (0.0, 0.0, 0.0), "lower": (0.0, 0.0, -0.3)}
        joint = sj.TorsionalSpring(("upper", "lower"), (0.0, 1.0, 0.0), 0.2, 0.1)
        scene = double_pendulum(lambda a, b, _: sj.Revolute((a, b), places[b], (0.0, 1.0, 0.0)))
        return sj.Scene(scene.bodies, scene.joints, {"coil": joint})

    for number in ("bodies.lower.position.z", "forces.coil.stiffness"):
        slopes = sj.linearize(build()).eigenvalue_sensitivity(number)
        wanted = by_differences(build, number, "start")
        np.testing.assert_allclose(slopes, wanted, rtol=1e-6, atol=1e-7 * abs(wanted).max())


def test_derivatives_are_for_states_without_velocities():
    with pytest.raises(sj.SceneError, match="without velocities"):
        sj.linearize(top(150.0)).eigenvalue_sensitivity("bodies.top.mass")


def door(axis=(0.0, 1.0, 0.0)):
    """A pendulum on two hinges in line, one of which is redundant."""
    hinges = {
        "left": sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        "right": sj.Revolute(("ground", "bob"), (0.0, 0.3, 0.0), axis),
    }
    return sj.Scene(pendulum().bodies, hinges)


def test_redundant_constraints_and_what_would_contradict():
    lin = sj.linearize(door())
    assert lin.degrees_of_freedom == 1
    np.testing.assert_allclose(lin.modes().eigenvalues, [1j * W], rtol=1e-9)
    np.testing.assert_allclose(lin.eigenvalue_sensitivity("bodies.bob.inertia.y"), [-1j * W / 2 / 0.26], rtol=1e-9)
    with pytest.raises(sj.SceneError, match="redundant joints hold only as they are"):
        lin.eigenvalue_sensitivity("joints.right.axis.x")


def test_a_mechanism_without_freedom_has_no_states():
    lin = sj.linearize(driven(), inputs="gravity.x", outputs=["reaction.axle.x", "position.disc.x"])
    assert lin.A.shape == (0, 0)
    assert len(lin.modes()) == 0
    # The axle carries the weight at any frequency.
    np.testing.assert_allclose(lin.frequency_response([0.0, 5.0])[:, :, 0], [[-1.0, 0.0]] * 2, atol=1e-12)


def test_a_run_is_held_where_a_number_would_move_its_constraints(hanging):
    run = sj.simulate(pendulum(0.3), jnp.linspace(0.0, 0.2, 3))
    lin = sj.linearize(run, at=0.1)
    assert not lin.is_steady
    # About a moment: theta'' = -(m g l / J) cos(theta) theta.
    angle = np.arcsin(float(run.position("bob")[1, 0]) / 0.5)
    np.testing.assert_allclose(np.abs(lin.modes().eigenvalues), W * np.sqrt(np.cos(angle)), rtol=1e-7)
    standing = sj.linearize(run, at=0.0)
    assert np.all(np.isfinite(standing.eigenvalue_sensitivity("bodies.bob.mass")))
    with pytest.raises(sj.SceneError, match="moves the constraints"):
        standing.eigenvalue_sensitivity("joints.pivot.places.1.x")


# Eigenvalues by themselves -------------------------------------------------------------------------------------------


def test_zero_eigenvalues_do_not_hide_slow_ones():
    """A chain of two zeros beside rates of 1e-3 and 1e6: the zeros would be computed as +-1e-2 or so."""
    A = np.zeros((6, 6))
    A[0, 1] = 1.0
    A[2:4, 2:4] = [[0.0, 1.0], [-1e-6, -1e-5]]
    A[4:, 4:] = [[0.0, 1.0], [-1e12, -1e3]]
    A[0, 4] = 3.0
    found = eigen(A)
    assert found.n_zero == 2
    slow = found.values[np.argsort(np.abs(found.values))[:2]]
    np.testing.assert_allclose(np.sort_complex(slow), np.sort_complex(np.roots([1.0, 1e-5, 1e-6])), rtol=1e-9)
    residual = A @ found.right - found.right * found.values
    assert np.abs(residual).max() < 1e-9 * np.abs(A).max()
    np.testing.assert_allclose(np.sum(found.left.conj() * found.right, 0), 1.0, rtol=1e-9)
    left = found.left.conj().T @ A - found.values[:, None] * found.left.conj().T
    assert np.abs(left / np.abs(found.left).max(0)[:, None]).max() < 1e-6 * np.abs(A).max()


def test_what_rounding_leaves_is_no_mode():
    """Rods that are let go in the horizontal: gravity has no derivative there but what rounding leaves."""
    modes = sj.linearize(sj.gallery.chain(5)).modes()
    assert (len(modes), modes.n_zero) == (0, 10)


def test_a_slow_mode_is_no_zero():
    """A wheel whose center hangs a micrometer below its hinge: w^2 = m g d / (J + m d^2)."""
    wheel = sj.Body(2.0, (1e-2, 2e-2, 1e-2), (0.0, 0.0, -1e-6))
    modes = sj.linearize(
        sj.Scene({"wheel": wheel}, {"hinge": sj.Revolute(("ground", "wheel"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))})
    ).modes()
    assert modes.n_zero == 0
    assert abs(modes.eigenvalues[0]) == pytest.approx(np.sqrt(2.0 * 9.81 * 1e-6 / 2e-2), rel=1e-9)


def test_a_free_body_has_twelve_zeros():
    modes = sj.linearize(sj.Scene({"stone": sj.Body(1.0, (1e-2, 2e-2, 2.5e-2))}, gravity=(0.0, 0.0, 0.0))).modes()
    assert (len(modes), modes.n_zero) == (0, 12)
    assert "12 zero eigenvalues" in str(modes)
    with pytest.raises(sj.SceneError, match="none of the modes moves a body"):
        sj.plot.modes(modes)


# Output --------------------------------------------------------------------------------------------------------------


def test_tables(rubber, tmp_path):
    modes = rubber.modes()
    text = str(modes)
    assert "Modes about the start" in text
    assert "frequency [Hz]" in text
    assert "body" in text
    assert text.count("\n") == 1 + len(modes)
    assert "<table>" in modes._repr_html_()
    assert "damping ratio" in modes._repr_html_()
    assert "6 degrees of freedom, 12 states" in str(rubber)
    assert "forces.push.force.x" in str(rubber)
    table = modes.to_xarray()
    table.to_netcdf(tmp_path / "modes.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "modes.nc", engine="h5netcdf") as read:
        np.testing.assert_array_equal(read["frequency"], modes.frequency)
        assert read["shape_real"].sel(body="body", component="turn_z").shape == (len(modes),)
    matrices = rubber.to_xarray()
    np.testing.assert_array_equal(matrices["A"], rubber.A)
    assert list(matrices["output"].values) == ["position.body.x", "reaction.mount.x"]
    matrices.to_netcdf(tmp_path / "matrices.nc", engine="h5netcdf")


def test_the_basis_gives_changes_of_the_state(rubber):
    np.testing.assert_allclose(rubber.inverse @ rubber.basis, np.eye(12), atol=1e-12)
    # B: a force on 2 kg; states are mass-weighted.
    push = rubber.basis[6:9, 6:] @ rubber.B[6:]
    np.testing.assert_allclose(push[:, 0], [0.5, 0.0, 0.0], atol=1e-12)


def test_a_state_space_of_python_control(rubber):
    control = pytest.importorskip("control")
    system = rubber.to_control()
    assert isinstance(system, control.StateSpace)
    f = np.array([1.0, 7.0])
    response = system(2j * np.pi * f)
    np.testing.assert_allclose(response[0, 0], rubber.frequency_response(f)[:, 0, 0], rtol=1e-10)


def test_figures(rubber, tmp_path):
    response = rubber.frequency_response(np.geomspace(1.0, 100.0, 50))
    figure = sj.plot.bode(response)
    assert len(figure.axes[0].lines) == 2
    assert sj.plot.bode(0 * response).axes[0].get_yscale() == "linear"
    assert len(sj.plot.bode({"a": response, "b": 2 * response}).axes[0].lines) == 4
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), np.abs(response[:, 0, 0]))
    drawn = sj.plot.modes(rubber.modes(), [0, 2])
    assert [ax.get_title().split(":")[0] for ax in drawn.axes] == ["mode 0", "mode 2"]
    drawn.savefig(tmp_path / "modes.png")
    assert rubber.modes().figure().axes


def test_a_film_swings_as_the_mode_does(hanging):
    """By A cos(w t) about the hinge's axis, also between the poses that were computed; no jump at its end."""
    modes = hanging.modes()
    motion, period = swing(modes, 0, 0.2)
    assert period == pytest.approx(2 * np.pi / W)
    y = np.asarray(hanging.point.y)
    rest = Rotation.from_quat(y[3:7], scalar_first=True)
    ts = np.linspace(0.0, motion.ts[-1], 77)
    turned = [Rotation.from_quat(motion.pose(t).quaternions["bob"], scalar_first=True) for t in ts]
    angles = np.array([(each * rest.inv()).as_rotvec() for each in turned])
    amplitude = angles[0, 1]
    assert 0.05 < abs(amplitude) < 1.5
    wanted = amplitude * np.cos(W * ts)
    np.testing.assert_allclose(angles, wanted[:, None] * [0.0, 1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(period - motion.ts[-1], np.diff(motion.ts), rtol=1e-9)
    moved = np.array([motion.pose(t).positions["bob"] for t in ts]) - y[:3]
    np.testing.assert_allclose(moved, wanted[:, None] * np.cross([0.0, 1.0, 0.0], y[:3]), atol=1e-6)


def test_a_film_of_a_mode(hanging, tmp_path):
    modes = hanging.modes()
    path = modes.animate(tmp_path / "films" / "mode.gif", fps=10, reach=0.2)
    with Image.open(path) as film:
        assert (film.n_frames, film.info["duration"], film.info["loop"]) == (20, 100, 0)
        frames = []
        for k in range(20):
            film.seek(k)
            frames.append(np.asarray(film.convert("L"), float)[60:])  # below the line with the time
    # Both ways through the rest look alike but for rounding, and the ends of the swing do not.
    assert np.mean(frames[5] != frames[15]) < 1e-3 < np.mean(frames[0] != frames[10])
    assert np.mean(frames[3] != frames[17]) < 1e-3
    with pytest.raises(sj.SceneError, match="exists"):
        modes.animate(path)
    with pytest.raises(sj.SceneError, match="no mode 1 that moves a body"):
        modes.animate(path, 1, overwrite=True)
    for draw in (lambda: modes.animate(tmp_path / "no.gif", reach=0.0), lambda: sj.plot.modes(modes, reach=np.nan)):
        with pytest.raises(sj.SceneError, match=r"reach = .* must be positive"):
            draw()
    assert not (tmp_path / "no.gif").exists()


def test_the_command_names_no_unit_of_a_pure_number(capsys):
    assert cli.main(["modes", "four-bar", "--joint", "friction", "--by", "friction.mu", "--by", "clearance"]) == 0
    out = capsys.readouterr().out
    assert "per unit of joints.coupler_rocker.model.friction.mu" in out
    assert "per m of joints.coupler_rocker.model.clearance" in out


def test_the_command(capsys, tmp_path):
    words = ["modes", "four-bar", "--at", "start", "--by", "rocker.inertia", "--out", str(tmp_path / "out")]
    words += ["--input", "gravity.z", "--output", "position.rocker.z", "--points", "20"]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert "Modes about the start" in out
    assert [f"per kg m^2 of bodies.rocker.inertia.{axis}" in out for axis in "xyz"] == [True] * 3
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "modes.nc", "modes.png", "response.csv", "response.png"
    }  # fmt: skip
    with (tmp_path / "out" / "response.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["frequency [Hz]", "Re position.rocker.z by gravity.z", "Im position.rocker.z by gravity.z"]
    assert len(rows) == 21
    assert cli.main(words) == 2
    assert "exists" in capsys.readouterr().err
    assert cli.main(["modes", "four-bar", "--input", "gravity.z"]) == 2
    assert "needs --input, --output and --out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "name", "words"),
    [
        ("--by", "clearence", "nothing of that name in the model of coupler_rocker; did you mean 'clearance'"),
        ("--by", "normal.stiffness", "is not given"),
        ("--input", "gravity.w", "its entries are x, y, z"),
    ],
)
def test_the_command_judges_names_before_it_computes(capsys, tmp_path, monkeypatch, option, name, words):
    def computes(*_, **__):
        raise AssertionError("computed before the names were looked at")

    monkeypatch.setattr(sj, "linearize", computes)
    asked = ["--output", "position.rocker.z", "--out", str(tmp_path)] if option == "--input" else []
    assert cli.main(["modes", "four-bar", "--joint", "friction", option, name, *asked]) == 2
    said = capsys.readouterr().err
    assert option in said
    assert words in said


def test_names_are_judged_before_a_rest_position_is_looked_for(monkeypatch):
    monkeypatch.setattr("spherejax.studies.linear.point.equilibrium", None)
    for asked in ({"inputs": "bodies.body.mas"}, {"outputs": "position.bodi"}):
        with pytest.raises(sj.SceneError, match="did you mean"):
            sj.linearize(on_rubber(), at="rest", **asked)


# Bad input -----------------------------------------------------------------------------------------------------------


def driven():
    return sj.Scene(
        {"disc": sj.Body(1.0, (1e-2,) * 3, angular_velocity=(0.0, 3.0, 0.0))},
        {
            "axle": sj.Revolute(("ground", "disc"), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
            "motor": sj.RotationDriver(("ground", "disc"), (0.0, 1.0, 0.0), sj.functions.Polynomial([0.0, 3.0])),
        },
    )


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (lambda: sj.linearize(3), "int is no scene and no run"),
        (lambda: sj.linearize(pendulum(), at="resting"), "it is 'start' or 'rest'"),
        (lambda: sj.linearize(pendulum(), at=0.1), "give the run"),
        (
            lambda: sj.linearize(pendulum(), inputs="forces.push.force"),
            "inputs: forces.push.force: forces has no 'push'",
        ),
        (lambda: sj.linearize(pendulum(), inputs="bodies.bob"), "is no number.*mass"),
        (lambda: sj.linearize(pendulum(), inputs="gravity.w"), "its entries are x, y, z"),
        (lambda: sj.linearize(pendulum(), inputs=["gravity", "gravity.x"]), "'gravity.x' twice"),
        (lambda: sj.linearize(pendulum(), outputs="position.bobb"), "did you mean"),
        (lambda: sj.linearize(pendulum(), outputs="mechanical_energy"), "no quantity of one instant"),
        (lambda: sj.linearize(pendulum(), turning=(0.0, 1.0)), "turning = .* three finite numbers"),
        (lambda: sj.linearize(pendulum(), t=np.nan), "t = nan"),
        (lambda: sj.linearize(driven(), inputs="joints.motor.angle.coefficients.1"), "moves a constraint"),
        (lambda: sj.linearize(pendulum()).frequency_response(1.0), "name some"),
        (lambda: sj.linearize(pendulum()).modes().shape(0, "no"), "no body 'no'"),
        (lambda: sj.linearize(pendulum()).modes().sensitivity(5, "gravity.z"), "no mode 5"),
        (lambda: sj.linearize(pendulum()).eigenvalue_sensitivity("gravity"), "name one, e.g. 'gravity.x'"),
        (lambda: sj.plot.bode(3), "bode draws"),
        (lambda: sj.plot.modes(3), "int has no modes"),
    ],
    ids=lambda given: given if isinstance(given, str) else "",
)
def test_what_makes_no_sense_is_refused(request_, words):
    with pytest.raises(sj.SceneError, match=words):
        request_()


def test_frequencies_that_make_no_sense(rubber):
    for wrong in (-1.0, [np.nan], "high", []):
        with pytest.raises(sj.SceneError, match="numbers in Hz"):
            rubber.frequency_response(wrong)


@pytest.mark.slow
def test_a_run_has_all_its_moments():
    """Between samples as at a sample there."""
    run = sj.simulate(pendulum(0.3), jnp.linspace(0.0, 0.2, 3))
    finer = sj.simulate(pendulum(0.3), jnp.array([0.0, 0.11, 0.2]))
    found, wanted = (sj.linearize(each, at=0.11, outputs="position.bob.x") for each in (run, finer))
    np.testing.assert_allclose(found.A, wanted.A, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(np.abs(found.C), np.abs(wanted.C), rtol=1e-7, atol=1e-10)
    assert "integrated on from its sample at 0.1 s" in str(found)
    with pytest.raises(sj.SceneError, match=r"at = 0\.3 s is not within the run"):
        sj.linearize(run, at=0.3)
    with pytest.raises(sj.SceneError, match="no moment of a run"):
        sj.linearize(run, at="rest")
    runs = jax.vmap(lambda m: sj.simulate(pendulum(mass=m), jnp.linspace(0.0, 0.01, 2)))(jnp.ones(2))
    with pytest.raises(sj.SceneError, match="a single run"):
        sj.linearize(runs)


def test_traced_numbers_are_refused():
    with pytest.raises(sj.SceneError, match="outside of jit"):
        jax.jit(lambda m: sj.linearize(pendulum(mass=m)).A)(1.0)


def test_a_kink_is_said():
    def scene(force):
        body = sj.Body(1.0, (1e-2,) * 3)
        return sj.Scene({"body": body}, forces={"wall": sj.AppliedWrench("body", force)}, gravity=(0.0, 0.0, 0.0))

    def pushes(t, motions):
        return jnp.array([1e3 * jnp.maximum(-motions["body"].position[0], 0.0), 0.0, 0.0])

    def smooth(t, motions):
        x = motions["body"].position[0]
        return jnp.array([1e3 * (x + 1e3 * x**2), 0.0, 0.0])

    with pytest.warns(sj.errors.LinearizationWarning, match="have a kink"):
        sj.linearize(scene(pushes))
    with warnings.catch_warnings():
        warnings.simplefilter("error", sj.errors.LinearizationWarning)
        sj.linearize(scene(smooth))


def test_numbers_by_path():
    scene = on_rubber()
    assert [n.name for n in numbers_at(scene, "forces.push.force")] == [f"forces.push.force.{a}" for a in "xyz"]
    assert number_at(scene, "bodies.body.mass").value(scene) == 2.0
    # The law of the bushing may be left out, for it alone has a stiffness.
    assert number_at(scene, "joints.mount.model.stiffness.2.2").value(scene) == 3e4
    assert full_path(scene, "body.mass") == "bodies.body.mass"
    assert full_path(scene, "stiffness.2.2", "mount").startswith("joints.mount.model.")
    assert full_path(scene, "forces.push.force.y") == "forces.push.force.y"


# In time --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_small_harmonic_force_is_answered_as_the_response_says():
    """An arm on rubber with a weight, pushed by 1e-3 N at 6 Hz until the start is forgotten: to 1 %."""
    rest = sj.equilibrium(loaded(LOADED["mount"]())).scene
    still = sj.Scene(
        rest.bodies, rest.joints, {**rest.forces, "push": sj.AppliedWrench("weight")}, ground_points=rest.ground_points
    )
    lin = sj.linearize(still, inputs="forces.push.force.x", outputs="position.weight.x")
    f, size = 6.0, 1e-3
    H = complex(lin.frequency_response(f)[0, 0, 0])
    slowest = np.min(-lin.modes().eigenvalues.real)
    end = np.ceil(f * np.log(1e4) / slowest) / f
    ts = jnp.concatenate([jnp.zeros(1), end + jnp.linspace(0.0, 1 / f, 65)])

    def push(t):
        return jnp.array([size * jnp.cos(2 * jnp.pi * f * t), 0.0, 0.0])

    pushed = sj.Scene(
        rest.bodies, rest.joints, {**rest.forces, "push": sj.AppliedWrench("weight", push)},
        ground_points=rest.ground_points,
    )  # fmt: skip
    run = sj.simulate(pushed, ts, rtol=1e-10, throw=True)
    x = np.asarray(run.position("weight"))[1:-1, 0]
    found = 2 * np.mean(x * np.exp(-2j * np.pi * f * np.asarray(ts)[1:-1])) / size
    assert abs(found - H) < 1e-2 * abs(H)
