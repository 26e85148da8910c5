"""PyTorch's side of the convolution bench: milliseconds of each pass on two threads.

python3 pytorch_conv.py SHAPES.json TORCH.json

Run by `cairn-eval conv --torch python3`, which writes SHAPES.json and takes turns with it. Times are added to those in
TORCH.json.
"""

import json
import sys
import time

import torch

RUNS = 15
PASSES = {"input gradient": [True, False, False], "weight gradient": [False, True, False]}


def timed(f):
    for _ in range(3):
        f()
    times = []
    for _ in range(RUNS):
        start = time.perf_counter()
        f()
        times.append((time.perf_counter() - start) * 1e3)
    return times


def main():
    shapes_path, torch_path = sys.argv[1:3]
    with open(shapes_path) as file:
        shapes = json.load(file)["shapes"]
    try:
        with open(torch_path) as file:
            samples = json.load(file)
    except FileNotFoundError:
        samples = {}
    torch.set_num_threads(2)
    for name, s in shapes.items():
        stride = [1 if n == 1 else s["stride"] for n in s["size"]]
        x = torch.randn(s["batch"], s["inputs"], *s["size"])
        w = torch.randn(s["outputs"], s["inputs"], *s["kernel"])
        forward = lambda: torch.nn.functional.conv2d(x, w, None, stride, s["padding"])  # noqa: E731
        with torch.no_grad():
            grad = torch.randn_like(forward())
            samples.setdefault(f"{name}, forward", []).extend(timed(forward))
            for label, mask in PASSES.items():
                backward = lambda: torch.ops.aten.convolution_backward(  # noqa: E731
                    grad, x, w, None, stride, s["padding"], [1, 1], False, [0, 0], 1, mask)
                samples.setdefault(f"{name}, {label}", []).extend(timed(backward))
    with open(torch_path, "w") as file:
        json.dump(samples, file)


if __name__ == "__main__":
    main()
