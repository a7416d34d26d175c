"""First marginals of the distribution: in scaled velocities (g over xi_x) and in classical ones (f over v_x).

Without space: curves, one for each time, several run directories in the same panels. With space: colour maps
over position and velocity, along the middle of the domain in two dimensions. Needs output.marginals = true in
the job. PNG and PDF into the first DIR's figures.

    python postprocess/marginals.py runs/test5_shock --times 0
"""

from __future__ import annotations

import sys

import common
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm
from profiles import middle_cut

STYLES = ("-", "--", ":", "-.")
DECADES = 4
VELOCITIES = 400


def main(argv=None) -> int:
    """Draw the first marginals of one or more run directories; the exit status."""
    return common.run_script(_draw, common.parser_for(__doc__, several=True), argv)


def classical(marginal, xi, omega, v):
    """Marginal of f on velocities v from that of g: f1(v) = g1(v / omega) / omega, zero outside g's grid.

    Parameters
    ----------
    marginal : (n, points) of n cells, on the nodes xi (points,)
    omega : (n,)
    v : (m,)

    Returns
    -------
    (n, m) array, linear between the nodes
    """
    rows = (np.interp(v / w, xi, g1, left=0.0, right=0.0) / w for g1, w in zip(marginal, omega, strict=True))
    return np.stack(list(rows))


def _draw(options):
    runs = [common.open_run(directory) for directory in options.directories]
    for directory, run in zip(options.directories, runs, strict=True):
        if "marginal_x" not in run:
            raise common.PlotError(
                f"{directory} holds no marginals: run the job with output.marginals = true"
            )
    if all(run.kinetic_density.ndim == 1 for run in runs):
        common.save(_curves(options, runs), options.directories[0], "marginals")
        return
    for directory, run in zip(options.directories, runs, strict=True):
        if run.kinetic_density.ndim == 1:
            raise common.PlotError(f"{directory} has no space dimension, another run has: draw them apart")
        common.save(_maps(run, common.choose_times(run, options.times, most=3)), directory, "marginals")


def _curves(options, runs):
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.8))
    for number, (directory, run) in enumerate(zip(options.directories, runs, strict=True)):
        style = STYLES[number % len(STYLES)]
        xi = run.xi_x.values
        for colour, index in enumerate(common.choose_times(run, options.times)):
            g1, omega = run.marginal_x.values[index], float(run.scaling_omega[index])
            name = common.time_label(float(run.time[index]))
            if len(runs) > 1:
                name += f", {directory.name}"
            left.plot(xi, g1, style, color=f"C{colour}", lw=1.3, label=name)
            right.plot(omega * xi, g1 / omega, style, color=f"C{colour}", lw=1.3, label=name)
    left.set_xlabel(r"$\xi_x$")
    left.set_ylabel(r"scaled variables: $g^{(1)}(\xi_x)$")
    right.set_xlabel("$v_x$")
    right.set_ylabel("classical variables: $f^{(1)}(v_x)$")
    right.set_yscale("log", nonpositive="mask")  # a g below zero is a gap, not a line down and up again
    top = right.dataLim.y1
    right.set_ylim(top * 10.0 ** -(DECADES + 2), 2 * top)
    if len(runs) > 1:  # below: beside the curves there is no room for so many names
        figure.legend(*left.get_legend_handles_labels(), loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=len(runs))
    else:
        for axis in (left, right):
            common.legend_below(axis, columns=3)
    figure.suptitle(common.titled("first marginals of g and of f", *runs))
    return figure


def _maps(run, chosen):
    """One row for each time: g over (x, xi_x) on the left, f over (x, v_x) on the right."""
    marginal, omega = run.marginal_x.values, run.scaling_omega.values
    if omega.ndim == 3:
        marginal = np.moveaxis(middle_cut(np.moveaxis(marginal, -1, 1), "x"), 1, -1)
        omega = middle_cut(omega, "x")
    x, xi = run.x.values, run.xi_x.values
    figure, axes = plt.subplots(
        len(chosen), 2, figsize=(8.6, 0.6 + 2.6 * len(chosen)), sharex=True, sharey="col", squeeze=False
    )
    widest = omega[chosen].max() * common.cell_edges(xi)[1]
    v = np.linspace(-widest, widest, VELOCITIES)
    f1 = [classical(marginal[index], xi, omega[index], v) for index in chosen]
    top = max(float(values.max()) for values in f1)
    scales = ({"vmin": 0.0, "vmax": float(marginal[chosen].max())}, {"norm": LogNorm(top / 10**DECADES, top)})
    for row, index in enumerate(chosen):
        maps = []
        for axis, velocity, values, scale in zip(
            axes[row], (xi, v), (marginal[index], f1[row]), scales, strict=True
        ):
            if "norm" in scale:
                values = np.maximum(values, scale["norm"].vmin)
            maps.append(axis.pcolormesh(x, velocity, values.T, shading="nearest", rasterized=True, **scale))
            axis.set_title(common.time_label(float(run.time[index])))
        axes[row, 0].set_ylabel(r"$\xi_x$")
        axes[row, 1].set_ylabel("$v_x$")
    for axis in axes[-1]:
        axis.set_xlabel("$x$")
    figure.colorbar(
        maps[0], ax=axes[:, 0], location="bottom", aspect=30, label=r"scaled: $g^{(1)}(x, \xi_x)$"
    )
    figure.colorbar(
        maps[1], ax=axes[:, 1], location="bottom", aspect=30, label="classical: $f^{(1)}(x, v_x)$"
    )
    figure.suptitle(common.titled(common.where_cut(run, "x", "first marginals"), run))
    return figure


if __name__ == "__main__":
    sys.exit(main())
