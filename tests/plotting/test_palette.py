"""Pictures with a palette: smaller, the same to the eye, never broken."""

import io

import numpy as np
from PIL import Image

from ppmcal.plotting.curves import draw_curves
from ppmcal.plotting.style import with_palette


def pixels(png):
    with Image.open(io.BytesIO(png)) as picture:
        return np.asarray(picture.convert("RGB"), dtype=int)


def test_a_picture_becomes_smaller_and_looks_the_same():
    t = np.linspace(0.0, 6.0, 200)
    whole = draw_curves("A curve", "t, s", "x, mm", [("one", t, np.sin(t)), ("two", t, np.cos(t))])
    small = with_palette(whole)
    assert len(small) < 0.6 * len(whole)
    assert np.mean(np.abs(pixels(whole) - pixels(small))) < 1.0
    assert with_palette(small) == small or len(with_palette(small)) <= len(small)


def test_what_is_no_picture_or_shines_through_stays_as_it_is():
    out = io.BytesIO()
    Image.new("RGBA", (40, 30), (255, 0, 0, 90)).save(out, "PNG")
    for data in (b"", b"no picture", out.getvalue(), out.getvalue()[:60]):
        assert with_palette(data) == data
