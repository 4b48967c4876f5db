"""The conditions of order of every table whose forces depend on places alone, evaluated in 60 digits, without JAX.

Those of Nystrom's trees: Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, section II.14.
"""

from decimal import Decimal, localcontext
from functools import cache

import pytest

from midlie_jax.integrators import schemes

DIGITS = 60
TABLES = [name for name, s in schemes.SCHEMES.items() if not s.gradients and not s.random]
PRECISE = {name: (flights.split(), kicks.split()) for name, (flights, kicks) in schemes.ORDER_8.items()}


@cache
def trees(order):
    """The trees of this order as tuples of their children: None is the velocity, a tree stands for its acceleration."""

    def children(left, largest, first):
        """Tuples of children of `left` orders together, in falling order; of the largest order, not before `first`."""
        if left == 0:
            yield ()
        for size in range(min(left, largest), 0, -1):
            kinds = (None,) if size == 1 else trees(size - 1)
            for i in range(first if size == largest else 0, len(kinds)):
                yield from ((kinds[i], *rest) for rest in children(left - size, size, i))

    return tuple(children(order - 1, order - 1, 0))


def order_of(tree):
    return 1 + sum(1 if child is None else 1 + order_of(child) for child in tree)


def density(tree):
    """The factor 1 / density is what a weight of the exact solution is."""
    product = order_of(tree)
    for child in tree:
        product *= 1 if child is None else (1 + order_of(child)) * density(child)
    return product


def defects(stages, order):
    """How far a table misses the conditions of this order: |sum of b_i Phi_i - 1 / density| of each tree."""
    places, kicks, now = [], [], Decimal(0)
    for kind, x in stages:
        if kind == schemes.FLIGHT:
            now += x
        else:
            places.append(now)
            kicks.append(x)

    @cache
    def weights(tree):
        """Phi_i, what the force of kick i has of the tree."""
        found = [Decimal(1)] * len(kicks)
        for child in tree:
            of_child = weights(child) if child is not None else None
            for i, place in enumerate(places):
                found[i] *= (
                    place if of_child is None else sum(kicks[j] * (place - places[j]) * of_child[j] for j in range(i))
                )
        return found

    return [
        abs(sum(b * phi for b, phi in zip(kicks, weights(tree), strict=True)) - Decimal(1) / density(tree))
        for tree in trees(order)
    ]


def stages_of(flights, kicks):
    """The palindrome of these flights and kicks, of which the last kick stands in the middle."""
    pairs = zip(flights, kicks, strict=True)
    half = [stage for a, b in pairs for stage in ((schemes.FLIGHT, Decimal(a)), (schemes.KICK, Decimal(b)))]
    return (*half, *reversed(half[:-1]))


def test_there_are_as_many_trees_as_in_the_book():
    assert [len(trees(n)) for n in range(1, 10)] == [1, 1, 2, 3, 6, 10, 20, 36, 72]


@pytest.mark.parametrize("name", PRECISE)
def test_all_digits_meet_the_conditions(name):
    """34 digits leave 1e-33; and the table in use has these digits."""
    with localcontext(prec=DIGITS):
        stages, scheme = stages_of(*PRECISE[name]), schemes.SCHEMES[name]
        assert all(len(x.as_tuple().digits) >= 31 for _, x in stages)
        assert [(kind, float(x)) for kind, x in stages] == list(scheme.stages)
        assert abs(sum(x for kind, x in stages if kind == schemes.FLIGHT) - 1) < Decimal("1e-33")
        missed = [max(defects(stages, n)) for n in range(1, scheme.order + 1)]
        assert max(missed) < Decimal("1e-33")


@pytest.mark.parametrize("name", TABLES)
def test_a_table_has_its_order_and_no_more(name):
    """To the rounding of its digits, 14 or more."""
    scheme = schemes.SCHEMES[name]
    with localcontext(prec=DIGITS):
        stages = [(kind, Decimal(x)) for kind, x in scheme.stages]
        missed = [max(defects(stages, n)) for n in range(1, scheme.order + 2)]
        assert max(missed[:-1]) < Decimal("1e-13")
        assert missed[-1] > Decimal("1e-10")
