"""Deformable solids by the methods for particles: a thrown block of tetrahedra, d'Alembert's bar, and what steps cost."""
