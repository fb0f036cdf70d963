"""How far a sweep is, where people look: a terminal, a notebook; and what a signal leaves behind."""

import os
import pty
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from sweeping import pendulum

import spherejax as sj
from spherejax.studies.sweep import crew

TESTS = str(Path(__file__).parent)


@pytest.fixture(scope="module")
def environment():
    """Other processes find the scenes, and what has been compiled."""
    path = os.pathsep.join(filter(None, [TESTS, os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, "SPHEREJAX_QUIET": "1"}


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """A sweep of 256 chunks on the command line, each of up to a second: it outlasts the signal by far."""
    scene = tmp_path_factory.mktemp("scenes") / "pendulum.toml"
    sj.save_scene(pendulum(), scene)
    return [
        *(sys.executable, "-m", "spherejax.cli", "sweep", str(scene), "--vary", "bob.mass=1:2:16384", "--chunk", "64"),
        *("--workers", "1", "--t1", "50", "--samples", "2", "--solver", "dopri8", "--rtol", "1e-10"),
        *("--record", "final position.bob", "--no-pictures", "--out"),
    ]


def shown_until(words: bytes, terminal: int, patience: float = 300) -> bytes:
    """What a program shows up to some words."""
    shown, end = b"", time.monotonic() + patience
    while words not in shown and time.monotonic() < end:
        if select.select([terminal], [], [], 0.1)[0]:
            try:
                shown += os.read(terminal, 65536)
            except OSError:  # the other end is closed
                break
    return shown


@pytest.mark.parametrize("signal_number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_terminal_shows_a_bar_and_a_signal_leaves_a_store(command, environment, tmp_path, signal_number):
    path = tmp_path / "sweep.zarr"
    terminal, other_end = pty.openpty()
    process = subprocess.Popen([*command, str(path)], stdout=other_end, stderr=other_end, env=environment)
    os.close(other_end)
    shown = shown_until(b"per second", terminal)
    process.send_signal(signal_number)
    shown += shown_until(b"goes on from there", terminal, 30)
    code = process.wait(timeout=30)
    os.close(terminal)
    assert b"\x1b[2K" in shown, "a bar is drawn over itself"
    assert b"lane efficiency" in shown
    n_stored = int(np.sum(sj.open_sweep(path)["status"] == 0))
    assert 64 <= n_stored < 16384
    assert n_stored % 64 == 0
    if signal_number == signal.SIGINT:
        assert code == 130
        # A chunk that was being written may have got there yet.
        told = (f"{n:,} of 16,384 runs are in".encode() for n in (n_stored, n_stored - 64))
        assert any(words in shown for words in told)
    else:
        assert code == -signal.SIGTERM


def test_control_comes_back_at_once(tmp_path, monkeypatch):
    # A chunk that takes long, in a thread that nobody can stop.
    is_over = threading.Event()
    monkeypatch.setattr(crew, "compiled_for", lambda *_: None)
    began = []
    # A shell starts what runs in its background with this signal ignored, and Python leaves it so.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)

    def slow_chunk(*_):
        began.append(time.monotonic())
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        is_over.wait(60)

    monkeypatch.setattr(crew, "run_chunk", slow_chunk)
    try:
        with pytest.raises(KeyboardInterrupt) as caught:
            sj.sweep(pendulum, {"gravity": [9.0, 10.0]}, [0.0, 1.0], record=["final position.bob"],
                     workers=1, store=tmp_path / "sweep.zarr", progress=False)  # fmt: skip
        assert time.monotonic() - began[0] < 30
    finally:
        is_over.set()
        signal.signal(signal.SIGINT, before)
    assert "0 of 2 runs are in" in caught.value.__notes__[0]
    assert "goes on from there" in caught.value.__notes__[0]


def test_a_notebook_shows_one_output_that_ends_readable(environment, monkeypatch):
    monkeypatch.setattr(os, "environ", environment)
    code = (
        "import spherejax as sj, numpy as np\n"
        "from sweeping import pendulum\n"
        "s = sj.sweep(pendulum, {'gravity': np.linspace(1, 20, 300)}, [0.0, 1.0], record=['final position.bob'],\n"
        "             chunk=3, workers=1)"
    )
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(code)])
    NotebookClient(notebook, timeout=300).execute()
    (output,) = notebook.cells[0].outputs
    assert output.output_type == "display_data"
    assert output.data["text/plain"].startswith("sweep: 300 of 300 runs, ")
    assert "lane efficiency" in output.data["text/plain"]
    assert 'value="1.0000"' in output.data["text/html"]
