"""Files are written whole or not at all, with every name that a scene can have, and hold their numbers themselves."""

import json
import os

import jax.numpy as jnp
import matplotlib.figure
import numpy as np
import pytest
import xarray

import spherejax as sj
from spherejax.files.paths.drafts import draft_of
from spherejax.output.escapes import escaped, escapes_of, unescaped
from spherejax.output.tables import write_rows

TS = jnp.linspace(0.0, 0.02, 3)
ARRAYS = (".nc", ".zarr", ".h5")


def sloped_names(stiffness=10.0):
    """A pendulum whose parts have slashes in their names, as parts of a front axle have."""
    rod = sj.Body(1.0, (1e-2, 1e-2, 1e-2), (0, 0, -0.5), points={"top": (0, 0, 0.5)})
    return sj.Scene(
        {"rod/x": rod},
        {"front/left": sj.Spherical("ground.o", "rod/x.top")},
        {"shock/1": sj.SpringDamper(("ground.p", "rod/x"), stiffness, 1.0)},
        ground_points={"o": (0, 0, 0), "p": (1, 0, 0)},
    )


@pytest.fixture(scope="module")
def run():
    return sj.simulate(sloped_names(), TS, throw=True)


# Names ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ARRAYS)
def test_names_with_slashes_are_restored(run, tmp_path, suffix):
    again = sj.load(sj.save(run, tmp_path / f"run{suffix}"))
    np.testing.assert_array_equal(again["shock/1.length"], run.force("shock/1")["length"])
    np.testing.assert_array_equal(again.reaction.sel(joint="front/left"), run.reaction("front/left"))
    assert "escaped_names" not in again.attrs


def test_a_table_has_the_names_as_they_are(run, tmp_path):
    heads = sj.save(run, tmp_path / "run.csv").read_text().splitlines()[0]
    assert "shock/1.length [m]" in heads


@pytest.mark.parametrize("suffix", ARRAYS)
def test_dimensions_with_slashes_are_restored(tmp_path, suffix):
    given = xarray.Dataset(
        {"a/b": (("k/1", "axis"), np.arange(6.0).reshape(2, 3)), "a%2Fb": ("axis", [7.0, 8.0, 9.0]), "..": ((), 1.0)},
        {"k/1": [0.5, 1.5], "axis": ["x", "y", "z"]},
    )
    again = sj.load(sj.save(given, tmp_path / f"set{suffix}"))
    xarray.testing.assert_identical(again.drop_attrs(), given)


def test_escapes_never_meet():
    names = ["a/b", "a%2Fb", "a%2Fb%", "plain", " x", ".", "..", "", ".zarray"]
    words = escapes_of(names)
    assert set(words) == set(names) - {"a%2Fb", "a%2Fb%", "plain"}
    assert len({*words.values(), "a%2Fb", "a%2Fb%", "plain"}) == len(names)
    assert not escapes_of(words.values())
    plain = xarray.Dataset({"x": ((), 1.0)})
    assert escaped(plain) is plain
    assert unescaped(plain) is plain


def test_a_sweep_store_holds_names_with_slashes(tmp_path):
    path = tmp_path / "sweep.zarr"
    found = sj.sweep(
        sloped_names, {"stiffness": [5.0, 10.0]}, TS, record=("position.rod/x.z", "shock/1.length"), store=path
    )
    again = sj.open_sweep(path)
    np.testing.assert_array_equal(np.asarray(again["shock/1.length"]), np.asarray(found["shock/1.length"]))
    # Others see them as well, and what describes them is sealed.
    assert "shock%2F1.length" in xarray.open_zarr(path, consolidated=False)
    described = path / "shock%2F1.length" / "zarr.json"
    described.write_text(described.read_text().replace('"units": "m"', '"units": "mm"'))
    with pytest.raises(sj.SceneError, match="what describes its arrays is not what was written"):
        sj.sweep(
            sloped_names, {"stiffness": [5.0, 10.0]}, TS, record=("position.rod/x.z", "shock/1.length"), store=path
        )


# Whole or not at all --------------------------------------------------------------------------------------------------


class Unwritable:
    """What no file format has a place for."""


@pytest.mark.parametrize("suffix", ARRAYS)
def test_a_save_that_fails_leaves_what_was_there(tmp_path, suffix):
    """The last variable cannot be written; the first one is, before that is found."""
    bad = xarray.Dataset({"x": ("n", [1.0, 2.0])}).assign_attrs(bad=Unwritable())
    path = tmp_path / f"set{suffix}"
    with pytest.raises((TypeError, ValueError, sj.SceneError)):
        sj.save(bad, path)
    assert os.listdir(tmp_path) == []
    good = xarray.Dataset({"x": ("n", [3.0, 4.0])})
    sj.save(good, path)
    with pytest.raises((TypeError, ValueError, sj.SceneError)):
        sj.save(bad, path, overwrite=True)
    xarray.testing.assert_identical(sj.load(path), good)
    assert os.listdir(tmp_path) == [path.name]


def failing_rows():
    yield [1.0]
    raise KeyboardInterrupt


def test_a_table_that_is_cut_off_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        write_rows(tmp_path / "table.csv", ["x"], failing_rows())
    assert os.listdir(tmp_path) == []


def test_a_picture_that_fails_leaves_nothing(tmp_path, monkeypatch):
    figure = sj.draw(sj.gallery.four_bar())

    def half(self, fname, **options):
        with open(fname, "wb") as file:
            file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(matplotlib.figure.Figure, "savefig", half)
    with pytest.raises(OSError, match="disk full"):
        figure.savefig(tmp_path / "picture.svg")
    assert os.listdir(tmp_path) == []


def test_a_picture_gets_the_suffix_of_its_format(tmp_path):
    figure = sj.draw(sj.gallery.four_bar())
    figure.savefig(tmp_path / "picture")
    figure.savefig(tmp_path / "other", format="svg")
    assert sorted(os.listdir(tmp_path)) == ["other.svg", "picture.png"]


def test_a_report_or_a_scene_file_that_fails_leaves_nothing(run, tmp_path, monkeypatch):
    import pathlib

    whole = pathlib.Path.write_text

    def half(self, text, **options):
        whole(self, text[: len(text) // 2], **options)
        raise OSError(28, "No space left on device")

    page = run.report
    monkeypatch.setattr(pathlib.Path, "write_text", half)
    with pytest.raises(sj.SceneError, match="No space left"):
        page(tmp_path / "report.html")
    with pytest.raises(sj.SceneError, match="No space left"):
        sj.save_scene(sloped_names(), tmp_path / "scene.toml")
    assert os.listdir(tmp_path) == []


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real.csv").write_text("old")
    (tmp_path / "link.csv").symlink_to(tmp_path / "real.csv")
    with draft_of(tmp_path / "link.csv") as draft:
        draft.write_text("new")
    assert (tmp_path / "link.csv").is_symlink()
    assert (tmp_path / "real.csv").read_text() == "new"


# Files hold their numbers themselves ----------------------------------------------------------------------------------


@pytest.fixture
def secret(tmp_path):
    path = tmp_path / "secret.bin"
    path.write_bytes(b"password" * 4)
    return path


def hdf5_of(path):
    import h5py

    return h5py.File(path, "w")


@pytest.mark.parametrize("suffix", [".nc", ".h5"])
@pytest.mark.parametrize("way", ["storage", "link", "virtual", "deep"])
def test_bytes_of_other_files_are_not_loaded(tmp_path, secret, suffix, way):
    import h5py

    with hdf5_of(tmp_path / "other.h5") as other:
        other["x"] = np.arange(4.0)
    path = tmp_path / f"bad{suffix}"
    with hdf5_of(path) as file:
        place = file.create_group("inner").create_group("more") if way == "deep" else file
        if way == "link":
            file["x"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "x")
        elif way == "virtual":
            layout = h5py.VirtualLayout((4,), "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", (4,))
            file.create_virtual_dataset("x", layout)
        else:
            place.create_dataset("x", (4,), "f8", external=[(str(secret), 0, 32)])
    with pytest.raises(sj.SceneError, match=r"other file|virtual dataset"):
        sj.load(path)


def test_links_within_a_file_are_read(tmp_path):
    import h5py

    path = sj.save(xarray.Dataset({"x": ("n", [1.0, 2.0])}, {"n": [0, 1]}), tmp_path / "set.h5")
    with h5py.File(path, "a") as file:
        file["same"] = h5py.SoftLink("/x")
    np.testing.assert_array_equal(sj.load(path)["same"], [1.0, 2.0])


def test_a_store_with_a_symbolic_link_is_not_loaded(tmp_path, secret):
    path = sj.save(xarray.Dataset({"x": ("n", np.arange(4.0))}), tmp_path / "set.zarr")
    described = json.loads((path / "x" / ".zarray").read_text())
    (path / "x" / ".zarray").write_text(json.dumps({**described, "compressor": None, "filters": None}))
    (path / "x" / "0").unlink()
    (path / "x" / "0").symlink_to(secret)
    with pytest.raises(sj.SceneError, match="symbolic link"):
        sj.load(path)


def test_a_store_that_runs_code_is_not_loaded(tmp_path):
    path = sj.save(xarray.Dataset({"x": ("n", np.arange(4.0))}), tmp_path / "set.zarr")
    described = json.loads((path / "x" / ".zarray").read_text())
    described |= {"filters": [{"id": "pickle", "protocol": 5}], "dtype": "|O"}
    (path / "x" / ".zarray").write_text(json.dumps(described))
    with pytest.raises(sj.SceneError, match="stored as pickles, which may be code"):
        sj.load(path)
