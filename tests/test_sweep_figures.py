"""Pictures and tables of sweeps: maps, pairs of parameters, fans; failed runs are seen."""

import numpy as np
import pytest
import xarray
from sweeping import pendulum

import spherejax as sj
from spherejax.cli import main
from spherejax.command_line.shown import ShownNumbers, in_units
from spherejax.command_line.sweep_check import changes, check_runs
from spherejax.motion.integration.status import Status
from spherejax.output.plot.swept import FEW_CELLS, figures_of_sweep
from spherejax.output.plot.swept_axes import outliers
from spherejax.studies.sweep import product, sobol_samples, zipped
from spherejax.studies.sweep.dataset import COUNTED, RunsColumn, SweepAccount, coordinates_of, dataset_of

TIMES = np.linspace(0.0, 0.2, 11)


def swept(grid) -> xarray.Dataset:
    """A made-up result: runs with a > 1.6 and b > 0.2 failed."""
    a, b = grid.values["a"], grid.values.get("b", np.full(grid.n_runs, 0.25))
    status = np.where((a > 1.6) & (b > 0.2), Status.TOO_MANY_STEPS, Status.SUCCEEDED)
    failed = status > 0
    peak = np.where(failed, np.nan, a * (1 + b))
    ends = np.where(failed[:, None], np.nan, np.stack([a, b, a - b], 1))
    motion = np.sin(20 * TIMES) * a[:, None]
    motion[failed, 5:] = np.nan
    values = {
        "peak": peak, "ends": ends, "motion": motion, "status": status, "t_reached": np.where(failed, 0.1, 0.2),
        "n_steps": (100 * a).astype(int), "n_rejected": (10 * a).astype(int), "warnings": failed.astype(int),
    }  # fmt: skip
    columns = {"peak": RunsColumn((), {"units": "N"}), "ends": RunsColumn(("axis",), {"units": "m"})}
    columns |= {"motion": RunsColumn(("time",), {"units": "m"}), **{name: RunsColumn((), {}) for name in COUNTED}}
    shaped = {name: each.reshape(*grid.shape, *each.shape[1:]) for name, each in values.items()}
    account = SweepAccount.of_nothing(np.array([True]), grid.n_runs, np.zeros(1), np.zeros(1, int))
    account.add(0, status, values["n_steps"])
    return dataset_of(grid.dims, coordinates_of(grid, TIMES), columns, shaped, {}, account)


def drawn(figure) -> list:
    """Panels that show something."""
    return [ax for ax in figure.axes if ax.axison and ax.get_label() != "<colorbar>"]


def crosses(ax) -> int:
    """Number of marks of failed runs."""
    return sum(len(line.get_xdata()) for line in ax.lines if line.get_marker() == "x")


def texts(figure) -> str:
    return " ".join(text.get_text() for ax in figure.axes for text in ax.texts)


A, B = np.linspace(1.0, 2.0, 6), np.linspace(0.0, 0.3, 4)


def test_a_curve_marks_failed_runs():
    figures = figures_of_sweep(swept(product({"a": A, "b": [0.25]})), "one")
    assert set(figures) == {"peak", "ends", "motion", "n_steps"}
    (panel,) = drawn(figures["peak"])
    assert crosses(panel) == 2
    assert panel.get_xlabel() == "a"
    assert panel.get_ylabel() == "peak [N]"
    # Samples of one parameter are no product, and are drawn in its order.
    (panel,) = drawn(figures_of_sweep(swept(zipped({"a": A[::-1]})))["n_steps"])
    assert np.all(np.diff(panel.lines[0].get_xdata()) > 0)


def test_axes_have_the_units_in_which_parameters_are_told():
    told = in_units(swept(product({"a": A, "b": B})), {"a": ShownNumbers("mm", 1e-3), "b": ShownNumbers()})
    (panel,) = drawn(figures_of_sweep(told)["n_steps"])
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("a [mm]", "b")
    np.testing.assert_allclose(panel.get_xticks(), 1e3 * A)
    told = in_units(swept(zipped({"a": A})), {"a": ShownNumbers("mm", 1e-3)})
    assert drawn(figures_of_sweep(told)["n_steps"])[0].get_xlabel() == "a [mm]"


def test_a_map_marks_failed_cells():
    result = swept(product({"a": A, "b": B}))
    figures = figures_of_sweep(result, "two")
    assert len(drawn(figures["ends"])) == 3
    for panel in drawn(figures["ends"]):
        assert crosses(panel) == int((result["status"] != 0).sum()) == 2
        assert "2 failed runs" in panel.get_title(loc="right")


def test_a_map_has_whole_cells_and_a_constant_has_no_map():
    result = swept(product({"a": A, "b": B}))
    result["ends"] = xarray.where(result["axis"] == result["axis"][1], 0.5, result["ends"]).assign_attrs(units="m")
    result["ends"] = result["ends"].transpose("a", "b", "axis")
    figure = figures_of_sweep(result, "two")["ends"]
    assert len(drawn(figure)) == 2
    assert "is 0.5 in all runs" in figure.get_suptitle()
    for ax in drawn(figure):
        half = np.diff(A)[[0, -1]] / 2
        np.testing.assert_allclose(ax.get_xlim(), (A[0] - half[0], A[-1] + half[1]))
        np.testing.assert_allclose(ax.get_xticks(), A)
        assert crosses(ax) == int((result["status"] > 0).sum()) > 0


def test_a_map_of_many_cells_ends_at_the_swept_values():
    many = np.linspace(1.0, 2.0, FEW_CELLS + 1)
    (panel,) = drawn(figures_of_sweep(swept(product({"a": many, "b": B})), "many")["n_steps"])
    assert panel.get_xlim() == (1.0, 2.0)
    assert len(panel.get_yticks()) == len(B)


@pytest.mark.parametrize("kind", ["product", "samples"])
def test_many_parameters_are_drawn_in_pairs(kind):
    names = ["a", "b", "c", "d"]
    ranges = {"a": (1.0, 2.0), "b": (0.0, 0.3), "c": (0.0, 1.0), "d": (1.0, 5.0)}
    lists = {name: np.linspace(*ranges[name], 3) for name in names}
    grid = product(lists) if kind == "product" else sobol_samples(ranges, 64)
    result = swept(grid)
    figures = figures_of_sweep(result, "many")
    assert set(figures) == {"peak", "ends x", "ends y", "ends z", "motion", "n_steps"}
    panels = drawn(figures["peak"])
    assert len(panels) == 4 + 6
    assert [(ax.get_xlabel(), ax.get_ylabel()) for ax in panels[:3]] == [
        ("a", "peak [N]"),
        ("a", "b"),
        ("b", "peak [N]"),
    ]
    n_failed = int((result["status"] != 0).sum())
    # Over a and b the failed corner of the product is one cell; samples are marked one by one.
    assert crosses(panels[1]) == (1 if kind == "product" else n_failed)
    assert "90 % of the runs" in [text.get_text() for text in figures["motion"].axes[0].get_legend().get_texts()]
    assert len(drawn(figures["motion"])) == 1 + 3
    assert f"{n_failed} runs that failed are left out" in texts(figures["motion"])


def test_a_fan_tells_parameters_apart():
    figure = figures_of_sweep(swept(product({"a": A, "b": B})), "fan")["motion"]
    by_a = drawn(figure)[1]
    # Six values in five groups, from small to large; the motion is proportional to a.
    heights = [line.get_ydata().max() for line in by_a.lines]
    assert len(heights) == 5
    assert heights == sorted(heights)
    assert heights[0] == pytest.approx(np.mean(A[:2]) * np.sin(20 * TIMES).max(), rel=0.01)


def test_more_parameters_than_fit_are_named():
    grid = sobol_samples({name: (1.0, 2.0) for name in "abcdefg"}, 8)
    figure = figures_of_sweep(swept(grid), "seven")["n_steps"]
    assert len(drawn(figure)) == 15
    assert "the first 5 of 7 parameters" in figure.get_suptitle()


def test_the_command_tells_why_runs_failed(tmp_path, capsys, monkeypatch):
    scene, out = tmp_path / "pendulum.toml", tmp_path / "masses.zarr"
    sj.save_scene(pendulum(), scene)
    command = ["sweep", str(scene), "--vary", "bob.mass=-1,0.5,2", "--t1", "0.1", "--samples", "3", "--chunk", "2"]
    command += ["--check", "2"]
    assert main([*command, "--solver", "dopri8", "--record", "final position.bob", "--out", str(out)]) == 0
    captured = capsys.readouterr()
    told = captured.out
    # Where nobody watches there is no bar; on a slow machine a line every ten seconds.
    assert all(line.startswith("spherejax: sweep: ") for line in captured.err.splitlines())
    assert len(told.splitlines()) < 36
    assert "runs that failed" in told
    assert "bob_mass -1 to -1" in told
    assert "2 runs at the tolerances 1e-07 and 1e-08" in told
    assert "bad value: a physical number is not valid" in told
    result = sj.open_sweep(out)
    assert result["status"].values.tolist() == [Status.BAD_VALUE, 0, 0]
    assert result["warnings"].values.tolist() == [1, 0, 0]
    assert sorted(path.name for path in (tmp_path / "masses").iterdir()) == ["final_position_bob.png", "n_steps.png"]
    failed = result.assign(status=0 * result["status"] + Status.BAD_VALUE)
    monkeypatch.setattr(sj, "sweep", lambda *arguments, **options: failed)
    last = ["--check", "0", "--record", "final position.bob", "--no-pictures", "--out", str(tmp_path / "none.nc")]
    assert main([*command, *last]) == 3
    assert "all 3 runs failed" in capsys.readouterr().err
    assert (tmp_path / "none.nc").exists()


def test_a_check_of_the_tolerance_tells_the_largest_change_and_its_run():
    result = swept(zipped({"a": np.linspace(1.0, 2.0, 9)}))
    runs = check_runs(4, 9)
    assert runs == [0, 3, 5, 8]
    again = result.isel(run=runs).copy(deep=True)
    again["peak"][1] *= 1.1
    again["motion"][1, 4] += 1e-3
    peak, motion = changes(result, again, runs, ["peak", "motion"])
    before = float(result["peak"][3])
    assert (peak.run, peak.values, peak.unit) == (3, (before, pytest.approx(1.1 * before)), "N")
    assert peak.share == pytest.approx(0.1 * before / float(result["peak"].max()))
    assert (motion.run, motion.largest) == (3, pytest.approx(1e-3))
    again["status"][:] = Status.BAD_VALUE
    assert changes(result, again, runs, ["peak"]) == []


def test_an_outlier_leaves_the_colors_to_the_others_and_is_told():
    result = swept(product({"a": np.linspace(1.0, 2.0, 9), "b": np.linspace(0.0, 0.3, 7)}))
    name = next(name for name in result.data_vars if set(result[name].dims) == {"a", "b"} and name != "status")
    values = np.outer(1.0 + np.arange(9), 1.0 + np.arange(7))
    values[5, 2] = 4000.0
    result = result.assign({name: (("a", "b"), values, result[name].attrs), "status": 0 * result["status"]})
    figure = figures_of_sweep(result, "one run is far beyond")[name]
    mesh = next(one for ax in figure.axes for one in ax.collections if hasattr(one, "get_clim") and one.get_clim()[1])
    assert mesh.get_clim() == (1.0, 63.0)
    told = " ".join(text.get_text() for ax in figure.axes for text in ax.texts)
    assert "beyond the colors:\n4e+03 at" in told
    assert not outliers(values[:5]).any()  # a steady slope has none
