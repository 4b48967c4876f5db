"""The methods for spins, as `midlie_jax.methods()` lists them."""

from ..integrators import schemes
from ..integrators.registry import Entry
from .midpoint import LieMidpointOnSphere, SphericalMidpoint
from .sublattices import Sublattices

FAMILIES = {"SUBLATTICES": Sublattices}
ENTRIES = (
    Entry(Sublattices(schemes.EA), "spins coupled only to other sublattices: order 2, explicit, conserves the energy"),
    Entry(Sublattices(schemes.SRKN6B), "such spins: order 4"),
    Entry(Sublattices(schemes.KAHAN_LI6), "such spins: order 6"),
    Entry(Sublattices(schemes.BAOAB), "such spins in a heat bath"),
    Entry(SphericalMidpoint(), "spins, any energy: order 2, implicit, symplectic"),
    Entry(LieMidpointOnSphere(), "comparison: the paper's midpoint rule on the sphere; not symplectic"),
)
