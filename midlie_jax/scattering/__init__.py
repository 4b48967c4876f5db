"""Random inputs of ensembles: `distributions` describes how a quantity varies, and `scatter` draws it for each body.

    drawn = ml.scatter(key, 1000, weight=ml.distributions.Normal(20.0, 0.5), attitude=ml.distributions.Rotation())

`scatter` makes one key for each quantity and body.
"""

from .scatter import scatter as scatter
