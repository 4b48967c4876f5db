"""Spins on lattices, beside closed forms and other programs: the parts of benchmarks/spins.py."""
