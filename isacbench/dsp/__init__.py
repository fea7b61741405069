"""Signal processing of estimators, as pure functions on arrays."""

__all__ = [
    "angles",
    "bounds",
    "cell_detection",
    "cfar",
    "detection",
    "fitting",
    "null_carriers",
    "partial_dft",
    "rangedoppler",
    "scaling",
    "scatterers",
    "sparse_bayes",
    "windows",
]
