"""A cooling gas by direct simulation Monte Carlo: its fourth cumulant a_2, beside the Sonine theory.

`python benchmarks/dsmc.py` (a minute), `--particles`, `--sweeps` for more. Kernel |u| b, b constant in sigma: pairs are
drawn at random and accepted with the probability |u|/u_max, sigma is uniform on the sphere; hard spheres in d = 3.
Velocities are rescaled to temperature one after each sweep, which changes nothing but the time. Errors are those of the
mean over blocks of sweeps, one standard deviation.
"""

# ruff: noqa: NPY002  the generator that compiled code has

import argparse
import sys
from math import pi
from pathlib import Path

import numpy as np
from numba import njit

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests.verification.cooling_state import cooling_state

RESTITUTIONS = (0.5, 0.7, 0.8, 0.9)


@njit
def sweep(v, pairs, restitution, largest):
    """So many candidate pairs; returns the collisions, and the largest |u| met, above which some were too rare."""
    n, d = v.shape
    sigma = np.empty(d)
    collisions, met = 0, 0.0
    for _ in range(pairs):
        i, j = np.random.randint(n), np.random.randint(n - 1)
        j += j >= i
        speed = 0.0
        for c in range(d):
            speed += (v[i, c] - v[j, c]) ** 2
        speed = speed**0.5
        met = max(met, speed)
        if np.random.random() * largest > speed:
            continue
        collisions += 1
        angle = 2 * pi * np.random.random()
        sine = 1.0
        if d == 3:
            sigma[2] = 2 * np.random.random() - 1
            sine = (1 - sigma[2] ** 2) ** 0.5
        sigma[0], sigma[1] = sine * np.cos(angle), sine * np.sin(angle)
        for c in range(d):
            change = (1 + restitution) / 4 * (speed * sigma[c] - (v[i, c] - v[j, c]))
            v[i, c] += change
            v[j, c] -= change
    return collisions, met


@njit
def rescale(v):
    """Rest and temperature one; returns <|v|^4>."""
    n, d = v.shape
    for c in range(d):
        v[:, c] -= v[:, c].mean()
    v *= (n * d / (v**2).sum()) ** 0.5
    fourth = 0.0
    for i in range(n):
        square = 0.0
        for c in range(d):
            square += v[i, c] ** 2
        fourth += square**2
    return fourth / n


@njit
def simulate(v, restitution, sweeps, largest, seed):
    """<|v|^4> after each sweep, collisions of a particle a sweep, largest |u|; about one collision a particle each."""
    np.random.seed(seed)
    n, d = v.shape
    for i in range(n):
        for c in range(d):
            v[i, c] = np.random.normal()
    fourth, collisions, met = np.empty(sweeps), 0, 0.0
    for s in range(sweeps):
        fourth[s] = rescale(v)
        count, fastest = sweep(v, 2 * n, restitution, largest)
        collisions += count
        met = max(met, fastest)
    return fourth, 2 * collisions / (n * sweeps), met


def measure(d, restitution, particles, sweeps, seed=1):
    """a_2, its error, collisions of a particle in all, and the largest |u| over u_max."""
    largest = 16.0
    fourth, collisions, met = simulate(np.empty((particles, d)), restitution, sweeps, largest, seed)
    start = max(30, sweeps // 10)
    blocks = np.array_split(fourth[start:] / (d * (d + 2)) - 1, 20)
    means = np.array([b.mean() for b in blocks])
    return (
        fourth[start:].mean() / (d * (d + 2)) - 1,
        means.std(ddof=1) / len(means) ** 0.5,
        collisions * sweeps,
        met / largest,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--particles", type=int, default=100_000)
    parser.add_argument("--sweeps", type=int, default=400)
    given = parser.parse_args()
    print(f"{given.particles} particles, {given.sweeps} sweeps")
    print(" d    e        a_2     error   linear   eighth order   collisions of a particle   largest |u|/u_max")
    for d in (2, 3):
        for e in RESTITUTIONS:
            a2, error, collisions, met = measure(d, e, given.particles, given.sweeps)
            linear, high = cooling_state(d, e, 2, True)[0][0], cooling_state(d, e, 8)[0][0]
            print(
                f"{d:2} {e:4.1f} {a2:10.5f} {error:9.5f} {linear:8.5f} {high:14.5f} {collisions:26.0f} {met:19.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
