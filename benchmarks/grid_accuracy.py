"""What a velocity grid makes of viscosity, heat conduction and the cooling state: `advice/accuracy_tables.json`.

    python benchmarks/grid_accuracy.py                 (prints all tables; an hour, most of it for d = 3)
    python benchmarks/grid_accuracy.py --write         (and writes them into the package)
    python benchmarks/grid_accuracy.py --only cooling  (one part: operator, drift or cooling; --write keeps the others)
    python benchmarks/grid_accuracy.py --exponent 0    (Maxwell molecules, not hard spheres, on a few grids)

The Boltzmann operator by itself, elastic, linear about the sampled Maxwellian M of unit temperature at rest: it acts
on M (xi_x xi_y + xi_x (|xi|^2 - d - 2)), and the momentum it makes is taken out as the program's correction does. C(t)
is what is left of stress and heat flux, t in units of the heat flux's first Sonine relaxation time. Given are

    first        the initial rate, over the exact one: first Sonine approximation, inverted
    viscosity    the integral of C over ten relaxation times, over the exact one
    conductivity the same of the heat flux
    residue      C of the heat flux after twenty: what never relaxes

d = 1 has no shear and its elastic collisions do nothing: there e = 0.9, and the loss of energy and the initial rate of
the heat flux are given.

The drift: conductivity of ES-BGK in rescaled variables (tests/verification/navier_stokes.py) over that in classical
ones, from a wave on 64 cells, V = 7, with so many velocities along the gradient (d = 1), and across it (d = 2, 32
along). Errors add up: that of d dimensions is the mean over the directions, along counted three times, across once.
The viscosity of a shear wave on as many velocities in both directions (d = 2), over that of the finest grid, is the
third row.

Cooling: the fourth cumulant a_2 less that of Sonine theory (tests/verification/cooling_state.py), of the homogeneous
cooling state of hard spheres, operator and drift together: whole runs from a Maxwellian, moments held, until T has
fallen a hundredfold. NaN where a run fails. In d = 1 there is no theory, and the state is no near Maxwellian.
"""

import argparse
import json
import re
import sys
import time
from math import gamma
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi.collisions.boltzmann import BoltzmannOperator
from rvm_mpi.collisions.weights import SUPPORT, kernel_scale
from rvm_mpi.kinetic_theory import dissipation_coefficient, sphere_area
from rvm_mpi.step.failure import NumericalFailure
from tests.verification.cooling_state import cool, cooling_state
from tests.verification.navier_stokes import conductivity, viscosity

TABLES = Path(__file__).resolve().parent.parent / "rvm_mpi" / "advice" / "accuracy_tables.json"
HALF_WIDTHS = {
    1: (4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 7.5, 8.0, 8.5, 9.0, 9.5, 10.0, 10.5, 11.0, 12.0),
    2: (4.0, 4.5, 5.0, 5.25, 5.5, 5.75, 6.0, 6.25, 6.5, 6.75, 7.0, 7.5, 8.0, 8.5, 9.0, 10.0),
    3: (5.0, 5.5, 6.0, 6.5, 7.0, 7.5, 8.0, 9.0),
}
POINTS = {1: range(8, 49), 2: range(10, 49), 3: (*range(10, 29), 32)}
#: all converged Sonine expansions: viscosity and conductivity over their first approximations
EXACT = {(2, 1): (1.0220, 1.0297), (3, 1): (1.016034, 1.025218), (2, 0): (1.0, 1.0), (3, 0): (1.0, 1.0)}
RESTITUTION = 0.9  # in d = 1
END, LASTED, STEPS = 20, 10, 4  # relaxation times, and Runge-Kutta steps in each
SPACINGS = (8, 9, 10, 11, 12, 14, 16, 18, 20, 24, 28, 32, 40, 48)  # velocities on V = 7
DRIFTS = ("maxwellian", "van-leer", "seventh-order", "seventh-order-positive")
RELAXATION, CELLS, ALONG = 0.01, 64, 32
#: of the cooling states
COOLING_POINTS = {
    2: dict.fromkeys(("maxwellian", "van-leer"), (12, 16, 20, 24, 28, 32, 40, 48)),
    3: {"maxwellian": (12, 16, 20, 24), "van-leer": (12, 16, 20)},
}
COOLING_WIDTHS = {2: (5.0, 6.0, 7.0, 8.0, 9.0, 10.0), 3: (5.0, 6.0, 7.0, 8.0)}
COOLING_RESTITUTIONS = {2: (0.5, 0.7, 0.8, 0.9, 0.95), 3: (0.7, 0.8, 0.9)}
THEORY_RESTITUTIONS = (0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0)
DECADES, ORDER = 2, 8  # of T, and of the Sonine series


class Gas:
    """Perturbed Maxwellians on grids of the same number of points and several half widths, one a row."""

    def __init__(self, dimensions, points, half_widths, restitution, exponent):
        d = self.dimensions = dimensions
        unit = kernel_scale(d, 1.0, exponent, 1.0)
        self.operator = BoltzmannOperator.create((points,) * d, 1.0, restitution, exponent, 1 / unit)
        # g stands here for its nodes' shares of the mass: g times a node's volume
        self.scale = np.array([kernel_scale(d, w, exponent, 1.0) / (2 * w / points) ** d for w in half_widths])
        nodes = np.stack(np.meshgrid(*[(2 * np.arange(points) + 1 - points) / points] * d, indexing="ij"))
        xi = np.array([width * nodes for width in half_widths])
        self.axes = tuple(range(1, d + 1))
        self.x, self.square = xi[:, 0], (xi**2).sum(1)
        self.maxwellian = np.exp(-0.5 * self.square)
        self.maxwellian /= self.maxwellian.sum(self.axes, keepdims=True)
        self.stress = self.x * xi[:, -1] if d > 1 else 0.0 * self.x
        self.flux = self.x * (self.square - d - 2)

    def collide(self, g):
        """Q(g, g)."""
        out = np.empty_like(g)
        self.operator.collide(g, out, self.scale)
        return out

    def linear(self, h):
        """2 Q(M, h) for h odd in xi_x, less its momentum: the odd part of Q(M + h)."""
        q = self.collide(self.maxwellian + h)
        q = 0.5 * (q - np.flip(q, 1))
        return q - self.maxwellian * self.x * self.part(q, self.x).reshape(-1, *(1,) * self.dimensions)

    def part(self, h, polynomial):
        """How much of M times this polynomial is in h: one number a grid."""
        return (h * polynomial).sum(self.axes) / (self.maxwellian * polynomial**2).sum(self.axes)

    def parts(self, h):
        """Of the stress and of the heat flux: (2, grids)."""
        return np.array([self.part(h, polynomial) for polynomial in (self.stress, self.flux)])


def relaxation_rates(d, exponent):
    """Those of stress and heat flux, b = 1, T = 1: first Sonine approximation (`kinetic_theory.py`)."""
    moment = gamma((d + exponent + 4) / 2) / gamma(d / 2)
    shear = 2 * sphere_area(d) * 2**exponent * moment / (d * (d + 2))
    return np.array([shear, shear * (d - 1) / d])


def measure_operator(d, points, exponent=1):
    """first (2, grids), viscosity, conductivity and residue (grids,) of one number of points."""
    gas = Gas(d, points, HALF_WIDTHS[d], 1.0, exponent)
    rates = relaxation_rates(d, exponent)
    dt = 1 / (STEPS * rates[1])
    h = gas.maxwellian * (gas.stress + gas.flux)
    h -= gas.maxwellian * gas.x * gas.part(h, gas.x).reshape(-1, *(1,) * d)
    left, slope, lasted = gas.parts(h), gas.parts(gas.linear(h)), 0.0
    first = -left / slope * rates[:, None]
    for step in range(END * STEPS):
        k1 = gas.linear(h)
        k2 = gas.linear(h + 0.5 * dt * k1)
        k3 = gas.linear(h + 0.5 * dt * k2)
        k4 = gas.linear(h + dt * k3)
        h = h + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        before, slope, left = left, gas.parts(k1), gas.parts(h)
        if step < LASTED * STEPS:  # Hermite's rule
            lasted = lasted + dt / 2 * (before + left) + dt**2 / 12 * (slope - gas.parts(k4))
    over_exact = lasted * rates[:, None] / np.array(EXACT[d, exponent])[:, None]
    return first, over_exact[0], over_exact[1], left[1]


def measure_cooling(points):
    """d = 1, e = 0.9: loss of energy and time in which the heat flux relaxes, not yet over the exact ones."""
    gas = Gas(1, points, HALF_WIDTHS[1], RESTITUTION, 1.0)
    energy = 0.5 * (gas.collide(gas.maxwellian) * gas.square).sum(1)
    rate = gas.part(gas.linear(gas.maxwellian * gas.flux), gas.flux)
    return -energy / ((1 - RESTITUTION**2) * dissipation_coefficient(1, 1.0)), -1 / rate


def operator_tables(dimensions, exponent, points=POINTS):
    """Print and return {d: {points: (viscosity or cooling, conductivity, residue or nothing)}}."""
    tables = {}
    for d in dimensions:
        print(f"\nd = {d}, half widths {HALF_WIDTHS[d]}, support {np.round(SUPPORT * np.array(HALF_WIDTHS[d]), 2)}")
        exact = measure_cooling(256)[1][-1] if d == 1 else None
        tables[d] = {}
        for n in points[d]:
            begin = time.perf_counter()
            if d == 1:
                cooling, heat = measure_cooling(n)
                named = {"cooling": cooling, "conductivity": heat / exact}
                tables[d][n] = (cooling, heat / exact)
            else:
                first, viscosity_, conductivity_, residue = measure_operator(d, n, exponent)
                named = {"first viscosity": first[0], "first conductivity": first[1]}
                named |= {"viscosity": viscosity_, "conductivity": conductivity_, "residue": residue}
                tables[d][n] = (viscosity_, conductivity_, residue)
            print(f"{n} points, {time.perf_counter() - begin:.1f} s", flush=True)
            for name, row in named.items():
                print(f"  {name:<18}", " ".join(f"{value:10.4g}" for value in row), flush=True)
    return tables


def drift_table():
    """Print and return {drift: (along, across, viscosity)} over the exact ones at `SPACINGS`."""
    found = {}
    exact = {d: wave(conductivity, (48,) * d, "none", "van-leer") for d in (1, 2)}
    for drift in DRIFTS:
        along, across, shear = [], [], []
        lost = 3 * (1 - wave(conductivity, (ALONG,), "kinetic", drift) / exact[1])
        for n in SPACINGS:
            along.append(wave(conductivity, (n,), "kinetic", drift) / exact[1])
            across.append(1 + lost - 4 * (1 - wave(conductivity, (ALONG, n), "kinetic", drift) / exact[2]))
            shear.append(wave(viscosity, (n, n), "kinetic", drift))
        found[drift] = along, across, list(np.array(shear) / shear[-1])
        print(f"\n{drift}: {', '.join(map(str, SPACINGS))} velocities on V = 7")
        for name, row in zip(("along", "across", "viscosity"), found[drift], strict=True):
            print(f"  {name:<10}", " ".join(f"{value:8.4f}" for value in row), flush=True)
    return found


def cooling_errors(d, points, half_widths, restitution, drift):
    """a_2 of the cooling state less that of theory, for several half widths."""
    (exact, *_), factor = cooling_state(d, restitution, ORDER)
    found = []
    for width in half_widths:
        try:
            found.append(cool(d, restitution, points, width, drift, factor, DECADES)[0] - exact)
        except NumericalFailure:
            found.append(np.nan)
    return found


def cooling_tables(dimensions):
    """Print and return {d: {drift: {points: a row of half widths for each restitution}}}."""
    tables = {}
    for d in dimensions:
        tables[d] = {}
        for drift, points in COOLING_POINTS[d].items():
            print(f"\nd = {d}, {drift}: e, a_2 less the exact one for half widths {COOLING_WIDTHS[d]}")
            tables[d][drift] = {}
            for n in points:
                rows, begin = [], time.perf_counter()
                for e in COOLING_RESTITUTIONS[d]:
                    rows.append(cooling_errors(d, n, COOLING_WIDTHS[d], e, drift))
                    print(f"  {n:<4} {e:<5}", " ".join(f"{value:9.5f}" for value in rows[-1]), flush=True)
                print(f"  {time.perf_counter() - begin:.1f} s", flush=True)
                tables[d][drift][n] = rows
    return tables


def wave(quantity, points, scaling, drift):
    """Conductivity or viscosity from a wave on these velocities."""
    return quantity(RELAXATION, CELLS, points, scaling, drift, 1.0, 7.0)


def operator_part(dimensions):
    """The operator's part of the data file."""
    tables = operator_tables(dimensions, 1)
    return {
        "half_widths": {d: HALF_WIDTHS[d] for d in tables},
        "boltzmann": {d: {n: rounded(rows, ".4g") for n, rows in table.items()} for d, table in tables.items()},
    }


def drift_part():
    """The drift's."""
    return {
        "spacings": [float(f"{14 / n:.6g}") for n in SPACINGS],
        "drift": {name: rounded(rows, ".4f") for name, rows in drift_table().items()},
    }


def cooling_part(dimensions):
    """The cooling states'; null where a run failed."""
    return {
        "exact_a2": {
            d: rounded([(e, cooling_state(d, e, ORDER)[0][0]) for e in THEORY_RESTITUTIONS], ".5f") for d in dimensions
        },
        "cooling_half_widths": {d: COOLING_WIDTHS[d] for d in dimensions},
        "cooling_restitutions": {d: COOLING_RESTITUTIONS[d] for d in dimensions},
        "cooling": {
            d: {drift: {n: rounded(rows, ".4f") for n, rows in table.items()} for drift, table in drifts.items()}
            for d, drifts in cooling_tables(dimensions).items()
        },
    }


def text_of(tables):
    """The data file that holds the tables: JSON, a row of a table on a line."""
    text = json.dumps(tables, indent=2, allow_nan=False)
    return re.sub(r"\[\s*([^][]*?)\s*\]", lambda row: f"[{' '.join(row[1].split())}]", text) + "\n"


def rounded(rows, digits):
    """Rows of numbers to so many digits; None for what is no number."""
    return [[float(f"{value:{digits}}") + 0.0 if np.isfinite(value) else None for value in row] for row in rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"write the tables into {TABLES.name}")
    parser.add_argument("--only", choices=("operator", "drift", "cooling"), help="this part alone")
    parser.add_argument("--exponent", type=int, choices=(0, 1), default=1, help="of the kernel [1]; 0: a few grids")
    options = parser.parse_args()
    if options.exponent == 0:
        operator_tables((2, 3), 0, {2: (16, 20, 21, 24, 32), 3: (16, 20, 21, 24)})
        return
    tables = json.loads(TABLES.read_text(encoding="utf-8"))
    if options.only in (None, "drift"):
        tables |= drift_part()
    if options.only in (None, "cooling"):
        tables |= cooling_part((2, 3))
    if options.only in (None, "operator"):
        tables |= operator_part((1, 2, 3))
    if options.write:
        TABLES.write_text(text_of(tables), encoding="utf-8")


if __name__ == "__main__":
    main()
