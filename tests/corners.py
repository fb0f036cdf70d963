"""Corners of a car by hand: positions of ideal joints in NumPy and SciPy, from the hardpoints alone."""

import numpy as np
from scipy.optimize import brentq, fsolve

UP = np.array([0.0, 0.0, 1.0])


def turned(vector, axis, angle):
    """Rodrigues' formula."""
    axis = np.asarray(axis) / np.linalg.norm(axis)
    return (
        vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle) + axis * (axis @ vector) * (1 - np.cos(angle))
    )


def on_hinge(point, first, second, angle):
    """A point that turns about the line through two others."""
    return first + turned(point - first, second - first, angle)


def on_circle_at(center_distance, point, first, second, near):
    """The angle at which a point on a hinge is at a distance from a place, the solution nearest to `near`."""
    place, distance = center_distance
    angles = near + np.linspace(-0.7, 0.7, 141)
    gaps = [np.linalg.norm(on_hinge(point, first, second, a) - place) - distance for a in angles]
    changes = [i for i in range(len(angles) - 1) if gaps[i] * gaps[i + 1] < 0]
    best = min(changes, key=lambda i: abs(angles[i] - near))

    def gap(angle):
        return np.linalg.norm(on_hinge(point, first, second, angle) - place) - distance

    return brentq(gap, angles[best], angles[best + 1], xtol=1e-15, rtol=1e-15)


def third_point(places, distances, near):
    """The place at given distances from three others, the one of two that is nearer to `near`."""
    a, b, c = places
    ex = (b - a) / np.linalg.norm(b - a)
    i = ex @ (c - a)
    ey = c - a - i * ex
    ey /= np.linalg.norm(ey)
    ez = np.cross(ex, ey)
    d, j = np.linalg.norm(b - a), ey @ (c - a)
    r1, r2, r3 = distances
    x = (r1**2 - r2**2 + d**2) / (2 * d)
    y = (r1**2 - r3**2 + i**2 + j**2) / (2 * j) - i / j * x
    z = np.sqrt(r1**2 - x**2 - y**2)
    both = [a + x * ex + y * ey + sign * z * ez for sign in (1, -1)]
    return min(both, key=lambda p: np.linalg.norm(p - near))


def frame(points):
    """Axes through three points."""
    a, b, c = points
    x = (b - a) / np.linalg.norm(b - a)
    z = np.cross(x, c - a)
    z /= np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])


def spin_axis(toe, camber):
    """Outward axis of a left wheel."""
    return np.array([np.cos(camber) * np.sin(toe), np.cos(camber) * np.cos(toe), -np.sin(camber)])


class DoubleWishbone:
    """A left corner whose lower arm's angle is the unknown, one at a time.

    The upper ball is on its circle, at its distance from the lower one; the tie rod's end at its distances from both
    and from the rack; with three points of the upright, all of it is known.
    """

    def __init__(self, at, toe=0.0, camber=0.0):
        self.at = {name: np.asarray(place, float) for name, place in at.items()}
        self.spin = spin_axis(toe, camber)
        self.radius = np.linalg.norm(self.at["wheel_center"] - self.at["contact_patch"])

    def position(self, angle, steer):
        """Places at an angle of the lower arm."""
        p = self.at
        lower = on_hinge(p["lower_ball"], p["lower_arm_rear"], p["lower_arm_front"], angle)
        apart = np.linalg.norm(p["upper_ball"] - p["lower_ball"])
        upper_angle = on_circle_at((lower, apart), p["upper_ball"], p["upper_arm_rear"], p["upper_arm_front"], angle)
        upper = on_hinge(p["upper_ball"], p["upper_arm_rear"], p["upper_arm_front"], upper_angle)
        inner = p["tie_rod_inner"] + np.array([0.0, steer, 0.0])
        distances = [
            np.linalg.norm(p["tie_rod_outer"] - p[name]) for name in ("lower_ball", "upper_ball", "tie_rod_inner")
        ]
        guess = p["tie_rod_outer"] + lower - p["lower_ball"] + np.array([0.0, steer, 0.0])
        outer = third_point((lower, upper, inner), distances, guess)
        R = frame((lower, upper, outer)) @ frame((p["lower_ball"], p["upper_ball"], p["tie_rod_outer"])).T
        center = lower + R @ (p["wheel_center"] - p["lower_ball"])
        return {
            "lower": lower,
            "upper": upper,
            "upper_angle": upper_angle,
            "angle": angle,
            "center": center,
            "spin": R @ self.spin,
            "spring": on_hinge(p["spring_lower"], p["lower_arm_rear"], p["lower_arm_front"], angle)
            if "spring_lower" in p
            else None,
        }

    def at_travel(self, travel, steer=0.0):
        """Places where the lowest point of the wheel has gone up by `travel`."""
        design = self.at["wheel_center"][2] - self.radius * np.sqrt(1 - self.spin[2] ** 2)

        def missing(angle):
            found = self.position(angle, steer)
            return found["center"][2] - self.radius * np.sqrt(1 - found["spin"][2] ** 2) - design - travel

        return self.position(brentq(missing, -0.3, 0.3, xtol=1e-15, rtol=1e-15), steer)


def characteristics(found, radius, design_patch, design_center):
    """Angles and offsets of a left wheel by their definitions."""
    spin, center = found["spin"], found["center"]
    down = -(UP - spin[2] * spin)
    patch = center + radius * down / np.linalg.norm(down)
    k = found["upper"] - found["lower"]
    road = found["lower"] + k * (patch[2] - found["lower"][2]) / k[2]
    return {
        "toe": np.arctan2(spin[0], spin[1]),
        "camber": -np.arcsin(spin[2]),
        "caster": np.arctan(-k[0] / k[2]),
        "kingpin_inclination": np.arctan(-k[1] / k[2]),
        "scrub_radius": patch[1] - road[1],
        "caster_trail": road[0] - patch[0],
        "track_change": patch[1] - design_patch[1],
        "recession": -(center[0] - design_center[0]),
        "center_travel": center[2] - design_center[2],
        "patch": patch,
        "center": center,
    }


def mcpherson_at(at, travel, steer=0.0):
    """A McPherson strut at a travel: six equations for six unknowns of the upright, by SciPy."""
    p = {name: np.asarray(place, float) for name, place in at.items()}
    radius = np.linalg.norm(p["wheel_center"] - p["contact_patch"])
    inner = p["tie_rod_inner"] + np.array([0.0, steer, 0.0])
    hinge = p["lower_arm_front"] - p["lower_arm_rear"]
    hinge /= np.linalg.norm(hinge)

    def place(unknown, name):
        turn = unknown[3:]
        angle = np.linalg.norm(turn)
        arm = p[name] - p["wheel_center"]
        return p["wheel_center"] + unknown[:3] + (turned(arm, turn, angle) if angle > 0 else arm)

    def spin_of(unknown):
        angle = np.linalg.norm(unknown[3:])
        y = np.array([0.0, 1.0, 0.0])
        return turned(y, unknown[3:], angle) if angle > 0 else y

    def missing(unknown):
        ball, tube = place(unknown, "lower_ball"), place(unknown, "strut_lower")
        was = p["lower_ball"] - p["lower_arm_rear"]
        now = ball - p["lower_arm_rear"]
        top = p["strut_top"] - p["strut_lower"]
        angle = np.linalg.norm(unknown[3:])
        along = turned(top, unknown[3:], angle) if angle > 0 else top
        across = np.cross(along, p["strut_top"] - tube)
        rod = np.linalg.norm(place(unknown, "tie_rod_outer") - inner)
        spin = spin_of(unknown)
        height = unknown[2] + radius - radius * np.sqrt(1 - spin[2] ** 2)
        return [
            hinge @ (now - was),
            now @ now - was @ was,
            across[0],
            across[1],
            rod - np.linalg.norm(p["tie_rod_outer"] - p["tie_rod_inner"]),
            height - travel,
        ]

    start = np.array([0.0, 0.0, travel, 0.0, 0.0, 0.0])
    unknown = fsolve(missing, start, xtol=1e-12)
    assert np.max(np.abs(missing(unknown))) < 1e-12
    return {
        "lower": place(unknown, "lower_ball"),
        "upper": p["strut_top"],
        "center": place(unknown, "wheel_center"),
        "spin": spin_of(unknown),
    }
