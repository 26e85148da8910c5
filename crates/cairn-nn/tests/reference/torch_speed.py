"""PyTorch's side of examples/conv_speed.rs: the same convolutions, in milliseconds, median (fastest)."""

import statistics
import time

import torch

CASES = [(32, 32, 2, 128, 1), (16, 16, 4, 128, 1), (16, 32, 4, 128, 2), (64, 64, 4, 32, 1)]


def timed(f, runs=30):
    for _ in range(3):
        f()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        f()
        times.append((time.perf_counter() - start) * 1e3)
    return f"{statistics.median(times):.2f} ({min(times):.2f})"


def main():
    print(f"PyTorch {torch.__version__}, {torch.get_num_threads()} threads")
    for inputs, outputs, batch, side, stride in CASES:
        x = torch.randn(batch, inputs, side, side, requires_grad=True)
        w = torch.randn(outputs, inputs, 3, 3, requires_grad=True)

        def forward():
            return torch.nn.functional.conv2d(x, w, stride=stride, padding=1)

        grad = torch.ones_like(forward())
        print(f"{inputs} -> {outputs} channels, {batch} x {side} x {side}, stride {stride}")
        both = timed(lambda: torch.autograd.grad(forward(), [x, w], grad))
        print(f"  forward {timed(forward)}, forward and backward {both}")


if __name__ == "__main__":
    main()
