"""Observations of a scenario: by the closed form where it holds, else through the link."""

from __future__ import annotations

from pathlib import Path

from isacbench.choices import Division, Modulation, Sensing
from isacbench.errors import InputError
from isacbench.model.echo import observe_echo as observe_plainly
from isacbench.model.observation import Observation
from isacbench.model.scene import Scenario
from isacbench.model.scenes.scenario import load_scenario


def observe(
    scenario: Scenario | str | Path,
    snr_db: float = 10.0,
    trial: int = 0,
    seed: int = 0,
    *,
    modulation: Modulation = "qpsk",
    sensing: Sensing = "all",
    division: Division = "reciprocal",
) -> Observation:
    """Observe a scenario once; what was computed of the last two scenarios and signals is kept.

    Parameters
    ----------
    scenario : Scenario, str or Path
        Or what `isacbench.load_scenario` takes: a name, a family such as ``town[seed=7]``, a path.
    snr_db : float
        Signal-to-noise ratio Σ|G|²/σ² per resource element and virtual element,
        whatever is sensed with; infinity for no noise. By default 10, as of ``isacbench image``.
    trial, seed : int
        Trial and seed of noise and data.
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
        Of the data.
    sensing : {"all", "prs"}
        Resource elements that are sensed with: the whole grid, or the PRS alone.
    division : {"reciprocal", "matched", "wiener"}
        Division of what was received by what was sent. All give the same where
        all symbols have the same power, as in QPSK and in the PRS.

    Raises
    ------
    InputError
        If a value is not allowed, or the scenario is of another type, or the
        SNR is no number, or so low that the noise overflows.

    Examples
    --------
    >>> whole_grid = observe("street", snr_db=10)
    >>> pilots_alone = observe("street", snr_db=10, sensing="prs")
    >>> bool(abs(pilots_alone.cells).mean() > abs(whole_grid.cells).mean())
    True
    """
    if isinstance(scenario, (str, Path)):
        scenario = load_scenario(scenario)
    if not isinstance(scenario, Scenario):
        raise InputError(f"scenario takes a name, a path or a Scenario, not {type(scenario).__name__}")
    if (modulation, sensing, division) == ("qpsk", "all", "reciprocal"):
        return observe_plainly(scenario, snr_db, trial, seed)
    # Loaded where it is needed: the link brings in what most runs do without.
    from isacbench.link.sensing.division import Signal
    from isacbench.link.sensing.link_observation import kept_simulator

    return kept_simulator(scenario, Signal(modulation, sensing, division)).observe(snr_db, trial, seed)
