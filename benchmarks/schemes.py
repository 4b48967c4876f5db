"""Measures the effective error of each scheme: its cost for a given accuracy.

    python benchmarks/schemes.py

The effective error is the number of evaluations a step times the order-th root of the error constant, as a multiple of
the smallest among the schemes of the same order. It is measured on two coupled pendulums with exact flights, in
extended precision and without JAX. A force with its gradient counts as two evaluations. Smaller is better. ABA82
and ABA1064 are made for small forces; the forces here are not small.
"""

from itertools import pairwise

import numpy as np

from midlie_jax.integrators import schemes
from midlie_jax.integrators.scheme_order import pendulums


def work(scheme):
    """Evaluations in a step, with those of gradients."""
    return scheme.evaluations + (0 if scheme.displaced else sum(g != 0 for g in scheme.gradients))


def effective_error(scheme):
    """Evaluations in a unit of time for an error of 1, extrapolated with the order of the scheme."""
    for count in (12, 24, 48, 96, 192, 384):
        ends = [pendulums(scheme, count * factor) for factor in (1, 2, 4)]
        coarse, fine = (np.linalg.norm(a - b) for a, b in pairwise(ends))
        if abs(np.log2(coarse / fine) - scheme.order) < 0.1:
            break
    return float(work(scheme) * 2 * count / 3 * fine ** (1 / scheme.order))


def main():
    errors = {
        name: effective_error(scheme)
        for name, scheme in schemes.SCHEMES.items()
        if scheme.order > 1 and not scheme.random
    }
    best = {}
    for name, value in errors.items():
        order = schemes.SCHEMES[name].order
        best[order] = min(value, best.get(order, value))
    print("| scheme | order | evaluations | effective error, by the best of its order |\n| --- | --- | --- | --- |")
    for name, value in sorted(errors.items(), key=lambda item: (schemes.SCHEMES[item[0]].order, item[1])):
        scheme = schemes.SCHEMES[name]
        print(f"| {name} | {scheme.order} | {work(scheme)} | {value / best[scheme.order]:.2f} |")


if __name__ == "__main__":
    main()
