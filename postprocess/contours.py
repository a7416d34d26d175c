"""Contour plots of a run in two space dimensions: kinetic above fluid, one column for each time.

One figure each for density, the velocity components in the plane and temperature, the same colour limits in
both rows, and an overview of all of them at the last time. PNG and PDF into DIR/figures.

    python postprocess/contours.py runs/test4_clustering --times 0 0.25 1 5 10 30
"""

from __future__ import annotations

import sys

import common
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MaxNLocator

BANDS = 33  # odd, so that velocities about zero are white
COLOURS = {"density": "viridis", "temperature": "cividis"}  # velocities: diverging, symmetric about zero


def main(argv=None) -> int:
    """Draw the contour plots of one run directory; the exit status."""
    parser = common.parser_for(__doc__)
    parser.add_argument(
        "--scale",
        choices=("shared", "per-time"),
        default="shared",
        help="colour limits: the same at all times, or one pair of limits and one colour bar for each time",
    )
    return common.run_script(_draw, parser, argv)


def _draw(options):
    run = common.open_run(options.directory)
    if run.kinetic_density.ndim != 3:
        other = "profiles.py" if run.kinetic_density.ndim == 2 else "history.py or marginals.py"
        raise common.PlotError(
            f"{options.directory} has {run.kinetic_density.ndim - 1} space dimensions: use {other}"
        )
    chosen = common.choose_times(run, options.times)
    for quantity, label in common.quantities(run).items():
        figure = _by_time(run, quantity, label, chosen, options.scale)
        common.save(figure, options.directory, f"contours_{quantity}")
    common.save(_overview(run, chosen[-1]), options.directory, "contours_last")


def _by_time(run, quantity, label, chosen, scale):
    """Times from left to right, kinetic above fluid."""
    fields = {model: common.field(run, model, quantity)[chosen] for model in common.models(run)}
    figure, axes = _panels(run, len(fields), len(chosen), bars_below=scale == "per-time")
    shared = _limits(quantity, *fields.values())
    for column, index in enumerate(chosen):
        here = _limits(quantity, *(values[column] for values in fields.values()))
        for row, values in enumerate(fields.values()):
            drawn = _contours(
                axes[row, column], run, values[column], quantity, here if scale == "per-time" else shared
            )
        axes[0, column].set_title(common.time_label(float(run.time[index])))
        if scale == "per-time":
            _colour_bar(figure, drawn, axes[:, column], "", below=True)
    if scale == "shared":
        _colour_bar(figure, drawn, axes, label)
        _hint(quantity, fields, shared)
    figure.suptitle(f"{common.title_of(run)} – {label}")
    return figure


def _overview(run, index):
    """All quantities at one time from left to right, kinetic above fluid, one colour bar for each pair."""
    names = common.quantities(run)
    models = common.models(run)
    figure, axes = _panels(run, len(models), len(names), bars_below=True)
    for column, (quantity, label) in enumerate(names.items()):
        fields = [common.field(run, model, quantity)[index] for model in models]
        limits = _limits(quantity, *fields)
        for row, values in enumerate(fields):
            drawn = _contours(axes[row, column], run, values, quantity, limits)
        axes[0, column].set_title(label)
        _colour_bar(figure, drawn, axes[:, column], "", below=True)
    figure.suptitle(f"{common.title_of(run)} – {common.time_label(float(run.time[index]))}")
    return figure


def _panels(run, rows, columns, bars_below):
    """A grid of panels of the domain's shape, labelled on the outside only."""
    (left, right), (bottom, top) = common.cell_edges(run.x.values), common.cell_edges(run.y.values)
    shape = (top - bottom) / (right - left)
    width = min(max(11.0 / columns, 1.9), 3.2)
    size = (columns * width + 1.3, rows * (width * shape + 0.15) + 0.9 + 0.6 * bars_below)
    figure, axes = plt.subplots(
        rows, columns, figsize=size, sharex=True, sharey=True, squeeze=False, **common.COMPRESSED
    )
    for axis in axes.flat:
        axis.set_aspect("equal")
        axis.set_xlim(left, right)
        axis.set_ylim(bottom, top)
        axis.xaxis.set_major_locator(MaxNLocator(4, prune="upper"))
        axis.yaxis.set_major_locator(MaxNLocator(4))
    for axis in axes[-1]:
        axis.set_xlabel("$x$")
    for axis, model in zip(axes[:, 0], common.models(run), strict=True):
        axis.set_ylabel(f"{model}\n$y$" if rows > 1 else "$y$")
    return figure, axes


def _limits(quantity, *fields):
    """Colour limits of all these fields: symmetric about zero for velocities, never empty."""
    low = min(float(np.min(values)) for values in fields)
    high = max(float(np.max(values)) for values in fields)
    if quantity.startswith("velocity"):
        largest = max(-low, high)
        low, high = (-largest, largest) if largest > 1e-12 else (-1.0, 1.0)
    if not np.isfinite([low, high]).all():
        raise common.PlotError(f"the {quantity} is not finite everywhere")
    middle = (low + high) / 2
    if high - low <= 1e-10 * abs(middle):
        margin = 0.05 * abs(middle) or 1.0
        return middle - margin, middle + margin
    return low, high


def _contours(axis, run, values, quantity, limits):
    """Filled contours up to the edges of the domain, where the outermost cells' values are carried on."""
    x, y = (
        np.concatenate([[edges[0]], centres, [edges[1]]])
        for centres, edges in (
            (run.x.values, common.cell_edges(run.x.values)),
            (run.y.values, common.cell_edges(run.y.values)),
        )
    )
    drawn = axis.contourf(
        x,
        y,
        np.pad(values, 1, mode="edge"),
        levels=np.linspace(*limits, BANDS + 1),
        cmap=COLOURS.get(quantity, "RdBu_r"),
        zorder=-10,
    )
    axis.set_rasterization_zorder(0)  # thousands of polygons as one picture, so that the PDF stays small
    return drawn


def _colour_bar(figure, drawn, axes, label, below=False):
    where = {"location": "bottom", "aspect": 18, "pad": 0.02} if below else {"aspect": 30, "pad": 0.01}
    bar = figure.colorbar(drawn, ax=axes, shrink=0.95, **where)
    bar.ax.minorticks_off()
    if bar.solids is not None:
        bar.solids.set_edgecolor("face")  # no white lines between the bands in PDF viewers
    bar.locator = MaxNLocator(4 if below else 7)
    bar.update_ticks()
    bar.set_label(label)


def _hint(quantity, fields, shared):
    """Say so if the shared limits leave the last time in hardly more than one colour."""
    for model, values in fields.items():
        part = np.ptp(values[-1]) / (shared[1] - shared[0])
        if len(values) > 1 and np.ptp(values) > 0 and part < 0.1:
            print(f"# {quantity}, {model}: the last time has {part:.1%} of the colours; see --scale per-time")


if __name__ == "__main__":
    sys.exit(main())
