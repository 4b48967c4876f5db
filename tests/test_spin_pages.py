"""What docs/reports/heat.md shows of spins: its pictures can be drawn, its closed forms hold, its parts run small."""

import math

import numpy as np
import pytest
from laboratory.spins import conservation, dispersion, rivals, skyrmion, symplectic, wall
from PIL import Image

SMALL = 12


def turning(size=SMALL, frames=3):
    """A skyrmion that is moved along y by a place a frame."""
    spin = np.asarray(skyrmion.guess(size).spin)
    return skyrmion.Moved(np.arange(frames) * 10.0, np.stack([np.roll(spin, i, axis=1) for i in range(frames)]))


def seen(size=16):
    angles = 2 * math.pi * np.fft.fftshift(np.fft.fftfreq(size))
    return dispersion.Peaks(angles, 2.01 * (1 - np.cos(angles)))


def rung(method, dt):
    return rivals.Rung(method, dt, error=dt**2, cost=10 / dt, step_cost=10.0)


DRAWN = {
    "area": lambda out: symplectic.draw({case: np.full((4, 2), 1e-3) for case in symplectic.CASES}, out),
    "waves": lambda out: dispersion.draw(dict.fromkeys(dispersion.SEEN, seen()), out),
    "rivals": lambda out: rivals.draw([rung(m, dt) for m, steps in rivals.LADDERS.items() for dt in steps], out),
    "wall": lambda out: wall.draw([wall.Speed(wall.WALKER * x, x, x) for x in (0.5, 2.0)], out),
    "skyrmion": lambda out: skyrmion.draw(turning(), out),
    "animation": lambda out: skyrmion.animate(turning(), out),
}


@pytest.mark.parametrize("name", DRAWN)
def test_pictures_are_drawn_and_small(name, tmp_path):
    out = tmp_path / ("a.gif" if name == "animation" else "a.png")
    DRAWN[name](out)
    with Image.open(out) as picture:
        assert getattr(picture, "n_frames", 1) == (3 if name == "animation" else 1)
    assert out.stat().st_size < 300_000


def test_a_skyrmion_has_charge_minus_one_and_moves_across_the_slope():
    spin = np.asarray(skyrmion.guess(40).spin)
    assert abs(skyrmion.charge(spin) + 1) < 1e-12
    x, y = skyrmion.thiele(spin)
    assert abs(y) > 3 * abs(x) > 0


def test_a_peak_is_found_between_the_bins():
    times, w = np.arange(512), 1.2345
    signal = np.hanning(513)[:-1] * np.exp(1j * w * times)
    found = dispersion.peak_of(2 * math.pi * np.fft.fftfreq(512), np.abs(np.fft.fft(signal)))
    assert abs(found - w) < 1e-5


def test_the_cost_of_an_error_lies_on_the_line_of_its_neighbours():
    rungs = [rung("a", dt) for dt in (0.1, 0.2, 0.4)]
    assert math.isclose(rivals.cost_at(rungs, 0.25**2), 40.0)
    assert math.isnan(rivals.cost_at(rungs, 1.0))


def test_a_wall_is_fastest_at_the_field_of_walker():
    fastest = wall.known(wall.WALKER)
    assert wall.known(0.9 * wall.WALKER) < fastest
    assert wall.known(1.1 * wall.WALKER) < fastest


def conserved():
    energy, total, length = conservation.errors("SUBLATTICES[EA]", 0.1, spins=8, time=1.0)
    assert max(energy, length) < 1e-14 < total


def not_symplectic():
    ((defect, volume),) = symplectic.defects(symplectic.Case(symplectic.COUPLED, "SUBLATTICES[EA]"), (0.2,), 1)
    assert volume < 1e-13
    assert defect > 1e-4


def waves():
    assert dispersion.peaks("SUBLATTICES[SRKN6b]", spins=8, steps=1024).errors.max() < 1e-3


def against():
    """Depondt and Mertens' method in JAX is of second order towards our reference."""
    found = rivals.measured((8, 8), 1.0, {rivals.JAX: (0.05, 0.025)}, rounds=1, reference=("RK4", 0.01))
    coarse, fine = (r.error for r in found)
    assert 3.7 < coarse / fine < 4.3


def walls():
    field = 0.5 * wall.WALKER
    assert (
        abs(wall.found(field, method="SUBLATTICES[EA]", spins=96, time=400.0, saved=20) / wall.known(field) - 1) < 0.1
    )


def moved():
    found = skyrmion.measured(24, 8.0, 2, "SUBLATTICES[EA]")
    assert abs(skyrmion.charge(found.spin[-1]) + 1) < 1e-12


@pytest.mark.sample(1)
@pytest.mark.parametrize("part", [conserved, not_symplectic, waves, against, walls, moved], ids=lambda f: f.__name__)
def test_each_part_runs_small(part):
    part()
