"""Methods for spins: sublattices that rotate in turn, and midpoint rules on the sphere."""

from .midpoint import LieMidpointOnSphere as LieMidpointOnSphere
from .midpoint import SphericalMidpoint as SphericalMidpoint
from .sublattices import Sublattices as Sublattices
