"""Random inputs of ensembles: `distributions` says how a quantity is scattered, and `scatter` draws it for each body.

    drawn = ml.scatter(key, 1000, weight=ml.distributions.Normal(20.0, 0.5), attitude=ml.distributions.Rotation())

Modules: `distributions` (of numbers and vectors), `rotations` (on the sphere and on SO(3)), `data` (rows of arrays),
`parameters` (their arguments, checked), `scatter` (one key for each quantity and body).
"""

from .scatter import scatter as scatter
