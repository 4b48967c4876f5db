"""Places labels as near as possible to what they name, so that none covers another."""

from collections.abc import Sequence


def apart(heights: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """The nearest heights, by least squares, that are at least `gap` apart, in the same order, and within low to high.

    With the gaps subtracted, the problem is isotonic regression: neighbours out of sequence are pooled at their mean.
    """
    order = sorted(range(len(heights)), key=lambda i: heights[i])
    pools: list[list[float]] = []  # [mean, number of members]
    for rank, i in enumerate(order):
        pools.append([heights[i] - rank * gap, 1])
        while len(pools) > 1 and pools[-2][0] > pools[-1][0]:
            mean, members = pools.pop()
            pools[-1] = [
                (pools[-1][0] * pools[-1][1] + mean * members) / (pools[-1][1] + members),
                pools[-1][1] + members,
            ]
    room = max(low, high - (len(heights) - 1) * gap)
    placed = [min(max(mean, low), room) for mean, members in pools for _ in range(int(members))]
    result = [0.0] * len(heights)
    for rank, i in enumerate(order):
        result[i] = placed[rank] + rank * gap
    return result
