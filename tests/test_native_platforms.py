"""Machine code on other processors and systems: where it is made, what its text asks for, the numbers on ARM."""

import functools
import os
import re
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import cases
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.compiler import primitive
from spherejax.compiler.emit.llvm import FUNCTION
from spherejax.compiler.emit.llvm_functions import FUNCTIONS, OF_VECTORS_ALONE
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native import platforms
from spherejax.compiler.operations import LIBRARY
from spherejax.compiler.program import scalarize

PLATFORMS = {
    "Linux x86": ("Linux", "x86_64"),
    "Linux ARM": ("Linux", "aarch64"),
    "macOS ARM": ("Darwin", "arm64"),
    "macOS x86": ("Darwin", "x86_64"),
    "Windows": ("Windows", "AMD64"),
    "FreeBSD": ("FreeBSD", "amd64"),
    "nothing": ("", ""),
}


@pytest.fixture
def on(monkeypatch):
    """Sets the platform of this process, as Python tells it, and what the environment variable says."""

    def set_platform(name, setting=""):
        system, machine = PLATFORMS[name]
        monkeypatch.setattr("platform.system", lambda: system)
        monkeypatch.setattr("platform.machine", lambda: machine)
        monkeypatch.setenv(platforms.SETTING, setting)
        return functools.cache(machine_code.is_available.__wrapped__)

    if not machine_code.is_available():
        pytest.skip("no machine code with this jaxlib, or without llvmlite")
    return set_platform


# Where it is made -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PLATFORMS)
def test_machine_code_is_made_where_it_has_been_tested(name, on):
    """Anywhere else XLA compiles everything, and one short warning says so."""
    afresh = on(name)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        available = [afresh(), afresh()]
    if name in ("Linux x86", "Linux ARM"):
        assert available == [True, True]
        assert not said
        return
    assert available == [False, False]
    (word,) = said
    assert word.category is sj.runtime.ConfigurationWarning
    shown = {"macOS ARM": "macOS (aarch64)", "Windows": "Windows (x86_64)", "nothing": "an unknown system"}
    assert (shown.get(name) or name.split()[0]) in str(word.message)
    assert "SPHEREJAX_MACHINE_CODE=0 hides this" in str(word.message)
    assert len(str(word.message)) < 350


@pytest.mark.parametrize("name", PLATFORMS)
def test_it_can_be_switched_off_in_silence_and_asked_for(name, on):
    assert not on(name, "0")()
    if name != "Windows":  # which needs __chkstk, which is not here
        assert on(name, "1")()


def test_what_a_platform_lacks_is_said_before_llvm_ends_the_process(on):
    with pytest.warns(sj.runtime.ConfigurationWarning, match="has no function __chkstk.*Report it, and set"):
        assert not on("Windows", "1")()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda patch, llvm: patch.setattr(llvm, "address_of_symbol", lambda name: None), "no function acos, acosh"),
        (
            lambda patch, llvm: patch.setattr(platforms, "expected", lambda: [0.1] * (len(LIBRARY) + 9)),
            r"wrong numbers \(acos: 1\.047",
        ),
        (lambda patch, llvm: patch.setattr(llvm, "check_jit_execution", _forbidden), "OSError.*not executable here"),
        (lambda patch, llvm: patch.setattr(llvm, "create_mcjit_compiler", _forbidden), "OSError.*not executable here"),
    ],
)
def test_the_small_program_finds_what_is_wrong(change, words, on, monkeypatch):
    import llvmlite.binding as llvm

    assert platforms.check(llvm) == ""
    change(monkeypatch, llvm)
    with pytest.warns(sj.runtime.ConfigurationWarning, match=f"{words}.*XLA compiles everything"):
        assert not on("Linux ARM")()


def _forbidden(*_, **__):
    raise OSError("not executable here")


def test_a_host_whose_features_llvm_cannot_tell_has_its_name(monkeypatch):
    """llvmlite 0.44 raises there; newer versions have none."""
    import llvmlite.binding as llvm

    def untold():
        raise RuntimeError("LLVM is not able to retrieve host CPU features")

    monkeypatch.setattr(llvm, "get_host_cpu_features", untold)
    assert platforms.host(llvm) == (llvm.get_process_triple(), llvm.get_host_cpu_name(), "")


def test_code_of_another_platform_has_another_name(monkeypatch):
    """A home that two machines share: both processors are called "generic"."""
    import llvmlite.binding as llvm

    monkeypatch.setattr(llvm, "get_host_cpu_name", lambda: "generic")
    made = []
    for triple in ("x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu"):
        monkeypatch.setattr(llvm, "get_process_triple", lambda triple=triple: triple)
        made.append(machine_code._machine.__wrapped__(True, True))
    assert made[0] != made[1]


ON_ANOTHER = """
import asyncio, multiprocessing.reduction, os, platform, sys
# These look at the system for themselves.
import diffrax, jax, lineax, llvmlite.binding, numpy as np, optax, optimistix
system, machine, name = sys.argv[1:4]
platform.system, platform.machine, sys.platform = (lambda: system), (lambda: machine), name
if name == "win32":
    sys.modules |= dict.fromkeys(["fcntl", "grp", "pwd", "resource"])
    for missing in ("getuid", "geteuid", "sched_getaffinity", "sysconf"):
        delattr(os, missing)
import spherejax as sj
run = sj.simulate(sj.gallery.physical_pendulum(sj.Dry(1e-4)), np.linspace(0.0, 0.01, 4))
print(*map(float.hex, np.asarray(run.ys).ravel().tolist()))
"""


def run_on(system, machine, name):
    """The states of a run in a process that takes itself for one of another platform, and what it warns of."""
    command = [sys.executable, "-W", "always", "-c", ON_ANOTHER, system, machine, name]
    environment = {**os.environ, platforms.SETTING: ""}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return np.array([float.fromhex(x) for x in done.stdout.split()]), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "machine", "name"), [("Darwin", "arm64", "darwin"), ("Windows", "AMD64", "win32"), ("OS", "chip", "os")]
)
def test_a_run_is_the_same_on_a_platform_without_machine_code(system, machine, name):
    """In a process of its own, without what Windows does not have; every process has one warning."""
    here, said = run_on("Linux", "x86_64", "linux")
    assert "machine code" not in said
    there, said = run_on(system, machine, name)
    assert said.count("spherejax compiles no machine code of its own") == 1
    np.testing.assert_allclose(there, here, rtol=0, atol=1e-11)


# What its text asks for -----------------------------------------------------------------------------------------------


def field(numbers, t, y):
    """Each operation of scalar programs, at least once."""
    a, b, c = y
    return jnp.stack(
        [
            jnp.exp(a) + jnp.exp2(b) + jnp.log(2 + c) + jnp.log1p(a * a) + jnp.expm1(b) + jnp.tanh(c),
            jnp.sin(a) * jnp.cos(b)
            + jnp.tan(c / 4)
            + jnp.arcsin(a / 4)
            + jnp.arccos(b / 4)
            + jnp.arctan2(c, numbers[0]),
            jnp.sinh(a) + jnp.cosh(b) + jnp.arcsinh(c) + jnp.arccosh(2 + a * a) + jnp.arctanh(b / 4) + jnp.cbrt(c),
            (2 + a) ** b
            + jnp.arctan(c)
            + jax.lax.erf(b)
            + jax.lax.erfc(c)
            + jnp.nextafter(a, 1.0)
            + jax.lax.rem(b, 0.3),
            jnp.floor(3 * a)
            + jnp.ceil(3 * b)
            + jnp.round(5 * c)
            + jax.lax.round(5 * a)
            + jnp.sign(b)
            + jnp.sqrt(2 + c),
            jnp.maximum(a, b) + jnp.minimum(b, c) + jnp.clip(c, -0.5, t) + jax.nn.sigmoid(a) + jax.lax.rsqrt(2 + b),
            jnp.where((a > b) & ~(c >= t) | (a != a), numbers[1] / (2 + a), -b) + jnp.where(jnp.isfinite(c), a, t),
        ]
    )


NUMBERS, T, Y = jnp.array([0.7, -0.3]), jnp.array(0.2), jnp.array([0.9, -1.1, 0.15])


def texts_of(*calls):
    """The texts that some functions have compiled, and how each is compiled."""
    if not machine_code.is_available():
        pytest.skip("no machine code with this jaxlib, or without llvmlite")
    texts = {}
    target_of = machine_code.target_of

    def seen(text, *, is_wide, is_optimised, **more):
        texts[text] = is_wide, is_optimised
        return target_of(text, is_wide=is_wide, is_optimised=is_optimised, **more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine_code, "target_of", seen)
        patch.setattr(primitive, "SMALLEST_CALLED", 0)
        for call in calls:
            call()
    return texts


def texts_of_programs():
    """Of one evaluation, and of lanes."""
    program = scalarize(field, NUMBERS, T, Y)
    with machine_code.native_code():
        return texts_of(
            lambda: jax.jit(program).lower(NUMBERS, T, Y),
            lambda: jax.jit(jax.vmap(program, (None, None, 0))).lower(NUMBERS, T, jnp.stack([Y] * 19)),
        )


def texts_of_runs():
    """Of steps and loops: explicit and stiff, of one run and of many, with tangents."""

    def lowered(model, *numbers, over=lambda function: function):
        run = over(lambda c: sj.simulate(cases.ball_in_socket(model(c)), np.linspace(0.0, 1e-3, 3)).ys)
        return lambda: jax.jit(run).lower(*numbers)

    return texts_of(
        lowered(sj.Dry, 1e-4),
        lowered(sj.Dry, 1e-4, over=jax.jacfwd),
        lowered(sj.Dry, jnp.linspace(1e-4, 2e-4, 9), over=jax.vmap),
        lowered(lambda c: sj.Lubricated(c, viscosity=0.4), 1e-4),
    )


CROSS = [
    # Triple, processor, features. The first of each has no more than every processor of its kind.
    ("x86_64-unknown-linux-gnu", "x86-64", ""),
    ("x86_64-unknown-linux-gnu", "x86-64-v3", ""),
    ("aarch64-unknown-linux-gnu", "generic", ""),
    ("aarch64-unknown-linux-gnu", "neoverse-v1", ""),  # Graviton 3, with SVE
    ("arm64-apple-darwin23.0.0", "apple-m1", ""),
    ("x86_64-pc-windows-msvc", "x86-64-v2", ""),
]
OF_LLVM = {"memset", "memcpy", "memmove"}
"""Functions that LLVM calls by itself, which each C library has."""
OF_SYSTEM = {
    # Since 2018 in glibc; processors since 2008 round by themselves.
    "x86_64-unknown-linux-gnu": {"round", "roundeven", "floor", "ceil"},
    "arm64-apple-darwin23.0.0": {"bzero", "__bzero", "memset_pattern16"},
    "x86_64-pc-windows-msvc": {"__chkstk"},
}
CALLED = re.compile(r"^\s+(?:bl|callq?|jmp|b)\s+([A-Za-z_]\w*)(?:@PLT)?\s*(?:[#;/].*)?$", re.MULTILINE)


def symbols_of(text, triple, cpu, features, is_wide, is_optimised):
    """What the machine code of a text calls and does not have."""
    import llvmlite.binding as llvm

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    module = llvm.parse_assembly(machine_code._with_widths(text, is_wide).replace(f"@{FUNCTION}", "@program"))
    how = {"cpu": cpu, "features": features, "opt": 1, "reloc": "pic"}
    machine = llvm.Target.from_triple(triple).create_target_machine(codemodel="jitdefault", jit=True, **how)
    module.triple, module.data_layout = triple, str(machine.target_data)
    if is_optimised:
        builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=1))
        builder.getModulePassManager().run(module, builder)
    assert machine.emit_object(module)
    own = {function.name for function in module.functions if not function.is_declaration}
    # Calls have their names beside them only where everything is near.
    near = llvm.Target.from_triple(triple).create_target_machine(codemodel="small", **how)
    called = CALLED.findall(near.emit_assembly(module))
    if "darwin" in triple:  # each name of C has an underscore in front
        called = [name.removeprefix("_") for name in called]
    return {name for name in called if name not in own and name[0] != "L"}


def calls_of(texts, triple, cpu, features):
    """What the machine code of some texts calls, besides each other."""
    called = set()
    for text, how in texts.items():
        of_others = set(re.findall(r"declare .*@(spherejax_\w+)", text))
        called |= symbols_of(text, triple, cpu, features, *how) - of_others
    return called


@pytest.mark.parametrize(("triple", "cpu", "features"), CROSS)
def test_programs_ask_for_nothing_that_a_platform_lacks(triple, cpu, features):
    """Their text names no processor: LLVM makes code of it for each of them, which calls the C library alone."""
    known = {*LIBRARY.values()}
    called = calls_of(texts_of_programs(), triple, cpu, features)
    assert not called & (FUNCTIONS.keys() - OF_VECTORS_ALONE)
    assert {"pow", "erf", "fmod", "atan2"} <= called <= known | OF_LLVM | OF_SYSTEM.get(triple, set())


@pytest.mark.slow
def test_runs_ask_for_nothing_that_a_platform_lacks():
    texts = texts_of_runs()
    words = "\n".join(texts)
    for part in ("@stages(", "@along(", "<8 x double>", "@sum("):
        assert part in words
    known = {*LIBRARY.values()} | OF_LLVM
    for triple, cpu, features in CROSS:
        assert calls_of(texts, triple, cpu, features) <= known | OF_SYSTEM.get(triple, set())


# On an emulated ARM ---------------------------------------------------------------------------------------------------


def test_arm_code_has_the_numbers_of_this_processor(tmp_path):
    """Object code for ARM, called by a program of C as XLA would, under QEMU."""
    compiler, emulator = "aarch64-linux-gnu-gcc", "qemu-aarch64"
    if not (shutil.which(compiler) and shutil.which(emulator)):
        pytest.skip("no cross compiler (Debian: apt-get install gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user)")
    import llvmlite.binding as llvm

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    program = scalarize(field, NUMBERS, T, Y)
    made = []
    target_of = machine_code.target_of

    def seen(text, **how):
        made.append(text)
        return target_of(text, **how)

    ys = jnp.stack([Y * (1 - 0.05 * k) for k in range(11)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine_code, "target_of", seen)
        patch.setattr(primitive, "SMALLEST_CALLED", 0)
        with machine_code.native_code():
            right = np.asarray(jax.jit(jax.vmap(program, (None, None, 0), 1))(NUMBERS, T, ys))
    (text,) = made
    triple = "aarch64-unknown-linux-gnu"
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu="generic", opt=1, reloc="pic")
    module = llvm.parse_assembly(text.replace(f"@{FUNCTION}", "@program"))
    module.triple, module.data_layout = triple, str(machine.target_data)
    (tmp_path / "program.o").write_bytes(machine.emit_object(module))
    host = tmp_path / "host"
    source = Path(__file__).with_name("native_host.c")
    subprocess.run([compiler, "-O1", "-o", host, source, tmp_path / "program.o", "-lm"], check=True)
    # Lanes are last in memory.
    arguments = [np.asarray(NUMBERS), np.asarray(T), np.asarray(ys).T]
    words = "".join(f"{x.size} {' '.join(map(float.hex, x.ravel().tolist()))}\n" for x in arguments)
    command = [emulator, "-L", "/usr/aarch64-linux-gnu", host, str(len(arguments)), str(right.size)]
    done = subprocess.run(command, input=words, capture_output=True, text=True, check=True)
    numbers = np.array([float.fromhex(x) for x in done.stdout.split()]).reshape(right.shape)
    np.testing.assert_allclose(numbers, right, rtol=1e-14, atol=1e-15)
