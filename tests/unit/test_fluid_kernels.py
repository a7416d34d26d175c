"""The fluid's kernels against plain NumPy twins."""

import numpy as np
import pytest

from rvm_mpi.fluid import GHOSTS, cells, euler
from rvm_mpi.fluid.weno import weno5


def weno5_twin(v, flat=1e-40):
    """WENO-Z with exponent 2 in the notation of the papers; v: the five averages, flat: their epsilon."""
    a, b, c, d, e = v
    q = np.array([2 * a - 7 * b + 11 * c, -b + 5 * c + 2 * d, 2 * c + 5 * d - e]) / 6
    beta = np.array(
        [
            13 / 12 * (a - 2 * b + c) ** 2 + (a - 4 * b + 3 * c) ** 2 / 4,
            13 / 12 * (b - 2 * c + d) ** 2 + (b - d) ** 2 / 4,
            13 / 12 * (c - 2 * d + e) ** 2 + (3 * c - 4 * d + e) ** 2 / 4,
        ]
    )
    alpha = np.array([0.1, 0.6, 0.3]) * (1 + (abs(beta[0] - beta[2]) / (beta + flat)) ** 2)
    return alpha @ q / alpha.sum()


def primitives(q, gamma):
    u = q[1:-1] / q[0]
    return u, (gamma - 1) * (q[-1] - 0.5 * q[0] * (u @ u))


def flux_twin(q, gamma):
    u, p = primitives(q, gamma)
    f = u[0] * q
    f[1] += p
    f[-1] += p * u[0]
    return f


def fields_twin(left, right, gamma):
    """Right eigenvectors of the Jacobian at Roe's average, as columns: u - c, entropy, shears, u + c."""
    weights = np.sqrt([left[0], right[0]]) / np.sqrt([left[0], right[0]]).sum()
    states = (left, right)
    u = sum(w * q[1:-1] / q[0] for w, q in zip(weights, states, strict=True))
    h = sum(w * (q[-1] + primitives(q, gamma)[1]) / q[0] for w, q in zip(weights, states, strict=True))
    c = np.sqrt((gamma - 1) * (h - 0.5 * u @ u))
    columns = [[1, u[0] - c, *u[1:], h - u[0] * c], [1, *u, 0.5 * u @ u]]
    for t in range(1, len(u)):
        column = np.zeros(len(left))
        column[1 + t], column[-1] = 1, u[t]
        columns.append(column)
    columns.append([1, u[0] + c, *u[1:], h + u[0] * c])
    return np.array(columns, dtype=float).T


def high_flux_twin(cells, gamma):
    """Flux between the third and the fourth of six cells (6, m)."""
    right = fields_twin(cells[2], cells[3], gamma)
    inverse = np.linalg.inv(right)
    signals = []
    for q in cells:
        u, p = primitives(q, gamma)
        c = np.sqrt(gamma * p / q[0])
        signals.append([abs(u[0] - c), *[abs(u[0])] * (len(q) - 2), abs(u[0] + c)])
    speed = np.max(signals, axis=0)
    w = cells @ inverse.T
    g = np.array([flux_twin(q, gamma) for q in cells]) @ inverse.T
    plus, minus = 0.5 * (g + speed * w), 0.5 * (g - speed * w)
    # what is no roughness: 1e-20 of the natural size of the flux, that of momentum for the shears
    fastest = max(max(signal) for signal in signals)
    mass = 1e-20 * cells[:, 0].max() * fastest
    flat = [mass**2, mass**2, *[(mass * fastest) ** 2] * (len(speed) - 3), mass**2]
    field = [
        weno5_twin(plus[:5, c], flat[c]) + weno5_twin(minus[:0:-1, c], flat[c]) for c in range(len(speed))
    ]
    return right @ field


def low_flux_twin(a, b, gamma):
    speed = 0.0
    for q in (a, b):
        u, p = primitives(q, gamma)
        speed = max(speed, abs(u[0]) + np.sqrt(gamma * p / q[0]))
    return 0.5 * (flux_twin(a, gamma) + flux_twin(b, gamma) - speed * (b - a))


def inner(q):
    return q[-1] - 0.5 * (q[1:-1] @ q[1:-1]) / q[0]


def allowed_twin(first, loss):
    """Part of `loss` on the limiter's chord that leaves the fraction KEPT of density and internal energy."""
    theta = 1.0
    if first[0] - loss[0] < euler.KEPT * first[0]:
        theta = (1 - euler.KEPT) * first[0] / loss[0]
    after = inner(first - theta * loss)
    if after < euler.KEPT * inner(first):
        theta *= (1 - euler.KEPT) * inner(first) / (inner(first) - after)
    return theta


def row_twin(row, ratio, share):
    """Change of the cells of one ghosted row (n + 6, m), normal momentum second; and the limiter's thetas."""
    gamma = len(row[0]) / (len(row[0]) - 2)
    n = len(row) - 2 * GHOSTS
    low = {i: low_flux_twin(row[i], row[i + 1], gamma) for i in range(1, n + 4)}
    first = {i: row[i] - share * (low[i] - low[i - 1]) for i in range(2, n + 4)}
    flux, thetas = {}, []
    for i in range(2, n + 3):
        extra = high_flux_twin(row[i - 2 : i + 4], gamma) - low[i]
        thetas.append(
            min(allowed_twin(first[i], 2 * share * extra), allowed_twin(first[i + 1], -2 * share * extra))
        )
        flux[i] = low[i] + thetas[-1] * extra
    return np.array([-ratio * (flux[i] - flux[i - 1]) for i in range(3, n + 3)]), thetas


def random_state(rng, shape, d, contrast):
    """Random positive states with density and temperature over `contrast` decades."""
    density, temperature = (10 ** (contrast * (rng.random(shape) - 0.5)) for _ in range(2))
    velocity = min(contrast, 1.0) * rng.normal(size=(*shape, d)) * np.sqrt(temperature)[..., None]
    energy = 0.5 * density * (d * temperature + (velocity**2).sum(-1))
    return np.concatenate([density[..., None], density[..., None] * velocity, energy[..., None]], axis=-1)


def test_weno5_is_its_twin_and_fifth_order():
    rng = np.random.default_rng(1)
    for v in rng.normal(size=(200, 5)):
        assert weno5(*v, 1e-40) == pytest.approx(weno5_twin(v), rel=1e-12, abs=1e-13)
        # in any other unit the same bits
        assert weno5(*(2.0**-300 * v), 2.0**-600 * 1e-40) == 2.0**-300 * weno5(*v, 1e-40)
    # averages of a quartic give its value at the face exactly but for the weights, of a step no overshoot
    errors = []
    for h in (0.1, 0.05, 0.025):
        edges = h * np.arange(-3, 3)  # an extremum of cos one cell away from the face
        averages = np.diff(np.sin(edges + 0.5 * h)) / h
        errors.append(abs(weno5(*averages, 1e-40) - np.cos(0.5 * h)))
    assert np.log2(errors[0] / errors[1]) > 4.7 and np.log2(errors[1] / errors[2]) > 4.7
    assert abs(weno5(0.0, 0.0, 0.0, 1.0, 1.0, 1e-40)) < 1e-3
    assert abs(weno5(1.0, 1.0, 1.0, 0.0, 0.0, 1e-40) - 1.0) < 1e-3
    assert weno5(0.0, 0.0, 0.0, 0.0, 0.0, 1e-40) == 0.0


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("contrast", [0.1, 4.0])
def test_sweep_is_its_twin(d, contrast):
    rng = np.random.default_rng(10 * d)
    ny, nx, directions = 5, 19, min(d, 2)
    wy = GHOSTS if directions == 2 else 0
    state = random_state(rng, (ny + 2 * wy, nx + 2 * GHOSTS), d, contrast)
    work = np.zeros(euler.work_size(max(nx, ny)))
    fastest = max(
        abs(q[1:-1] / q[0]).max() + np.sqrt(2 * (d + 2) / d**2 * inner(q) / q[0])
        for q in state.reshape(-1, d + 2)
    )
    ratio = 0.5 / fastest
    change = np.full((ny, nx, d + 2), np.nan)
    euler.sweep(state, change, 0, directions, ratio, False, False, work)
    limited = []
    for j in range(ny):
        expected, thetas = row_twin(state[wy + j], ratio, directions * ratio)
        limited += thetas
        assert np.allclose(change[j], expected, rtol=1e-10, atol=1e-12 * abs(expected).max())
    if directions == 2:
        euler.sweep(state, change, 1, directions, ratio, False, False, work)
        order = [0, 2, 1, *range(3, d + 2)]
        for i in range(nx):
            x_part = np.array([row_twin(state[wy + j], ratio, 2 * ratio)[0][i] for j in range(ny)])
            y_part, thetas = row_twin(state[:, GHOSTS + i][:, order], ratio, 2 * ratio)
            limited += thetas
            expected = x_part + y_part[:, order]
            assert np.allclose(change[:, i], expected, rtol=1e-10, atol=1e-12 * abs(expected).max())
    # the limiter is at work in the one case and idle in the other
    assert (min(limited) < 0.999) == (contrast > 1)


@pytest.mark.parametrize("d", [1, 3])
def test_one_limited_euler_step_is_positive_at_the_largest_step(d):
    """Eight decades of density and temperature at dt max_rate = 1/2, in one row."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        state = random_state(rng, (1, 60 + 2 * GHOSTS), d, 8.0)
        rate = cells.largest_rate(state, 0, 0, 0.0, 1.0)
        change = np.empty((1, 60, d + 2))
        euler.sweep(state, change, 0, 1, 0.5 / rate, False, False, np.zeros(euler.work_size(60)))
        inside = state[:, GHOSTS:-GHOSTS].copy()
        assert cells.combine(inside, inside.copy(), change, 1.0) == 60
        assert (inside[..., 0] > 0).all() and all(inner(q) > 0 for q in inside[0])


def test_combine_cool_rate_and_omega_are_their_twins():
    rng = np.random.default_rng(2)
    for d in (1, 2, 3):
        state, start = (random_state(rng, (4, 5), d, 1.0) for _ in range(2))
        change = 1e-3 * rng.normal(size=state.shape)
        expected = 0.75 * start + 0.25 * (state + change)
        result = state.copy()
        assert cells.combine(result, start, change, 0.25) == 20
        assert np.allclose(result, expected, rtol=1e-14)
        result[2, 3, 0] = -1.0
        assert cells.combine(result, start, np.zeros_like(change), 1.0) == 13
        result[1, 0, -1] = np.nan
        assert cells.combine(result, start, np.zeros_like(change), 1.0) == 5

        temperature = np.array([[2 * inner(q) / (d * q[0]) for q in row] for row in state])
        rate = 0.7 * state[..., 0] * 0.3
        for power, after in (
            (1.0, temperature / (1 + rate * np.sqrt(temperature)) ** 2),
            (0.4, (temperature**-0.2 + 0.4 * rate) ** -5),
            (0.0, temperature * np.exp(-2 * rate)),
        ):
            cooled = state.copy()
            cells.cool(cooled, 0.7, power, 0.3)
            expected = state[..., -1] + 0.5 * d * state[..., 0] * (after - temperature)
            assert np.allclose(cooled[..., -1], expected, rtol=1e-13)
            assert np.array_equal(cooled[..., :-1], state[..., :-1])

        sound = np.sqrt((d + 2) / d * temperature)
        u = abs(state[..., 1:-1] / state[..., :1])
        rate = (u[..., 0] + sound) * 3.0 + ((u[..., 1] + sound) * 2.0 if d > 1 else 0.0)
        assert cells.largest_rate(state, 0, 0, 2.0, 3.0) == pytest.approx(rate.max(), rel=1e-13)

        omega = np.empty((4, 5))
        cells.root_mean_energy(state, omega)
        assert np.allclose(omega, np.sqrt(2 * state[..., -1] / (d * state[..., 0])), rtol=1e-15)
