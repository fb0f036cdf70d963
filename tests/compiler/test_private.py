"""What is private of JAX and XLA: it is as we say, and where a part is missing the results stay right."""

import os
import re
import shutil
import subprocess
import sys
from functools import partial
from types import SimpleNamespace

import jax
import jax.extend.core
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.compiler import hooks, native_code, private, scalarize, xla_flags
from spherejax.compiler.native import compile as native
from spherejax.compiler.native import ffi_abi, loop_fusion

OFFSETS = {
    "FRAME_EXTENSION": "offsetof(XLA_FFI_CallFrame, extension_start)",
    "FRAME_ARGUMENTS": "offsetof(XLA_FFI_CallFrame, args) + offsetof(XLA_FFI_Args, args)",
    "FRAME_RESULTS": "offsetof(XLA_FFI_CallFrame, rets) + offsetof(XLA_FFI_Rets, rets)",
    "BUFFER_DATA": "offsetof(XLA_FFI_Buffer, data)",
    "EXTENSION_TYPE": "offsetof(XLA_FFI_Extension_Base, type)",
    "EXTENSION_METADATA": "XLA_FFI_Extension_Metadata",
    "METADATA_OF_EXTENSION": "offsetof(XLA_FFI_Metadata_Extension, metadata)",
    "METADATA_MAJOR": "offsetof(XLA_FFI_Metadata, api_version) + offsetof(XLA_FFI_Api_Version, major_version)",
    "METADATA_MINOR": "offsetof(XLA_FFI_Metadata, api_version) + offsetof(XLA_FFI_Api_Version, minor_version)",
    "METADATA_TRAITS": "offsetof(XLA_FFI_Metadata, traits)",
    "API_MAJOR": "XLA_FFI_API_MAJOR",
    "API_MINOR": "XLA_FFI_API_MINOR",
}


@pytest.mark.skipif(shutil.which("cc") is None or private.header() is None, reason="no C compiler, or no header")
def test_offsets_are_those_of_the_header_that_is_installed(tmp_path):
    header = private.header()
    assert header is not None
    prints = "\n".join(f'printf("{name} %zu\\n", (size_t)({what}));' for name, what in OFFSETS.items())
    prints += '\nprintf("size %zu\\n", sizeof(XLA_FFI_CallFrame));'
    source = tmp_path / "offsets.c"
    source.write_text(
        f'#include <stdio.h>\n#include <stddef.h>\n#include "{header}"\nint main(void) {{\n{prints}\n}}\n'
    )
    include = header.parents[3]
    subprocess.run(["cc", "-std=c11", f"-I{include}", source, "-o", tmp_path / "offsets"], check=True)
    printed = subprocess.run([tmp_path / "offsets"], check=True, capture_output=True, text=True).stdout
    numbers = dict(re.findall(r"(\w+) (\d+)", printed))
    assert {name: int(numbers[name]) for name in OFFSETS} == {name: getattr(ffi_abi, name) for name in OFFSETS}
    assert ffi_abi.FRAME_RESULTS + 8 <= 8 * ffi_abi.FRAME_WORDS


def with_other_parameters_of_scan(patch):
    """A JAX that has renamed the parameters of its operations."""
    make_jaxpr = jax.make_jaxpr

    def traced(function, *arguments):
        equations = make_jaxpr(function)(*arguments).jaxpr.eqns
        renamed = [e.replace(params={f"new_{name}": value for name, value in e.params.items()}) for e in equations]
        return SimpleNamespace(jaxpr=SimpleNamespace(eqns=renamed))

    patch.setattr(jax, "make_jaxpr", lambda function: partial(traced, function))


NO_JAXLIB = (90, 0), (91, 0)
MISSES = {
    "a known version of jaxlib": lambda patch: patch.setattr(ffi_abi, "KNOWN_JAXLIB", NO_JAXLIB),
    "jax.make_user_context": lambda patch: patch.delattr(jax, "make_user_context"),
    "llvmlite": lambda patch: patch.setitem(sys.modules, "llvmlite", None),
    "version 0.3 of XLA's interface": lambda patch: patch.setattr(ffi_abi, "API_MINOR", 99),
    "numbers of arguments of `scan`": with_other_parameters_of_scan,
    "DropVar": lambda patch: patch.delattr(jax.extend.core, "DropVar"),
    "the setting jax_disable_jit": lambda patch: patch.setattr(jax, "config", SimpleNamespace(values={})),
    "jax.extend.core.jaxprs_in_params": lambda patch: patch.delattr(jax.extend.core, "jaxprs_in_params"),
    "jax._src.xla_bridge.backends_are_initialized": lambda patch: patch.delattr(
        jax._src.xla_bridge, "backends_are_initialized"
    ),
    "options of one program": lambda patch: patch.setattr(xla_flags, "FAST_COMPILE", {"xla_no_such_option": 0}),
    "jax._src.compiler.backend_compile_and_load": lambda patch: patch.setattr(private, "COMPILING", ("no_such_name",)),
    "fields of jaxlib's CompileOptions": lambda patch: patch.setattr(private, "_of_any_length", lambda number: b"\xff"),
    "a jaxlib of which it is known": lambda patch: patch.setattr(xla_flags, "JAXLIB_WITH_LIBRARY", NO_JAXLIB),
}
"""By the beginning of the name of a part: an installation that lacks it."""


@pytest.mark.parametrize(("part", "name"), zip(private.PARTS, MISSES, strict=True), ids=[*MISSES])
def test_the_check_names_the_part_that_is_missing(part, name, monkeypatch, capsys):
    assert part.name.startswith(name)
    before = private.missing()
    if part in before:
        pytest.skip("the installed versions lack it anyway")
    MISSES[name](monkeypatch)
    assert [missing for missing in private.missing() if missing not in before] == [part]
    assert private.main() == 1
    assert f"missing: {part.name}; without it: {part.without}\n" in capsys.readouterr().out


def test_the_check_is_a_command():
    """Nothing that `import spherejax` loads may be run as a command: Python warns that it is loaded twice."""
    for package in ("compiler", "program_cache"):
        command = [sys.executable, "-W", "error", "-m", f"spherejax.{package}.private"]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.stderr == ""
        assert done.stdout.startswith("jax ")


def smooth(y):
    return jnp.sin(y) * y + 1.0


def test_without_the_context_there_is_no_machine_code_but_one_warning(monkeypatch):
    monkeypatch.delattr(jax, "make_user_context", raising=False)
    with pytest.warns(UserWarning, match="has no make_user_context"):
        assert not native.is_available.__wrapped__()
    monkeypatch.setattr(native, "is_available", lambda: False)
    program, y = scalarize(smooth, np.ones(3)), np.array([0.1, 0.2, 0.3])
    with native_code():
        np.testing.assert_allclose(jax.jit(program)(y), np.sin(y) * y + 1.0, rtol=1e-14)


def test_a_name_of_a_dropped_variable_that_is_not_known_changes_no_result(monkeypatch):
    program = scalarize(smooth, np.ones(3))
    monkeypatch.setattr(private, "is_dropped", lambda variable: False)
    other = scalarize(smooth, np.ones(3))
    y = np.array([0.1, 0.2, 0.3])
    np.testing.assert_array_equal(program(y), other(y))
    np.testing.assert_array_equal(jax.jacfwd(program)(y), jax.jacfwd(other)(y))


def test_parameters_of_scan_that_are_not_known_are_refused_by_name():
    with pytest.raises(KeyError, match="ft_in"):
        private.counts_of_scan({"other": 1})


@pytest.mark.skipif(not native_code.is_available(), reason="no machine code with this jaxlib")
def test_an_attribute_that_means_nothing_to_xla_makes_ordinary_calls(monkeypatch):
    """As it would be if XLA gave `xla_cpu_small_call` another name."""
    monkeypatch.setattr("spherejax.compiler.primitive.SMALLEST_CALLED", 0)
    monkeypatch.setattr(private, "KERNEL_ATTRIBUTES", {"no_such_attribute": "true", "inlineable": "false"})
    # The loop is left to XLA, with fused kernels.
    monkeypatch.setattr(loop_fusion, "_as_a_whole", lambda equation, values: None)
    program = scalarize(smooth, np.ones(3))

    def three_times(y):
        return jax.lax.fori_loop(0, 3, lambda i, y: 0.1 * program(y) + jnp.cos(y) * i, y)

    y = np.array([0.1, 0.2, 0.3])
    expected = y
    for i in range(3):
        expected = 0.1 * (np.sin(expected) * expected + 1.0) + np.cos(expected) * i
    np.testing.assert_allclose(jax.jit(native_code()(three_times))(y), expected, rtol=1e-13)


def test_without_the_setting_jit_counts_as_on(monkeypatch):
    with jax.disable_jit():
        assert private.is_jit_disabled()
        monkeypatch.setattr(jax, "config", SimpleNamespace(values={}))
        assert not private.is_jit_disabled()


def test_where_jax_does_not_say_there_is_one_device():
    class Context:
        class module_context:  # noqa: N801 - as it is called there
            axis_context = object()

    assert private.n_devices(Context) == 1


def test_where_jax_does_not_say_its_backend_has_not_started(monkeypatch):
    from jax._src import xla_bridge

    jax.devices()
    assert hooks.has_backend_started()
    monkeypatch.delattr(xla_bridge, "backends_are_initialized")
    assert not hooks.has_backend_started()


FLAGS = """
import os, sys
from spherejax.compiler import hooks, xla_flags
xla_flags.LOOP_OPTIONS = *xla_flags.LOOP_OPTIONS, "xla_cpu_no_such_option=1"
os.environ["XLA_FLAGS"] = hooks.with_xla_flags("")
assert "jax" not in sys.modules
import jax
print(jax.jit(lambda x: x + 1.0)(1.0))
"""


def test_a_loop_option_that_xla_does_not_know_is_passed_over():
    """Other flags that it does not know end the process."""
    environment = {**os.environ, "SPHEREJAX_CONFIGURE": "0", "XLA_FLAGS": ""}
    done = subprocess.run([sys.executable, "-c", FLAGS], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "2.0"
