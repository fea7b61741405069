"""Signal processing of estimators, as pure functions on arrays."""

__all__ = [
    "angles",
    "beam_integration",
    "bounds",
    "cell_detection",
    "cfar",
    "detection",
    "doppler_notch",
    "fitting",
    "floating_point",
    "null_carriers",
    "partial_dft",
    "rangedoppler",
    "scatterers",
    "sparse_bayes",
    "windows",
]
