"""The implicit methods, which do not consist of flights and kicks: the other methods in Figure 1 of the paper."""

from .akw import AKW as AKW
from .lie_midpoint_implicit import LieMidpointImplicit as LieMidpointImplicit
from .midpoint import ImplicitMidpoint as ImplicitMidpoint
from .newmark import NewmarkBody as NewmarkBody
from .simo_wong import SW as SW
