"""Tables, searches, branches by a number, sorts: what a law looks up, in a scalar program, against JAX.

`LAWS` are functions of a number x, a speed v and arrays; `EDGES` are what a table is asked at its ends, with equal
entries, with NaN, with one entry.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from spherejax.compiler import NotScalarizable, native_code, primitive, scalarize
from spherejax.compiler.emit.llvm import FEWEST_ENTRIES
from spherejax.compiler.graph import LARGEST_TABLE
from spherejax.compiler.lookups import LARGEST_SORTED
from spherejax.compiler.operations import WRITTEN_OUT

_random = np.random.default_rng(0)
KNOTS = np.array([-1.0, -0.81, -0.4, -0.33, -0.1, 0.12, 0.21, 0.5, 0.64, 0.97, 1.3])
ENTRIES = np.sin(2 * KNOTS) + 0.1 * _random.normal(size=KNOTS.size)
SPEEDS = np.array([-1.0, -0.3, 0.1, 0.7, 1.1])
MAP = _random.normal(size=(KNOTS.size, SPEEDS.size))
FEW = np.array([0.7, -1.3, 0.4, 1.9])


def hermite(x, v, knots, entries):
    del v
    slopes = jnp.gradient(entries, knots)
    i = jnp.clip(jnp.searchsorted(knots, x, side="right") - 1, 0, knots.size - 2)
    h = knots[i + 1] - knots[i]
    s = (x - knots[i]) / h
    values = (1 + 2 * s) * (1 - s) ** 2 * entries[i] + s**2 * (3 - 2 * s) * entries[i + 1]
    return values + h * (s * (1 - s) ** 2 * slopes[i] + s**2 * (s - 1) * slopes[i + 1])


def bilinear(x, v, knots, speeds, table):
    i = jnp.clip(jnp.searchsorted(knots, x) - 1, 0, knots.size - 2)
    j = jnp.clip(jnp.searchsorted(speeds, v) - 1, 0, speeds.size - 2)
    a, b = (x - knots[i]) / (knots[i + 1] - knots[i]), (v - speeds[j]) / (speeds[j + 1] - speeds[j])
    block = lax.dynamic_slice(table, (i, j), (2, 2))
    return jnp.stack([1 - a, a]) @ block @ jnp.stack([1 - b, b])


def cumulative(x, v, knots, entries):
    del v
    area = jnp.concatenate([jnp.zeros(1), jnp.cumsum(0.5 * (entries[1:] + entries[:-1]) * jnp.diff(knots))])
    return jnp.interp(x, knots, area)


def piecewise(x, v, a):
    return jnp.piecewise(
        v + 0 * x, [v < -0.3, v > 0.4], [lambda v: a[0] * v, lambda v: a[1] * v**2, lambda v: a[2] * v**3]
    )


def on_a_grid(x, v, table):
    grid = jax.scipy.interpolate.RegularGridInterpolator((np.linspace(-1.5, 1.5, 11), np.linspace(-1.5, 1.5, 5)), table)
    return grid(jnp.stack([x, v]))[0]


class Law(NamedTuple):
    """A law and its arrays."""

    function: Callable
    arrays: tuple[np.ndarray, ...]


LAWS = {
    "interpolated": Law(lambda x, v, xs, fs: jnp.interp(x, xs, fs) * v, (KNOTS, ENTRIES)),
    "of a known table": Law(lambda x, v, a: a[0] * jnp.interp(x, KNOTS, ENTRIES) * v, (FEW,)),
    "beyond the ends": Law(lambda x, v, xs, fs: jnp.interp(3 * x, xs, fs, left=-2.0, right=fs[0]), (KNOTS, ENTRIES)),
    "extrapolated": Law(
        lambda x, v, xs, fs: jnp.interp(3 * x, xs, fs, left="extrapolate", right="extrapolate"), (KNOTS, ENTRIES)
    ),
    "periodic": Law(lambda x, v, xs, fs: jnp.interp(5 * x, xs, fs, period=2.5), (KNOTS, ENTRIES)),
    "with a part of zeros": Law(
        lambda x, v, xs, fs: jnp.interp(x, jnp.concatenate([jnp.zeros(2) - 2, xs]), jnp.append(jnp.zeros(2), fs)),
        (KNOTS, ENTRIES),
    ),
    "hermite": Law(hermite, (KNOTS, ENTRIES)),
    "a map": Law(bilinear, (KNOTS, SPEEDS, MAP)),
    "map_coordinates": Law(
        lambda x, v, z: jax.scipy.ndimage.map_coordinates(z, [5 + 6 * x, 2 + v], order=1, mode="nearest"), (MAP,)
    ),
    "on a grid": Law(on_a_grid, (MAP,)),
    "cumulative": Law(cumulative, (KNOTS, ENTRIES)),
    "digitized": Law(lambda x, v, xs, fs: jnp.take(fs, jnp.digitize(x, xs)) * v, (KNOTS[1:], ENTRIES)),
    "select": Law(
        lambda x, v, a: jnp.select([x < -0.5, x < 0.1, v > 0.0], [a[0] * x, a[1] * x**2, a[2] * v], a[3]), (FEW,)
    ),
    "piecewise": Law(piecewise, (FEW,)),
    "switch": Law(
        lambda x, v, a: lax.switch(
            jnp.floor(3 * x).astype(jnp.int32) + 1,
            [lambda: a[0] * v, lambda: a[1] * v**2, lambda: a[2] * jnp.sin(v)],
        ),
        (FEW,),
    ),
    "nearest": Law(lambda x, v, xs: (x - xs[jnp.argmin(jnp.abs(xs - x))]) * v, (KNOTS,)),
    "largest": Law(lambda x, v, a: (lambda f: f[jnp.argmax(jnp.abs(f))])(a[:3] * jnp.stack([x, v, x * v])), (FEW,)),
    "median": Law(lambda x, v, a: jnp.median(a * jnp.stack([x, v, x * v, 2 * x])), (FEW,)),
    "sorted": Law(lambda x, v, a: jnp.sort(a * jnp.stack([x, v, x * v, 2 * x])) @ jnp.arange(1.0, 5.0), (FEW,)),
    "counted": Law(
        lambda x, v, a: (
            jnp.histogram(jnp.stack([x, v, x * v]), bins=np.linspace(-2, 2, 5), weights=a[:3])[0] @ jnp.arange(4.0)
        ),
        (FEW,),
    ),
    "changed": Law(
        lambda x, v, a: (lambda i: a.at[i].add(v) @ jnp.arange(4.0) + a.at[i].set(x)[1])(
            jnp.floor(2 * x).astype(int) + 2
        ),
        (FEW,),
    ),
    "modulo": Law(lambda x, v, a: a[jnp.floor(7 * x).astype(int) % 4] * v, (FEW,)),
    "one_hot": Law(lambda x, v, a: jax.nn.one_hot(jnp.floor(2 * x).astype(int) + 2, 4) @ a * v, (FEW,)),
}

XS, VS = np.array([-0.93, -0.28, 0.05, 0.33, 0.71, 0.88]), np.array([0.35, -0.52, 0.63, -0.11, 0.22, -0.9])
"""Where all of these have derivatives."""


@pytest.fixture(autouse=True)
def small_programs_are_called(monkeypatch):
    monkeypatch.setattr(primitive, "SMALLEST_CALLED", 0)


def programs(name: str):
    law = LAWS[name]
    arrays = tuple(map(jnp.asarray, law.arrays))

    def function(x, v, arrays):
        return law.function(x, v, *arrays)

    return function, scalarize(function, 0.0, 0.0, arrays), arrays


def natively(function: Callable, *arguments):
    """By machine code, where there is some."""
    with native_code():
        lowered = jax.jit(function).lower(*arguments)
    if native_code.is_available():
        assert "stablehlo.custom_call @spherejax_" in lowered.as_text()
    return lowered.compile()(*arguments)


def agrees(ours, right, rtol=1e-12) -> None:
    for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(right), strict=True):
        if np.asarray(b).dtype == float:
            np.testing.assert_allclose(a, b, rtol=rtol, atol=1e-13)
        else:
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_what_jax_makes_of_it(name):
    function, program, arrays = programs(name)
    right = [function(x, v, arrays) for x, v in zip(jnp.asarray(XS), jnp.asarray(VS), strict=True)]
    agrees([program.compute(x, v, arrays) for x, v in zip(XS, VS, strict=True)], right)
    own = jax.tree.map(lambda a: jnp.stack([a] * XS.size), arrays)
    for axes, of_lanes in (((0, 0, None), arrays), ((0, 0, 0), own)):
        lanes = jax.vmap(program, axes)
        agrees(jax.jit(lanes)(XS, VS, of_lanes), jnp.stack(right))
        agrees(natively(lanes, XS, VS, of_lanes), jnp.stack(right))
    agrees(natively(program, XS[1], VS[1], arrays), right[1])


@pytest.mark.parametrize("name", LAWS)
def test_its_derivatives_are_those_of_jax_and_of_differences(name):
    """By what is looked up, by the entries of the table and by its knots, forward and back."""
    function, program, arrays = programs(name)
    along = jax.tree.map(lambda a: jnp.asarray(np.random.default_rng(1).normal(size=np.shape(a))), (0.0, 0.0, arrays))

    def at(x, v):
        return (jnp.asarray(x), jnp.asarray(v), arrays), along

    def forward(x, v):
        point, tangents = at(x, v)
        return jax.jvp(program, point, tangents)[1]

    def back(x, v):
        return jax.grad(program, (0, 1, 2))(*at(x, v)[0])

    h = 1e-7
    for x, v in zip(XS[:4], VS[:4], strict=True):
        point, tangents = at(x, v)
        moved = [jax.tree.map(lambda a, t, h=h: a + h * t, point, tangents) for h in (h, -h)]
        difference = (function(*moved[0]) - function(*moved[1])) / (2 * h)
        slope = jax.jvp(function, point, tangents)[1]
        np.testing.assert_allclose(slope, difference, rtol=1e-5, atol=1e-6)
        agrees(natively(forward, x, v), slope, 1e-10)
        agrees(jax.jit(forward)(x, v), slope, 1e-10)
        gradient = jax.grad(function, (0, 1, 2))(*point)
        agrees(natively(back, x, v), gradient, 1e-10)
    agrees(
        natively(jax.vmap(back), XS, VS),
        jax.vmap(lambda x, v: jax.grad(function, (0, 1, 2))(*at(x, v)[0]))(XS, VS),
        1e-10,
    )


# At their ends --------------------------------------------------------------------------------------------------------

nan, inf = np.nan, np.inf
ANY = np.array([nan, -inf, -9.0, -1.5, -1.0, -0.5, -0.0, 0.0, 0.2, 0.99, 1.0, 1.5, 2.0, 3.0, 3.7, 4.0, 5.5, 1e12, inf])
"""What is asked for."""

EQUAL = np.array([-1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 2.0])
WITH_NAN = np.array([-1.0, 0.0, 1.0, nan, nan])
ODD = {
    "equal": EQUAL, "with NaN": WITH_NAN, "one": np.array([0.2]), "falling": -EQUAL,
    "infinite": np.array([-inf, 0.0, inf]),
    "zeros of both signs": np.array([-0.0, 0.0, -0.0]), "NaN in front": np.array([nan, 0.0, 1.0]),
}  # fmt: skip


def place(x, dtype=int):
    return jnp.floor(x).astype(dtype)


def edges():
    for kind, table in ODD.items():
        for side in ("left", "right"):
            for method in ("scan", "scan_unrolled", "compare_all", "sort"):
                yield (
                    f"searched by {method} and {side}, {kind}",
                    lambda x, a, side=side, method=method: jnp.searchsorted(a, x, side=side, method=method),
                    table,
                )
        yield f"digitized, {kind}", lambda x, a: jnp.digitize(x, a), table
        yield f"interpolated, {kind}", lambda x, a: jnp.interp(x, a, jnp.arange(1.0, a.size + 1)), table
        for largest in (jnp.argmax, jnp.argmin, jnp.nanargmax, jnp.nanargmin):
            yield f"{largest.__name__}, {kind}", lambda x, a, largest=largest: largest(jnp.append(a, x)), table
        yield f"sorted, {kind}", lambda x, a: jnp.sort(jnp.append(a, x)), table
        yield f"sorted down, {kind}", lambda x, a: jnp.sort(jnp.append(x, a), descending=True), table
        yield f"order, {kind}", lambda x, a: jnp.argsort(jnp.append(a, x)), table
        yield f"order by two, {kind}", lambda x, a: jnp.lexsort((a, jnp.where(a > x, 1.0, 0.0))), table
    for n in (1, FEWEST_ENTRIES, WRITTEN_OUT + 1):
        table = np.linspace(1.0, 2.0, n)
        for mode in ("fill", "clip", "promise_in_bounds"):
            if mode == "promise_in_bounds":
                yield (
                    f"read, {mode}, {n}",
                    lambda x, a, m=mode: a.at[jnp.clip(place(x), 0, a.size - 1)].get(mode=m),
                    table,
                )
                continue
            yield f"read, {mode}, {n}", lambda x, a, m=mode: a.at[place(x)].get(mode=m), table
            yield f"taken, {mode}, {n}", lambda x, a, m=mode: jnp.take(a, place(x, jnp.int32), mode=m), table
            yield f"several, {mode}, {n}", lambda x, a, m=mode: a.at[place(x) + np.arange(3)].get(mode=m), table
            for how in ("set", "add", "mul", "min", "max"):
                yield (
                    f"{how}, {mode}, {n}",
                    lambda x, a, m=mode, how=how: getattr(a.at[place(x)], how)(1.3, mode=m),
                    table,
                )
            yield f"rows, {mode}, {n}", lambda x, a, m=mode: jnp.outer(a, a[:2]).at[place(x)].get(mode=m), table
            yield (
                f"whole, {mode}, {n}",
                lambda x, a, m=mode: jnp.arange(3, 3 + a.size).at[place(x)].get(mode=m) - 2,
                table,
            )
            yield (
                f"truths, {mode}, {n}",
                lambda x, a, m=mode: (jnp.arange(a.size) % 3 == 1).at[place(x)].get(mode=m),
                table,
            )
            yield f"of 8 bits, {mode}, {n}", lambda x, a, m=mode: a.at[place(x, jnp.uint8)].get(mode=m), table
        yield f"wrapped, {n}", lambda x, a: jnp.take(a, place(x, jnp.int32), mode="wrap"), table
        yield f"indexed, {n}", lambda x, a: a[place(x)], table
        yield f"a part, {n}", lambda x, a: lax.dynamic_slice(a, (place(x),), ((a.size + 1) // 2,)), table
        yield (
            f"a part set, {n}",
            lambda x, a: lax.dynamic_update_slice(a, a[: (a.size + 1) // 2] * 7, (place(x),)),
            table,
        )
        yield f"selected, {n}", lambda x, a: lax.select_n(jnp.clip(place(x), -3, 40).astype(jnp.int32), *a), table
        yield (
            f"branch, {n}",
            lambda x, a: lax.switch(place(x), [lambda x, k=k: k * x for k in range(1, a.size + 1)], x),
            table,
        )
    few = np.array([0.5, -1.0, 2.0])
    for name in ("cumsum", "cumprod"):
        yield name, lambda x, a, name=name: getattr(jnp, name)(jnp.append(a, x)), few
    yield "cummax", lambda x, a: lax.cummax(jnp.append(a, x)), few
    yield "cummin, reversed", lambda x, a: lax.cummin(jnp.append(a, x), reverse=True), few
    yield "argmax of truths", lambda x, a: jnp.argmax(a > x), few
    yield "argmin of truths", lambda x, a: jnp.argmin(a > x), few
    yield "argmax of counts", lambda x, a: jnp.argmax(jnp.cumsum(a > x)), few
    yield "argmin over columns", lambda x, a: jnp.argmin(jnp.outer(a, jnp.append(a, x)), axis=0), few
    yield (
        "one of many sorted",
        lambda x, a: jnp.sort(jnp.append(jnp.sin(jnp.arange(19.0)) * a[0], x))[jnp.arange(0, 20, 3)],
        few,
    )
    yield (
        "order of many equal ones",
        lambda x, a: jnp.argsort(jnp.append(jnp.floor(2 * jnp.sin(jnp.arange(19.0)) * a[0]), x)),
        few,
    )
    for dtype in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64"):
        yield f"of type {dtype}", lambda x, a, d=dtype: x.astype(d), few
    yield "a truth", lambda x, a: x.astype(bool), few
    yield "a truth of a whole number", lambda x, a: place(x).astype(bool), few
    yield "quotients", lambda x, a: place(x) // jnp.where(x < 1, -3, 2), few
    yield "remainders", lambda x, a: place(x) % jnp.where(x < 1, -3, 2), few
    yield "by nothing", lambda x, a: lax.div(place(x), place(x) * 0) + lax.rem(place(x), place(x) * 0), few
    yield "the sign of a whole number", lambda x, a: jnp.sign(place(x)) * jnp.abs(place(x, jnp.int32)), few


def grouped():
    """By table, and by what a place outside gives: a program of many functions takes a fraction of as many programs."""
    groups: dict[str, tuple[list[Callable], np.ndarray]] = {}
    for name, function, table in edges():
        # XLA ends the process where one kernel is to have both an `argmax` and an `argmin` (jaxlib 0.10).
        apart = "smallest, " if "argmin" in name else ""
        groups.setdefault(apart + ", ".join(name.split(", ")[1:]) or name, ([], table))[0].append(function)
    return groups


EDGES = grouped()


@pytest.mark.parametrize("name", EDGES)
def test_what_a_table_gives_at_its_ends_is_what_jax_gives(name):
    functions, table = EDGES[name]
    table = jnp.asarray(table)

    def function(x, table):
        return [one(x, table) for one in functions]

    right = jax.tree.map(np.asarray, jax.jit(jax.vmap(function, (0, None)))(ANY, table))
    program = scalarize(function, 0.0, table)
    agrees(jax.tree.map(lambda *rows: np.stack(rows), *(program.compute(x, table) for x in ANY)), right, 1e-14)
    lanes = jax.vmap(program, (0, None))
    agrees(jax.jit(lanes)(ANY, table), right, 1e-14)
    agrees(natively(lanes, ANY, table), right, 1e-14)
    # A table that is known when the program is made.
    known = scalarize(lambda x: function(x, table), 0.0)
    agrees(natively(jax.vmap(known), ANY), right, 1e-14)


# Size -----------------------------------------------------------------------------------------------------------------


def test_a_program_does_not_grow_with_its_table():
    """But by the turns of the search, each of which halves what is left."""

    def operations(n):
        knots = jnp.linspace(0.0, 1.0, n)
        return scalarize(lambda x, xs, fs: jnp.interp(x, xs, fs), 0.3, knots, knots).n_operations

    assert operations(1024) - operations(128) == 3 * (operations(256) - operations(128)) > 0
    knots = np.linspace(0.0, 1.0, 1000)
    function = lambda x, xs, fs: jnp.interp(x, xs, fs)  # noqa: E731
    program = scalarize(function, 0.3, knots, knots)
    xs = np.linspace(-0.1, 1.1, 37)
    fs = np.sin(7 * knots)
    agrees(natively(jax.vmap(program, (0, None, None)), xs, knots, fs), np.interp(xs, knots, fs))


@pytest.mark.parametrize(
    ("function", "n", "reason"),
    [
        (lambda x, a: a[place(x)], LARGEST_TABLE + 1, "a table of"),
        (lambda x, a: jnp.sort(a * x), LARGEST_SORTED + 1, "'sort' of"),
        (lambda x, a: a.at[place(x) + jnp.zeros(20, int)].add(1.0), 100, "scalar operations"),
    ],
)
def test_what_would_be_too_large_is_refused(function, n, reason):
    with pytest.raises(NotScalarizable, match=reason):
        scalarize(function, 0.0, np.ones(n), maximum_operations=500)


def test_truths_choose_without_a_table():
    """A law with `jnp.select` has a selection for each condition."""
    program = scalarize(lambda x, v, a: LAWS["select"].function(x, v, a), 0.0, 0.0, FEW)
    assert program.operations["select"] == 3
    assert program.operations["lookup"] == 0


def test_programs_with_a_table_are_written_in_c():
    function, program, _ = programs("interpolated")
    del function
    source = program.c_source("law")
    assert "const double[]" in source
