"""`sj.fit`: measurements from files and data sets, and what makes no sense is refused before anything is computed."""

import re
from types import SimpleNamespace

import fitting
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fitting import INSTANTS, SENSOR, START, oscillation, oscillator, seen

import spherejax as sj
from spherejax.studies.fit.columns import shown_units_of
from spherejax.studies.fit.reading import measured_from


def with_data(**changes):
    return {**seen(), **changes}


# Files and data sets -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run():
    return sj.simulate(oscillator(200.0, 1.5), jnp.linspace(0.0, 0.2, 5))


def test_a_runs_data_set_is_read_by_selection(run):
    dataset = run.to_xarray()
    whole = measured_from(dataset[["position", "velocity"]])
    assert list(whole.values) == ["position.ball", "velocity.ball"]
    one = measured_from(dataset[["position"]].sel(body="ball", axis="x"))
    assert list(one.values) == ["position.ball.x"]
    np.testing.assert_array_equal(one.values["position.ball.x"], run.position("ball")[:, 0])
    np.testing.assert_array_equal(one.ts, run.ts)
    everything = measured_from(dataset)
    assert not [name for name in everything.values if "violation" in name]
    assert everything.values["spring.length"].shape == (5,)


@pytest.mark.parametrize("suffix", ["nc", "csv"])
def test_what_is_saved_is_read(run, tmp_path, suffix):
    from spherejax.output.io import save

    path = save(run.to_xarray()[["position"]], tmp_path / f"drop.{suffix}")
    read = measured_from(path)
    assert read.name == "drop"
    columns = np.concatenate([np.reshape(value, (5, -1)) for value in read.values.values()], 1)
    np.testing.assert_allclose(columns, run.position("ball"), rtol=1e-15)


def test_tables_have_units_gaps_and_comments(tmp_path):
    path = tmp_path / "drop.csv"
    path.write_text("# sensor 3\nt [ms];position.ball.x [mm]\n1;1100\n\n2;\n3;nan\n4;1.05e3\n", encoding="utf-8-sig")
    read = measured_from(str(path))
    np.testing.assert_allclose(read.ts, [1e-3, 2e-3, 3e-3, 4e-3])
    np.testing.assert_allclose(read.values["position.ball.x"], [1.1, np.nan, np.nan, 1.05])
    assert read.shown_in == {"position.ball.x": "mm"}
    with pytest.raises(sj.SceneError, match="shown_in names 'x', which was not measured"):
        sj.Measured(read.ts, read.values, shown_in={"x": "mm"})


def test_pictures_of_fits_have_the_units_of_the_measurements():
    values = {"position.ball": np.zeros((2, 3)), "reaction.joint.z": np.zeros(2)}
    measured = sj.Measured([0.0, 1.0], values, shown_in={"position.ball": "mm"})
    observables = [SimpleNamespace(unit="m"), SimpleNamespace(unit="N")]
    experiment = SimpleNamespace(measured=measured, frame=SimpleNamespace(observables=observables))
    assert shown_units_of(experiment) == [("mm", pytest.approx(1e-3))] * 3 + [("N", 1.0)]


TABLES = {
    "empty": ("", "is empty: the first row must name the columns"),
    "head alone": ("time,position.ball.x\n", "no measurements below the head"),
    "no time": ("a,b\n1,2\n", "drop.csv:1: no column is named time; there are 'a', 'b'"),
    "no head": ("0.1,0.2\n0.2,0.3\n", "drop.csv:1: '0.1' is a number: the first row must name the columns"),
    "twice": ("time,a,a\n1,2,3\n", "drop.csv:1: two columns are named 'a'"),
    "a word": ("time,position.ball.x\n1,2\n\n2,two\n", "drop.csv:4: column 'position.ball.x': 'two' is no number"),
    "decimal comma": ("time;a\n1;2,5\n", "drop.csv:2: column 'a': '2,5' is no number; write 2.5"),
    "long row": ("time,a\n1,2,3\n", "drop.csv:2: 3 cells in a row, but the head .line 1. names 2 columns"),
    "wrong unit": (
        "time,position.ball.x [N]\n1,2\n",
        "drop.csv:1: column 'position.ball.x': 'N' is a force",
    ),
    "no unit": (
        "time,position.ball.x [qx]\n1,2\n",
        "drop.csv:1: column 'position.ball.x': 'qx' is no unit: 'qx' is not defined",
    ),
    "a number as unit": (
        "time;position.ball.x [1,5 mm]\n1;2\n",
        "drop.csv:1: .*'1,5 mm' is no unit: write a unit alone",
    ),
    "a multiple as unit": ("time,position.ball.x [10 mm]\n1,2\n", "'10 mm' is no unit: write a unit alone"),
    "brackets in pieces": ("time,position.ball.x [1,5 mm]\n1,2,3\n", "write the name, then one unit in brackets"),
    "digits with gaps": ("time,a\n1,1_000\n", "drop.csv:2: column 'a': '1_000' is no number; write 1000"),
    "infinity": ("time,a\n1,inf\n", "drop.csv:2: column 'a': 'inf' is no number"),
    "other digits": ("time,a\n1,\u0661\n", "drop.csv:2: column 'a': .* is no number; write 1"),
    "time missing": ("time,a\n1,2\n,3\n", "drop.csv:3: the time is missing"),
    "time falls": ("time,a\n2,2\n1,3\n", "drop.csv: the instants of measurements must increase; 1 s"),
    "nothing": ("time,a\n1,\n2,\n", "drop.csv: nothing was measured: all values of a are missing"),
}


@pytest.mark.parametrize(("text", "message"), TABLES.values(), ids=TABLES)
def test_bad_tables_are_refused(tmp_path, text, message):
    path = tmp_path / "drop.csv"
    path.write_text(text)
    with pytest.raises(sj.SceneError, match=message):
        measured_from(path)


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(sj.SceneError, match=r"cannot read .*nowhere\.csv"):
        measured_from(tmp_path / "nowhere.csv")
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(sj.SceneError, match="is no text file"):
        measured_from(tmp_path / "a.csv")


# Requests ------------------------------------------------------------------------------------------------------------

X = "position.ball.x"
REQUESTS = {
    "unknown kind": ({"time": INSTANTS, "height.ball": INSTANTS}, START, {}, "'height.ball' names no quantity; the ki"),
    "unknown body": ({"time": INSTANTS, "position.bal.x": INSTANTS}, START, {}, "belongs to a body.*one of 'ball'"),
    "unknown axis": ({"time": INSTANTS, "position.ball.w": INSTANTS}, START, {}, "no component 'w'; its components ar"),
    "vector for a number": (with_data(**{X: np.ones((80, 3))}), START, {}, "has 3 components, and 1 are predicted"),
    "number for a vector": ({"time": INSTANTS, "position.ball": INSTANTS}, START, {}, "name a component, e.g. 'posit"),
    "wrong length": (with_data(**{X: np.ones(79)}), START, {}, r"has shape \(79,\); it must have one row for each of"),
    "words": (with_data(**{X: ["a"] * 80}), START, {}, "must be numbers"),
    "infinity": (with_data(**{X: np.full(80, np.inf)}), START, {}, "has an infinite value"),
    "no time": ({X: np.ones(3)}, START, {}, "measured has no 'time'"),
    "before the start": (with_data(time=INSTANTS - 1), START, {}, "before the motion starts at t0 = 0 s"),
    "nothing": ([], START, {}, "measured is an empty list"),
    "a number": (3.0, START, {}, "cannot read measurements from float"),
    "too few": ({"time": [0.1], X: [1.0]}, START, {}, "1 measured values cannot determine 2 parameters"),
    "no start": (seen(), {}, {}, "start must be a dict"),
    "start is a word": (seen(), {**START, "damping": "big"}, {}, "start of 'damping' must be a number"),
    "start is NaN": (seen(), {**START, "damping": np.nan}, {}, "start of 'damping' must be finite"),
    "start on its bound": (
        seen(), {**START, "damping": sj.Parameter(1.0, lower=1.0)}, {}, "must lie between its bounds, 1 and inf"
    ),
    "bounds crossed": (seen(), {**START, "damping": sj.Parameter(1.0, lower=2, upper=1)}, {}, "lower = 2 must be bel"),
    "negative": (seen(), {**START, "damping": sj.Parameter(-1.0, positive=True)}, {}, "must be positive"),
    "bad scale": (seen(), {**START, "damping": sj.Parameter(1.0, scale=-1.0)}, {}, "scale of 'damping' = -1 must be"),
    "illegal start": (seen(), {**START, "stiffness": -5.0}, {}, "stiffness = -5 must"),
    "noise missing": (seen(), START, {"noise": {"position.ball.y": 1.0}}, "noise of 'position.ball.x' is missing"),
    "noise zero": (seen(), START, {"noise": 0.0}, "noise of 'position.ball.x' must be positive"),
    "noise is a word": (seen(), START, {"noise": "small"}, "must be a number or an array"),
    "starts": (seen(), START, {"starts": 0}, "starts = 0 must be at least 1"),
    "rtol": (seen(), START, {"rtol": 1e-20}, "rtol = 1e-20 asks for digits"),
}  # fmt: skip


@pytest.mark.parametrize(("measured", "start", "options", "message"), REQUESTS.values(), ids=REQUESTS)
def test_requests_without_sense_are_refused(measured, start, options, message):
    with pytest.raises(sj.SceneError, match=message):
        sj.fit(oscillator, start, measured, **{"noise": SENSOR, **options})


def test_a_scene_that_does_not_depend_on_the_parameters_is_refused():
    with pytest.raises(sj.SceneError, match="does not depend on 'color'"):
        sj.fit(lambda color: oscillator(200.0, 1.5), {"color": 1.0}, seen(), noise=SENSOR)


def test_noise_of_some_experiments_alone_is_refused():
    values = {X: oscillation()}
    experiments = [sj.Measured(INSTANTS, values, noise=1e-4), sj.Measured(INSTANTS, values)]
    with pytest.raises(sj.SceneError, match="missing for experiment 2"):
        sj.fit(oscillator, START, experiments)


def test_functions_must_give_a_row_for_each_sample():
    given = sj.Measured(INSTANTS, {"end": oscillation()}, functions={"end": lambda run: run.position("ball")[-1]})
    with pytest.raises(sj.SceneError, match=r"'end' has shape \(3,\); it must have one row for each sample"):
        sj.fit(oscillator, START, given, noise=SENSOR)
    with pytest.raises(sj.SceneError, match="have no measured values of that name"):
        sj.Measured(INSTANTS, {"end": oscillation()}, functions={"begin": len})


def test_an_optimiser_that_is_none_is_refused():
    with pytest.raises(sj.SceneError, match="needs an optimiser of optax"):
        sj.studies.Descent("adam")


# On the command line -------------------------------------------------------------------------------------------------


def write_scene(folder):
    scene = sj.save_scene(oscillator(80.0, 0.4), folder / "ball.toml")
    lines = [f"{t!r},{x * 1e3!r}" for t, x in zip(INSTANTS.tolist(), seen()[X].tolist(), strict=True)]
    (folder / "ball.csv").write_text("\n".join(["time,position.ball.x [mm]", *lines]))
    return scene


def test_command_fits_a_scene_file_to_a_table(tmp_path, capsys):
    from spherejax.cli import main

    write_scene(tmp_path)
    words = ["fit", tmp_path / "ball.toml", "--measured", tmp_path / "ball.csv", "--noise", "0.1 mm"]
    words += ["--start", "forces.spring.stiffness", "--start", "forces.spring.damping=300 N s/km:0.01:100"]
    words += ["--report", tmp_path / "fit.html", "--validate", tmp_path / "ball.csv"]
    assert main([*map(str, words), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "forces.spring.damping [N s/km]" in re.sub("<[^>]*>", "", (tmp_path / "fit.html").read_text())
    assert "forces.spring.stiffness [N/m]" in told
    assert "Prediction of 80 values that were not fitted" in told
    assert "forces.spring.damping [N s/km]" in told
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {
        "estimates.csv", "report.txt", "fit.nc", "fit.png", "residuals.png", "history.png", "correlation.png",
        "validation.png",
    }  # fmt: skip
    rows = (tmp_path / "out" / "estimates.csv").read_text().splitlines()
    name, value, deviation, low, high, _, unit = rows[1].split(",")
    assert (name, unit) == ("forces.spring.stiffness", "N/m")
    name, damping, *_, unit = rows[2].split(",")
    assert (name, unit) == ("forces.spring.damping", "N s/km")
    assert float(damping) == pytest.approx(1e3 * sj.load(tmp_path / "out" / "fit.nc")["estimate"].values[1], rel=1e-12)
    assert float(low) < 200.0 < float(high)
    assert float(value) == pytest.approx(200.0, rel=1e-3)
    assert 0 < float(deviation) < 0.1
    assert main([*map(str, words), "--out", str(tmp_path / "out")]) == 2
    assert "exists" in capsys.readouterr().err


COMMANDS = {
    "path": (["--start", "forces.spring.stifness=1"], "forces.spring has no 'stifness'; did you mean 'stiffness'?"),
    "no number": (["--start", "forces.spring=1"], "forces.spring is no number but a SpringDamper"),
    "word": (["--start", "forces.spring.stiffness=stiff"], "'stiff' is no number"),
    "one bound": (["--start", "forces.spring.stiffness=1:2"], "write NAME=VALUE or NAME=VALUE:LOW:HIGH"),
    "twice": (["--start", "ball.mass=1", "--start", "ball.mass=2"], "--start ball.mass is given twice"),
    "array": (["--start", "ball.inertia=1"], "it is an array of shape (3,); give the name alone"),
    "noise": (["--start", "ball.mass=1", "--noise", "x=1", "--noise", "2"], "give one number for all columns, or"),
    "unit of the noise": (
        ["--start", "ball.mass=1", "--noise", "2 N"],
        "--noise 2 N: '2 N' is a force [N], but a length [m]",
    ),
    "joint": (["--start", "stiffness=1"], "--stiffness changes nothing without --joint"),
}


@pytest.mark.parametrize(("words", "message"), COMMANDS.values(), ids=COMMANDS)
def test_command_refuses_what_makes_no_sense(tmp_path, capsys, words, message):
    from spherejax.cli import main

    write_scene(tmp_path)
    assert main(["fit", str(tmp_path / "ball.toml"), "--measured", str(tmp_path / "ball.csv"), *words]) == 2
    assert message in capsys.readouterr().err


def test_the_four_bars_bushing_is_named_by_its_options():
    """What the README shows, up to where it is computed: names of options are parameters."""
    from spherejax.cli import parser
    from spherejax.command_line.scenes import chosen
    from spherejax.command_line.unknowns import builder_of, starts_of, with_starts

    words = ["fit", "four-bar", "--joint", "bushing", "--measured", "x.csv", "--start", "stiffness=1e4"]
    options = parser().parse_args([*words, "--start", "damping=1e-2"])
    build = builder_of(chosen(with_starts(options, starts_of(options))), options)
    assert build(stiffness=3.0, damping=2.0).joints["coupler_rocker"].model.law.stiffness == 3.0
    assert fitting.bushing_four_bar(3.0, 2.0).joints["coupler_rocker"].model.law.damping == 2.0


OWN = "Zeit/ms;Weg [mm];Kraft;rest\n10;1.5;2;x\n20;-2.5;3;y\n"


def test_a_table_with_names_of_its_own_is_read_by_a_mapping(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text(OWN)
    columns = {"Zeit/ms": "time [ms]", "Weg": "position.ball.x", "Kraft": "reaction.joint.z [kN]"}
    read = measured_from(path, columns)
    np.testing.assert_allclose(read.ts, [0.01, 0.02])
    np.testing.assert_allclose(read.values["position.ball.x"], [1.5e-3, -2.5e-3])  # by the unit of its own head
    np.testing.assert_allclose(read.values["reaction.joint.z"], [2e3, 3e3])
    assert len(read.values) == 2  # the rest, which holds no numbers, is not read
    whole = measured_from(path, {"Zeit/ms": "time [ms]", "Weg [mm]": "position.ball.x [cm]"})
    np.testing.assert_allclose(whole.values["position.ball.x"], [1.5e-2, -2.5e-2])  # what is said goes before
    path.write_text("t [ms],a\n10,1\n")
    np.testing.assert_allclose(measured_from(path, {"a": "position.ball.x"}).ts, [0.01])


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"Zeit/ms": "time [ms]", "weg": "position.ball.x"}, "there is no column 'weg'; did you mean 'Weg'"),
        ({"Weg": "position.ball.x"}, "no column is named time"),
        ({"Zeit/ms": "time [mm]", "Weg": "position.ball.x"}, "'mm' is a length"),
        ({"Zeit/ms": "time [ms]", "Weg": "position.ball.x [N]"}, "'N' is a force"),
        ({"Zeit/ms": "time [ms]", "rest": "position.ball.x"}, "'x' is no number"),
    ],
)
def test_a_mapping_that_does_not_fit_its_table_says_so(tmp_path, columns, message):
    path = tmp_path / "rig.csv"
    path.write_text(OWN)
    with pytest.raises(sj.SceneError, match=message):
        measured_from(path, columns)


def test_a_mapping_is_for_tables_alone():
    with pytest.raises(sj.SceneError, match="CSV files"):
        measured_from({"time": [1.0], "position.ball.x": [0.0]}, {"a": "position.ball.x"})


def test_traced_times_and_values_are_refused_with_what_to_do():
    """NumPy's error of a tracer named neither; a clock offset is an unknown of residuals of one's own."""

    def late(offset):
        sj.Measured(INSTANTS + offset, {SENSOR: np.zeros(len(INSTANTS))})

    def scaled(factor):
        sj.Measured(INSTANTS, {SENSOR: factor * np.ones(len(INSTANTS))})

    for transform in (jax.grad, jax.jit):
        with pytest.raises(sj.SceneError, match=r"instants .* traced.*clock offset.*sj\.studies\.Sensor.*sj\.simulate"):
            transform(late)(0.01)
        with pytest.raises(sj.SceneError, match=f"{SENSOR!r} are traced"):
            transform(scaled)(2.0)
