"""Range-Doppler maps, detections and spectra of a run for a page, computed anew."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.compare.scene_scores import SCENE_KINDS
from isacbench.bench.store.run_store import read_results
from isacbench.report.figures.curves import nearest_values
from isacbench.report.figures.diagnosed_images import diagnosed_images
from isacbench.report.html.packed_clouds import SHOWN_SNR_DB

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.model.numerology import System
    from isacbench.plugins.contracts import Diagnosis, Spectrum

LONGEST_S = 1.0
"""Time of all maps of a page: what has not begun by then is left out, and the page says so."""


def diagnosed_maps(folder: Path) -> dict[str, Any]:
    """Compute maps and spectra of estimators that show their work, scene by scene, for one second.

    Parameters
    ----------
    folder : Path
        Of a run.

    Returns
    -------
    dict
        Empty unless the run is of images.
        ``maps``, each with its scene, estimator (label), SNR and trial, axes, power, threshold and mask, and
        spectra; and ``left_out``, the number of scenes
        without any for which there was no time.

    Warns
    -----
    InputWarning
        If a diagnosis fails.
    """
    results = read_results(folder)
    if results.suite.kind not in SCENE_KINDS or results.records.empty:
        return {}
    latest, longest_s, found, n_left_out = time.perf_counter() + LONGEST_S, 0.0, [], 0
    (snr_db,) = nearest_values(sorted(results.records["snr_db"].unique()), [SHOWN_SNR_DB])
    trial = int(results.records["trial"].min())
    for name in dict.fromkeys(results.records["scenario"].astype(object)):
        begun = time.perf_counter()
        if begun + longest_s > latest:
            n_left_out += 1
            continue
        own = {"scene": name, "snr_db": float(snr_db), "trial": trial}
        for one in diagnosed_images(results, name, snr_db, trial):
            system = results.scenarios[name].system
            found.append({**own, "estimator": one.label, **_map(one.diagnosis, system, one.noise_power)})
            ended = time.perf_counter()
            begun, longest_s = ended, max(longest_s, ended - begun)
            if ended + longest_s > latest:
                break
    return {"maps": found, "left_out": n_left_out}


def _map(diagnosis: Diagnosis, system: System, noise_power: float) -> dict[str, Any]:
    """Power and threshold over noise in tenths of a dB, and what was detected."""
    return {
        "range_m": np.round(diagnosis.range_bins * system.range_bin_m, 3).tolist(),
        "velocity_mps": np.round(diagnosis.doppler_bins * system.velocity_bin_mps, 3).tolist(),
        "power_db": _decibels(diagnosis.power / noise_power),
        "threshold_db": _decibels(diagnosis.detection.threshold / noise_power),
        "mask": diagnosis.detection.mask.astype(int).tolist(),
        "spectra": [_spectrum(one) for one in diagnosis.spectra],
    }


def _decibels(ratio: Any) -> list[list[float]]:
    decibels: list[list[float]] = np.round(10 * np.log10(np.maximum(ratio, 0.01)), 1).tolist()
    return decibels


def _spectrum(spectrum: Spectrum) -> dict[str, Any]:
    threshold = spectrum.threshold_db
    return {
        "label": spectrum.label,
        "cosine": np.round(spectrum.cosine, 4).tolist(),
        "level_db": np.round(np.maximum(spectrum.level_db, -300), 2).tolist(),
        "threshold_db": None
        if threshold is None
        else np.round(np.broadcast_to(threshold, spectrum.cosine.shape), 2).tolist(),
        "peaks": np.round(spectrum.peaks, 4).tolist(),
    }
