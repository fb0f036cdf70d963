"""Whoever waits for a compiler is told so: on a terminal and in a notebook, not in logs, once, and not for a moment."""

import os
import pty
import subprocess
import sys
import threading
import time

import jax
import jax.numpy as jnp
import pytest

import spherejax as sj
from spherejax.foundations import terminals
from spherejax.foundations.terminals import waiting_for
from spherejax.program_cache import cached_jit

RUN = """
import jax.numpy as jnp
import spherejax as sj
for _ in range(2):
    sj.simulate(sj.gallery.four_bar(sj.Lubricated(1e-4)), jnp.linspace(0.0, 0.01, 3))
"""
"""Of a film: an ideal mechanism compiles within the second that nobody is told of."""


def said_on_a_terminal(cache, **environment):
    """What a process writes to standard error where that is a terminal."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "SPHEREJAX_CACHE": str(cache), **environment}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    process = subprocess.Popen([sys.executable, "-c", RUN], stderr=theirs, env=environment)
    assert process.wait(300) == 0
    os.write(theirs, b"end")
    os.close(theirs)
    return os.read(ours, 10_000).decode().removesuffix("end").splitlines()


def test_the_first_process_is_told_and_the_next_has_nothing_to_wait_for(tmp_path):
    *of_start, first, last = said_on_a_terminal(tmp_path)
    assert first == "spherejax: compiling a run; once for each kind of scene ..."
    assert last.startswith("spherejax: compiled a run in ")
    # Its start takes less than is worth a word, or not.
    assert all(line.removeprefix("spherejax: compil").startswith(("ing the", "ed the")) for line in of_start)
    assert said_on_a_terminal(tmp_path) == []
    assert said_on_a_terminal("0", SPHEREJAX_QUIET="1") == []


@pytest.fixture
def watched(monkeypatch):
    monkeypatch.setattr(terminals, "is_watched", lambda: True)
    monkeypatch.setattr(terminals, "SAID_AFTER", 0.05)
    monkeypatch.delenv("SPHEREJAX_QUIET", raising=False)


def test_nothing_is_said_in_logs(monkeypatch, capsys):
    monkeypatch.setattr(terminals, "SAID_AFTER", 0.0)
    with waiting_for("something", "program"):
        time.sleep(0.05)
    assert capsys.readouterr() == ("", "")


@pytest.mark.usefixtures("watched")
def test_workers_of_a_pool_are_silent(monkeypatch, capsys):
    """Each of them would say it beside the bar of the study that they work for."""
    monkeypatch.setattr(terminals.multiprocessing, "parent_process", lambda: "a process")
    with waiting_for("something", "program"):
        time.sleep(0.1)
    assert capsys.readouterr() == ("", "")


@pytest.mark.usefixtures("watched")
def test_the_wait_is_over_when_it_is_compiled(capsys):
    def slow_to_trace(x):
        time.sleep(0.2)
        return jnp.sin(x)

    program = cached_jit(slow_to_trace, what="a sine")
    with waiting_for("all of it", "another program"):
        program(jnp.asarray(1.0))
        assert "compiled" not in capsys.readouterr().err
    assert capsys.readouterr().err.startswith("spherejax: compiled all of it in ")
    program = cached_jit(slow_to_trace, what="a sine")
    program(jnp.asarray(1.0))
    first, last = capsys.readouterr().err.splitlines()
    assert first == "spherejax: compiling a sine; once for each kind of scene ..."
    assert last == "spherejax: compiled a sine in 0 s"
    program(jnp.asarray(2.0))
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("watched")
def test_a_long_run_is_not_taken_for_compiling(capsys):
    told = []

    def run(x):
        jax.debug.callback(lambda: (time.sleep(0.2), told.append(capsys.readouterr().err)))
        return x

    cached_jit(run, what="a run")(jnp.asarray(1.0))
    jax.effects_barrier()
    assert told == [""] or told[0].splitlines()[-1].startswith("spherejax: compiled a run in ")
    assert "compil" not in capsys.readouterr().err


@pytest.mark.usefixtures("watched")
def test_what_fails_is_not_said_to_be_compiled(capsys):
    def fails(x):
        time.sleep(0.2)
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        cached_jit(fails)(jnp.asarray(1.0))
    assert capsys.readouterr().err == "spherejax: compiling fails; once for each kind of scene ...\n"
    time.sleep(0.1)
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("watched")
def test_threads_wait_each_for_itself(capsys):
    def wait(name):
        with waiting_for(name, name):
            time.sleep(0.3)

    threads = [threading.Thread(target=wait, args=(name,)) for name in ("one", "two")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    lines = capsys.readouterr().err.splitlines()
    assert sorted(line.split(";")[0] for line in lines if "compiling" in line) == [
        "spherejax: compiling one",
        "spherejax: compiling two",
    ]
    assert len(lines) == 4


@pytest.mark.usefixtures("watched")
def test_a_linearization_says_that_it_is_compiled(capsys):
    """One word for its many programs."""
    jax.clear_caches()
    sj.linearize(sj.gallery.four_bar(sj.Bushing(1e6, 1e-4)), inputs="gravity.z")
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "spherejax: compiling a linearization; once for each kind of scene ..."
    assert said[1].startswith("spherejax: compiled a linearization in ")
    assert len(said) == 2
