"""The methods as solvers of diffrax: one line changes in a pipeline, the rest of it stays.

    term, solver = ml.RigidBodyTerm(body, torque), ml.LieSolver("LIEMID[EA]")
    solution = diffrax.diffeqsolve(term, solver, t0, t1, dt0, ml.RigidState(momentum, attitude))

The only part of the package that imports diffrax, by its public names. The same term runs under diffrax's own solvers,
which see the derivatives of the state's arrays; `LieSolver` sees angular velocity and torque and moves on the group.

Read `term` (what moves), `solver` (a step), `estimate` (its error), `interpolation` (between steps), `norm`.
"""

from .interpolation import LieInterpolation as LieInterpolation
from .norm import RotationNorm as RotationNorm
from .solver import LieSolver as LieSolver
from .term import Rates as Rates
from .term import RigidBodyTerm as RigidBodyTerm
