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
from types import SimpleNamespace

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from sweeping import pendulum

import spherejax as sj
from spherejax.motion.integration.lanes import Block
from spherejax.studies.sweep import worker_pool
from spherejax.studies.sweep.chunks import ChunkWork
from spherejax.studies.sweep.store import stored_chunk_size

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
    monkeypatch.setattr(worker_pool, "compiled_for", lambda *_: None)
    began = []
    # A shell starts what runs in its background with this signal ignored, and Python leaves it so.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)

    def slow_chunk(*_):
        began.append(time.monotonic())
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        is_over.wait(60)

    monkeypatch.setattr(worker_pool, "run_chunk", slow_chunk)
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


# How long a chunk takes -----------------------------------------------------------------------------------------------


def paced_size(monkeypatch, seconds, n_runs=60_000, workers=2, size=2000, width=24):
    """Runs in a chunk of a sweep whose runs take so long each."""
    method = SimpleNamespace(block=Block(width))
    work = ChunkWork(pendulum, method, None, (0.0, 1.0), size)  # type: ignore[arg-type]
    monkeypatch.setattr(worker_pool, "compiled_for", lambda *_: None)
    monkeypatch.setattr(
        worker_pool, "run_chunk", lambda _, rows, __: SimpleNamespace(seconds=seconds * worker_pool.n_rows(rows))
    )
    rows = {"gravity": np.linspace(1.0, 2.0, 48)}
    return worker_pool.paced(work, some_runs=lambda n: rows, n_runs=n_runs, workers=workers).size


def test_chunks_of_a_long_sweep_take_seconds(monkeypatch):
    """A sweep of 60,000 lost up to 23 s of each core when it was stopped."""
    for seconds in (0.004, 0.0075, 0.02):
        size = paced_size(monkeypatch, seconds)
        assert size >= worker_pool.FEWEST_FOR_EACH_LANE * 24
        assert size * seconds <= max(worker_pool.CHUNK_SECONDS, worker_pool.FEWEST_FOR_EACH_LANE * 24 * seconds)
        assert size < 2000
    assert paced_size(monkeypatch, 0.0031) == paced_size(monkeypatch, 0.0033)  # one program


def test_chunks_stay_as_they_are_where_it_is_not_worth_compiling_again(monkeypatch):
    assert paced_size(monkeypatch, 1e-4) == 2000  # a chunk takes 0.2 s
    assert paced_size(monkeypatch, 0.01, n_runs=4000) == 2000  # the sweep takes 20 s
    assert paced_size(monkeypatch, 1.0, size=500) == 500  # few runs for each lane


@pytest.mark.slow
def test_a_sweep_makes_the_chunks_that_it_is_paced_to(monkeypatch, tmp_path):
    monkeypatch.setattr(worker_pool, "LONG_SWEEP", 0.0)
    monkeypatch.setattr(worker_pool, "CHUNK_SECONDS", 1e-9)
    monkeypatch.setattr(worker_pool, "FEWEST_FOR_EACH_LANE", 2)
    grid, ts = {"gravity": np.linspace(1.0, 20.0, 30)}, np.linspace(0.0, 0.1, 3)
    options = {"record": ["final position.bob"], "workers": 1, "block": Block(4), "progress": False}
    paced = sj.sweep(pendulum, grid, ts, store=tmp_path / "s.zarr", **options)
    assert stored_chunk_size(tmp_path / "s.zarr") == 8
    whole = sj.sweep(pendulum, grid, ts, chunk=30, **options)
    np.testing.assert_array_equal(paced["final_position.bob"], whole["final_position.bob"])


@pytest.mark.usefixtures("hears_interrupts")
def test_a_stopped_sweep_keeps_what_has_been_computed(monkeypatch, tmp_path):
    """The chunks that threads had finished when the interrupt came were not stored."""
    ready, at_once = [], worker_pool.wait

    def interrupted(under_way, timeout, return_when):
        ready.append(at_once(under_way).done)  # all that were handed out
        if len(ready) == 2:
            raise KeyboardInterrupt
        return at_once(under_way, timeout, return_when=return_when)

    monkeypatch.setattr(worker_pool, "wait", interrupted)
    grid, ts = {"gravity": np.linspace(1.0, 20.0, 12)}, np.linspace(0.0, 0.1, 3)
    options = {"record": ["final position.bob"], "workers": 2, "chunk": 2, "progress": False}
    with pytest.raises(KeyboardInterrupt) as stop:
        sj.sweep(pendulum, grid, ts, store=tmp_path / "s.zarr", **options)
    assert stop.value.__notes__[0].startswith("sweep: stopped; 8 of 12 runs are in ")
