"""Writes conv.json: convolutions, group normalisation and resampling with gradients, computed by PyTorch in f64.

python3 make_conv.py > conv.json
Inputs are sines that the test makes too; only results are stored. A result's gradients are those of its sum
weighted by another sine.
"""

import json
import math

import torch
import torch.nn.functional as F


def wave(shape, phase):
    count = math.prod(shape)
    data = [math.sin(i * 0.7391 + phase) for i in range(count)]
    return torch.tensor(data, dtype=torch.float32).double().reshape(shape).requires_grad_()


def entry(kind, settings, shapes, f):
    inputs = [wave(shape, 1.3 * i) for i, shape in enumerate(shapes)]
    out = f(*inputs)
    weight = wave(list(out.shape), 9.0).detach()
    grads = torch.autograd.grad((out * weight).sum(), inputs)

    def numbers(t):
        return [round(v, 7) for v in t.flatten().tolist()]

    return {"kind": kind, "settings": settings, "shapes": shapes, "shape": list(out.shape), "out": numbers(out),
            "grads": [numbers(g) for g in grads]}


def main():
    cases = []
    # batch, inputs, outputs, rows, columns, kernel, stride, padding, dilation
    for n, ci, co, h, w, k, s, p, d in [(2, 3, 5, 6, 7, 3, 1, 1, 1), (1, 2, 3, 7, 6, 3, 2, 1, 1),
                                        (2, 3, 2, 5, 4, 1, 1, 0, 1), (1, 2, 2, 9, 8, 5, 2, 2, 1),
                                        (1, 2, 1, 7, 10, 3, 3, 0, 1), (1, 1, 2, 6, 5, 2, 2, 1, 1),
                                        (1, 2, 3, 9, 8, 3, 1, 2, 2), (1, 9, 17, 6, 5, 3, 2, 2, 3)]:
        shapes = [[n, ci, h, w], [co, ci, k, k], [co]]
        cases.append(entry("conv2d", [s, p, d], shapes, lambda x, w, b, s=s, p=p, d=d: F.conv2d(x, w, b, s, p, d)))
    # kernel, stride, padding, dilation
    for k, s, p, d in [(9, 4, 4, 1), (3, 1, 1, 1), (5, 2, 6, 3)]:
        shapes = [[2, 2, 23], [3, 2, k], [3]]
        cases.append(entry("conv1d", [s, p, d], shapes, lambda x, w, b, s=s, p=p, d=d: F.conv1d(x, w, b, s, p, d)))
    # kernel, stride, padding, dilation, extra rows and columns
    for k, s, p, d, e in [(3, 2, 1, 1, 1), (4, 2, 1, 1, 0), (3, 1, 0, 2, 0), (2, 3, 0, 1, 2), (3, 1, 0, 1, 0)]:
        def transposed(x, w, b, f, s=s, p=p, d=d, e=e):
            return f(x, w, b, s, p, e, 1, d)

        cases.append(entry("conv_transpose2d", [s, p, d, e], [[2, 3, 4, 5], [3, 2, k, k], [2]],
                           lambda x, w, b, f=transposed: f(x, w, b, F.conv_transpose2d)))
        cases.append(entry("conv_transpose1d", [s, p, d, e], [[2, 3, 7], [3, 2, k], [2]],
                           lambda x, w, b, f=transposed: f(x, w, b, F.conv_transpose1d)))
    cases.append(entry("group_norm_leaky", [2], [[2, 4, 3, 5], [4], [4]],
                       lambda x, g, b: F.leaky_relu(F.group_norm(x, 2, g, b), 0.1)))
    cases.append(entry("leaky_relu", [], [[2, 3, 4]], lambda x: F.leaky_relu(x, 0.1)))
    cases.append(entry("upsample_add", [], [[1, 2, 2, 3], [1, 2, 4, 6]],
                       lambda x, y: F.interpolate(x, scale_factor=2) + y))
    cases.append(entry("avg_pool", [2, 3], [[1, 2, 4, 6]], lambda x: F.avg_pool2d(x, (2, 3))))
    cases.append(entry("pool_moments", [], [[2, 3, 4, 5]],
                       lambda x: torch.cat([x.mean((2, 3)), (x * x).mean((2, 3))], 1)))
    line = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0], dtype=torch.float64) / 16

    def front(x, classes):
        n, c, h, w = x.shape
        blur = F.conv2d(F.pad(x, (2, 2, 2, 2), mode="replicate").reshape(n * c, 1, h + 4, w + 4),
                        torch.outer(line, line)[None, None]).reshape(x.shape)
        high = 10 * (x - blur)
        if c == 3:
            a = torch.tensor([[1.0, 1, 1], [1, -1, 0], [1, 1, -2]], dtype=torch.float64)
            a = a / a.norm(dim=1, keepdim=True) * torch.tensor([[1.0], [4], [4]], dtype=torch.float64)
            high = torch.einsum("kc,nchw->nkhw", a, high)
        return torch.cat([x, high / (1 + high.abs()), classes[:, :, None, None].expand(-1, -1, h, w)], 1)

    for channels in (2, 3):
        cases.append(entry("front_end", [10], [[2, channels, 5, 4], [2, 3]], front))
    print("[" + ",\n".join(json.dumps(case) for case in cases) + "]")


if __name__ == "__main__":
    main()
