"""What was traced in one process is found by the next one, computes the same, and is never what it is not."""

import errno
import io
import os
import pickle
import subprocess
import sys
import threading
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax import runtime
from spherejax.compiler.program import scalarize
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import program_for
from spherejax.motion.integration import jobs, one_run
from spherejax.motion.integration.lanes import landing
from spherejax.program_cache import cached_jit, disk_cache, folders, settings
from spherejax.program_cache.fingerprints import known_fingerprint, value_fingerprint
from spherejax.program_cache.private import found_by_jax

RUN = """
import sys, jax
traced = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **said: traced.append(said.get("fun_name")) if "trace_duration" in event else None
)
import jax.numpy as jnp
import numpy as np
import spherejax as sj
force = {force}
scene = sj.gallery.simple_pendulum() if force is None else sj.Scene(
    bodies={{"bob": sj.Body(1.0, (1e-3, 1e-3, 1e-3), position=(1.0, 0.0, 0.0))}}, joints={{}}, forces=force
)
run = sj.simulate(scene, jnp.linspace(0.0, 0.3, 4))
print(run.ys.tobytes().hex())
print(any("advance_window" in str(name) for name in traced), "state_rate" in traced, sep="\\n")
"""


def script(cache, force="None", **environment):
    """The last state and whether the run, and its equations, were traced, in a process of its own."""
    environment = {**os.environ, "SPHEREJAX_CACHE": str(cache), **environment}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    code = RUN.format(force=force)
    return subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def answer(process):
    out, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert errors == ""
    states, run, equations = out.split()
    return states, run == "True", equations == "True"


def in_a_process(cache, force="None", **environment):
    return answer(script(cache, force, **environment))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of this process."""
    monkeypatch.setattr(folders, "_in_use", [tmp_path])
    return tmp_path


@pytest.fixture
def pendulum():
    return flatten_system(compile_scene(sj.gallery.simple_pendulum()).system)


# Processes ------------------------------------------------------------------------------------------------------------


def test_the_next_process_traces_nothing_and_computes_the_same_bits(tmp_path):
    first, run, equations = in_a_process(tmp_path)
    assert run
    assert equations
    assert in_a_process(tmp_path) == (first, False, False)
    assert in_a_process("0")[0] == first


LAPACK = """
import jax
traced = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **said: traced.append(said.get("fun_name")) if "trace_duration" in event else None
)
import jax.numpy as jnp
import spherejax
from spherejax.program_cache import cached_jit
from spherejax.compiler.linear_algebra import general
solve = cached_jit(general._by_lapack)
print(solve(jnp.diag(jnp.array([2.0, 4.0])), jnp.ones((2, 1)))[1, 0], any("_by_lapack" in str(name) for name in traced))
"""


def test_a_program_that_calls_lapack_is_loaded_and_runs(tmp_path):
    """It was a segmentation fault: JAX knows LAPACK only after it has lowered a program that calls it."""
    environment = {**os.environ, "SPHEREJAX_CACHE": str(tmp_path)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    said = []
    for _ in range(2):
        made = subprocess.run([sys.executable, "-c", LAPACK], env=environment, capture_output=True, text=True)
        assert made.returncode == 0, made.stderr[-2000:]
        said.append(made.stdout.split())
    assert said == [["0.25", "True"], ["0.25", "False"]]


def test_damaged_files_are_made_anew(tmp_path):
    first, *_ = in_a_process(tmp_path)
    files = list((tmp_path / "kept").iterdir())
    assert len(files) > 3
    for place, file in enumerate(files):
        content = bytearray(file.read_bytes())
        content[place * len(content) // len(files)] ^= 1
        file.write_bytes(content)
    again, run, equations = in_a_process(tmp_path)
    assert again == first
    assert run
    assert equations
    assert in_a_process(tmp_path) == (first, False, False)


def test_processes_may_fill_a_folder_together(tmp_path):
    processes = [script(tmp_path) for _ in range(2)]
    answers = {answer(process)[0] for process in processes}
    assert answers == {in_a_process(tmp_path)[0]}
    assert in_a_process(tmp_path)[1:] == (False, False)
    assert not list(tmp_path.rglob(".new-*"))


def test_without_a_folder_to_write_to_a_run_is_a_run(tmp_path):
    is_a_file = tmp_path / "file"
    is_a_file.write_text("")
    home = tmp_path / "home"
    home.mkdir()
    expected, *_ = in_a_process("0")
    assert in_a_process(is_a_file)[0] == expected
    # Root may write anywhere, so the home is a file as well.
    assert in_a_process("", HOME=str(is_a_file), XDG_CACHE_HOME="")[0] == expected
    assert in_a_process("", HOME=str(home), XDG_CACHE_HOME="")[0] == expected
    assert list((home / ".cache" / "spherejax" / "kept").iterdir())


def test_code_of_a_users_own_is_never_kept(tmp_path):
    def pushed(newtons):
        push = f"sj.functions.UserFunction(lambda t: jnp.array([0.0, 0.0, {newtons}]))"
        return f'dict(push=sj.AppliedWrench("bob", force={push}))'

    answers = [in_a_process(tmp_path, pushed(newtons)) for newtons in (1.0, 2.0, 1.0)]
    assert all(run and equations for _, run, equations in answers)
    assert answers[0][0] == answers[2][0] != answers[1][0]


# Keys -----------------------------------------------------------------------------------------------------------------


def test_the_key_is_over_all_that_goes_in(folder, monkeypatch, pendulum):
    structure, _ = pendulum
    other, _ = flatten_system(compile_scene(sj.gallery.four_bar()).system)
    key = disk_cache.key_for(state_rate, structure)
    assert key is not None
    assert key == disk_cache.key_for(state_rate, structure)
    assert len({key, disk_cache.key_for(state_rate, other), disk_cache.key_for(jobs.job_of, structure)}) == 3
    monkeypatch.setattr(landing, "SAFETY", 0.8)
    assert disk_cache.key_for(state_rate, structure) not in (None, key)
    with jax.numpy_dtype_promotion("strict"):
        assert disk_cache.key_for(state_rate, structure) != key


def test_nothing_is_kept_where_something_cannot_be_told(folder, monkeypatch, pendulum):
    structure, _ = pendulum
    assert disk_cache.key_for(state_rate, structure, lambda: 1) is None
    assert disk_cache.key_for(state_rate, structure, object()) is None

    class Endless:
        """Whatever is asked for, there is another one."""

        def __getattr__(self, name):
            return Endless()

    endless = Endless()
    assert disk_cache.key_for(state_rate, structure, lambda: endless) is None
    with jax.debug_nans(True):
        assert disk_cache.key_for(state_rate, structure) is None
    with monkeypatch.context() as patched:
        patched.setattr(landing, "own_time", lambda share, bend: share)
        assert disk_cache.key_for(state_rate, structure) is None
    with monkeypatch.context() as patched:
        patched.setattr(landing.Landing, "judge", lambda self, *step: step)
        assert disk_cache.key_for(state_rate, structure) is None
    with monkeypatch.context() as patched:
        # As after an edit of a source: this process may hold what the file said before.
        patched.setattr(settings, "_settings", replace(settings.current(), began=0.0))
        assert disk_cache.key_for(state_rate, structure) is None
    with monkeypatch.context() as patched:
        patched.setattr(folders, "_in_use", [])
        assert disk_cache.key_for(state_rate, structure) is None
    assert disk_cache.key_for(state_rate, structure) is not None


def test_functions_of_this_package_are_told_by_what_they_close_over():
    one, two, again = (jobs._magnitudes_of.__wrapped__((name,)) for name in ("a", "b", "a"))
    assert value_fingerprint(one) == known_fingerprint(one) == known_fingerprint(again) != known_fingerprint(two)


def test_trees_are_told_by_the_functions_in_them():
    def tree(function):
        return jax.tree.structure(sj.functions.UserFunction(function))

    assert value_fingerprint(tree(lambda t: 2 * t)) != value_fingerprint(tree(lambda t: 3 * t))
    assert known_fingerprint(tree(lambda t: 2 * t)) is None
    assert known_fingerprint(jax.tree.structure(sj.functions.Sine(1.0, 2.0))) is not None


def test_what_is_in_a_set_is_looked_at_too():
    assert known_fingerprint({1, "a"}) == known_fingerprint({"a", 1}) is not None
    assert known_fingerprint(frozenset({lambda: 1})) is None


@jax.tree_util.register_pytree_node_class
class _Picky:
    """Takes nothing but texts for its leaves."""

    def tree_flatten(self):
        return ("leaf",), None

    @classmethod
    def tree_unflatten(cls, _, leaves):
        assert all(isinstance(leaf, str) for leaf in leaves)
        return cls()


def test_a_tree_that_cannot_be_made_of_numbers_is_told_by_its_text():
    tree = jax.tree.structure(_Picky())
    assert known_fingerprint(tree) is None
    assert value_fingerprint(tree) == value_fingerprint(jax.tree.structure(_Picky()))


# Files ----------------------------------------------------------------------------------------------------------------


def test_a_full_disk_and_what_cannot_be_written_leave_nothing(folder, monkeypatch, pendulum):
    key = disk_cache.key_for("something")
    disk_cache.save(key, lambda: 1)
    assert disk_cache.load(key) is None
    disk_cache.save(key, "kept")
    assert disk_cache.load(key) == "kept"

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    disk_cache.save(disk_cache.key_for("other"), "lost")
    assert disk_cache.load(disk_cache.key_for("other")) is None
    assert [file.name for file in (folder / "kept").iterdir()] == [key]


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owners here")
def test_files_of_others_are_not_opened(folder, monkeypatch):
    """They are pickles, which can hold code."""
    disk_cache.save("key", "kept")
    assert disk_cache.load("key") == "kept"
    assert (folder / "kept").stat().st_mode & 0o077 == 0
    me = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: me + 1)
    assert disk_cache.load("key") is None


def test_nobodys_home_is_done_without(monkeypatch):
    def nobody(_):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "expanduser", nobody)
    monkeypatch.setattr(folders, "_in_use", [])
    monkeypatch.setenv("SPHEREJAX_CACHE", "")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    runtime.configure()
    assert folders.current() is None


def test_processors_are_told_by_the_first_of_a_machine(monkeypatch):
    def kind_with(text):
        monkeypatch.setattr("builtins.open", lambda *_, **__: io.StringIO(text))
        try:
            return folders.kind_of_processor.__wrapped__()
        finally:
            monkeypatch.undo()

    one = "processor : 0\nmodel name : Fast\ncpu MHz : {}\nflags : " + "avx " * 2000 + "{}\n\n"
    kind = kind_with(one.format(1000, "sse"))
    assert kind_with(one.format(2100, "sse") + one.format(1000, "sse")) == kind
    assert kind_with(one.format(1000, "avx512")) != kind


def keyed_by(monkeypatch, key):
    """A function of a test is not told by any version: as if it were."""
    monkeypatch.setattr(disk_cache, "key_for", lambda *_: key)


@pytest.mark.parametrize("warns", [False, True])
def test_what_has_warned_is_traced_again(folder, monkeypatch, warns):
    keyed_by(monkeypatch, os.urandom(8).hex())  # JAX's own cache outlives the tests
    traced = []

    def doubled(x):
        traced.append(x)
        if warns:
            disk_cache.note_warning()
        return 2 * x

    for _ in range(2):
        assert float(cached_jit(doubled)(jnp.asarray(2.0))) == 4.0
    assert len(traced) == 1 + warns


@pytest.mark.parametrize(("found", "n_traced", "is_kept"), [(False, 1, True), (True, 2, False), (None, 1, False)])
def test_only_what_was_compiled_here_is_kept(folder, monkeypatch, found, n_traced, is_kept):
    """What JAX has loaded from its own cache cannot be written again: it is compiled under another name."""
    keyed_by(monkeypatch, "key")
    monkeypatch.setattr("spherejax.program_cache.private.found_by_jax", lambda: nullcontext(lambda: found))
    traced = []

    def halved(x):
        traced.append(x)
        return x / 2

    assert float(cached_jit(halved)(jnp.asarray(2.0))) == 1.0
    assert len(traced) == n_traced
    assert (disk_cache.load("key") is not None) == is_kept


def test_jax_says_whether_it_has_found_a_program():
    name = f"named_{os.urandom(8).hex()}"
    for expected in (False, True):

        def quartered(x):
            return x / 4

        quartered.__name__ = name
        with found_by_jax() as found:
            jax.jit(quartered).lower(jnp.asarray(2.0)).compile()
        assert found() is expected
        jax.clear_caches()


def test_options_of_a_compiler_that_does_not_know_them_are_done_without(folder, monkeypatch):
    keyed_by(monkeypatch, "key")
    tripled = cached_jit(lambda x: 3 * x, options={"xla_has_no_such_option": True})
    assert float(tripled(jnp.asarray(2.0))) == 6.0


@pytest.mark.usefixtures("folder")
def test_what_calls_python_is_not_kept(monkeypatch):
    """Another process has not the function that it would call."""
    keyed_by(monkeypatch, "key")
    called = []

    def counted(x):
        return jax.lax.cond(
            x > 0, lambda x: jax.pure_callback(lambda x: called.append(1) or x, jax.ShapeDtypeStruct((), x.dtype), x),
            lambda x: x, x,
        )  # fmt: skip

    for n in (1, 2):
        assert float(cached_jit(counted)(jnp.asarray(2.0))) == 2.0
        assert len(called) == n
        assert disk_cache.load("key") is None


def test_the_folder_stays_small(tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "MOST_BYTES", 3000)
    for part in ("kept", "compiled-1"):
        (tmp_path / part).mkdir()
        for age in range(4):
            file = tmp_path / part / f"{age}"
            file.write_bytes(bytes(1000))
            then = time.time() - 1000.0 * age - (part == "kept")
            os.utime(file, (then, then))
    (tmp_path / "mine").write_bytes(bytes(10_000))
    folders._make_room(tmp_path)
    left = {str(file.relative_to(tmp_path)) for file in tmp_path.rglob("*") if file.is_file()}
    assert left == {"looked-at", "mine", "kept/0", "compiled-1/0", "compiled-1/1"}
    (tmp_path / "kept" / "large").write_bytes(bytes(10_000))
    folders._make_room(tmp_path)  # looked at a moment ago
    assert (tmp_path / "kept" / "large").exists()


def test_a_folder_that_was_asked_for_must_be_one(tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "_in_use", [])
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(OSError, match="file"):
        runtime.configure(cache=file)


# Programs -------------------------------------------------------------------------------------------------------------


def test_scalar_programs_survive_being_written(pendulum):
    structure, theta = pendulum
    program = program_for(state_rate, structure, None).scalar
    again = pickle.loads(_pickled(program))
    y = np.linspace(0.1, 0.7, program._shapes[2][0])
    assert again.operations == program.operations
    assert np.array_equal(again.dependence(2), program.dependence(2))
    for evaluated in (
        lambda made: made(theta, 0.5, y),
        lambda made: made.compute(theta, 0.5, y),
        lambda made: made.inside(made.ahead(theta), theta, 0.5, y),
        lambda made: jax.jacfwd(made, argnums=2)(jnp.asarray(theta), jnp.asarray(0.5), jnp.asarray(y)),
    ):
        assert np.array_equal(evaluated(again), evaluated(program))


def test_an_operation_that_is_not_of_jax_is_not_written():
    def special(x):
        return jnp.sin(x[0]) + jnp.cosh(x[1]) + jax.scipy.special.erf(x[0])

    program = scalarize(special, jax.ShapeDtypeStruct((2,), jnp.float64))
    x = jnp.array([0.3, 0.4])
    assert float(pickle.loads(_pickled(program))(x)) == float(program(x))
    program._graph.operations[program._graph.operations.index("cosh")] = _Foreign("mine")
    with pytest.raises(pickle.PicklingError, match="mine"):
        _pickled(program)


class _Foreign(jax.extend.core.Primitive):
    pass


def _pickled(value) -> bytes:
    import io

    buffer = io.BytesIO()
    disk_cache._Pickler(buffer).dump(value)
    return buffer.getvalue()


def test_a_loaded_program_serves_traces_too(folder):
    """Under `jax.grad` and `jax.vmap` it is the function again that is traced."""

    def end(length):
        scene = sj.gallery.four_bar(sj.Bushing(length, 1e-2))
        return sj.simulate(scene, jnp.array([0.0, 1e-3]), max_steps=200).position("rocker")[-1, 2]

    value = end(1e5)
    one_run.integrated.clear()
    assert end(1e5) == value
    slope = jax.jvp(end, (1e5,), (1.0,))[1]
    assert np.isfinite(slope)
    assert Path(folder, "kept").exists()


def test_options_of_the_compiler_serve_programs_that_are_not_kept(monkeypatch):
    monkeypatch.setenv("SPHEREJAX_CACHE", "0")
    given, lower = [], jax.stages.Lowered.compile
    monkeypatch.setattr(
        jax.stages.Lowered, "compile", lambda self, compiler_options=None: given.append(compiler_options) or lower(self)
    )
    options = {"xla_llvm_enable_noalias_metadata": False}
    assert cached_jit(lambda x: 5 * x, options=options)(jnp.float64(2.0)) == 10.0
    assert given == [options]


def test_other_threads_may_import_while_a_key_is_made(folder):
    """`spherejax compare` failed so, now and then: the table of modules changed while it was gone through."""
    is_done = threading.Event()

    def importing():
        while not is_done.is_set():
            for i in range(500):
                sys.modules[f"imported_meanwhile_{i}"] = sys
            for i in range(500):
                del sys.modules[f"imported_meanwhile_{i}"]

    thread = threading.Thread(target=importing)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    thread.start()
    try:
        keys = {disk_cache.key_for("something") for _ in range(50)}
    finally:
        is_done.set()
        thread.join()
        sys.setswitchinterval(interval)
    assert len(keys) == 1
    assert None not in keys


def test_a_module_is_looked_at_again_when_a_name_in_it_stands_for_something_else(folder, monkeypatch):
    before = disk_cache.key_for("something")
    assert disk_cache.key_for("something") == before
    with monkeypatch.context() as patched:
        patched.setattr(landing, "SAFETY", landing.SAFETY / 2)
        assert disk_cache.key_for("something") not in (before, None)
    assert disk_cache.key_for("something") == before
    with monkeypatch.context() as patched:  # within a class
        patched.setattr(landing.Landing, "judge", lambda *given: None)
        assert disk_cache.key_for("something") is None
    with monkeypatch.context() as patched:
        patched.setattr(landing, "in_lanes", lambda function: function)
        assert disk_cache.key_for("something") is None
    assert disk_cache.key_for("something") == before
