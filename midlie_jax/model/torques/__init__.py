"""Torques. A torque is any callable of (t, state) that returns the body-frame torque (3,).

`base` defines the interface (potential energy, dependence on the body) and sums of torques. `reads_body` has torques
that read the body, `from_functions` custom torques from a function, and `fields` torques that depend on the attitude.
`friction` has damping and air drag. `travel` has torques on bodies that translate; they return a
`midlie_jax.torques.Wrench`, a torque and a force. `by_step` has controls and pulses, which are constant in each step.
The torques of one application are in its folder: `asteroids`, `molecules`, `spacecraft`, `spins`.
"""

from ..._lazy import names_of

__getattr__, __dir__, __all__ = names_of(__name__, __file__)
