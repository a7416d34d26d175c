"""What `Simulation` gives is the caller's: it stays as it was, and writing into it changes no run."""

import numpy as np

from rvm_mpi import Job, Simulation

JOB = Job.from_dict(
    {
        "space": {"cells": [12], "boundary": {"x": "diffuse"}},
        "velocity": {"points": [12, 12]},
        "collision": {"operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.5},
        "fluid": {"enabled": True},
        "initial": {"state": "wave", "mode": [1], "density_amplitude": 0.3},
        "time": {"end": 0.05},
        "output": {"marginals": True},
    }
)


def given(simulation):
    """All arrays that a user is given, by name."""
    arrays = {**simulation.snapshot(), **simulation.walls(), **simulation.moments()}
    assert "scaling/omega" in arrays
    assert "wall/x-lower/pressure" in arrays
    return arrays


def test_kept_arrays_stay():
    simulation = Simulation(JOB)
    kept = []
    for _ in simulation:
        arrays = given(simulation)
        kept.append((arrays, {name: values.copy() for name, values in arrays.items()}))
    assert len(kept) > 3
    for arrays, copies in kept:
        for name, values in arrays.items():
            assert np.array_equal(values, copies[name]), name


def test_writing_into_them_changes_nothing():
    one, other = Simulation(JOB), Simulation(JOB)
    for _ in one:
        for values in given(one).values():
            values[...] = np.nan
    for _ in other:
        pass
    for name, values in given(other).items():
        assert np.array_equal(given(one)[name], values), name
