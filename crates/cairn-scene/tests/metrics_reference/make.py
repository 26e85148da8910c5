#!/usr/bin/env python3
"""Writes metrics.json: inputs and what scikit-image, SciPy and NumPy say of them.

    pip install scikit-image scipy numpy && python3 make.py

Inputs come from a linear congruential generator that the Rust test repeats, so
that the file holds a few numbers and no pictures.
"""

import json
import pathlib

import numpy as np
import scipy
import skimage
from scipy.signal import stft
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio, structural_similarity


def draw(seed, count):
    """`count` numbers in [0, 1) with 24 bits each, float32-exact."""
    state, out = seed, np.empty(count, np.float32)
    for i in range(count):
        state = (state * 1664525 + 1013904223) & 0xFFFFFFFF
        out[i] = np.float32(state >> 8) / np.float32(1 << 24)
    return out


def smooth(picture):
    """Box-blurs by 3 x 3 with wrap-around, in float32, in the order the test uses."""
    total = np.zeros_like(picture)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            total = total + np.roll(picture, (dy, dx), (0, 1))
    return total / np.float32(9)


def pictures():
    for width, height, seed, noise in [(11, 11, 1, 0.2), (40, 31, 2, 0.05), (64, 48, 3, 0.5), (97, 20, 4, 0.01)]:
        a = smooth(draw(seed, height * width * 3).reshape(height, width, 3))
        b = a + np.float32(noise) * (draw(seed + 100, height * width * 3).reshape(height, width, 3) - np.float32(0.5))
        mask = draw(seed + 200, height * width).reshape(height, width) < 0.4
        x, y = a.astype(np.float64), b.astype(np.float64)
        score, full = structural_similarity(
            x, y, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1.0, channel_axis=-1, full=True
        )
        inner = np.zeros_like(mask)
        inner[5:-5, 5:-5] = mask[5:-5, 5:-5]
        row = dict(width=width, height=height, seed=seed, noise=noise)
        row["mse"] = mean_squared_error(x, y)
        row["psnr_db"] = peak_signal_noise_ratio(x, y, data_range=1.0)
        row["psnr_db_masked"] = peak_signal_noise_ratio(x[mask], y[mask], data_range=1.0)
        row["ssim"] = score
        row["ssim_masked"] = full.mean(axis=-1)[inner].mean() if inner.any() else None
        yield row


def sounds():
    for count, seed, noise in [(256, 11, 0.1), (1000, 12, 0.5), (4000, 13, 0.02), (100, 14, 0.3)]:
        t = draw(seed, count) - np.float32(0.5)
        r = t + np.float32(noise) * (draw(seed + 100, count) - np.float32(0.5))
        t, r = t.astype(np.float64), r.astype(np.float64)
        padded = max(256, 256 + -(-(count - 256) // 128) * 128)

        def spectrum(v):
            v = np.pad(v, (0, padded - count))
            _, _, z = stft(v, window="hann", nperseg=256, noverlap=128, boundary=None, padded=False, scaling="spectrum")
            return 10 * np.log10(np.maximum(np.abs(z) ** 2, 10**-8.0))

        lsd = np.sqrt(((spectrum(t) - spectrum(r)) ** 2).mean(axis=0)).mean()
        snr = 10 * np.log10((t**2).sum() / ((t - r) ** 2).sum())
        yield dict(samples=count, seed=seed, noise=noise, snr_db=snr, log_spectral_distance_db=lsd)


def calibration():
    for count, seed, bins in [(50, 21, 10), (400, 22, 15)]:
        confidence = draw(seed, count).astype(np.float64)
        right = draw(seed + 100, count) < draw(seed, count)
        edges, ece = np.linspace(0, 1, bins + 1), 0.0
        for lower, upper in zip(edges[:-1], edges[1:]):
            inside = (confidence > lower) & (confidence <= upper)
            if inside.any():
                ece += inside.mean() * abs(right[inside].mean() - confidence[inside].mean())
        yield dict(answers=count, seed=seed, bins=bins, expected_calibration_error=ece)


if __name__ == "__main__":
    result = dict(
        made_with=dict(numpy=np.__version__, scipy=scipy.__version__, skimage=skimage.__version__),
        pictures=list(pictures()),
        sounds=list(sounds()),
        calibration=list(calibration()),
    )
    path = pathlib.Path(__file__).with_name("metrics.json")
    path.write_text(json.dumps(result, indent=1) + "\n")
