"""How fast a cell's frame turns: omega on its faces, its gradients, and the drift in velocity that they make."""

from __future__ import annotations

from rvm_mpi.compiling.declare import part
from rvm_mpi.kinetic.drift import Drift
from rvm_mpi.kinetic.drift_speed import fastest_along, fastest_turning
from rvm_mpi.kinetic.limiter import face_number


@part
def face_omega(upwind, omega, y, x, down, right):  # type: ignore[no-untyped-def]
    """omega at the upper face of cell (y, x) along (down, right), as this cell and as the next one see it.

    Upwind where the moments are carried by the fluxes: velocities that go up carry the lower cell's omega, those that
    go down the upper cell's, each reconstructed as g is, so that what crosses a face is what the gas of that side
    sends, however much omega jumps. Without carried moments nothing but the drift takes back what a jump of
    omega does to g, and it does so best with the mean.
    """
    b, c = omega[y, x], omega[y + down, x + right]
    if not upwind:
        return 0.5 * (b + c), 0.5 * (b + c)
    a, e = omega[y - down, x - right], omega[y + 2 * down, x + 2 * right]
    # no room beyond Koren's bounds: at a jump it would set gas at rest in motion
    return face_number(b, b - a, c - b, 0.0), face_number(c, c - e, b - c, 0.0)


@part
def omega_across(upwind, omega, y, x, down, right):  # type: ignore[no-untyped-def]
    """omega at a cell's lower face and at its upper one along (down, right), each as `face_omega` has it."""
    if down + right == 0:
        here = omega[y, x]
        return here, here, here, here
    lower = face_omega(upwind, omega, y - down, x - right, down, right)
    upper = face_omega(upwind, omega, y, x, down, right)
    return lower[0], lower[1], upper[0], upper[1]


@part
def frame_drift(grid, space, upwind, omega, cell, own, state):  # type: ignore[no-untyped-def]
    """A cell's drift a = -(A + xi . grad omega) xi + push, and how fast it and transport are.

    Parameters
    ----------
    upwind : bool
        As `face_omega`.
    omega : array with ghosts
    cell : Here
    own : float
        A = d_t omega/omega and the drag's rate together.
    state : tuple
        beta, and mean (three numbers) and temperature of g.

    Returns
    -------
    Drift, float, float
        The drift; sums of max|a|/h over the directions of space and over those of velocity.
    """
    y, x, (beta, mean, temperature) = cell.y, cell.x, state
    w0, w1, e0, e1 = omega_across(upwind, omega, y, x, 0, 1 if space.dimensions >= 1 else 0)
    s0, s1, n0, n1 = omega_across(upwind, omega, y, x, 1 if space.dimensions == 2 else 0, 0)
    half_width = grid.half_width
    rises = (
        (e0 - w0) * space.per_dx,
        (e1 - w1) * space.per_dx,
        (n0 - s0) * space.per_dy,
        (n1 - s1) * space.per_dy,
    )
    push, nothing = (beta * mean[0], beta * mean[1], beta * mean[2]), (0.0, 0.0, 0.0)
    turning = fastest_turning(own, rises, half_width)
    fastest = (
        fastest_along(grid, push[0], turning, 0),
        fastest_along(grid, push[1], turning, 1),
        fastest_along(grid, push[2], turning, 2),
    )
    drift = Drift(
        own=own,
        rising_x=rises[0],
        falling_x=rises[1],
        rising_y=rises[2],
        falling_y=rises[3],
        push=push,
        centre=mean,
        temperature=temperature,
        flow=(0.0, 0.0),
        shears=(nothing, nothing, nothing, nothing),
        fastest=fastest,
    )
    crossing = max(w0, w1, e0, e1) * half_width[0] * space.per_dx
    crossing += max(s0, s1, n0, n1) * half_width[1] * space.per_dy
    return drift, crossing, fastest[0] + fastest[1] + fastest[2]
