"""Orders in time and of free transport, and Haff's law: `python benchmarks/order.py` (some minutes)."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests.verification import free_transport, time_order
from tests.verification.kinetic_cases import orders, table


def rows_of(sizes, errors):
    """Errors beside the orders from the line above."""
    rates = [[float("nan")] * len(errors[0]), *orders(errors).tolist()]
    return [(int(n), *e, *r) for n, e, r in zip(sizes, errors, rates)]


def main() -> None:
    for name, knudsen in (("1", lambda dt: 1.0), ("dt", lambda dt: dt), ("1e-6", lambda dt: 1e-6)):
        for scaling, drift, points in (
            ("none", "van-leer", 24), ("kinetic", "seventh-order", 48), ("kinetic", "van-leer", 24),
        ):  # fmt: skip
            steps = (40, 80, 160, 320)
            found = time_order.errors(knudsen, steps, 2560, points=[points], scaling=scaling, drift=drift)
            print(f"order in time, eps = {name}, {scaling}, {drift}, {points} velocities")
            table("steps density temperature heat_flux o(density) o(temperature) o(heat_flux)", rows_of(steps, found))
    for scaling, conservative in (
        ("none", False), ("macroscopic", False), ("macroscopic", True), ("kinetic", True),
    ):  # fmt: skip
        cells = (32, 64, 128, 256)
        found = [free_transport.errors(n, n // 2, scaling, conservative)[0] for n in cells]
        print(f"free transport, {scaling}, conservative {conservative}, half as many velocities as cells")
        table("cells density velocity temperature o(density) o(velocity) o(temperature)", rows_of(cells, found))


if __name__ == "__main__":
    main()
