"""The compiler on small functions that have nothing to do with mechanisms: Lorenz, a pendulum, a dense solve."""

import ctypes
import re
import shutil
import subprocess
import textwrap
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from spherejax import compiler
from spherejax.compiler import NotScalarizable, ScalarProgram, linear_algebra, native_code, scalarize
from spherejax.compiler.emit.llvm import FunctionText
from spherejax.compiler.runge_kutta import Tableau, explicit


def lorenz(t, y, args):
    del t
    sigma, rho, beta = args
    return jnp.stack([sigma * (y[1] - y[0]), y[0] * (rho - y[2]) - y[1], y[0] * y[1] - beta * y[2]])


def pendulum(t, y, args):
    """Driven and damped, with a guard at a standstill: branches, functions of the library, powers."""
    length, damping = args
    speed = jnp.sqrt(y[1] ** 2 + 1e-12)
    drag = jnp.where(speed > 0.1, damping * speed * y[1], 0.0)
    return jnp.stack([y[1], -9.81 / length * jnp.sin(y[0]) - drag + jnp.exp(-t) * jnp.cos(3 * t)])


def dense_solve(t, y, args):
    """A linear system whose matrix depends on the state, symmetric and positive definite."""
    matrix = args @ args.T + jnp.diag(3.0 + y**2)
    right = jnp.sin(t) + jnp.cos(y)
    return linear_algebra.symmetric_solve(matrix, right[:, None])[:, 0]


_random = np.random.default_rng(5)
CASES = {
    "lorenz": (lorenz, np.array([1.0, 2.0, 3.0]), np.array([10.0, 28.0, 8 / 3])),
    "pendulum": (pendulum, np.array([0.3, -0.7]), np.array([1.2, 0.05])),
    "dense solve": (dense_solve, _random.normal(size=4), _random.normal(size=(4, 4))),
}


@pytest.fixture(params=CASES)
def case(request):
    function, y, args = CASES[request.param]
    return function, scalarize(function, 0.0, y, args), (0.4, y, args)


def independent(function, t, y, args):
    """The same by NumPy, without JAX's operations where there are any to replace."""
    if function is dense_solve:
        return np.linalg.solve(args @ args.T + np.diag(3.0 + y**2), np.sin(t) + np.cos(y))
    if function is lorenz:
        s, r, b = args
        return np.array([s * (y[1] - y[0]), y[0] * (r - y[2]) - y[1], y[0] * y[1] - b * y[2]])
    speed = np.hypot(y[1], 1e-6)
    drag = args[1] * speed * y[1] if speed > 0.1 else 0.0
    return np.array([y[1], -9.81 / args[0] * np.sin(y[0]) - drag + np.exp(-t) * np.cos(3 * t)])


def test_a_program_computes_what_the_function_says(case):
    function, program, arguments = case
    expected = independent(function, *arguments)
    np.testing.assert_allclose(program(*arguments), expected, rtol=1e-12)
    np.testing.assert_allclose(program.compute(*arguments), expected, rtol=1e-12)
    np.testing.assert_allclose(jax.jit(program)(*arguments), expected, rtol=1e-12)


def test_its_derivatives_are_those_of_the_function(case):
    function, program, arguments = case
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(mode(program, 1)(*arguments), mode(function, 1)(*arguments), rtol=1e-10, atol=1e-12)
    check_grads(lambda y: program(arguments[0], y, arguments[2]), (arguments[1],), order=1, rtol=1e-6)


def test_it_is_mapped_over_lanes(case):
    function, program, (t, y, args) = case
    many = y + 0.01 * np.arange(5)[:, None]
    mapped = jax.jit(jax.vmap(program, (None, 0, None)))(t, many, args)
    np.testing.assert_allclose(mapped, [independent(function, t, one, args) for one in many], rtol=1e-12)


@pytest.mark.skipif(not native_code.is_available(), reason="no machine code with this jaxlib")
def test_as_machine_code_it_computes_the_same(case, monkeypatch):
    monkeypatch.setattr("spherejax.compiler.primitive.SMALLEST_CALLED", 0)  # programs this small are XLA's otherwise
    function, program, arguments = case
    with native_code(), native_code.record_ffi_targets() as codes:
        result = jax.jit(lambda *values: program(*values))(*arguments)
    np.testing.assert_allclose(result, independent(function, *arguments), rtol=1e-12)
    (content,) = codes().values()
    assert content[:4] == b"\x7fELF" or content[:4] == b"\xcf\xfa\xed\xfe" or content[:2] == b"\x64\x86"


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_as_c_it_computes_the_same(case, tmp_path):
    function, program, arguments = case
    source, library = tmp_path / "program.c", tmp_path / "program.so"
    # Two functions: what depends on the leading argument alone goes ahead, into an array that the other one reads.
    called = """
void called(const double *t, const double *y, const double *args, double *out) {
  double ahead[rate_ahead_size + 1];
  rate_ahead(t, ahead);
  rate(ahead, t, y, args, out);
}
"""
    source.write_text(f"{ScalarProgram.C_PRELUDE}\n{program.c_source('rate')}{called}")
    subprocess.run(["cc", "-std=c11", "-O1", "-shared", "-fPIC", source, "-o", library, "-lm"], check=True)
    expected = independent(function, *arguments)
    result = np.full(expected.shape, np.nan)
    operands = [np.ascontiguousarray(x, np.float64) for x in arguments]
    pointers = [x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for x in [*operands, result]]
    ctypes.CDLL(str(library)).called(*pointers)
    np.testing.assert_allclose(result, expected, rtol=1e-12)


def test_the_worked_example_of_the_readme_is_what_the_compiler_does():
    """Each number and each line of text in it, but for those that depend on the processor."""
    readme = Path(compiler.__file__).with_name("README.md").read_text(encoding="utf-8")
    example = readme[readme.index("## From a function to machine code") : readme.index("## Where things stand")]
    scope = {"jnp": jnp}
    exec(textwrap.dedent(example[example.index("    def pendulum") : example.index("1. **JAX")]), scope)
    arguments = 0.0, np.ones(2), 1.0
    jaxpr = jax.make_jaxpr(scope["pendulum"])(*arguments)
    assert "Twelve operations" in example
    assert len(jaxpr.eqns) == 12
    program = scalarize(scope["pendulum"], *arguments)
    nodes = [*map(int, re.findall(r"^ +(\d+) (?:input|sin|mul|neg) ", example, re.MULTILINE))]
    graph = program._graph
    assert nodes == graph.needed(program._flat_outputs)
    for node in nodes:
        read = graph.parameters[node] if graph.operations[node] == "input" else graph.arguments[node]
        inside = ", ".join(map(str, read))
        assert re.search(rf"^ +{node} {graph.operations[node]} \({inside}\)", example, re.MULTILINE)
    text = FunctionText(program._line("whole"), (), (0, 0, 0)).written()
    lines = re.findall(r"^ +((?:%v|store).*)$", example, re.MULTILINE)
    assert len(lines) == 8
    for line in lines:
        assert f"  {line}\n" in text


def test_the_table_of_files_in_the_readme_has_all_of_them():
    folder = Path(compiler.__file__).parent
    readme = (folder / "README.md").read_text(encoding="utf-8")
    table = readme[readme.index("## Where things stand") : readme.index("## A step of a Runge-Kutta method")]
    named = {name for row in re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE) for name in re.findall("`(.*?)`", row)}
    assert [name for name in named if not (folder / name).exists()] == []
    files = [path.relative_to(folder) for path in folder.rglob("*.py") if path.name != "__init__.py"]
    assert [path for path in files if not named & {str(path), f"{path.parent}/"}] == []


def test_the_recipe_of_the_readme_is_that_of_an_explicit_step(monkeypatch):
    """Of a program that takes (theta, t, y), with two tangents."""
    steps = []
    monkeypatch.setattr(explicit, "can_be_called", lambda step, size: True)
    monkeypatch.setattr(explicit.machine_code, "native_code_enabled", lambda: True)
    monkeypatch.setattr(explicit, "all_stages", lambda step, *arguments, **_: steps.append(step) or (None, None))
    rate = scalarize(lambda theta, t, y: jnp.sin(theta[0] * y) + t, jnp.ones(1), jnp.zeros(()), jnp.ones(2))
    euler = Tableau.explicit(np.zeros((1, 1)), np.zeros(1), [np.ones(1)])
    numbers, one = jnp.ones((1, 3)), jnp.ones(3)
    explicit.explicit_stages(rate, euler, one, one, one, jnp.ones((3, 2, 3)), 1, numbers, (), (jnp.ones((2, 1, 3)), ()))
    (step,) = steps
    readme = Path(compiler.__file__).with_name("README.md").read_text(encoding="utf-8")
    recipe = readme[readme.index("    StepRecipe(") : readme.index("For each stage i")].replace('"', "'")
    along = step.rows.along
    assert f"rate=LinePart(f, sources={step.rate.sources})" in recipe
    assert f"along=LinePart(f', sources={along.sources}, n_rows={along.n_rows})" in recipe
    assert f"rows=Rows(n={step.rows.n}, arguments={step.rows.arguments}, " in recipe
    assert (step.ahead, step.solve) == ((), None)


def test_what_has_no_rule_is_refused_by_name():
    with pytest.raises(NotScalarizable, match="'qr' has no scalar rule") as refused:
        scalarize(lambda t, y, args: jnp.linalg.qr(jnp.outer(y, y))[1], 0.0, np.ones(3), np.ones(1))
    assert not refused.value.is_too_large
    with pytest.raises(NotScalarizable, match="more than 3 scalar operations") as refused:
        scalarize(lorenz, 0.0, np.ones(3), np.ones(3), maximum_operations=3)
    assert refused.value.is_too_large
