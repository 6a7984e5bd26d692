import struct

import numpy as np
import pytest

from canopen_control.physics.sdf_world import convex_parts


def stl(*triangles):
    """Return triangles as binary STL."""
    rows = b"".join(struct.pack("<12fH", *(0.0,) * 3, *(n for corner in each for n in corner), 0) for each in triangles)
    return bytes(80) + struct.pack("<I", len(triangles)) + rows


def cube(x, size):
    """Return two triangles for each side of a cube that begins at x."""
    at = [(x + i * size, j * size, k * size) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return [(at[a], at[b], at[c]) for s in sides for a, b, c in ((s[0], s[1], s[2]), (s[0], s[2], s[3]))]


def test_each_piece_that_hangs_together_is_a_part_at_the_scale():
    parts = convex_parts(stl(*cube(0.0, 1.0), *cube(3.0, 0.5)), (1.0, 2.0, 1.0))
    bounds = sorted((*each.corners.min(axis=0), *each.corners.max(axis=0)) for each in parts)
    assert np.allclose(bounds, [(0, 0, 0, 1, 2, 1), (3, 0, 0, 3.5, 1, 0.5)])


def test_a_flat_piece_gets_a_thickness_of_a_millimetre():
    wall = [((1, 0, 0), (1, 2, 0), (1, 2, 1)), ((1, 0, 0), (1, 2, 1), (1, 0, 1))]
    (part,) = convex_parts(stl(*wall), (1.0, 1.0, 1.0))
    assert np.allclose(part.corners.max(axis=0) - part.corners.min(axis=0), [0.001, 2.0, 1.0])


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (stl(((0, 0, 0), (1, 0, 0), (0, float("nan"), 0))), "a number in it is none"),
        (stl(*(((10 * n, 0, 0), (10 * n + 1, 0, 0), (10 * n, 1, 0)) for n in range(501))), "501 separate pieces"),
        (bytes(80) + struct.pack("<I", 200_001), "200001 faces are more than the 200000"),
    ],
)
def test_what_cannot_be_simulated_is_told(content, why):
    with pytest.raises(ValueError, match=why):
        convex_parts(content, (1.0, 1.0, 1.0))
