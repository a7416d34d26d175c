"""Profiles of density, velocity and temperature in space, kinetic and fluid, one column for each time.

One space dimension, or two along a cut through the middle of the domain (--cut). Several run directories are
drawn into the same panels. PNG and PDF into the first DIR's figures.

    python postprocess/profiles.py runs/test3 --normalised --times 0.25 0.75 2
"""

from __future__ import annotations

import sys

import common
import matplotlib.pyplot as plt
import numpy as np

#: solid for the kinetic curve, dashes for the fluid's
STYLES = {"kinetic": "-", "fluid": "--"}
#: points: width of the last curve, and by how much wider each earlier one is: of equal curves both show
NARROWEST, WIDER = 1.3, 2.0


def main(argv=None) -> int:
    """Draw the profiles of one or more run directories; the exit status."""
    parser = common.parser_for(__doc__, several=True)
    parser.add_argument("--cut", choices=("x", "y"), default="x", help="direction of the cut through 2D runs")
    parser.add_argument(
        "--normalised", action="store_true", help="density and temperature divided by their mean over space"
    )
    parser.add_argument(
        "--no-fluid", action="store_true", help="without the fluid, where it is so far off that it hides the rest"
    )
    return common.run_script(_draw, parser, argv)


def middle_cut(values, along):
    """Cut fields (..., y, x) through the middle, along "x" or "y"; even numbers of rows: the mean of two."""
    axis = -2 if along == "x" else -1
    n = values.shape[axis]
    return np.take(values, range((n - 1) // 2, n // 2 + 1), axis=axis).mean(axis=axis)


def profile(run, model, quantity, along="x", normalised=False):
    """One quantity at all stored times along a line, shape (time, n)."""
    values = common.field(run, model, quantity)
    if normalised and not quantity.startswith("velocity"):
        cells = tuple(range(1, values.ndim))
        values = values / values.mean(axis=cells, keepdims=True)
    return middle_cut(values, along) if values.ndim == 3 else values


def _draw(options):
    runs = [common.open_run(directory) for directory in options.directories]
    for directory, run in zip(options.directories, runs, strict=True):
        if run.kinetic_density.ndim == 1:
            raise common.PlotError(f"{directory} has no space dimension: use history.py or marginals.py")
    first = runs[0]
    chosen = common.choose_times(first, options.times)
    times = first.time.values[chosen]
    labels = common.quantities(first)
    width = min(max(11.0 / len(chosen), 2.0), 4.0)
    figure, axes = plt.subplots(
        len(labels),
        len(chosen),
        figsize=(1.0 + width * len(chosen), 0.8 + 1.8 * len(labels)),
        sharex=True,
        squeeze=False,
    )
    for number, (directory, run) in enumerate(zip(options.directories, runs, strict=True)):
        models = ["kinetic"] if options.no_fluid else common.models(run)
        along = options.cut if run.kinetic_density.ndim == 3 else "x"
        for row, quantity in enumerate(labels):
            for model in models:
                values = profile(run, model, quantity, along, options.normalised)
                name = model if len(runs) == 1 else directory.name + ("" if options.no_fluid else f", {model}")
                colour = f"C{number}" if len(runs) > 1 else f"C{list(STYLES).index(model)}"
                style = {"ls": STYLES[model], "lw": NARROWEST + WIDER * (len(runs) - 1 - number), "color": colour}
                for column, index in enumerate(common.choose_times(run, times)):
                    axes[row, column].plot(run[along], values[index], label=name, **style)
    _finish(figure, axes, runs, labels, times, options)
    common.save(figure, options.directories[0], "profiles")


def _finish(figure, axes, runs, labels, times, options):
    run = runs[0]
    cut = options.cut if run.kinetic_density.ndim == 3 else "x"
    for column, time in enumerate(times):
        axes[0, column].set_title(common.time_label(float(time)))
        axes[-1, column].set_xlabel(f"${cut}$")
        axes[-1, column].set_xlim(*common.cell_edges(run[cut].values))
    for row, (quantity, label) in enumerate(labels.items()):
        if options.normalised and not quantity.startswith("velocity"):
            label += " / mean"
        axes[row, 0].set_ylabel(label)
        unit = 1.0
        if not options.normalised or quantity.startswith("velocity"):
            unit = max(common.unit(run, model, quantity).max() for run in runs for model in common.models(run))
        for axis in axes[row]:
            lines = np.concatenate([line.get_ydata() for line in axis.get_lines()])
            spread, middle = np.ptp(lines), (lines.max() + lines.min()) / 2
            if spread <= common.ROUNDING * unit:  # a constant, not its last bits
                margin = 0.05 * max(abs(middle), unit) or 1.0
                axis.set_ylim(middle - margin, middle + margin)
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=4)
    figure.suptitle(common.titled(common.where_cut(run, cut, "profiles"), *runs))


if __name__ == "__main__":
    sys.exit(main())
