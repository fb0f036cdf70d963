"""Files: what is written reads back, labelled and with units; nothing is replaced in silence."""

import csv
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import spherejax as sj
from spherejax.motion.results.dataset import to_dataset
from spherejax.output.io import load, save

TS = jnp.linspace(0.0, 0.02, 5)


@pytest.fixture(scope="module")
def dry():
    scene = sj.gallery.four_bar(sj.Dry(1e-4, friction=sj.Threlfall()))
    return sj.simulate(scene, TS, track_work=True, throw=True)


@pytest.fixture(scope="module")
def ideal():
    return sj.simulate(sj.gallery.four_bar(), TS, throw=True)


def test_dataset_holds_what_the_run_says(dry):
    ds = to_dataset(dry)
    np.testing.assert_array_equal(ds.position.sel(body="rocker"), dry.position("rocker"))
    np.testing.assert_array_equal(ds.quaternion.sel(body="crank"), dry.quaternion("crank"))
    np.testing.assert_array_equal(ds.acceleration.sel(body="coupler"), dry.acceleration("coupler"))
    np.testing.assert_array_equal(ds.reaction.sel(joint="coupler_rocker"), dry.reaction("coupler_rocker"))
    e = ds.eccentricity.sel(spherical_joint="coupler_rocker")
    np.testing.assert_array_equal(e, dry.eccentricity("coupler_rocker"))
    np.testing.assert_array_equal(
        ds.penetration.sel(clearance_joint="coupler_rocker"), dry.penetration("coupler_rocker")
    )
    np.testing.assert_array_equal(
        ds.dissipated_energy.sel(force_joint="coupler_rocker"), dry.dissipated_energy("coupler_rocker")
    )
    np.testing.assert_array_equal(ds.mechanical_energy, dry.mechanical_energy)
    np.testing.assert_array_equal(ds.joint_memory, dry.state.memory)
    assert ds.clearance.sel(clearance_joint="coupler_rocker") == 1e-4
    assert list(ds.axis.values) == ["x", "y", "z"]


def test_names_belong_to_their_bodies(ideal):
    """At the start the crank's center is at the origin, the coupler's is not."""
    start = to_dataset(ideal).position.isel(time=0)
    np.testing.assert_allclose(start.sel(body="crank"), 0.0, atol=1e-9)
    np.testing.assert_allclose(start.sel(body="coupler"), (-0.037455577, -0.0425, 0.042623654), atol=1e-8)


def test_every_variable_has_a_unit_and_a_name(dry):
    ds = to_dataset(dry)
    for name in [*ds.data_vars, "time"]:
        assert ds[name].attrs["units"], name
        assert ds[name].attrs["long_name"], name
    assert ds.acceleration.attrs["units"] == "m/s^2"


def test_attributes_say_how_the_run_went(dry):
    attributes = to_dataset(dry).attrs
    assert attributes["status"] == "succeeded"
    assert attributes["n_steps"] == int(dry.stats.n_steps) > 0
    assert attributes["method"] == dry.choice
    assert attributes["spherejax_version"]


def test_an_ideal_run_has_no_columns_of_other_models(ideal):
    ds = to_dataset(ideal)
    assert "penetration" not in ds
    assert "joint_memory" not in ds
    assert "dissipated_energy" not in ds
    assert set(ds.spherical_joint.values) == {"crank_coupler", "coupler_rocker"}


def test_every_keeps_every_so_many_samples(ideal):
    ds = to_dataset(ideal, every=2)
    np.testing.assert_array_equal(ds.time, TS[::2])
    np.testing.assert_array_equal(ds.velocity.sel(body="rocker"), ideal.velocity("rocker")[::2])


def test_what_is_kept_of_every_so_many_samples_is_what_there_is_at_them(dry):
    seen = to_dataset(dry).isel(time=slice(None, None, 3))  # it has been observed at all of them now
    xarray.testing.assert_identical(to_dataset(dry, every=3), seen)
    fresh = eqx.tree_at(lambda run: run.ys, dry, np.array(dry.ys))
    assert "observation" not in vars(fresh)
    xarray.testing.assert_allclose(to_dataset(fresh, every=3), seen, rtol=1e-12, atol=1e-12)


def test_a_batch_is_refused(ideal):
    batch = jax.tree.map(lambda x: jnp.stack([x, x]) if isinstance(x, jax.Array) else x, ideal)
    with pytest.raises(sj.SceneError, match="single run"):
        to_dataset(batch)


def test_netcdf_reads_back(dry, tmp_path):
    path = save(dry, tmp_path / "new" / "folder" / "run.nc")
    expected = to_dataset(dry)
    xarray.testing.assert_identical(load(path), expected)
    with xarray.open_dataset(path) as opened:
        assert opened.position.attrs["units"] == "m"


def test_csv_reads_back(dry, tmp_path):
    path = save(dry, tmp_path / "run.csv")
    with path.open() as file:
        rows = list(csv.reader(file))
    heads, numbers = rows[0], np.array(rows[1:], float)
    assert heads[0] == "time [s]"
    assert "mechanical_energy [J]" in heads
    column = numbers[:, heads.index("position rocker z [m]")]
    np.testing.assert_array_equal(column, dry.position("rocker")[:, 2])


def test_a_file_is_replaced_only_on_request(ideal, tmp_path):
    path = save(ideal, tmp_path / "run.nc")
    with pytest.raises(sj.SceneError, match="exists"):
        save(ideal, path)
    assert save(ideal, path, overwrite=True) == path


def test_an_unknown_format_is_refused(ideal, tmp_path):
    with pytest.raises(sj.SceneError, match=r"'\.xlsx' names no format; there are: \.nc, \.zarr"):
        save(ideal, tmp_path / "run.xlsx")


def test_a_path_that_cannot_be_written_is_named(ideal, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(sj.SceneError, match="cannot make the folder"):
        save(ideal, tmp_path / "file" / "run.nc")


def test_load_refuses_what_is_no_netcdf(tmp_path):
    with pytest.raises(sj.SceneError, match="there is no file"):
        load(tmp_path / "absent.nc")
    broken = tmp_path / "broken.nc"
    broken.write_text("this is text")
    with pytest.raises(sj.SceneError, match=r"no readable file of this kind \(netCDF 4\)"):
        load(broken)
    table = tmp_path / "table.csv"
    table.write_text("a,b")
    with pytest.raises(sj.SceneError, match="load reads netCDF"):
        load(table)


def grid():
    """A data set as sweeps make them, with texts, truth values and lists of texts."""
    positions = np.arange(24.0).reshape(2, 2, 3, 2) / 7
    return xarray.Dataset(
        {
            "position.rocker": (("clearance", "mu", "time", "axis"), positions, {"units": "m", "long_name": "place"}),
            "status": (("clearance", "mu"), np.array([[0, 1], [2, 3]]), {"units": "1"}),
            "is_sound": (("clearance", "mu"), np.array([[True, False], [False, True]])),
            "method": ((), "Dopri8"),
        },
        {
            "clearance": ("clearance", [1e-4, 2e-4], {"units": "m"}),
            "mu": [0.1, 0.2],
            "time": ("time", [0.0, 0.5, 1.0], {"units": "s"}),
            "axis": ["x", "z"],
        },
        {"record": ["final", "peak"], "seconds": [0.5, 0.25], "note": "von Größe ⌀"},
    )


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".h5", ".hdf5"])
def test_formats_give_everything_back(dry, tmp_path, suffix):
    run = sj.load(sj.save(dry, tmp_path / f"run{suffix}"))
    xarray.testing.assert_identical(run, to_dataset(dry))
    sweep = sj.load(sj.save(grid(), tmp_path / f"sweep{suffix}"))
    xarray.testing.assert_equal(sweep, grid())
    assert list(sweep.attrs["record"]) == ["final", "peak"]
    assert sweep["position.rocker"].attrs == grid()["position.rocker"].attrs
    assert sweep.attrs["note"] == "von Größe ⌀"
    with pytest.raises(sj.SceneError, match="exists"):
        sj.save(dry, tmp_path / f"run{suffix}")
    assert "mechanical_energy" not in sj.load(sj.save(grid(), tmp_path / f"run{suffix}", overwrite=True))


def test_hdf5_is_read_by_those_who_know_nothing_of_us(dry, tmp_path):
    import h5py

    with h5py.File(sj.save(dry, tmp_path / "run.h5")) as file:
        position = file["position"]
        assert position.attrs["units"] == "m"
        assert [dim.label for dim in position.dims] == ["time", "body", "axis"]
        np.testing.assert_array_equal(position.dims[0][0], TS)
        body = [name.decode() for name in position.dims[1][0][()]].index("rocker")
        np.testing.assert_array_equal(position[:, body], dry.position("rocker"))


def test_zarr_is_read_by_those_who_know_nothing_of_us(dry, tmp_path):
    import zarr

    store = zarr.open_group(sj.save(dry, tmp_path / "run.zarr"), mode="r")
    assert store["position"].attrs["units"] == "m"
    np.testing.assert_array_equal(store["time"][:], TS)


def test_a_sweep_as_a_table_has_a_row_for_each_run_and_sample(tmp_path):
    with sj.save(grid(), tmp_path / "sweep.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        "clearance [m]", "mu", "time [s]", "position.rocker x [m]", "position.rocker z [m]", "status [1]",
        "is_sound",
    ]  # fmt: skip
    assert len(rows) == 12
    for row in rows:
        at = grid().sel(clearance=float(row["clearance [m]"]), mu=float(row["mu"]))
        assert float(row["position.rocker z [m]"]) == at["position.rocker"].sel(time=float(row["time [s]"]), axis="z")
        assert (int(row["status [1]"]), row["is_sound"]) == (int(at["status"]), str(bool(at["is_sound"])))


def test_draws_as_a_table_have_their_numbers_beside_them(tmp_path):
    draws = xarray.Dataset(
        {"peak": ("run", [1.0, 2.0], {"units": "N"}), "response": ("run", [1 + 2j, 3 - 1j], {"units": "m/N"})},
        {"clearance": ("run", [1e-4, 2e-4])},
    )
    lines = sj.save(draws, tmp_path / "draws.csv").read_text().splitlines()
    assert lines[0] == "run,clearance,peak [N],Re response [m/N],Im response [m/N]"
    assert lines[2] == "1,0.0002,2.0,3.0,-1.0"
    names = xarray.Dataset({"estimate": ("parameter", [1.0, 2.0])}, {"parameter": ["k", "c"]})
    assert sj.save(names, tmp_path / "names.csv").read_text().splitlines() == [
        "parameter,estimate",
        "k,1.0",
        "c,2.0",
    ]
    with pytest.raises(sj.SceneError, match="no table"):
        sj.save(xarray.Dataset({"a": 1.0}), tmp_path / "a.csv")


def test_results_of_studies_are_saved_and_others_refused(tmp_path):
    study = SimpleNamespace(to_xarray=grid)
    xarray.testing.assert_equal(sj.load(sj.save(study, tmp_path / "study.h5")), grid())
    response = SimpleNamespace(to_xarray=lambda: grid()["position.rocker"])
    assert "position.rocker" in sj.load(sj.save(response, tmp_path / "response.nc"))
    with pytest.raises(sj.SceneError, match="a dict is no run"):
        sj.save({}, tmp_path / "a.nc")


def test_only_stores_of_ours_are_replaced(tmp_path):
    (tmp_path / "mine.zarr").mkdir()
    (tmp_path / "mine.zarr" / "letters.txt").write_text("dear")
    with pytest.raises(sj.SceneError, match="no Zarr store"):
        sj.save(grid(), tmp_path / "mine.zarr", overwrite=True)
    assert (tmp_path / "mine.zarr" / "letters.txt").read_text() == "dear"
    import zarr

    zarr.open_group(tmp_path / "sweep.zarr", mode="w").attrs["identity"] = "{}"
    with pytest.raises(sj.SceneError, match="store of a sweep"):
        sj.save(grid(), tmp_path / "sweep.zarr", overwrite=True)
