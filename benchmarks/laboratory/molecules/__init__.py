"""Rigid water: runs with `ml.molecules.PairForces`, and the same runs in LAMMPS and OpenMM.

Units: nm, ps, amu, kJ/mol, so that they need no factors.
"""
