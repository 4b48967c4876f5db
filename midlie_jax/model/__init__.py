"""What moves, and under what: rotations, bodies, states, torques, orbits, densities, and what is read off a motion."""
