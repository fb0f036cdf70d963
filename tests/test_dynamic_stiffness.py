"""Dynamic stiffness and loss angle: closed forms, runs of a driven joint, and fits of measurements."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_rubber import (
    BRANCHES,
    CROSS,
    FRICTION,
    HALF,
    HINGE,
    LIMIT,
    SIX,
    SPRING,
    STIFFNESSES,
    TIMES,
    K,
    berg_loss,
    berg_peak,
    harmonic,
)

import spherejax as sj

FREQUENCIES = np.geomspace(0.5, 100.0, 15)
W = 2 * np.pi * FREQUENCIES[:, None]
ALONG_X = sj.laws.Maxwell([[1e5, 0.0, 0.0]], [0.05])


def of_branches(w, stiffnesses=STIFFNESSES, times=TIMES):
    wt = w[..., None] * np.asarray(times)
    return np.sum(np.asarray(stiffnesses) * 1j * wt / (1 + 1j * wt), -1)


def test_linear_rubber_is_its_complex_stiffness():
    model = sj.Bushing(law=sj.laws.VectorElastomer(K, 2e-3), branches=BRANCHES)
    found = sj.studies.dynamic_stiffness(model, FREQUENCIES, [1e-5, 1e-3])
    exact = K * (1 + 2e-3j * W) + of_branches(W)
    assert np.asarray(found.complex_stiffness) == pytest.approx(np.repeat(exact, 2, 1), rel=1e-12)
    assert np.asarray(found.stiffness) == pytest.approx(np.abs(np.asarray(found.complex_stiffness)), rel=1e-14)
    assert np.tan(np.asarray(found.loss_angle)) == pytest.approx(np.asarray(found.loss / found.storage), rel=1e-12)


def test_an_elastomer_alone_and_a_single_point():
    found = sj.studies.dynamic_stiffness(SPRING, 5.0, 1e-4, direction=(1.0, 2.0, 3.0))
    assert found.complex_stiffness.shape == (1, 1)
    assert complex(found.complex_stiffness[0, 0]) == pytest.approx(K, rel=1e-12)


@pytest.mark.parametrize("r", [1e-4, 0.3, 1.0, 10.0, 300.0])
def test_friction_loses_what_its_closed_form_says_at_any_frequency(r):
    found = sj.studies.dynamic_stiffness(sj.Bushing(law=SPRING, friction=FRICTION), [1.0, 50.0], r * HALF)
    lost = np.pi * np.asarray(found.loss)[:, 0] * (r * HALF) ** 2
    exact = LIMIT * HALF * (berg_loss(r) if r > 0.01 else 8 / 3 * r**3)
    assert lost == pytest.approx(exact, rel=1e-3 if r < 0.01 else 1e-8)
    inner = np.asarray(found.storage)[:, 0] - K
    if r < 0.01:
        assert inner == pytest.approx(LIMIT / HALF, rel=1e-6)
    assert np.all(inner < LIMIT / HALF)
    assert np.all(inner < 1.3 * LIMIT * berg_peak(r) / (r * HALF))


def test_rubber_is_stiffer_for_small_amplitudes():
    model = sj.Bushing(law=SPRING, branches=BRANCHES, friction=FRICTION)
    found = sj.studies.dynamic_stiffness(model, FREQUENCIES, np.geomspace(1e-6, 1e-2, 9))
    assert np.all(np.diff(np.asarray(found.storage), axis=1) < 0)
    assert np.all(np.diff(np.asarray(found.stiffness)[:, 2:], axis=1) < 0)  # from a tenth of the half length on
    # The loss angle has its peak between: small loops are elastic, in large ones friction is nothing.
    assert np.all(np.argmax(np.asarray(found.loss_angle), axis=1) > 0)
    assert np.all(np.argmax(np.asarray(found.loss_angle), axis=1) < 8)


def test_a_driven_joint_says_the_same():
    """All at once: a curve about the origin, a branch, friction; the first harmonic of a run's last cycle."""
    law = sj.laws.CurveElastomer([1e-4, 3e-4, 6e-4], [20.0, 80.0, 250.0], 1e-3)
    model = sj.Bushing(law=law, branches=sj.laws.Maxwell([1e5], [0.02]), friction=FRICTION)
    frequency, amplitude = 10.0, 5e-4
    ts, force = harmonic(model, frequency, amplitude, 8, 256)
    found = np.mean(force * np.exp(-2j * np.pi * frequency * ts)) * 2j / amplitude
    table = sj.studies.dynamic_stiffness(model, frequency, amplitude)
    assert found == pytest.approx(complex(table.complex_stiffness[0, 0]), rel=3e-4)


def test_directions_and_free_ones():
    model = sj.Bushing(law=SPRING, branches=ALONG_X, friction=sj.laws.Berg([LIMIT, 0.0, 0.0], HALF))
    for direction, share in (((2.0, 0.0, 0.0), 1.0), ((0.0, 1.0, 0.0), 0.0)):
        found = sj.studies.dynamic_stiffness(model, 7.0, 2e-4, direction=direction).complex_stiffness[0, 0]
        alone = sj.Bushing(law=SPRING, branches=sj.laws.Maxwell(1e5, 0.05), friction=FRICTION)
        full = sj.studies.dynamic_stiffness(alone, 7.0, 2e-4).complex_stiffness[0, 0]
        assert complex(found - K) == pytest.approx(complex(share * (full - K)), rel=1e-12, abs=1e-6)
    slanted = sj.studies.dynamic_stiffness(model, 7.0, 2e-4, direction=(1.0, 1.0, 0.0)).complex_stiffness[0, 0]
    # Half of a branch along x; of friction what an amplitude smaller by the root of two does, half of it.
    smaller = sj.studies.dynamic_stiffness(alone, 7.0, 2e-4 / np.sqrt(2)).complex_stiffness[0, 0]
    assert complex(slanted - K) == pytest.approx(complex(smaller - K) / 2, rel=1e-9)


@pytest.mark.parametrize(
    ("law", "axis", "held"), [(SIX, (1, 2, 2), 1.0), (HINGE, (1, 0, 0), 1.0), (HINGE, (0, 0, 1), 0.0)]
)
def test_rotation(law, axis, held):
    branches = sj.laws.Maxwell([0.0], [0.05], rotational_stiffness=[30.0])
    friction = sj.laws.Berg(0.0, HALF, rotational_limit=0.4, half_angle=0.01)
    model = sj.Bushing(law=law, branches=branches, friction=friction)
    found = sj.studies.dynamic_stiffness(model, FREQUENCIES, 0.01, direction=axis, rotation=True)
    loop = sj.studies.dynamic_stiffness(
        sj.Bushing(law=SPRING, friction=sj.laws.Berg(0.4, 0.01)), 1.0, 0.01
    ).complex_stiffness[0, 0]
    exact = 50.0 + of_branches(W[:, 0], [30.0], [0.05]) + complex(loop - K)
    assert np.asarray(found.complex_stiffness)[:, 0] == pytest.approx(held * exact, rel=1e-6, abs=1e-9)
    assert found.units["stiffness"] == "N m/rad"


def test_a_cross_resists_its_middle_turn_alone():
    model = sj.Bushing(law=CROSS, branches=sj.laws.Maxwell([0.0], [0.05], rotational_stiffness=[30.0]))
    for axis, held in (((0, 1, 0), 1.0), ((1, 0, 0), 0.0), ((0, 0, 1), 0.0)):
        found = sj.studies.dynamic_stiffness(model, FREQUENCIES, 0.01, direction=axis, rotation=True)
        exact = held * (50.0 + of_branches(W[:, 0], [30.0], [0.05]))
        assert np.asarray(found.complex_stiffness)[:, 0] == pytest.approx(exact, rel=1e-9, abs=1e-9)


def test_about_a_mean_deflection_a_curve_is_as_stiff_as_there():
    law = sj.laws.CurveElastomer([1e-4, 3e-4, 6e-4], [20.0, 80.0, 250.0], 0.0)
    found = sj.studies.dynamic_stiffness(law, 1.0, 1e-7, mean=2e-4).complex_stiffness[0, 0]
    slope = -jax.grad(lambda x: law.force(jnp.array([x, 0.0, 0.0]), jnp.zeros(3))[0])(2e-4)
    assert complex(found) == pytest.approx(float(slope), rel=1e-6)


def test_it_differentiates_and_maps():
    def stiffness(x, frequency):
        model = sj.Bushing(law=SPRING, branches=sj.laws.Maxwell([x[0]], [x[1]]), friction=sj.laws.Berg(x[2], x[3]))
        return sj.studies.dynamic_stiffness(model, frequency, x[4]).stiffness[0, 0]

    at = np.array([1e5, 0.02, LIMIT, HALF, 2e-4])
    gradient = jax.grad(stiffness)(jnp.asarray(at), 8.0)
    for i, seed in enumerate(np.eye(5)):
        h = 1e-4 * at * seed
        difference = (stiffness(at + h, 8.0) - stiffness(at - h, 8.0)) / (2e-4 * at[i])
        assert float(gradient[i]) == pytest.approx(float(difference), rel=1e-6)
    mapped = jax.vmap(lambda f: stiffness(jnp.asarray(at), f))(jnp.array([1.0, 8.0]))
    assert float(mapped[1]) == pytest.approx(float(stiffness(at, 8.0)), rel=1e-13)


def test_traced_numbers_that_make_no_sense_give_nan():
    def stiffness(time, frequency):
        return sj.studies.dynamic_stiffness(
            sj.Bushing(law=SPRING, branches=sj.laws.Maxwell([1e5], [time])), frequency, 1e-3
        ).stiffness

    found = jax.vmap(stiffness)(jnp.array([0.1, -0.1, 0.1]), jnp.array([1.0, 1.0, 0.0]))
    assert np.isfinite(np.asarray(found)).ravel().tolist() == [True, False, False]


# Tables and figures ---------------------------------------------------------------------------------------------------

RUBBER = sj.Bushing(
    law=SPRING, branches=sj.laws.Maxwell([6e4, 5e4, 6e4], [0.1, 0.01, 1e-3]), friction=sj.laws.Berg(LIMIT, HALF)
)
TABLE = {"frequencies": FREQUENCIES, "amplitudes": [5e-5, 2e-4, 1e-3]}


def test_tables(tmp_path):
    found = sj.studies.dynamic_stiffness(RUBBER, **TABLE)
    data = found.to_xarray()
    assert data["stiffness"].dims == ("frequency", "amplitude")
    assert data["stiffness"].attrs["units"] == "N/m"
    assert float(data["loss_angle"].sel(amplitude=2e-4)[3]) == float(found.loss_angle[3, 1])
    found.save(tmp_path / "rubber.csv")
    read = np.genfromtxt(tmp_path / "rubber.csv", delimiter=",", names=True)
    assert len(read) == 45
    assert [*read[4].tolist()] == found.rows[4].tolist() == [
        FREQUENCIES[1], 2e-4, float(found.stiffness[1, 1]), float(found.loss_angle[1, 1])
    ]  # fmt: skip
    found.save(tmp_path / "rubber.nc")
    with pytest.raises(sj.SceneError, match="exists"):
        found.save(tmp_path / "rubber.nc")
    text = str(found).splitlines()
    assert text[0].startswith("frequency [Hz]")
    assert text[-1] == "... and 33 more"


def test_figures():
    found = sj.studies.dynamic_stiffness(RUBBER, **TABLE)
    left, right = found.figure().axes
    assert (left.get_xscale(), left.get_yscale(), right.get_yscale()) == ("log", "log", "linear")
    assert [line.get_label() for line in left.lines] == ["0.05 mm", "0.2 mm", "1 mm"]
    assert right.lines[1].get_ydata() == pytest.approx(np.degrees(np.asarray(found.loss_angle)[:, 1]))
    both = sj.plot.dynamic_stiffness(
        {"a": found.to_xarray(), "b": sj.studies.dynamic_stiffness(SPRING, [1.0, 2.0], 1e-3).to_xarray()}
    )
    assert [line.get_label() for line in both.axes[0].lines] == ["a, 0.05 mm", "a, 0.2 mm", "a, 1 mm", "b, 1 mm"]
    with pytest.raises(sj.SceneError, match="no table"):
        sj.plot.dynamic_stiffness({})
    turned = sj.studies.dynamic_stiffness(SIX, 1.0, 0.1, rotation=True).to_xarray()
    with pytest.raises(sj.SceneError, match="no axis in common"):
        sj.plot.dynamic_stiffness({"a": found.to_xarray(), "b": turned})


# Fits -----------------------------------------------------------------------------------------------------------------

START = {"k": 1e5, "stiffness": [1e5, 1e5], "time": [0.2, 0.005], "limit": 20.0, "half": 2e-4}
TRUTH = {"k": K, "stiffness": STIFFNESSES, "time": TIMES, "limit": LIMIT, "half": HALF}
NOISE = {"stiffness": 0.01, "loss_angle": 0.005}


def built(k, stiffness, time, limit, half):
    return sj.Bushing(
        law=sj.laws.VectorElastomer(k, 0.0),
        branches=sj.laws.Maxwell(stiffness, time),
        friction=sj.laws.Berg(limit, half),
    )


def measurements(seed=0):
    """Of the truth, with noise."""
    random = np.random.default_rng(seed)
    frequency, amplitude, stiffness, angle = sj.studies.dynamic_stiffness(built(**TRUTH), **TABLE).rows.T
    stiffness = stiffness * np.exp(NOISE["stiffness"] * random.standard_normal(stiffness.size))
    angle = angle + NOISE["loss_angle"] * random.standard_normal(angle.size)
    return {"frequency": frequency, "amplitude": amplitude, "stiffness": stiffness, "loss_angle": angle}


def test_known_branches_are_found_again_from_noisy_measurements():
    fit = sj.studies.fit_stiffness(built, START, measurements(), noise=NOISE)
    assert fit.succeeded
    true = np.concatenate([np.ravel(value) for value in TRUTH.values()])
    low, high = np.array([fit.interval(0.999)[name] for name in fit.names]).T
    assert np.all((low < true) & (true < high))
    found = np.concatenate([np.ravel(value) for value in fit.estimates.values()])
    assert found == pytest.approx(true, rel=0.15)
    assert 2 * fit.best.cost / (90 - 7) == pytest.approx(1.0, abs=0.5)
    assert "stiffness[1]" in str(fit)
    left, _ = fit.figure().axes
    assert len(left.lines) == 6
    again = fit.predicted(FREQUENCIES, [2e-4])
    exact = sj.studies.dynamic_stiffness(built(**TRUTH), FREQUENCIES, [2e-4])
    assert np.asarray(again.stiffness) == pytest.approx(np.asarray(exact.stiffness), rel=0.01)


def test_exact_measurements_give_exact_numbers_and_tables_of_any_form_the_same(tmp_path):
    exact = sj.studies.dynamic_stiffness(built(**TRUTH), **TABLE)
    exact.save(tmp_path / "rubber.nc")
    rows = exact.rows * [1.0, 1e3, 1e-3, 180 / np.pi]
    head = "frequency [Hz];amplitude [mm];stiffness [N/mm];loss angle [deg]"
    lines = [";".join(repr(float(x)) for x in row) for row in rows]
    (tmp_path / "rubber.csv").write_text("\n".join(["# test stand", head, *lines]))
    for measured in (exact, tmp_path / "rubber.nc", tmp_path / "rubber.csv"):
        fit = sj.studies.fit_stiffness(built, START, measured)
        assert fit.succeeded
        assert fit.estimates["time"] == pytest.approx(TIMES, rel=1e-6)
        assert fit.estimates["limit"] == pytest.approx(LIMIT, rel=1e-6)


def test_noise_is_estimated_where_it_is_not_stated():
    fit = sj.studies.fit_stiffness(built, START, measurements(1))
    assert fit.noise[0] == pytest.approx(np.sqrt((0.01**2 + 0.005**2) / 2), rel=0.3)
    assert not fit.noise_is_known


def test_what_was_not_measured_is_left_out():
    measured = measurements()
    alone = {name: values for name, values in measured.items() if name != "loss_angle"}
    with_holes = {**measured, "loss_angle": np.full(45, np.nan)}
    first, second = (sj.studies.fit_stiffness(built, START, each) for each in (alone, with_holes))
    assert first.best.residuals.size == second.best.residuals.size == 45
    assert first.best.cost == pytest.approx(second.best.cost, rel=1e-9)


def test_what_the_data_cannot_tell_is_named():
    """At one amplitude the friction cannot be told from a stiffer spring."""
    one = sj.studies.dynamic_stiffness(built(**TRUTH), FREQUENCIES, [2e-4])
    fit = sj.studies.fit_stiffness(built, START, one, noise=NOISE)
    assert any("limit" in each.explanation or "half" in each.explanation for each in fit.undetermined)


def test_several_starts():
    fit = sj.studies.fit_stiffness(built, START, measurements(), noise=NOISE, starts=3, rng=1)
    assert len(fit.courses) == 3
    assert fit.best.cost <= min(course.cost for course in fit.courses)
    assert fit.succeeded


# Bad input ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: sj.studies.dynamic_stiffness(sj.Ideal(), 1.0, 1e-3), "Ideal has no dynamic stiffness"),
        (lambda: sj.studies.dynamic_stiffness(SPRING, 0.0, 1e-3), "frequencies"),
        (lambda: sj.studies.dynamic_stiffness(SPRING, 1.0, [1e-3, -1e-3]), "amplitudes"),
        (lambda: sj.studies.dynamic_stiffness(SPRING, 1.0, []), "amplitudes"),
        (lambda: sj.studies.dynamic_stiffness(SPRING, "1", 1e-3), "frequencies"),
        (lambda: sj.studies.dynamic_stiffness(SPRING, 1.0, 1e-3, direction=(0.0, 0.0, 0.0)), "direction"),
        (lambda: sj.studies.dynamic_stiffness(SPRING, 1.0, 1e-3, direction=1.0), "direction"),
        (lambda: sj.studies.dynamic_stiffness(SPRING, 1.0, 1e-3, rotation=True), "leaves rotation free"),
        (
            lambda: sj.studies.dynamic_stiffness(sj.Bushing(K, branches=sj.laws.Maxwell(1.0, -1.0)), 1.0, 1e-3),
            "branches.time",
        ),
        (lambda: sj.studies.fit_stiffness(built, START, 3.0), "cannot read"),
        (lambda: sj.studies.fit_stiffness(built, START, {"frequency": 1.0, "stiffness": 1e5}), "has no 'amplitude'"),
        (lambda: sj.studies.fit_stiffness(built, START, {"frequency": 1.0, "amplitude": 1e-3}), "has no 'stiffness'"),
        (lambda: sj.studies.fit_stiffness(built, START, {**measurements(), "x": 1.0}), "'x' is nothing"),
        (
            lambda: sj.studies.fit_stiffness(built, START, {**measurements(), "stiffness": -1.0}),
            "stiffness must be above zero",
        ),
        (lambda: sj.studies.fit_stiffness(built, START, {**measurements(), "loss_angle": 15.0}), r"\[deg\]"),
        (
            lambda: sj.studies.fit_stiffness(built, START, {**measurements(), "stiffness": [1.0, 2.0]}),
            "do not go together",
        ),
        (lambda: sj.studies.fit_stiffness(built, START, measurements(), noise=-1.0), "noise"),
        (lambda: sj.studies.fit_stiffness(built, START, measurements(), noise={"stiffness": 0.1}), "noise"),
        (lambda: sj.studies.fit_stiffness(built, {**START, "time": [0.1]}, measurements()), "branches.stiffness"),
        (lambda: sj.studies.fit_stiffness(built, START, measurements(), starts=0), "starts"),
        (
            lambda: sj.studies.fit_stiffness(built, START, {n: v[:3] for n, v in measurements().items()}),
            "cannot determine 7 parameters",
        ),
    ],
)
def test_bad_input_is_named(call, named):
    with pytest.raises(sj.SceneError, match=named):
        call()


def test_bad_tables_name_line_and_column(tmp_path):
    path = tmp_path / "stand.csv"
    for text, named in (
        ("frequency,amplitude,stifness\n1,1e-3,1e5", r"stand.csv:1: column 'stifness'.*did you mean 'stiffness'"),
        ("frequency,amplitude,stiffness [N s]\n1,1e-3,1e5", r"stand.csv:1: column 'stiffness'"),
        ("frequency,amplitude,stiffness\n1,1e-3,hard", r"stand.csv:2: column 'stiffness'"),
        ("frequency,amplitude,stiffness\n1,1e-3", r"stand.csv:2: 2 cells"),
    ):
        path.write_text(text)
        with pytest.raises(sj.SceneError, match=named):
            sj.studies.fit_stiffness(built, START, path)
