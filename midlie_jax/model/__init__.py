"""The mechanical model: rotations, bodies, states, torques, orbits, step densities, and observables such as the energy.

It is independent of the methods that integrate it.
"""
