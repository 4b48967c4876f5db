"""The methods as solvers of diffrax, so that an existing diffrax program only changes its term and solver.

    term, solver = ml.diffrax.RigidBodyTerm(body, torque), ml.diffrax.LieSolver("LIEMID[EA]")
    solution = diffrax.diffeqsolve(term, solver, t0, t1, dt0, ml.RigidState(momentum, attitude))

Only this subpackage imports diffrax, and only its public names. The same term also runs under the solvers of diffrax.
They integrate the derivatives of the arrays of the state, whereas `LieSolver` uses angular velocity and torque and
moves on the group.

Modules: `term` (body and torque), `solver` (the step), `estimate` (its error and the size of an error), `dense` (dense
output by cubics and by steps).
"""

from .dense import LieInterpolation as LieInterpolation
from .estimate import RotationNorm as RotationNorm
from .solver import LieSolver as LieSolver
from .term import Rates as Rates
from .term import RigidBodyTerm as RigidBodyTerm
