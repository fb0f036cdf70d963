"""Vectors and rotations as tuples of scalars, which the compiler keeps in registers."""

import math

from numba import njit

from baselines.written_out import FAST

compiled = njit(fastmath=FAST, error_model="numpy")


@compiled
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def times(c, a):
    return c * a[0], c * a[1], c * a[2]


@compiled
def length(a):
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@compiled
def three(p, at):
    return p[at], p[at + 1], p[at + 2]


@compiled
def rotation(q, at):
    """Rotation matrix, row by row, of the unit quaternion at q[at : at + 4]."""
    p0, p1, p2, p3 = q[at], q[at + 1], q[at + 2], q[at + 3]
    return (
        1 - 2 * (p2 * p2 + p3 * p3),
        2 * (p1 * p2 - p0 * p3),
        2 * (p1 * p3 + p0 * p2),
        2 * (p1 * p2 + p0 * p3),
        1 - 2 * (p1 * p1 + p3 * p3),
        2 * (p2 * p3 - p0 * p1),
        2 * (p1 * p3 - p0 * p2),
        2 * (p2 * p3 + p0 * p1),
        1 - 2 * (p1 * p1 + p2 * p2),
    )


@compiled
def turned(A, s):
    """A s: body axes to world axes."""
    return (
        A[0] * s[0] + A[1] * s[1] + A[2] * s[2],
        A[3] * s[0] + A[4] * s[1] + A[5] * s[2],
        A[6] * s[0] + A[7] * s[1] + A[8] * s[2],
    )


@compiled
def turned_back(A, s):
    """A^T s: world axes to body axes."""
    return (
        A[0] * s[0] + A[3] * s[1] + A[6] * s[2],
        A[1] * s[0] + A[4] * s[1] + A[7] * s[2],
        A[2] * s[0] + A[5] * s[1] + A[8] * s[2],
    )


@compiled
def diagonal_turned(A, d):
    """The six entries xx, xy, xz, yy, yz, zz of A diag(d) A^T."""
    x, y, z = (A[0] * d[0], A[1] * d[1], A[2] * d[2]), (A[3] * d[0], A[4] * d[1], A[5] * d[2]), A[6:]
    return (
        x[0] * A[0] + x[1] * A[1] + x[2] * A[2],
        x[0] * A[3] + x[1] * A[4] + x[2] * A[5],
        x[0] * z[0] + x[1] * z[1] + x[2] * z[2],
        y[0] * A[3] + y[1] * A[4] + y[2] * A[5],
        y[0] * z[0] + y[1] * z[1] + y[2] * z[2],
        z[0] * z[0] * d[0] + z[1] * z[1] * d[1] + z[2] * z[2] * d[2],
    )


@compiled
def symmetric_times(J, a):
    return (
        J[0] * a[0] + J[1] * a[1] + J[2] * a[2],
        J[1] * a[0] + J[3] * a[1] + J[4] * a[2],
        J[2] * a[0] + J[4] * a[1] + J[5] * a[2],
    )
