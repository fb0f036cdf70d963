"""Entries on disk: found by their key, of the kind that was asked for, and never half of one."""

import os

import jax
import jax.numpy as jnp
import pytest

from spherejax.program_cache import cached_jit, disk_cache, folders, package_state, settings


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(settings, "_settings", settings.Settings())
    monkeypatch.setattr(folders, "entries", lambda: tmp_path)
    return tmp_path


def test_an_entry_is_made_once(folder):
    made = []

    def make():
        made.append(1)
        return "entry"

    for _ in range(2):
        assert disk_cache.load_or_make("key", make, str) == "entry"
    assert len(made) == 1
    # Of another kind, as after a change of what is written under a key: made and written over.
    assert disk_cache.load_or_make("key", lambda: 1, int) == 1
    assert disk_cache.load("key") == 1
    for _ in range(2):
        disk_cache.load_or_make(None, make, str)
    assert len(made) == 3


def test_an_entry_is_bound_to_its_key_and_whole(folder):
    disk_cache.save("one", [1.0])
    disk_cache.save("other", [2.0])
    content = (folder / "one").read_bytes()
    for damaged in (content[:-1], content[:40], b"", content[:-1] + b"x", (folder / "other").read_bytes()):
        (folder / "one").write_bytes(damaged)
        assert disk_cache.load("one") is None
    (folder / "one").write_bytes(content)
    assert disk_cache.load("one") == [1.0]


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners and modes of files are those of POSIX")
def test_an_entry_that_others_could_have_written_is_not_read(folder):
    disk_cache.save("key", 1)
    assert (folder / "key").stat().st_mode & 0o777 == 0o600
    for mode in (0o620, 0o602):
        (folder / "key").chmod(mode)
        assert disk_cache.load("key") is None
    (folder / "key").chmod(0o600)
    assert disk_cache.load("key") == 1


def test_without_a_package_programs_are_kept_in_memory_alone(folder):
    """Until `settings.configure` is called, no code has a version: nothing is written."""
    traced = []

    @cached_jit
    def doubled(x):
        traced.append(1)
        return 2 * x

    assert [float(doubled(jnp.float64(x))) for x in (1.0, 2.0)] == [2.0, 4.0]
    assert len(traced) == 1
    assert list(folder.iterdir()) == []


def test_constants_that_hold_functions_are_the_same_in_each_process():
    """A table of records with functions is a constant; with their addresses in the key no process found an entry."""

    def words(number):
        names = {"TABLE": (lambda x: x, number, len), "SCALE": 2.0}
        return package_state._SeenModule("none", names, with_constants=True).words

    first, again = words(1), words(1)
    assert first == again
    assert first is not None
    assert b"0x" not in first
    assert words(2) != first


def test_sources_are_those_of_the_package_that_is_attached_now(folder, monkeypatch):
    """Before a package is attached there are none; that answer stayed, and edits were not seen afterwards."""
    (folder / "one.py").write_text("")
    for sources, names in ((None, []), (folder, ["one.py"]), (None, [])):
        monkeypatch.setattr(settings, "_settings", settings.Settings(sources=sources))
        assert [file.name for file in package_state.sources()] == names


def test_sources_that_are_gone_switch_the_disk_off(folder, monkeypatch):
    """An installer replaces the package while a process uses it: that was a FileNotFoundError."""
    source = folder / "one.py"
    source.write_text("")
    os.utime(source, (0, 0))
    monkeypatch.setattr(settings, "_settings", settings.Settings(sources=folder))
    assert not package_state._has_changed()
    source.unlink()
    assert package_state._has_changed()
    assert package_state.package_state() is None


def test_a_warning_is_told_to_the_contexts_around_it():
    with disk_cache.record_warnings() as outer:
        with disk_cache.record_warnings() as inner:
            assert not inner()
            disk_cache.note_warning()
        with disk_cache.record_warnings() as after:
            pass
        assert (outer(), inner(), after()) == (True, True, False)


def test_settings_that_change_what_programs_do_switch_the_disk_off(folder):
    assert not disk_cache.is_debugging()
    with jax.debug_nans(True):
        assert disk_cache.is_debugging()
        assert disk_cache.key_for("anything") is None
