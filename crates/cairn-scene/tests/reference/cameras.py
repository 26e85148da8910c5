"""Reference projections for every camera model and file format Cairn reads.

Written with numpy from the formats' own documentation, sharing nothing with the
Rust code: COLMAP (https://colmap.github.io/cameras.html and format.html), OpenCV's
distortion (calib3d, "Detailed Description"), LLFF's poses_bounds.npy and
NeRF's transforms.json (OpenGL axes).

Run from this folder, with numpy installed; it rewrites cameras.json:

    python3 cameras.py
"""

import json

import numpy as np

WIDTH, HEIGHT = 64, 48


def rotation(q):
    """Rotation matrix of a quaternion (w, x, y, z), by Rodrigues' formula."""
    q = np.asarray(q) / np.linalg.norm(q)
    angle = 2 * np.arctan2(np.linalg.norm(q[1:]), q[0])
    axis = q[1:] / np.linalg.norm(q[1:])
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def project(model, p, point):
    """Pixels of a point in camera axes, as COLMAP's cameras.html defines it."""
    u, v = point[0] / point[2], point[1] / point[2]
    r2 = u * u + v * v
    if model == "SIMPLE_PINHOLE":
        return [p[0] * u + p[1], p[0] * v + p[2]]
    if model == "PINHOLE":
        return [p[0] * u + p[2], p[1] * v + p[3]]
    if model == "SIMPLE_RADIAL":
        radial = 1 + p[3] * r2
        return [p[0] * u * radial + p[1], p[0] * v * radial + p[2]]
    if model == "RADIAL":
        radial = 1 + p[3] * r2 + p[4] * r2**2
        return [p[0] * u * radial + p[1], p[0] * v * radial + p[2]]
    fx, fy, cx, cy, k1, k2, p1, p2 = p
    radial = k1 * r2 + k2 * r2**2
    du = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    dv = v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v * v)
    return [fx * (u + du) + cx, fy * (v + dv) + cy]


def main():
    rng = np.random.default_rng(20)
    models = {
        "SIMPLE_PINHOLE": [55.0, 31.0, 25.0],
        "PINHOLE": [55.0, 57.5, 31.0, 25.0],
        "SIMPLE_RADIAL": [55.0, 31.0, 25.0, -0.21],
        "RADIAL": [55.0, 31.0, 25.0, -0.21, 0.06],
        "OPENCV": [55.0, 57.5, 31.0, 25.0, -0.21, 0.06, 0.004, -0.007],
    }
    cases = []
    for model, params in models.items():
        q = rng.normal(size=4)
        q /= np.linalg.norm(q)
        t = rng.normal(size=3)
        r = rotation(q)
        local = np.stack([[rng.uniform(-0.9, 0.9), rng.uniform(-0.7, 0.7), 1.0] for _ in range(8)])
        local *= rng.uniform(0.5, 6.0, size=(8, 1))
        world = (local - t) @ r  # R^T (x - t), row by row
        to_world = np.eye(4)
        to_world[:3, :3] = r.T
        to_world[:3, 3] = -r.T @ t
        opengl = to_world @ np.diag([1.0, -1.0, -1.0, 1.0])
        right, down, back = to_world[:3, 0], to_world[:3, 1], -to_world[:3, 2]
        # LLFF states the full size, eight times the photographs', and one focal.
        hwf = np.array([HEIGHT * 8, WIDTH * 8, params[0] * 8])
        llff = np.stack([down, right, back, to_world[:3, 3], hwf], axis=1)
        simple = [params[0], WIDTH / 2, HEIGHT / 2]
        cases.append(
            {
                "model": model,
                "params": params,
                "quaternion_wxyz": q.tolist(),
                "translation": t.tolist(),
                "opengl_camera_to_world": opengl.tolist(),
                "llff_row": llff.reshape(-1).tolist() + [0.5, 6.0],
                "world": world.tolist(),
                "pixels": [project(model, params, x) for x in local],
                "pixels_simple_centred": [project("SIMPLE_PINHOLE", simple, x) for x in local],
            }
        )
    document = {"width": WIDTH, "height": HEIGHT, "cases": cases}
    with open("cameras.json", "w", encoding="utf-8") as f:
        json.dump(document, f, indent=1)
        f.write("\n")


if __name__ == "__main__":
    main()
