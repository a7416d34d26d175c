"""How a run went: cooling beside Haff's law, the density's deviation from uniform, the health of the numbers.

Three figures into DIR/figures, as PNG and PDF: history_cooling (mean temperature and energy), history_density
(variance of the density, and its L1 deviation from the mean with the fitted rate of damping in log t), and
history_health (errors of mass, momentum and energy, smallest g, size of the correction).

    python postprocess/history.py runs/test4_clustering
"""

from __future__ import annotations

import sys

import common
import matplotlib.pyplot as plt
import numpy as np

from rvm_mpi import results
from rvm_mpi.job import Job

FEWEST_FOR_A_FIT = 6


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
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.6))
    cooling, time = job.collision.cooling, history["time"]
    granular = cooling > 0
    shown = time > 0 if granular else slice(None)
    left.plot(time[shown], history["mean_temperature"][shown], **common.KINETIC, label="kinetic")
    if _is_there(history, "fluid_mean_temperature"):
        left.plot(time[shown], history["fluid_mean_temperature"][shown], **common.FLUID, label="fluid")
    elif "fluid_density" in run:
        temperature = mean_temperature(run, "fluid")
        later = run.time.values > 0 if granular else slice(None)
        left.plot(run.time.values[later], temperature[later], "s", color="tab:orange", ms=4, label="fluid")
    if granular:
        start, density = mean_temperature(run, "kinetic")[0], run.kinetic_density.values[0].mean()
        law = haff(time[shown], start, density, cooling)
        left.plot(time[shown], law, color="black", ls=":", label="Haff's law at the mean density")
        left.set_xscale("log")
        left.set_yscale("log")
    left.set_ylabel(r"mean temperature $\langle \rho T \rangle / \langle \rho \rangle$")
    start = history["energy"][0]
    right.plot(time[shown], history["energy"][shown] / start, **common.KINETIC, label="kinetic")
    if _is_there(history, "fluid_energy"):
        right.plot(time[shown], history["fluid_energy"][shown] / start, **common.FLUID, label="fluid")
    right.set_ylabel("energy / kinetic energy at the start")
    if granular:
        right.set_xscale("log")
        right.set_yscale("log")
    for axis in (left, right):
        axis.set_xlabel("$t$")
        if granular:
            axis.set_xlim(max(time[1], 1e-3 * time[-1]), 1.2 * time[-1])
        axis.legend()
    figure.suptitle(common.title_of(run))
    return figure


def _density(run, history):
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.6))
    time = run.time.values
    later = time[time > 0]
    wide = len(later) > 1 and later[-1] > 20 * later[0]
    shown = time > 0 if wide else slice(None)
    steps = history["time"] >= (later[0] if wide else 0)

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
        axis.legend()
    figure.suptitle(common.title_of(run))
    return figure


def _health(run, history):
    corrections = [name for name in history if name.startswith("correction")]
    figure, axes = plt.subplots(1, 2 + bool(corrections), figsize=(8.6 + 3 * bool(corrections), 3.4))
    time = history["time"]
    for name, values in errors(history).items():
        size = np.abs(values)
        axes[0].plot(time, np.where(size > 0, size, np.nan), lw=1, label=name)
    axes[0].set_ylabel("relative error")
    axes[0].set_yscale("log")
    axes[0].legend()
    axes[1].plot(time, history["min_g"] / history["max_g"].max(), lw=1)
    axes[1].set_ylabel("smallest $g$ / largest $g$ of the run")
    if corrections:
        for name in corrections:
            positive = history[name] > 0
            axes[2].plot(time[positive], history[name][positive], lw=1, label=name.replace("_", " "))
        axes[2].set_ylabel("size of the correction")
        axes[2].set_yscale("log")
        if len(corrections) > 1:
            axes[2].legend()
    for axis in axes:
        axis.set_xlabel("$t$")
        axis.set_xlim(time[0], time[-1])
    figure.suptitle(common.title_of(run))
    return figure


if __name__ == "__main__":
    sys.exit(main())
