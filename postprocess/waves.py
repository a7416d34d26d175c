"""Test 2: energy against Haff's law, and how the density tends to its mean, of one or several runs.

Two figures into the first DIR's figures, as PNG and PDF: waves_energy (energy over that of the start) and
waves_deviation (L(t), the mean of |rho - mean rho|, in log-log, with the line through its maxima), and a table of the
damping rates, L ~ t^rate, with the paper's where it has one. Maxima below --floor, and from the first on that does
not fall, are left out of the fit: there the scheme's own error shows. Runs without space, and those whose density stays
uniform, have no waves and are refused.

    python postprocess/waves.py runs/test2_specular_e080 runs/test2_specular_e090
"""

from __future__ import annotations

import sys

import common
import matplotlib.pyplot as plt
import numpy as np
from history import haff

from rvm_mpi import results
from rvm_mpi.job.job import Job

PAPER = {0.8: -1.05, 0.85: -1.4, 0.9: -2.05, 0.95: -4.1}
FLOOR = 5e-5


def main(argv=None) -> int:
    """Draw the waves of one or more run directories; the exit status."""
    parser = common.parser_for(__doc__, several=True, times=False)
    parser.add_argument("--labels", nargs="+", metavar="TEXT", help="names in the legends, by default the directories'")
    parser.add_argument("--floor", type=float, default=FLOOR, help="fit no maximum of L below this (%(default)g)")
    return common.run_script(_draw, parser, argv)


def maxima(time, values):
    """Times and heights of the local maxima between the ends, by the parabola through three points."""
    k = np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:])) + 1
    before, top, after = values[k - 1], values[k], values[k + 1]
    shift = 0.5 * (before - after) / (before - 2 * top + after)
    place = np.interp(k + shift, np.arange(len(time)), time)
    return place, top - 0.25 * (before - after) * shift


def damping(time, values, floor=FLOOR):
    """Rate and period of decaying oscillations in log t, from the maxima of |oscillation| above the floor.

    Returns
    -------
    (rate, period, times, fit at these times) : the period is twice the mean distance of the maxima in log t; None
    with fewer than two maxima above the floor. The first maximum that is higher than the one before ends them too.
    """
    place, height = maxima(time, values)
    lost = (height < floor) | (np.diff(height, prepend=np.inf) >= 0)
    count = int(np.argmax(lost)) if lost.any() else len(place)
    if count < 2:
        return None
    x, y = np.log(place[:count]), np.log(height[:count])
    rate, constant = np.polyfit(x, y, 1)
    return float(rate), 2 * float(x[-1] - x[0]) / (count - 1), place[:count], np.exp(constant + rate * x)


def _draw(options):
    names = options.labels or [directory.name for directory in options.directories]
    if len(names) != len(options.directories):
        raise common.PlotError(f"{len(names)} labels for {len(options.directories)} runs")
    runs = []
    for directory in options.directories:
        job, history = Job.from_file(directory / "job.toml"), results.read_history(directory)
        _refuse_without_waves(directory, job, history)
        runs.append((job, history))
    common.save(_energy(runs, names), options.directories[0], "waves_energy")
    fits = [damping(history["time"], history["density_deviation"], options.floor) for _, history in runs]
    common.save(_deviation(runs, names, fits), options.directories[0], "waves_deviation")
    for line in table(runs, names, fits):
        print(line)


def _refuse_without_waves(directory, job, history):
    """PlotError if a run's history has no L(t) to draw."""
    if not job.space.dimensions:
        raise common.PlotError(f"{directory} has no space dimension, so no waves: use history.py")
    if "density_deviation" not in history:
        raise common.PlotError(f"{directory}/history.csv has no density_deviation")
    if len(history["time"]) < 3:
        raise common.PlotError(f"{directory}/history.csv has fewer than three rows")
    deviation, density = history["density_deviation"], history["mass"][0] / np.prod(job.space.length)
    if not np.isfinite(deviation).all():
        raise common.PlotError(f"{directory}/history.csv: density_deviation is not a number in some row")
    if deviation.max() <= common.ROUNDING * density:
        raise common.PlotError(f"{directory}: the density stays uniform, there are no waves: use history.py")


def table(runs, names, fits):
    """Lines of text: a run's restitution coefficient, rate, the paper's, period."""
    yield f"# {'run':24s} {'e':>5s} {'maxima':>6s} {'rate':>7s} {'paper':>6s} {'period in log t':>15s}"
    for (job, _), name, fit in zip(runs, names, fits, strict=True):
        e = job.collision.restitution
        paper = f"{PAPER[e]:.2f}" if e in PAPER else "-"
        found = f"{len(fit[2]):6d} {fit[0]:7.3f} {paper:>6s} {fit[1]:15.3f}" if fit else f"{'none fitted':>14s}"
        yield f"# {name:24s} {e or 1.0:5.2f} {found}"


def _energy(runs, names):
    figure, axis = plt.subplots(figsize=(5.6, 4.4))
    last = max(history["time"][-1] for _, history in runs)
    first = min(history["time"][1] for _, history in runs)
    shown = np.geomspace(max(first, 1e-3 * last), last, 200)
    laws = set()
    for number, ((job, history), name) in enumerate(zip(runs, names, strict=True)):
        axis.plot(history["time"], history["energy"] / history["energy"][0], color=f"C{number}", label=name)
        cooling, density = job.collision.cooling, history["mass"][0] / np.prod(job.space.length)
        if cooling > 0 and (cooling, density) not in laws:
            law = haff(shown, history["mean_temperature"][0], density, cooling) / history["mean_temperature"][0]
            axis.plot(shown, law, color="black", ls=":", lw=1, label=None if laws else "Haff's law")
            laws.add((cooling, density))
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlim(shown[0], last)
    axis.set_xlabel("$t$")
    axis.set_ylabel("$E(t) / E(0)$")
    common.legend_below(axis)
    axis.set_title(common.titled("energy", *(job for job, _ in runs)))
    return figure


def _deviation(runs, names, fits):
    figure, axis = plt.subplots(figsize=(5.6, 4.4))
    last, least, top = 0.0, np.inf, 0.0
    for number, ((_, history), name, fit) in enumerate(zip(runs, names, fits, strict=True)):
        time, values = history["time"][1:], history["density_deviation"][1:]
        label = name if fit is None else f"{name}: $t^{{{fit[0]:.2f}}}$"
        axis.plot(time, values, color=f"C{number}", lw=1.2, label=label)
        if fit is not None:
            axis.plot(fit[2], fit[3], color=f"C{number}", marker="o", ms=3, ls=":", lw=1)
        last, least = max(last, time[-1]), min(least, np.percentile(values[values > 0], 2))
        top = max(top, values[0])
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlim(1e-3 * last, last)
    axis.set_ylim(0.3 * least, 2 * top)
    axis.set_xlabel("$t$")
    axis.set_ylabel(r"$\mathcal{L}(t)$: mean of $|\rho - \overline{\rho}|$")
    common.legend_below(axis)
    axis.set_title(common.titled("deviation of the density", *(job for job, _ in runs)))
    return figure


if __name__ == "__main__":
    sys.exit(main())
