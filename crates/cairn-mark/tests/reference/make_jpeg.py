"""Makes jpeg.json: a picture written by libjpeg (through Pillow, colours 4:2:0) and read back.

    python3 make_jpeg.py > jpeg.json
"""

import io
import json
import math

from PIL import Image

WIDTH, HEIGHT = 20, 18


def pixel(x, y):
    r = 128 + 90 * math.sin(0.35 * x + 0.2 * y)
    g = 110 + 80 * math.cos(0.22 * x - 0.31 * y)
    b = (37 * x + 53 * y) % 256 if (x // 6 + y // 6) % 2 else 60
    return tuple(round(v) for v in (r, g, b))


def main():
    picture = Image.new("RGB", (WIDTH, HEIGHT))
    for y in range(HEIGHT):
        for x in range(WIDTH):
            picture.putpixel((x, y), pixel(x, y))
    out = {}
    for quality in (30, 75, 95):
        file = io.BytesIO()
        picture.save(file, "JPEG", quality=quality, subsampling=2)
        file.seek(0)
        out[str(quality)] = list(Image.open(file).convert("RGB").tobytes())
    print(json.dumps(out))


main()
