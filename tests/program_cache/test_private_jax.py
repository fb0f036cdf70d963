"""What the cache uses of JAX without a public name: where it is missing, results stay right, and it is named."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest

from spherejax.program_cache import cached_jit, folders, private, settings


def doubled(x):
    return 2.0 * x


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "entries", lambda: tmp_path)
    # This file stands for a package whose version is known: only such functions are written.
    told = settings.Settings(package=__name__.split(".")[0])
    monkeypatch.setattr(settings, "_settings", told)
    return tmp_path


def test_nothing_is_missing_in_the_versions_that_are_tested():
    assert private.missing() == []


def test_without_an_answer_of_jax_nothing_is_written(folder, monkeypatch):
    """A program that JAX has loaded must not be written: it lacks functions."""
    assert float(cached_jit(doubled)(jnp.asarray(2.0))) == 4.0
    assert len(list(folder.iterdir())) == 1
    before = jax.config.values["jax_compilation_cache_dir"]
    monkeypatch.setattr(private, "HIT", "another name")
    monkeypatch.setattr(private, "MISS", "another name, too")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    try:
        assert float(cached_jit(lambda x: doubled(x) + 1.0)(jnp.asarray(2.0))) == 5.0
        assert float(cached_jit(doubled)(jnp.ones(3))[0]) == 2.0
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
    assert len([file for file in folder.iterdir() if len(file.name) == 64]) == 1


def test_settings_under_other_names_are_named(monkeypatch, capsys):
    monkeypatch.setattr(jax, "config", SimpleNamespace(values={}))
    assert not private.is_jit_disabled()
    assert private.missing() == ["settings by name"]
    assert private.main() == 1
    assert "missing: settings by name; without it: " in capsys.readouterr().out


def test_where_jax_does_not_say_there_is_one_device(monkeypatch):
    monkeypatch.setattr(private, "n_devices", lambda context: 1)
    assert private.missing() == ["the number of devices of a program"]
