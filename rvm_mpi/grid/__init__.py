"""The grids: cells of space shared among ranks, nodes of velocity."""
