"""The mechanical model: rotations, bodies, states, torques, orbits, step densities, and observables such as the energy.

It does not depend on the integration methods.
"""
