"""Session set-up: JAX as spherejax configures it, a compilation cache, and one thread for each parallel worker."""

import contextlib
import gc
import os
import signal
from pathlib import Path

if "PYTEST_XDIST_WORKER" in os.environ:
    # Workers are the parallelism: threads inside them would only get in each other's way.
    for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(_name, "1")
    flags = " --xla_cpu_multi_thread_eigen=false"
    if not os.environ.get("SPHEREJAX_TEST_OPTIMIZED"):
        # Most of the time goes into compiling programs that run once: a quarter to an eighth less of it without LLVM's
        # optimisation (six files measured). XLA's own passes are as users have them; the slow tests, and any tests
        # without `-n`, are compiled as users' programs are.
        flags += " --xla_backend_optimization_level=0"
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + flags
os.environ.setdefault("MPLBACKEND", "Agg")

ROOT = Path(__file__).resolve().parents[1]
LONG = ROOT / "tests" / "long_tests.txt"
os.environ["SPHEREJAX_CACHE"] = os.environ.get("SPHEREJAX_TEST_CACHE", str(ROOT / ".jax_cache"))

import spherejax  # noqa: E402, F401 - before any other use of JAX, so that its compiler flags take effect

# isort: split
import pytest  # noqa: E402

# What has been imported stays: the collector, a twentieth of a worker's time, need not look through it again and again.
# Nor through what is being traced, behind every few hundred objects: of two files' time a thirtieth, as without it.
gc.collect()
gc.freeze()
gc.set_threshold(50_000, 20, 50)


def pytest_configure(config):
    if "slow" in (config.option.markexpr or "").replace("not slow", ""):
        os.environ["SPHEREJAX_TEST_OPTIMIZED"] = "1"  # for the workers, which start after this
    # Two workers may write the same entry at the same time; JAX then compiles again, which is all that matters.
    config.addinivalue_line("filterwarnings", "ignore:.*persistent compilation cache.*:UserWarning")
    # What `.ci/versions` tries is known to be slower.
    config.addinivalue_line("filterwarnings", "ignore:spherejax cannot compile its own machine code")
    # So is a platform on which machine code is not tried (docs/howto/platforms.md).
    config.addinivalue_line("filterwarnings", "ignore:spherejax compiles no machine code of its own")


def long_tests() -> dict[str, float]:
    """Processor time [s] of the tests that are slow for that reason alone, by name."""
    lines = (line.split(" ", 1) for line in LONG.read_text().splitlines() if line and not line.startswith("#"))
    return {name: float(seconds) for seconds, name in lines}


UNKNOWN = pytest.StashKey[list[str]]()
"""Long tests that are not in the files that were collected."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    known, met = long_tests(), {item.nodeid for item in items}
    whole = set() if any("::" in argument for argument in config.args) else {name.split("::")[0] for name in met}
    config.stash[UNKNOWN] = [name for name in known if name.split("::")[0] in whole and name not in met]
    for item in items:
        if item.nodeid in known:
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Where `SPHEREJAX_TEST_TIMES` names a file, a line with the processor time of each test is added to it."""
    start = sum(os.times()[:4])  # with the processes that it starts and waits for
    result = yield
    if path := os.environ.get("SPHEREJAX_TEST_TIMES"):
        with Path(path).open("a") as file:
            file.write(f"{sum(os.times()[:4]) - start:.1f} {item.nodeid}\n")
    return result


@pytest.fixture
def hears_interrupts():
    """SIGINT raises `KeyboardInterrupt`; a shell tells what it starts in the background to ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


ROOM, MOST = 1.5e9, 2.3e9
"""Memory [bytes] up to which a worker keeps what it has compiled from one file to the next, and within a file."""


def memory() -> float:
    """Of this process [bytes]; where nobody says, no worker keeps anything."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return float("inf")


def let_go():
    """What has been compiled is let go: a worker would grow to 8 GB.

    What the compiler gave back the C library keeps for itself, more than half of a worker's memory, until it is told.
    """
    import ctypes

    import jax

    from spherejax.program_cache.jit import CachedJit

    for programs in [each for each in gc.get_objects() if type(each) is CachedJit]:
        programs.clear()
    jax.clear_caches()
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # of another C library
        ctypes.CDLL("libc.so.6").malloc_trim(0)


@pytest.fixture(autouse=True, scope="module")
def room_for_the_next_file():
    yield
    if memory() > ROOM:
        let_go()


@pytest.fixture(autouse=True)
def room_for_the_next_test():
    yield
    if memory() > MOST:
        let_go()
