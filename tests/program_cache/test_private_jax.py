"""What the cache uses of JAX without a public name: where it is missing, results stay right, and it is named."""

import os
import subprocess
import sys
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
    monkeypatch.setattr(settings, "_settings", settings.Settings(package=__name__.split(".")[0]))
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


class ConfigWithout:
    """The settings of JAX, in a version that has one of them under another name."""

    def __init__(self, name, config):
        self.name, self.config = name, config

    @property
    def values(self):
        return {name: value for name, value in self.config.values.items() if name != self.name}

    def __getattr__(self, name):
        if name == self.name:
            raise AttributeError(name)
        return getattr(self.config, name)


@pytest.mark.parametrize("name", ["jax_disable_jit", "jax_compilation_cache_dir"])
def test_with_settings_under_other_names_nothing_is_written(name, folder, monkeypatch):
    monkeypatch.setattr(private, "HIT", "another name")  # no answer of an event instead
    monkeypatch.setattr(private, "MISS", "another name, too")
    monkeypatch.setattr(jax, "config", ConfigWithout(name, jax.config))
    assert float(cached_jit(doubled)(jnp.asarray(2.0))) == 4.0
    assert [*folder.iterdir()] == []


def test_settings_under_other_names_are_named(monkeypatch, capsys):
    monkeypatch.setattr(jax, "config", ConfigWithout("jax_disable_jit", jax.config))
    assert not private.is_jit_disabled()
    assert private.missing() == ["settings by name"]
    assert private.main() == 1
    assert "missing: settings by name; without it: " in capsys.readouterr().out


def test_events_under_other_names_are_named(monkeypatch, capsys):
    monkeypatch.setattr(private, "HIT", "another name")
    monkeypatch.setattr(private, "MISS", "another name, too")
    assert private.missing() == ["events of the compilation cache"]
    assert private.main() == 1
    assert "missing: events of the compilation cache; without it: " in capsys.readouterr().out


def test_the_check_leaves_the_compilation_cache_of_jax_as_it_was():
    """In a process without one: JAX warned that it cannot write to the folder of the check."""
    program = """
import jax
from spherejax.program_cache import private
assert private.missing() == []
assert jax.config.jax_compilation_cache_dir is None
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # so that everything is written
jax.jit(lambda x: x - 1.0)(1.0)
"""
    environment = {**os.environ, "SPHEREJAX_CONFIGURE": "0"}
    command = [sys.executable, "-W", "error", "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr) == (0, "")


def test_where_jax_does_not_say_there_is_one_device(monkeypatch, capsys):
    """As if JAX gave the number of devices another name in the context of a lowering rule."""
    register_lowering, contexts = private.mlir.register_lowering, []

    def register(primitive, rule):
        def lowering(context, x):
            contexts.append(context.module_context.axis_context)
            renamed = SimpleNamespace(n_devices=context.module_context.axis_context.num_devices)
            return rule(SimpleNamespace(module_context=SimpleNamespace(axis_context=renamed)), x)

        register_lowering(primitive, lowering)

    monkeypatch.setattr(private.mlir, "register_lowering", register)
    assert private.missing() == ["the number of devices of a program"]
    assert [context.num_devices for context in contexts] == [2]
    assert private.main() == 1
    assert "missing: the number of devices of a program; without it: " in capsys.readouterr().out
