"""The studied joint's force laws (Lankarani-Nikravesh, Threlfall, squeeze film, bushing), one function for each model.

Each takes the eccentricity e [m] and its rate [m/s], the angular velocities of socket and ball [rad/s], the onset rate
of the contact [m/s] (0 in flight) and the parameters; it returns the force on the ball at its center, the moment on the
ball about its center, and the moment on the socket about its center.
"""

import math

from baselines import parameters as at
from baselines.vectors import compiled, cross, dot, length, minus, plus, times

CONCENTRIC_SQUARE = 1e-24
SLOWEST_ONSET = 1e-6
LARGEST_RATIO = 1.0 - 1e-12


@compiled
def radial(e, rate):
    """The rate's part along e; all of it for a concentric ball."""
    along = dot(e, rate)
    scale = 1.0 / (dot(e, e) + CONCENTRIC_SQUARE)
    return times(scale, plus(times(along, e), times(CONCENTRIC_SQUARE, rate)))


@compiled
def bushing(e, rate, w_socket, w_ball, onset_rate, p):
    on_socket = minus(rate, cross(w_socket, e))
    force = times(-p[at.STIFFNESS], plus(e, times(p[at.DAMPING], radial(e, on_socket))))
    return force, (0.0, 0.0, 0.0), cross(force, e)


@compiled
def contact(e, rate, w_socket, w_ball, onset_rate, share, p):
    """Force and moments of a closed contact, of which `share` acts."""
    distance = length(e)
    n = times(1.0 / distance, e)
    depth = max(distance - p[at.CLEARANCE], 0.0)
    damping = 1.0 + p[at.DAMPING] * dot(rate, n) / max(onset_rate, SLOWEST_ONSET)
    normal_force = share * p[at.STIFFNESS] * depth * math.sqrt(depth) * max(damping, 0.0)
    radii = 2.0 * p[at.SOCKET_RADIUS] - p[at.CLEARANCE]
    ball_arm = times(0.5 * (radii - distance), n)
    socket_arm = times(0.5 * (radii + distance), n)
    sliding = minus(plus(rate, cross(w_ball, ball_arm)), cross(w_socket, socket_arm))
    sliding = minus(sliding, times(dot(sliding, n), n))
    speed = length(sliding)
    v1 = p[at.THRESHOLD]
    secant = math.tanh(speed / v1) / speed if speed > 0.0 else 1.0 / v1
    traction = times(-normal_force * p[at.FRICTION] * secant, sliding)
    force = minus(traction, times(normal_force, n))
    return force, cross(ball_arm, traction), cross(traction, socket_arm)


@compiled
def dry(e, rate, w_socket, w_ball, onset_rate, p):
    if onset_rate <= 0.0:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return contact(e, rate, w_socket, w_ball, onset_rate, 1.0, p)


@compiled
def squeeze_factor(eps):
    """B(eps) = ln(1 - eps) / eps^3 + 1 / (eps^2 (1 - eps)) - 1 / (2 eps); near 0, sum (k + 2) / (k + 3) eps^k."""
    if abs(eps) > 0.1:
        tail = -(math.log1p(-eps) + eps + 0.5 * eps * eps) / (eps * eps * eps)
    else:
        tail = 0.0
        for k in range(16, -1, -1):
            tail = tail * eps + 1.0 / (k + 3)
    return 1.0 / (1.0 - eps) - tail


@compiled
def lubricated(e, rate, w_socket, w_ball, onset_rate, p):
    distance = length(e)
    eps = min(distance / (p[at.CLEARANCE] + p[at.OFFSET]), LARGEST_RATIO)
    load = p[at.FILM] * squeeze_factor(-eps if dot(e, rate) < 0.0 else eps)
    film = times(-load, radial(e, rate))
    depth = distance - p[at.CLEARANCE]
    if depth <= 0.0:
        return film, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    share = min(depth / p[at.WIDTH], 1.0)
    film = times(1.0 - share, film)
    if onset_rate <= 0.0:
        return film, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    force, on_ball, on_socket = contact(e, rate, w_socket, w_ball, onset_rate, share, p)
    return plus(film, force), on_ball, on_socket


@compiled
def nothing(e, rate, w_socket, w_ball, onset_rate, p):
    return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


FORCES = {"ideal": nothing, "bushing": bushing, "dry": dry, "lubricated": lubricated}
