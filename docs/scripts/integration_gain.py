"""Draw which share of scatterers lies in detected cells over SNR, by what is integrated before detection.

The bound is that of a matched filter aimed at the place of a scatterer, without tapers, at the same
false-alarm rate: Marcum's Q function of what the filter shows of all echoes. Scenes are developing ones.

    python docs/scripts/integration_gain.py    # two minutes
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import chndtr

from isacbench import get_detector, load_scenario
from isacbench.dsp.cell_detection import detect_cells
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.echo import Simulator
from isacbench.model.kernels import dirichlet, steering
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.report.figures import new_figure, save, styled
from isacbench.specifications import spell_spec

FIGURE = Path(__file__).resolve().parents[1] / "images" / "integration-gain.png"
FAMILIES = "street", "town", "facade", "crowd", "weak", "traffic", "crossing", "sparse"
SEEDS = range(40, 43)
PHASES = {"all in phase": False, "phase of the carrier": True}
SNR_DB = range(-70, 5, 5)
PFA, DYNAMIC_RANGE_DB = 1e-4, 28.0
INTEGRATIONS = {"element": "one element", "noncoherent": "mean power", "beams": "strongest beam"}
BOUND = "filter aimed at the place"
LINES = {"one element": ":", "mean power": "-.", "strongest beam": "-", BOUND: "--"}


def measure() -> pd.DataFrame:
    """Share of the scatterers of every scene that is detected."""
    rows, detector = [], get_detector("osca", pfa=PFA, order_axis=1)
    for phase, is_coherent in PHASES.items():
        for name in (
            spell_spec(family, {"seed": seed, "coherent_phase": is_coherent})
            for family in FAMILIES
            for seed in SEEDS
        ):
            scenario = load_scenario(name)
            simulator = Simulator(scenario)
            places = radio_places(scenario, scenario.truth) / rayleigh_cells(scenario)
            matched = matched_energy(simulator, places)
            cells = set(zip(*np.rint(places[:, :2]).astype(int).T, strict=True))
            own = [tuple(place) for place in np.rint(places[:, :2]).astype(int)]
            for snr_db in SNR_DB:
                energy = matched / simulator.noise_power(snr_db)
                bound = 1 - chndtr(-2 * np.log(PFA), 2, 2 * energy)
                rows.append((phase, BOUND, snr_db, name, bound.mean()))
                observation = simulator.observe(snr_db)
                gated = GatedMap.of(observation, observation.cells.astype(np.complex128))
                for integration, label in INTEGRATIONS.items():
                    found = detect_cells(
                        gated.tapered("hann", "hann"),
                        detector,
                        integration,
                        DYNAMIC_RANGE_DB,
                        cosine_limits=observation.cosine_limits,
                    )
                    detected = cells & set(zip(*found.bins, strict=True))
                    rows.append((phase, label, snr_db, name, np.mean([cell in detected for cell in own])))
    return pd.DataFrame(rows, columns=["phase", "integration", "snr_db", "scene", "share"])


def matched_energy(simulator: Simulator, places: np.ndarray) -> np.ndarray:
    """Energy behind filters matched to places (n, 4) in Rayleigh cells, of the echoes without noise."""
    scenario, gate = simulator.scenario, simulator.gate
    system, (n_p, n_q) = scenario.system, scenario.array.shape
    in_range = dirichlet(gate.range_bins, places[:, 0], system.n_subcarriers) / np.sqrt(system.n_subcarriers)
    in_doppler = dirichlet(gate.doppler_bins, places[:, 1], system.n_symbols) / np.sqrt(system.n_symbols)
    towards_u, towards_w = steering(n_p, 2 / n_p * places[:, 2]), steering(n_q, 2 / n_q * places[:, 3])
    seen = np.tensordot(in_range.conj().T, simulator.clean, 1)
    seen = np.einsum("dn,ndpq->npq", in_doppler, seen, optimize=True)
    seen = np.einsum("np,npq,nq->n", towards_u.conj(), seen, towards_w.conj(), optimize=True)
    return np.abs(seen) ** 2 / (n_p * n_q)


def draw(rows: pd.DataFrame) -> None:
    """Draw the means over the scenes."""
    with styled():
        figure = new_figure(9.0, 3.6)
        axes = figure.subplots(1, len(PHASES), sharey=True)
        for axis, phase in zip(axes, PHASES, strict=True):
            for k, (label, line) in enumerate(LINES.items()):
                own = rows[(rows["phase"] == phase) & (rows["integration"] == label)]
                mean = own.groupby("snr_db")["share"].mean()
                color = "0.4" if label == BOUND else f"C{k}"
                axis.plot(
                    mean.index,
                    mean,
                    line + ("" if label == BOUND else "os^"[k]),
                    color=color,
                    ms=4,
                    label=label,
                )
            axis.set(title=phase, xlabel="SNR [dB]", ylim=(0, 1.03))
            axis.grid(True)
        axes[0].set_ylabel("scatterers in detected cells")
        axes[0].legend(frameon=False)
        save(figure, FIGURE)


def main() -> None:
    """Measure, print the means and draw them."""
    rows = measure()
    print(rows.pivot_table("share", ["phase", "integration"], "snr_db").round(2).to_string())
    draw(rows)


if __name__ == "__main__":
    main()
