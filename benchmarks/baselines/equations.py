"""The four-bar's equations of motion by hand: absolute coordinates, Lagrange multipliers, Baumgarte's feedback.

    rate(y, onset_rate, p, out)

y has 39 entries: position and quaternion of coupler, crank, rocker (21), then velocity and angular velocity of each
(18). The onset rate is the contact's memory, 0 in flight. p are the numbers of `baselines.parameters`.
"""

from functools import lru_cache

from numba import njit

from baselines import parameters as at
from baselines.joint_forces import FORCES
from baselines.vectors import (
    compiled,
    cross,
    diagonal_turned,
    dot,
    minus,
    plus,
    rotation,
    symmetric_times,
    three,
    times,
    turned,
    turned_back,
)
from baselines.written_out import accelerations_function

COUPLER, CRANK, ROCKER = 0, 7, 14
COUPLER_V, CRANK_V, ROCKER_V = 21, 27, 33


@compiled
def gyroscopic_moment(A, w, inertia):
    """-w x (J w), by way of the body's axes."""
    w_body = turned_back(A, w)
    h = (inertia[0] * w_body[0], inertia[1] * w_body[1], inertia[2] * w_body[2])
    return cross(turned(A, h), w)


@compiled
def position_rates(y, q, v, alpha, out):
    """Velocity; quaternion rate with the norm held at one."""
    p0, p1, p2, p3 = y[q + 3], y[q + 4], y[q + 5], y[q + 6]
    wx, wy, wz = y[v + 3], y[v + 4], y[v + 5]
    pull = alpha * (p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3 - 1.0)
    out[q], out[q + 1], out[q + 2] = y[v], y[v + 1], y[v + 2]
    out[q + 3] = 0.5 * (-p1 * wx - p2 * wy - p3 * wz) - pull * p0
    out[q + 4] = 0.5 * (p0 * wx + p3 * wy - p2 * wz) - pull * p1
    out[q + 5] = 0.5 * (-p3 * wx + p0 * wy + p1 * wz) - pull * p2
    out[q + 6] = 0.5 * (p2 * wx - p1 * wy + p0 * wz) - pull * p3


@compiled
def wanted(bias, rate, residual, alpha, beta):
    """gamma - 2 alpha Phi_dot - beta^2 Phi of three equations."""
    return (
        bias[0] - 2 * alpha * rate[0] - beta * beta * residual[0],
        bias[1] - 2 * alpha * rate[1] - beta * beta * residual[1],
        bias[2] - 2 * alpha * rate[2] - beta * beta * residual[2],
    )


@compiled
def wanted_pair(r_i, s_i, v_i, w_i, r_j, s_j, v_j, w_j, alpha, beta):
    """What the coincidence of two points wants of the accelerations."""
    u_i, u_j = cross(w_i, s_i), cross(w_j, s_j)
    bias = minus(cross(w_i, u_i), cross(w_j, u_j))
    rate = minus(plus(v_j, u_j), plus(v_i, u_i))
    return wanted(bias, rate, minus(plus(r_j, s_j), plus(r_i, s_i)), alpha, beta)


@compiled
def wanted_turn(b, u, normal, w, alpha, beta):
    """What the perpendicularity of a ground direction b and a body's axis u wants; normal = u x b."""
    bias = -dot(b, cross(w, cross(w, u)))
    return bias - 2 * alpha * dot(w, normal) - beta * beta * dot(b, u)


@compiled
def pivot(p, place, r, A, v, w, alpha, beta):
    """Arm, two normals and five wanted entries of a revolute joint with the ground."""
    arm, axis = turned(A, three(p, place + 3)), turned(A, three(p, place + 12))
    b, c = three(p, place + 6), three(p, place + 9)
    normal_b, normal_c = cross(axis, b), cross(axis, c)
    zero = (0.0, 0.0, 0.0)
    point = wanted_pair(three(p, place), zero, zero, zero, r, arm, v, w, alpha, beta)
    turns = (wanted_turn(b, axis, normal_b, w, alpha, beta), wanted_turn(c, axis, normal_c, w, alpha, beta))
    return arm, normal_b, normal_c, point + turns


@compiled
def crossing(y, p):
    """g = (|e|^2 / c^2 - 1) / 2 and its rate, whose sign says whether ball and socket touch."""
    c = p[at.CLEARANCE]
    A_i, A_j = rotation(y, COUPLER + 3), rotation(y, ROCKER + 3)
    s_i, s_j = turned(A_i, three(p, at.COUPLER_ROCKER_END)), turned(A_j, three(p, at.ROCKER_COUPLER_END))
    e = minus(plus(three(y, ROCKER), s_j), plus(three(y, COUPLER), s_i))
    v_i = plus(three(y, COUPLER_V), cross(three(y, COUPLER_V + 3), s_i))
    v_j = plus(three(y, ROCKER_V), cross(three(y, ROCKER_V + 3), s_j))
    return (dot(e, e) / (c * c) - 1.0) / 2.0, dot(e, minus(v_j, v_i)) / (c * c)


@lru_cache(maxsize=8)
def rate_function(kind: str):
    """The compiled right-hand side for a joint model: "ideal", "bushing", "dry" or "lubricated"."""
    force_on_ball = FORCES[kind]
    is_ideal = kind == "ideal"
    accelerations = accelerations_function(is_ideal)

    @njit(fastmath={"contract"}, error_model="numpy")
    def rate(y, onset_rate, p, out):
        alpha, beta = p[at.ALPHA], p[at.BETA]
        gravity = three(p, at.GRAVITY)
        r0, r1, r2 = three(y, COUPLER), three(y, CRANK), three(y, ROCKER)
        A0, A1, A2 = rotation(y, COUPLER + 3), rotation(y, CRANK + 3), rotation(y, ROCKER + 3)
        v0, v1, v2 = three(y, COUPLER_V), three(y, CRANK_V), three(y, ROCKER_V)
        w0, w1, w2 = three(y, COUPLER_V + 3), three(y, CRANK_V + 3), three(y, ROCKER_V + 3)
        J0 = diagonal_turned(A0, three(p, at.INVERSE_INERTIA))
        J1 = diagonal_turned(A1, three(p, at.INVERSE_INERTIA + 3))
        J2 = diagonal_turned(A2, three(p, at.INVERSE_INERTIA + 6))
        m0 = gyroscopic_moment(A0, w0, three(p, at.INERTIA))
        m1 = gyroscopic_moment(A1, w1, three(p, at.INERTIA + 3))
        m2 = gyroscopic_moment(A2, w2, three(p, at.INERTIA + 6))
        im = three(p, at.INVERSE_MASS)
        socket_arm = turned(A0, three(p, at.COUPLER_ROCKER_END))
        ball_arm = turned(A2, three(p, at.ROCKER_COUPLER_END))
        a0, a2 = gravity, gravity
        if not is_ideal:
            e = minus(plus(r2, ball_arm), plus(r0, socket_arm))
            e_rate = minus(plus(v2, cross(w2, ball_arm)), plus(v0, cross(w0, socket_arm)))
            force, on_ball, on_socket = force_on_ball(e, e_rate, w0, w2, onset_rate, p)
            a0, a2 = minus(gravity, times(im[0], force)), plus(gravity, times(im[2], force))
            m0 = plus(m0, minus(on_socket, cross(socket_arm, force)))
            m2 = plus(m2, plus(on_ball, cross(ball_arm, force)))
        free0, free1 = a0 + symmetric_times(J0, m0), gravity + symmetric_times(J1, m1)
        free2 = a2 + symmetric_times(J2, m2)
        cp, cn, cm, desired_crank = pivot(p, at.CRANK_PIVOT, r1, A1, v1, w1, alpha, beta)
        rp, rn, rm, desired_rocker = pivot(p, at.ROCKER_PIVOT, r2, A2, v2, w2, alpha, beta)
        pin, end = turned(A1, three(p, at.CRANK_PIN)), turned(A0, three(p, at.COUPLER_CRANK_END))
        desired_pin = wanted_pair(r1, pin, v1, w1, r0, end, v0, w0, alpha, beta)
        if is_ideal:
            desired_studied = wanted_pair(r0, socket_arm, v0, w0, r2, ball_arm, v2, w2, alpha, beta)
            desired = desired_crank + desired_pin + desired_studied + desired_rocker
            a = accelerations(
                cp, cn, cm, pin, end, socket_arm, ball_arm, rp, rn, rm, desired, im, J0, free0, J1, free1, J2, free2
            )
        else:
            desired = desired_crank + desired_pin + desired_rocker
            a = accelerations(cp, cn, cm, pin, end, rp, rn, rm, desired, im, J0, free0, J1, free1, J2, free2)
        position_rates(y, COUPLER, COUPLER_V, alpha, out)
        position_rates(y, CRANK, CRANK_V, alpha, out)
        position_rates(y, ROCKER, ROCKER_V, alpha, out)
        for i in range(18):
            out[21 + i] = a[i]

    return rate
