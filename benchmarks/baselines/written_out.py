"""Straight-line code for the multipliers: nobody writes the elimination of a 16 x 16 matrix by hand, but its pattern.

The rows of the constraints are given symbolically; S = D M^-1 D^T and its LDL^T factors are written out entry by entry,
structural zeros left out, as a numba function of scalars.
"""

from numba import njit

AXES = "xyz"
FAST = {"contract"}
"""The one freedom given to the compiler: a fused multiply-add instead of a multiplication and an addition."""


class Row:
    """One constraint equation: for each body that it binds, its linear and its angular part.

    Attributes:
        parts: body -> (axis of the linear part or None, its sign, three angular coefficients as names or None).
    """

    def __init__(self, **parts):
        self.parts = parts


def point_rows(body: str, arm: str, sign: int) -> list[tuple]:
    """Linear and angular parts of sign (r + s) for the three axes: [I, -s~], with the sign."""
    s = [f"{arm}{a}" for a in AXES]
    plus = [(None, s[2], "-" + s[1]), ("-" + s[2], None, s[0]), (s[1], "-" + s[0], None)]
    flip = {1: lambda c: c, -1: lambda c: None if c is None else c[1:] if c[0] == "-" else "-" + c}[sign]
    return [(axis, sign, tuple(flip(c) for c in plus[axis])) for axis in range(3)]


def rows_of(has_ideal_joint: bool) -> list[Row]:
    """The equations in an order that keeps the factor banded: crank pivot, pin, (studied joint), rocker pivot."""

    def pivot(body, arm, normals):
        turns = [(None, 0, tuple(f"{n}{a}" for a in AXES)) for n in normals]
        return [Row(**{body: part}) for part in [*point_rows(body, arm, 1), *turns]]

    def pair(i, arm_i, j, arm_j):
        return [Row(**{i: a, j: b}) for a, b in zip(point_rows(i, arm_i, -1), point_rows(j, arm_j, 1), strict=True)]

    rows = pivot("crank", "cp", ("cn", "cm")) + pair("crank", "pi", "coupler", "ce")
    if has_ideal_joint:
        rows += pair("coupler", "re", "rocker", "ro")
    return rows + pivot("rocker", "rp", ("rn", "rm"))


def _sum(terms: list[str]) -> str:
    return " + ".join(terms) if terms else "0.0"


def _times(left, right) -> list[str]:
    return [f"({a}) * ({b})" for a, b in zip(left, right, strict=True) if a is not None and b is not None]


def source(has_ideal_joint: bool) -> str:
    """The text of `accelerations(vectors, masses, inverse inertias, free accelerations, right side)`.

    Per body: im_B inverse mass; J_B six entries of the inverse inertia in world axes; f_B free acceleration (6).
    `desired` are the 13 or 16 entries of gamma - 2 alpha Phi_dot - beta^2 Phi.
    """
    rows = rows_of(has_ideal_joint)
    arms = ["cp", "cn", "cm", "pi", "ce", *(["re", "ro"] if has_ideal_joint else []), "rp", "rn", "rm"]
    bodies = ["coupler", "crank", "rocker"]
    lines = [f"def accelerations({', '.join(arms)}, desired, im, {', '.join(f'J_{b}, f_{b}' for b in bodies)}):"]
    lines += [f"    {a}x, {a}y, {a}z = {a}" for a in arms]
    for k, b in enumerate(bodies):
        lines += [f"    {', '.join(f'J{b}{e}' for e in ('xx', 'xy', 'xz', 'yy', 'yz', 'zz'))} = J_{b}"]
        lines += [f"    {', '.join(f'f{b}{i}' for i in range(6))} = f_{b}", f"    im{b} = im[{k}]"]
    lines += _mobility(rows)
    lines += _elimination(rows)
    lines += _accelerations(rows, bodies)
    return "\n".join(lines)


def _mobility(rows: list[Row]) -> list[str]:
    lines = []
    for i, row in enumerate(rows):
        for body, (_, _, g) in row.parts.items():
            for axis in range(3):
                column = [f"J{body}" + "".join(sorted((AXES[axis], AXES[k]))) for k in range(3)]
                lines.append(f"    h{body}{i}_{axis} = {_sum(_times(g, column))}")
    for i, row in enumerate(rows):
        for j, other in enumerate(rows[: i + 1]):
            terms = []
            for body in (name for name in row.parts if name in other.parts):
                (axis, sign, g), (axis_j, sign_j, _) = row.parts[body], other.parts[body]
                if axis is not None and axis == axis_j:
                    terms.append(f"im{body}" if sign * sign_j > 0 else f"(-im{body})")
                terms += _times(g, [f"h{body}{j}_{k}" for k in range(3)])
            if terms:
                lines.append(f"    s{i}_{j} = {_sum(terms)}")
        terms = []
        for body, (axis, sign, g) in row.parts.items():
            if axis is not None:
                terms.append(f"f{body}{axis}" if sign > 0 else f"(-f{body}{axis})")
            terms += _times(g, [f"f{body}{3 + k}" for k in range(3)])
        lines.append(f"    b{i} = {_sum(terms)} - desired[{i}]")
    return lines


def _elimination(rows: list[Row]) -> list[str]:
    """LDL^T with fill-in tracked, forward and backward substitution."""
    n = len(rows)
    filled = {(i, j) for i in range(n) for j in range(i) if rows[i].parts.keys() & rows[j].parts.keys()}
    lines = []
    for j in range(n):
        below = [i for i in range(j + 1, n) if (i, j) in filled]
        lines.append(f"    r{j} = 1.0 / s{j}_{j}")
        for i in below:
            lines.append(f"    l{i}_{j} = s{i}_{j} * r{j}")
        for i in below:
            for k in below:
                if k > i:
                    continue
                known = i == k or (i, k) in filled
                lines.append(f"    s{i}_{k} = {f's{i}_{k}' if known else '0.0'} - l{i}_{j} * s{k}_{j}")
                if not known:
                    filled.add((i, k))
            lines.append(f"    b{i} = b{i} - l{i}_{j} * b{j}")
    for j in reversed(range(n)):
        terms = "".join(f" - l{i}_{j} * b{i}" for i in range(j + 1, n) if (i, j) in filled)
        lines.append(f"    b{j} = b{j} * r{j}{terms}")
    return lines


def _accelerations(rows: list[Row], bodies: list[str]) -> list[str]:
    results = []
    for body in bodies:
        linear, angular = [""] * 3, [""] * 3
        for i, row in enumerate(rows):
            if body not in row.parts:
                continue
            axis, sign, _ = row.parts[body]
            if axis is not None:
                linear[axis] += f" {'-' if sign > 0 else '+'} b{i}"
            for k in range(3):
                angular[k] += f" - b{i} * h{body}{i}_{k}"
        results += [f"f{body}{k} + im{body} * (0.0{linear[k]})" for k in range(3)]
        results += [f"f{body}{3 + k}{angular[k]}" for k in range(3)]
    return [f"    return ({', '.join(results)})"]


def accelerations_function(has_ideal_joint: bool):
    """The compiled function."""
    space: dict = {}
    exec(compile(source(has_ideal_joint), f"<multipliers, ideal joint: {has_ideal_joint}>", "exec"), space)
    return njit(space["accelerations"], fastmath=FAST, error_model="numpy")
