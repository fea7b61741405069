"""Range-Doppler maps, detections and spectra of a run for a page, computed anew."""

from __future__ import annotations

import time
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.compare.scene_scores import SCENE_KINDS
from isacbench.charts import nearest_values
from isacbench.report.figures.diagnosed_images import Diagnoses, warn_of_fault
from isacbench.report.html.packed_clouds import SHOWN_SNR_DB

if TYPE_CHECKING:
    from isacbench.model.numerology import System
    from isacbench.plugins.contracts import Diagnosis, Spectrum
    from isacbench.report.html.joined_runs import ReadRun

LOWEST_DB, LOWEST_RATIO = -300.0, 0.01
"""Lowest level of a spectrum, and lowest ratio of power to noise: a page needs no weaker ones."""

LONGEST_S = 1.0
"""Time of all maps of a page: what has not begun by then is left out, and the page says so."""


def diagnosed_maps(run: ReadRun) -> dict[str, Any]:
    """Compute maps and spectra of estimators that show their work, for one second.

    Every scene comes before any has a second estimator.

    Parameters
    ----------
    run : ReadRun

    Returns
    -------
    dict
        ``maps``, each with its scene, estimator (label), SNR and trial, axes, power, threshold and mask, and
        spectra; and ``left_out``, the number of those for which there was no time. Empty unless the run is
        of images.

    Warns
    -----
    InputWarning
        If an estimator of the run is not installed, or its diagnosis fails or cannot be shown.
    """
    records, scenarios, suite = run.rows.records, run.observed.scenarios, run.observed.suite
    if suite.kind not in SCENE_KINDS or records.empty:
        return {}
    (snr_db,) = nearest_values(sorted(records["snr_db"].unique()), [SHOWN_SNR_DB])
    trial = int(records["trial"].min())
    diagnoses = Diagnoses(suite, records, scenarios, snr_db, trial)
    names = [name for name in dict.fromkeys(records["scenario"].astype(object)) if name in scenarios]
    rounds = zip_longest(*([(name, variant) for variant in diagnoses.variants(name)] for name in names))
    wanted = [cell for cells in rounds for cell in cells if cell is not None]
    latest, took_s = time.perf_counter() + LONGEST_S, 0.0
    found: list[dict[str, Any]] = []
    for number, (name, variant) in enumerate(wanted):
        begun = time.perf_counter()
        if begun + took_s > latest:
            return {"maps": found, "left_out": len(wanted) - number}
        one = diagnoses.of(name, variant)
        if one is not None:
            own = {"scene": name, "estimator": one.label, "snr_db": float(snr_db), "trial": trial}
            try:
                found.append(own | _map(one.diagnosis, scenarios[name].system, one.noise_power))
            except Exception as error:  # a plugin may return anything
                warn_of_fault(one.label, error)
        took_s = time.perf_counter() - begun
    return {"maps": found, "left_out": 0}


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
