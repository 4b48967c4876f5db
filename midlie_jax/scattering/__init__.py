"""Random inputs of ensembles: `distributions` describes how a quantity varies, and `scatter` draws it for each body.

    drawn = ml.scatter(key, 1000, weight=ml.distributions.Normal(20.0, 0.5), attitude=ml.distributions.Rotation())

Modules: `base` (the interface of a distribution), `numbers` (numbers and vectors), `rotations` (the sphere and SO(3)),
`data` (rows of arrays), `distributions` (all of them), `scatter` (one key for each quantity and body).
"""

from .scatter import scatter as scatter
