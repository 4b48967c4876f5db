"""Closed-form motions to test and chart the integrators against.

`free_body` is the torque-free rigid body with any moments, `lagrange_top` the symmetric heavy top; both return body
momenta and attitudes at chosen times, right to about 1e-14. They use neither JAX nor any step, so they share no
mistake with the methods they judge. They need mpmath: `pip install "midlie_jax[oracle]"`.
"""

from .free_body import free_body
from .lagrange_top import lagrange_top

__all__ = ["free_body", "lagrange_top"]
