"""Which parameter matters when: derivatives along time as table, text and pictures, forward and in reverse."""

import csv

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sweeping import hanging, pendulum

import spherejax as sj
from spherejax.cli import main
from spherejax.studies.sensitivity.study import REVERSE_FROM
from spherejax.studies.sensitivity.unknowns import unknowns_of

TS = np.linspace(0.0, 0.5, 6)


def swinging(gravity, tilt, spin=0.0):
    """The pendulum with its gravity as a vector."""
    scene = pendulum(9.81, tilt)
    bob = scene.bodies["bob"]
    bob = sj.Body(bob.mass, bob.inertia, position=bob.position, velocity=spin * jnp.array([0.0, 1.0, 0.0]))
    return sj.Scene({"bob": bob}, scene.joints, gravity=gravity)


def squared_height(run):
    return run.position("bob")[:, 2] ** 2


POINT = {"gravity": [0.0, 0.0, -9.81], "tilt": 1.0}
WANTED = ["position.bob", "reaction.pivot.z", squared_height]


@pytest.fixture(scope="module")
def found():
    return sj.sensitivity(swinging, POINT, TS, observables=WANTED)


def observed(gravity, tilt):
    run = sj.simulate(swinging(gravity, tilt), TS, rtol=1e-10)
    return run.position("bob"), run.reaction("pivot")[:, 2:], squared_height(run)[:, None]


@pytest.mark.slow
def test_they_are_differences(found):
    gravity, h = np.array(POINT["gravity"]), 1e-4
    assert found.names == ["gravity[0]", "gravity[1]", "gravity[2]", "tilt"]
    for k, (g, t) in enumerate([*((np.eye(3)[i], 0.0) for i in range(3)), (np.zeros(3), 1.0)]):
        ends = [observed(gravity + s * g, 1.0 + s * t) for s in (-h, h)]
        for column, below, above in zip(found.columns, *ends, strict=True):
            differences = np.asarray(above - below) / (2 * h)
            # In reactions the drift control amplifies what the samples of the motion err by.
            within = (5e-4 if "reaction" in column.name else 1e-5) * max(1.0, np.abs(differences).max())
            np.testing.assert_allclose(column.slopes[:, :, k], differences, atol=within)


def test_the_table(found):
    table = found.to_xarray()
    assert table["sensitivity.position.bob"].dims == ("time", "axis", "parameter")
    assert table["sensitivity.reaction.pivot.z"].dims == ("time", "parameter")
    assert table["sensitivity.position.bob"].attrs["units"] == "m per unit of the parameter"
    assert table["value"].sel(parameter="tilt") == 1.0
    normalized = table["normalized.position.bob"].sel(parameter="gravity[2]")
    np.testing.assert_allclose(normalized, 9.81 * found.derivative("position.bob", "gravity[2]"))
    with pytest.raises(KeyError, match="was not asked for; there are 'position"):
        found.derivative("velocity.bob", "tilt")


def test_what_is_written(found, tmp_path):
    path = found.save(tmp_path / "table.csv")
    rows = list(csv.reader(path.read_text().splitlines()))
    assert rows[0][:2] == ["time [s]", "position.bob x [m]"]
    assert len(rows) == 1 + len(TS)
    at = rows[0].index("sensitivity.position.bob z tilt [m per unit of the parameter]")
    assert float(rows[-1][at]) == found.derivative("position.bob", "tilt")[-1, 2]
    with pytest.raises(sj.SceneError, match="exists"):
        found.save(path)


def test_what_is_told(found):
    first = found.ranking[0]
    assert first.share == max(each.share for each in found.ranking)
    text = str(found)
    assert "in forward mode" in text
    assert "the errors of the derivatives are controlled" in text
    assert "a change by 0.01 of its unit" in text  # gravity has entries that are 0
    at_tilt = next(each for each in found.ranking if each[:2] == ("tilt", "position.bob"))
    changes = np.linalg.norm(0.01 * found.derivative("position.bob", "tilt"), axis=1)
    assert at_tilt.effect == pytest.approx(np.sqrt(np.mean(changes**2)))
    assert at_tilt.t_largest == TS[np.argmax(changes)]


def test_pictures(found):
    figures = found.figures()
    assert set(figures) == {"position.bob", "reaction.pivot.z", "squared_height", "ranking"}
    panels = figures["position.bob"].axes
    assert [ax.get_ylabel() for ax in panels if "change of" in ax.get_ylabel()] == [
        f"change of position, bob, {axis} [m]"
        for axis in "xz"  # the other one does not change
    ]


@pytest.mark.slow
def test_through_impacts():
    ts = np.linspace(0.0, 0.02, 3)
    result = sj.sensitivity(hanging, {"clearance": 1e-4, "mu": 0.1}, ts, observables=["position.bob"])

    def position(clearance, mu):
        run = sj.simulate(hanging(clearance, mu), ts)
        return run.position("bob"), run.stats.n_onsets

    slopes, n_onsets = jax.jacfwd(position, (0, 1), has_aux=True)(1e-4, 0.1)
    assert int(n_onsets[0]) > 1
    slopes = np.stack(slopes, -1)
    np.testing.assert_allclose(result.columns[0].slopes, slopes, atol=1e-5 * np.abs(slopes).max())


def kinetic_end(run):
    return 0.5 * jnp.sum(run.velocity("bob")[-1] ** 2)


@pytest.mark.slow
def test_a_number_forward_and_in_reverse():
    ts = np.array([0.0, 0.3])
    results = {mode: sj.sensitivity(swinging, POINT, ts, of=kinetic_end, mode=mode) for mode in ("forward", "reverse")}
    gradients = {mode: result.columns[0].slopes.ravel() for mode, result in results.items()}
    np.testing.assert_allclose(gradients["forward"], gradients["reverse"], rtol=1e-6, atol=1e-8)
    h = 1e-4
    low, high = (kinetic_end(sj.simulate(swinging(np.array([0, 0, -9.81 + s]), 1.0), ts)) for s in (-h, h))
    assert gradients["reverse"][2] == pytest.approx(float(high - low) / (2 * h), rel=1e-5)
    assert "along a mixture of all parameters" in results["reverse"].reason
    assert set(results["forward"].figures()) == {"ranking"}


@pytest.mark.slow
def test_a_number_in_reverse_through_impacts():
    def end(run):
        return run.position("bob")[-1, 2] + 1e-3 * run.reaction("hook")[1, 0]

    ts, point = np.linspace(0.0, 0.02, 3), {"clearance": 1e-4, "mu": 0.1}
    results = [sj.sensitivity(hanging, point, ts, of=end, mode=mode) for mode in ("forward", "reverse")]
    forward, reverse = (result.columns[0].slopes.ravel() for result in results)
    np.testing.assert_allclose(reverse, forward, rtol=1e-5)


def test_the_mode_follows_the_counts():
    from spherejax.studies.sensitivity.study import _mode

    assert _mode(None, False, 1000)[0] == "forward"
    assert _mode(None, True, REVERSE_FROM - 1)[0] == "forward"
    mode, reason = _mode(None, True, REVERSE_FROM)
    assert mode == "reverse"
    assert f"{REVERSE_FROM} parameters" in reason


def test_parameters_are_named():
    unknowns, numbers = unknowns_of({"mass": 2.0, "inertia": np.eye(2), "start": sj.Parameter(3.0)})
    assert unknowns.names == ("mass", "inertia[0, 0]", "inertia[0, 1]", "inertia[1, 0]", "inertia[1, 1]", "start")
    assert numbers.tolist() == [2, 1, 0, 0, 1, 3]
    np.testing.assert_array_equal(unknowns.by_name(numbers)["inertia"], np.eye(2))


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"observables": []}, "asks for nothing"),
        ({"observables": ["speed.bob"]}, "names no quantity"),
        ({"observables": ["position.bob.w"]}, "no component 'w'"),
        ({"observables": ["position.bob", "position.bob"]}, "twice"),
        ({"observables": [3]}, "neither"),
        ({}, "needs observables="),
        ({"observables": ["position.bob"], "of": kinetic_end}, "needs observables="),
        ({"observables": ["position.bob"], "mode": "reverse"}, "serves one number alone"),
        ({"of": kinetic_end, "mode": "backward"}, "it is 'forward', 'reverse'"),
        ({"of": squared_height}, "must make one number"),
    ],
)
def test_bad_requests(request_, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.sensitivity(swinging, POINT, TS, **request_)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({}, "needs parameters by name"),
        ({"tilt": "steep"}, "must be a number"),
        ({"tilt": np.nan}, "must be finite"),
        ({"weight": 1.0}, "cannot be called with the parameters weight"),
    ],
)
def test_bad_parameters(parameters, words):
    with pytest.raises(sj.SceneError, match=words):
        sj.sensitivity(swinging, parameters, TS, observables=["position.bob"])


def test_a_failed_run_says_so(monkeypatch):
    result = sj.sensitivity(swinging, POINT, TS, observables=["position.bob"], max_steps=5)
    assert "stopped" in str(result)
    assert np.all(np.isnan(result.columns[0].slopes[-1]))
    assert np.all(np.isfinite(result.columns[0].slopes[0]))


@pytest.mark.slow
def test_the_command(tmp_path, capsys):
    out = tmp_path / "out"
    options = ["sensitivity", "four-bar", "--joint", "bushing", "--by", "stiffness=1e5", "--by", "damping"]
    options += ["--of", "position.rocker.z", "--t1", "0.05", "--samples", "6", "--out", str(out)]
    assert main(options) == 0
    assert "stiffness" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {
        "sensitivities.csv", "sensitivities.nc", "position_rocker_z.png", "ranking.png"
    }  # fmt: skip
    assert main(options) == 2
    assert "exists" in capsys.readouterr().err


def test_the_command_answers_in_the_units_that_were_asked_for(tmp_path):
    options = [
        "sensitivity",
        "four-bar",
        "--joint",
        "bushing",
        "--by",
        "stiffness=1e5",
        "--t1",
        "0.01",
        "--samples",
        "3",
    ]
    tables = []
    for quantity in ("position.rocker.z", "position.rocker.z [mm]"):
        out = tmp_path / str(len(tables))
        assert main([*options, "--of", quantity, "--out", str(out)]) == 0
        with (out / "sensitivities.csv").open() as file:
            tables.append([*csv.reader(file)])
    (heads, *rows), (heads_mm, *rows_mm) = tables
    assert "position.rocker.z [m]" in heads
    assert heads_mm == [head.replace("[m", "[mm") for head in heads]
    np.testing.assert_allclose(np.array(rows_mm, float)[:, 1:], 1e3 * np.array(rows, float)[:, 1:], rtol=1e-12)
    assert np.all(np.array(rows, float)[-1] != 0)


def test_bad_commands(capsys):
    base = ["sensitivity", "four-bar", "--of", "position.rocker"]
    assert main([*base[:3], "position.rocker.z [N]", "--joint", "bushing", "--by", "stiffness=1e5"]) == 2
    assert "a length [m] is expected" in capsys.readouterr().err
    assert main([*base, "--joint", "bushing", "--by", "stiffnes"]) == 2
    assert "--by stiffnes: no such number" in capsys.readouterr().err
    assert main([*base, "--joint", "bushing", "--by", "rocket.mass"]) == 2
    assert "no body 'rocket'" in capsys.readouterr().err
    assert main([*base, "--joint", "bushing", "--by", "stiffness=much"]) == 2
    assert "is no number" in capsys.readouterr().err
    assert main([*base, "--joint", "ideal", "--by", "stiffness=1e5"]) == 2
    assert "means nothing with --joint ideal" in capsys.readouterr().err
