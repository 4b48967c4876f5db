"""Deformable solids by the methods for particles: docs/reports/applications.md, and the pictures of docs/solids.md.

    python benchmarks/solids.py block [--write]    a thrown block of gel: momenta, energy bands; thrown-block.png, .gif
    python benchmarks/solids.py bar [--write]      a fixed bar beside d'Alembert's solution
    python benchmarks/solids.py cost [--write]     a step beside the one force that it evaluates

Times are processor times on one core; programs that are compared take turns. The meshes are made by scikit-fem, which
`pip install 'midlie_jax[solids]'` brings.
"""

import one_core  # noqa: F401
from harness import main
from laboratory import solids

if __name__ == "__main__":
    main(__doc__, {"block": solids.measure, "bar": solids.BAR, "cost": solids.COST})
