"""Reference projections through fisheyes: COLMAP's OPENCV_FISHEYE and SIMPLE_RADIAL_FISHEYE,
which nerfstudio's transforms.json states as well.

Written from COLMAP's documentation (https://colmap.github.io/cameras.html and the comments of
src/colmap/sensor/models.h), sharing nothing with the Rust code: the angle off the axis comes
from a chord of the unit sphere, the side from a polar angle. Poses are those of cameras.json;
points lie up to 85 degrees off the axis, and for transforms.json up to 110. Plain Python, no
numpy. Run from this folder; it rewrites fisheye.json:

    python3 fisheye.py
"""

import json
import math
import random

OPENCV = [24.0, 25.0, 31.0, 25.0, 0.05, -0.01, 0.003, -0.0005]
SIMPLE = [24.0, 31.0, 25.0, -0.04]


def turned_back(q, p):
    """The point turned by the inverse of a quaternion (w, x, y, z), by its matrix."""
    w, x, y, z = q
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return [sum(rows[k][i] * p[k] for k in range(3)) for i in range(3)]


def project(p, point):
    """Pixels of a point in camera axes."""
    fx, fy, cx, cy = p[:4] if len(p) == 8 else [p[0], p[0], p[1], p[2]]
    coefficients = p[4:] if len(p) == 8 else p[3:]
    length = math.sqrt(sum(v * v for v in point))
    chord = math.dist([v / length for v in point], [0, 0, 1])
    theta = 2 * math.asin(chord / 2)
    distorted = theta + sum(k * theta ** (2 * n + 3) for n, k in enumerate(coefficients))
    side = math.atan2(point[1], point[0])
    return [cx + fx * distorted * math.cos(side), cy + fy * distorted * math.sin(side)]


def main():
    with open("cameras.json", encoding="utf-8") as f:
        cameras = json.load(f)
    rng = random.Random(21)
    cases = []
    for case in cameras["cases"]:
        q, t = case["quaternion_wxyz"], case["translation"]
        norm = math.hypot(*q)
        q = [v / norm for v in q]
        local = []
        for degrees in [0.01, 5, 20, 35, 50, 65, 80, 85, 95, 110]:
            theta, side, far = math.radians(degrees), rng.uniform(0, 2 * math.pi), rng.uniform(0.5, 6)
            local.append(
                [
                    far * math.sin(theta) * math.cos(side),
                    far * math.sin(theta) * math.sin(side),
                    far * math.cos(theta),
                ]
            )
        cases.append(
            {
                "world": [turned_back(q, [v - s for v, s in zip(p, t)]) for p in local],
                "opencv": [project(OPENCV, p) for p in local],
                "simple": [project(SIMPLE, p) for p in local],
            }
        )
    with open("fisheye.json", "w", encoding="utf-8") as f:
        json.dump({"opencv": OPENCV, "simple": SIMPLE, "ahead": 8, "cases": cases}, f, indent=1)
        f.write("\n")


if __name__ == "__main__":
    main()
