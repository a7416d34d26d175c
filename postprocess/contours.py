"""Maps of a run in two space dimensions, a colour for each cell: kinetic above fluid, one column for each time.

One figure each for density, the velocity components in the plane and temperature, and an overview of all of them at
the last time. Kinetic and fluid have colour limits of their own, unless --limits shared; --no-fluid or --no-kinetic
leaves one of them out. PNG and PDF into DIR/figures.

    python postprocess/contours.py runs/test4_clustering --times 0 0.25 1 5 10 30
"""

from __future__ import annotations

import sys

import common
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MaxNLocator

COLOURS = {"density": "viridis", "temperature": "cividis"}  # velocities: diverging, symmetric about zero


def main(argv=None) -> int:
    """Draw the maps of one run directory; the exit status."""
    parser = common.parser_for(__doc__)
    parser.add_argument(
        "--scale",
        choices=("auto", "shared", "per-time"),
        default="auto",
        help="colour limits over time: the same at all times, or others at each; by default the same, but where "
        "they would leave what is to be seen at some time in a tenth of the colours",
    )
    parser.add_argument(
        "--limits",
        choices=("own", "shared"),
        default="own",
        help="colour limits of kinetic and fluid: each its own, or the same for both",
    )
    alone = parser.add_mutually_exclusive_group()
    alone.add_argument("--no-fluid", action="store_true", help="the kinetic solution alone")
    alone.add_argument("--no-kinetic", action="store_true", help="the fluid alone")
    return common.run_script(_draw, parser, argv)


def _draw(options):
    run = common.open_run(options.directory)
    if run.kinetic_density.ndim != 3:
        other = "profiles.py" if run.kinetic_density.ndim == 2 else "history.py or marginals.py"
        raise common.PlotError(
            f"{options.directory} has {run.kinetic_density.ndim - 1} space dimensions: use {other}"
        )
    models = [model for model in common.models(run) if not getattr(options, f"no_{model}")]
    if not models:
        raise common.PlotError(f"{options.directory} holds no fluid: nothing is left without the kinetic solution")
    chosen = common.choose_times(run, options.times)
    own = options.limits == "own"
    for quantity, label in common.quantities(run).items():
        figure = _by_time(run, quantity, label, chosen, options.scale, models, own)
        common.save(figure, options.directory, f"contours_{quantity}")
    common.save(_overview(run, chosen[-1], models, own), options.directory, "contours_last")


def _by_time(run, quantity, label, chosen, scale, models, own=True):
    """Times from left to right, one row for each model; a colour bar for all panels that share their limits."""
    fields = np.stack([common.field(run, model, quantity)[chosen] for model in models])
    units = np.stack([common.unit(run, model, quantity)[chosen] for model in models])
    rows = _together(len(models), not own)
    if scale == "auto":
        scale = "per-time" if any(_fades(quantity, fields[some], units[some]) for some in rows) else "shared"
    figure, axes = _panels(run, models, len(chosen), bars_below=len(rows) if scale == "per-time" else 0)
    for some_rows in rows:
        for some_columns in _together(len(chosen), scale == "shared"):
            part = np.ix_(some_rows, some_columns)
            drawn = _maps(axes[part], run, fields[part], quantity, units[part].max())
            if scale == "per-time":
                _colour_bar(figure, drawn, axes[part], "", below=True)
            else:
                _colour_bar(figure, drawn, axes[part], label if len(rows) == 1 else f"{models[some_rows[0]]} {label}")
    for axis, index in zip(axes[0], chosen):
        axis.set_title(common.time_label(float(run.time[index])))
    figure.suptitle(common.titled(label, run))
    return figure


def _together(count, shared):
    """Numbers of the rows or columns that share their limits: all of them, or each its own."""
    return [list(range(count))] if shared else [[number] for number in range(count)]


def _fades(quantity, fields, units):
    """Whether limits for all times would leave what varies at one of them in a tenth of the colours."""
    low, high = _limits(quantity, fields, units.max())
    varies = np.ptp(fields, axis=(0, -2, -1))
    return bool(((varies > common.ROUNDING * units.max(axis=0)) & (varies < 0.1 * (high - low))).any())


def _overview(run, index, models, own=True):
    """All quantities at one time from left to right, one row for each model."""
    names = common.quantities(run)
    rows = _together(len(models), not own)
    figure, axes = _panels(run, models, len(names), bars_below=len(rows))
    for column, (quantity, label) in enumerate(names.items()):
        for some in rows:
            fields = np.stack([common.field(run, models[row], quantity)[index] for row in some])
            unit = max(common.unit(run, models[row], quantity)[index] for row in some)
            drawn = _maps(axes[some, column], run, fields, quantity, unit)
            _colour_bar(figure, drawn, axes[some, column], "", below=True)
        axes[0, column].set_title(label)
    figure.suptitle(common.titled(common.time_label(float(run.time[index])), run))
    return figure


def _panels(run, models, columns, bars_below):
    """A grid of panels of the domain's shape, labelled on the outside only; room for so many rows of bars below."""
    (left, right), (bottom, top) = common.cell_edges(run.x.values), common.cell_edges(run.y.values)
    shape = (top - bottom) / (right - left)
    width = min(max(11.0 / columns, 1.9), 3.2)
    rows = len(models)
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
    for axis, model in zip(axes[:, 0], models, strict=True):
        axis.set_ylabel(f"{model}\n$y$" if rows > 1 or model == "fluid" else "$y$")
    return figure, axes


def _limits(quantity, fields, unit):
    """Colour limits of all these fields: symmetric about zero for velocities, never empty."""
    low, high = float(np.min(fields)), float(np.max(fields))
    if not np.isfinite([low, high]).all():
        raise common.PlotError(f"the {quantity} is not finite everywhere")
    if quantity.startswith("velocity"):
        largest = max(-low, high)
        return (-largest, largest) if largest > common.ROUNDING * unit else (-(unit or 1.0), unit or 1.0)
    if high - low <= common.ROUNDING * unit:
        middle = (low + high) / 2
        margin = 0.05 * abs(middle) or 1.0
        return middle - margin, middle + margin
    return low, high


def _maps(axes, run, fields, quantity, unit):
    """A colour for each cell, in panels (any shape) with the same limits; fields of that shape and (y, x)."""
    low, high = _limits(quantity, fields, unit)
    for axis, values in zip(axes.flat, fields.reshape(-1, *fields.shape[-2:]), strict=True):
        drawn = axis.pcolormesh(
            run.x.values, run.y.values, values, shading="nearest", vmin=low, vmax=high,
            cmap=COLOURS.get(quantity, "RdBu_r"), rasterized=True,
        )  # fmt: skip
    return drawn


def _colour_bar(figure, drawn, axes, label, below=False):
    where = {"location": "bottom", "aspect": 18, "pad": 0.02} if below else {"aspect": 30, "pad": 0.01}
    bar = figure.colorbar(drawn, ax=axes, shrink=0.95, **where)
    bar.ax.minorticks_off()
    bar.locator = MaxNLocator(4 if below else 7)
    bar.update_ticks()
    bar.set_label(label)


if __name__ == "__main__":
    sys.exit(main())
