"""Deformable solids by the methods for particles: a thrown block, d'Alembert's bar, and what steps cost."""
