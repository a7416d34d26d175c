"""How a run went: cooling beside Haff's law, the density's deviation from uniform, the health of the numbers.

Three figures into DIR/figures, as PNG and PDF: history_cooling (mean temperature and energy; where the gas cools by
Haff's law, the temperature beside it, and both over it), history_density (variance of the density, and its L1
deviation from the mean with the fitted rate of damping in log t), and history_health (errors of mass, momentum and
energy, smallest g, size of the correction).

    python postprocess/history.py runs/test4_clustering
"""

from __future__ import annotations

import sys

import common
import matplotlib.pyplot as plt
import numpy as np

from rvm_mpi import results
from rvm_mpi.job.job import Job

FEWEST_FOR_A_FIT = 6
NOUGHT = 1e-17
"""Errors below this, zero among them, are drawn here on a logarithmic axis."""


def main(argv=None) -> int:
    """Draw the history of one run directory; the exit status."""
    return common.run_script(_draw, common.parser_for(__doc__, times=False), argv)


def haff(time, temperature, density, cooling):
    """Haff's law: T0 / (1 + cooling rho sqrt(T0) t)^2, the homogeneous gas in the Maxwellian closure."""
    return temperature / (1 + cooling * density * np.sqrt(temperature) * np.asarray(time)) ** 2


def mean_temperature(run, model):
    """Sum of rho T over sum of rho, at all stored times."""
    density, temperature = run[f"{model}_density"].values, run[f"{model}_temperature"].values
    cells = tuple(range(1, density.ndim))
    return (density * temperature).sum(cells) / density.sum(cells)


def variance(run, model):
    """Variance of the density over the domain, at all stored times."""
    density = run[f"{model}_density"].values
    return density.var(axis=tuple(range(1, density.ndim)))


def deviation(run, model):
    """Mean over the domain of |rho - mean rho| at the first time: the L1 norm on a domain of unit volume."""
    density = run[f"{model}_density"].values
    return np.abs(density - density[0].mean()).mean(axis=tuple(range(1, density.ndim)))


def damping_rate(time, values):
    """Fit values ~ time^rate: on the maxima where it oscillates, else on all positive times.

    Parameters
    ----------
    time, values : (n,) arrays

    Returns
    -------
    rate, fitted times, fit at these times; or None where that makes no sense: fewer than six points in all, a
    decrease by less than a factor of two, or points that a power of time does not describe (R^2 below 0.8).
    """
    use = (time > 0) & (values > 0)
    time, values = time[use], values[use]
    if len(time) < FEWEST_FOR_A_FIT:
        return None
    inner = values[1:-1]
    peaks = np.flatnonzero((inner > values[:-2]) & (inner >= values[2:])) + 1
    if len(peaks) >= 3:
        time, values = time[peaks], values[peaks]
    if values[-1] > values[0] / 2:
        return None
    x, y = np.log(time), np.log(values)
    rate, constant = np.polyfit(x, y, 1)
    misfit = y - (constant + rate * x)
    if 1 - misfit.var() / y.var() < 0.8:
        return None
    return float(rate), time, np.exp(constant) * time**rate


def mass_error(history):
    """Relative change of the mass beyond what has entered through the sides since the start.

    What has entered is in the columns whose names begin with entered_mass.
    """
    entered = sum(values for name, values in history.items() if name.startswith("entered_mass"))
    return (history["mass"] - history["mass"][0] - entered) / history["mass"][0]


def errors(history):
    """Relative errors of mass, momentum and energy at each step, as far as the history has them."""
    found = {"mass": mass_error(history)}
    for name in ("momentum", "energy"):
        if _is_there(history, f"{name}_error"):
            found[name] = history[f"{name}_error"]
    return found


def _is_there(history, name):
    return name in history and bool(np.isfinite(history[name]).all())


def _draw(options):
    directory = options.directory
    run = common.open_run(directory)
    folder = directory if directory.is_dir() else directory.parent
    job = Job.from_file(folder / "job.toml")
    history = results.read_history(folder)
    if len(history["time"]) < 2:
        raise common.PlotError(f"{folder}/history.csv has fewer than two time steps yet")
    common.save(_cooling(run, job, history), folder, "history_cooling")
    if run.kinetic_density.ndim > 1:
        common.save(_density(run, history), folder, "history_density")
    common.save(_health(run, history), folder, "history_health")


def _cooling(run, job, history):
    """The mean temperature, beside Haff's law where the gas is granular; energy and temperature over that law."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.9))
    cooling, time = job.collision.cooling, history["time"]
    granular = cooling > 0
    shown = time > 0 if granular else slice(None)
    start, unit = history["energy"][0], 1.0
    left.plot(time[shown], history["mean_temperature"][shown], **common.KINETIC, label="kinetic")
    if _is_there(history, "fluid_mean_temperature"):
        left.plot(time[shown], history["fluid_mean_temperature"][shown], **common.FLUID, label="fluid")
    elif "fluid_density" in run:
        temperature = mean_temperature(run, "fluid")
        later = run.time.values > 0 if granular else slice(None)
        left.plot(run.time.values[later], temperature[later], "s", color="tab:orange", ms=4, label="fluid")
    if granular:
        first, density = mean_temperature(run, "kinetic")[0], run.kinetic_density.values[0].mean()
        law = haff(time[shown], first, density, cooling)
        left.plot(time[shown], law, color="black", ls=":", label="Haff's law at the mean density")
        unit = law / first
        over = history["mean_temperature"][shown] / law
        right.plot(time[shown], over, color="tab:green", ls="-.", label="kinetic, temperature")
        right.axhline(1.0, color="black", ls=":", lw=1)
    for name, style in (("energy", common.KINETIC), ("fluid_energy", common.FLUID)):
        if _is_there(history, name):
            model = "fluid" if name.startswith("fluid") else "kinetic"
            right.plot(time[shown], history[name][shown] / start / unit, **style, label=f"{model}, energy")
    left.set_ylabel(r"mean temperature $\langle \rho T \rangle / \langle \rho \rangle$")
    right.set_ylabel("over Haff's law at the mean density" if granular else "energy / kinetic energy at the start")
    if granular:
        left.set_yscale("log")
    _scale_of_a_ratio(right)
    for axis in (left, right):
        axis.set_xlabel("$t$")
        if granular:
            axis.set_xscale("log")
            axis.set_xlim(max(time[1], 1e-3 * time[-1]), 1.2 * time[-1])
        common.legend_below(axis)
    figure.suptitle(common.titled("mean temperature and energy", run))
    return figure


def _scale_of_a_ratio(axis):
    """An axis for what is about 1: a constant as one, not as its rounding errors; decades where it has some."""
    low, high = axis.dataLim.y0, axis.dataLim.y1
    if high > 20 * low > 0:
        axis.set_yscale("log")
        return
    if high - low < 1e-3:
        axis.set_ylim(min(low, 0.999), max(high, 1.001))
    axis.ticklabel_format(axis="y", useOffset=False)


def _density(run, history):
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.9))
    time = run.time.values
    later = time[time > 0]
    wide = len(later) > 1 and later[-1] >= 20 * later[0]
    shown = time > 0 if wide else slice(None)
    since = min(later[0], max(history["time"][1], 1e-3 * later[-1])) if wide else 0.0
    steps = history["time"] >= since

    def draw(axis, style, values, column, label):
        """The history of every step with the snapshots as points, or these alone."""
        if _is_there(history, column):
            axis.plot(history["time"][steps], history[column][steps], **style, label=label)
            style = {"color": style["color"], "ls": ""}
            label = None
        axis.plot(time[shown], values[shown], **style, marker="o", ms=3, label=label)

    for model in common.models(run):
        prefix, style = ("", common.KINETIC) if model == "kinetic" else ("fluid_", common.FLUID)
        draw(left, style, variance(run, model), f"{prefix}density_variance", model)
        values = deviation(run, model)
        fit = damping_rate(time, values)
        label = model
        if fit is not None:
            label += f", rate {fit[0]:.3g} in $\\log t$"
            right.plot(*fit[1:], color=style["color"], ls=":", lw=1)
        draw(right, style, values, f"{prefix}density_deviation", label)
    if wide:
        for axis, measure in ((left, variance), (right, deviation)):
            axis.axhline(measure(run, "kinetic")[0], color="grey", lw=0.7, ls=":", label="kinetic at $t = 0$")
            axis.set_xscale("log")
            if all(measure(run, model)[shown].min() > 0 for model in common.models(run)):
                axis.set_yscale("log")
    left.set_ylabel("variance of the density")
    if left.get_yscale() == "linear":
        left.set_ylim(bottom=0)
    right.set_ylabel(r"mean of $|\rho - \overline{\rho}|$")
    for axis in (left, right):
        axis.set_xlabel("$t$")
        common.legend_below(axis)
    figure.suptitle(common.titled("how far the density is from its mean", run))
    return figure


def _health(run, history):
    corrections = [name for name in history if name.startswith("correction")]
    figure, axes = plt.subplots(1, 2 + bool(corrections), figsize=(8.6 + 3 * bool(corrections), 3.8))
    time = history["time"]
    for name, values in errors(history).items():
        axes[0].plot(time, np.maximum(np.abs(values), NOUGHT), lw=1, label=name)
    axes[0].set_ylabel(f"relative error; below {NOUGHT:g} drawn there")
    axes[0].axhline(np.finfo(float).eps, color="grey", ls=":", lw=1, label="rounding of one number")
    relative = history["min_g"] / history["max_g"].max()
    for sign, style, label in ((1, common.KINETIC, "above zero"), (-1, {"color": "tab:red"}, "below zero, its size")):
        if (sign * relative > 0).any():
            axes[1].plot(time, np.where(sign * relative > 0, np.abs(relative), np.nan), lw=1, label=label, **style)
    axes[1].set_ylabel("smallest $g$ / largest $g$ of the run")
    for name in corrections:
        size = np.where(history[name] > 0, history[name], np.nan)
        axes[2].plot(time, size, lw=1, label="largest in a cell, a step" if name == "correction" else name)
    if corrections:
        axes[2].set_ylabel("size of the correction")
    for axis in axes:
        axis.set_xlabel("$t$")
        axis.set_xlim(time[0], time[-1])
        if any(np.isfinite(line.get_ydata()).any() for line in axis.get_lines()):
            axis.set_yscale("log")
        if axis.get_legend_handles_labels()[0]:
            common.legend_below(axis)
    figure.suptitle(common.titled("errors, smallest $g$, correction", run))
    return figure


if __name__ == "__main__":
    sys.exit(main())
