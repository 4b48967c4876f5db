"""The colours of charts differ in every colour vision, and a chart without results says so."""

import itertools

import numpy as np
import pytest

from midlie_jax.cli import charts, convergence, figures


def test_nothing_to_draw_is_said():
    with pytest.raises(ValueError, match="no method gave a finite result"):
        charts.convergence_figure([convergence.Row("SW", 0.1, 10, failure="x")], title="", reference="")


# Machado, Oliveira and Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291: what those see who lack one cone.
VISIONS = {
    "all cones": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def lab(colour: str, vision) -> np.ndarray:
    """CIELAB of an sRGB colour seen so, white D65."""
    srgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    to_xyz = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    xyz = to_xyz @ np.clip(np.asarray(vision) @ linear, 0, 1) / np.array([0.95047, 1.0, 1.08883])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISIONS)
def test_the_colours_differ_in_every_colour_vision(vision):
    """By 15 units of CIELAB and more; 2 are just seen side by side."""
    seen = [lab(colour, VISIONS[vision]) for colour in (*figures.COOL, *figures.WARM)]
    assert min(np.linalg.norm(one - other) for one, other in itertools.combinations(seen, 2)) > 15
