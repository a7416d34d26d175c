"""Which ranks lie together: the ranks of a node share one link, and so are given parts of the grid that touch.

A DMDA numbers its ranks along x first, and launchers give a node ranks that follow each other: a row of the grid's
parts, with two long sides. As a tile, nearly a square, the same ranks send a fraction of the bytes over the link
(docs/scaling.md). Ranks are renumbered for that; results do not depend on who owns what.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any


def nodes(comm: Any) -> list[int]:
    """The node of each rank, named by the first of its ranks; collective."""
    from mpi4py import MPI

    together = comm.Split_type(MPI.COMM_TYPE_SHARED)
    first = together.allreduce(comm.Get_rank(), op=MPI.MIN)
    together.Free()
    return list(comm.allgather(first))


def tile(split: tuple[int, int], cells: tuple[int, int], ranks: int) -> tuple[int, int]:
    """Ranks along x and y of a node's tile: of those that pave the grid the one with the shortest sides to others.

    Parameters
    ----------
    split : tuple of int
        Ranks along x and y of the whole grid.
    cells : tuple of int
        Cells along x and y of a rank.
    ranks : int
        Ranks of a node.

    Returns
    -------
    tuple of int
        (0, 0) where no tile paves the grid; of equals the widest, as the ranks are numbered anyway.
    """
    (px, py), (wide, high) = split, cells
    tiles = [(a, ranks // a) for a in range(min(px, ranks), 0, -1) if ranks % a == 0 and px % a == 0]
    tiles = [(a, b) for a, b in tiles if py % b == 0]

    def border(shape: tuple[int, int]) -> int:
        a, b = shape
        return (b * high if a < px else 0) + (a * wide if b < py else 0)

    return min(tiles, key=border, default=(0, 0))


def places(split: tuple[int, int], cells: tuple[int, int], node_of: Sequence[int]) -> list[int]:
    """The number each rank gets along x first, so that the ranks of a node are a tile.

    Or the number that it has, where fewer cells lie between nodes so: a launcher may have dealt the ranks out better.

    Parameters
    ----------
    split, cells : tuple of int
        As of `tile`.
    node_of : sequence of int
        The node of each rank, by any names.

    Returns
    -------
    list of int
        A permutation that leaves rank 0 where it is; the ranks as they are, where nodes have unequal numbers of them,
        no tile paves the grid, or tiles cut more.
    """
    counts = set(Counter(node_of).values())
    a, b = tile(split, cells, counts.pop()) if len(counts) == 1 else (0, 0)
    as_dealt = list(range(len(node_of)))
    if a * b == 0:
        return as_dealt
    px = split[0]
    number: dict[int, int] = {}
    taken: Counter[int] = Counter()
    found, tiled = [], list(node_of)
    for node in node_of:
        row, column = divmod(number.setdefault(node, len(number)), px // a)
        up, along = divmod(taken[node], a)
        taken[node] += 1
        found.append((row * b + up) * px + column * a + along)
        tiled[found[-1]] = node
    return found if cut(split, cells, tiled) <= cut(split, cells, node_of) else as_dealt


def cut(split: tuple[int, int], cells: tuple[int, int], node_at: Sequence[int]) -> int:
    """Cells along the sides between two nodes, the grid taken as periodic.

    Parameters
    ----------
    split, cells : tuple of int
        As of `tile`.
    node_at : sequence of int
        The node of each part of the grid, numbered along x first.
    """
    (px, py), (wide, high) = split, cells
    found = 0
    for place, node in enumerate(node_at):
        y, x = divmod(place, px)
        found += high * (node != node_at[y * px + (x + 1) % px])
        found += wide * (node != node_at[(y + 1) % py * px + x])
    return found
