"""Files: what is written reads back, labelled and with units; nothing is replaced in silence."""

import csv

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
    with pytest.raises(sj.SceneError, match=r"'\.xlsx' names no format; use \.nc or \.csv"):
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
    with pytest.raises(sj.SceneError, match="no readable netCDF file"):
        load(broken)
    table = tmp_path / "table.csv"
    table.write_text("a,b")
    with pytest.raises(sj.SceneError, match="reads netCDF"):
        load(table)
