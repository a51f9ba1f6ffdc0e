"""Pictures for a page: as PNG with a palette, a third of the size."""

from __future__ import annotations

import io

COLOURS = 256


def with_palette(png: bytes) -> bytes:
    """Return a PNG in at most 256 colours, as it is where that is not smaller or cannot be read.

    Args:
        png: the file's bytes.
    """
    from PIL import Image

    out = io.BytesIO()
    try:
        with Image.open(io.BytesIO(png)) as picture:
            if picture.mode != "RGB" and picture.getextrema()[-1] != (255, 255):
                return png    # what shines through would be lost
            few = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        few.save(out, "PNG", optimize=True)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return png    # a browser may do better
    return min(png, out.getvalue(), key=len)
