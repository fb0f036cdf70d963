"""Other systems and processors, as far as one machine can test them. `docs/howto/platforms.md` has the table."""

import ast
import builtins
import io
import os
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

import spherejax as sj
from spherejax import cli, runtime
from spherejax.program_cache import folders
from spherejax.studies import workers
from spherejax.studies.sweep import lock

PACKAGE = Path(sj.__file__).parent
TEXT = {"open", "fdopen", "read_text", "write_text"}
POSIX_ONLY = {"fcntl", "grp", "pwd", "resource", "termios", "tty", "pty", "posix", "syslog"}
"""Modules that Windows does not have."""
POSIX_NAMES = {"getuid", "geteuid", "getgid", "fork", "sysconf", "sched_getaffinity", "killpg", "chown", "uname"}
"""Names of `os` that Windows does not have."""


def sources():
    return [(path, ast.parse(path.read_text(encoding="utf-8"))) for path in sorted(PACKAGE.rglob("*.py"))]


# Sources --------------------------------------------------------------------------------------------------------------


def test_text_is_read_and_written_as_utf_8():
    """Not in the system's encoding, which is cp1252 on Windows: it cannot read the sources of this package."""
    faults = []
    for path, tree in sources():
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            function = call.func
            name = getattr(function, "attr", getattr(function, "id", ""))
            words = [argument.value for argument in call.args if isinstance(argument, ast.Constant)]
            is_binary = any(isinstance(word, str) and set(word) <= set("rwxab+") and "b" in word for word in words)
            if name not in TEXT or is_binary or any(keyword.arg == "encoding" for keyword in call.keywords):
                continue
            text = ast.unparse(call)
            # Files of Linux alone, files by number, and the metadata of packages, which has no such argument.
            if not text.startswith(("os.open(", "Path('/proc/", "distribution.read_text(")):
                faults.append(f"{path.relative_to(PACKAGE)}:{call.lineno}: {text}")
    assert not faults


def test_what_windows_does_not_have_is_asked_for_with_care():
    """Modules are imported within functions, and names of `os` stand beside a look whether they are there."""
    faults = []
    for path, tree in sources():
        text = path.read_text(encoding="utf-8")
        for node in tree.body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            faults += [f"{path.name}: import {name}" for name in names if name.split(".")[0] in POSIX_ONLY]
        used = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute) and ast.unparse(n.value) == "os"}
        for name in used & POSIX_NAMES:
            if f'hasattr(os, "{name}")' not in text and "except (AttributeError" not in text:
                faults.append(f"{path.name}: os.{name}")
    assert not faults


# Locks, waits, output -------------------------------------------------------------------------------------------------


@pytest.fixture
def windows_locks(monkeypatch):
    """`msvcrt`, as far as locks need it; `fcntl` is not there."""
    locked = {}

    def locking(descriptor, how, n_bytes):
        assert (how, n_bytes) == (2, 1)
        assert os.lseek(descriptor, 0, os.SEEK_CUR) == 10_000  # where nobody reads
        file = os.fstat(descriptor).st_ino
        if locked.setdefault(file, descriptor) != descriptor:
            raise PermissionError(13, "Permission denied")

    monkeypatch.setitem(sys.modules, "fcntl", None)
    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(locking=locking, LK_NBLCK=2))


def test_a_store_is_locked_on_windows_too(windows_locks, tmp_path):
    path = tmp_path / "sweep.zarr"
    taken = f"is being written by process {os.getpid()}"
    with lock.held(path), pytest.raises(sj.SceneError, match=taken), lock.held(path):
        pass
    assert not path.with_name("sweep.zarr.lock").exists()


def test_waits_that_have_to_end_now_and_then_bring_all_results(monkeypatch):
    """As on Windows, where Ctrl-C would not be heard during a wait."""
    monkeypatch.setattr(runtime, "LONGEST_WAIT", 0.01)
    begun = threading.Event()
    pieces = [workers.Piece("slow", lambda: time.sleep(0.1) or begun.is_set()), workers.Piece("quick", begun.set)]
    with workers.workers(workers.Progress(workers.silent, 2)) as pool:
        assert pool.each(pieces) == [True, None]


def test_names_that_the_output_cannot_spell_end_no_command(monkeypatch):
    """A pipe on Windows is written in cp1252, without most of Greek."""
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="cp1252", write_through=True))
    with pytest.raises(UnicodeEncodeError):
        print("stößel_δ")
    cli._print_any_name()
    print("stößel_δ")
    assert raw.getvalue().decode("cp1252").strip() == r"stößel_\u03b4"


# Processors -----------------------------------------------------------------------------------------------------------

ARM = """processor\t: 0
BogoMIPS\t: 243.75
Features\t: fp asimd {features}
CPU implementer\t: 0x41
CPU architecture: 8
CPU variant\t: 0x3
CPU part\t: {part}

processor\t: 1
"""


def kind(monkeypatch, text=None, system="Linux", brand=""):
    """The name of a processor, of whose machine `/proc/cpuinfo` and `sysctl` are given."""

    def opened(path, *_, **__):
        if path == "/proc/cpuinfo" and text is not None:
            return io.StringIO(text)
        raise FileNotFoundError(path)

    with monkeypatch.context() as patch:
        patch.setattr(builtins, "open", opened)
        patch.setattr(sys, "platform", {"Linux": "linux", "Darwin": "darwin", "Windows": "win32"}[system])
        patch.setattr("platform.system", lambda: system)
        patch.setattr("platform.processor", lambda: "arm")
        if brand:
            patch.setattr("subprocess.run", lambda *_, **__: SimpleNamespace(stdout=brand))
        return folders.kind_of_processor.__wrapped__()


def test_processors_are_told_apart_on_every_system(monkeypatch):
    """A home may be shared by machines, or moved: a program for a newer processor would end the process."""
    kinds = [
        kind(monkeypatch, ARM.format(features="crc32", part="0xd0c")),
        kind(monkeypatch, ARM.format(features="crc32 sve", part="0xd0c")),
        kind(monkeypatch, ARM.format(features="crc32", part="0xd40")),
        kind(monkeypatch, None, "Darwin", "Apple M1\n"),
        kind(monkeypatch, None, "Darwin", "Apple M4\n"),
        kind(monkeypatch, None, "Windows"),
    ]
    assert len(set(kinds)) == len(kinds)
    assert kinds[0] == kind(monkeypatch, ARM.format(features="crc32", part="0xd0c"))
    assert kind(monkeypatch, None, "Darwin")  # without sysctl
