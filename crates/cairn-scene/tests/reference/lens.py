"""Reference projections through a lens with all five coefficients (k1, k2, k3, p1, p2),
which no COLMAP model has and transforms.json may state.

Written from OpenCV's documentation (calib3d, "Detailed Description"), sharing nothing
with the Rust code; poses and points are those of cameras.json. Plain Python, no numpy.
Run from this folder; it rewrites lens.json:

    python3 lens.py
"""

import json
import math

LENS = {
    "fl_x": 55.0,
    "fl_y": 57.5,
    "cx": 31.0,
    "cy": 25.0,
    "k1": -0.21,
    "k2": 0.06,
    "k3": -0.013,
    "p1": 0.004,
    "p2": -0.007,
}


def rotated(q, p):
    """The point turned by a quaternion (w, x, y, z), by Rodrigues' formula."""
    norm = math.hypot(*q[1:])
    angle = 2 * math.atan2(norm, q[0])
    a = [v / norm for v in q[1:]]
    cross = [a[1] * p[2] - a[2] * p[1], a[2] * p[0] - a[0] * p[2], a[0] * p[1] - a[1] * p[0]]
    along = sum(x * y for x, y in zip(a, p))
    c, s = math.cos(angle), math.sin(angle)
    return [p[k] * c + cross[k] * s + a[k] * along * (1 - c) for k in range(3)]


def project(lens, point):
    """Pixels of a point in camera axes: OpenCV's x'' and y'' with k4..k6 = 0."""
    x, y = point[0] / point[2], point[1] / point[2]
    r = math.hypot(x, y)
    radial = 1 + lens["k1"] * r**2 + lens["k2"] * r**4 + lens["k3"] * r**6
    bent_x = x * radial + 2 * lens["p1"] * x * y + lens["p2"] * (r**2 + 2 * x**2)
    bent_y = y * radial + lens["p1"] * (r**2 + 2 * y**2) + 2 * lens["p2"] * x * y
    return [lens["fl_x"] * bent_x + lens["cx"], lens["fl_y"] * bent_y + lens["cy"]]


def main():
    with open("cameras.json", encoding="utf-8") as f:
        cameras = json.load(f)
    pixels = []
    for case in cameras["cases"]:
        q, t = case["quaternion_wxyz"], case["translation"]
        local = [[v + s for v, s in zip(rotated(q, p), t)] for p in case["world"]]
        pixels.append([project(LENS, p) for p in local])
    with open("lens.json", "w", encoding="utf-8") as f:
        json.dump({"lens": LENS, "pixels": pixels}, f, indent=1)
        f.write("\n")


if __name__ == "__main__":
    main()
