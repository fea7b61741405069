"""Range-Doppler maps, detections and spectra of a run for a page, computed anew."""

from __future__ import annotations

from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.compare.scenes import SCENE_KINDS
from isacbench.charts import nearest_values
from isacbench.report.diagnoses import Diagnoses, warn_of_fault
from isacbench.report.html.packed_clouds import SHOWN_SNR_DB

if TYPE_CHECKING:
    from isacbench.bench.store.run import Run
    from isacbench.model.numerology import System
    from isacbench.plugins.contracts import Diagnosis, Spectrum

LOWEST_DB, LOWEST_RATIO = -300.0, 0.01
"""Lowest level of a spectrum, and lowest ratio of power to noise: a page needs no weaker ones."""

MOST_MAPS = 6
"""Images of a page of which maps and spectra are computed; the page says how many it leaves out."""


def diagnosed_maps(run: Run) -> dict[str, Any]:
    """Compute maps and spectra of estimators that show their work, of a few images of a run of images.

    Every scene comes before any has a second estimator. The dictionary has ``maps``, each with its scene,
    estimator (label), SNR and trial, axes, power, threshold and mask, and spectra; and ``left_out``, the
    number of images beyond the first six. An estimator that is not installed, or whose diagnosis fails or
    cannot be shown, costs its own maps with a warning.
    """
    if run.kind not in SCENE_KINDS or run.rows.empty:
        return {}
    (snr_db,) = nearest_values(sorted(run.rows["snr_db"].unique()), [SHOWN_SNR_DB])
    trial = int(run.rows["trial"].min())
    diagnoses = Diagnoses(run, snr_db, trial)
    names = [name for name in dict.fromkeys(run.rows["scenario"].astype(object)) if name in run.scenarios]
    rounds = zip_longest(*([(name, variant) for variant in diagnoses.variants(name)] for name in names))
    wanted = [cell for cells in rounds for cell in cells if cell is not None]
    found: list[dict[str, Any]] = []
    for name, variant in wanted[:MOST_MAPS]:
        one = diagnoses.of(name, variant)
        if one is not None:
            own = {"scene": name, "estimator": one.label, "snr_db": float(snr_db), "trial": trial}
            try:
                found.append(own | _map(one.diagnosis, run.scenarios[name].system, one.noise_power))
            except Exception as error:  # a plugin may return anything
                warn_of_fault(one.label, error)
    return {"maps": found, "left_out": max(len(wanted) - MOST_MAPS, 0)}


def _map(diagnosis: Diagnosis, system: System, noise_power: float) -> dict[str, Any]:
    """Power and threshold over noise in tenths of a dB, and what was detected."""
    return {
        "range_m": _rounded(diagnosis.range_bins * system.range_bin_m, 3),
        "velocity_mps": _rounded(diagnosis.doppler_bins * system.velocity_bin_mps, 3),
        "power_db": _decibels(diagnosis.power / noise_power),
        "threshold_db": _decibels(diagnosis.detection.threshold / noise_power),
        "mask": np.asarray(diagnosis.detection.mask, dtype=int).tolist(),
        "spectra": [_spectrum(one) for one in diagnosis.spectra],
    }


def _spectrum(spectrum: Spectrum) -> dict[str, Any]:
    threshold = spectrum.threshold_db
    return {
        "label": str(spectrum.label),
        "cosine": _rounded(spectrum.cosine, 4),
        "level_db": _rounded(np.maximum(spectrum.level_db, LOWEST_DB), 2),
        "threshold_db": None
        if threshold is None
        else _rounded(np.broadcast_to(threshold, spectrum.cosine.shape), 2),
        "peaks": _rounded(spectrum.peaks, 4),
    }


def _decibels(ratio: Any) -> list[Any]:
    return _rounded(10 * np.log10(np.maximum(ratio, LOWEST_RATIO)), 1)


def _rounded(values: Any, digits: int) -> list[Any]:
    """Round numbers for JSON, None for what is not finite."""
    numbers = np.asarray(values, dtype=float)
    rounded = np.round(numbers, digits).astype(object)
    rounded[~np.isfinite(numbers)] = None
    found: list[Any] = rounded.tolist()
    return found
