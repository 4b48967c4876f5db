"""Closed-form motions against which tests and charts compare the integrators.

`free_body` is the torque-free rigid body with any moments, `lagrange_top` the symmetric heavy top. Both return body
momenta and attitudes at given times, accurate to about 1e-14. They use neither JAX nor time steps, so they share no
error with the integrators. They need mpmath: `pip install "midlie_jax[oracle]"`.
"""

from .free_body import free_body
from .lagrange_top import lagrange_top

__all__ = ["free_body", "lagrange_top"]
