"""A Stewart platform: thirteen bodies, six closed loops, six controllers; see `automatic_mechanisms`."""

import numpy as np

import spherejax as sj

HEIGHT, BASE, TOP = 0.4, 0.3, 0.2
"""Height of the platform above the ground, and radii of the rings of joints there [m]."""


def stewart_platform(model: sj.joints.AbstractSphericalModel) -> sj.Scene:
    """A platform of 10 kg on six legs that a PID controller lifts by 20 to 50 mm within 0.3 s.

    Args:
        model: of the joint between the first leg and the platform; the others are ideal.
    """
    center = np.array([0.0, 0.0, HEIGHT])

    def ring(radius, half_angle, height):
        angles = np.deg2rad([60 + 120 * (i // 2) + (half_angle if i % 2 else -half_angle) for i in range(6)])
        return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(6, height)], 1)

    bases, tops = ring(BASE, 50.0, 0.0), ring(TOP, 10.0, HEIGHT)
    bodies = {
        "platform": sj.Body(
            10.0, (0.1, 0.1, 0.2), position=center, points={f"top{i}": top - center for i, top in enumerate(tops)}
        )
    }
    joints, forces, ground_points = {}, {}, {}
    for i, (base, top) in enumerate(zip(bases, tops, strict=True)):
        along = (top - base) / np.linalg.norm(top - base)
        side = np.cross(along, [0.0, 0.0, 1.0])
        side = side / np.linalg.norm(side)
        low, middle, high = (base + share * (top - base) for share in (0.4, 0.6, 0.7))
        bodies[f"cylinder{i}"] = sj.Body.rod({"base": base, "end": middle}, radius=0.012, mass=1.0)
        bodies[f"rod{i}"] = sj.Body.rod({"inner": low, "top": top}, radius=0.008, mass=0.5)
        ground_points[f"base{i}"] = base
        joints[f"universal{i}"] = sj.Universal(("ground", f"cylinder{i}"), base, side, np.cross(along, side))
        joints[f"slide{i}"] = sj.Prismatic((f"cylinder{i}", f"rod{i}"), high, along)
        joints[f"ball{i}"] = sj.Spherical(f"rod{i}.top", f"platform.top{i}", sj.Ideal() if i else model)
        forces[f"leg{i}"] = sj.PID(
            sj.Extension((f"ground.base{i}", f"rod{i}.top")),
            sj.functions.SmoothStep(0.0, 0.3, 0.0, 0.02 * (1 + 0.3 * i)),
            proportional=2e5, integral=2e6, derivative=2e3, filter_time=1e-3,
        )  # fmt: skip
    return sj.Scene(bodies, joints, forces, ground_points=ground_points)
