"""The kernels' mathematics a second time in plain NumPy: whole arrays, no padding, no closed formulas where an
iteration says the same.

A distribution is an array (..., points_x, points_y, points_z). `pack` and `VelocityGrid.unpack` go to the
kernels' slabs and back.
"""

import numpy as np

from rvm_mpi.grid.velocity import VelocityGrid

#: velocity grids in one, two and three directions: slabs that need padding and slabs that do not, odd and even counts
SHAPES = [(6,), (7,), (9, 7), (8, 8), (5, 4), (8, 6, 5), (6, 6, 8), (5, 7, 3)]


def make_grid(points, half_width=7.0):
    return VelocityGrid.create(points, (half_width,) * len(points))


def pack(grid, values):
    """Blocks (..., block) of values (..., px, py, pz), the padding zero."""
    values = np.asarray(values)
    nx, ny, nz = grid.points
    lead = values.shape[:-3]
    blocks = np.zeros((*lead, nx, grid.slab_size))
    blocks[..., : ny * nz] = values.reshape(*lead, nx, ny * nz)
    return blocks.reshape(*lead, grid.block)


def laid_out(grid, values, rng):
    """Cells one behind the other as the kernels see them, arbitrary numbers before and behind; and the first offset."""
    guard = -(-(2 * grid.slab_size + grid.points[2] + 16) // 8) * 8
    blocks = pack(grid, values).reshape(-1)
    return np.concatenate([rng.normal(size=guard), blocks, rng.normal(size=guard)]), guard


def random_g(grid, rng, cells=(), signed=False):
    """A rough positive g, over several orders of magnitude; or one of both signs."""
    shape = (*cells, *grid.points)
    return rng.normal(size=shape) if signed else np.exp(2.0 * rng.normal(size=shape))


def nodes(grid):
    """xi_x, xi_y, xi_z, each of three axes."""
    axes = [np.array([v * (2 * i + 1 - n) / n for i in range(n)]) for n, v in zip(grid.points, grid.half_width)]
    return np.meshgrid(*axes, indexing="ij", sparse=True)


def powers(grid, centre=(0.0, 0.0, 0.0)):
    """1, x, y, z, xx, xy, xz, yy, yz, zz about a centre: (10, px, py, pz)."""
    x, y, z = (axis - c for axis, c in zip(nodes(grid), centre))
    one = np.ones(grid.points)
    return np.array([one * m for m in (1.0, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z)])


def ten_sums(grid, g, centre=(0.0, 0.0, 0.0)):
    """Sums of the ten powers over the nodes: (..., 10)."""
    return np.einsum("...ijk,pijk->...p", g, powers(grid, centre))


def five_sums(grid, flux):
    """Sums of a flux times 1, xi, |xi|^2: (..., 5)."""
    p = powers(grid)
    return np.einsum("...ijk,pijk->...p", flux, np.array([*p[:4], p[4] + p[7] + p[9]]))


def half_slope(a, b):
    """Half of Van Leer's slope, from the textbook's 2 a b/(a + b)."""
    with np.errstate(all="ignore"):
        return np.where(a * b > 0.0, 0.5 * (2.0 * a * b / (a + b)), 0.0)


def upwinded(before, down, up, after, speed):
    """g on the face between down and up, from the side the speed comes from."""
    return np.where(speed > 0.0, *both_sides(before, down, up, after))


def both_sides(before, down, up, after):
    """The value on the face between down and up as each of them sees it."""
    return down + half_slope(down - before, up - down), up - half_slope(up - down, after - up)


def signed(up, down, xi):
    """Of a pair for velocities that go up and down, the one that holds for each xi."""
    return np.where(xi > 0.0, up, down)


#: linear fluxes through a face: of 4 or 8 nodes, central, as Shu (ICASE 97-65) and others list them
CENTRAL = {3: np.array([-1, 7, 7, -1]) / 12, 7: np.array([-3, 29, -139, 533, 533, -139, 29, -3]) / 840}


def bounded_flux(grid, flux, speed, values, turning, gradient, push, axis):
    """The flux between neighbouring values, as far as none loses more than its share of 2 max|a| g.

    Of that share all but h * spread may leave with a, h * spread against it; half of it where a is below 2 h * spread.
    """
    spread = abs(turning) + sum(np.abs(gradient[q]).max() * grid.half_width[q] for q in range(2))
    h, fastest = grid.spacing[axis], spread * grid.half_width[axis] + abs(push[axis])

    def share(along):
        ahead = np.where(along > 2 * h * spread, 2 * fastest - h * spread, fastest)
        return np.where(along > 0, ahead, h * spread)

    held = np.maximum(values, 0.0)
    return np.clip(flux, -share(-speed) * held[1:], share(speed) * held[:-1])


def drift_rate(grid, g, turning, gradient, push, order=0, bounded=False):
    """-div_xi (a g), a = -(turning + gradient . xi) xi + push, closed at the edge of the box.

    gradient: along x and y, each a pair for velocities that go up and down in that direction; order: 0 for Van Leer's
    limiter, else that of the linear reconstruction; bounded: whether its fluxes are (`bounded_flux`).
    """
    rate = np.zeros(g.shape)
    for axis, n in enumerate(grid.points):
        if n == 1:
            continue
        h, v = grid.spacing[axis], grid.half_width[axis]
        where = list(nodes(grid))
        shape = [1, 1, 1]
        shape[axis] = n - 1
        where[axis] = np.array([v * (2 * i + 2 - n) / n for i in range(n - 1)]).reshape(shape)
        along = turning + sum(signed(*gradient[q], where[q]) * where[q] for q in range(2))
        speed = np.broadcast_to(
            -along * where[axis] + push[axis], [*np.array(grid.points) - np.eye(3, dtype=int)[axis]]
        )
        speed, values = np.moveaxis(speed, axis, 0), np.moveaxis(g, axis, 0)
        through = np.zeros((n + 1, *values.shape[1:]))
        if order:
            where = list(nodes(grid))
            along = turning + sum(signed(*gradient[q], where[q]) * where[q] for q in range(2))
            product = np.moveaxis((-along * where[axis] + push[axis]) * g, axis, 0)
            beyond = [((order + 1) // 2,) * 2, (0, 0), (0, 0)]
            steps = np.diff(np.pad(values, beyond), order, axis=0)[1:-1]
            for tap, weight in enumerate(CENTRAL[order]):
                through[1:-1] += weight * np.pad(product, beyond)[tap + 1 : tap + n]
            through[1:-1] -= CENTRAL[order][-1] * np.abs(speed) * steps
            if bounded:
                through[1:-1] = bounded_flux(grid, through[1:-1], speed, values, turning, gradient, push, axis)
        else:
            step = np.diff(values, axis=0)
            bend = np.zeros_like(values)
            bend[1:-1] = half_slope(step[:-1], step[1:])
            through[1:-1] = speed * np.where(speed > 0.0, values[:-1] + bend[:-1], values[1:] - bend[1:])
        rate -= np.moveaxis(np.diff(through, axis=0), 0, axis) / h
    return rate


def exponential_family(grid, basis, weight, wanted, start):
    """The theta for which weight exp(theta . basis) has the sums `wanted` of the basis: damped Newton, to round-off.

    basis (n, px, py, pz). The sums are the gradient of a convex function, so a step is halved until it descends.
    """
    theta = np.array(start, dtype=float)

    def objective(t):
        with np.errstate(over="ignore"):
            values = weight * np.exp(np.einsum("p,pijk->ijk", t, basis))
        return float(values.sum() - t @ wanted), values

    scale = np.abs(wanted[0]) * np.array([np.sqrt(np.mean(b**2)) for b in basis])
    size, values = objective(theta)
    best, previous = theta, np.inf
    for _ in range(200):
        lack = wanted - np.einsum("ijk,pijk->p", values, basis)
        off = float(np.max(np.abs(lack) / scale))
        if off < previous:
            best = theta
        if off < 1e-16 or (off < 1e-13 and off >= previous):
            break
        previous = off
        step = np.linalg.solve(np.einsum("ijk,pijk,qijk->pq", values, basis, basis), lack)
        for _ in range(60):
            new_size, new_values = objective(theta + step)
            if np.isfinite(new_size) and new_size <= size + 1e-12 * abs(size):
                break
            step = 0.5 * step
        theta, size, values = theta + step, new_size, new_values
    return best


def gaussian(grid, density, mean, tensor):
    """The exponential of a quadratic with the sum, mean and covariance (d, d) given."""
    d = grid.dimensions
    pairs = [(a, b) for a in range(d) for b in range(a, d)]
    x = [axis - m for axis, m in zip(nodes(grid), mean)]
    one = np.ones(grid.points)
    basis = np.array([one, *(one * x[a] for a in range(d)), *(one * x[a] * x[b] for a, b in pairs)])
    wanted = density * np.array([1.0, *np.zeros(d), *(tensor[a][b] for a, b in pairs)])
    inverse = np.linalg.inv(tensor)
    quadratic = [-(0.5 if a == b else 1.0) * inverse[a, b] for a, b in pairs]
    plain = np.exp(np.einsum("p,pijk->ijk", np.array(quadratic), basis[1 + d :]))
    start = np.array([np.log(density / plain.sum()), *np.zeros(d), *quadratic])
    theta = exponential_family(grid, basis, 1.0, wanted, start)
    return np.exp(np.einsum("p,pijk->ijk", theta, basis))


def corrected(grid, g, target):
    """g times exp(c0 + c . xi + c2 |xi|^2) with the sums of 1, xi, |xi|^2/2 given (5)."""
    d = grid.dimensions
    x = nodes(grid)
    one = np.ones(grid.points)
    mean = [target[1 + a] / target[0] for a in range(3)]
    c = [axis - m for axis, m in zip(x, mean)]
    basis = np.array([one, *(one * c[a] for a in range(d)), one * sum(c[a] ** 2 for a in range(d))])
    spread = 2.0 * target[4] - target[0] * sum(m * m for m in mean)
    wanted = np.array([target[0], *np.zeros(d), spread])
    theta = exponential_family(grid, basis, g, wanted, np.zeros(d + 2))
    return g * np.exp(np.einsum("p,pijk->ijk", theta, basis))


# -- one step of the scheme, periodic in space ---------------------------------------------------------------


class Twin:
    """The two stages on a periodic domain: g (ny, nx, px, py, pz), omega (ny, nx), carried (ny, nx, 5).

    Parameters
    ----------
    grid : VelocityGrid
    spacing : tuple of floats
        One for each space dimension, x first.
    model : stage.Model
    order : int
        Of the drift's linear reconstruction, 0 for Van Leer's.
    """

    def __init__(self, grid, spacing, model, order=0):
        self.grid, self.spacing, self.model, self.order = grid, spacing, model, order
        self.d, self.weight = grid.dimensions, grid.weight

    def transport(self, g, omega):
        """Rates of g, and of mass, momentum and energy of f, by the fluxes through the faces."""
        rate, moments = np.zeros(g.shape), np.zeros((*omega.shape, 5))
        gradient = []
        for axis, h in enumerate(self.spacing):
            place = 1 - axis
            near = [np.roll(omega, -k, place) for k in (-1, 0, 1, 2)]
            sides = both_sides(*near) if self.model.conservative else [0.5 * (near[1] + near[2])] * 2
            xi = nodes(self.grid)[axis] * np.ones(self.grid.points)
            w = signed(*(side[..., None, None, None] for side in sides), xi)
            cells = [np.roll(g, -k, place) for k in (-1, 0, 1, 2)]
            flux = w / h * xi * upwinded(*cells, xi)
            mass, momentum, energy = (self.weight * five_sums(self.grid, flux * w**power) for power in range(3))
            carried = np.concatenate([mass[..., :1], momentum[..., 1:4], 0.5 * energy[..., 4:]], axis=-1)
            rate -= flux - np.roll(flux, 1, place)
            moments -= carried - np.roll(carried, 1, place)
            gradient.append([(side - np.roll(side, 1, place)) / h for side in sides])
        gradient += [[np.zeros(omega.shape)] * 2] * (2 - len(gradient))
        return rate, moments, np.array(gradient)

    def of_g(self, g, omega):
        """rho, rho u, E of f from the sums of g."""
        s = self.weight * ten_sums(self.grid, g)
        energy = 0.5 * omega**2 * (s[..., 4] + s[..., 7] + s[..., 9])
        return np.concatenate([s[..., :1], omega[..., None] * s[..., 1:4], energy[..., None]], axis=-1)

    def thermal(self, u):
        return u[..., 4] - 0.5 * np.sum(u[..., 1:4] ** 2, axis=-1) / u[..., 0]

    def haff(self, u, dt):
        """Carried moments after the homogeneous cooling of each cell over dt (negative: before)."""
        rho, thermal = u[..., 0], self.thermal(u)
        root = np.sqrt(2.0 * thermal / (self.d * rho))
        root = 1.0 / (1.0 / root + self.model.cooling * rho * dt)
        result = u.copy()
        result[..., 4] += 0.5 * self.d * rho * root**2 - thermal
        return result

    def depth_rate(self, rho, temperature):
        m = self.model
        return m.relaxation * rho**m.density_power * temperature**m.temperature_power

    def tensor_of(self, second, rho, u):
        """(1 - nu) T I + nu Theta of a state with the second moments rho (Theta + u u)."""
        theta = second / rho - np.outer(u, u)
        d, nu = self.d, self.model.nu
        return (1.0 - nu) * np.trace(theta) / d * np.eye(d) + nu * theta

    def second_moments(self, g):
        s = ten_sums(self.grid, g)
        d = self.d
        full = np.zeros((3, 3))
        for place, (a, b) in enumerate([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]):
            full[a, b] = full[b, a] = s[4 + place]
        return full[:d, :d]

    def relax(self, explicit, first, weight_first, weight_last, known):
        """(explicit + weight_first G[first] + weight_last G[result])/whole, both Gaussians as one; `known` is the
        weight of the parts without the last."""
        d = self.d
        p = np.array([ten_sums(self.grid, explicit), ten_sums(self.grid, first)])
        total = p[0, :4] + weight_first * p[1, :4]
        whole = known + weight_last
        rho = total[0] / (whole - weight_last)
        u = total[1 : 1 + d] / (rho * (whole - weight_last))
        rho0, u0 = p[1, 0], p[1, 1 : 1 + d] / p[1, 0]
        second0 = rho0 * (self.tensor_of(self.second_moments(first), rho0, u0) + np.outer(u0, u0))
        parts = self.second_moments(explicit) + weight_first * second0
        # the result's second moments, by iterating its implicit equation; trace first, for nu does not touch it
        trace = np.trace(parts) / (whole - weight_last)
        second = (trace / d) * np.eye(d)
        for _ in range(400):
            own = rho * (self.tensor_of(second, rho, u) + np.outer(u, u))
            second = (parts + weight_last * own) / whole
        own = rho * (self.tensor_of(second, rho, u) + np.outer(u, u))
        share = weight_first + weight_last
        if share == 0.0:
            return explicit / whole
        density = (weight_first * rho0 + weight_last * rho) / share
        mean = (weight_first * rho0 * u0 + weight_last * rho * u) / (share * density)
        tensor = (weight_first * second0 + weight_last * own) / (share * density) - np.outer(mean, mean)
        blended = gaussian(self.grid, density, [*mean, *np.zeros(3 - d)], tensor)
        return (explicit + share * blended) / whole

    def step(self, g, omega, carried, dt, omega_end=None, substeps=(None, None)):
        """g, omega and carried moments at the end of a step; omega_end where the scaling is given from outside.

        substeps: (ny, nx) for each stage, in how many substeps the drift is taken by itself, 0 where with transport.
        """
        growth = None if omega_end is None else np.log(omega_end / omega) / dt
        middle = self.stage(False, g, omega, carried, g, omega, carried, dt, growth, omega_end, None, substeps[0])
        depth = middle[3]
        return self.stage(True, g, omega, carried, *middle[:3], dt, growth, omega_end, depth, substeps[1])[:3]

    def flow(self, g, drift, dt, substeps):
        """The drift alone over dt: stages of forward Euler over dt/substeps, the last one averaged with the start."""
        moved = g
        for _ in range(substeps):
            moved = moved + dt / substeps * drift(moved)
        return (g + substeps * (moved + dt / substeps * drift(moved))) / (substeps + 1)

    def gaussian_of(self, g):
        """The discrete Gaussian G[g] of a cell."""
        s, d = ten_sums(self.grid, g), self.d
        u = s[1:4] / s[0]
        return gaussian(self.grid, s[0], u, self.tensor_of(self.second_moments(g), s[0], u[:d]))

    def stage(self, second, g0, omega0, carried0, g, omega, carried, dt, growth, omega_end, depth, substeps=None):
        """One stage from (g, omega, carried); the step began at (g0, omega0, carried0)."""
        substeps = np.zeros(omega.shape, dtype=int) if substeps is None else substeps
        model, grid, d = self.model, self.grid, self.d
        rate, moments, gradient = self.transport(g, omega)
        state = carried if model.conservative else self.of_g(g, omega)
        rho, thermal = state[..., 0], self.thermal(state)
        temperature = 2.0 * thermal / (d * rho)
        other = self.thermal(self.haff(state, -dt if second else dt))
        beta = np.abs(np.log(thermal / other)) / (2.0 * dt)
        if model.kinetic:
            energy_rate = moments[..., 4] - 2.0 * beta * thermal
            turning = 0.5 * (energy_rate / state[..., 4] - moments[..., 0] / rho) + beta
        else:
            turning = growth + beta
        velocity = state[..., 1:4] / rho[..., None]
        explicit = np.empty(g.shape)
        z = depth if second else np.zeros(omega.shape)
        weight_first = np.where(substeps > 0, 0.0, 0.5 * z)
        for at in np.ndindex(*omega.shape):
            push = beta[at] * velocity[at] / omega[at]

            def drift(block, at=at, push=push):
                return drift_rate(grid, block, turning[at], gradient[:, :, at[0], at[1]], push, self.order)

            moved = g[at] + dt * rate[at]
            if substeps[at] == 0:
                explicit[at] = moved + dt * drift(g[at])
                if second:
                    explicit[at] = 0.5 * g0[at] + 0.5 * (1.0 + z[at]) * explicit[at]
            elif second:
                known = 0.5 * g0[at] + (0.5 * z[at] * self.gaussian_of(g0[at]) if model.collisions else 0.0)
                explicit[at] = self.flow(known, drift, dt, substeps[at]) + 0.5 * (1.0 + z[at]) * moved
            else:
                explicit[at] = self.flow(moved, drift, dt, substeps[at])
        new_carried, new_omega = carried, omega_end
        if model.conservative:
            moved = carried + dt * moments
            new_carried = 0.5 * self.haff(carried0, dt) + 0.5 * moved if second else self.haff(moved, dt)
            if model.kinetic:
                new_omega = np.sqrt(2.0 * new_carried[..., 4] / (d * new_carried[..., 0]))
        result, new_depth = np.empty(g.shape), np.zeros(omega.shape)
        for at in np.ndindex(*omega.shape):
            w = new_omega[at]
            wanted = new_carried[at] / self.weight / np.array([1.0, w, w, w, w * w])
            if model.conservative:
                sums0 = ten_sums(grid, g0[at])
                begin = np.array([*sums0[:4], 0.5 * (sums0[4] + sums0[7] + sums0[9])])
                part = (1.0 + z[at]) * wanted - weight_first[at] * begin
                explicit[at] = corrected(grid, explicit[at], part)
            if not second and model.collisions:
                after = new_carried[at] if model.conservative else self.of_g(explicit[at], w)
                after_temperature = 2.0 * self.thermal(after) / (d * after[0])
                before = self.depth_rate(rho[at], temperature[at])
                new_depth[at] = 0.5 * dt * (before + self.depth_rate(after[0], after_temperature))
            zz = z[at] if second else new_depth[at]
            weights = (weight_first[at], 0.5 * zz * zz) if second else (0.0, zz)
            result[at] = self.relax(explicit[at], g0[at], *weights, 1.0 + zz if second else 1.0)
        return result, new_omega, new_carried, new_depth
