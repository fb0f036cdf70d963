"""What accuracy costs: errors, references, horizons, frontier, advice, failures, figures, files, command."""

import csv
from dataclasses import replace

import cases
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import spherejax as sj
from spherejax import cli
from spherejax.output.plot.style import typeset
from spherejax.output.plot.work_precision import WorkCurve, WorkDiagram, work_precision_figure
from spherejax.studies.accuracy.accuracy_result import Row, WorkPrecision
from spherejax.studies.accuracy.frontier import FrontierPoint, advice, duration, efficient, price, spreads, usual_target
from spherejax.studies.accuracy.reference import AGREED, Reference, make_reference, parting
from spherejax.studies.accuracy.runs import PROBE_STEPS, TimedProgram, TimedTrial
from spherejax.studies.accuracy.samples import UNITS, errors, samples_of, scales, statistics
from spherejax.studies.accuracy.solvers import SOLVERS

EXPLICIT = {name: SOLVERS[name] for name in ("Tsit5", "Dopri8")}
IDEAL, FRICTION = (sj.gallery.four_bar(cases.FOUR_BAR_MODELS[name]) for name in ("ideal", "friction"))
T_FRICTION, N_FRICTION = 0.05, 2001
PARTED = 1e-6
"""Where `run.determined_until` ends with a clearance of 0.1 mm [m]."""
AGREEMENT = AGREED * PARTED


def friction_ts():
    return jnp.linspace(0.0, T_FRICTION, N_FRICTION)


def raises(rtol, atol):
    raise ValueError(f"no solver for {rtol}")


def study(scene, t1, **options):
    options = {"tolerances": (1e-5, 1e-7, 1e-9), "n_repeats": 1, "solvers": EXPLICIT, **options}
    return sj.work_precision(scene, t1, **options)


@pytest.fixture(scope="module")
def result():
    """Two models; among the solvers one that cannot adapt its step and one that cannot be made."""
    broken = {"Euler": diffrax.Euler(), "raises": raises}
    ideal = study({"ideal": IDEAL}, 0.2, n_samples=501, solvers={**EXPLICIT, **broken}, name="four-bar")
    friction = study({"friction": FRICTION}, T_FRICTION, n_samples=N_FRICTION)
    return replace(ideal, rows=(*ideal.rows, *friction.rows), references={**ideal.references, **friction.references})


@pytest.fixture(scope="module")
def chaotic():
    """Frictionless dry motion, beyond the time at which tight runs part."""
    scene = sj.gallery.four_bar(cases.FOUR_BAR_MODELS["dry"])
    return study({"dry": scene}, 0.6, tolerances=(1e-5, 1e-8), n_samples=5001, solvers={"Dopri8": SOLVERS["Dopri8"]})


def rows_of(result, model, solver):
    return [row for row in result.rows_of(model) if row.solver == solver]


# Errors --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["ideal", "friction"])
@pytest.mark.parametrize("solver", EXPLICIT)
def test_every_error_falls_with_the_tolerance(result, model, solver):
    rows = rows_of(result, model, solver)
    assert [row.rtol for row in rows] == [1e-5, 1e-7, 1e-9]
    for quantity in UNITS:
        found = [max(row.errors[quantity], result.references[model].floor(quantity)) for row in rows]
        assert found[0] > 3 * found[1], quantity
        assert found[1] > 3 * found[2] or found[2] == result.references[model].floor(quantity), quantity
    assert result.is_resolved(rows[0])
    assert [row.n_steps for row in rows] == sorted(row.n_steps for row in rows)
    assert all(row.seconds > 0 and row.n_repeats == 1 and row.compile_seconds > 0 for row in rows)


def test_a_row_is_the_run_that_simulate_makes(result):
    # With absorbed work integrated beside it, and a budget around its controller, the run is still the same: but for
    # rounding, by which alone the number of steps through these contacts varies by a twentieth.
    def simulated(rtol):
        return sj.simulate(FRICTION, friction_ts(), rtol=rtol, atol=1e-2 * rtol, solver=diffrax.Dopri8())

    run = jax.jit(simulated)(1e-7)
    row = rows_of(result, "friction", "Dopri8")[1]
    assert row.atol == pytest.approx(1e-9)
    assert row.n_steps == pytest.approx(int(run.stats.n_steps), rel=0.15)
    assert row.n_rejected == pytest.approx(int(run.stats.n_rejected), rel=0.15)
    assert row.n_onsets == int(run.stats.n_onsets[0]) > 0
    assert row.n_evaluations / row.n_steps == int(run.stats.n_evaluations) / int(run.stats.n_steps)
    reference = result.references["friction"].samples
    for quantity, seen in (("position", run.position), ("acceleration", run.acceleration)):
        apart = [
            np.linalg.norm(np.asarray(seen(body)) - reference.vectors[quantity][:, i], axis=1)
            for i, body in enumerate(run.system.bodies)
        ]
        assert np.max(apart) / 3 < row.errors[quantity] < 3 * np.max(apart)


def test_the_energy_counts_what_the_joint_absorbs(result):
    reference = result.references["friction"].samples
    assert reference.dissipated[-1] > 1e-5
    assert np.ptp(reference.energy) < 1e-3 * reference.dissipated[-1]


def test_relative_errors_refer_to_peaks(result):
    reference, row = result.references["ideal"], rows_of(result, "ideal", "Tsit5")[0]
    moved = reference.samples.vectors["position"] - reference.samples.vectors["position"][0]
    assert reference.scales["position"] == pytest.approx(np.linalg.norm(moved, axis=2).max())
    assert result.relative_error(row, "position") == row.errors["position"] / reference.scales["position"]
    assert scales(reference.samples)["energy"] == pytest.approx(reference.samples.kinetic_energy.max())


def test_the_estimate_of_run_error_stands_beside_the_error(result):
    for row in result.rows:
        if row.succeeded and result.is_resolved(row):
            assert 1 / 3 < row.estimates["position"] / row.errors["position"] < 3
    # It is that of a run which `simulate` makes.
    row = rows_of(result, "friction", "Dopri8")[0]
    run = sj.simulate(FRICTION, friction_ts(), rtol=row.rtol, atol=row.atol, solver=diffrax.Dopri8())
    for quantity, names in (("position", run.system.bodies), ("reaction", run.system.joints)):
        largest = max(np.linalg.norm(run.error(f"{quantity}.{name}"), axis=1).max() for name in names)
        assert row.estimates[quantity] == pytest.approx(largest, rel=0.5)
    note = next(note for note in result.notes["friction"] if note.startswith("run.error estimates"))
    assert note in str(result)
    assert "run.error [m]" in str(result)


def test_a_companion_over_the_budget_leaves_the_estimate_open(monkeypatch, result):
    known, budget = result.references["ideal"], TimedProgram.budget
    monkeypatch.setattr("spherejax.studies.accuracy.study.make_reference", lambda *arguments: known)
    monkeypatch.setattr(
        TimedProgram, "budget", lambda self, rtol, seconds: 3 if rtol < 1e-8 else budget(self, rtol, seconds)
    )
    found = study(IDEAL, 0.2, n_samples=501, solvers={"Dopri8": SOLVERS["Dopri8"]}, tolerances=(1e-5, 1e-7))
    estimates = [row.estimates["position"] for row in found.rows]
    assert estimates[0] > 0, "the run at 1e-7 is its companion"
    assert np.isnan(estimates[1])
    assert found.cells(found.rows[1])[5] == "-"


# References ----------------------------------------------------------------------------------------------------------


def test_the_reference_is_as_good_as_it_says():
    programs = {
        name: TimedProgram(FRICTION, SOLVERS[name], friction_ts(), atol_ratio=1e-2, measures=True)
        for name in ("Dopri8", "Tsit5")
    }
    truth = samples_of(programs["Dopri8"].run(1e-12))
    poor, good = (make_reference(programs.__getitem__, ("Dopri8", "Tsit5"), rtol, 10.0) for rtol in (1e-4, 1e-7))
    assert poor.methods == good.methods == ("Dopri8", "Tsit5")
    assert (poor.rtols[0], good.rtols[1]) == (pytest.approx(1e-6), pytest.approx(1e-9))
    for reference in (poor, good):
        found = errors(reference.samples, truth)
        for quantity in UNITS:
            assert 0 < found[quantity] <= reference.floor(quantity), quantity
    # A poor reference says that it is poor.
    assert all(poor.errors[quantity] > 30 * good.errors[quantity] for quantity in UNITS)


def test_a_reference_falls_back_to_one_method_and_to_looser_tolerances():
    ideal = TimedProgram(IDEAL, SOLVERS["Dopri8"], jnp.linspace(0.0, 0.2, 501), atol_ratio=1e-2, measures=True)
    alone = make_reference({"Dopri8": ideal}.__getitem__, ("Dopri8",), 1e-8, 10.0)
    assert alone.methods == ("Dopri8", "Dopri8")
    assert alone.rtols == (pytest.approx(1e-10), pytest.approx(1e-9))

    class Impatient:
        def run(self, rtol, n_steps):
            return ideal.run(rtol, n_steps if rtol > 2e-10 else 3)

        def budget(self, rtol, seconds):
            return 10_000

    looser = make_reference({"Dopri8": Impatient()}.__getitem__, ("Dopri8",), 1e-8, 10.0)
    assert looser.rtols == (pytest.approx(1e-9), pytest.approx(1e-8))
    with pytest.raises(sj.SceneError, match="no method finished a reference run"):
        make_reference({"Dopri8": Impatient()}.__getitem__, ("Dopri8",), 1e-10, 10.0)


# Motion that does not repeat -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_frictionless_dry_run_has_a_horizon(chaotic):
    reference = chaotic.references["dry"]
    assert 0.05 < reference.horizon < 0.3 < reference.parted < 0.6
    assert reference.errors["position"] <= AGREEMENT
    assert "does not repeat" in str(reference)
    assert "one of many" in str(reference)
    assert "agree to 1e-10 m until" in str(reference)
    # The same criterion as that of a run: a tight one is determined until then.
    run = sj.simulate(sj.gallery.four_bar(cases.FOUR_BAR_MODELS["dry"]), jnp.linspace(0.0, 0.6, 601), rtol=1e-10)
    assert reference.parted == pytest.approx(run.determined_until, rel=0.1)
    assert f"over the first {reference.horizon:.3g} s" in chaotic.advice["dry"]


def test_errors_are_measured_until_the_horizon_and_statistics_compared_after(chaotic):
    loose, tight = chaotic.rows
    assert 1e-4 > loose.errors["position"] > 10 * tight.errors["position"] > 0
    reference = chaotic.references["dry"]
    assert len(reference.members) == 8
    for row in chaotic.rows:
        assert set(row.statistics) == set(reference.members[0])
        assert row.statistics["time_in_contact"] > 0
        assert all(np.isfinite(far) for far in chaotic.deviations(row).values())
    peaks = [member["peak_acceleration"] for member in reference.members]
    assert min(peaks) < max(peaks)
    # The histories do part: over the whole time, no tolerance is met.
    again = TimedProgram(
        sj.gallery.four_bar(cases.FOUR_BAR_MODELS["dry"]),
        SOLVERS["Dopri8"],
        jnp.linspace(0.0, 0.6, 5001),
        atol_ratio=1e-2,
        measures=True,
    )
    assert errors(samples_of(again.run(1e-8)), reference.samples)["position"] > PARTED


def test_friction_and_ideal_motion_repeat(result):
    assert all(reference.horizon is None and not reference.members for reference in result.references.values())
    assert all(not row.statistics for row in result.rows)


def test_parting_tells_fast_growth_from_a_poor_reference():
    ts = np.linspace(0.0, 1.0, 1001)
    agreed, parted = parting(ts, 1e-13 * np.exp(30 * ts), PARTED)
    assert agreed == pytest.approx(np.log(AGREEMENT / 1e-13) / 30, abs=2e-3)
    assert parted == pytest.approx(np.log(PARTED / 1e-13) / 30, abs=2e-3)
    assert parting(ts, 1e-13 * np.exp(10 * ts), PARTED) == (None, None)  # has not parted yet
    assert parting(ts, 1e-5 * ts**2, PARTED) == (None, None)  # grows, but not exponentially: the reference is poor
    assert parting(ts, np.full(1001, 1e-5), PARTED) == (None, None)  # poor from the start


def test_statistics_of_a_known_history(result):
    known = result.references["friction"].samples
    n = len(known.ts)
    touching = np.zeros((n, 1), bool)
    touching[n // 2 : n // 2 + n // 4] = True
    known = known._replace(is_touching=touching, eccentricity=np.linspace(0, 1e-4, n)[:, None], n_onsets=3)
    found = statistics(known, T_FRICTION / 2)
    assert found["time_in_contact"] == pytest.approx(T_FRICTION / 4, rel=2e-2)
    assert found["eccentricity_50"] == pytest.approx(0.75e-4, rel=1e-2)
    assert found["n_onsets"] == 3
    assert found["dissipated_energy"] == pytest.approx(known.dissipated[-1] - known.dissipated[n // 2])


def test_spreads_count_standard_deviations():
    members = [{"a": value} for value in (1.0, 2.0, 3.0)]
    assert spreads({"a": 5.0}, members) == {"a": pytest.approx(3.0)}


# Frontier and advice -------------------------------------------------------------------------------------------------

POINTS = [
    FrontierPoint("fast", 1e-4, 1e-4, 1e-3),
    FrontierPoint("fast", 1e-6, 1e-6, 4e-3),
    FrontierPoint("fast", 1e-8, 1e-8, 16e-3),
    FrontierPoint("slow", 1e-4, 1e-5, 8e-3),
    FrontierPoint("slow", 1e-8, 1e-11, 20e-3),
]


def test_the_frontier_holds_what_no_other_beats():
    assert efficient(POINTS) == [POINTS[0], POINTS[1], POINTS[2], POINTS[4]]
    assert efficient(POINTS[3:4]) == [POINTS[3]]


def test_a_price_is_interpolated_along_one_solver():
    found = price(POINTS, 1e-5)
    assert (found.solver, found.seconds, found.rtol) == ("fast", pytest.approx(2e-3), pytest.approx(1e-5))
    assert price(POINTS, 1e-10).solver == "slow"
    assert price(POINTS, 1e-2).seconds == pytest.approx(1e-3)  # nothing is cheaper than the loosest run
    assert price(POINTS, 1e-12) is None


def test_the_advice_prices_an_accuracy_and_one_more_digit():
    assert usual_target(POINTS) == 1e-6
    expected = "1e-06 m costs 4 ms with fast at rtol 1e-06; one more digit costs 2 times as much."
    assert advice(POINTS) == expected
    assert advice(POINTS, target=1e-7).endswith("times as much (with slow).")
    assert "no run shows what one more digit costs" in advice(POINTS, target=1e-11)
    assert advice(POINTS, target=1e-13).startswith("No run reaches 1e-13 m; the nearest is slow at rtol 1e-08")
    assert "as good as the reference resolves (1e-03 m); the quickest is fast at rtol 1e-04: 1 ms" in advice(
        POINTS, floor=1e-3
    )
    assert advice([]) == "No run reached its end within its budget."


def test_the_usual_target_is_one_that_the_runs_bracket():
    assert usual_target([FrontierPoint("a", 1e-4, 3e-9, 1.0), FrontierPoint("a", 1e-8, 2e-12, 2.0)]) == 1e-9
    assert usual_target([FrontierPoint("a", 1e-4, 3e-2, 1.0), FrontierPoint("a", 1e-8, 2e-5, 2.0)]) == 1e-3
    assert usual_target([FrontierPoint("a", 1e-4, 3e-9, 1.0)]) == 3e-9


def test_durations_are_for_people():
    assert [duration(x) for x in (2.0, 0.00083, 5e-6)] == ["2 s", "830 us", "5 us"]


# Failures ------------------------------------------------------------------------------------------------------------


def test_a_solver_that_fails_is_a_row_with_a_diagnosis(result):
    rows = rows_of(result, "ideal", "raises")
    assert [row.status for row in rows] == ["not_compiled"] * 3
    assert rows[0].diagnosis.startswith("ValueError: no solver for")
    assert np.isnan(rows[0].seconds)
    assert np.isnan(rows[0].errors["position"])
    euler = rows_of(result, "ideal", "Euler")
    assert not any(row.succeeded for row in euler)
    assert all(row.diagnosis for row in euler)
    assert any(note.startswith("raises did not finish at rtol 1e-05") for note in result.notes["ideal"])
    assert not any(point.solver in ("raises", "Euler") for point in result.points("ideal"))


def test_a_hopeless_run_ends_with_its_budget_and_tighter_ones_are_not_tried(monkeypatch, result):
    patience = 17.0
    monkeypatch.setattr(TimedProgram, "budget", lambda self, rtol, seconds: 7)  # whatever the machine
    known = result.references["ideal"]
    monkeypatch.setattr("spherejax.studies.accuracy.study.make_reference", lambda *arguments: known)
    found = study(
        IDEAL, 0.2, n_samples=501, solvers={"Dopri8": SOLVERS["Dopri8"]}, max_seconds=patience, tolerances=(1e-5, 1e-7)
    )
    assert [row.status for row in found.rows] == ["over_budget", "not_tried"]
    assert found.rows[0].n_steps == 7
    assert "of 0.2 s after about 17 s and 7 steps" in found.rows[0].diagnosis
    assert found.advice == {"scene": "No run reached its end within its budget."}
    assert "over budget" in str(found)
    figure = found.figures("scene")["work_precision"]
    figure.canvas.draw()
    assert any("did not finish at every tolerance: Dopri8" in text.get_text() for text in figure.axes[-1].texts)


def test_a_budget_is_learned_from_the_time_of_a_step(result):
    program = TimedProgram(IDEAL, SOLVERS["Tsit5"], jnp.array([0.0, 0.2]), atol_ratio=1e-2, measures=False)
    few = program.run(1e-10, 11)
    assert int(few.stats.n_steps) == 11
    assert int(few.status) == sj.Status.TOO_MANY_STEPS
    assert 0 < float(few.t_reached) < 0.2
    n = program.budget(1e-10, 1.0)
    assert n == int(1.0 / program.seconds_a_step) > PROBE_STEPS
    trial = TimedTrial(program, 1e-7, 1e-9)  # no time for a second run: the first one counts
    trial.repeat()
    assert (trial.n_repeats, trial.seconds) == (1, trial.first)
    patient = TimedTrial(program, 1e-7, 100.0)
    patient.repeat()
    patient.repeat()
    assert patient.n_repeats == 2
    assert patient.seconds == np.median(patient.times)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"t1": -1.0}, "t1 = -1 must be a positive time"),
        ({"tolerances": ()}, "tolerances is empty"),
        ({"tolerances": (1e-5, 1e-13)}, "tolerance 1e-13 must lie in"),
        ({"tolerances": (2.0,)}, "tolerance 2 must lie in"),
        ({"solvers": {}}, "solvers is empty"),
        ({"n_repeats": 0}, "n_repeats = 0 must be at least 1"),
        ({"n_samples": 1}, "n_samples = 1 must be at least 2"),
        ({"max_seconds": 0.0}, "max_seconds = 0 must be positive"),
        ({"atol_ratio": 0.0}, "atol_ratio = 0 must be positive"),
    ],
)
def test_a_request_without_sense_is_refused(options, message):
    with pytest.raises(sj.SceneError, match=message):
        sj.work_precision(IDEAL, **options)


@pytest.mark.slow
def test_kvaerno5_converges_with_its_root_finder():
    # With a root finder that does not converge it rejects most of its steps on a stiff bushing, and needs thousands.
    # With one that does: 56 of 134 at 1e-4, some of them for diffrax's first step of 0.01 s.
    scene = sj.gallery.four_bar(sj.Bushing(1e6, 1e-2))
    found = study(
        scene, 0.1, solvers={"Kvaerno5": SOLVERS["Kvaerno5"]}, tolerances=(1e-4, 1e-6), n_samples=501, max_seconds=60.0
    )
    loose, tight = found.rows
    assert loose.succeeded
    assert tight.succeeded
    assert loose.errors["position"] > 3 * tight.errors["position"]
    assert all(row.n_rejected < 0.5 * row.n_steps for row in found.rows)
    assert tight.n_steps < 400


# Figures and files ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("span", [(2e-3, 12.5e-3), (1e-3, 1.3e-3), (4.1e-3, 8.9e-3), (1e-4, 2.0), (3e-3, 0.1)])
def test_an_axis_of_times_has_three_ticks(span):
    curve = WorkCurve("one", [1e-5, 1e-7], list(span), [10, 20], {"position": [1e-6, 1e-8]})
    frontiers = {"position": (list(span), [1e-6, 1e-8])}
    figure = work_precision_figure(WorkDiagram("title", [curve], {"position": "m"}, {"position": 0.0}, frontiers))
    ax = next(ax for ax in figure.axes if "position" in ax.get_title(loc="left"))
    figure.canvas.draw()
    low, high = ax.get_xlim()
    assert sum(low <= tick <= high for tick in ax.get_xticks()) >= 3


def test_figures_show_the_rows(result, chaotic):
    named = result.figures("friction")
    assert all(figure.get_suptitle().startswith("four-bar, friction: what accuracy costs") for figure in named.values())
    drawn = replace(result, name="").figures("friction")
    assert set(drawn) == {"work_precision", "steps"}
    figure = drawn["work_precision"]
    figure.canvas.draw()
    titles = {ax.get_title(loc="left") for ax in figure.axes}
    assert titles == {"(a) position", "(b) velocity", "(c) acceleration", "(d) reaction", "(e) energy"}
    large = next(ax for ax in figure.axes if "position" in ax.get_title(loc="left"))
    lines = {line.get_label(): line for line in large.lines}
    rows = rows_of(result, "friction", "Dopri8")
    np.testing.assert_allclose(lines["Dopri8"].get_xdata(), [row.seconds for row in rows])
    np.testing.assert_allclose(lines["Dopri8"].get_ydata(), [row.errors["position"] for row in rows])
    best = result.frontier("friction")
    np.testing.assert_allclose(lines["no other run beats it"].get_ydata(), [point.error for point in best])
    assert "$10^{-7}$" in {text.get_text() for text in large.texts}
    assert typeset(result.advice["friction"]) in figure.get_suptitle()
    statistics = chaotic.figures("dry")["statistics"]
    statistics.canvas.draw()
    assert len(statistics.axes) == 7


def test_the_overview_shows_the_best_runs_of_every_model(result):
    figure = result.overview()
    figure.canvas.draw()
    lines = {line.get_label(): line for line in figure.axes[0].lines}
    assert set(lines) == {"ideal", "friction"}
    for model, line in lines.items():
        np.testing.assert_allclose(line.get_ydata(), [point.error for point in result.frontier(model)])


def test_a_data_set_carries_units_and_survives_a_file(result, tmp_path):
    from spherejax.output.io import load, save

    ds = load(save(result.to_xarray(), tmp_path / "accuracy.nc"))
    assert ds.position_error.dims == ("model", "solver", "rtol")
    assert ds.acceleration_error.attrs["units"] == "m/s^2"
    row = rows_of(result, "friction", "Tsit5")[1]
    chosen = ds.sel(model="friction", solver="Tsit5", rtol=1e-7)
    assert float(chosen.reaction_error) == row.errors["reaction"]
    assert float(chosen.reaction_estimate) == row.estimates["reaction"]
    assert int(chosen.n_steps) == row.n_steps
    assert float(chosen.energy_reference_error) == result.references["friction"].errors["energy"]
    assert np.isnan(ds.seconds.sel(model="ideal", solver="raises")).all()
    assert np.isnan(ds.seconds.sel(model="friction", solver="raises")).all()
    assert ds.attrs["advice_ideal"] == result.advice["ideal"]


def test_a_result_prints_table_reference_and_advice(result):
    text = str(result)
    assert "acceleration [m/s^2]" in text
    assert "not compiled" in text
    assert "Reference: Dopri8 at rtol 1e-11 and Tsit5 at rtol 1e-11 differ by" in text
    assert result.advice["friction"] in text


def test_an_error_that_is_not_resolved_is_shown_as_such():
    known = dict.fromkeys(UNITS, 1e-9)
    reference = Reference(("a", "b"), (1e-12, 1e-12), known, dict.fromkeys(UNITS, 1.0), 1.0, None, None)
    row = Row("m", "a", 1e-6, 1e-8, 1e-3, 5, 1.0, 10, errors={**dict.fromkeys(UNITS, 2e-9), "velocity": 4e-9})
    found = WorkPrecision((row,), {"m": reference}, 1.0, 11)
    assert found.cells(row)[6:8] == ("< 3e-09", "4.0e-09")
    assert found.points("m")[0].error == pytest.approx(3e-9)
    assert "as good as the reference resolves" in found.advice["m"]


# The command ---------------------------------------------------------------------------------------------------------


def test_the_command_prints_and_writes(tmp_path, capsys):
    folder = tmp_path / "results"
    words = ["accuracy", "four-bar", "--quick", "--t1", "0.2", "--solvers", "dopri8", "--tolerances", "1e-5", "1e-7"]
    assert cli.main([*words, "--repeats", "1", "--target", "5e-9", "--out", str(folder)]) == 0
    seen = capsys.readouterr()
    assert "position [m]" in seen.out
    assert "Reference: Dopri8 at rtol 1e-09 and Tsit5 at rtol 1e-09 differ by" in seen.out
    assert "5e-09 m costs" in seen.out
    assert "Compiled once for all tolerances: Dopri8" in seen.out
    assert "ideal: reference" in seen.err
    names = {"accuracy.csv", "accuracy.nc", "work_precision_ideal.png", "steps_ideal.png"}
    assert {path.name for path in folder.iterdir()} == names
    assert (folder / "steps_ideal.png").read_bytes().startswith(b"\x89PNG")
    with (folder / "accuracy.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["rtol [-]"]) for row in rows] == [1e-5, 1e-7]
    assert float(rows[0]["position_error [m]"]) > float(rows[1]["position_error [m]"]) > 0
    assert 1 / 3 < float(rows[0]["position_estimate [m]"]) / float(rows[0]["position_error [m]"]) < 3
    with xarray.open_dataset(folder / "accuracy.nc") as ds:
        assert float(ds.position_error.sel(rtol=1e-5).item()) == float(rows[0]["position_error [m]"])
    assert cli.main([*words, "--out", str(folder)]) == 2
    assert "exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--clearance", "1e-4"), "--clearance means nothing with --joint ideal"),
        (("--t1", "-1"), "t1 = -1 must be a positive time"),
        (("--tolerances", "1e-15"), "tolerance 1e-15 must lie in"),
        (("--repeats", "0"), "n_repeats = 0 must be at least 1"),
        (("--max-seconds", "0"), "--max-seconds = 0 must be positive"),
        (("--models", "ideal", "dry", "--joint", "dry"), "leave --joint and its options out"),
        (("--models", "ideal", "dry", "--clearance", "1e-4"), "--clearance means nothing with --joint ideal"),
    ],
)
def test_the_command_refuses_a_request_without_sense(words, message, capsys):
    assert cli.main(["accuracy", "four-bar", *words]) == 2
    assert message in capsys.readouterr().err


def test_the_command_compares_models_with_their_defaults(tmp_path, monkeypatch, result):
    asked = []
    monkeypatch.setattr(sj, "work_precision", lambda scenes, **options: asked.append((scenes, options)) or result)
    words = ["accuracy", "four-bar", "--models", "ideal", "friction", "--quick", "--out", str(tmp_path)]
    assert cli.main(words) == 0
    scenes, options = asked[0]
    assert list(scenes) == ["ideal", "friction"]
    assert isinstance(scenes["friction"].joints["coupler_rocker"].model.friction, sj.Threlfall)
    assert (options["t1"], options["max_seconds"], options["tolerances"]) == (0.05, 1.0, (1e-5, 1e-7, 1e-9))
    assert set(options["solvers"]) == {"Tsit5", "Dopri8", "Rodas5P"}
    assert {"models.png", "work_precision_ideal.png", "steps_friction.png"} <= {p.name for p in tmp_path.iterdir()}


def test_the_command_takes_solvers_as_the_study_sets_them_up():
    from spherejax.command_line.accuracy import solvers_named
    from spherejax.command_line.catalog import SOLVERS as CATALOG

    named = solvers_named(CATALOG)
    assert named["Kvaerno5"] is SOLVERS["Kvaerno5"]
    assert isinstance(named["Dopri5"], diffrax.Dopri5)
    assert set(SOLVERS) <= set(named)
