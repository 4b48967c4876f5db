"""Rigid water: a pair force written to be copied, its list of neighbours, and the same runs in LAMMPS and OpenMM.

Units: nm, ps, amu, kJ/mol, so that they need no factors.
"""
