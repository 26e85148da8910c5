"""Reference pictures in WebP: files that libwebp wrote (through Pillow), and the pixels that it reads from them.

Run from this folder, with Pillow installed; it rewrites webp.json:

    python3 webp.py
"""

import io
import json
import math

from PIL import Image

WIDTH, HEIGHT = 21, 18


def pixel(x, y):
    r = 128 + 90 * math.sin(0.35 * x + 0.2 * y)
    g = 110 + 80 * math.cos(0.22 * x - 0.31 * y)
    b = (37 * x + 53 * y) % 256 if (x // 6 + y // 6) % 2 else 60
    a = 255 - 12 * x if y > 5 else 255
    return tuple(max(0, round(v)) for v in (r, g, b, a))


def picture(mode):
    rgba = Image.new("RGBA", (WIDTH, HEIGHT))
    rgba.putdata([pixel(x, y) for y in range(HEIGHT) for x in range(WIDTH)])
    return rgba.convert(mode)


def saved(mode, **how):
    """A file as hexadecimal digits, the mode it is read in, and its stored pixels, row-major."""
    file = io.BytesIO()
    picture(mode).save(file, "WEBP", **how)
    file.seek(0)
    read = Image.open(file)
    return {"file": file.getvalue().hex(), "mode": read.mode, "pixels": read.tobytes().hex()}


def main():
    turned = Image.Exif()
    turned[0x0112] = 6
    cases = {
        "lossy": saved("RGB", quality=80),
        "lossy, alpha": saved("RGBA", quality=60, alpha_quality=100),
        "lossless": saved("RGB", lossless=True),
        "lossless, alpha": saved("RGBA", lossless=True, exact=True),
        "lossy, turned": saved("RGB", quality=80, exif=turned),
        "lossless, turned": saved("RGB", lossless=True, exif=turned),
    }
    frames = io.BytesIO()
    other = picture("RGB").transpose(Image.Transpose.FLIP_LEFT_RIGHT)
    picture("RGB").save(frames, "WEBP", save_all=True, append_images=[other], duration=100)
    cases["animation"] = {"file": frames.getvalue().hex()}
    with open("webp.json", "w", encoding="utf-8") as out:
        json.dump({"width": WIDTH, "height": HEIGHT, "cases": cases}, out, indent=1)
        out.write("\n")


main()
