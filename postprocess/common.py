"""What the plotting scripts share: reading runs, choosing times, saving figures, errors in one line."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:  # a checkout works without installing the package
    sys.path.append(str(ROOT))

from rvm_mpi import results  # noqa: E402
from rvm_mpi.job.job import Job, JobError  # noqa: E402

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_COLUMNS = 6
# panels of fixed aspect move together where matplotlib can do that (3.6)
COMPRESSED = {"layout": "compressed"} if hasattr(plt.Figure, "set_layout_engine") else {}
ROUNDING = 1e-10
"""What varies by less than this times its unit is drawn as a constant."""
FLUID = {"color": "tab:orange", "linestyle": "--"}
KINETIC = {"color": "tab:blue", "linestyle": "-"}

plt.rcParams.update(
    {
        "figure.constrained_layout.use": True,
        "font.size": 9.0,
        "axes.titlesize": 9.0,
        "axes.formatter.limits": (-3, 4),
        "axes.formatter.use_mathtext": True,
        "image.cmap": "viridis",
        "legend.frameon": False,
        "savefig.dpi": 200,
    }
)


class PlotError(Exception):
    """What was asked for cannot be drawn; the text is the one line to show."""


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that says in one line, too, what is wrong with the arguments."""

    def error(self, message: str) -> NoReturn:
        """Leave with status 2 and a line."""
        self.exit(2, f"{self.prog}: {message} (--help lists the options)\n")


def run_script(draw: Callable[[argparse.Namespace], None], parser: argparse.ArgumentParser, argv) -> int:
    """Parse the arguments and draw; 0 when done, 2 with one line on stderr when it cannot be done."""
    options = parser.parse_args(argv)
    try:
        draw(options)
    except (PlotError, JobError, OSError, ValueError, KeyError) as error:
        print(f"{parser.prog}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    finally:
        plt.close("all")
    return 0


def parser_for(doc: str, several: bool = False, times: bool = True) -> argparse.ArgumentParser:
    """The arguments all scripts have: the run directory or directories, and which times."""
    parser = Parser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    if several:
        parser.add_argument("directories", metavar="DIR", nargs="+", type=Path, help="run directories")
    else:
        parser.add_argument("directory", metavar="DIR", type=Path, help="run directory")
    if times:
        parser.add_argument("--times", nargs="+", type=float, metavar="T", help="stored times to draw")
    return parser


def open_run(directory: Path) -> xarray.Dataset:
    """The snapshots of a run.

    Raises
    ------
    PlotError : the run has none yet.
    FileNotFoundError : it is not a run directory.
    """
    run = results.open_run(directory)
    if run.sizes["time"] == 0:
        raise PlotError(f"{directory} has no snapshot yet")
    return run


def choose_times(run: xarray.Dataset, wanted: Sequence[float] | None, most: int = MOST_COLUMNS) -> list[int]:
    """Indices of the snapshots to draw: those wanted, or all, or evenly chosen ones if there are too many.

    Raises
    ------
    PlotError : a wanted time is not stored.
    """
    stored = run.time.values
    if wanted is None:
        if len(stored) <= most:
            return list(range(len(stored)))
        return [round(i) for i in np.linspace(0, len(stored) - 1, most)]
    chosen = []
    for time in wanted:
        nearest = int(np.argmin(np.abs(stored - time)))
        if abs(stored[nearest] - time) > 1e-6 * max(abs(time), stored.max() * 1e-3):
            raise PlotError(f"no snapshot at t = {time:g}; stored are {', '.join(f'{t:g}' for t in stored)}")
        chosen.append(nearest)
    return chosen


def time_label(time: float) -> str:
    """Such as "t = 0.25"."""
    return f"$t = {time:g}$"


def quantities(run: xarray.Dataset) -> dict[str, str]:
    """What can be drawn of a spatial run, with labels: density, velocities in the plane, temperature."""
    in_plane = min(run.kinetic_density.ndim - 1, run.sizes["component"])
    velocities = {f"velocity_{axis}": rf"velocity $u_{axis}$" for axis in "xy"[:in_plane]}
    return {"density": r"density $\rho$", **velocities, "temperature": r"temperature $T$"}


def field(run: xarray.Dataset, model: str, quantity: str) -> np.ndarray:
    """One quantity of "kinetic" or "fluid" at all stored times, shape (time, y, x) or (time, x)."""
    if quantity.startswith("velocity_"):
        return run[f"{model}_velocity"].sel(component=quantity[-1]).values
    return run[f"{model}_{quantity}"].values


def unit(run: xarray.Dataset, model: str, quantity: str) -> np.ndarray:
    """What a quantity is small against if it is nought, at each stored time: of a velocity the thermal speed."""
    values = field(run, model, quantity)
    if quantity.startswith("velocity"):
        values = np.sqrt(np.maximum(field(run, model, "temperature"), 0.0))
    return np.abs(values).max(axis=tuple(range(1, values.ndim)))


def models(run: xarray.Dataset) -> list[str]:
    """Which solutions the run holds: "kinetic", and "fluid" if it is there."""
    return ["kinetic", "fluid"] if "fluid_density" in run else ["kinetic"]


def cell_edges(centres: np.ndarray) -> tuple[float, float]:
    """Where the domain begins and ends, from uniform cell centres."""
    half = (centres[-1] - centres[0]) / (len(centres) - 1) / 2 if len(centres) > 1 else 0.5
    return float(centres[0] - half), float(centres[-1] + half)


def title_of(*runs: xarray.Dataset | Job) -> str:
    """The job's title, of several runs what theirs share up to a colon, safe for matplotlib's mathematics."""
    titles = (run.title if isinstance(run, Job) else str(run.attrs.get("title", "")) for run in runs)
    parts = zip(*(title.split(":") for title in titles))
    return ":".join(part[0] for part in takewhile(lambda part: len(set(part)) == 1, parts)).replace("$", r"\$")


def titled(what: str, *runs: xarray.Dataset | Job) -> str:
    """The title of a figure: the job's, and what is shown of it."""
    return " – ".join(part for part in (title_of(*runs), what) if part)


def where_cut(run: xarray.Dataset, along: str, what: str) -> str:
    """What is shown, and of two space dimensions where the cut lies that it is shown along."""
    if run.kinetic_density.ndim < 3:
        return what
    other = "y" if along == "x" else "x"
    return f"{what} along ${along}$ at ${other} = {np.mean(cell_edges(run[other].values)):g}$"


def legend_below(axis: Axes, columns: int = 2, **more: Any):
    """A legend under an axis and its label, where no curve can run through it."""
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncol=columns, **more)


def save(figure: Figure, directory: Path, name: str):
    """Write NAME.png and NAME.pdf into DIR/figures, and print the paths."""
    folder = (directory if directory.is_dir() else directory.parent) / "figures"
    folder.mkdir(exist_ok=True)
    figure.draw_without_rendering()  # lays out and measures once, not once for each file
    box = figure.get_tightbbox(figure.canvas.get_renderer()).padded(0.08)
    for suffix in ("png", "pdf"):
        path = folder / f"{name}.{suffix}"
        if hasattr(figure, "set_layout_engine"):  # each time: saving switches it on again
            figure.set_layout_engine("none")
        else:
            figure.set_constrained_layout(False)
        figure.savefig(path, bbox_inches=box)
        print(path)
    plt.close(figure)
