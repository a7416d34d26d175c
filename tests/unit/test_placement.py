"""Ranks of a node on parts of the grid that touch, against counting every side between two parts."""

import random

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from rvm_mpi.grid.placement import places, tile


def cut(split, cells, node_at):
    """Cells along sides between two nodes; node_at[place], the places numbered along x first. Periodic."""
    (px, py), (wide, high) = split, cells
    grid = np.reshape(node_at, (py, px))
    across_x = np.count_nonzero(grid != np.roll(grid, 1, axis=1)) if px > 1 else 0
    across_y = np.count_nonzero(grid != np.roll(grid, 1, axis=0)) if py > 1 else 0
    return across_x * high + across_y * wide


def placed(split, cells, node_of):
    """The node at each place."""
    numbers = places(split, cells, node_of)
    assert sorted(numbers) == list(range(len(node_of)))
    assert numbers[0] == 0
    node_at = [0] * len(node_of)
    for rank, number in enumerate(numbers):
        node_at[number] = node_of[rank]
    return node_at


sizes = st.integers(1, 6)
CELLS = st.tuples(st.integers(3, 40), st.integers(3, 40))


@given(a=sizes, b=sizes, along=sizes, up=sizes, cells=CELLS, seed=st.none() | st.integers(0, 99))
def test_nodes_are_tiles_unless_these_cut_more_than_the_order_dealt(a, b, along, up, cells, seed):
    split, ranks = (a * along, b * up), a * b
    node_of = [rank // ranks for rank in range(ranks * along * up)]
    if seed is not None:  # a launcher that deals the ranks out in another order
        rest = node_of[1:]
        random.Random(seed).shuffle(rest)
        node_of[1:] = rest
    node_at = placed(split, cells, node_of)
    if node_at != node_of:
        for node in set(node_of):
            rows, columns = np.nonzero(np.reshape(node_at, split[::-1]) == node)
            height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
            assert width * height == ranks == rows.size
    # never worse than the tile this was made of, nor than the order dealt, nor than rows
    tiles = [column // a + row // b * along for row in range(split[1]) for column in range(split[0])]
    found = cut(split, cells, node_at)
    assert found <= cut(split, cells, tiles)
    assert found <= cut(split, cells, node_of)
    assume(split[0] % ranks == 0 or ranks % split[0] == 0)
    assert found <= cut(split, cells, [rank // ranks for rank in range(len(node_of))])


def test_sixty_four_ranks_of_a_node_are_a_square():
    """The example of docs/scaling.md: 128 strips leave a node in rows, 32 in squares."""
    split, node_of = (64, 64), [rank // 64 for rank in range(4096)]
    assert tile(split, (8, 8), 64) == (8, 8)
    assert cut(split, (8, 8), node_of) * 2 // 64 == 128 * 8
    assert cut(split, (8, 8), placed(split, (8, 8), node_of)) * 2 // 64 == 32 * 8


def test_an_order_dealt_that_cuts_less_than_tiles_stays():
    """Tiles of three parts are rows or columns; these two nodes hook into each other."""
    split, cells, node_of = (3, 2), (4, 3), [0, 1, 0, 0, 1, 1]
    assert tile(split, cells, 3) == (3, 1)
    assert cut(split, cells, [0, 0, 0, 1, 1, 1]) == 24
    assert cut(split, cells, node_of) == 20
    assert places(split, cells, node_of) == list(range(6))


def test_numbers_by_hand():
    """Unequal nodes, one node, columns of three."""
    assert places((4, 2), (5, 5), [0, 0, 0, 0, 0, 5, 5, 5]) == list(range(8))
    assert places((3, 3), (5, 5), [0] * 9) == list(range(9))
    columns = [0, 5, 10, 1, 6, 11, 2, 7, 12, 3, 8, 13, 4, 9, 14]
    assert places((5, 3), (9, 9), [rank // 3 for rank in range(15)]) == columns
