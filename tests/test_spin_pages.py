"""What docs/reports/heat.md shows of spins: its pictures can be drawn, its closed forms hold, its parts run small."""

import math

import numpy as np
import pytest
from laboratory.spins import conservation, dispersion, rivals, skyrmion, symplectic, wall


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
