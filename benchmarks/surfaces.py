"""Surfaces: what sunlight and shadows cost, and a light curve: docs/reports/applications.md and docs/surfaces.md.

    python benchmarks/surfaces.py cost [--write]      a step with sunlight beside a loop in C over the same facets
    python benchmarks/surfaces.py shadows [--write]   shadows beside ray tracing, and their run time; needs embreex
    python benchmarks/surfaces.py curve [--write]     the light curve of a tumbling body; light-curve.png

Times are processor times on one core; programs that are compared take turns.
"""

import one_core  # noqa: F401
from harness import main
from laboratory import shadows, surfaces

if __name__ == "__main__":
    main(__doc__, {"cost": surfaces.TABLE, "shadows": shadows.TABLE, "curve": surfaces.measure})
